"""The look `air` and its terms: against marched rays, at their limits, and what they refuse."""

import pickle
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    InputError,
    Layers,
    LayersLook,
    Look,
    Scene,
    analytic_layers,
    combine,
    composite,
    find_look,
)
from model_jax.looks._check import check_look

from .scenes import RADIUS, scene_of

TERMS = [
    "density",
    "density-rgb",
    "top",
    "saturation",
    "density+top+saturation",
    "top+saturation",
    "phase",
    "density+sun",
    "density-rgb+top+saturation+sun+upwelling+phase",
]


def look(terms: str = "", **values: Any) -> Look:
    return find_look("air" + (terms and f"+{terms}"))(**values)


def scene(shell: float = 100.0 / RADIUS, **more: Any) -> Scene:
    """From 380 km up, past the limb; the sun is behind it, so that there is a shadow in the air."""
    return scene_of(
        (1.06, 0.0, 0.0), (0.88, 0.3, 0.0), (-0.3, 0.9, 0.35), shell=shell, path="distance", **more
    )


def marched(given: Scene, layers: Layers, height: float, top: float) -> np.ndarray:
    """Lit and dark columns, by rays that are marched from the camera in 40,000 steps a pixel."""
    camera = given.camera
    x = (np.arange(camera.width) - (camera.width - 1) / 2) * camera.pixel_size()
    y = ((camera.height - 1) / 2 - np.arange(camera.height)) * camera.pixel_size()
    basis = np.asarray(camera.basis())
    found = np.zeros((2, camera.height, camera.width))
    reference = float(layers.reference)
    assert layers.shadow_front is not None
    assert layers.shadow_back is not None
    for row, column in np.ndindex(camera.height, camera.width):
        ray = np.array([x[column], y[row], 1.0]) @ basis
        edges = [layers.front, layers.shadow_front, layers.shadow_back, layers.back]
        front, first, last, back = (float(e[row, column]) + reference for e in edges)
        if front == back:
            continue
        step = (back - front) / 40000
        t = front + step * (np.arange(40000) + 0.5)
        r = np.linalg.norm(np.asarray(camera.position) + t[:, None] * ray, axis=1)
        density = np.where(r - RADIUS < top, np.exp(-(r - RADIUS) / height), 0)
        dark = (t > first) & (t < last)
        length = step * np.linalg.norm(ray)
        found[:, row, column] = length * density[~dark].sum(), length * density[dark].sum()
    return found / float(layers.width_unit)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("terms", "top"), [("density", np.inf), ("density+top", 40.0)])
def test_light_is_that_of_marched_rays(terms: str, top: float) -> None:
    """40,000 steps: an edge (shadow, top) falls into a step, 2e-5 of the densest ray."""
    given = scene(size=(9, 7))
    layers = analytic_layers(given, np.float64)
    lit, dark = marched(given, layers, 8.0, top)
    assert (dark > 0).any()
    assert (lit > 0).any()
    values = {"top": top} if np.isfinite(top) else {}
    light = combine(layers, look(terms, brightness=1.0, shadow=0.3, **values))[..., 0]
    expected = (lit + 0.3 * dark) * float(np.asarray(layers.color)[0])
    np.testing.assert_allclose(light, expected, rtol=2e-4, atol=4e-5 * expected.max())


def test_without_terms_it_is_the_papers() -> None:
    layers = analytic_layers(scene())
    values: dict[str, Any] = {"brightness": 2.0, "shadow": (0.1, 0.2, 0.3), "tint": (0.5, 1.0, 1.5)}
    one, other = combine(layers, look(**values)), combine(layers, LayersLook(**values))
    np.testing.assert_array_equal(one, other)


@pytest.mark.usefixtures("x64")
def test_air_of_great_scale_height_is_uniform_air() -> None:
    """H ≫ shell: exp(-100 km/H) is 1 - 1e-7 at 10⁹ km."""
    layers = analytic_layers(scene(), np.float64)
    uniform = combine(layers, look())
    np.testing.assert_allclose(combine(layers, look("density", scale_height=1e9)), uniform, 2e-7)
    np.testing.assert_allclose(combine(layers, look("top", top=1e4)), uniform, 1e-12, 1e-13)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("terms", ["top", "density+top"])
def test_a_lower_top_is_a_lower_shell(terms: str) -> None:
    low = replace(scene(), atmosphere=replace(scene().atmosphere, height=30.0))
    high = analytic_layers(scene(), np.float64)
    expected = combine(analytic_layers(low, np.float64), look(terms, top=1e4))[..., :3]
    found = combine(high, look(terms, top=30.0))[..., :3]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("x64")
