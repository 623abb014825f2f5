"""Sunlight through exponential air against adaptive integration and marches; slopes; limits."""

import itertools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import special
from scipy.integrate import quad

from model_jax._phase import henyey_greenstein, rayleigh
from model_jax._sun_column import scaled_tail, sun_column
from model_jax._sunlight import sunlight_met

HEIGHTS = [1e-3, 1e-2, 0.05, 1.0]
"""Scale heights, planet radii."""


def test_the_tail_is_scipys(dtype: np.dtype) -> None:
    """2.1e-5 as fitted; float32 adds six sums and products of half an ulp each, on either side."""
    t = np.concatenate([[0.0], np.geomspace(1e-6, 1e6, 500)]).astype(dtype)
    exact = np.sqrt(np.pi) / 2 * special.erfcx(t.astype(np.float64))
    tolerance = 2.2e-5 + 12 * float(np.finfo(dtype).eps)
    np.testing.assert_allclose(scaled_tail(jnp.asarray(t)), exact, rtol=tolerance)


def to_sun(height: float, elevation: float, scale: float, top: float) -> float:
    """∫ exp(-h/H) dl from a height to the top, by adaptive quadrature; the radius is 1."""
    r = 1 + height
    along, lowest = r * np.sin(elevation), r * np.cos(elevation)
    end = np.sqrt((1 + top) ** 2 - lowest**2)

    def density(way: float) -> float:
        return float(np.exp(-(np.hypot(lowest, way) - 1) / scale))

    cuts = sorted({c for c in (along, 0.0, -along, end) if along <= c <= end})
    parts = itertools.pairwise(cuts)
    return float(sum(quad(density, a, b, epsrel=1e-10, limit=400)[0] for a, b in parts))


