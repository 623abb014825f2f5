"""`airlight stress`: stiff and extreme cases, as tables, and whether what is promised holds.

    scenes (_render_cases), looks and curves (_combine_cases) ──> errors (_number_row, _wide)
    hard fits (_fit_cases), random fits (_random_fits)        ──> verdicts (_fit_row)
        ──> stress.csv, stress_fits.csv, stress_random.csv, stress.json (_words) ──> bench.html

Promised is: no NaN, no infinity, and no loss without a name; no fit that calls itself converged and
is off by more than five times its stated interval.
"""

import json
from dataclasses import asdict, dataclass
from datetime import date
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any

from render_gl import write_whole

from ..bench._measure import machine
from ..bench._page import put, put_rows, write_page
from ._combine_cases import combine_probes, record_probes
from ._fit_cases import fit_rows
from ._fit_row import FitRow
from ._made import SEED, Tell
from ._number_row import NumberRow, measured
from ._plans import FULL, Plan
from ._random_fits import random_fits, summary
from ._render_cases import render_probes
from ._words import tables


@dataclass(frozen=True)
class Stress:
    """All rows, and what is to be known of them."""

    numbers: tuple[NumberRow, ...]
    fits: tuple[FitRow, ...]
    random: tuple[FitRow, ...]
    facts: dict[str, Any]
    """Date, machine, versions, seed."""

    @property
    def broken(self) -> list[NumberRow | FitRow]:
        """Rows that break a promise."""
        every: list[NumberRow | FitRow] = [*self.numbers, *self.fits, *self.random]
        return [row for row in every if not row.kept]

    def to_dict(self) -> dict[str, Any]:
        """All of it, as JSON data."""
        return self.about() | {
            "numbers": [asdict(row) for row in self.numbers],
            "fits": [asdict(row) for row in self.fits],
            "random": [asdict(row) for row in self.random],
        }

    def about(self) -> dict[str, Any]:
        """What there is to know beside the rows."""
        return self.facts | {"summary": summary(self.random), "broken": len(self.broken)}


def run_stress(
    folder: Path,
    plan: Plan = FULL,
    seed: int = SEED,
    tell: Tell = lambda step: None,
) -> Stress:
    """Compute, and write into a folder `stress.csv`, `stress_fits.csv`, `stress_random.csv`, the
    rows; `stress.json`, machine, versions, seed and the tables in words; and the page `bench.html`.

    Args:
        seed: of the random fits.

    Raises:
        InputError: a look cannot be found, or needs fields that no analytic layers have; the folder
            cannot be written.
    """
    probes = chain(
        islice(render_probes(), 0, None, plan.every) if plan.every else (),
        combine_probes(plan.looks),
        islice(record_probes(), 0, None, plan.every) if plan.every else (),
    )
    numbers = []
    for probe in probes:
        tell(f"{probe.area}: {probe.case}")
        numbers.append(measured(probe))
    fits = tuple(fit_rows(tell, plan.hard)) if plan.hard else ()
    random = tuple(random_fits(plan.fits, seed, tell, plan.kinds))
    facts = {"date": date.today().isoformat(), "machine": machine(), "seed": seed}
    stress = Stress(tuple(numbers), fits, random, facts)
    _write(folder, stress)
    return stress


def _write(folder: Path, stress: Stress) -> None:
    for name, rows in (
        ("stress.csv", stress.numbers),
        ("stress_fits.csv", stress.fits),
        ("stress_random.csv", stress.random),
    ):
        write_whole(folder / name, partial(put_rows, rows))
    shown = [asdict(table) for table in tables(stress.numbers, stress.fits, stress.random)]
    facts = stress.about() | {"tables": shown}
    text = json.dumps(facts, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    write_whole(folder / "stress.json", partial(put, text.encode()))
    write_page(folder)
