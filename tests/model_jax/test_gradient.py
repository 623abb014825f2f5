"""The look `gradient` against document 004 written down in NumPy, its terms, and its limits."""

import pickle
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import InputError, Layers, Look, Scene, analytic_layers, combine, find_look
from model_jax.looks._gradient import BRIGHTNESSES, HEIGHTS, LIGHT_DISTANCE, table_at
from tests.documents import Gradient, gradient_picture, sampled

from .scenes import PLACES, scene_of

SHELL = 1200 / 1024 - 1
"""The document's, of its planet."""
SUN = (1.0, 1.0, 1.0)
CASES: dict[str, Scene] = {
    "the document's": scene_of((2.0, 1.5, 0.6), sun=SUN, shell=SHELL),
    "terminator": scene_of((0.4, -2.6, 0.7), sun=(0.9, 0.2, 0.1), shell=0.02),
    "night": scene_of((0.4, -2.6, 0.7), sun=(0.2, 0.9, 0.1), shell=0.1),
    "far": scene_of((140.0, -185.0, 15.0), fov=0.62, sun=(0.2, -1.0, 0.4), shell=0.016),
    "above the shell": scene_of((0.0, -1.19, 0.0), (0.6, 0.0, 0.4), SUN, fov=80.0, shell=SHELL),
    "in the shell": scene_of((0.2, -1.1, 0.1), (0.8, 0.4, 0.9), (0.4, -0.6, 0.5), shell=SHELL),
    "by the ground": scene_of((0.0, 0.0, 1.004), (1.0, 0.3, 1.3), (0.9, 0.1, 0.2), shell=SHELL),
}
NODES = np.random.default_rng(4).uniform(0.1, 1.5, (BRIGHTNESSES, HEIGHTS, 4))
NODES[-1, -1] = 1.0
TABLES = dict(zip(("red", "green", "blue", "cover"), NODES.reshape(-1, 4)[:-1].T, strict=True))

SETTINGS: dict[str, tuple[Gradient, dict[str, Any]]] = {
    "": (Gradient(), {}),
    "table": (Gradient(texture=NODES), TABLES),
    "mie": (Gradient(g=-0.95), {}),
    "mie+lamp": (Gradient(g=-0.95, lamp=LIGHT_DISTANCE), {}),
    "veil": (Gradient(veil=True), {}),
    "table+mie+lamp+veil": (
        Gradient(2.2, (1, 1, 1, 0.6), 0.4, 0.05, NODES, -0.7, 0.6, veil=True),
        TABLES
        | {"falloff": 2.2, "opacity": 0.6, "stretch": 0.4, "tweak": 0.05}
        | {"asymmetry": -0.7, "light_distance": 0.6},
    ),
}


def look(terms: str = "", **values: Any) -> Look:
    return find_look("gradient" + (terms and f"+{terms}"))(**values)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("terms", SETTINGS)
def test_every_number_is_the_documents(case: str, terms: str) -> None:
    """In float64, which leaves some hundred roundings; from 232 radii the transcription takes
    differences of cosines that differ by 3e-7 and of squares that leave 1e-9."""
    scene, (numbers, values) = CASES[case], SETTINGS[terms]
    color = tuple(np.multiply(numbers.color, (*scene.atmosphere.color[:3], 1.0)))
    expected = gradient_picture(scene, replace(numbers, color=color))
    made = np.asarray(combine(analytic_layers(scene, np.float64, look()), look(terms, **values)))
    # Beside the limb's own pixels a point on the shell is as uncertain as a root is.
    bound = 1e-6 if case == "far" else 1e-11
    np.testing.assert_allclose(made, expected, rtol=0, atol=bound)
    assert np.ptp(expected) > 0.2


def test_the_table_is_linear_between_its_nodes_and_held_at_its_edges() -> None:
    """At nodes, beside them, at and beyond the edges, and in between."""
    places = np.concatenate([np.arange(8) / 7, [-0.5, 1e-7, 1 - 1e-7, 1.5], np.linspace(0, 1, 50)])
    heights = np.concatenate([np.arange(4) / 3, [-1.0, 1e-7, 1 - 1e-7, 2.0], np.linspace(0, 1, 40)])
    u, v = (part.astype(np.float32) for part in np.meshgrid(places, heights))
    tables = [jnp.float32(TABLES[name]) for name in ("red", "green", "blue", "cover")]
    found = table_at(jnp.asarray(u[..., None]), jnp.asarray(v[..., None]), tables)
    expected = sampled(NODES, np.clip(u, 0, 1).astype(np.float64), v.astype(np.float64))
    # Shares are off by half an ulp of a place of 7 at most, times a step of 1.4 between nodes.
    np.testing.assert_allclose(found, expected, atol=4 * 7 * 1.4 * 2**-24)