def test_thin_air_dims_nothing_and_thick_air_shows_its_surface() -> None:
    layers = analytic_layers(scene(), np.float64)
    thin = look("saturation", extinction=(0.0, 0.0, 0.0))
    np.testing.assert_array_equal(combine(layers, thin), combine(layers, look()))
    # τ ≫ 1: light is brightness / extinction, if all is lit, and nothing passes.
    color = np.asarray(layers.color)[:3]
    bright = look("saturation", extinction=(1e9, 1e9, 1e9), brightness=2e9, shadow=1.0)
    air = np.asarray(layers.has_air)
    light = np.asarray(combine(layers, bright))[air][:, :3]
    np.testing.assert_allclose(light, np.broadcast_to(2 * color, light.shape), rtol=1e-6)
    behind = replace(layers, surface=jnp.ones((*air.shape, 3)))
    passed = [
        np.asarray(composite(behind, one) - combine(behind, one))[air][:, :3]
        for one in (bright, thin)
    ]
    assert np.abs(passed[0]).max() < 1e-6
    np.testing.assert_allclose(passed[1], 1.0, rtol=1e-12)


@pytest.mark.parametrize("terms", TERMS)
def test_a_set_of_terms_is_a_look(terms: str) -> None:
    kind = find_look(f"air+{terms}")
    check_look(kind)
    assert find_look("air+" + "+".join(reversed(terms.split("+")))) is kind
    again = pickle.loads(pickle.dumps(kind()))
    assert type(again) is kind
    needs = {"sun": "density+sun", "upwelling": "density+sun+upwelling"}
    alone = [find_look(f"air+{needs.get(term, term)}") for term in terms.split("+")]
    assert set(kind.PARAMETERS) == {name for one in alone for name in one.PARAMETERS}
    assert (kind.NEEDS[:2] == ("lit", "dark")) == (terms in ("saturation", "phase"))
    assert ("sun_cos" in kind.NEEDS) == ("sun" in terms or "phase" in terms)


@pytest.mark.parametrize("terms", TERMS)
def test_slopes_are_finite_in_every_pixel(terms: str, dtype: np.dtype) -> None:
    layers = analytic_layers(scene(size=(17, 13)), dtype)
    given = jax.tree.map(lambda part: jnp.asarray(part, dtype), look(terms))
    slopes = jax.jacfwd(lambda one: composite(layers, one))(given)
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(slopes))


def test_what_cannot_be_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="look air: has no term 'haze'; choose from density,"):
        find_look("air+haze")
    with pytest.raises(InputError, match="density and density-rgb are one term"):
        find_look("air+density+density-rgb")
    with pytest.raises(InputError, match="term sun goes with density; add it"):
        find_look("air+saturation+sun")
    with pytest.raises(InputError, match="term upwelling goes with sun; add it"):
        find_look("air+density+upwelling")
    with pytest.raises(InputError, match="look layers: has no term 'density'"):
        find_look("layers+density")
    with pytest.raises(InputError, match=r"scale_height: -1\.0 must be at least 0"):
        look("density", scale_height=-1.0)


def test_layers_that_do_not_know_their_rays_are_refused() -> None:
    bare = replace(analytic_layers(scene()), view=None)
    with pytest.raises(InputError, match=r"do not tell how rays pass the planet.*field begin"):
        combine(bare, look("density"))
    combine(bare, look("saturation"))  # needs widths only


@pytest.mark.parametrize("terms", ["phase", "density+sun"])
def test_scenes_without_a_sun_are_refused_where_it_counts(terms: str) -> None:
    dark = analytic_layers(replace(scene(), sun=None))
    with pytest.raises(InputError, match=r"do not tell where the sun is.*give the scene a sun"):
        combine(dark, look(terms))


@pytest.mark.usefixtures("x64")
def test_the_suns_way_of_clear_air_changes_nothing() -> None:
    """Without extinction all sunlight gets there; eight nodes for six, which leave 6e-5."""
    layers = analytic_layers(scene(size=(17, 13)), np.float64)
    known: dict[str, Any] = {"scale_height": 8.0, "shadow": 0.3}
    plain = combine(layers, look("density", **known))
    for terms in ("density+sun", "density+saturation+sun"):
        found = combine(layers, look(terms, extinction=(0.0, 0.0, 0.0), **known))
        np.testing.assert_allclose(found, plain, rtol=2e-4, atol=1e-6 * float(plain.max()))


def test_several_shadows_are_refused_where_their_place_counts() -> None:
    two = analytic_layers(scene(moons=(((0.0, 3.0, 0.0), 0.27),)))
    with pytest.raises(InputError, match="hold 2 shadows"):
        combine(two, look("density"))
    combine(two, look("saturation"))
