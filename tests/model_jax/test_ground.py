"""Ground behind the air: brighter or darker than the scene says, lit through the air."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import InputError, Look, Planet, Scene, analytic_layers, composite, find_look
from model_jax._composite import air_light
from model_jax._fields import fields_of
from model_jax.looks._check import check_look

from .scenes import RADIUS, scene_of
from .test_sunlight import to_sun

SCENE = scene_of((0.0, -3.0, 0.4), sun=(0.5, -0.6, 0.2), shell=0.05)
WHITE = replace(SCENE, planet=Planet(RADIUS, albedo=(1.0, 1.0, 1.0)))
GROUND = (0.2, 0.3, 0.5)
ONE = np.ones(3, np.float32)


def look_of(terms: str, **values: object) -> Look:
    return find_look(f"air+{terms}")(**values)


@pytest.mark.parametrize("terms", ["", "density", "saturation"])
def test_ground_is_a_factor_on_the_light_behind(terms: str) -> None:
    """As an albedo of the same would be: a product in another order, some roundings of float32."""
    plain = "+".join(["air", *terms.split()])
    said = composite(analytic_layers(WHITE), find_look(f"{plain}+ground")(ground=GROUND))
    coloured = replace(SCENE, planet=Planet(RADIUS, albedo=GROUND))
    given = composite(analytic_layers(coloured), find_look(plain)())
    np.testing.assert_allclose(said, given, rtol=1e-6)
    assert float(np.max(said)) > 0.1


def test_without_light_of_the_planet_it_stays_black() -> None:
    layers = analytic_layers(SCENE)
    one, other = (composite(layers, find_look(f"air{t}")()) for t in ("", "+ground"))
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", ["brightness", "unknown", "top"])
def test_a_factor_that_is_none_is_refused(name: str) -> None:
    class Wrong(find_look("air+top")):  # type: ignore[misc]
        """Wrong."""

        GROUND = name

    with pytest.raises(InputError, match=r"GROUND: .* must be a parameter of shape 'rgb'"):
        check_look(Wrong)


@pytest.mark.usefixtures("x64")
def test_sunlight_reaches_the_ground_through_the_air() -> None:
    """Of black air over white ground what passes is exp(-τ), of the columns from the sun and to the
    camera by adaptive integration. The camera's column is exact to 6.5e-5, what passes on the sun's
    way to 1e-3."""
    scale, extinction, shell = 0.02 * RADIUS, (2.0, 6.0, 20.0), 0.2
    scene = scene_of((0.0, -3.0, 0.4), sun=(0.7, -0.3, 0.2), shell=shell, path="distance")
    scene = replace(scene, planet=Planet(RADIUS, albedo=(1.0, 1.0, 1.0)))
    look = look_of(
        "density+saturation+sun+ground", scale_height=scale, extinction=extinction, brightness=0.0
    )
    layers = analytic_layers(scene, np.float64, look)
    picture = np.asarray(composite(layers, look))[..., :3]
    assert layers.surface is not None
    white = np.asarray(layers.surface)
    rows, columns = np.nonzero(white[..., 0] > 0.02)
    view = layers.view
    assert view is not None
    depth = np.asarray(extinction) * RADIUS / float(layers.width_unit)
    pixels = zip(rows.tolist(), columns.tolist(), strict=True)
    passed = np.array([ways(scene, row, column, shell) for row, column in pixels])
    expected = white[rows, columns] * np.exp(-depth * passed[:, None])
    np.testing.assert_allclose(picture[rows, columns], expected, atol=1.2e-3)
    assert np.median(expected) < 0.9 * np.median(white[rows, columns])


def ways(scene: Scene, row: int, column: int, shell: float) -> float:
    """Columns from the ground that a pixel sees to camera and sun, planet radii."""
    camera, sun = scene.camera, scene.sun
    assert sun is not None
    right, up, ahead = np.asarray(camera.basis(), np.float64)
    size = float(camera.pixel_size())
    x = (column + 0.5 - camera.width / 2) * size
    y = (camera.height / 2 - row - 0.5) * size
    ray = ahead + x * right + y * up
    ray /= np.linalg.norm(ray)
    place = np.asarray(camera.position, np.float64) / RADIUS
    along = -place @ ray - np.sqrt((place @ ray) ** 2 - place @ place + 1)
    normal = place + along * ray
    elevations = (np.arcsin(np.clip(normal @ d, -1, 1)) for d in (-ray, np.asarray(sun.direction)))
    return sum(to_sun(0.0, float(e), 0.02, shell) for e in elevations)


def test_what_lies_behind_the_air_of_the_night_passes_it() -> None:
    """Stars have a light of their own: the sun's way dims the ground alone. Columns by six nodes
    and by eight are alike to 6.5e-5, and depths end at 3 here."""
    layers = analytic_layers(SCENE)
    values = {"scale_height": 0.01 * RADIUS, "extinction": (1.0, 3.0, 9.0)}
    terms = ("density+saturation", "density+saturation+sun")
    dimmed, lit = (
        air_light(
            look_of(name, **values), fields_of(layers, find_look(f"air+{name}").NEEDS), ONE
        ).transmittance
        for name in terms
    )
    assert dimmed is not None
    assert lit is not None
    sky = np.asarray(layers.planet) == 0
    np.testing.assert_allclose(np.asarray(lit)[sky], np.asarray(dimmed)[sky], atol=3e-4)
    assert np.asarray(lit)[~sky].min() < 0.9 * np.asarray(dimmed)[~sky].min()


def test_slopes_by_the_ground_are_finite_at_its_bound() -> None:
    layers = analytic_layers(WHITE)
    look = look_of("density+saturation+sun+ground", ground=(0.0, 0.0, 0.0))

    def total(look: Look) -> jax.Array:
        return composite(layers, look).sum()

    slopes = jax.grad(total)(jax.tree.map(jnp.float32, look))
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(slopes))
    assert (np.asarray(slopes.ground) > 0).all()