@pytest.mark.parametrize("size", [(4, 8), (64, 256), (9, 17)])
def test_a_picture_becomes_the_table(size: tuple[int, int]) -> None:
    """A texture painted from a table, columns brightness and rows height, comes back; of one about
    as coarse as the table its own bends between nodes are lost."""
    rows, columns = size
    v, u = ((np.arange(n) + 0.5) / n for n in (rows, columns))
    smooth = np.linspace(0.2, 0.8, 8)[:, None, None] * np.linspace(0.3, 1.0, 4)[None, :, None]
    table = smooth * [0.9, 0.7, 0.5, 1.0]
    picture = sampled(table, *np.meshgrid(u, v))
    made = look("table", **type(look("table")).of_picture(picture))
    tables = [np.append(getattr(made, name), 1.0) for name in ("red", "green", "blue", "cover")]
    found = np.stack(tables, axis=-1).reshape(8, 4, 4)
    strength = np.append(made.falloff / 1.5 * np.asarray(made.tint), made.falloff / 1.5)
    strength[3] *= made.opacity
    # Outermost pixels' middles stand for the edges of a coarse one.
    bound = 1e-12 if rows >= 8 and columns >= 16 else 0.15
    np.testing.assert_allclose(found * strength, table, atol=bound)


def test_a_picture_without_light_at_the_horizon_is_refused() -> None:
    picture = np.ones((8, 16, 4))
    picture[..., 2] = 0.0
    with pytest.raises(InputError, match=r"last pixel.*channels of 0, \[1.0, 1.0, 0.0, 1.0\]"):
        type(look("table")).of_picture(picture)
    with pytest.raises(InputError, match="look layers: is made of no picture"):
        find_look("layers").of_picture(picture)


@pytest.mark.parametrize("terms", ["table", "table+mie"])
def test_a_flat_table_is_the_look_without_it(terms: str) -> None:
    layers = analytic_layers(CASES["terminator"], np.float32, look())
    ones = {name: np.ones(31) for name in TABLES}
    without = "+".join(term for term in terms.split("+") if term != "table")
    np.testing.assert_allclose(
        combine(layers, look(terms, **ones)), combine(layers, look(without)), rtol=1e-6, atol=1e-9
    )


@pytest.mark.usefixtures("x64")
def test_a_lamp_far_away_is_the_sun() -> None:
    """The direction to it turns with the inverse of its distance, in planet radii."""
    layers = analytic_layers(CASES["the document's"], np.float64, look())
    sun = np.asarray(combine(layers, look("mie", asymmetry=-0.7)))
    apart = [
        np.abs(combine(layers, look("mie+lamp", asymmetry=-0.7, light_distance=d)) - sun).max()
        for d in (1e3, 1e5)
    ]
    assert 0.01 * apart[0] < 2 * apart[1] < 0.04 * apart[0]
    assert apart[1] < 1e-4


def test_a_lamp_in_the_planet_makes_no_glow() -> None:
    """The document's (10, 10, 10): from the sky it stands below, never behind. A g of -0.95 makes
    light around the sun 3/2 · 0.0975/2.9025 · 2/0.0025 = 40 times the colour."""
    scene = scene_of((0.0, 0.0, 1.004), (2.0, 0.0, 1.804), (0.5, 0.0, 0.2), fov=80.0, shell=SHELL)
    layers = analytic_layers(scene, np.float32, look())
    plain, sun, lamp = (
        np.asarray(combine(layers, look(terms, falloff=1e-3)))[12, 16, 2]
        for terms in ("", "mie", "mie+lamp")
    )
    assert 20 < sun / plain < 41
    assert lamp < 1.2 * plain


@pytest.mark.usefixtures("x64")
def test_known_fault_crossing_the_shell() -> None:
    """The document's "not smooth" crossing: there is no jump, but the sky stands still on the way
    from 1.02 to 1 shell heights, where `tweak` holds its edge, and then moves ten times as fast.
    Without `tweak` the way down ends like a root, ever steeper."""

    def sky_from(height: float, tweak: float) -> np.ndarray:
        scene = scene_of(
            (0.0, -1.0 - height * SHELL, 0.0), (1.0, 0.0, 0.5), (0.5, -1.0, 0.3), shell=SHELL,
            fov=90.0,
        )  # fmt: skip
        made = look("veil", tweak=tweak)
        layers = analytic_layers(scene, np.float64, made)
        return np.where(
            np.asarray(layers.planet)[..., None] > 0, np.nan, np.asarray(combine(layers, made))
        )

    def speed(high: float, low: float, tweak: float = 0.1) -> float:
        """Of light, for each shell height."""
        change = np.abs(sky_from(high, tweak) - sky_from(low, tweak))
        return float(np.nanmax(change) / (high - low))

    assert np.nanmax(np.abs(sky_from(1 + 1e-9, 0.1) - sky_from(1 - 1e-9, 0.1))) < 1e-7
    before, still, after = speed(1.1, 1.05), speed(1.01, 1.005), speed(0.995, 0.99)
    assert still < 0.1 * before
    assert still < 0.1 * after
    assert speed(1.001, 1.0, 0.0) > speed(1.01, 1.005, 0.0) > 2 * speed(1.05, 1.02, 0.0)


