"""Scenes that the renderers' tests share."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from model_jax import Atmosphere, Camera, Occluder, Planet, Scene, Sun
from tests.data import REPOSITORY
from tests.model_jax.scenes import scene_of

OCTANTS = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]


def scene(
    distance: float = 2.3,
    thickness: float = 0.05,
    sun: tuple[float, ...] | None = (1.0, -0.4, 0.3),
    size: tuple[int, int] = (320, 240),
    sun_radius: float = 0.2666,
    moons: tuple[tuple[tuple[float, float, float], float], ...] = (),
    path: str = "depth",
) -> Scene:
    """A camera `distance` planet radii away that sees the whole shell; lengths in km.

    Moons: centres and radii in planet radii.
    """
    radius = 6371.0
    shell = 1 + thickness
    away = np.array([0.2, -0.9, 0.3])
    position = distance * radius * away / np.linalg.norm(away)
    half = np.arcsin(min(shell / distance, 0.95))
    near = max(distance - 1.01 * shell, 0.01) * radius
    return Scene(
        Camera(
            position,
            -position,
            [0, 0, 1],
            np.rad2deg(2.3 * half),
            *size,
            near,
            (distance + 1.01 * shell) * radius,
        ),
        Planet(radius, triangles=20_000),
        Atmosphere(thickness * radius, [0.3, 0.6, 1.0, 0.9], path),
        None if sun is None else Sun(sun, sun_radius),
        tuple(Occluder(np.array(at) * radius, size * radius) for at, size in moons),
    )


SCENES = {f"sun {octant}": scene(sun=octant) for octant in OCTANTS} | {
    "near camera": scene(distance=1.15),
    "far camera": scene(distance=232.0),
    "odd size": scene(size=(641, 479)),
    "tall odd size": scene(size=(123, 457)),
    "thin shell": scene(thickness=0.002),
    "thick shell": scene(thickness=1.5, distance=4.0),
    "sun behind planet": scene(sun=(-0.2, 0.9, -0.3)),
    "sun behind camera": scene(sun=(0.2, -0.9, 0.3)),
    "cylinder": scene(sun_radius=0.0),
    "apex in the shell": scene(thickness=1.5, distance=4.0, sun_radius=35.0),
    "no sun": scene(sun=None),
    "lengths": scene(distance=1.3, path="distance"),
    "eclipse": scene(thickness=0.3, moons=(((3.0, -1.9, 1.0), 0.3),)),
    "moon sixty radii away": scene(thickness=0.3, moons=(((53.7, -22.3, 16.4), 0.6),)),
    "three moons": scene(
        thickness=0.6,
        distance=4.0,
        sun=(0.6, 0.5, 0.3),
        moons=(((1.5, 0.5, 0.9), 0.5), ((0.3, -1.6, 0.9), 0.3), ((1.8, 0.7, 1.7), 0.4)),
    ),
}


def by_chance(rng: np.random.Generator) -> Scene:
    """A camera from the ground to 30 radii away, any sun, thin and thick shells, ground that
    mirrors where a map says."""
    away = rng.normal(size=3)
    place = away / np.linalg.norm(away) * rng.choice([1.002, 1.05, 1.5, 3.0, 30.0])
    distance = float(np.linalg.norm(place))
    x, y, z = (float(c) for c in rng.normal(size=3))
    made = scene_of(
        tuple(place),
        tuple(rng.normal(size=3) * 0.5),
        (x, y, z),
        fov=float(np.degrees(min(2.4 / distance, 1.2))),
        shell=float(rng.choice([0.002, 0.02, 0.2])),
        near=max(distance - 1.5, 1e-3),
        far=distance + 1.5,
        path=str(rng.choice(["depth", "distance"])),
        size=(48, 36),
    )
    maps = REPOSITORY / "examples"
    albedo, water = (str(maps / f"planet_{name}") for name in ("albedo.jpg", "water.png"))
    return replace(made, planet=replace(made.planet, albedo=albedo, water=water, triangles=5000))


def plant_fault(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """A parameter of looks reaches the shader a percent too small."""
    from render_gl import _raster

    drawn = _raster.look_uniforms

    def faulty(look: Any) -> dict[str, Any]:
        found = drawn(look)
        if name in found:  # accuracy is measured with another look
            wrong = np.multiply(found[name], 0.99).tolist()
            found[name] = tuple(wrong) if isinstance(found[name], tuple) else wrong
        return found

    monkeypatch.setattr(_raster, "look_uniforms", faulty)
