"""Widths of air by search along each ray: the oracle of `analytic_layers`.

Independent of the library's formulas and of its preparation of the view: rays are written down from
the scene file's conventions (DESIGN §3), bodies are known only by a signed function (negative
inside), and entry and exit are found by search. Every body is convex (ball, capped cone, half-
infinite cylinder) and its function is convex along a line, so a ternary search finds the deepest
point and bisection the two ends. Float64 NumPy throughout.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np

from model_jax import Scene, Sun

Signed = Callable[[np.ndarray], np.ndarray]


class Widths(NamedTuple):
    """Eye depths or, if the scene asks for it, lengths along rays [h, w], scene length units."""

    lit: np.ndarray
    dark: np.ndarray


class March:
    """The search of one scene. Deepest points and edges are kept, for they are asked for again."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        radius = float(scene.planet.radius)
        top = radius + float(scene.atmosphere.height)
        origin, directions = camera_rays(scene)
        reach = np.linalg.norm(origin) + 2 * top
        self.size = directions.shape[:-1]
        lengths = np.linalg.norm(directions, axis=-1)
        self.stretch = lengths if scene.atmosphere.path == "distance" else np.ones(self.size)
        self.start, self.end = np.full(self.size, -reach), np.full(self.size, reach)

        def point(t: np.ndarray) -> np.ndarray:
            return origin + t[..., None] * directions

        def ball(size: float, center: np.ndarray) -> Signed:
            return lambda t: np.linalg.norm(point(t) - center, axis=-1) - size

        def umbra(size: float, center: np.ndarray, sun: Sun) -> Signed:
            def signed(t: np.ndarray) -> np.ndarray:
                p = point(t) - center
                along = p @ sun.direction
                across = np.linalg.norm(p - along[..., None] * sun.direction, axis=-1)
                slope = np.tan(np.deg2rad(float(sun.angular_radius_deg)))
                # Behind the apex `across ≤ size + slope·along` cannot hold: it is positive there.
                return np.maximum(across - size - slope * along, along)

            return signed

        middle = np.zeros(3)
        solids = [(radius, middle)] + [(float(o.radius), o.center) for o in scene.occluders]
        self.bodies = {"shell": ball(top, middle)}
        for k, (size, center) in enumerate(solids):
            self.bodies[f"solid {k}"] = ball(size, center)
            if scene.sun is not None:
                self.bodies[f"shadow {k}"] = umbra(size, center, scene.sun)
        self.count = len(solids)
        self.inside = cache(self._inside)
        self._deepest = cache(lambda body: deepest(self.bodies[body], self.start, self.end))

    def widths(self, ground: float = 0.0, shell: float = 0.0, shadow: float = 0.0) -> Widths:
        """Lit and shadowed lengths of air; bodies may be swollen by a length (shrunk, if < 0)."""
        near, far = float(self.scene.camera.near), float(self.scene.camera.far)
        enter, leave = self.inside("shell", shell)
        for k in range(self.count):
            hit_from, hit_to = self.inside(f"solid {k}", ground)
            hit = (hit_to > hit_from) & (hit_to > near) & (hit_from < far)
            leave = np.where(hit, np.minimum(leave, hit_from), leave)
        enter, leave = np.clip(enter, near, far), np.clip(leave, near, far)
        air = np.maximum(leave - enter, 0)
        if self.scene.sun is None:
            return Widths(air * self.stretch, np.zeros(self.size))
        found = [self.inside(f"shadow {k}", shadow) for k in range(self.count)]
        parts = [tuple(np.clip(end, enter, leave) for end in ends) for ends in found]
        dark = union(parts) * (leave > enter)
        return Widths((air - dark) * self.stretch, dark * self.stretch)

    def _inside(self, body: str, swollen: float) -> tuple[np.ndarray, np.ndarray]:
        """Where each ray enters and leaves a body; of zero length where it does neither."""
        signed, middle = self.bodies[body], self._deepest(body)
        met = signed(middle) <= swollen

        def edge(outer: np.ndarray) -> np.ndarray:
            outside, within = outer, middle
            for _ in range(56):  # 2^-56 of the span, below its rounding
                half = (outside + within) / 2
                here = signed(half) <= swollen
                outside, within = np.where(here, outside, half), np.where(here, half, within)
            found = np.where(signed(outer) <= swollen, outer, (outside + within) / 2)
            return np.where(met, found, middle)

        return edge(self.start), edge(self.end)


def union(parts: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Length that intervals cover together: cut at all their ends, count the pieces inside any."""
    cuts = np.sort(np.stack([end for part in parts for end in part]), axis=0)
    middles, lengths = (cuts[1:] + cuts[:-1]) / 2, np.diff(cuts, axis=0)
    inside = np.any([(begin < middles) & (middles < end) for begin, end in parts], axis=0)
    return np.sum(lengths * inside, axis=0)


def deepest(signed: Signed, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Where a convex function is least, by ternary search."""
    for _ in range(90):  # (2/3)^90 = 1e-16 of the span
        third = (high - low) / 3
        left_lower = signed(low + third) < signed(high - third)
        low = np.where(left_lower, low, low + third)
        high = np.where(left_lower, high - third, high)
    return (low + high) / 2


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
