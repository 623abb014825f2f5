# `make demo` and `make test` need git, make and Python 3.11 or newer; the first run sets up the rest.
PYTHON ?= python3
PYTEST_ARGS ?=
ready := .venv/.ready
bin := .venv/bin

.PHONY: help setup demo test test-full lint types clean

help: ## Say what the targets do
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1	\2/p' $(MAKEFILE_LIST) | expand -t 20

setup: $(ready) ## Make .venv from the lock file and find an OpenGL driver

demo: $(ready) ## Fit the example photo and write demo/report.html
	$(bin)/airlight fit examples/reference.toml examples/reference.png -o demo
	@echo "Report: $(CURDIR)/demo/report.html"
	@echo "Next: the same of a photo of yours, with a scene such as examples/epic.toml (README.md, Scenes);"
	@echo "      $(bin)/airlight export demo/fit.json --to glsl  prints the look for a shader"

test: $(ready) ## Run the tests; options for pytest go into PYTEST_ARGS
	$(bin)/python -m pytest -m "not full" -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart=0 $(PYTEST_ARGS)

test-full: $(ready) ## Run the tests and the full sweep, compiled as users compile (tests/conftest.py)
	XLA_FLAGS="$(XLA_FLAGS)" $(bin)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart=0 $(PYTEST_ARGS)

lint: $(ready) ## Check style, formatting, lengths and which file imports which
	$(bin)/ruff check
	$(bin)/ruff format --check
	$(bin)/python .ci/lengths.py model_jax render_gl fit airlight
	$(bin)/lint-imports --no-logo --no-cache

types: $(ready) ## Check types
	$(bin)/mypy

clean: ## Remove everything that make has made
	rm -rf .venv .venv-uv demo out dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

$(ready): uv.lock pyproject.toml
	@PYTHON="$(PYTHON)" .ci/setup
