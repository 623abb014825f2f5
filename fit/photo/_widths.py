"""Lit and dark widths of a photo's used pixels, in pieces of one size."""

import jax
import numpy as np
from jaxtyping import Bool, Float

from model_jax import Layers, layer_widths
from model_jax._shapes import AnyArray

from .._compile import float64

_CHUNK = 65536
"""Pixels at once: half a megabyte for each array on the way."""
_jit_widths = jax.jit(layer_widths)


def widths_of(
    layers: Layers, index: np.ndarray, unit: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"] | None]:
    """Widths in float64 whatever JAX's setting, in pieces of one size so that JAX compiles once."""
    lit = np.empty(index.size)
    dark = np.empty(index.size) if layers.has_shadow else None

    def part(depth: AnyArray, chosen: np.ndarray) -> np.ndarray:
        """Depths [1, chunk] of the chosen pixels, or of several shadows [n, 1, chunk]."""
        several = depth.shape[:-2]
        row = np.zeros((*several, 1, _CHUNK))
        row[..., 0, : chosen.size] = np.asarray(depth).reshape(*several, -1)[..., chosen]
        return row

    shadows = [s for s in (layers.shadow_front, layers.shadow_back) if s is not None]
    with float64():
        for start in range(0, index.size, _CHUNK):
            end = min(start + _CHUNK, index.size)
            chosen = index[start:end]
            front, back = part(layers.front, chosen), part(layers.back, chosen)
            begin, until = [part(s, chosen) for s in shadows] or (None, None)
            stretch = None if layers.stretch is None else part(layers.stretch, chosen)
            piece = Layers(front, back, begin, until, width_unit=unit, stretch=stretch)
            lit_piece, dark_piece = _jit_widths(piece)
            lit[start:end] = np.asarray(lit_piece)[0, : end - start]
            if dark is not None:
                dark[start:end] = np.asarray(dark_piece)[0, : end - start]
    return lit, dark


def rounding_of_widths(layers: Layers, used: Bool[np.ndarray, "h w"], unit: float) -> float:
    """Four depths enter a width, each off by half an ulp of the largest at most."""
    if not used.any():
        return 0.0
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    depth = max(float(np.abs(front[used]).max()), float(np.abs(back[used]).max()))
    if layers.stretch is not None:
        depth *= float(np.asarray(layers.stretch)[used].max())
    return 2.0 * float(np.finfo(front.dtype).eps) * depth / unit
