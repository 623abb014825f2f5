"""A camera's blur: light spread by a Gaussian before it is recorded.

Of a picture that is a convolution (`blurred`). Near a planet's limb, where the light hangs on the
height above the limb alone, it is a weighted sum over a few heights (`profile_heights`,
`line_weights`): between them light is taken as parabolas, whose product with the Gaussian has a
closed form. So any width has its right weights on the same heights, down to none at all, and
slopes by the width are exact.

Light that is e^(-z/H), or that saturated up to a depth of 5, is met within 0.3 % of its value at
the limb for H of 0.2 to 1 px or above 10 px, within 0.8 % between, for widths up to 3 px.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import erfc
from jaxtyping import Float

from ._safe import safe_divide
from ._shapes import AnyArray, Scalar

MOST_BLUR = 3.0
"""Widest blur, px: a photo that is less sharp tells as much at half its size."""

REACH = 4.0 * MOST_BLUR
"""How far, px, light is spread: beyond four widths of the widest lie 6e-5 of it."""

PANELS = 12
"""Parabolas from the limb to the air's end: twice as many heights, and one more."""

INNER_PANELS = 4
"""The same for the air in front of the planet, which grows as a root of the depth below the limb:
with three in place of four, half a percent of the light at the limb is lost."""

FINEST = 0.5
"""Heights are spaced as the logarithm of z + this many px: finest at the limb, where thin air is
brightest."""

SHARPEST = 1e-3
"""Least width, px, in place of 0, where the Gaussian is none; moves no light by 1e-3 px."""


def blurred(light: Float[AnyArray, "h w c"], width: Scalar) -> Float[jax.Array, "h w c"]:
    """A picture's light, spread by a Gaussian.

    Args:
        light: linear light.
        width: standard deviation, px, 0 to `MOST_BLUR`.

    Returns:
        Σ g(i, j) light(x + i, y + j) with weights that add up to 1; beyond its borders a picture
        is what it is at them. Same shape and dtype; the slope by the width is finite at 0.
    """
    light = jnp.asarray(light)
    taps = int(np.ceil(REACH))
    steps = jnp.arange(-taps, taps + 1, dtype=light.dtype)
    squares = safe_divide(steps, jnp.asarray(width, light.dtype), jnp.inf) ** 2
    weights = jnp.where(steps == 0, 1, jnp.exp(-squares / 2))
    weights = weights / weights.sum()
    for axis in (0, 1):
        around = [(taps, taps) if k == axis else (0, 0) for k in range(3)]
        rows = jnp.moveaxis(jnp.pad(light, around, mode="edge"), axis, -1)
        row = rows.reshape(-1, 1, rows.shape[-1])
        spread = jax.lax.conv_general_dilated(row, weights[None, None], (1,), "VALID")
        light = jnp.moveaxis(spread.reshape(*rows.shape[:-1], -1), -1, axis)
    return light


def profile_heights(top: Float[np.ndarray, " m"]) -> Float[np.ndarray, "k m"]:
    """Heights above the limb, px, at which light has to be known on lines across it: from the limb
    to the air's end, px. Every second one is the middle of a parabola."""
    share = np.linspace(0, 1, PANELS + 1)[:, None]
    edges = FINEST * np.expm1(share * np.log1p(np.maximum(top, 0) / FINEST))
    edges[-1] = np.maximum(top, 0)  # what the logarithm rounded
    return _with_middles(edges)


def inner_heights() -> Float[np.ndarray, " k"]:
    """The same below the limb, px, for pixels at any height: from `REACH` to the limb itself."""
    return _with_middles(-REACH * np.linspace(1, 0, INNER_PANELS + 1) ** 3)


def _with_middles(edges: Float[np.ndarray, "p ..."]) -> Float[np.ndarray, "k ..."]:
    """Ends of parabolas, and their middles between them."""
    found = np.empty((2 * len(edges) - 1, *edges.shape[1:]))
    found[::2] = edges
    found[1::2] = (edges[1:] + edges[:-1]) / 2
    return found


