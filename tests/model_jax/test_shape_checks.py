"""The run-time checks are switched on: a transposed image fails, and so does a mixed-up rank."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import TypeCheckError

from model_jax import DepthTextures, Layers, LayersLook, combine, limb_height
from model_jax._intersect import squared_miss_distance

TALL, WIDE = np.zeros((4, 3), np.float32), np.zeros((3, 4), np.float32)


def test_the_right_shapes_pass() -> None:
    assert combine(Layers(WIDE, WIDE), LayersLook()).shape == (3, 4, 4)


@pytest.mark.parametrize(
    "fields",
    [
        {"front": WIDE, "back": TALL},
        {"front": WIDE, "back": WIDE, "shadow_front": TALL, "shadow_back": TALL},
        {"front": WIDE, "back": WIDE, "surface": np.zeros((4, 3, 3), np.float32)},
        {"front": WIDE, "back": WIDE, "surface": np.zeros((3, 3, 4), np.float32)},
        {"front": WIDE, "back": WIDE.astype(np.int32)},
    ],
    ids=["back", "shadow", "surface", "channels first", "integers"],
)
def test_a_transposed_image_fails(fields: dict[str, Any]) -> None:
    with pytest.raises(TypeCheckError):
        Layers(**fields)


def test_a_transposed_texture_fails() -> None:
    with pytest.raises(TypeCheckError):
        DepthTextures(WIDE, TALL, None, None, 1.0, 2.0, "window")


def test_a_wrong_argument_fails() -> None:
    with pytest.raises(TypeCheckError):
        combine(WIDE, LayersLook())  # type: ignore[arg-type]
    with pytest.raises(TypeCheckError):
        limb_height("scene.toml")  # type: ignore[arg-type]


def test_different_ranks_do_not_meet() -> None:
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.ones(4) + jnp.ones((3, 4))
    with pytest.raises(ValueError, match="rank_promotion"):
        squared_miss_distance(jnp.ones(4), jnp.ones((3, 1)), jnp.ones((1, 4)), jnp.ones((3, 1)))
