"""The tables in words, for pages, terminals and the README."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from .._numbers import number
from ..bench._page import Table
from ._fit_row import FitRow
from ._number_row import NumberRow
from ._random_fits import summary

_NUMBERS = (
    "Largest errors, as a share of the largest result; of slopes by the relative change of every "
    "number given, as a share of the largest. Renders: widths of air, against intersections in 50 "
    "digits, with slopes by each number of the scene; in brackets what one rounding of the given "
    "numbers does by itself, which no formula can undo. Combine: a look with a number at an end of "
    "its range (10¹² where it has none), light before white ground if it dims it. Record: tone "
    "curves. A quarter of a code of 8 bits holds; each loss says why."
)
_FITS = (
    "Photos made with a known look. Promised is that no fit calls itself converged and is off by "
    "more than five half-lengths of its 95 % interval, that what has no interval is named, and "
    "that nothing is NaN or infinite. Intervals are for what is held as it is held: where a fit "
    "holds what the photo does not tell, it is made again with that as known, and the row says so. "
    "float32 is a traced fit, in typical sizes from the one in float64."
)
_RANDOM = "Random planets, places, looks, starts and noise; the promise is the same."


def tables(
    numbers: Sequence[NumberRow], fits: Sequence[FitRow], random: Sequence[FitRow]
) -> list[Table]:
    """What the page shows."""
    every = [_number_table(numbers), _fit_table(fits), _random_table(random)]
    return [table for table, rows in zip(every, (numbers, fits, random), strict=True) if rows]


def _number_table(rows: Sequence[NumberRow]) -> Table:
    columns = ("where", "case", "float32", "float64", "OpenGL", "slopes finite", "slopes, float32")
    return Table(
        "Stability of numbers",
        _NUMBERS,
        (*columns, "slopes, float64", "verdict", "why"),
        tuple(_number_cells(row) for row in rows),
        _marked(rows),
    )


def _number_cells(row: NumberRow) -> tuple[str, ...]:
    finite = {None: "", True: "yes", False: "no"}[row.gradient_finite]
    return (
        row.area,
        row.case,
        _beside(row.float32, row.given32),
        _beside(row.float64, row.given64),
        number(row.opengl, 2) if row.opengl is not None else "",
        finite,
        _beside(row.gradient32, row.gradient_given32),
        _beside(row.gradient64, row.gradient_given64),
        row.verdict,
        row.note,
    )


def _beside(error: float | None, given: float | None) -> str:
    return "" if error is None else f"{number(error, 2)} ({number(given, 1)})"


def _fit_table(rows: Sequence[FitRow]) -> Table:
    columns = ("case", "look", "pixels", "verdict", "worst", "intervals off", "error", "float32")
    return Table(
        "Hard fits",
        _FITS,
        (*columns, "not told", "remark"),
        tuple(_fit_cells(row) for row in rows),
        _marked(rows),
    )


def _fit_cells(row: FitRow) -> tuple[str, ...]:
    def told(value: float | None) -> str:
        return "" if value is None else number(value, 2)

    return (
        row.case,
        row.look,
        f"{row.pixels:,}",
        row.verdict,
        row.worst,
        told(row.intervals),
        told(row.error),
        told(row.float32),
        row.untold,
        row.note,
    )


def _random_table(rows: Sequence[FitRow]) -> Table:
    found: dict[str, list[FitRow]] = {"all": list(rows)}
    for row in rows:
        found.setdefault(row.look.partition("+")[0], []).append(row)
    columns = ("look", "fits", "verdicts", "error: 50, 90, 99, 100 %", "intervals off: the same")
    return Table(
        "Random fits",
        _RANDOM,
        (*columns, "over 1 interval", "over 5", "promise broken"),
        tuple(_random_cells(name, part) for name, part in found.items()),
    )


def _random_cells(name: str, rows: Sequence[FitRow]) -> tuple[str, ...]:
    told = summary(rows)

    def quantiles(values: dict[str, float]) -> str:
        return ", ".join(number(value, 2) for value in values.values())

    verdicts = ", ".join(f"{label} {100 * part:.3g} %" for label, part in told["verdicts"].items())
    return (
        name,
        f"{told['count']:,}",
        verdicts,
        quantiles(told["error"]),
        quantiles(told["intervals"]),
        str(told["over 1 interval"]),
        str(told["over 5 intervals"]),
        str(told["broken"]),
    )


def _marked(rows: Sequence[Any]) -> tuple[int, ...]:
    return tuple(k for k, row in enumerate(rows) if not row.kept)


def verdicts(numbers: Sequence[NumberRow]) -> Counter[tuple[str, str]]:
    """How many rows of an area got which verdict."""
    return Counter((row.area, row.verdict) for row in numbers)
