"""The lints of the house find what they are for: planted faults, one at a time."""

import shutil
import subprocess
import sys
from pathlib import Path
from textwrap import indent

import pytest

from .data import REPOSITORY

PACKAGES = ("model_jax", "render_gl", "fit", "airlight")
FLOORS = "Floors: airlight, fit, render_gl, model_jax"
LENGTHS = REPOSITORY / ".ci" / "lengths.py"


def run(*command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def house(tmp_path: Path) -> Path:
    """A copy of the packages to plant faults in."""
    for package in PACKAGES:
        shutil.copytree(REPOSITORY / package, tmp_path / package)
    shutil.copy(REPOSITORY / "pyproject.toml", tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("file", "line", "contract"),
    [
        ("model_jax/_look.py", "import render_gl", FLOORS),
        (
            "render_gl/_draw.py",
            "from fit import fit",
            FLOORS,
        ),
        ("fit/_fit.py", "import airlight", FLOORS),
        ("fit/solve/_model.py", "from ..report import _report", "Floors of fit"),
        ("fit/photo/_photo.py", "from ..solve import _model", "Floors of fit"),
        ("fit/diagnose/_spread.py", "from .. import _fit", "Floors of fit"),
        ("fit/_elsewhere.py", "", "Floors of fit"),
        ("fit/solve/_samples.py", "from . import _search", "No circles"),
        ("render_gl/_frame.py", "from . import _draw", "No circles"),
        ("fit/photo/_pixels.py", "import moderngl", "No OpenGL in photo, solve and diagnose"),
        ("fit/diagnose/_limb.py", "from render_gl import _draw", "No OpenGL in photo, solve"),
        ("fit/solve/_task.py", "from ..photo import _read", "No file formats in solve"),
    ],
)
def test_an_import_that_runs_up_is_found(house: Path, file: str, line: str, contract: str) -> None:
    path = house / file
    path.write_text((path.read_text() if path.exists() else "") + f"\n{line}\n")
    done = run(str(Path(sys.executable).with_name("lint-imports")), "--no-cache", folder=house)
    assert done.returncode == 1, done.stdout
    broken = [line for line in done.stdout.splitlines() if line.endswith("BROKEN")]
    assert any(line.startswith(contract) for line in broken), done.stdout


LONG_FILE = "x = 1\n" * 401
LONG_FUNCTION = "def f():\n" + "    x = 1\n" * 61


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (LONG_FILE, "401 lines, over 400"),
        (LONG_FUNCTION, "f has 61 lines of code, over 60"),
        ("class A:\n" + indent(LONG_FUNCTION, "    "), "f has 61 lines of code"),
        (LONG_FILE[6:], None),
        ("# long: a table\n" + LONG_FILE, None),
        (LONG_FUNCTION.replace("def f():", "def f():  # long: a loop"), None),
        (LONG_FUNCTION.replace("x = 1\n", "# x = 1\n\n", 1), None),
        (LONG_FUNCTION.replace("x = 1\n", '"""Of\n\n    three lines."""\n', 1), None),
    ],
)
def test_what_is_long_without_a_reason_is_found(
    tmp_path: Path, text: str, found: str | None
) -> None:
    (tmp_path / "a.py").write_text(text)
    done = run(sys.executable, str(LENGTHS), ".", folder=tmp_path)
    assert done.returncode == (0 if found is None else 1)
    assert found is None or found in done.stdout


def test_a_folder_without_files_is_no_success(tmp_path: Path) -> None:
    assert run(sys.executable, str(LENGTHS), "nowhere", folder=tmp_path).returncode == 2


def test_make_lint_runs_them() -> None:
    done = run("make", "-n", "lint", folder=REPOSITORY)
    assert "lint-imports" in done.stdout
    assert f"lengths.py {' '.join(PACKAGES)}" in done.stdout
