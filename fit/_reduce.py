"""A million pixels in a six by six triangle, without loss.

The picture is linear in the columns `A = [1 lit dark]`, channel by channel, so all that plain least
squares asks of the pixels is in the triangle R of the QR decomposition of the tall matrix
`[A y_r y_g y_b]`: `|A x - y_k|² = |R_A x - R_k|² + |rest_k|²`. R is updated tile by tile (TSQR:
Demmel, Grigori, Hoemmen, Langou, "Communication-optimal parallel and sequential QR and LU
factorizations", SIAM J. Sci. Comput. 34, 2012), in float64 NumPy, memory bounded by one tile.
Nothing is binned.
"""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from model_jax import Layers

from ._photo import Photo
from ._pixels import Pixels, tiles


@dataclass(frozen=True)
class Reduced:
    """All that the used pixels tell a fit by least squares; scaled to order one.

    The columns are divided by powers of two, which rounds nothing.
    """

    count: int
    """Used pixels, n."""
    design: Float[np.ndarray, "3 3"]
    """R_A: columns 1, lit / width, dark / width."""
    target: Float[np.ndarray, "3 3"]
    """R_k: photo minus surface, divided by `light`; column k is the channel."""
    rest: float
    """Scaled square sum that no choice of the columns explains, all channels."""
    light: float
    """Light unit: a power of two at least as large as any |light|; 0 when all are 0."""
    width: float
    """Width unit, in `width_unit`s, a power of two; 1 when there is no pixel."""
    width_error: float
    """Bound on the rounding of a scaled width, from the layers' dtype and depths."""
    constant: bool
    """The photo is the same everywhere, the air's width is not."""
    has_lit: bool
    has_dark: bool
    """Some used pixel has more lit (shadowed) air than rounding explains."""

    @property
    def square_sum(self) -> float:
        """Σ light² over used pixels and channels, scaled."""
        return float((self.target**2).sum()) + self.rest

    @property
    def variation(self) -> float:
        """Σ (light - its channel's mean)², scaled."""
        return float((self.target[1:] ** 2).sum()) + self.rest


def reduce_pixels(photo: Photo | np.ndarray | jax.Array, layers: Layers, pixels: Pixels) -> Reduced:
    """One pass over the used pixels."""
    triangle = np.zeros((0, 6))
    low, high = np.full(6, np.inf), np.full(6, -np.inf)
    light = width = 0.0
    for tile in tiles(photo, layers, pixels.used):
        columns = np.column_stack([np.ones_like(tile.lit), tile.lit, tile.dark, tile.light])
        low, high = np.minimum(low, columns.min(axis=0)), np.maximum(high, columns.max(axis=0))
        new_light = max(light, _power_of_two(np.abs(tile.light).max()))
        new_width = max(width, _power_of_two(np.abs(columns[:, 1:3]).max()))
        # The scale grows with what has been seen; what was kept so far follows it.
        scale = np.array([1.0, *2 * [new_width or 1.0], *3 * [new_light or 1.0]])
        before = np.array([1.0, *2 * [width or 1.0], *3 * [light or 1.0]])
        kept = triangle * (before / scale)
        triangle = np.asarray(np.linalg.qr(np.concatenate([kept, columns / scale]), mode="r"))
        light, width = new_light, new_width
    full = np.zeros((6, 6))
    full[: len(triangle)] = triangle
    error = _width_error(layers, pixels)
    spread = high - low
    return Reduced(
        count=pixels.count,
        design=full[:3, :3],
        target=full[:3, 3:],
        rest=float((full[3:, 3:] ** 2).sum()),
        light=light,
        width=width or 1.0,
        width_error=error / (width or 1.0),
        constant=pixels.count > 0
        and not spread[3:].any()
        and bool((spread[1:3] > 2 * error).any()),
        has_lit=pixels.count > 0 and bool(high[1] > error),
        has_dark=pixels.count > 0 and bool(high[2] > error),
    )


def worst_bias(
    photo: Photo,
    layers: Layers,
    pixels: Pixels,
    reduced: Reduced,
    response: Float[np.ndarray, "3 3 p"],
) -> Float[np.ndarray, " p"]:
    """How far the photo's rounding can move the parameters at most, to first order.

    `response[m, k]` is the change of the parameters per scaled light of channel k and unit of
    column m, so that pixel i moves them by `Σ_m A_im response_mk` per light: the pseudo-inverse.
    Every sample is off by half a code step at most, and the worst case has all of them conspire:
    `Σ_ik |J⁺_ik| q_ik`. No statistics enter, so it is a bound where rounding is no noise.
    """
    bound = np.zeros(response.shape[-1])
    for tile in tiles(photo, layers, pixels.used):
        assert tile.half_step is not None
        columns = np.column_stack([np.ones_like(tile.lit), tile.lit, tile.dark])
        columns[:, 1:] /= reduced.width
        for k in range(3):
            bound += tile.half_step[:, k] / reduced.light @ np.abs(columns @ response[:, k])
    return bound


def _power_of_two(value: float) -> float:
    """The smallest power of two above a value; 0 for 0."""
    return float(np.ldexp(1.0, int(np.frexp(value)[1]))) if value > 0 else 0.0


def _width_error(layers: Layers, pixels: Pixels) -> float:
    """Four depths enter a width, each off by half an ulp of the largest at most; width_units."""
    if not pixels.count:
        return 0.0
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    depth = max(float(np.abs(front[pixels.used]).max()), float(np.abs(back[pixels.used]).max()))
    return 2.0 * float(np.finfo(front.dtype).eps) * depth / float(layers.width_unit)
