"""Columns of exponential air against adaptive integration with 30 digits; slopes; limits."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from model_jax._column import (
    REACH,
    STEEPEST,
    below,
    column,
    columns,
    mean_transmittance,
    pieces,
)

TOLERANCE = 1e-4
"""Cut off at `REACH` is exp(-10) = 4.5e-5 of a steep ray's column; six nodes add 2e-5."""

HEIGHTS = [1e-4, 1e-3, 1e-2, 0.1, 1.0]
"""Scale heights, planet radii."""


def exact(
    begin: float, end: float, impact: float, height: float, altitude: float | None = None
) -> float:
    """∫ exp(-(r - R)/H) ds by adaptive quadrature, cut where the integrand bends; R = 1, or
    `impact - altitude`."""
    with mpmath.workdps(30):
        b, h = mpmath.mpf(impact), mpmath.mpf(height)
        radius = 1 if altitude is None else b - mpmath.mpf(altitude)

        def density(s: Any) -> Any:
            return mpmath.exp(-(mpmath.sqrt(b * b + s * s) - radius) / h)

        near = min(max(0.0, begin), end)  # of the ray, where the air is densest
        r = float(np.hypot(impact, near))
        # Over so many lengths from there the density falls by e, along the slope or along the bow.
        step = min(height * r / max(near, 1e-30), float(np.sqrt(2 * height * max(r, height))))
        cuts = [near + side * step * 2.0**k for k in range(-2, 9) for side in (-1, 1)]
        inside = sorted({c for c in [begin, near, end, *cuts] if begin <= c <= end})
        return float(mpmath.quad(density, inside)) if len(inside) > 1 else 0.0


