"""The combine step of the paper, in JAX: layers → widths → colour → picture.

`layer_widths` and `combine` are the contract: the same five lines as `combine.glsl`, in the same
order, so that they differ from the shader by rounding only. `composite` adds what the paper leaves
to the frame buffer: the surface behind the air and the background.

All are pure and dtype-generic (the layers' dtype decides), and every gradient is finite: the only
kinks are min/max ties, where JAX takes half of each side.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Float

from ._kinds import as_jax, need, need_array
from ._layers import Layers
from ._look import Look
from ._shapes import AnyArray, Depth, Rgba, Scalar, Shadows, Width


def layer_widths(layers: Layers) -> tuple[Width, Width | None]:
    """Lit and shadowed width of air along each pixel's ray, in units of `layers.width_unit`.

    Returns:
        `(lit, dark)`; `dark` is `None` when the layers have no shadow. Both are along the camera's
        axis (eye depth), as in the paper, unless the layers bring a `stretch`. `lit + dark` is the
        width of the air; rounding can make either negative by an ulp of the depths. What several
        shadows cover counts once.

    Twin: `layer_widths` in `combine.glsl`.
    """
    need("layers", layers, Layers)
    front = jnp.asarray(layers.front)
    unit = jnp.asarray(layers.width_unit, front.dtype)
    lit, dark = _depth_widths(layers)
    if layers.stretch is not None:
        stretch = jnp.asarray(layers.stretch, front.dtype)
        lit, dark = lit * stretch, None if dark is None else dark * stretch
    return lit / unit, None if dark is None else dark / unit


def _depth_widths(layers: Layers) -> tuple[Width, Width | None]:
    """Widths along the camera's axis, scene length units."""
    front, back = jnp.asarray(layers.front), jnp.asarray(layers.back)
    if layers.shadow_front is None or layers.shadow_back is None:
        return back - front, None
    if np.ndim(layers.shadow_front) > back.ndim:
        return _union_widths(front, back, layers.shadow_front, layers.shadow_back)
    shadow_back = jnp.minimum(jnp.maximum(layers.shadow_back, front), back)
    shadow_front = jnp.minimum(jnp.maximum(layers.shadow_front, front), back)
    lit = (back - shadow_back) + (shadow_front - front)
    return lit, shadow_back - shadow_front


def _union_widths(
    front: Depth, back: Depth, shadow_front: Shadows, shadow_back: Shadows
) -> tuple[Width, Width]:
    """Lengths between front and back, outside and inside the union of the shadows.

    From front to back, each shadow adds what lies beyond all that ended before; summing parts
    instead of subtracting lengths from the whole leaves nothing to cancel.
    """
    front, back = front[None], back[None]
    begin, end = (jnp.clip(depth, front, back) for depth in (shadow_front, shadow_back))
    order = jnp.argsort(begin, axis=0)
    begin, end = (jnp.take_along_axis(depth, order, axis=0) for depth in (begin, end))
    reached = jax.lax.cummax(end, axis=0)
    before = jnp.concatenate([front, reached[:-1]])
    lit = jnp.sum(jnp.maximum(begin - before, 0), axis=0) + (back[0] - reached[-1])
    dark = jnp.sum(jnp.maximum(end - jnp.maximum(begin, before), 0), axis=0)
    return lit, dark


def combine(layers: Layers, look: Look) -> Rgba:
    """Colour of the air: `brightness · color · tint · (lit + shadow · dark)`, and its alpha.

    Args:
        layers: depth layers [h, w] and the air's colour.
        look: brightness, shadow and tint; `background` is not part of the contract (`composite`).

    Returns:
        Linear light [h, w, 4]; alpha is the colour's where there is air and 0 elsewhere.

    Twin: `combine` in `combine.glsl`.
    """
    need("look", look, Look)
    lit, dark = layer_widths(layers)
    color = jnp.asarray(layers.color, lit.dtype)
    rgb = air_light(lit[..., None], None if dark is None else dark[..., None], color[:3], look)
    alpha = jnp.where(layers.has_air, color[3], 0)
    return jnp.concatenate([rgb, alpha[..., None].astype(lit.dtype)], axis=-1)


def air_light(
    lit: Float[AnyArray, "*shape 1"],
    dark: Float[AnyArray, "*shape 1"] | None,
    color: Float[AnyArray, "3"],
    look: Look,
) -> Float[AnyArray, "*shape 3"]:
    """Light of the air where its lit and shadowed widths are known, whoever measured them.

    Args:
        lit, dark: widths in `width_unit`s; `dark` None without shadow.
        color: linear RGB of the air.
    """
    need("look", look, Look)
    need_array("lit", lit, "[..., 1]")
    if dark is not None:
        need_array("dark", dark, "[..., 1]")
    color = as_jax("color", color)
    dtype = lit.dtype
    shape = (1,) * (lit.ndim - 1) + (-1,)
    width = lit
    if dark is not None:
        width = width + _per_channel(look.shadow, dtype, shape) * dark
    tinted = _per_channel(color, dtype, shape) * _per_channel(look.tint, dtype, shape)
    return jnp.asarray(look.brightness, dtype) * (tinted * width)


def composite(layers: Layers, look: Look) -> Rgba:
    """The picture: surface + air + background, and the coverage of both.

    Returns:
        Linear light [h, w, 4]. Without a surface layer the planet is black; alpha is 1 in front of
        the planet where the layers know it, else the air's.
    """
    air = combine(layers, look)
    rgb = air[..., :3] + _per_channel(look.background, air.dtype, (1, 1, -1))
    if layers.surface is not None:
        rgb = rgb + jnp.asarray(layers.surface, air.dtype)
    alpha = air[..., 3]
    if layers.planet is not None:
        alpha = jnp.maximum(alpha, jnp.asarray(layers.planet, air.dtype))
    return jnp.concatenate([rgb, alpha[..., None]], axis=-1)


def _per_channel(
    value: Scalar | AnyArray, dtype: DTypeLike, shape: tuple[int, ...]
) -> Float[AnyArray, "*ones channels"]:
    """One number or one per channel, ready to multiply an array of pixels."""
    return jnp.asarray(value, dtype).reshape(shape)
