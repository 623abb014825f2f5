"""Widths of air by search along each ray: the oracle of `analytic_layers`.

Independent of the library's formulas and of its preparation of the view: rays are written down from
the scene file's conventions (DESIGN §3), bodies are known only by a signed function (negative
inside), and entry and exit are found by search. Every body is convex (ball, capped cone, half-
infinite cylinder) and its function is convex along a line, so a ternary search finds the deepest
point and bisection the two ends. Float64 NumPy throughout.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from model_jax import Scene

Signed = Callable[[np.ndarray], np.ndarray]


class Widths(NamedTuple):
    """Eye-depth lengths [h, w], scene length units."""

    lit: np.ndarray
    dark: np.ndarray


def march(scene: Scene, ground: float = 0.0, shell: float = 0.0, shadow: float = 0.0) -> Widths:
    """Lit and shadowed lengths of air; each body may be swollen by a length (or shrunk, if < 0)."""
    radius = float(scene.planet.radius)
    top = radius + float(scene.atmosphere.height)
    origin, directions = camera_rays(scene)

    def point(t: np.ndarray) -> np.ndarray:
        return origin + t[..., None] * directions

    def ball(size: float) -> Signed:
        return lambda t: np.linalg.norm(point(t), axis=-1) - size

    def umbra(t: np.ndarray) -> np.ndarray:
        p = point(t)
        along = p @ scene.sun.direction
        across = np.linalg.norm(p - along[..., None] * scene.sun.direction, axis=-1)
        slope = np.tan(np.deg2rad(float(scene.sun.angular_radius_deg)))
        # Behind the apex `across ≤ radius + slope·along` cannot hold: the function is positive.
        return np.maximum(across - radius - slope * along, along) - shadow

    reach = np.linalg.norm(origin) + 2 * top
    size = directions.shape[:-1]
    start, end = np.full(size, -reach), np.full(size, reach)
    near, far = float(scene.camera.near), float(scene.camera.far)

    enter, leave = inside(ball(top + shell), start, end)
    hit_from, hit_to = inside(ball(radius + ground), start, end)
    hit = (hit_to > hit_from) & (hit_to > near) & (hit_from < far)
    leave = np.where(hit, np.minimum(leave, hit_from), leave)
    enter, leave = np.clip(enter, near, far), np.clip(leave, near, far)
    air = np.maximum(leave - enter, 0)
    if scene.sun is None:
        return Widths(air, np.zeros(size))
    dark_from, dark_to = inside(umbra, start, end)
    dark_from, dark_to = np.maximum(dark_from, enter), np.minimum(dark_to, leave)
    dark = np.maximum(dark_to - dark_from, 0)
    return Widths(air - dark, dark)


def camera_rays(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Camera position [3] and ray directions [h, w, 3] of unit eye depth; row 0 on top."""
    camera = scene.camera
    right = np.cross(camera.forward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, camera.forward)
    top = np.tan(np.deg2rad(float(camera.fov_y_deg)) / 2)
    across = (np.arange(camera.width) + 0.5) / camera.width * 2 - 1
    down = (np.arange(camera.height) + 0.5) / camera.height * 2 - 1
    x = across[None, :, None] * top * camera.width / camera.height
    y = -down[:, None, None] * top
    return np.asarray(camera.position), camera.forward + x * right + y * up


def inside(signed: Signed, start: np.ndarray, end: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a convex function is ≤ 0 between start and end; of zero length where nowhere."""
    low, high = start, end
    for _ in range(90):  # (2/3)^90 = 1e-16 of the span
        third = (high - low) / 3
        left_lower = signed(low + third) < signed(high - third)
        low = np.where(left_lower, low, low + third)
        high = np.where(left_lower, high - third, high)
    deepest = (low + high) / 2
    met = signed(deepest) <= 0

    def bisect(outer: np.ndarray) -> np.ndarray:
        out, within = outer, deepest
        for _ in range(56):  # 2^-56 of the span, below its rounding
            middle = (out + within) / 2
            here = signed(middle) <= 0
            out, within = np.where(here, out, middle), np.where(here, middle, within)
        edge = (out + within) / 2
        return np.where(signed(outer) <= 0, outer, edge)

    first, last = bisect(start), bisect(end)
    return np.where(met, first, deepest), np.where(met, last, deepest)
