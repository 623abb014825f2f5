"""Errors against 50 digits: the digits are right, and what is lost for no reason is called so."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from fit._compile import float64
from fit.stress._combine_cases import LOOKS, combine_probes, record_probes
from fit.stress._number_row import Cause, NumberRow, Probe, Program, judged, measured
from fit.stress._render_cases import render_probes
from fit.stress._wide import Wide
from model_jax import InputError


def test_fifty_digits_are_those_of_mpmath() -> None:
    """Where float64 has none left."""

    def function(x: jax.Array) -> jax.Array:
        return (1 - jnp.cos(x)) / x**2 + jnp.expm1(x) - x

    x = np.array([1e-9, 1e-3, 2.0])
    with float64():
        found = Wide(function, jnp.asarray(x))(x)
    with mpmath.workdps(50):
        given = [mpmath.mpf(float(v)) for v in x]
        right = [float((1 - mpmath.cos(v)) / v**2 + mpmath.expm1(v) - v) for v in given]
    assert found == pytest.approx(right, rel=1e-15)


def test_slopes_have_as_many() -> None:
    def function(x: jax.Array) -> jax.Array:
        return jnp.sum(jnp.where(x > 1, jnp.sqrt(x), (1 - jnp.cos(x)) / x))

    x = np.array([1e-9, 0.5, 4.0])
    with float64():
        found = Wide(jax.grad(function), jnp.asarray(x))(x)
    # (1 - cos x) / x = x/2 - x³/24 …
    right = [0.5, float(np.sin(0.5) / 0.5 - (1 - np.cos(0.5)) / 0.25), 0.25]
    assert found == pytest.approx(right, rel=1e-14)


def test_what_moves_counts_and_loops_is_followed() -> None:
    def function(x: jax.Array) -> Any:
        def step(total: jax.Array, part: jax.Array) -> tuple[jax.Array, jax.Array]:
            return total + part, total * part

        total, steps = jax.lax.scan(step, jnp.zeros((), x.dtype), x.ravel(), reverse=True)
        picked = jnp.take(x, jnp.argmin(jnp.abs(x - 3), axis=1), axis=0)
        padded = jnp.pad(x.T, ((1, 0), (0, 2)), constant_values=7)
        small = jax.lax.cond(total > 0, lambda: total, lambda: -total)
        return total, steps, picked, padded, small, jnp.stack([x, x[::-1]]) @ jnp.ones((3, 2))

    x = jnp.arange(6.0).reshape(2, 3) - 1
    with float64():
        x = jnp.asarray(x, jnp.float64)
        found, right = Wide(function, x)(x), function(x)
    for one, other in zip(found, right, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-15)


def test_an_operation_that_it_does_not_know_is_named() -> None:
    with float64(), pytest.raises(NotImplementedError, match="sort in numbers of 50 digits"):
        Wide(jnp.sort, jnp.ones(3))(jnp.ones(3))


def probe(function: Any, *given: float, cause: Cause | None = None) -> NumberRow:
    with float64():
        numbers = jnp.asarray(given, jnp.float64)
        return measured(
            Probe("combine", "a case", Program(function, numbers), numbers, cause=cause)
        )


def test_a_loss_that_another_formula_would_not_have_is_found() -> None:
    """1 - cos x of a small x, which is 2 sin²(x/2)."""
    row = probe(lambda x: 1 - jnp.cos(x), 1e-4)
    assert not row.kept
    assert row.verdict == "FAILS"
    assert "for no reason" in row.note
    assert row.float64 is not None
    assert row.float64 < 1e-6
    assert probe(lambda x: 2 * jnp.sin(x / 2) ** 2, 1e-4).verdict == "holds"


def test_a_loss_that_has_a_cause_is_named() -> None:
    """Cosines near 1 have steps of 6e-8, ten times what is left of 1 - cos 1e-4."""
    row = probe(lambda x: 1 - jnp.cos(x), 1e-4, cause=Cause("cosines have steps", 12.0))
    assert row.kept
    assert row.verdict == "float32 loses"
    assert row.note.startswith("float32: cosines have steps")
    small = probe(lambda x: 1 - jnp.cos(x), 1e-4, cause=Cause("cosines have steps", 0.1))
    assert not small.kept


def test_what_is_given_may_be_to_blame() -> None:
    """The difference of two numbers that are nearly the same: exact, of numbers that are not."""
    row = probe(lambda x: x[:1] - x[1:], 1.0 + 3e-7, 1.0)
    assert row.kept
    assert row.verdict == "float32 loses"
    assert row.note == "float32: one rounding of what is given moves the result as far"


def test_infinite_slopes_fail() -> None:
    row = probe(jnp.sqrt, 0.0, 1.0)
    assert row.gradient_finite is False
    assert row.verdict == "FAILS"
    assert row.note == "some number is not finite"


def test_a_kink_excuses_nothing() -> None:
    row = NumberRow(
        "combine",
        "a case",
        float32=0.0,
        float64=0.0,
        given32=0.0,
        given64=0.0,
        gradient_finite=True,
        gradient32=0.5,
        gradient64=0.0,
        gradient_given32=1.0,
    )
    smooth = judged(replace(row, gradient_given64=1e-9))
    kink = judged(replace(row, gradient_given64=1.0))
    assert (smooth.verdict, smooth.kept) == ("float32 loses", True)
    assert (kink.verdict, kink.kept) == ("FAILS", False)


def test_a_refusal_is_a_verdict() -> None:
    def refuse(dtype: str) -> np.ndarray:
        raise InputError("too far; come nearer\nmore")

    with float64():
        program = Program(lambda x: x, jnp.ones(1))
        row = measured(Probe("render", "c", program, jnp.ones(1), plain=refuse))
    assert (row.verdict, row.kept, row.note) == ("refused", True, "too far; come nearer")


def test_every_case_has_a_name_of_its_own() -> None:
    with float64():
        names = [p.case for p in (*render_probes(), *record_probes(), *combine_probes(LOOKS[:2]))]
    assert len(set(names)) == len(names)
    assert len(names) > 60
