"""Help, versions, exports and slips of the command line are answered before JAX is imported.

Counted in modules, which are the same on every machine, not in seconds.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import pytest

from fit._compile import keep_programs
from tests.data import REPOSITORY

HEAVY = {
    "jax",
    "numpy",
    "scipy",
    "matplotlib",
    "equinox",
    "optimistix",
    "moderngl",
    "PIL",
    "jinja2",
}

MOST_MODULES = 450
"""Of them 150 are Python's own at its start, and 280 are there once Typer has read a wrong option;
JAX alone imports 900."""

LISTING = """
import sys
from fit.cli._cli import main
sys.argv[0] = "airlight"
try:
    main()
finally:
    with open("modules.txt", "w") as file:
        print(*sys.modules, file=file)
"""

SCENE = REPOSITORY / "examples" / "reference.toml"
PHOTO = SCENE.with_suffix(".png")


def run(folder: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", LISTING, *words],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(REPOSITORY)} | variables,
    )


SHAPES = {"brightness": "number", "shadow": "either", "tint": "rgb", "background": "either"}


def document() -> dict[str, object]:
    values = {"brightness": 3.0, "shadow": 0.2, "background": 0.0}
    values |= {f"tint.{channel}": 1.0 for channel in "rgb"}
    return {
        "schema": 3,
        "look": {"kind": "layers", "light": "", "shapes": SHAPES},
        "verdict": "converged",
        "parameters": {name: {"value": value, "role": "fixed"} for name, value in values.items()},
    }


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--help"], 0, "Usage: airlight"),
        (["fit", "--help"], 0, "Usage: airlight fit"),
        (["--version"], 0, "airlight "),
        (["version"], 0, "optimistix"),
        (["version", "--json"], 0, "optimistix"),
        (["export", "fit.json", "--to", "glsl"], 0, "brightness = 3.0"),
        (["export", "fit.json", "--to", "csv"], 0, "brightness,3.0"),
        (["export", "fit.json", "--to", "glsl", "-o", "out.glsl"], 0, ""),
        (["export", "none.json", "--to", "csv"], 2, "none.json: no such file"),
        (["nonsense"], 2, "nonsense"),
        (["fit", "--nope"], 2, "--nope"),
        (["fit", "scene.toml", "-o", "out"], 2, "give SCENE PHOTO"),
        (["fit", "no.toml", "no.png", "-o", "out"], 2, "no.toml: no such file"),
        (["fit", SCENE, PHOTO, "-o", "fit.json"], 2, "cannot be made a folder"),
        (["fit", SCENE, PHOTO, "-o", "out", "--loss", "none"], 2, "'none' is not one of"),
        (["fit", SCENE, PHOTO, "-o", "out", "--solver", "none"], 2, "'none' is not one of"),
        (["fit", SCENE, PHOTO, "-o", "out", "--bounds", "shadow"], 2, "must be NAME=LOW:HIGH"),
        (["fit", SCENE, PHOTO, "-o", "out", "--max-steps", "0"], 2, "max-steps: is 0"),
        (["fit", SCENE, PHOTO, "-o", "out", "--near", "1"], 2, "go with --layers"),
        (["fit", SCENE, PHOTO, "-o", "out", "--tone-curve", "1,x"], 2, "EXPOSURE,GAMMA"),
        (["fit", SCENE, PHOTO, "-o", "out", "--tone-curve", "log"], 2, "linear, srgb or EXPOSURE"),
        (["fit", SCENE, PHOTO, "-o", "out", "--free", "-haze"], 2, "'-haze' is no parameter"),
        (["fit", SCENE, PHOTO, "-o", "out", "--start", "2=1"], 2, "'2' is no parameter"),
        (["fit", SCENE, PHOTO, "-o", "out", "--tie", "gamma=a b"], 2, "'a b' is no parameter"),
        (
            ["fit", SCENE, PHOTO, SCENE, PHOTO, "-o", "out", "--mask", PHOTO],
            2,
            "--mask and --tone-curve are of one photo",
        ),
        (["render", SCENE, "-o", "picture.jpg"], 2, "neither .exr"),
        (["render", SCENE, "-o", "picture.png", "--size", "big"], 2, "must be WIDTHxHEIGHT"),
        (["render", SCENE, "-o", "a.png", "--size", "9" * 5000 + "x1"], 2, "must be WIDTHxHEIGHT"),
        (["render", "no.toml", "-o", "picture.png"], 2, "no.toml: no such file"),
        (["check", "no.toml"], 2, "no.toml: no such file"),
        (["check", SCENE, "-o", "fit.json"], 2, "cannot be made a folder"),
        (["bench", "-o", "fit.json"], 2, "cannot be made a folder"),
    ],
    ids=lambda value: " ".join(map(str, value)) if isinstance(value, list) else None,
)
def test_the_first_word_needs_no_jax(
    words: list[object], code: int, said: str, tmp_path: Path
) -> None:
    (tmp_path / "fit.json").write_text(json.dumps(document()))
    done = run(tmp_path, *map(str, words))
    assert done.returncode == code, done.stderr
    assert said in done.stdout + done.stderr
    modules = (tmp_path / "modules.txt").read_text().split()
    assert not HEAVY & set(modules)
    assert len(modules) <= MOST_MODULES


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("airlight ex", "export"),
        ("airlight fit --los", "--loss"),
        ("airlight export f --to t", "toml"),
    ],
)
def test_the_shell_completes(typed: str, offered: str, tmp_path: Path) -> None:
    count = str(len(typed.split()) - 1)
    completing = {"_AIRLIGHT_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": count}
    done = run(tmp_path, **completing)
    assert done.stdout.split() == [offered], done.stderr
    assert not HEAVY & set((tmp_path / "modules.txt").read_text().split())


@pytest.mark.parametrize("package", ["model_jax", "render_gl", "fit", "airlight"])
def test_importing_a_package_imports_what_is_used(package: str) -> None:
    code = f"import sys, {package}; print(dir({package})); print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    listed, modules = done.stdout.splitlines()
    assert len(listed) > 100, "the names are known before they are imported"
    assert not HEAVY & set(modules.split())


def test_a_setting_that_jax_refuses_is_named(tmp_path: Path) -> None:
    done = run(tmp_path, "render", str(SCENE), "-o", "a.png", JAX_ENABLE_X64="banana")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "JAX refuses a setting" in line
    assert "banana" in line
    assert "JAX_ENABLE_X64" in line


WATCHED = """
import sys
import rich.progress
from fit.cli._cli import main
sys.argv[0] = "airlight"
add_task = rich.progress.Progress.add_task
def watch(self, description, **options):
    with open("first.txt", "w") as file:
        print(description, "jax" in sys.modules, file=file)
    return add_task(self, description, **options)
