"""Few pseudo-pixels that stand for all: what a fit can do before it touches every pixel again.

All return `Samples` that any solver descends on as on the real ones; the exact pass
(`_gram`) then ends the fit, so that neither has to be exact.

`moments`: where the model is linear in its columns `[1 fields surface]`, plain least squares asks
of the pixels no more than the sums of products of columns and light. A factor of that matrix, read
as rows, is a few pseudo-pixels with the same square sum for every look.

`bins`: where the model is a function of one field or of a pair, pixels that agree in it tell their
number, their mean and their sum of squares. A grid over the pair takes the middle for all of a bin,
which is second order in its width.

`thinned`: every k-th pixel, for robust losses, surfaces and more fields, which know no such pairs.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from .._compile import program
from ..photo._columns import Columns
from ._gram import tile_columns, weighted_squares
from ._samples import TILES_OF_LINES, Samples, tile_at, to_samples

BINS = 256
"""Bins along each field: parameters within 1e-5 of the exact ones on real pictures."""

THIN = 2**15
"""Pixels of a thinned picture: parameters within a few standard errors of theirs, √(all / THIN)."""

THIN_OF_LINES = 2**13
"""The same where pixels see lines across the limb."""

_RUN = TILES_OF_LINES[0]
"""Pixels side by side that are taken of those: they share their lines."""

MOST_BINNED = 2
"""Fields that can be binned; three would make 17 million bins."""

_ROWS = 16
"""Pixels of a tile of pseudo-pixels, or a multiple: of two fields nine moments, padded."""


def moments(samples: Samples) -> Samples:
    """Pseudo-pixels of each photo; clipped samples are taken as measured."""
    photos = len(np.asarray(samples.color))
    names = ["one", *samples.fields]
    surface = samples.surface is not None
    size = len(names) + 3 * surface + 3
    sums = np.asarray(_products(samples, photos, size))
    rows = np.stack([factor_of(matrix) for matrix in sums])  # [photo, row, column]
    padded = np.zeros((photos, -(-size // _ROWS) * _ROWS, size))
    padded[:, :size] = rows
    column = {name: padded[..., k] for k, name in enumerate(names)}
    behind = padded[..., len(names) : len(names) + 3].swapaxes(1, 2) if surface else None
    return Samples(
        fields={name: column[name] for name in samples.fields},
        light=padded[..., -3:].swapaxes(1, 2),
        surface=behind,
        clipped=None,
        one=column["one"],
        weight=None,
        count=np.full(photos, size, np.int32),
        photo=np.arange(photos, dtype=np.int32),
        used=np.asarray(photos, np.int32),
        color=samples.color,
        mix=samples.mix,
    )


def bins(columns: Sequence[Columns]) -> Samples:
    """Means over bins of the fields, photo by photo, weighted by their pixels.

    Clipped samples of one kind share their bound, so pixels in which the same channels are clipped
    have bins of their own. The columns have no surface. The squares about the means are one more
    pseudo-pixel, in which no look shows.
    """
    binned, weights, ones = zip(*(_bin(c) for c in columns), strict=True)
    return to_samples(binned, weights=weights, ones=ones)


def thin_of(columns: Sequence[Columns]) -> int:
    """Pixels that stand for all."""
    return THIN if all(c.stencil is None for c in columns) else THIN_OF_LINES


def thinned(columns: Sequence[Columns]) -> Samples:
    """Every k-th pixel of each photo, or k-th run of pixels along the limb, counting for as many as
    there are; `thin_of` or a little more in all."""
    step = max(sum(len(c.index) for c in columns) // thin_of(columns), 1)

    def reduced(c: Columns) -> Columns:
        number = np.arange(len(c.index))
        return c.part(number[(number if c.stencil is None else number // _RUN) % step == 0])

    def weight(all_: Columns, few: Columns) -> np.ndarray:
        count = len(few.index)
        each = step if all_.stencil is None else len(all_.index) / max(count, 1)  # ends of runs
        return np.full(count, float(each))

    found = [reduced(c) for c in columns]
    weights = [weight(c, few) for c, few in zip(columns, found, strict=True)]
    return to_samples(found, weights=weights)


def _bin(
    columns: Columns,
) -> tuple[Columns, Float[np.ndarray, " rows"], Float[np.ndarray, " rows"]]:
    """Pseudo-pixels, how many pixels each stands for, and the factor on its levels."""
    number = np.zeros(len(columns.index), np.intp)
    for field in columns.fields.values():
        number = number * BINS + _bin_numbers(field)
    if columns.clipped is not None:
        for k in range(3):
            number = number * 3 + (columns.clipped[:, k] + 1)
    counts = np.bincount(number)
    filled = np.flatnonzero(counts)
    weight = counts[filled].astype(np.float64)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(number, values)[filled] / weight

    light = np.stack([mean(columns.light[:, k]) for k in range(3)], axis=-1)
    squares = np.einsum("nk,nk->k", columns.light, columns.light, dtype=np.float64)
    clipped = None
    if columns.clipped is not None:
        kind = filled[:, None] // np.array([9, 3, 1]) % 3 - 1
        clipped = np.append(kind, np.zeros((1, 3)), axis=0).astype(np.int8)
    within = np.sqrt(np.maximum(squares - weight @ light**2, 0))
    means = replace(
        columns,
        index=np.append(filled, 0),
        fields={name: np.append(mean(field), 0) for name, field in columns.fields.items()},
        light=np.append(light, within[None], axis=0),
        clipped=clipped,
    )
    return means, np.append(weight, 1), np.append(np.ones_like(weight), 0)


def _bin_numbers(field: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    low, high = float(field.min()), float(field.max())
    if high <= low:
        return np.zeros(len(field), dtype=np.intp)
    return np.minimum((field - low) * (BINS / (high - low)), BINS - 1).astype(np.intp)


@program
def _products(samples: Samples, photos: int, size: int) -> Float[jax.Array, "photos c c"]:
    def add(index: jax.Array, total: jax.Array) -> jax.Array:
        tile = tile_at(samples, index)
        rows = jnp.concatenate([tile_columns(samples, tile), tile.light])
        return total.at[tile.photo].add(weighted_squares(samples, tile, rows))

    zero = jnp.zeros((photos, size, size), samples.like.dtype)
    return jax.lax.fori_loop(0, samples.used, add, zero)


def factor_of(matrix: Float[np.ndarray, "c c"]) -> Float[np.ndarray, "c c"]:
    """Rows R with RᵀR = matrix, by eigenvalues of the matrix with a unit diagonal."""
    size = np.sqrt(np.maximum(np.diag(matrix), 0))  # rounding may take a 0 below
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(matrix / size / size[:, None])
    return np.asarray(np.sqrt(np.maximum(values, 0))[:, None] * vectors.T * size)
