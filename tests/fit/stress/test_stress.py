"""A sample of `airlight stress`: nothing is broken, and its files say what is in the rows."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from fit._compile import float64
from fit.bench._page import write_page
from fit.stress._plans import SAMPLE
from fit.stress._stress import Stress, run_stress
from fit.stress._words import tables
from tests.command import airlight


@pytest.fixture(scope="module")
def stress(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Stress, Path]]:
    folder = tmp_path_factory.mktemp("stress")
    with float64():
        yield run_stress(folder, SAMPLE), folder


def test_the_sample_keeps_what_is_promised(stress: tuple[Stress, Path]) -> None:
    found = stress[0]
    assert found.broken == []
    assert {row.area for row in found.numbers} == {"render", "combine", "record"}
    assert any(row.verdict == "float32 loses" and row.note for row in found.numbers)
    for row in found.numbers:
        assert row.gradient_finite
        assert row.float64 is not None
        assert row.float64 < 1e-8
    assert found.fits
    assert len(found.random) == SAMPLE.fits


def test_the_files_hold_the_rows(stress: tuple[Stress, Path]) -> None:
    found, folder = stress
    for name, rows in (
        ("stress.csv", found.numbers),
        ("stress_fits.csv", found.fits),
        ("stress_random.csv", found.random),
    ):
        with open(folder / name, newline="", encoding="utf-8") as stream:
            cases = [row["case"] for row in csv.DictReader(stream)]
        assert cases == [row.case for row in rows]
    told = json.loads((folder / "stress.json").read_text())
    assert told["machine"]["versions"]["mpmath"]
    assert told["broken"] == 0
    assert told["summary"]["count"] == SAMPLE.fits
    assert len(told["tables"][0]["rows"]) == len(found.numbers)


def test_the_page_holds_the_tables(stress: tuple[Stress, Path]) -> None:
    found, folder = stress
    page = (folder / "bench.html").read_text()
    for table in tables(found.numbers, found.fits, found.random):
        assert f"<h2>{table.title}</h2>" in page
    assert "Who is first" not in page  # no frontier lies there
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"date": "", "seed": 1, "machine": {}}'])
def test_a_file_of_others_is_left_out_with_a_word(text: str, tmp_path: Path) -> None:
    (tmp_path / "stress.json").write_text(text)
    (tmp_path / "frontier.json").write_text(text)
    write_page(tmp_path)
    page = (tmp_path / "bench.html").read_text()
    assert "stress.json: cannot be read" in page
    assert "frontier.json: cannot be read" in page


@pytest.mark.parametrize("option", ["--fits", "--seed"])
def test_counts_below_nothing_are_refused(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("stress", "-o", str(tmp_path / "new"), option, "-1") == 2
    assert option in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


OWN = """
import jax.numpy as jnp

from model_jax import Look, parameter


class Haze(Look):
    "Light that grows with the square of the width."

    gain: float = parameter("light at a width of 1", default=1e-3, lower=0.0, upper=1e-3)
    NEEDS = ("width",)
    ROUNDINGS = (4.0, 4.0)
    GLSL = "uniform float gain; vec3 air(Fields f, inout float a, inout vec3 t) { return vec3(0); }"

    def air(self, fields):
        x = self.gain * fields.width
        return LIGHT * fields.color, None
"""


@pytest.mark.parametrize(
    ("light", "code"), [("(1 - jnp.cos(x))", 1), ("2 * jnp.sin(x / 2) ** 2", 0)]
)
def test_a_look_of_ones_own_is_taken_to_its_limits(
    light: str, code: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The square of small numbers, by a formula that cancels and by one that does not."""
    path = tmp_path / "haze.py"
    path.write_text(OWN.replace("LIGHT", light))
    assert airlight("stress", "-o", str(tmp_path / "out"), "--look", str(path)) == code
    told = capsys.readouterr().out
    assert ("broken: haze: as it starts: float32: lost for no reason" in told) is bool(code)
    assert (tmp_path / "out" / "bench.html").exists()


def test_a_look_that_is_none_is_refused_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("stress", "-o", str(tmp_path), "--look", "layers", "--look", "fog") == 2
    assert "look 'fog' is unknown" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