@pytest.mark.usefixtures("x64")
def test_known_fault_at_the_sunward_edge_is_cured() -> None:
    """Close above the shell `tweak` lifts the sky's edge above the shell's horizon: between the two
    the document's light is below 0, which alpha's blend takes from what lies behind; here it is
    0."""
    scene = scene_of(
        (0.0, -1.0 - 1.01 * SHELL, 0.0), (1.0, -1.1, 0.0), (0.5, -1.0, 0.3), shell=SHELL, fov=10.0
    )
    drawn = gradient_picture(scene, Gradient(clamped=False))
    made = np.asarray(combine(analytic_layers(scene, np.float64, look()), look()))
    assert drawn.min() < -0.05
    assert made.min() == 0
    np.testing.assert_allclose(made[..., 3], np.maximum(drawn[..., 3], 0), atol=1e-9)


@pytest.mark.usefixtures("x64")
def test_in_the_air_nothing_is_intersected() -> None:
    """The document's near point lies behind the camera; that of its simpler variant is the camera.
    At the shell they meet."""
    apart = []
    for height in (0.999, 0.5, 0.01):
        scene = scene_of(
            (0.0, -1.0 - height * SHELL, 0.0), (1.0, -1.0, 0.5), (0.2, -0.2, 1.0), shell=SHELL
        )
        both = [gradient_picture(scene, Gradient(near=near)) for near in ("eye", "shell")]
        apart.append(np.abs(both[0] - both[1]).max())
    assert apart[0] < 0.01 < apart[1]


EXTREME: dict[str, dict[str, Any]] = {
    "forward alone": {"asymmetry": -1.0},
    "back alone": {"asymmetry": 1.0},
    "no asymmetry": {"asymmetry": 0.0},
    "a light in the centre": {"light_distance": 0.0},
    "a light on the ground": {"light_distance": 1.0},
    "a light far away": {"light_distance": 1e12},
    "no stretch": {"stretch": 0.0},
    "stretched to midnight": {"stretch": 1.0},
    "no tweak": {"tweak": 0.0},
    "a tweak beyond the horizon": {"tweak": 1.0},
    "nothing": {"falloff": 0.0, "opacity": 0.0},
    "saturated": {"falloff": 1e12},
    "a black table": {name: np.zeros(31) for name in ("red", "green", "blue", "cover")},
}


@pytest.mark.parametrize(
    "place",
    ["sun ahead", "zenith", "wide field", "in shell, by the ground", "planet behind", "thin shell"],
)
@pytest.mark.parametrize("case", EXTREME)
def test_light_and_slopes_are_numbers(case: str, place: str) -> None:
    """Of the ray into the sun and of the one straight up, too."""
    own = {
        "sun ahead": scene_of((0.0, -1.1, 0.0), (0.0, 3.0, 4.1), sun=(0.0, 4.1, 4.1), shell=SHELL),
        "zenith": scene_of((0.0, -1.01, 0.0), (0.0, -4.0, 0.0), sun=(0.0, -1.0, 0.0), shell=SHELL),
        "thin shell": scene_of((0.5, -2.5, 0.4), shell=0.002, fov=50.0),
    }
    layers = analytic_layers((PLACES | own)[place], np.float32, look())
    made = jax.tree.map(jnp.float32, look("table+mie+lamp+veil", **EXTREME[case]))

    def total(part: Look, layers: Layers) -> jax.Array:
        return jnp.sum(combine(layers, part))

    light = np.asarray(combine(layers, made))
    assert np.isfinite(light).all()
    assert ((light >= 0) & (light <= 1)).all()
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(jax.grad(total)(made, layers)))

    def by_depths(front: jax.Array, back: jax.Array) -> jax.Array:
        return total(made, replace(layers, front=front, back=back))

    for slope in jax.grad(by_depths, argnums=(0, 1))(layers.front, layers.back):
        assert np.isfinite(slope).all()


def test_light_of_a_scene_has_slopes() -> None:
    """By every number of the scene, from outside of the air and in it."""

    def total(scene: Scene) -> jax.Array:
        return jnp.sum(combine(analytic_layers(scene, look=look()), look("table+mie")))

    for case in ("terminator", "in the shell"):
        for leaf in jax.tree.leaves(jax.grad(total, allow_int=True)(CASES[case])):
            if np.issubdtype(np.asarray(leaf).dtype, np.floating):
                assert np.isfinite(leaf).all()


def test_without_a_sun_it_says_what_is_missing() -> None:
    scene = replace(CASES["terminator"], sun=None)
    with pytest.raises(InputError, match=r"where the sun is.*begin_sun_cos"):
        combine(analytic_layers(scene), look())


def test_terms_are_named_and_pickle() -> None:
    with pytest.raises(InputError, match="look gradient: has no term 'haze'; choose from table"):
        find_look("gradient+haze")
    with pytest.raises(InputError, match="look gradient: term lamp goes with mie; add it"):
        find_look("gradient+lamp")
    made = look("table+mie+lamp", stretch=0.5)
    again = pickle.loads(pickle.dumps(made))
    assert type(again) is type(made)
    assert again.stretch == 0.5
