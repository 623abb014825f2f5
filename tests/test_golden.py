"""Eight fits and four renders have the numbers that they had (see `golden`)."""

import json

import pytest

from . import golden
from .golden import COST, COST_OF_PHOTO

SAMPLED = ("fit paper", "fit two photos", "render relief", "render in the shell")
"""The rest takes a minute: in the full sweep, and by `python -m tests.golden`."""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in SAMPLED else pytest.mark.full) for n in golden.CASES]
)
def test_numbers_are_as_they_were(name: str) -> None:
    check(name, golden.make(name), COST_OF_PHOTO if name == "fit reference" else COST)


@pytest.mark.full
@pytest.mark.usefixtures("data_dir")
@pytest.mark.parametrize("name", golden.PHOTOS)
def test_numbers_of_photos_are_as_they_were(name: str) -> None:
    check(name, golden.make(name), COST_OF_PHOTO)


def check(name: str, made: golden.Document, cost: float) -> None:
    before = json.loads(golden.GOLDEN.read_text())[name]
    found = list(golden.differences(made, before, cost, name))
    assert not found, "\n".join(found)


def test_differences_are_seen() -> None:
    """The net holds: a changed value, cost, word or name does not fall through."""
    estimate = {"value": 3.0, "stderr": 0.1, "interval": [2.8, 3.2], "role": "free"}
    before = {"parameters": {"a": estimate}, "history": [9.0, 5.0], "verdict": "converged"}
    assert not list(golden.differences(before, before, None))
    near = {**before, "history": [9.0, 5.0 * (1 + 1e-11)]}
    near["parameters"] = {"a": {**estimate, "value": 3.00005}}
    assert not list(golden.differences(near, before, COST))
    assert len(list(golden.differences(near, before, None))) == 2
    for changed in (
        {**before, "verdict": "at_bound"},
        {**before, "history": [9.0, 5.0 * (1 + 1e-9)]},
        {**before, "parameters": {"a": {**estimate, "value": 3.0002}}},
        {**before, "parameters": {"a": {**estimate, "interval": [2.8, 3.3]}}},
        {**before, "parameters": {"a": {**estimate, "role": "fixed"}}},
        {**before, "parameters": {"b": estimate}},
        {"parameters": {"a": estimate}, "history": [9.0, 5.0]},
    ):
        assert list(golden.differences(changed, before, COST)), changed
