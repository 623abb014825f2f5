"""Scene and look records: defaults, conversion, and the one line that a bad value gets."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    LayersLook,
    Occluder,
    Planet,
    Scene,
    Sun,
)

GOOD: dict[str, Any] = {
    "position": (0.0, -3.0, 0.0),
    "forward": (0.0, 2.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "fov_y_deg": 40.0,
    "width": 64,
    "height": 48,
    "near": 0.1,
    "far": 6.0,
}

DEPTH = np.zeros((2, 3), np.float32)


def camera(**changes: Any) -> Camera:
    return Camera(**(GOOD | changes))


# what is built: (how, the field that the message must open with, the value it must show)
BAD: dict[str, tuple[Callable[[], object], str, str]] = {
    "near zero": (lambda: camera(near=0.0), "camera.near", "0"),
    "near negative": (lambda: camera(near=-2.5), "camera.near", "-2.5"),
    "near nan": (lambda: camera(near=float("nan")), "camera.near", "nan"),
    "far before near": (lambda: camera(far=0.05), "camera.far", "0.05"),
    "far infinite": (lambda: camera(far=float("inf")), "camera.far", "inf"),
    "fov 0": (lambda: camera(fov_y_deg=0.0), "camera.fov_y_deg", "0"),
    "fov 180": (lambda: camera(fov_y_deg=180.0), "camera.fov_y_deg", "180"),
    "no direction": (lambda: camera(forward=(0.0, 0.0, 0.0)), "camera.forward", "0.0, 0.0, 0.0"),
    "direction nan": (lambda: camera(forward=(0.0, np.nan, 1.0)), "camera.forward", "nan"),
    "up parallel": (lambda: camera(up=(0.0, -1.0, 0.0)), "camera.up", "-1.0"),
    "position inf": (lambda: camera(position=(np.inf, 0.0, 0.0)), "camera.position", "inf"),
    "no columns": (lambda: camera(width=0), "camera.width", "0"),
    "too many rows": (lambda: camera(height=70000), "camera.height", "70000"),
    "radius zero": (lambda: Planet(0.0), "planet.radius", "0"),
    "radius nan": (lambda: Planet(float("nan")), "planet.radius", "nan"),
    "few triangles": (lambda: Planet(1.0, triangles=3), "planet.triangles", "3"),
    "relief distance": (
        lambda: Planet(1.0, relief_distance=(2.0, 1.0)),
        "planet.relief_distance",
        "(2.0, 1.0)",
    ),
    "relief scale": (
        lambda: Planet(1.0, relief_scale=(-1.0, 1.0)),
        "planet.relief_scale",
        "(-1.0, 1.0)",
    ),
    "albedo of two": (lambda: Planet(1.0, albedo=(0.1, 0.2)), "planet.albedo", "(0.1, 0.2)"),  # type: ignore[arg-type]
    "albedo too bright": (lambda: Planet(1.0, albedo=(0.1, 1.5, 0)), "planet.albedo", "1.5"),
    "albedo negative": (lambda: Planet(1.0, albedo=(0.1, -0.5, 0)), "planet.albedo", "-0.5"),
    "albedo nan": (lambda: Planet(1.0, albedo=(np.nan, 0, 0)), "planet.albedo", "nan"),
    "albedo of one": (lambda: Planet(1.0, albedo=0.3), "planet.albedo", "0.3"),  # type: ignore[arg-type]
    "no air": (lambda: Atmosphere(0.0), "atmosphere.height", "0"),
    "unknown path": (lambda: Atmosphere(0.1, path="chord"), "atmosphere.path", "chord"),
    "negative colour": (lambda: Atmosphere(0.1, (-1.0, 0.0, 0.0)), "atmosphere.color", "-1.0"),
    "sun without direction": (lambda: Sun((0.0, 0.0, 0.0)), "sun.direction", "0.0"),
    "sun too large": (lambda: Sun((1.0, 0.0, 0.0), 90.0), "sun.angular_radius_deg", "90"),
    "sun negative": (lambda: Sun((1.0, 0.0, 0.0), -1.0), "sun.angular_radius_deg", "-1"),
    "occluder": (lambda: Occluder((1.0, 0.0, 0.0), -2.0), "occluder.radius", "-2"),
    "camera in planet": (
        lambda: Scene(camera(), Planet(4.0), Atmosphere(0.1)),
        "camera.position",
        "-3.0",
    ),
    "occluder without sun": (
        lambda: Scene(
            camera(), Planet(1.0), Atmosphere(0.1), None, (Occluder((2.0, 0.0, 0.0), 0.1),)
        ),
        "occluder",
        "1",
    ),
    "camera in an occluder": (
        lambda: Scene(
            camera(),
            Planet(1.0),
            Atmosphere(0.1),
            Sun((1.0, 0.0, 0.0)),
            (Occluder((5.0, 0.0, 0.0), 0.1), Occluder((0.0, -3.1, 0.0), 0.2)),
        ),
        "camera.position",
        "occluder 2 (0.1 from its centre, radius 0.2)",
    ),
    "brightness negative": (lambda: LayersLook(brightness=-1.0), "look.brightness", "-1"),
    "brightness nan": (lambda: LayersLook(brightness=float("nan")), "look.brightness", "nan"),
    "shadow negative": (lambda: LayersLook(shadow=-0.5), "look.shadow", "-0.5"),
    "tint negative": (lambda: LayersLook(tint=(1.0, -1.0, 1.0)), "look.tint", "-1"),
    "background infinite": (lambda: LayersLook(background=float("inf")), "look.background", "inf"),
    "layers rgb": (lambda: Layers(DEPTH, DEPTH, color=np.ones(3)), "layers.color", "1"),
    "look of text": (lambda: LayersLook(brightness="bright"), "look.brightness", "bright"),  # type: ignore[arg-type]
    "look of a digit": (lambda: LayersLook(brightness="3"), "look.brightness", "'3'"),  # type: ignore[arg-type]
    "look of two": (lambda: LayersLook(shadow=[1, 2]), "look.shadow", "[1.0, 2.0]"),
    "look beyond floats": (lambda: LayersLook(brightness=10**400), "look.brightness", "400 digits"),
    "near beyond floats": (lambda: camera(near=10**400), "camera.near", "400 digits"),
    "near beyond repr": (lambda: camera(near=10**5000), "camera.near", "5,000 digits"),
    "width beyond floats": (lambda: camera(width=10**5000), "camera.width", "5,000 digits"),
    "fov complex": (lambda: camera(fov_y_deg=1j), "camera.fov_y_deg", "1j"),
    "no position": (lambda: camera(position=None), "camera.position", "None"),
    "position of parts": (lambda: camera(position=(0.0, None, 1.0)), "camera.position", "None"),
    "position of text": (lambda: camera(position=(0.0, "1", 1)), "camera.position", "'1'"),
    "long position": (lambda: camera(position=[0] * 10**5), "camera.position", "..."),
    "forward ragged": (lambda: camera(forward=((1.0,), 1.0)), "camera.forward", "((1.0,), 1.0)"),
    "sun of text": (lambda: Sun(direction="x"), "sun.direction", "'x'"),
    "occluder of text": (lambda: Occluder("x", 1.0), "occluder.center", "'x'"),
    "color of none": (lambda: Atmosphere(1.0, None), "atmosphere.color", "None"),
    "scale beyond floats": (
        lambda: Planet(1.0, relief_scale=(10**400, 1)),
        "planet.relief_scale",
        "400 digits",
    ),
    "scale of none": (lambda: Planet(1.0, relief_scale=None), "planet.relief_scale", "None"),  # type: ignore[arg-type]
    "triangles beyond floats": (
        lambda: Planet(1.0, triangles=10**400),
        "planet.triangles",
        "400 digits",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_values_are_named_with_value_and_remedy(name: str) -> None:
    build, field, value = BAD[name]
    with pytest.raises(InputError) as error:
        build()
    message = str(error.value)
    assert message.startswith(field), message
    assert value in message, message
    assert message.isprintable()
    assert len(message) < 300
    remedies = ("must", "give", "choose", "move", "add", "is not a number")
    assert any(word in message for word in remedies), message


def test_defaults_pass_through_the_converters() -> None:
    look = LayersLook()
    assert isinstance(look.tint, np.ndarray)
    assert look.tint.dtype == np.float64
    for name, info in LayersLook.PARAMETERS.items():
        np.testing.assert_array_equal(getattr(look, name), info.default)
    assert isinstance(Atmosphere(1.0).color, np.ndarray)
    np.testing.assert_array_equal(Atmosphere(1.0).color, 1.0)
    assert isinstance(Layers(DEPTH, DEPTH).color, np.ndarray)
    assert isinstance(Sun((1.0, 0.0, 0.0)).angular_radius_deg, np.floating)


def test_an_albedo_is_a_colour_or_a_path() -> None:
    planet = Planet(1.0, albedo=(0, 0.5, 1))
    assert planet.albedo == (0.0, 0.5, 1.0)
    assert hash(planet.albedo) == hash((0.0, 0.5, 1.0))
    assert jax.tree.leaves(planet) == jax.tree.leaves(Planet(1.0))  # no number to differentiate by
    assert Planet(1.0, albedo="maps/color.png").albedo == "maps/color.png"


def test_every_default_lies_within_its_bounds() -> None:
    for info in LayersLook.PARAMETERS.values():
        default = np.asarray(info.default)
        assert ((info.lower <= default) & (default <= info.upper)).all()


def test_directions_become_unit_vectors() -> None:
    np.testing.assert_allclose(np.linalg.norm(Sun((3.0, 4.0, 12.0)).direction), 1, rtol=1e-15)
    np.testing.assert_array_equal(camera().forward, (0.0, 1.0, 0.0))


@pytest.mark.parametrize("size", [1e-200, 1e200, 1e308, 5e-324])
def test_directions_of_any_length_become_unit_vectors(size: float) -> None:
    np.testing.assert_array_equal(Sun((0.0, -size, 0.0)).direction, (0.0, -1.0, 0.0))


def test_numbers_of_any_kind_are_converted() -> None:
    for number in (10**30, np.float32(2), np.array(3), np.int64(4), True):
        near = camera(near=number, far=1e31).near
        assert isinstance(near, np.float64)
        assert near == number
    np.testing.assert_array_equal(camera(position=(0, -(10**30), 0.5)).position, (0, -1e30, 0.5))


def test_three_colours_mean_alpha_one() -> None:
    np.testing.assert_array_equal(Atmosphere(1.0, (0.2, 0.3, 0.4)).color, (0.2, 0.3, 0.4, 1.0))


def test_basis_is_right_handed_and_orthonormal(rng: np.random.Generator) -> None:
    basis = camera(forward=rng.normal(size=3), up=rng.normal(size=3)).basis()
    np.testing.assert_allclose(basis @ basis.T, np.eye(3), atol=1e-15)
    # Rows are right, up, forward: with up × right = forward the determinant is -1.
    assert np.linalg.det(basis) == pytest.approx(-1)


def test_resized_keeps_the_vertical_field() -> None:
    small = camera().resized(32, 24)
    assert (small.width, small.height) == (32, 24)
    assert small.pixel_size() == 2 * camera().pixel_size()


def test_numbers_are_leaves_and_names_are_not() -> None:
    scene = Scene(camera(), Planet(1.0, relief="map.png"), Atmosphere(0.1), Sun((1.0, 0.0, 0.0)))
    leaves = jax.tree.leaves(scene)
    assert leaves
    assert all(isinstance(leaf, np.ndarray | np.floating) for leaf in leaves)
