"""Exact layers against a search along every ray, and what they promise besides the widths."""

from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    InputError,
    Planet,
    Scene,
    Sun,
    analytic_layers,
    eye_center,
    layer_widths,
    limb_height,
)

from .ray_march import March
from .scenes import ANYWHERE, PLACES, SCENES, scene_of

STEPS = 16
"""Rounded operations between a ray's pixel index and the squared distances compared with radii²:
counted along `ray_offsets` → `ray_cone`, the longest chain."""


def lengths(scene: Scene, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Lit and dark widths in scene units, float64 NumPy."""
    layers = analytic_layers(scene, dtype)
    lit, dark = layer_widths(layers)
    unit = float(layers.width_unit)
    lit = np.asarray(lit, np.float64) * unit
    return lit, np.zeros_like(lit) if dark is None else np.asarray(dark, np.float64) * unit


@cache
def march_of(name: str) -> March:
    return March(SCENES[name])


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        # Each scene in one precision, in the full sweep in both.
        pytest.param(name, dtype, marks=() if (j + k) % 2 else pytest.mark.full)
        for (j, name), (k, dtype) in product(enumerate(SCENES), enumerate(("float32", "float64")))
    ],
    indirect=["dtype"],
)
def test_widths_equal_a_march_along_the_rays(name: str, dtype: np.dtype) -> None:
    """Backward error: rounding moves each surface by a few ulp of the outermost body's size.

    Near tangency a moved surface changes a chord by the square root of the move, and beside the
    limb by the whole chord behind the planet. Widths grow or shrink monotonically with each body,
    so the widths must lie between those of the march with all bodies moved to their worst sides.
    """
    scene = SCENES[name]
    size = float(scene.planet.radius + scene.atmosphere.height)
    distance = float(np.linalg.norm(scene.camera.position))
    off_axis = np.tan(np.deg2rad(float(scene.camera.fov_y_deg)) / 2)
    stretch = 1 + off_axis * max(1.0, scene.camera.width / scene.camera.height)
    eps, eps64 = np.finfo(dtype).eps, np.finfo(np.float64).eps
    # The march itself loses an ulp of the distance in `origin + t·direction`.
    move = STEPS * stretch * (eps * size + eps64 * distance)
    # Depths, clip planes included, are stored to half an ulp and subtracted in pairs.
    slack = 4 * stretch * (eps * size + eps64 * distance)
    lit, dark = lengths(scene, dtype)
    march = march_of(name)
    least = march.widths(ground=move, shell=-move, shadow=move)
    most = march.widths(ground=-move, shell=move, shadow=-move)
    assert_between(lit, least.lit, most.lit, slack, "lit")
    least = march.widths(ground=move, shell=-move, shadow=-move)
    most = march.widths(ground=-move, shell=move, shadow=move)
    assert_between(dark, least.dark, most.dark, slack, "dark")


def assert_between(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, slack: float, what: str
) -> None:
    assert np.all(np.isfinite(value)), f"{what}: not finite"
    outside = np.maximum(low - value, value - high)
    row, column = np.unravel_index(np.argmax(outside), outside.shape)
    assert outside[row, column] <= slack, (
        f"{what} at row {row}, column {column}: {value[row, column]!r} not in "
        f"[{low[row, column]!r}, {high[row, column]!r}] ± {slack:.3g}; "
        f"{np.sum(outside > slack)} pixels wrong"
    )


LIT_ONLY = {
    *("no sun", "against cylinder", "sun behind camera", "apex in planet"),
    *("planet behind", "planet off screen"),
}


def has_shadow(scene: Scene) -> bool:
    _, dark = lengths(scene, np.dtype("float32"))
    return dark.max() > 0.1 * scene.atmosphere.height


@pytest.mark.parametrize("name", sorted(set(SCENES) - LIT_ONLY - set(ANYWHERE)))
def test_scenes_have_shadow_to_get_wrong(name: str) -> None:
    """A width that is zero everywhere would compare nothing."""
    assert has_shadow(SCENES[name])


def test_most_places_see_shadow() -> None:
    seen = {name for name, scene in ANYWHERE.items() if has_shadow(scene)}
    assert len(seen) > len(ANYWHERE) / 3
    for place in ("outside", "in the shell", "in the cone", "in cone and shell", "on dark ground"):
        assert any(name.startswith(place) for name in seen)


@pytest.mark.parametrize("name", SCENES)
def test_layers_keep_their_promises(name: str, dtype: np.dtype) -> None:
    """Dtype, order, clamping to the clip planes, no air = front equals back, absence of shadow."""
    scene = SCENES[name]
    layers = analytic_layers(scene, dtype)
    shape = (scene.camera.height, scene.camera.width)
    near, far = (
        np.float64(plane) - np.float64(layers.reference)
        for plane in (scene.camera.near, scene.camera.far)
    )
    # One rounding of the plane in planet radii, one of the product with the radius.
    ulp = 2 * np.finfo(dtype).eps * max(abs(near), abs(far))
    depths = [layers.front, layers.back]
    assert (layers.shadow_front is None) == (layers.shadow_back is None) == (scene.sun is None)
    if scene.sun is not None:
        assert layers.shadow_front is not None
        assert layers.shadow_back is not None
        depths += [layers.shadow_front, layers.shadow_back]
    for depth in depths:
        several = depth is not layers.front and depth is not layers.back and scene.occluders
        assert depth.shape == ((1 + len(scene.occluders), *shape) if several else shape)
        assert depth.dtype == dtype
        assert np.all((np.asarray(depth) >= near - ulp) & (np.asarray(depth) <= far + ulp))
    assert np.all(layers.back >= layers.front)
    assert np.all(np.isin(np.asarray(layers.planet), (0.0, 1.0)))
    if scene.sun is not None:
        assert np.all(np.asarray(layers.shadow_back) >= np.asarray(layers.shadow_front))


def test_reference_is_the_centres_eye_depth() -> None:
    scene = SCENES["far, 232 radii"]
    layers = analytic_layers(scene)
    assert isinstance(layers.reference, np.floating)
    assert layers.reference == eye_center(scene)[2]
    assert layers.reference == pytest.approx(np.linalg.norm(scene.camera.position), rel=1e-14)
    assert layers.width_unit == scene.camera.far - scene.camera.near


def test_float64_needs_x64() -> None:
    with pytest.raises(InputError, match=r"float64.*jax_enable_x64"):
        analytic_layers(PLACES["odd sizes"], jnp.float64)


def test_planet_hides_the_air_behind_it() -> None:
    """Straight down from 3 radii: air from 1.1 R to the ground at 1 R, in front of the centre."""
    scene = scene_of((0.0, -3.0, 0.0), size=(1, 1), shell=0.1, radius=1.0)
    layers = analytic_layers(scene)
    assert np.asarray(layers.planet)[0, 0] == 1
    assert layers.front[0, 0] == pytest.approx(-1.1, rel=1e-6)
    assert layers.back[0, 0] == pytest.approx(-1.0, rel=1e-6)


def test_a_planet_of_one_colour_is_lit_as_lambert_says() -> None:
    """Straight down on a normal that the sun meets at 45°; beside the planet there is no light."""
    albedo = (0.2, 0.5, 1.0)

    def light(sun: tuple[float, float, float] | None, moon: Any = ()) -> np.ndarray:
        scene = scene_of((0.0, -3.0, 0.0), sun=sun, size=(9, 9), fov=60.0, moons=moon)
        colored = replace(scene, planet=Planet(scene.planet.radius, albedo=albedo))
        layers = analytic_layers(colored)
        planet = np.asarray(layers.planet)
        assert planet[4, 4] == 1
        assert planet[0, 0] == 0
        assert layers.surface is not None
        np.testing.assert_array_equal(np.asarray(layers.surface)[planet == 0], 0)
        assert analytic_layers(scene).surface is None
        return np.asarray(layers.surface)[4, 4]

    # Some ten operations on float32.
    expected = np.sqrt(0.5) * np.array(albedo)
    np.testing.assert_allclose(light((1.0, -1.0, 0.0)), expected, rtol=10 * 2**-24)
    np.testing.assert_array_equal(light((0.0, 1.0, 0.0)), 0)
    np.testing.assert_array_equal(light(None), np.array(albedo, np.float32))
    # A moon toward the sun darkens the place; one that stands a radius aside of that line does not,
    # nor one on the other side; one before the place hides it.
    for moon, seen in (
        ((2.0, -3.0, 0.0), 0.0),
        ((3.0, -3.0, 0.0), 1.0),
        ((-2.0, 1.0, 0.0), 1.0),
        ((0.0, -2.0, 0.0), 0.0),
    ):
        found = light((1.0, -1.0, 0.0), ((moon, 0.3),))
        np.testing.assert_allclose(found, seen * expected, rtol=10 * 2**-24)


def test_light_of_a_colour_under_jit_and_grad() -> None:
    """Traced, the light is the same; its slope is that of the albedo × -y / |(x, y, z)|."""
    scene = scene_of((0.0, -3.0, 0.0), sun=(1.0, -1.0, 0.0), size=(9, 9), fov=60.0)
    scene = replace(scene, planet=Planet(scene.planet.radius, albedo=(0.2, 0.5, 1.0)))

    def light(direction: Any) -> Any:
        return jnp.asarray(analytic_layers(replace(scene, sun=Sun(direction))).surface)

    toward = np.array([1.0, -1.0, 0.0])
    # The view is prepared in float32 there: a few ulp of 3 radii, over the cosine of 0.3 at the
    # last pixels of this coarse picture.
    traced = jax.jit(light)(jnp.asarray(toward))
    np.testing.assert_allclose(traced, light(toward), atol=STEPS * 3 * 2**-23 / 0.3)
    slope = jax.grad(lambda s: light(s).sum())(jnp.asarray(toward))
    assert np.isfinite(slope).all()
    # By x: x y / |s|³ = -1 / √8; by y: -1 / |s| + y² / |s|³ = -1 / √8.
    middle = jax.grad(lambda s: light(s)[4, 4, 1])(jnp.asarray(toward))
    np.testing.assert_allclose(middle, 0.5 * np.array([-1, -1, 0]) / np.sqrt(8), atol=1e-6)


def test_limb_height_is_the_height_of_closest_approach() -> None:
    """4 radii away, a pixel at slope x passes the centre at 4 sin(atan x) radii."""
    scene = scene_of((0.0, -4.0, 0.0), size=(9, 1), fov=5.0)
    pixel = 2 * np.tan(np.deg2rad(2.5))
    x = pixel * (np.arange(9) - 4)
    height = limb_height(scene)
    assert height.dtype == np.float64
    expected = (4 * np.sin(np.arctan(np.abs(x))) - 1) * scene.planet.radius
    # Half an ulp of each of some ten operations on numbers of the planet's size.
    np.testing.assert_allclose(height[0], expected, rtol=0, atol=10 * 2.3e-16 * 6371.0)


def test_jit_agrees_to_the_rounding_of_the_traced_view(dtype: np.dtype) -> None:
    """Inside jit the view is prepared in the dtype of the trace, outside in float64.

    A camera at 3 radii then loses a few ulp of 3 radii; the ray that grazes loses the square root
    of that: 2·sqrt(2·move) in radii, move = 16 steps · 3 · eps.
    """
    scene = SCENES["sun +1+1+1"]
    plain, traced = (
        analytic_layers(scene, dtype),
        jax.jit(analytic_layers, static_argnums=1)(scene, dtype),
    )
    move = 16 * 3 * np.finfo(dtype).eps
    atol = 2 * np.sqrt(2 * move)
    for a, b in zip(layer_widths(plain), layer_widths(traced), strict=True):
        unit = plain.width_unit / scene.planet.radius
        difference = np.abs(np.asarray(a, np.float64) - np.asarray(b, np.float64)) * unit
        assert difference.max() <= atol
        # Away from tangency nothing is amplified by more than 1/cos of the angle of incidence.
        assert np.median(difference) <= move
