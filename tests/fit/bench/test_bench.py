"""The benchmark runs, finds the optimum with every solver, and says what it has measured."""

import csv
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """By the command line, which switches float64 on: the float32 peer must not notice."""
    folder = tmp_path_factory.mktemp("bench")
    command = "import sys; sys.argv[0] = 'airlight'; from fit.cli._cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", command, "bench", "--quick", "--json", "-o", str(folder)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), folder


def test_all_rows_are_at_the_optimum(bench: tuple[dict, Path]) -> None:
    """To 1e-6 relative; float32's own rounding of sums over 110,000 samples is √n times smaller."""
    errors = {row["name"]: row["error"] for row in bench[0]["rows"] if row["error"] is not None}
    assert len(errors) == 5
    assert all(error < 1e-6 for error in errors.values()), errors


def test_a_photo_of_another_size_compiles_nothing(bench: tuple[dict, Path]) -> None:
    notes = {row["name"]: row["note"] for row in bench[0]["rows"]}
    assert notes["second photo of another size"] == "0 compilations"
    # What counts them does count: the first fit of a process compiles.
    (parts,) = re.findall(r"in (\d+) parts", notes["compiling, first fit() only"])
    assert int(parts) > 0


def test_files_hold_what_is_printed(bench: tuple[dict, Path]) -> None:
    document, folder = bench
    assert json.loads((folder / "fit-bench.json").read_text()) == document
    with open(folder / "fit-bench.csv", newline="", encoding="utf-8") as stream:
        names = [row["name"] for row in csv.DictReader(stream)]
    assert names == [row["name"] for row in document["rows"]]
    assert document["pass"]["times_floor"] > 1
