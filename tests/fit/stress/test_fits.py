"""The promise of `fit`: a broken one is called so, and hard and random fits keep it."""

import functools
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from fit import FitResult, LeftOut, fit
from fit.stress import _fit_cases as hard
from fit.stress._fit_row import MOST_INTERVALS, FitRow, judge_fit, without_result
from fit.stress._made import Made, changed, coded, row_of
from fit.stress._random_fits import random_case, random_fits, summary
from model_jax import InputError

SAMPLE = (
    "shadow in 10 pixels",
    "shadow in 1 pixel",
    "widths proportional",
    "no noise",
    "noise as large as the light",
    "brightness starts at its least, 0",
)
"""Cases of the look `layers`; the page of the stress tests has all."""

LOOKS = ("layers",)
"""Of the random fits, for the time that it takes to compile others."""


@functools.cache
def cases() -> dict[str, Made]:
    """The sample; no other photo is made."""
    groups = (hard._few_dark(), 4), (hard._noises(), 2), (hard._starts(hard.START, hard.TRUTH), 1)
    found: dict[str, Made] = {}
    for group, count in groups:
        found |= {made.case: made for made in islice(group, count)}
    return found


@pytest.fixture(scope="module")
def made() -> Made:
    return cases()["shadow in 10 pixels"]


@pytest.fixture(scope="module")
def result(made: Made) -> FitResult:
    return fit(made.photo, made.layers, made.start, sampling="point")


def test_a_fit_that_keeps_the_promise(made: Made, result: FitResult) -> None:
    row = judge_fit("as it is", "layers", result, made.known, asked=made.asked, layers=made.layers)
    assert row.kept, row.note
    assert row.verdict == "converged"
    assert row.untold == ""
    told = result.parameters[row.worst]
    assert told.interval is not None
    edge = told.interval[made.known[row.worst] > told.value]
    distance = abs(told.value - made.known[row.worst])
    assert row.intervals == pytest.approx(distance / abs(edge - told.value))


@pytest.mark.parametrize(("share", "kept"), [(0.9, True), (1.1, False)])
def test_a_value_far_outside_of_its_interval_breaks_it(
    share: float, kept: bool, made: Made, result: FitResult
) -> None:
    told = result.parameters["brightness"]
    assert told.interval is not None
    away = told.value + share * MOST_INTERVALS * (told.interval[1] - told.value)
    row = judge_fit("moved", "layers", result, made.known | {"brightness": away})
    assert (row.worst, row.kept) == ("brightness", kept)
    assert ("brightness is" in row.note) is not kept
    # A verdict that does not promise values only reports them.
    assert judge_fit("", "", replace(result, verdict="at_bound"), {"brightness": away}).kept


def test_what_is_not_told_has_to_be_named(made: Made, result: FitResult) -> None:
    silent = replace(result.parameters["shadow"], interval=None, stderr=None)

    def judged(role: str, left_out: tuple[LeftOut, ...] = ()) -> FitRow:
        given = result.parameters | {"shadow": replace(silent, role=role)}
        found = replace(result, parameters=given, left_out=left_out)
        return judge_fit("untold", "layers", found, made.known, asked=made.asked)

    for role in ("free", "fixed"):
        row = judged(role)
        assert not row.kept
        assert row.note == "shadow has no interval and is not named"
        assert row.untold == "shadow (not named)"
        assert judged(role, (LeftOut("shadow", "it is dark"),)).untold == "shadow (left out)"
    assert judged("held").untold == "shadow (held)"
    assert judged("at_bound").kept


def test_values_that_are_no_numbers_break_it(made: Made, result: FitResult) -> None:
    estimate = replace(result.parameters["shadow"], value=np.nan)
    given = replace(result, parameters=result.parameters | {"shadow": estimate})
    assert "shadow is nan" in judge_fit("", "layers", given, made.known).note
    lost = replace(result, look=changed(made.start, brightness=1e308, background=1.79e308))
    row = judge_fit("", "layers", lost, made.known, layers=made.layers)
    assert not row.kept
    assert "the picture of the fitted look is not finite" in row.note


def test_a_refusal_keeps_it_and_another_error_does_not() -> None:
    assert without_result("", "layers", InputError("give more")).kept
    row = without_result("", "layers", ZeroDivisionError("by 0"))
    assert (row.verdict, row.kept, row.note) == ("error", False, "ZeroDivisionError: by 0")


@pytest.mark.parametrize("case", SAMPLE)
def test_hard_fits_keep_it(case: str) -> None:
    row = row_of(replace(cases()[case], untraced="for the time that it takes"))
    assert row.kept, row


@pytest.mark.parametrize("level", [0, 255])
def test_without_light_or_range_there_is_no_data(level: int, made: Made) -> None:
    shape = (*np.shape(made.layers.front), 3)
    for photo in (coded(np.full(shape, level, np.uint8)), np.full(shape, level / 255.0)):
        row = row_of(replace(made, photo=photo, untraced="there is nothing to trace"))
        assert (row.verdict, row.kept) == ("no_data", True), row
        assert "brightness (no_data)" in row.untold


@pytest.mark.full
def test_a_traced_fit_in_float32_ends_at_the_same_place(made: Made) -> None:
    row = row_of(made)
    assert row.float32 is not None
    assert row.float32 < 1e-4


def test_random_fits_keep_it() -> None:
    def told(line: str) -> None:
        lines.append(line)

    lines: list[str] = []
    rows = list(random_fits(20, 20261142, told, LOOKS))
    assert [row for row in rows if not row.kept] == []
    assert summary(rows)["count"] == 20
    assert lines == []


def test_a_summary_counts() -> None:
    def rows() -> Iterator[FitRow]:
        good = without_result("", "layers", InputError(""))
        yield good
        for off in (0.5, 2.0, 6.0):
            yield replace(good, verdict="converged", intervals=off, error=off, kept=off < 5)

    found = summary(list(rows()))
    assert found["verdicts"] == {"converged": 0.75, "refused": 0.25}
    assert (found["over 1 interval"], found["over 5 intervals"], found["broken"]) == (2, 1, 1)
    assert found["intervals"]["50 %"] == 2.0
    assert found["error"]["100 %"] == 6.0


def test_what_ended_at_a_bound_and_has_no_effect_tells_nothing_of_others() -> None:
    """A sky whose stretch and tweak end at bounds at which one of them does nothing."""
    row = row_of(random_case(84, 20261129))
    assert row.verdict == "at_bound"
    assert row.kept, row.note
