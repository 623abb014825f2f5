"""A sample of `airlight stress`: nothing is broken, and its files say what is in the rows."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from fit._compile import float64
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
    assert "camera 1e+06 radii away" not in page or "float32 loses" in page
    assert "Who is first" not in page  # no frontier lies there
    assert "http" not in page.replace("http-equiv", "")


@pytest.mark.parametrize("option", ["--fits", "--seed"])
def test_counts_below_nothing_are_refused(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("stress", "-o", str(tmp_path / "new"), option, "-1") == 2
    assert option in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