rich.progress.Progress.add_task = watch
main()
"""


def test_the_progress_line_is_there_before_jax(tmp_path: Path) -> None:
    command = ["fit", str(SCENE), str(SCENE), "-o", "out"]  # the scene is no photo
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *command], capture_output=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 2
    assert (tmp_path / "first.txt").read_text() == "starting False\n"


# --- what is compiled once is kept --------------------------------------------------------------

COUNTED = """
import collections, sys
import jax
from fit.cli._cli import main
sys.argv[0] = "airlight"
counts = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: counts.update([event]))
try:
    main()
finally:
    asked = counts["/jax/compilation_cache/compile_requests_use_cache"]
    with open("counts.txt", "w") as file:
        print(asked, counts["/jax/compilation_cache/cache_hits"], file=file)
"""


DEMO = ("fit", SCENE, PHOTO, "-o", "demo")


def counted(folder: Path, *words: object, **variables: str) -> tuple[int, int]:
    """Runs a command; returns how many programs it asked for, and how many had been kept."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    done = subprocess.run(
        [sys.executable, "-c", COUNTED, *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=environment | {"XDG_CACHE_HOME": str(folder / "cache")} | variables,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr in ("", "airlight: warning: the best fit lies at a bound\n"), done.stderr
    asked, kept = map(int, (folder / "counts.txt").read_text().split())
    return asked, kept


@pytest.mark.skipif(sys.platform != "linux", reason="XDG_CACHE_HOME is Linux's")
def test_a_second_demo_compiles_nothing(tmp_path: Path) -> None:
    asked, kept = counted(tmp_path, *DEMO)
    assert kept < 5 < 10 < asked, "only what one command asks for twice"
    programs = sorted((tmp_path / "cache" / "airlight" / "xla").glob("*-cache"))
    assert len(programs) > 10
    document = json.loads((tmp_path / "demo" / "fit.json").read_text())
    values = document["parameters"]
    assert document["verdict"] == "at_bound"
    assert document["explained"] > 0.95
    assert 0.85 < values["scale_height"]["value"] / 8 < 1.15, "km, of the march's molecules"
    asked, kept = counted(tmp_path, *DEMO)
    assert sorted((tmp_path / "cache" / "airlight" / "xla").glob("*-cache")) == programs, (
        "the same programs under the same names"
    )
    assert json.loads((tmp_path / "demo" / "fit.json").read_text())["parameters"] == values
    if asked and not kept:
        pytest.skip("this processor takes no program from XLA's cache")
    assert kept == asked


def test_programs_are_not_kept_where_they_cannot_or_shall_not_be(tmp_path: Path) -> None:
    (tmp_path / "cache").write_text("a file, no folder")
    drawing = ("render", SCENE, "-o", "a.exr", "--source", "analytic", "--size", "72x54")
    asked, kept = counted(tmp_path, *drawing)
    assert kept == 0 < asked
    (tmp_path / "cache").unlink()
    assert counted(tmp_path, *drawing, JAX_ENABLE_COMPILATION_CACHE="false") == (0, 0)
    assert not list((tmp_path / "cache").rglob("*-cache"))


@pytest.mark.parametrize("own", [True, False], ids=["asked", "ours"])
def test_settings_of_the_cache_that_somebody_gave_stand(own: bool, tmp_path: Path) -> None:
    code = "import jax; from fit._compile import keep_programs; keep_programs(); c = jax.config; "
    code += "print(c.jax_compilation_cache_max_size, c.jax_compilation_cache_dir)"
    asked = {"JAX_COMPILATION_CACHE_MAX_SIZE": "1000"} if own else {}
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment |= {"XDG_CACHE_HOME": str(tmp_path)} | asked
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    size, folder = done.stdout.split()
    assert int(size) == (1000 if own else 2**28)
    assert folder == str(tmp_path / "airlight" / "xla")


def test_a_user_without_a_home_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """platformdirs raises RuntimeError then."""

    def nowhere(*_: object, **__: object) -> Path:
        raise RuntimeError("could not determine the home directory")

    monkeypatch.setattr("platformdirs.user_cache_path", nowhere)
    configuration: Any = jax.config  # its type does not list its settings
    kept = configuration.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    try:
        keep_programs()
        assert configuration.jax_compilation_cache_dir is None
    finally:
        jax.config.update("jax_compilation_cache_dir", kept)