@jax.custom_jvp
def line_weights(
    heights: Float[AnyArray, "k n"],
    height: Float[AnyArray, " n"],
    bend: Float[AnyArray, " n"],
    width: Scalar,
) -> Float[jax.Array, "k n"]:
    """How much of a pixel's light comes from each height.

    Args:
        heights: of `profile_heights` or `inner_heights`, px.
        height: the pixels' own, px.
        bend: curvature of the limb, 1/px: across a line the Gaussian reaches outward of a circle.
        width: standard deviation, px; the only one that slopes are known by.
    """
    return _line_weights(heights, height, bend, width)


@line_weights.defjvp
def _line_weights_jvp(given: Any, tangents: Any) -> Any:
    """The slope is a number of pixel and height, found once, however many parameters push it."""
    *places, width = given
    width = jnp.asarray(width, jnp.result_type(places[0]))
    found, slope = jax.jvp(partial(_line_weights, *places), (width,), (jnp.ones_like(width),))
    return found, slope * tangents[-1]


def _line_weights(heights: Any, height: Any, bend: Any, width: Any) -> jax.Array:
    sigma, center = _gaussian(height, bend, width)
    edges, middle = heights[::2], heights[1::2]
    half = (edges[1:] - edges[:-1]) / 2
    z = jnp.asarray((edges - center[None]) / sigma)
    (below, above), density = _tails(z), _normal(z)
    # The share between, from whichever tail has digits.
    share = jnp.where(z[:-1] > 0, above[:-1] - above[1:], below[1:] - below[:-1])
    ratio = safe_divide(sigma, half, 0.0)
    offset = safe_divide(center[None] - middle, half, 0.0)
    first = offset * share - ratio * (density[1:] - density[:-1])
    second = offset * first + ratio * (ratio * share - (density[1:] + density[:-1]))
    share, first, second = (jnp.where(half > 0, m, 0) for m in (share, first, second))
    weights = jnp.zeros(heights.shape, share.dtype)
    weights = weights.at[:-2:2].add((second - first) / 2)
    weights = weights.at[1::2].add(share - second)
    return weights.at[2::2].add((second + first) / 2)


def below_limb(
    height: Float[AnyArray, " n"], bend: Float[AnyArray, " n"], width: Scalar
) -> Float[jax.Array, "2 n"]:
    """How much comes from below the limb, of light that is 1 there, and of light that grows by 1
    each px down from the limb. Arguments as of `line_weights`."""
    sigma, center = _gaussian(height, bend, width)
    down = -center / sigma
    below, _ = _tails(down)
    return jnp.stack([below, sigma * (_normal(down) + down * below)])


def _gaussian(
    height: Float[AnyArray, " n"], bend: Float[AnyArray, " n"], width: Scalar
) -> tuple[jax.Array, jax.Array]:
    """Width and middle, px, of the Gaussian on a line across the limb."""
    width = jnp.asarray(width, jnp.result_type(height))
    sigma = jnp.sqrt(width * width + SHARPEST**2)
    return sigma, jnp.asarray(height) + bend * (sigma * sigma / 2)


@jax.custom_jvp
def _tails(x: jax.Array) -> tuple[jax.Array, jax.Array]:
    """How much of a standard normal distribution lies below, and above: each with its digits."""
    tail = erfc(jnp.abs(x) / np.sqrt(2)) / 2
    return jnp.where(x < 0, tail, 1 - tail), jnp.where(x < 0, 1 - tail, tail)


@_tails.defjvp
def _tails_jvp(given: Any, tangents: Any) -> Any:
    slope = _normal(given[0]) * tangents[0]
    return _tails(given[0]), (slope, -slope)


def _normal(x: jax.Array) -> jax.Array:
    """The standard normal density."""
    return jnp.exp(-x * x / 2) / np.sqrt(2 * np.pi)
