"""The look `rim` against document 003 written down in NumPy, its two set-ups, and its limits."""

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
    Look,
    Planet,
    Scene,
    analytic_layers,
    combine,
    composite,
    find_look,
)
from model_jax._composite import air_light
from model_jax._fields import fields_of
from tests.documents import Rim, rim_picture

from .scenes import PLACES, RADIUS, scene_of

GROUND = (0.3, 0.5, 0.2)
CASES: dict[str, Scene] = {
    "day": scene_of((2.0, -1.5, 0.6), sun=(0.9, -0.3, 0.3), shell=0.03),
    "terminator": scene_of((0.4, -2.6, 0.7), sun=(0.9, 0.2, 0.1), shell=0.02),
    "night": scene_of((0.4, -2.6, 0.7), sun=(0.2, 0.9, 0.1), shell=0.1),
    "far": scene_of((140.0, -185.0, 15.0), fov=0.62, sun=(0.2, -1.0, 0.4), shell=0.016),
}
NODES = np.random.default_rng(3).uniform(0.2, 2.0, (10, 3)) * [[1.0, 1.0, 1.0]]
NODES[0] = 1.0
TABLES = dict(zip(("red", "green", "blue"), NODES[1:].T, strict=True))

SETTINGS: dict[str, tuple[Rim, dict[str, Any]]] = {
    "": (Rim(), {}),
    "gradient": (Rim(nodes=NODES), TABLES),
    "specular": (
        Rim(specular=0.8, shininess=30.0),
        {"specular": 0.8, "shininess": 30.0},
    ),
    "single": (Rim(single=True), {}),
    "gradient+specular": (
        Rim(1.7, 0.6, 3.0, 12.0, NODES, 0.5, 7.0),
        TABLES
        | {"brightness": 1.7, "opacity": 0.6, "exponent": 3.0, "slump": 12.0}
        | {"specular": 0.5, "shininess": 7.0},
    ),
}


def look(terms: str = "", **values: Any) -> Look:
    return find_look("rim" + (terms and f"+{terms}"))(**values)


def lit(scene: Scene) -> Scene:
    return replace(scene, planet=Planet(scene.planet.radius, albedo=GROUND))


def layers_of(scene: Scene, dtype: Any = np.float64) -> Layers:
    """With a mask of water that no rule made."""
    layers = analytic_layers(lit(scene), dtype, look())
    shape = np.shape(layers.front)
    mask = np.random.default_rng(1).uniform(size=shape) * np.asarray(layers.planet)
    return replace(layers, water=jnp.asarray(mask, dtype))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("terms", SETTINGS)
def test_every_number_is_the_documents(case: str, terms: str) -> None:
    """In float64, which leaves some hundred roundings; from 232 radii the transcription squares
    numbers of which 1e-11 radii² are lost, and its points on the limb's pixels 1e-9."""
    scene, (numbers, values) = CASES[case], SETTINGS[terms]
    layers = layers_of(scene)
    assert layers.water is not None
    expected, alpha = rim_picture(
        scene, numbers, np.array(GROUND), np.asarray(layers.water) if numbers.specular else None
    )
    made = np.asarray(composite(layers, look(terms, **values)))
    grazing = 1e-8 if case == "far" else 1e-12
    np.testing.assert_allclose(made[..., :3], expected, rtol=0, atol=grazing)
    np.testing.assert_allclose(
        np.asarray(combine(layers, look(terms, **values)))[..., 3], alpha, rtol=0, atol=grazing
    )
    # The terminator's scene shows light and dark, or this would compare black with black.
    assert np.ptp(expected) > 0.05


@pytest.mark.usefixtures("x64")
def test_two_spheres_of_one_radius_are_one_sphere() -> None:
    """Of the same points where air begins and ends both set-ups are the same numbers."""
    layers = layers_of(CASES["terminator"])
    terms = ("gradient", "specular")
    fields = fields_of(layers, find_look("rim+gradient+specular").NEEDS)
    ground = {n: np.asarray(f)[np.asarray(layers.planet) == 1] for n, f in fields.items()}
    # A coat on the ground; it must be of some thickness to be there.
    ground["begin"] = np.nextafter(ground["end"], -np.inf)
    ground["begin_sun_cos"] = ground["end_sun_cos"]
    color = np.array([0.3, 0.6, 1.0])
    two = air_light(look("+".join(terms)), ground, color)
    one = air_light(look("+".join((*terms, "single"))), ground, color)
    for first, second in zip(two, one, strict=True):
        np.testing.assert_allclose(np.asarray(first), np.asarray(second), rtol=1e-12)
    assert np.asarray(two.light).max() > 0.1


