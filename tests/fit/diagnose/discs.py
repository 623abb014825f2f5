"""Planets without air: bare discs, and the Moon."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from model_jax import Atmosphere, Camera, Planet, Scene, Sun


def disc_scene(
    size: tuple[int, int],
    circle: tuple[float, float, float],
    height: float,
    sun: Sun | None = None,
) -> Scene:
    """A planet of radius 1, from 200 radii, whose outline is a circle (x, y, radius) in pixels."""
    (rows, columns), (x, y, radius), far = size, circle, 200.0
    focal = radius * np.sqrt(far**2 - 1)
    camera = Camera(
        position=(0.0, 0.0, far),
        forward=(-(x + 0.5 - columns / 2) / focal, (y + 0.5 - rows / 2) / focal, -1.0),
        up=(0.0, 1.0, 0.0),
        fov_y_deg=2 * np.degrees(np.arctan(rows / 2 / focal)),
        width=columns,
        height=rows,
        near=far - 2,
        far=far + 2,
    )
    return Scene(camera, Planet(radius=1.0), Atmosphere(height=height), sun)


def full_moon(x: float, y: float) -> np.ndarray:
    return moon(x, y, 1.5, np.ones_like)


def moon(x: float, y: float, blur: float, shade: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """A grey disc of radius 60, 200² px; drawn four times finer, blurred, reduced."""
    fine = (np.arange(800) + 0.5) / 4 - 0.5
    right, down = np.meshgrid((fine - x) / 60, (fine - y) / 60)
    light = np.where(np.hypot(right, down) < 1, shade(right), 0) * 0.6
    light = gaussian_filter(light, 4 * blur).reshape(200, 4, 200, 4).mean(axis=(1, 3))
    return light[..., None] * np.array([1.0, 0.95, 0.85])
