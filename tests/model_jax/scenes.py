"""The scenes that several tests share, by name: where the camera can stand and the sun can be."""

import itertools

import numpy as np

from model_jax import Atmosphere, Camera, Occluder, Planet, Scene, Sun

RADIUS = 6371.0
"""Most scenes are of Earth's size in kilometres, so that a forgotten unit shows."""


def scene_of(
    position: tuple[float, float, float],
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    sun: tuple[float, float, float] | None = (0.3, 0.5, 0.2),
    *,
    fov: float = 40.0,
    size: tuple[int, int] = (33, 25),
    shell: float = 0.1,
    angular_radius: float = 0.2666,
    near: float = 1e-3,
    far: float | None = None,
    radius: float = RADIUS,
    moons: tuple[tuple[tuple[float, float, float], float], ...] = (),
    path: str = "depth",
) -> Scene:
    """A scene with positions and lengths in planet radii; `size` is width × height: odd, so that
    the middle pixel looks along the axis, and mostly the same, so that JAX compiles once."""
    place, aim = np.array(position), np.array(target)
    forward = aim - place
    up = (0.0, 0.0, 1.0) if abs(forward[2]) < 0.9 * np.linalg.norm(forward) else (0.0, 1.0, 0.0)
    end: float | np.floating = np.linalg.norm(place) + 3.0 if far is None else far
    return Scene(
        Camera(place * radius, forward, up, fov, *size, near * radius, end * radius),
        Planet(radius),
        Atmosphere(shell * radius, (0.5, 0.7, 1.0), path),
        None if sun is None else Sun(sun, angular_radius),
        tuple(Occluder(np.array(at) * radius, size * radius) for at, size in moons),
    )


