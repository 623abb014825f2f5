"""jit, vmap and grad compose: over looks, over scenes, inside one another."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import Layers, LayersLook, Scene, analytic_layers, combine, layer_widths

from .scenes import OCTANTS

SCENE_LIST = list(OCTANTS.values())[:3]


def cast(tree: Any, dtype: np.dtype) -> Any:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), tree)


def stack(trees: list, dtype: np.dtype) -> object:
    return jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(v, dtype) for v in leaves]), *trees)


def test_vmap_over_looks(dtype: np.dtype) -> None:
    layers = analytic_layers(SCENE_LIST[2], dtype)
    looks = [
        LayersLook(1.0, 0.1),
        LayersLook(2.0, 0.3, (0.5, 1.0, 1.5)),
        LayersLook(4.0, 0.9, background=0.2),
    ]
    together = jax.jit(jax.vmap(combine, in_axes=(None, 0)))(layers, stack(looks, dtype))
    for look, picture in zip(looks, together, strict=True):
        expected = combine(layers, look)
        # The batched program may fuse differently: a few ulp of the brightest pixel.
        atol = 8 * np.finfo(dtype).eps * float(expected.max())
        np.testing.assert_allclose(picture, expected, rtol=0, atol=atol)


def test_vmap_over_scenes(dtype: np.dtype) -> None:
    """Bit for bit up to fusion: both sides prepare the view from traced numbers."""
    together = jax.jit(jax.vmap(lambda scene: analytic_layers(scene, dtype)))(
        stack(SCENE_LIST, dtype)
    )
    assert isinstance(together, Layers)
    assert together.front.shape == (3, 25, 33)
    for k, scene in enumerate(SCENE_LIST):
        alone = eqx.filter_jit(analytic_layers)(cast(scene, dtype), dtype)
        one = jax.tree.map(lambda leaf, k=k: leaf[k], together)
        for a, b in zip(layer_widths(one), layer_widths(alone), strict=True):
            difference = np.abs(np.asarray(a, np.float64) - np.asarray(b, np.float64))
            # As in test_analytic: 16 roundings of 3 radii, and their square root at the limb.
            move = 16 * 3 * np.finfo(dtype).eps
            span = float(alone.width_unit) / scene.planet.radius
            assert difference.max() * span <= 2 * np.sqrt(2 * move)
            assert np.median(difference) * span <= move


@pytest.mark.usefixtures("x64")
def test_grad_of_vmap_of_scene_and_look() -> None:
    """A loss summed over three scenes with a look each: every gradient is finite, and the look's
    is the one that each scene gives alone."""
    dtype = np.dtype("float64")
    looks = [LayersLook(1.0, 0.1), LayersLook(2.0, 0.3), LayersLook(4.0, 0.9)]
    scenes, stacked = stack(SCENE_LIST, dtype), stack(looks, dtype)

    def one(scene: Scene, look: LayersLook) -> jax.Array:
        return jnp.mean(combine(analytic_layers(scene, dtype), look)[..., :3] ** 2)

    def loss(scenes: Scene, looks: LayersLook) -> jax.Array:
        return jnp.sum(jax.vmap(one)(scenes, looks))

    gradient = jax.jit(jax.grad(one, 1))
    by_scene, by_look = jax.jit(jax.grad(loss, (0, 1)))(scenes, stacked)
    for leaf in jax.tree.leaves((by_scene, by_look)):
        assert np.all(np.isfinite(leaf))
    # Sums of 825 pixels whose grazing ones differ by rounding: √eps of one pixel of many.
    tolerance = float(np.sqrt(np.finfo(dtype).eps))
    for k, look in enumerate(looks):
        alone = gradient(cast(SCENE_LIST[k], dtype), cast(look, dtype))
        assert float(alone.brightness) > 0
        np.testing.assert_allclose(by_look.brightness[k], alone.brightness, rtol=tolerance)
        np.testing.assert_allclose(by_look.shadow[k], alone.shadow, rtol=tolerance)


def test_hessian_of_a_quadratic_loss_is_the_normal_matrix(dtype: np.dtype) -> None:
    """combine is linear in the background and in brightness: grad of grad equals 2 AᵀA."""
    layers = analytic_layers(SCENE_LIST[2], dtype)

    def loss(brightness: jax.Array) -> jax.Array:
        return jnp.sum(combine(layers, LayersLook(brightness=brightness))[..., :3] ** 2)

    hessian = jax.jit(jax.grad(jax.grad(loss)))(jnp.asarray(2.0, dtype))
    expected = 2 * float(loss(jnp.asarray(1.0, dtype)))
    assert expected > 0
    # 825 · 3 rounded terms, all of one sign.
    np.testing.assert_allclose(hessian, expected, rtol=2475 * np.finfo(dtype).eps)
