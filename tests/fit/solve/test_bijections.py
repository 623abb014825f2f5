"""Maps between bounded values and a solver's numbers, tested as a family."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fit.solve._bijections import (
    INSIDE,
    from_shares,
    from_value,
    inside,
    mean_free,
    to_shares,
    to_value,
)

EPS = np.finfo(np.float64).eps

RANGES = {
    "unbounded": (-np.inf, np.inf),
    "positive": (0.0, np.inf),
    "above": (-7.5, np.inf),
    "below": (-np.inf, 2.5),
    "gamma": (0.1, 10.0),
    "narrow": (1.0, 1.0 + 1e-6),
}
"""Every shape of range that a parameter can have."""

SCALES = [1e-8, 1.0, 1e8]

family = pytest.mark.parametrize("limits", RANGES.values(), ids=RANGES)
scaled = pytest.mark.parametrize("scale", SCALES, ids=str)


def one(number: float) -> np.ndarray:
    return np.array([number], np.float64)


def values(u: np.ndarray, limits: tuple[float, float], scale: float) -> np.ndarray:
    lower, upper, size = (np.full(len(u), x) for x in (*limits, scale))
    return np.asarray(to_value(u, lower, upper, size))


def steepness(u: np.ndarray, limits: tuple[float, float], scale: float) -> np.ndarray:
    """The derivative of `to_value`, by hand."""
    low, high = np.isfinite(limits)
    if low and high:
        return (limits[1] - limits[0]) / 2 * (1 + u**2) ** -1.5
    if low or high:
        root = np.hypot(u, 2)
        # (1 ± u/root) / 2, the small one of the two without cancellation
        up = u if low else -u
        return scale * np.where(up >= 0, (1 + up / root) / 2, 2 / (root * (root - up)))
    return np.full(len(u), scale)


@family
@scaled
@settings(max_examples=15, deadline=None)
@given(u=st.floats(-50, 50).map(lambda u: round(u, 12)))
def test_inverse(limits: tuple[float, float], scale: float, u: float) -> None:
    """To the rounding of the value, and of u, by the map's slope."""
    lower, upper, size = one(limits[0]), one(limits[1]), one(scale)
    value = to_value(one(u), lower, upper, size)
    ends = [abs(x) for x in limits if np.isfinite(x)]
    rounding = 4 * EPS * (abs(value[0]) + max(ends, default=0.0))
    slope = steepness(one(u), limits, scale)[0]
    if rounding > 0.1 * slope * max(abs(u), 1):  # the value has no digits left that tell u
        assert limits[0] <= value[0] <= limits[1]
        return
    back = from_value(value, lower, upper, size)[0]
    assert abs(back - u) <= 2 * rounding / slope + 16 * EPS * abs(u)


@family
@scaled
def test_codomain_and_order(limits: tuple[float, float], scale: float) -> None:
    """In the closed range whatever u; strictly inside and strictly increasing around u = 0."""
    far = np.array([-1e290, -1e150, -1e16, -1e3, 0.0, 1e3, 1e16, 1e150, 1e290])
    extreme = values(far, limits, scale)
    assert np.isfinite(extreme).all()
    assert (extreme >= limits[0]).all()
    assert (extreme <= limits[1]).all()
    assert (np.diff(extreme) >= 0).all()
    near = values(np.linspace(-3, 3, 101), limits, scale)
    ends = [abs(x) for x in limits if np.isfinite(x)]
    if max(ends, default=0.0) * EPS < 1e-3 * scale:  # else steps of `scale` are rounded away
        assert (np.diff(near) > 0).all()
        assert (near > limits[0]).all()
        assert (near < limits[1]).all()


@family
@scaled
def test_jacobian(limits: tuple[float, float], scale: float) -> None:
    """JAX's derivative against the hand-made one: to 16 eps, a dozen operations."""
    u = np.array([-1e4, -30.0, -1.0, -1e-9, 0.0, 1e-9, 1.0, 30.0, 1e4])
    with jax.enable_x64(True):

        def value(x: jax.Array) -> jax.Array:
            low, high, size = (jnp.full(1, y) for y in (*limits, scale))
            return to_value(x[None], low, high, size)[0]

        slope = np.array([jax.grad(value)(jnp.asarray(x)) for x in u])
    exact = steepness(u, limits, scale)
    assert (np.abs(slope - exact) <= 16 * EPS * exact).all()
    assert (slope > 0).all()


@family
def test_jacobian_by_differences(limits: tuple[float, float]) -> None:
    """The hand-made derivative is no twin mistake: central differences of step 1e-4.

    Their error is 1e-8 of the third derivative, at most 10 slopes here, and eps·|value| / 1e-4.
    """
    u, step = np.linspace(-2, 2, 21), 1e-4
    slope = (values(u + step, limits, 1.0) - values(u - step, limits, 1.0)) / (2 * step)
    rounding = EPS * max(abs(x) for x in (*limits, 3.0) if np.isfinite(x)) / step
    exact = steepness(u, limits, 1.0)
    assert (np.abs(slope - exact) <= 1e-7 * exact + 4 * rounding).all()


