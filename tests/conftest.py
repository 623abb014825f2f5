"""What every test has: run-time shape checks, strict JAX, seeded randomness, the data folder.

Imported before any test module, so that jaxtyping's hook sees the packages first: from here on each
annotated function of theirs checks its arguments' shapes and dtypes with beartype.
"""

import os
from collections.abc import Iterator
from pathlib import Path

from .data import FOLDER, REPOSITORY

# What one worker or command has compiled the next one reads. JAX looks at these when imported.
os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(REPOSITORY / ".pytest_cache" / "xla"))
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
# Most of the tests' time is compiling programs that run once, so LLVM optimises them less, and in
# one piece: a fifth less of a core's time. XLA's own passes, which reorder and fuse sums, are what
# users get; the full sweep compiles all as users do (Makefile).
os.environ.setdefault(
    "XLA_FLAGS", "--xla_backend_optimization_level=1 --xla_cpu_parallel_codegen_split_count=1"
)

import jax
import numpy as np
import pytest
from jaxtyping import install_import_hook

install_import_hook(["model_jax", "render_gl", "fit"], "beartype.beartype")
# Shapes of different rank never meet by accident: [w] + [h, w] raises.
jax.config.update("jax_numpy_rank_promotion", "raise")

pytest_plugins = ["tests.resources"]

SEED = 20240229


@pytest.fixture
def x64() -> Iterator[None]:
    """The test runs with JAX's 64-bit numbers on; they are off again after it."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(params=["float32", "float64"])
def dtype(request: pytest.FixtureRequest) -> Iterator[np.dtype]:
    """Runs the test in either precision, with x64 on only where it needs it."""
    with jax.enable_x64(request.param == "float64"):
        yield np.dtype(request.param)


@pytest.fixture
def rng() -> np.random.Generator:
    """NumPy random numbers, the same in each run and whatever runs before."""
    return np.random.default_rng(SEED)


@pytest.fixture
def key() -> jax.Array:
    """A JAX random key, the same in each run."""
    return jax.random.key(SEED)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of photos and damaged files."""
    if not FOLDER.is_dir():
        pytest.skip(f"no data folder at {FOLDER}; set AIRLIGHT_DATA to run the tests that read it")
    return FOLDER
