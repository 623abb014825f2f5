"""What `pip install` brings: packages with their types and data, and the examples."""

import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, capture_output=True, cwd=ROOT, check=True)
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path)


@pytest.fixture
def names(wheel: zipfile.ZipFile) -> set[str]:
    return set(wheel.namelist())


def test_each_package_is_there_with_its_types(names: set[str]) -> None:
    for package in ("model_jax", "render_gl", "fit", "airlight"):
        assert {f"{package}/{n}" for n in ("__init__.py", "__init__.pyi", "py.typed")} <= names
    assert {"fit/report/templates/report.html", "fit/bench/templates/bench.html"} <= names
    assert {"render_gl/glsl/fields.glsl", "render_gl/glsl/looks/layers.glsl"} <= names
    assert not any(name.startswith("tests/") for name in names)


def test_the_examples_are_there(names: set[str]) -> None:
    data = {name.partition(".data/data/")[2] for name in names if ".data/data/" in name}
    examples = (p for p in (ROOT / "examples").rglob("*") if p.is_file())
    assert data == {f"share/airlight/{path.relative_to(ROOT).as_posix()}" for path in examples}


def test_an_index_page_has_no_address_that_leads_nowhere(wheel: zipfile.ZipFile) -> None:
    """The picture and the links of the README are relative to the repository."""
    (name,) = (name for name in wheel.namelist() if name.endswith("/METADATA"))
    page = wheel.read(name).decode()
    assert "# airlight" in page
    assert "examples/paper.toml" in page
    assert re.findall(r"\]\((?!https?:)", page) == []
