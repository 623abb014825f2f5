"""Layers of the small scene, and a photo of it that no look explains."""

import jax
import numpy as np
import pytest

from model_jax import (
    Layers,
    analytic_layers,
)

from .looks import TRUTH, exact_layers, picture, scene


@pytest.fixture(scope="module")
def layers() -> Layers:
    return analytic_layers(scene())


@pytest.fixture(scope="module")
def layers64() -> Layers:
    return exact_layers(scene())


@pytest.fixture(scope="module")
def noisy(layers64: Layers) -> np.ndarray:
    """A photo that the model does not explain: noise, and a ramp that is no air."""
    rng = np.random.default_rng(7)
    with jax.enable_x64(True):
        clean = picture(layers64, TRUTH)
    ramp = np.linspace(0, 0.1, clean.shape[1])[:, None]
    return clean + ramp + rng.normal(scale=0.05, size=clean.shape)
