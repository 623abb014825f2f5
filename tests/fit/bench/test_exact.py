"""Two ways to exact widths that share no line: world axes in 50 digits, eye axes in float64."""

import jax.numpy as jnp
import numpy as np
import pytest

from fit._compile import float64
from fit.bench._exact import exact_widths
from fit.bench._render_points import widths
from fit.bench._scenes import extreme, synthetic
from model_jax import Scene, analytic_layers
from render_gl import load_scene
from render_gl._accuracy import smooth
from tests.data import REPOSITORY


def _scenes() -> dict[str, Scene]:
    files = {
        name: smooth(load_scene(REPOSITORY / "examples" / f"{name}.toml").scene)
        for name in ("paper", "reference", "rim", "gradient")
    }
    return files | {"synthetic": synthetic(640, 512), "extreme": extreme()}


@pytest.mark.parametrize("name", ["paper", "reference", "rim", "gradient", "synthetic", "extreme"])
def test_float64_has_its_digits(name: str) -> None:
    """Rounding of a ray's place, some eps of the camera's distance in shell heights, moves a
    surface; a width near tangency moves by its root."""
    scene = _scenes()[name]
    with float64():
        found = widths(analytic_layers(scene, jnp.float64))
    air = np.argwhere(found.sum(axis=0) > 0)
    row, column = air[np.random.default_rng(3).integers(0, len(air), 1000)].T
    right = np.stack(exact_widths(scene, row, column))
    apart = np.abs(found[:, row, column] - right) / float(scene.atmosphere.height)
    radius = float(scene.planet.radius)
    distance = float(np.linalg.norm(np.asarray(scene.camera.position)))
    place = 64 * np.finfo(np.float64).eps * (distance + radius) / float(scene.atmosphere.height)
    assert np.median(apart) < place
    assert apart.max() < 10 * np.sqrt(place)
    assert right.sum() > 0