def rays(seed: int, count: int, height: float) -> list[tuple[float, float, float]]:
    """(begin, end, impact), planet radii: along the shell, steep, into the ground, from inside,
    through the centre."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        top = 1 + height * 10 ** rng.uniform(-0.5, 1.3)
        impact = 1 + (top - 1) * rng.uniform() if k % 3 == 0 else (k > 1) * rng.uniform()
        half, ground = np.sqrt(top**2 - impact**2), np.sqrt(max(1 - impact**2, 0.0))
        begin, end = (-half, half) if impact >= 1 else (-half, -ground)
        if k % 2:  # a camera in the air
            begin += rng.uniform() * (end - begin)
        found.append((begin, end, impact))
    return found


@pytest.mark.parametrize("height", HEIGHTS)
def test_columns_are_those_of_adaptive_integration(height: float, dtype: np.dtype) -> None:
    """float32 adds what rounding does to heights above the ground: half an ulp of the radius for
    each of root, sum, quotient, product and difference would be 3e-3 at 1e-4 radii, if all went one
    way; what is promised is 1e-3."""
    chosen = rays(7, 24, height)
    begin, end, impact = (np.array(part)[:, None] for part in zip(*chosen, strict=True))
    given = [np.asarray(p, dtype) for p in (begin, end, impact - 1, impact)]
    h = np.full((1, 1), height, dtype)
    lit, dark = columns((given[0], given[1]), None, given[2], given[3], h)
    assert lit.dtype == dtype
    assert not np.any(dark)
    true = [exact(*ray, height) for ray in chosen]
    tolerance = TOLERANCE if dtype == np.float64 else 1e-3
    # Of what was given: a grazing ray's √(top² - b²) is another in float32.
    ends = zip(*(part[:, 0].tolist() for part in given), strict=True)
    told = [exact(begin, end, b, float(h[0, 0]), low) for begin, end, low, b in ends]
    np.testing.assert_allclose(lit[:, 0], told, rtol=tolerance)
    if dtype == np.float64:
        np.testing.assert_allclose(lit[:, 0], true, rtol=tolerance)


@pytest.mark.parametrize("height", [1e-3, 0.05])
@pytest.mark.usefixtures("x64")
def test_lit_and_dark_are_cut_where_the_shadow_is(height: float) -> None:
    rng = np.random.default_rng(3)
    chosen = rays(11, 18, height)
    expected, given = [], []
    for begin, end, impact in chosen:
        first, last = np.sort(rng.uniform(begin, end, 2))
        dark = exact(first, last, impact, height)
        lit = exact(begin, first, impact, height) + exact(last, end, impact, height)
        expected.append((lit, dark))
        given.append((begin, end, first, last, impact))
    a, b, first, last, impact = np.array(given).T
    found = columns((a, b), (first, last), impact - 1, impact, np.full(a.shape, height))
    np.testing.assert_allclose(np.transpose(found), expected, rtol=TOLERANCE)


@pytest.mark.usefixtures("x64")
def test_pieces_make_up_the_ray() -> None:
    rng = np.random.default_rng(5)
    begin, first, last, end = np.sort(rng.normal(size=(4, 200)), axis=0)
    parts = pieces((begin, end), (first, last))
    assert all(np.all(far >= near) for near, far, *_ in parts)
    dark = sum((far - near) * shade for near, far, shade, _ in parts)
    whole = sum(far - near for near, far, *_ in parts)
    middle = np.clip(0, begin, end)
    before = sum((far - near) * early for near, far, _, early in parts)
    np.testing.assert_allclose(before, middle - begin, atol=1e-14)
    np.testing.assert_allclose(dark, last - first, atol=1e-14)
    np.testing.assert_allclose(whole, end - begin, atol=1e-14)
    # Each on one side of the nearest point: from -1 to 1 is two pieces of 1, none of 0.
    (left, right) = pieces((np.array(-1.0), np.array(1.0)), None)
    assert float(left[1] - left[0]) == float(right[1] - right[0]) == 1.0


def _total(height: Any, near: Any, far: Any, impact: Any) -> Any:
    return columns((near, far), None, impact - 1, impact, height)[0].sum()


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("ray", [(0.02, -0.3, 0.25, 1.01), (0.004, -0.6, -0.1, 0.95)])
def test_slopes_are_those_of_differences(ray: tuple[float, ...]) -> None:
    """Slopes are taken under the integral, and nodes and cut make an error of 1e-4 in it as in the
    column; in what the ends do, of a density there."""
    args = [jnp.array([x]) for x in ray]
    for k in range(4):
        for mode in (jax.jacfwd, jax.jacrev):
            slope = float(mode(_total, argnums=k)(*args)[0])
            up, down = ([a + (i == k) * e for i, a in enumerate(args)] for e in (1e-6, -1e-6))
            difference = float(_total(*up) - _total(*down)) / 2e-6
            assert slope == pytest.approx(difference, rel=2e-4)


@pytest.mark.usefixtures("x64")
def test_second_slopes_exist() -> None:
    args = [jnp.array([x]) for x in (0.02, -0.3, 0.25, 1.01)]
    curved = jax.hessian(lambda h: _total(h, *args[1:]))(args[0])
    up, down = (jax.grad(lambda h: _total(h, *args[1:]))(args[0] + e) for e in (1e-5, -1e-5))
    assert float(curved[0, 0]) == pytest.approx(float((up - down)[0]) / 2e-5, rel=1e-5)


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_no_slope_is_missing_where_things_meet(mode: Callable, dtype: np.dtype) -> None:
    """Through the centre, of no length, at the nearest point, in a film, in air without end, and
    in a valley a hundred scale heights deep."""
    nothing, far = 0.0, 1e3
    rows = [
        (-1.1, 1.1, 0.0, 0.1),
        (-1.1, -1.0, 0.0, 0.1),
        (nothing, nothing, 1.0, 0.1),
        (nothing, nothing, 0.0, 0.1),
        (nothing, 0.3, 1.0, 0.0),
        (-0.3, 0.3, 1.0, 1e6),
        (-0.3, 0.3, 0.9, 1e-3),
        (-far, far, 1.0, 1e-4),
    ]
    slopes = [jax.jit(mode(_total, argnums=k)) for k in range(4)]
    for begin, end, impact, height in rows:
        args = [jnp.array([x], dtype) for x in (height, begin, end, impact)]
        assert np.isfinite(_total(*args))
        for k in range(4):
            assert np.isfinite(slopes[k](*args)).all(), (begin, end, impact, height)


@pytest.mark.usefixtures("x64")
def test_air_of_great_scale_height_is_uniform() -> None:
    begin, end, impact = np.array([-0.3]), np.array([0.4]), np.array([1.01])
    lit, _ = columns((begin, end), None, impact - 1, impact, np.array([1e5]))
    assert float(lit[0]) == pytest.approx(0.7, rel=1e-6)


@pytest.mark.usefixtures("x64")
def test_thin_films_go_by_the_formula_of_the_flat_ground() -> None:
    """H → 0: along the ground √(πRH/2) a side, straight up H; to first order in H."""
    for height in (1e-4, 1e-5, 1e-6):
        one = np.array([1.0])
        up = column(one, 2 * one, -one, 0 * one, height * one)
        along = column(0 * one, one, 0 * one, one, height * one)
        assert float(up[0]) == pytest.approx(height, rel=TOLERANCE + 3 * height)
        expected = np.sqrt(np.pi * height / 2)
        assert float(along[0]) == pytest.approx(expected, rel=TOLERANCE + height)
    below = column(0 * one, one, 0 * one, one, 0.0 * one)
    np.testing.assert_array_equal(below, column(0 * one, one, 0 * one, one, STEEPEST * 2 * one))


def test_reach_is_where_the_column_ends() -> None:
    assert np.exp(-REACH) < TOLERANCE / 2


def test_mean_transmittance(dtype: np.dtype) -> None:
    """Ten terms of a series below 0.5, of which the next is 0.5¹⁰/11! = 2.4e-11 (of 0.79); above it
    1 - exp, which loses two bits."""
    depth = np.concatenate([[0.0], np.geomspace(1e-30, 1e30, 301), [0.5, np.nextafter(0.5, 0)]])
    depth = depth.astype(dtype)
    true = [float(-mpmath.expm1(-mpmath.mpf(float(d))) / float(d)) if d else 1.0 for d in depth]
    found = jax.jit(mean_transmittance)(depth)
    np.testing.assert_allclose(found, true, rtol=3.2e-11 + 4 * np.finfo(dtype).eps)
    slopes = jax.vmap(jax.grad(mean_transmittance))(depth)
    assert np.isfinite(slopes).all()
    assert float(slopes[0]) == -0.5


@pytest.mark.usefixtures("x64")
def test_a_top_cuts_a_ray_at_half_its_chord() -> None:
    altitude = np.array([-1.0, 0.0, 0.5, 1.0, 2.0])
    far = np.full(5, 9.0)
    (begin, found), _ = below(np.array(1.0), (-far, far), None, altitude, altitude + 1)
    expected = np.sqrt(np.maximum(4 - (altitude + 1) ** 2, 0))
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    np.testing.assert_array_equal(begin, -found)