def points(scale: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Heights and the sun's elevations, down to where the ground hides it; and the air's top."""
    rng, top = np.random.default_rng(3), float(scale * 10)
    height = top * rng.uniform(0, 1, 60) ** 2
    dip = -np.arccos(1 / (1 + height))
    elevation = np.where(
        np.arange(60) % 2, rng.uniform(dip, np.pi / 2), np.maximum(rng.normal(0, 0.1, 60), dip)
    )
    return height, elevation, top


@pytest.mark.parametrize("scale", HEIGHTS)
def test_what_passes_is_that_of_adaptive_integration(scale: float, dtype: np.dtype) -> None:
    """At every optical depth: the promised 1e-3 of light, and 0.5 % of air as high as its planet.
    float32 heights are rounded to 1e-7 radii, which counts in scale heights, at most 0.37 of it."""
    height, elevation, top = points(scale)
    r = 1 + height
    given = [r * np.sin(elevation), r, height, np.exp(-height / scale), np.full(60, top)]
    sunward, distance, low, density, end, each = (
        np.asarray(part, dtype) for part in (*given, np.full(60, scale))
    )
    column = np.asarray(sun_column(sunward, distance, low, density, end, each), np.float64)
    exact = np.array([to_sun(h, e, scale, top) for h, e in zip(height, elevation, strict=True)])
    tolerance = 1e-3 if scale <= 1 / 20 else 5e-3
    if dtype == np.float32:
        tolerance += 4e-7 / scale
    for vertical in (0.01, 0.3, 3.0, 100.0):
        passed = np.exp(-vertical / scale * np.stack([column, exact]))
        np.testing.assert_allclose(passed[0], passed[1], atol=tolerance)


@pytest.mark.usefixtures("x64")
def test_uniform_air_is_crossed_along_its_chord() -> None:
    """Of air that thins out a thousand times its height the column is the length."""
    height, elevation, top = points(1e-2)
    r, far = 1 + height, np.full(60, 1000 * top)
    column = sun_column(r * np.sin(elevation), r, height, np.exp(-height / far), top + 0 * r, far)
    chord = np.sqrt((1 + top) ** 2 - (r * np.cos(elevation)) ** 2) - r * np.sin(elevation)
    np.testing.assert_allclose(column, chord, rtol=2e-3)


Ray = tuple[float, ...]


def rays(scale: float, count: int) -> list[Ray]:
    """(impact, begin, end, sunward, cosine, depth): rays past the limb and into the ground, half of
    them beside the terminator; optical depths of the longest way from 0.1 to 40."""
    rng, top = np.random.default_rng(0), 12 * scale
    found: list[Ray] = []
    for k in range(count):
        if k % 5 < 2:
            impact = rng.uniform(0.3, 1) if k % 5 else 1 - 2 * scale * rng.uniform()
            ends = -np.sqrt((1 + top) ** 2 - impact**2), -np.sqrt(1 - impact**2)
        else:
            impact = 1 + rng.uniform(0, 6) * scale
            half = np.sqrt((1 + top) ** 2 - impact**2)
            ends = -half, half
        cosine = rng.uniform(-1, 1)
        most = np.sqrt(1 - cosine**2)
        sine = rng.uniform(-most, most) if k % 2 else np.clip(rng.normal(0, 0.1), -most, most)
        depth = 10 ** rng.uniform(-1, 1.6)
        extinction = depth / np.sqrt(2 * np.pi * scale)
        found.append((impact, *map(float, ends), impact * sine, cosine, extinction))
    return found


def marched(ray: Ray, scale: float, dims: bool) -> tuple[np.ndarray, tuple[float, float]]:
    """Sunlit, shaded and upward light of a ray and its light if all of it sent 1, in 3,000 steps;
    and where the shadow is."""
    impact, begin, end, sunward, cosine, extinction = ray
    step = (end - begin) / 3000
    s = begin + step * (np.arange(3000) + 0.5)
    r = np.hypot(impact, s)
    height, sun = r - 1, sunward + s * cosine
    lit = ~((sun < 0) & (r * r - sun * sun < 1))
    density = np.exp(-height / scale)
    to = np.zeros(3000)
    # By a table over the sun's ray: the column from each point, in 400 steps a ray.
    lowest = np.sqrt(np.maximum(r * r - sun * sun, 0))
    far = np.sqrt(np.maximum((1 + 12 * scale) ** 2 - lowest**2, 0))
    share = (np.arange(400) + 0.5) / 400
    for part in range(0, 3000, 500):
        p = np.s_[part : part + 500, None]
        # Steps in t with l = t |t|, dense where the ray is lowest.
        a, b = (np.sign(x) * np.sqrt(np.abs(x)) for x in (sun[p], far[p]))
        t = a + (b - a) * share
        weight = 2 * np.abs(t) * (b - a) / 400
        heights = np.hypot(lowest[p], t * np.abs(t)) - 1
        to[part : part + 500] = (weight * np.exp(-np.maximum(heights, -9) / scale)).sum(1)
    deep = extinction * (np.cumsum(density) - density / 2) * step if dims else 0
    sent = density * step * np.exp(-deep)
    passed = np.exp(-extinction * np.minimum(to, 1e6))
    shadow = s[~lit]
    edges = (shadow[0] - step / 2, shadow[-1] + step / 2) if len(shadow) else (begin, begin)
    edges = (begin if edges[0] < begin + step else edges[0], edges[1])
    light = [sent @ (lit * passed), sent @ ~lit, sent @ np.maximum(sun / r, 0), sent.sum()]
    return np.array(light), edges


@pytest.mark.parametrize("scale", [1 / 800, 1 / 50])
@pytest.mark.parametrize("dims", [False, True])
@pytest.mark.usefixtures("x64")
def test_light_is_that_of_marched_rays(scale: float, dims: bool) -> None:
    """Shares of the light without the sun's way, to 1 %: eight nodes in air of optical depths to
    40, of which 0.4 % were seen; and an edge of shadow falls into a step, 1/3000 of the way, 4e-3
    of the lowest ray's light."""
    chosen = rays(scale, 100)
    marches = [marched(ray, scale, dims) for ray in chosen]
    impact, begin, end, sunward, cosine, extinction = np.array(chosen).T[..., None]
    dark = np.array([edges for _, edges in marches]).T[..., None]
    one = np.ones((1, 1))
    met = sunlight_met(
        (begin, end), (dark[0], dark[1]), impact - 1, impact, scale * one, sunward, cosine,
        12 * scale * one, extinction * np.ones((1, 3)), dims=dims,
    )  # fmt: skip
    light = np.array([part for part, _ in marches])
    for k, found in enumerate((met.sunlit, met.shaded, met.upward)):
        np.testing.assert_allclose(
            np.asarray(found)[:, 0],
            light[:, k] / light[:, 3],
            atol=1e-2,
            err_msg=met._fields[k + 1],
        )
    if not dims:
        np.testing.assert_allclose(met.column[:, 0], light[:, 3], rtol=1e-3)


STIFF: dict[str, dict[str, float]] = {
    "a film": {"scale_height": 1e-9},
    "uniform": {"scale_height": 1e6},
    "clear": {"extinction": 0.0},
    "opaque": {"extinction": 1e12},
    "no ray": {"begin": 0.0, "end": 0.0, "impact": 0.0, "altitude": 0.0, "sunward": 0.0},
    "through the centre": {"impact": 0.0, "altitude": -1.0, "sunward": 0.0, "end": -1.0},
    "along the sun": {"sun_cos": 1.0, "sunward": 0.0},
    "from the sun": {"sun_cos": -1.0, "sunward": 0.0},
    "the sun below": {"sunward": -1.001, "sun_cos": 0.0},
    "nothing above": {"shell": 0.0},
    "cut off below": {"top": 0.0},
}


@pytest.mark.parametrize("dims", [False, True])
def test_light_and_slopes_are_numbers_at_every_end(dims: bool, dtype: np.dtype) -> None:
    """By every argument at once, in reverse; by three, as fits ask, forwards; and these twice, as
    intervals ask in float64 (e^60 of the air in the centre squared is none in float32)."""
    usual = {
        "begin": -0.1, "end": 0.1, "altitude": 0.001, "impact": 1.001, "scale_height": 0.01,
        "sunward": 0.2, "sun_cos": 0.3, "shell": 0.02, "top": 0.018, "extinction": 3.0,
    }  # fmt: skip
    rows = [usual | changed for changed in STIFF.values()]
    args = {name: jnp.array([[row[name]] for row in rows], dtype) for name in usual}
    args["extinction"] = args["extinction"] * jnp.ones((1, 3), dtype)

    def light(some: dict[str, Any]) -> Any:
        every = args | some
        air = every.pop("begin"), every.pop("end")
        met = sunlight_met(air, (0.5 * air[0], 0.2 * air[1]), **every, dims=dims)
        return sum(part.sum(axis=1) for part in met)

    def along(of: Any) -> Any:
        few = {name: args[name] for name in ("scale_height", "extinction", "top")}
        return lambda some: jax.jvp(of, (few | some,), (jax.tree.map(jnp.ones_like, few),))[1]

    by_all = jax.grad(lambda some: light(some).sum())(args)
    found = {"light": light({}), "along few": along(light)({})}
    found |= {f"by {name}": slope.sum(axis=1) for name, slope in by_all.items()}
    if dtype == np.float64:
        found["twice along few"] = along(along(light))({})
    for what, values in found.items():
        bad = [case for case, value in zip(STIFF, values, strict=True) if not np.isfinite(value)]
        assert not bad, (what, bad)


@pytest.mark.parametrize("dims", [False, True])
@pytest.mark.usefixtures("x64")
def test_slopes_by_few_and_by_many_are_those_of_differences(dims: bool) -> None:
    scale, ext = jnp.full((1, 1), 0.01), jnp.array([[1.0, 3.0, 30.0]])
    one = np.ones((1, 1))

    def light(scale: Any, ext: Any, top: Any, sunward: Any, cosine: Any) -> Any:
        met = sunlight_met(
            (-0.2 * one, 0.2 * one), (-0.05 * one, 0.03 * one), 0.003 * one, 1.003 * one, scale,
            sunward, cosine, 0.12 * one, ext, dims=dims, top=top,
        )  # fmt: skip
        parts = (met.column, met.sunlit, met.shaded, met.upward)
        return jnp.concatenate([jnp.broadcast_to(part, (1, 3)) for part in parts], axis=1)

    at: list[Any] = [scale, ext, 0.015 * one, 0.1 * one, 0.4 * one]
    many = jax.jacfwd(light, argnums=(0, 1, 2, 3, 4))(*at)
    for k in range(5):
        few = jax.jacfwd(light, argnums=k)(*at)
        np.testing.assert_allclose(few, many[k], rtol=1e-9, atol=1e-12)
        step = 1e-6 * at[k]
        up, down = (
            light(*(a + (side * step if i == k else 0) for i, a in enumerate(at)))
            for side in (1, -1)
        )
        along = np.asarray(jnp.tensordot(many[k], step, ([2, 3], [0, 1])))
        np.testing.assert_allclose(along, (up - down) / 2, rtol=1e-5, atol=1e-13)


@pytest.mark.parametrize("asymmetry", [-1.0, -0.9, 0.0, 0.5, 0.99, 1.0])
@pytest.mark.usefixtures("x64")
def test_phase_functions_are_one_on_average(asymmetry: float) -> None:
    """Over all directions; and their mean cosine is the asymmetry. Gauss–Legendre over a variable
    that is dense at the peak is exact to rounding. Slopes are numbers at the ends."""
    x, w = np.polynomial.legendre.leggauss(2000)
    cos = x * (3 - x * x) / 2  # dense at both ends
    weight = w * 0.75 * (1 - x * x)
    found = np.asarray(henyey_greenstein(jnp.asarray(cos), jnp.asarray(asymmetry)))
    if abs(asymmetry) < 1:
        assert weight @ found == pytest.approx(1, abs=1e-9)
        assert weight @ (found * cos) == pytest.approx(asymmetry, abs=1e-9)
    assert weight @ rayleigh(jnp.asarray(cos)) == pytest.approx(1, abs=1e-12)
    ends = jnp.array([-1.0, 0.0, 1.0])
    for k in (0, 1):
        slope = jax.jacfwd(henyey_greenstein, argnums=k)(ends, jnp.asarray(asymmetry))
        assert np.isfinite(slope).all()
