"""The JAX API in one page: the gradient of an image loss with respect to the look.

Makes a picture with one look, starts from another, and walks down the gradient of their squared
difference. Needs no OpenGL: the layers come from exact intersection. A picture tells brightness and
tint only as a product, so that is what the descent finds.

    python examples/gradient.py
"""

from pathlib import Path

import jax
import jax.numpy as jnp

from model_jax import LayersLook, analytic_layers, combine
from render_gl import load_scene

scene = load_scene(Path(__file__).parent / "reference.toml").scene
layers = analytic_layers(scene)
target = combine(layers, LayersLook(brightness=2.0, shadow=0.5, tint=[1.2, 1.0, 0.8]))


@jax.jit
def loss(look: LayersLook) -> jax.Array:
    """Mean squared difference to the target, over pixels and channels."""
    return jnp.mean((combine(layers, look) - target) ** 2)


def descend(look: LayersLook, steps: int = 200) -> LayersLook:
    """Plain gradient descent; the step is the inverse of the largest curvature's order."""
    gradient = jax.jit(jax.grad(loss))
    rate = (
        0.5 * float(loss(look)) / sum(float(jnp.sum(g**2)) for g in jax.tree.leaves(gradient(look)))
    )
    for _ in range(steps):
        look = jax.tree.map(lambda value, slope: value - rate * slope, look, gradient(look))
    return look


if __name__ == "__main__":
    start = LayersLook()
    print(f"loss at the start   {loss(start):.3e}")
    print(f"gradient            {jax.grad(loss)(start).brightness:.3e} by brightness")
    end = descend(start)
    print(f"loss at the end     {loss(end):.3e}")
    print(f"brightness · tint   {end.brightness * end.tint} (target [2.4 2.  1.6])")
    print(f"shadow              {end.shadow:.3f} (target 0.5)")
