"""Scenes at the limits of geometry: widths of air by float32, float64 and OpenGL, and slopes by
every number of the scene."""

from collections.abc import Iterator
from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import Atmosphere, Camera, Layers, Planet, Scene, Sun, analytic_layers
from model_jax._fields import layer_widths
from render_gl import render

from ..bench._exact import exact_widths
from ._number_row import EPS, Cause, Probe, Program, cast

SIZE = (12, 9)
"""Pixels: numbers of 50 digits take their time."""

FAR = "pixels without air hold the far plane, whose slopes cancel up to its own rounding"


def render_probes() -> Iterator[Probe]:
    """All of them."""
    for name, scene in _scenes():
        yield _probe(name, scene)


def _looking(
    position: tuple[float, float, float],
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    fov: float = 45.0,
    radius: float = 1.0,
    shell: float = 0.1,
    near: float = 0.01,
    far: float = 100.0,
    sun: tuple[float, float, float] = (1.0, 0.3, 0.2),
    sun_radius: float = 0.0,
    path: Any = "depth",
) -> Scene:
    """From a place at another, in lengths of one unit."""
    way = np.asarray(at) - np.asarray(position)
    forward = way / np.linalg.norm(way)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    width, height = SIZE
    return Scene(
        camera=Camera(np.asarray(position), forward, up, fov, width, height, near, far),
        planet=Planet(radius=radius),
        atmosphere=Atmosphere(height=shell, path=path),
        sun=Sun(np.asarray(sun), sun_radius),
    )


def _scenes() -> Iterator[tuple[str, Scene]]:
    yield "far/near of 2", _looking((0.0, 0.3, 3.0), near=2.0, far=4.0)
    for power in (3, 6, 9, 12, 15):
        far = 10.0 ** max(1, power - 6)
        scene = _looking((0.0, 0.3, 3.0), near=far / 10.0**power, far=far)
        yield f"far/near of 1e{power}", scene
    earth = partial(_looking, fov=60.0, radius=6371.0, shell=100.0, near=1e-4, far=1e4)
    for height, words in (
        (0.001, "1 m above ground"),
        (1.0, "1 km above ground"),
        (99.999, "1 m below the air's edge"),
    ):
        place = (0.0, 6371.0 + height, 0.0)
        ahead = (1000.0, 6371.0 + height, 100.0)
        yield f"camera {words}", earth(place, ahead)
    yield "camera on the air's edge", _looking((0.0, 1.1, 0.0), (1.0, 1.1, 0.0), 60.0)
    for away in (1e2, 1e4, 1e6):
        fov = float(np.degrees(2.4 / away))
        scene = _looking((0.3 * away, 0.1 * away, away), fov=fov, near=0.5 * away, far=2 * away)
        yield f"camera {away:.0e} radii away", scene
    for shell in (1e-3, 1e-6):
        fov = float(np.degrees(8 * shell / 3))
        limb = (np.sqrt(8) / 3 * (1 + shell / 2), 0.0, 1 / 3)
        scene = _looking((0.0, 0.0, 3.0), limb, fov, shell=shell, near=1.0, far=5.0)
        yield f"shell of {shell:.0e} radii, at the limb", scene
    yield "air a million times the planet", _looking((0.0, 0.0, 3.0), shell=1e6, far=1e7)
    for unit in (1e-9, 1e9):
        scene = _looking(
            (0.0, 0.3 * unit, 3 * unit),
            radius=unit,
            shell=0.1 * unit,
            near=0.1 * unit,
            far=10 * unit,
        )
        yield f"lengths in units of {1 / unit:.0e} radii", scene
    yield "all but a rim in shadow", _looking((0.0, 0.2, -3.0), sun=(0.0, 0.0, 1.0))
    yield "no air in shadow but a rim", _looking((0.0, 0.2, 3.0), sun=(0.0, 0.01, 1.0))
    yield "grazing rays", _looking((0.0, 1.1 - 1e-9, 0.0), (1.0, 1.1 - 1e-9, 0.0), 1.0)
    side = float(np.tan(np.deg2rad(5.0)))
    for angle, slope in ((5.0, side), (0.0, 0.0)):
        # On the night side, looking back along the cone's side just outside of it.
        place = (-2.0, 0.999 - 2 * slope, 0.0)
        scene = _looking(
            place,
            (place[0] + 1, place[1] + slope, 0.0),
            2.0,
            shell=0.5,
            sun=(1.0, 0.0, 0.0),
            sun_radius=angle,
        )
        yield f"rays along the side of a shadow that narrows by {angle:g}°", scene
    yield "field of view of 179°", _looking((0.0, 0.0, 1.2), fov=179.0, path="distance")
    yield "field of view of a microdegree", _looking((0.0, 0.0, 3.0), (1.05, 0.0, 0.0), 1e-6)


def _probe(name: str, scene: Scene) -> Probe:
    shells = float(scene.camera.far) / float(scene.atmosphere.height)

    def right(given: Any) -> np.ndarray:
        row, column = np.indices((SIZE[1], SIZE[0])).reshape(2, -1)
        part: Scene = eqx.combine(jax.tree.map(np.asarray, given), _parts(scene)[1])
        widths = exact_widths(part, row, column)
        return np.stack(widths).reshape(2, SIZE[1], SIZE[0]) / float(part.atmosphere.height)

    return Probe(
        "render",
        name,
        _program(scene.atmosphere.path),
        _parts(scene)[0],
        right=right,
        plain=partial(_plain, scene),
        opengl=lambda: np.asarray(_in_shells(render(scene, "linear"), scene)),
        cause=Cause(FAR, EPS["float32"] * shells),
    )


def _parts(scene: Scene) -> tuple[Any, Any]:
    """Its numbers, and the rest, which all scenes of a path share."""
    numbers, rest = eqx.partition(cast(scene, jnp.float64), eqx.is_inexact_array)
    return numbers, rest


@cache
def _program(path: str) -> Program:
    numbers, rest = _parts(_looking((0.0, 0.3, 3.0), path=path))

    def drawn(given: Any) -> jax.Array:
        scene: Scene = eqx.combine(given, rest)
        return _in_shells(analytic_layers(scene, jnp.asarray(scene.camera.near).dtype), scene)

    return Program(drawn, numbers)


def _plain(scene: Scene, dtype: str) -> Float[np.ndarray, "2 h w"]:
    """As users call it: what does not hang on pixels is prepared in float64."""
    return np.asarray(_in_shells(analytic_layers(scene, jnp.dtype(dtype)), scene))


def _in_shells(layers: Layers, scene: Scene) -> jax.Array:
    """Lit and dark width [2, h, w], heights of the shell."""
    lit, dark = layer_widths(layers)
    widths = jnp.stack([lit, jnp.zeros_like(lit) if dark is None else dark])
    unit = jnp.asarray(layers.width_unit, lit.dtype) / jnp.asarray(scene.atmosphere.height)
    return widths * unit.astype(lit.dtype)