@pytest.mark.parametrize("limits", [RANGES[n] for n in ("positive", "above", "below")], ids=str)
def test_straight_far_from_a_bound(limits: tuple[float, float]) -> None:
    """One bound only: from ten typical sizes on, slope `scale` to 1 %, so linear stays linear."""
    u = 10.0 if np.isfinite(limits[0]) else -10.0
    step = values(one(u) + 0.5, limits, 1.0) - values(one(u) - 0.5, limits, 1.0)
    assert step[0] == pytest.approx(1.0, rel=0.01)


@family
def test_reverse_mode_is_finite_far_out(limits: tuple[float, float]) -> None:
    """Where a root and u differ by less than rounding the branch not taken must not spoil it."""
    with jax.enable_x64(True):
        low, high, size = (jnp.full(3, x) for x in (*limits, 1.0))
        u = jnp.array([-1e12, 0.0, 1e12])
        slope = jax.grad(lambda x: to_value(x, low, high, size).sum())(u)
    assert np.isfinite(slope).all()
    assert slope[1] == pytest.approx(steepness(one(0.0), limits, 1.0)[0])


@family
def test_nan_goes_through(limits: tuple[float, float]) -> None:
    lower, upper, size = one(limits[0]), one(limits[1]), one(1.0)
    assert np.isnan(to_value(one(np.nan), lower, upper, size)).all()
    assert np.isnan(from_value(one(np.nan), lower, upper, size)).all()
    basis = mean_free([True, True, True])
    assert np.isnan(to_shares(np.array([np.nan, 0.0]), basis, 3.0)).all()
    assert np.isnan(from_shares(np.array([1.0, np.nan, 1.0]), basis)).all()


@family
def test_outside_has_no_inverse(limits: tuple[float, float]) -> None:
    lower, upper, size = one(limits[0]), one(limits[1]), one(1.0)
    for bound, sign in zip(limits, (-1, 1), strict=True):
        if np.isfinite(bound):
            assert np.isnan(from_value(one(bound), lower, upper, size)).all()
            assert np.isnan(from_value(one(bound + sign), lower, upper, size)).all()


@family
@scaled
@pytest.mark.parametrize("value", [-1e9, -7.5, 0.0, 0.1, 1.0, 2.5, 10.0, 1e9], ids=str)
def test_inside(limits: tuple[float, float], scale: float, value: float) -> None:
    """What lies on or beyond a bound comes to a point from which a solver can start."""
    lower, upper, size = one(limits[0]), one(limits[1]), one(scale)
    moved = inside(one(value), lower, upper, size)
    assert limits[0] <= moved[0] <= limits[1]
    room = INSIDE * min(scale, limits[1] - limits[0])
    if limits[0] + room <= value <= limits[1] - room:
        assert moved[0] == value
    ends = [abs(x) for x in limits if np.isfinite(x)]
    if room > 4 * EPS * max(ends, default=0.0):
        assert np.isfinite(from_value(moved, lower, upper, size)).all()


MEMBERS = [(True, True, True), (True, False, True), (False, True, True)]


@pytest.mark.parametrize("members", MEMBERS, ids=str)
@settings(max_examples=25, deadline=None)
@given(u=st.tuples(st.floats(-20, 20), st.floats(-20, 20)), total=st.floats(1e-8, 1e8))
def test_tints(members: tuple[bool, ...], u: tuple[float, float], total: float) -> None:
    """Positive, of the right sum, and back: logs of up to 40 lose that many eps."""
    basis = mean_free(members)
    step = np.array(u[: basis.shape[1]])
    tints = to_shares(step, basis, total)
    assert (tints[list(members)] > 0).all()
    assert tints[list(members)].sum() == pytest.approx(total, rel=8 * EPS)
    np.testing.assert_allclose(from_shares(np.asarray(tints), basis), step, atol=200 * EPS)


@pytest.mark.parametrize("u", [1e3, -1e3, 1e5, -1e300], ids=str)
def test_extreme_tints(u: float) -> None:
    tints = to_shares(np.array([u, 0.0]), mean_free([True, True, True]), 3.0)
    assert np.isfinite(tints).all()
    assert (tints >= 0).all()
    assert tints.sum() == pytest.approx(3.0, rel=8 * EPS)


def test_tints_jacobian_against_differences() -> None:
    """Reverse mode, and central differences of step 1e-5: 1e-10 of their third derivatives."""
    basis, u, step = mean_free([True, True, True]), np.array([0.3, -0.7]), 1e-5
    with jax.enable_x64(True):
        exact = jax.jacrev(lambda x: to_shares(x, jnp.asarray(basis), 3.0))(jnp.asarray(u))
    for k, unit in enumerate(np.eye(2)):
        moved = [to_shares(u + sign * step * unit, basis, 3.0) for sign in (1, -1)]
        slope = (moved[0] - moved[1]) / (2 * step)
        np.testing.assert_allclose(exact[:, k], slope, atol=1e-9)
    np.testing.assert_allclose(np.asarray(exact).sum(axis=0), 0, atol=8 * EPS)
    assert np.abs(exact).min() > 1e-3


@pytest.mark.parametrize("members", [*MEMBERS, (True, False, False), (False,) * 3], ids=str)
def test_mean_free_is_orthonormal(members: tuple[bool, ...]) -> None:
    basis = mean_free(members)
    assert basis.shape == (3, max(sum(members) - 1, 0))
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=4 * EPS)
    np.testing.assert_allclose(basis.sum(axis=0), 0, atol=4 * EPS)
    assert (basis[~np.array(members)] == 0).all()
