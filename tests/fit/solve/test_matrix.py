"""The matrix of fits: solver × problem × units × start × dtype, and no verdict that is wrong.

Each fit is judged by a model of its own, in NumPy and float64 on all pixels, whose optimum SciPy
finds from several starts. `python -m tests.fit.solve.test_matrix` runs the whole matrix and lists
every verdict; words after it choose the rows that hold them all (`"gamma" " lm "`).
"""

import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from fit import Verdict, fit
from fit._choices import SOLVERS
from tests.fit.solve.problems import CASES, Dense, Fit, photo_of, start_of

SCALES = (1e-8, 1.0, 1e8)
"""Of the photo's light, and of the length unit; brightness goes as their ratio."""

STARTS = ("near", "far", "bound")
DTYPES = ("float32", "float64")


@dataclass(frozen=True)
class Outcome:
    """What a fit said, beside what is true."""

    fit: Fit
    verdict: str
    excess: float
    """(cost - what is allowed) / what is allowed, which is the oracle's cost and rounding."""
    widening: float
    """Median over parameters of half its 95 % interval by 1.96 of the oracle's standard errors; NaN
    without."""
    seconds: float

    @property
    def is_wrong(self) -> bool:
        return self.verdict == "converged" and not self.excess <= 1e-6

    def __str__(self) -> str:
        flag = "  WRONG" if self.is_wrong else ""
        return (
            f"{self.fit!s:<62} {self.verdict:<17} {self.excess:+9.1e} {self.widening:6.2f}"
            f" {self.seconds:6.2f} s{flag}"
        )


def run(place: Fit) -> Outcome:
    """One fit, judged."""
    layers, photo = photo_of(place.case, place.light, place.length, place.dtype)
    look, response = start_of(place)
    begin = perf_counter()
    result = fit(
        photo,
        layers,
        look,
        free=place.case.free,
        response=response,
        loss=place.case.loss,
        sampling="point",
        solver=place.solver,
    )
    seconds = perf_counter() - begin
    dense = Dense(place, layers, photo, result)
    x = dense.to_normal(result)
    best = dense.optimum()
    allowed = dense.cost(best) + dense.rounding
    widening = float("nan")
    intervals = [result.parameters[name].interval for name in dense.names]
    if place.case.noise and None not in intervals:  # where all is rounding there is no noise
        low, high = np.array(intervals, float).T
        oracle = 2 * 1.96 * dense.stderr(best) * dense.units
        widening = float(np.median((high - low) / oracle))
    return Outcome(place, result.verdict, dense.cost(x) / allowed - 1, widening, round(seconds, 3))


def whole() -> Iterator[Fit]:
    """Every combination."""
    places = product(CASES, SOLVERS, SCALES, SCALES, STARTS, DTYPES)
    return (Fit(*place) for place in places)


def sample() -> list[Fit]:
    """Each start of each loss by the default solver, and each other solver once.

    Units are a seeded draw. Each solver is compiled anew for each loss, gamma and dtype, which
    takes seconds: the other solvers are tried on linear light, in one dtype.
    """
    rng = np.random.default_rng(20261123)
    chosen = []
    for case, (k, solver), start in product(CASES, enumerate(SOLVERS), STARTS):
        light, length = rng.choice(SCALES, 2)
        if solver != "lm" and (case.name, start) != ("linear", STARTS[k % 3]):
            continue
        both = case.name == "linear" and solver == "lm"
        for dtype in DTYPES if both else (DTYPES[k % 2],):
            chosen.append(Fit(case, solver, float(light), float(length), start, dtype))
    return chosen


def table(outcomes: Sequence[Outcome]) -> str:
    """Verdicts by case and solver."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for outcome in outcomes:
        row = outcome.fit.case.name, outcome.fit.solver
        verdict = "WRONG" if outcome.is_wrong else outcome.verdict
        counts.setdefault(row, Counter())[verdict] += 1
    lines = [
        f"{case:<8} {solver:<13} " + ", ".join(f"{n} {verdict}" for verdict, n in count.items())
        for (case, solver), count in counts.items()
    ]
    return "\n".join(lines)


@pytest.fixture(scope="module", params=["sample", pytest.param("whole", marks=pytest.mark.full)])
def places(request: pytest.FixtureRequest) -> list[Fit]:
    return sample() if request.param == "sample" else list(whole())


@pytest.fixture(scope="module")
def listing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file in which all verdicts are listed."""
    return tmp_path_factory.mktemp("matrix") / "verdicts.txt"


@pytest.fixture(scope="module")
def outcomes(places: list[Fit], listing: Path) -> list[Outcome]:
    """All verdicts, which are also listed in a file and, when a test fails, in its output."""
    found = [run(place) for place in places]
    listing.write_text("\n".join(map(str, found)))
    print(listing.read_text(), table(found), sep="\n")
    return found


def test_the_matrix_is_whole() -> None:
    """And its sample has each case, solver, start, unit and dtype at least once."""
    everything, some = [str(place) for place in whole()], sample()
    assert len(everything) == len(set(everything)) == 5 * 3 * 3 * 3 * 3 * 2
    assert {str(place) for place in some} <= set(everything)
    assert {place.case for place in some} == set(CASES)
    assert {place.solver for place in some} == set(SOLVERS)
    assert {place.light for place in some} == {place.length for place in some} == set(SCALES)
    assert {(place.start, place.dtype) for place in some} == set(product(STARTS, DTYPES))


def test_every_verdict_is_listed(places: list[Fit], outcomes: list[Outcome], listing: Path) -> None:
    """One row for each combination, in the words that the command line chooses rows by."""
    rows = [line.split("  ")[0] for line in listing.read_text().splitlines()]
    assert rows == [str(place) for place in places]
    assert len(set(rows)) == len(rows)
    verdicts = {verdict.label for verdict in Verdict}
    assert all(outcome.verdict in verdicts for outcome in outcomes)
    summed = table(outcomes).splitlines()
    assert len(summed) == len({(place.case, place.solver) for place in places})
    assert sum(int(n) for line in summed for n in re.findall(r" (\d+) ", line)) == len(rows)


def test_no_verdict_is_wrong(outcomes: list[Outcome]) -> None:
    """`converged` means the cost is the oracle's, to 1e-6 and n roundings of the brightest."""
    wrong = [str(outcome) for outcome in outcomes if outcome.is_wrong]
    assert not wrong, "\n".join(wrong)


def test_caution_hides_nothing(outcomes: list[Outcome]) -> None:
    """The photo tells all that is asked here: 99 % converge, with errors not blown up.

    The widening is of a sandwich over blocks, for white noise: 1 in the mean, but for Student's t.
    """
    for solver in SOLVERS:
        mine = [outcome for outcome in outcomes if outcome.fit.solver == solver]
        missed = [str(outcome) for outcome in mine if outcome.verdict != "converged"]
        assert len(missed) <= 0.01 * len(mine), "\n".join(missed)
        widening = np.nanmedian([outcome.widening for outcome in mine])
        assert 1 / 1.5 <= widening <= 1.5, solver


if __name__ == "__main__":
    made: list[Outcome] = []
    for place in whole():
        if len(sys.argv) > 1 and not all(word in str(place) for word in sys.argv[1:]):
            continue
        made.append(run(place))
        print(made[-1], flush=True)
    print(table(made))