OCTANTS = {
    f"sun {x:+d}{y:+d}{z:+d}": scene_of((-0.4, -2.6, 0.7), sun=(0.9 * x, 0.7 * y, 0.5 * z))
    for x, y, z in itertools.product((-1, 1), repeat=3)
}
PLACES = {
    "near": scene_of((1.05, 0.4, 0.5), (0.0, 1.5, 0.6), fov=70.0, sun=(-0.6, 0.4, 0.1)),
    "far, 232 radii": scene_of((140.0, -185.0, 15.0), fov=0.62, sun=(0.2, 1.0, 0.4)),
    "far, off axis": scene_of((232.0, 0.0, 0.0), (0.0, 0.9, 0.7), fov=0.5, sun=(-0.1, 0.8, 0.3)),
    "in the shell": scene_of((0.0, -1.05, 0.02), (0.8, 0.4, 0.5), fov=75.0, sun=(0.8, 0.2, -0.3)),
    "in shell, by the ground": scene_of(
        (0.0, 0.0, 1.001), (1.0, 0.3, 1.1), (0.9, 0, -0.4), fov=60.0
    ),
    "in the shadow": scene_of((0.3, -2.0, 0.2), sun=(0.0, 1.0, 0.1), fov=75.0),
    "in shadow and shell": scene_of((0.0, -1.1, 0.0), (1.0, 0.1, 0.3), sun=(0, 1, 0), shell=0.3),
    "planet behind": scene_of((0.0, -3.0, 0.0), (0.0, -6.0, 1.0)),
    "planet off screen": scene_of((0.0, -4.0, 0.0), (4.0, 0.0, 0.0), fov=30.0),
    "wide field": scene_of((0.0, -1.6, 0.4), (0.2, 0.0, 0.1), fov=150.0, sun=(0.9, 0.2, -0.2)),
    "odd sizes": scene_of((0.0, -3.0, 1.0), size=(37, 53)),
    "one pixel": scene_of((0.0, -3.0, 0.0), (0.0, 0.0, 1.04), size=(1, 1), sun=(0.2, 0.9, 0.1)),
    "cut by near plane": scene_of((0.0, -2.0, 0.3), near=0.95),
    "cut by far plane": scene_of((0.0, -2.0, 0.3), far=1.9),
    "no sun": scene_of((0.0, -3.0, 0.3), sun=None),
}
SHAPES = {
    "thin shell": scene_of((0.5, -2.5, 0.4), shell=0.002, fov=50.0),
    "thick shell": scene_of((0.5, -4.5, 0.4), shell=1.5, fov=60.0, sun=(0.7, 0.6, -0.2)),
    "apex in the shell": scene_of((1.0, -2.5, 0.5), shell=0.5, angular_radius=35.0, fov=50.0),
    "apex in planet": scene_of((1.0, -2.5, 0.5), shell=0.5, angular_radius=75.0, fov=50.0),
    "cylinder": scene_of((0.5, -2.5, 0.4), angular_radius=0.0, shell=0.2, fov=50.0),
}
AXES = {
    "sun behind camera": scene_of((0.0, -3.0, 0.0), sun=(0.0, -1.0, 0.0), fov=45.0),
    "sun behind planet": scene_of((0.0, -3.0, 0.0), sun=(0.0, 1.0, 0.0), fov=45.0),
    "along cylinder": scene_of((0.0, -3.0, 0.0), sun=(0.0, 1.0, 0.0), angular_radius=0.0, fov=45.0),
    "against cylinder": scene_of(
        (0.0, -3.0, 0.0), sun=(0.0, -1.0, 0.0), angular_radius=0.0, fov=45.0
    ),
    # tan 10° is the slope of the cone and of some rays: the quadratic's leading term vanishes.
    "along the cone": scene_of(
        (0.0, -3.0, 0.0), sun=(0.0, 1.0, 0.0), angular_radius=10.0, fov=40.0
    ),
}
# The middle pixel of an odd picture looks along the axis and touches the body exactly.
TANGENT = {
    "tangent to planet": scene_of(
        (1.0, -5.0, 0.0), (1.0, 0.0, 0.0), fov=40.0, sun=(0.4, 0.6, 0.1), radius=1.0
    ),
    "tangent to shell": scene_of(
        (1.25, -5.0, 0.0), (1.25, 0.0, 0.0), fov=40.0, shell=0.25, radius=1.0
    ),
    "grazing the cylinder": scene_of(
        (1.0, -5.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0),
        fov=40.0, shell=0.25, radius=1.0, angular_radius=0.0,
    ),
}  # fmt: skip
ECLIPSES = {
    "moon before the sun": scene_of(
        (-1.5, -2.5, 0.6), sun=(-0.6, -0.7, 0.2), shell=0.3, moons=(((-3.0, -3.5, 1.0), 0.4),)
    ),
    "moon sixty radii away": scene_of(
        (-0.5, -3.0, 0.4), sun=(-0.6, -0.7, 0.2), shell=0.3,
        moons=(((-38.0, -44.2, 12.9), 0.7),),
    ),
    "annular": scene_of(
        (-0.5, -3.0, 0.4), sun=(-0.6, -0.7, 0.2), shell=0.3, angular_radius=2.0,
        moons=(((-38.0, -44.2, 12.9), 0.7),),
    ),
    "moon before the air": scene_of(
        (0.3, -4.0, 0.4), sun=(0.9, 0.1, 0.2), shell=0.3, moons=(((0.5, -2.0, 0.9), 0.15),)
    ),
    "moon in the air": scene_of(
        (0.3, -4.0, 0.4), sun=(0.9, -0.4, 0.2), shell=0.6, moons=(((0.7, -1.1, 0.5), 0.2),)
    ),
    "shadows overlap": scene_of(
        (0.3, -4.0, 0.9), sun=(0.9, 0.3, 0.2), shell=0.8,
        moons=(((1.8, -0.3, 1.0), 0.5), ((-0.6, -0.9, 1.1), 0.3), ((2.5, 0.4, 1.6), 0.45)),
    ),
    "shadow in shadow": scene_of(
        (0.3, -4.0, 0.4), sun=(0.9, 0.3, 0.2), shell=0.8, moons=(((-1.3, -0.5, -0.3), 0.2),)
    ),
    "in the moon's shadow": scene_of(
        (0.0, -2.6, 0.0), sun=(0.0, -1.0, 0.0), shell=0.8, moons=(((0.1, -3.5, 0.05), 0.3),)
    ),
    "moon behind the camera": scene_of(
        (0.0, -2.6, 0.0), sun=(0.5, -0.9, 0.2), shell=0.8, moons=(((0.0, -3.0, 0.05), 0.3),)
    ),
    "moon beside the camera, far": scene_of(
        (140.0, -185.0, 15.0), fov=0.62, sun=(0.2, -1.0, 0.4), shell=0.2,
        moons=(((1.0, -2.7, 0.6), 0.3), ((139.0, -186.0, 14.0), 0.2)),
    ),
}  # fmt: skip
LENGTHS = {
    "lengths": scene_of((0.3, -2.0, 0.4), fov=80.0, path="distance"),
    "lengths, wide field": scene_of(
        (0.0, -1.6, 0.4), (0.2, 0.0, 0.1), fov=150.0, sun=(0.9, 0.2, -0.2), path="distance"
    ),
    "lengths, in the shell": scene_of(
        (0.0, -1.05, 0.02), (0.8, 0.4, 0.5), fov=75.0, sun=(0.8, 0.2, -0.3), path="distance"
    ),
}


