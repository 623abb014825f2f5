"""Exact layers against a search along every ray, and what they promise besides the widths."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ray_march import march
from scenes import PLACES, SCENES, scene_of

from model_jax import InputError, Scene, analytic_layers, eye_center, layer_widths, limb_height

STEPS = 16
"""Rounded operations between a ray's pixel index and the squared distances compared with radii²:
counted along `pixel_rays` → `ray_cone`, the longest chain."""


def lengths(scene: Scene, dtype: np.dtype) -> tuple[np.ndarray, np.ndarray]:
    """Lit and dark widths in scene units, float64 NumPy."""
    layers = analytic_layers(scene, dtype)
    lit, dark = layer_widths(layers)
    unit = float(layers.width_unit)
    lit = np.asarray(lit, np.float64) * unit
    return lit, np.zeros_like(lit) if dark is None else np.asarray(dark, np.float64) * unit


@pytest.mark.parametrize("name", SCENES)
def test_widths_equal_a_march_along_the_rays(name: str, dtype: np.dtype) -> None:
    """Backward error: rounding moves each surface by a few ulp of the outermost body's size.

    Near tangency a moved surface changes a chord by the square root of the move, and beside the
    limb by the whole chord behind the planet. Widths grow or shrink monotonically with each body,
    so the widths must lie between those of the march with all bodies moved to their worst sides.
    """
    scene = SCENES[name]
    size = float(scene.planet.radius + scene.atmosphere.height)
    distance = float(np.linalg.norm(scene.camera.position))
    off_axis = np.tan(np.deg2rad(float(scene.camera.fov_y_deg)) / 2)
    stretch = 1 + off_axis * max(1.0, scene.camera.width / scene.camera.height)
    eps, eps64 = np.finfo(dtype).eps, np.finfo(np.float64).eps
    # The march itself loses an ulp of the distance in `origin + t·direction`.
    move = STEPS * stretch * (eps * size + eps64 * distance)
    # Depths, clip planes included, are stored to half an ulp and subtracted in pairs.
    slack = 4 * stretch * (eps * size + eps64 * distance)
    lit, dark = lengths(scene, dtype)
    least = march(scene, ground=move, shell=-move, shadow=move)
    most = march(scene, ground=-move, shell=move, shadow=-move)
    assert_between(lit, least.lit, most.lit, slack, "lit")
    least = march(scene, ground=move, shell=-move, shadow=-move)
    most = march(scene, ground=-move, shell=move, shadow=move)
    assert_between(dark, least.dark, most.dark, slack, "dark")


def assert_between(
    value: np.ndarray, low: np.ndarray, high: np.ndarray, slack: float, what: str
) -> None:
    assert np.all(np.isfinite(value)), f"{what}: not finite"
    outside = np.maximum(low - value, value - high)
    row, column = np.unravel_index(np.argmax(outside), outside.shape)
    assert outside[row, column] <= slack, (
        f"{what} at row {row}, column {column}: {value[row, column]!r} not in "
        f"[{low[row, column]!r}, {high[row, column]!r}] ± {slack:.3g}; "
        f"{np.sum(outside > slack)} pixels wrong"
    )
