"""The synthetic case that all contestants fit: scene, photo, truth, and one row of results."""

import json
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import (
    Atmosphere,
    Camera,
    Layers,
    LayersLook,
    Planet,
    Response,
    Scene,
    Sun,
    analytic_layers,
    composite,
)
from render_gl._scene_file import scene_record

from ..photo._columns import Columns
from ..solve._declare import declare
from ..solve._layout import Layout
from ..solve._loss import Loss
from ..solve._model import Model
from ..solve._problem import Problem
from ..solve._samples import on_device, to_samples

TRUTH = LayersLook(brightness=3.0, shadow=0.2, tint=np.array([0.8, 0.9, 1.3]))
FREE = ("brightness", "shadow", "tint")
NOISE = 0.02
"""Five of 256 codes, some noise of a photo: time does not depend on it."""
NOISE_SEED = 20261123
SIZE = (1280, 1024)
"""The paper's picture."""
LARGE = (4928, 2768)
"""13.6 megapixels, a full-frame camera's."""


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    pixels: int
    """Pixels of air."""
    median: float | None
    """Seconds; None where the row is no time."""
    low: float | None
    high: float | None
    error: float | None
    """Largest relative difference of a parameter from the optimum; None where there is none."""
    note: str


def _scene(width: int, height: int) -> Scene:
    """Air in front of space fills nearly half the picture."""
    return Scene(
        camera=Camera(
            position=np.array([0, 0, 3.2]),
            forward=np.array([0, 0, -1.0]),
            up=np.array([0, 1.0, 0]),
            fov_y_deg=60,
            width=width,
            height=height,
            near=0.5,
            far=6,
        ),
        planet=Planet(radius=0.9),
        atmosphere=Atmosphere(height=0.68),
        sun=Sun(direction=np.array([1, 0.2, 0.3])),
    )


def make_picture(width: int, height: int) -> tuple[Layers, Float[np.ndarray, "h w 3"]]:
    """Layers of the scene, and a noisy photo."""
    layers = jax.tree.map(np.asarray, analytic_layers(_scene(width, height), jnp.float32))
    clean = np.asarray(composite(layers, TRUTH), np.float32)[..., :3]
    noise = np.random.default_rng(NOISE_SEED).normal(scale=NOISE, size=clean.shape)
    return layers, (clean + noise).astype(np.float32)


def case_problem(columns: Columns, more: tuple[str, ...]) -> tuple[Problem, Any]:
    parameters = declare(LayersLook(1.0, 0.5), [Response()], free=(*FREE, *more))
    samples = on_device(to_samples([columns]))
    model = Model(Loss("linear"), None, Layout(LayersLook), not more)
    return Problem((columns,), samples, parameters, model), parameters


def scene_text(width: int, height: int) -> str:
    """The scene as a file."""
    lines = []
    for name, keys in scene_record(_scene(width, height)).items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    return "\n".join(lines)