def anywhere(
    place: str, gaze: str, size: tuple[int, int] = (33, 25), angular_radius: float = 5.0
) -> Scene:
    """A camera at one of `STANDS` that looks along one of `GAZES`; the sun is a wide one, so that
    generatrices of its cone of shadow are no lines along its axis."""
    sun = np.array([0.3, 0.5, 0.2]) / np.sqrt(0.38)
    axis, side = -sun, np.array([0.5, -0.3, 0.0]) / np.sqrt(0.34)
    height, angle = STANDS[place]
    at = height * (np.cos(angle) * axis + np.sin(angle) * side)
    slope = np.tan(np.deg2rad(angular_radius))
    across = at - (at @ axis) * axis
    away = across / np.linalg.norm(across)
    up = at / height
    # The tangent from `at` touches the planet at the angle acos(1 / height) from `up`.
    touch = up / height + np.sqrt(max(1 - height**-2, 0)) * np.cross(up, np.cross(away, up))
    touch = touch - at if height > 1 else np.cross(up, np.cross(away, up))
    forward = {
        "at the planet": -at,
        "away": at,
        "along the axis": axis,
        "against the axis": -axis,
        "along a generatrix": axis - slope * away,
        "against a generatrix": slope * away - axis,
        "at the limb": touch,
    }[gaze]
    return scene_of(
        tuple(at),
        tuple(at + forward),
        tuple(sun),
        fov=70.0,
        size=size,
        near=1e-6,
        shell=0.2,
        angular_radius=angular_radius,
    )


STANDS = {
    "outside": (2.5, 2.0),
    "in the shell": (1.1, 1.9),
    "on the ground": (1.0, 1.9),
    "in the cone": (2.2, 0.2),
    "in cone and shell": (1.1, 0.5),
    "on dark ground": (1.0, 0.7),
}
"""Where a camera can be: planet radii, and angle off the axis of the shadow, radians."""
GAZES = (
    "at the planet", "away", "along the axis", "against the axis", "along a generatrix",
    "against a generatrix", "at the limb",
)  # fmt: skip
ANYWHERE = {f"{place}, {gaze}": anywhere(place, gaze) for place in STANDS for gaze in GAZES}
EXTREMES = {
    # The paper's Fig. 11: the near plane cuts the front of the shadow.
    "near plane in the shadow": scene_of((0.6, -2.0, 0.3), sun=(0.5, 0.7, 0.1), near=1.3),
    "shell of 1e-4": scene_of((0.5, -2.5, 0.4), shell=1e-4, fov=50.0),
    "shell of 2": scene_of((0.5, -5.5, 0.4), shell=2.0, fov=70.0, sun=(0.7, 0.6, -0.2)),
    "field of 0.1 degrees": scene_of((0.0, -3.0, 0.0), (1.03, 0.0, 0.1), (-0.9, 0.2, 0.1), fov=0.1),
    "only the shell": scene_of(
        (0.0, -3.0, 0.0), (1.2, 0.0, 0.0), (-0.9, 0.2, 0.1), fov=4.0, shell=0.3
    ),
    "a metre above the ground": scene_of(
        (0.0, 0.0, 1 + 1.57e-7), (0.3, 1.0, 1.1), sun=(0.6, -0.3, -0.2), fov=60.0, near=1e-8
    ),
    "a million radii away": scene_of((1e6, 0.0, 0.0), (0.0, 0.9, 0.7), (0.1, -0.8, -0.3), fov=1e-4),
}  # fmt: skip
SCENES = OCTANTS | PLACES | SHAPES | AXES | TANGENT | ECLIPSES | LENGTHS | EXTREMES | ANYWHERE