@pytest.mark.usefixtures("x64")
def test_the_nearer_the_spheres_the_nearer_the_pictures() -> None:
    """What differs at different radii goes with the root of the height at the edge, and with the
    height elsewhere."""
    scene = CASES["day"]
    apart = {}
    for height in (0.03, 0.003, 0.0003):
        shell = replace(scene, atmosphere=replace(scene.atmosphere, height=height * RADIUS))
        layers = layers_of(shell)
        seen = np.asarray(layers.planet) == 1
        both = [np.asarray(composite(layers, look(terms)))[seen] for terms in ("", "single")]
        apart[height] = np.abs(both[0] - both[1])
    middle = [float(np.median(part)) for part in apart.values()]
    assert 5 < middle[0] / middle[1] < 20
    assert 5 < middle[1] / middle[2] < 20


@pytest.mark.parametrize(
    ("term", "off"),
    [
        ("gradient", {"red": np.ones(9), "green": np.ones(9), "blue": np.ones(9)}),
        ("specular", {"specular": 0.0}),
    ],
)
def test_a_term_that_does_nothing_is_the_look_without_it(term: str, off: dict[str, Any]) -> None:
    """To the rounding of a sum of two shares of 1, and of a product with 1."""
    layers = layers_of(CASES["terminator"], np.float32)
    plain = np.asarray(composite(layers, look()))
    np.testing.assert_allclose(composite(layers, look(term, **off)), plain, rtol=3e-7, atol=1e-12)


EXTREME: dict[str, dict[str, Any]] = {
    "s^400 underflows": {"exponent": 20.0},
    "s^0": {"exponent": 0.0},
    "no slump": {"slump": 0.0},
    "slump to full night": {"slump": 90.0},
    "a point of light": {"specular": 1e6, "shininess": 100.0},
    "nothing": {"opacity": 0.0, "brightness": 0.0, "specular": 0.0},
    "bright": {"brightness": 1e12},
}


@pytest.mark.parametrize(
    "place", ["centre", "wide field", "in shell, by the ground", "planet behind"]
)
@pytest.mark.parametrize("case", EXTREME)
def test_light_and_slopes_are_numbers(case: str, place: str) -> None:
    """Of rays through the very centre, too, where the sine is 0."""
    centre = scene_of((0.0, 0.0, 3.0), sun=(0.0, 0.0, 1.0))
    layers = layers_of(centre if place == "centre" else PLACES[place], np.float32)

    def total(part: Look, layers: Layers) -> jax.Array:
        return jnp.sum(composite(layers, part))

    made = jax.tree.map(jnp.float32, look("gradient+specular", **EXTREME[case]))
    light = composite(layers, made)
    assert np.isfinite(light).all()
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(jax.grad(total)(made, layers)))

    def by_depths(front: jax.Array) -> jax.Array:
        return total(made, replace(layers, front=front))

    assert np.isfinite(jax.grad(by_depths)(layers.front)).all()


def test_light_of_a_scene_has_slopes() -> None:
    """By every number of the scene: the camera's place moves the coat's edge."""

    def total(scene: Scene) -> jax.Array:
        return jnp.sum(composite(analytic_layers(scene, look=look()), look()))

    slopes = jax.grad(total, allow_int=True)(CASES["terminator"])
    for leaf in jax.tree.leaves(slopes):
        if np.issubdtype(np.asarray(leaf).dtype, np.floating):
            assert np.isfinite(leaf).all()


def test_a_surface_that_the_sun_has_lit_is_refused() -> None:
    scene = lit(CASES["day"])
    with pytest.raises(InputError, match=r"surface is the ground's light, and the look rim asks"):
        composite(analytic_layers(scene), look())
    with pytest.raises(InputError, match=r"surface is the ground's albedo, and the look layers"):
        composite(analytic_layers(scene, look=look()), find_look("layers")())
    assert analytic_layers(CASES["day"], look=look()).is_albedo is False  # there is no surface


def test_without_a_sun_it_says_what_is_missing() -> None:
    with pytest.raises(InputError, match=r"where the sun is.*begin_sun_cos"):
        composite(analytic_layers(replace(CASES["day"], sun=None)), look())


def test_unknown_terms_are_named_and_known_ones_pickle() -> None:
    with pytest.raises(InputError, match="look rim: has no term 'mie'; choose from gradient"):
        find_look("rim+mie")
    made = look("gradient+specular+single", exponent=3.0)
    again = pickle.loads(pickle.dumps(made))
    assert type(again) is type(made)
    assert again.exponent == 3.0
