"""Work is what it was: operations, draw calls, passes and compiled programs (see `counts`)."""

import json

import jax
import pytest

from . import counts

BEFORE = json.loads(counts.COUNTS.read_text())


@pytest.mark.parametrize("name", counts.CASES)
def test_work_is_what_it_was(name: str) -> None:
    """What JAX itself writes into programs is another release's affair."""
    of_jax = name.startswith(("operations", "programs"))
    if of_jax and jax.__version__ != BEFORE["jax"]:
        pytest.skip(f"counted with JAX {BEFORE['jax']}")
    found = counts.differences(name, counts.CASES[name](), BEFORE[name])
    assert not found, "\n".join(found)


def test_a_photo_of_another_size_compiles_nothing() -> None:
    assert BEFORE["programs"]["first"] > 0
    assert BEFORE["programs"]["again"] == BEFORE["programs"]["another size"] == 0


def test_what_a_look_does_not_need_is_not_there() -> None:
    """`layers` has no loop, and air that thins out asks for more than air that does not."""
    uniform, thin = (BEFORE[f"operations, {look}"]["combine"] for look in ("layers", "air+density"))
    assert uniform["loops"] == 0
    assert uniform["operations"] < thin["operations"]


def test_differences_are_seen() -> None:
    before = {"a": {"passes": 20}}
    assert counts.differences("passes, x", {"a": {"passes": 24}}, before) == []
    assert counts.differences("passes, x", {"a": {"passes": 30}}, before)
    assert counts.differences("operations, x", {"a": {"passes": 21}}, before)
