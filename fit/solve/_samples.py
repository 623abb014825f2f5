"""Samples as the solver sees them: used pixels of all photos, in tiles of one size."""

import contextlib
import mmap
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from model_jax._shapes import AnyArray

from .._compile import float64
from ..photo._columns import Columns
from ..photo._stencil import Stencil

TILE = 3072
"""Pixels of a tile: its slopes by 8 parameters are 600 kB, which stays in a core's second cache."""

TILE_OF_PLACES = 128
"""The same of looks that go along the ray: what stands between their slopes and them is more."""

TILES_OF_LINES = (192, 48, 12)
"""The same where pixels see lines across the limb: as many as lie between few lines."""

_BETWEEN = 4
"""Lines that a tile may lie between, of which the first and the last serve it."""

_CAPACITY = 8
"""Samples are stored with room for a power of this many times their least number of tiles, so that
photos of other sizes find a compiled program; loops run over the tiles in use only."""


class StencilTiles(eqx.Module):
    """What blurred pixels see (`photo._stencil.Stencil`), by tiles, or of one tile."""

    heights: Float[AnyArray, "*T k 2"]
    """Of the lines at either end of the tile."""
    fields: dict[str, Float[AnyArray, "*T k 2"]]
    inner: dict[str, Float[AnyArray, "*T j 2"]]
    band: Float[AnyArray, "*T 2"]
    along: Float[AnyArray, "*T n"]
    """Where each pixel is between the two, 0 to 1."""
    height: Float[AnyArray, "*T n"]
    bend: Float[AnyArray, "*T n"]
    inside: Float[AnyArray, "*T 6 n"]


class Samples(eqx.Module):
    """The used pixels of all photos; what no pixel has is None. T tiles of n pixels each."""

    fields: dict[str, Float[AnyArray, "T n"]]
    """What the look needs, by name; widths in the first photo's `width_unit`s."""
    light: Float[AnyArray, "T 3 n"]
    """What the photo recorded, in its own precision; for a clipped sample the bound it tells."""
    surface: Float[AnyArray, "T 3 n"] | None
    """Light behind the air."""
    clipped: Int[AnyArray, "T 3 n"] | None
    """1: at least this bright, -1: at most, 0: measured."""
    one: Float[AnyArray, "T n"] | None
    """Factor on levels, of pseudo-pixels; None is 1."""
    weight: Float[AnyArray, "T n"] | None
    """Pixels that a pixel stands for; None is 1."""
    count: Int[AnyArray, " T"]
    """Pixels of each tile, the rest is padding."""
    photo: Int[AnyArray, " T"]
    """Which photo each tile is of."""
    used: Int[AnyArray, ""]
    """Tiles in use."""
    color: Float[AnyArray, "photos 3"]
    """Colour of the air, a scene's own."""
    mix: Float[AnyArray, "photos 3 3"] | None = None
    """What each channel recorded of red, green and blue; a channel that is a copy of another has a
    row of 0, light 0 and no surface, so that it counts for nothing. None where all are their own.
    Surfaces are mixed already, unless the look dims them."""
    stencil: StencilTiles | None = None
    """What blurred pixels see; None where nothing is blurred."""

    @property
    def like(self) -> AnyArray:
        """Some field: their shape [T, n] and dtype."""
        return next(iter(self.fields.values()))


class Tile(eqx.Module):
    """One tile of `Samples`."""

    fields: dict[str, Float[jax.Array, " n"]]
    light: Float[jax.Array, "3 n"]
    surface: Float[jax.Array, "3 n"] | None
    clipped: Int[jax.Array, "3 n"] | None
    one: Float[jax.Array, " n"] | None
    weight: Float[jax.Array, " n"]
    """0 for padding."""
    photo: Int[jax.Array, ""]
    color: Float[jax.Array, "3"]
    mix: Float[jax.Array, "3 3"] | None
    stencil: StencilTiles | None = None


def tile_at(samples: Samples, index: Int[AnyArray, ""]) -> Tile:
    """The tile of an index."""

    def part(array: AnyArray | None) -> Any:
        return None if array is None else array[index]

    dtype = samples.like.dtype
    inside = jnp.arange(samples.like.shape[1], dtype=jnp.int32) < samples.count[index]
    weight = part(samples.weight)
    photo = jnp.asarray(samples.photo)[index]
    return Tile(
        fields={name: part(field) for name, field in samples.fields.items()},
        light=jnp.asarray(samples.light)[index].astype(dtype),
        surface=part(samples.surface),
        clipped=part(samples.clipped),
        one=part(samples.one),
        weight=jnp.where(inside, 1.0 if weight is None else weight, 0.0).astype(dtype),
        photo=photo,
        color=jnp.asarray(samples.color)[photo],
        mix=None if samples.mix is None else jnp.asarray(samples.mix)[photo],
        stencil=jax.tree.map(part, samples.stencil),
    )


def capacity(tiles: int, least: int) -> int:
    """Room for a number of tiles."""
    room = least
    while room < tiles:
        room *= _CAPACITY
    return room


ROOM = 1024
"""Least room, in tiles: 3 megapixels of uniform air, 131,072 pixels of air that thins out. Where
nothing is written it takes no memory on a CPU."""
FEW_ROOM = 64
"""Least room of few pixels, in tiles: 200,000, below which memory that is touched is no matter."""


def to_samples(
    columns: Sequence[Columns],
    tile: int | None = None,
    weights: Sequence[Float[np.ndarray, " _"]] | None = None,
    ones: Sequence[Float[np.ndarray, " _"]] | None = None,
) -> Samples:
    """Tiles of all photos' columns; a part that any photo has, all have.

    With weights, of pseudo-pixels: they are fewer, and so is the room for them; `ones` are their
    factors on levels.
    """
    if tile is None:
        tile = _tile_of(columns)
    starts = _first_tiles(columns, tile)
    room = capacity(int(starts[-1]), ROOM if weights is None else FEW_ROOM)

    def fill(parts: list[np.ndarray | None]) -> Any:
        return _fill(parts, starts, room, tile)

    count = np.zeros(room, np.int32)
    photo = np.zeros(room, np.int32)
    for number, (c, (start, end)) in enumerate(zip(columns, pairwise(starts), strict=True)):
        count[start:end] = np.minimum(tile, len(c.index) - tile * np.arange(end - start))
        photo[start:end] = number
    return Samples(
        fields={n: fill([c.fields.get(n) for c in columns]) for n in _names(columns)},
        light=fill([c.light for c in columns]),
        surface=fill([c.surface for c in columns]),
        clipped=fill([c.clipped for c in columns]),
        one=None if ones is None else fill(list(ones)),
        weight=None if weights is None else fill(list(weights)),
        count=count,
        photo=photo,
        used=np.asarray(starts[-1], np.int32),
        color=np.stack([c.color for c in columns]),
        mix=_stacked_mix(columns),
        stencil=_stencil_tiles([c.stencil for c in columns], starts, room, tile),
    )


def _tile_of(columns: Sequence[Columns]) -> int:
    """Pixels of a tile: with stencils few enough that light between its two lines is as theirs."""
    known = [c.stencil for c in columns if c.stencil is not None and len(c.index)]
    if not known:
        return TILE_OF_PLACES if "begin" in _names(columns) else TILE
    pixels = sum(len(part.angle) for part in known)
    lines = sum(len(np.unique(part.before)) for part in known)
    fitting = [n for n in TILES_OF_LINES if n * lines <= _BETWEEN * pixels]
    return fitting[0] if fitting else TILES_OF_LINES[-1]


def _stencil_tiles(
    parts: Sequence[Stencil | None], starts: Int[np.ndarray, " _"], room: int, tile: int
) -> StencilTiles | None:
    """Tiles of all photos' stencils, if they have some."""
    known = [part for part in parts if part is not None]
    if not known:
        return None
    ends, alongs, bands = [], [], np.zeros((room, 2))
    for part, (start, end) in zip(known, pairwise(starts), strict=True):
        first = tile * np.arange(end - start)
        last = np.minimum(first + tile, len(part.angle)) - 1
        before = part.before
        after = np.minimum(before[last] + 1, len(part.lines) - 1)
        two = np.stack([before[first], after], axis=-1)
        low, high = (np.repeat(part.lines[k], last - first + 1) for k in two.T)
        width = high - low
        along = np.clip((part.angle - low) / np.where(width > 0, width, 1.0), 0, 1)
        ends.append(two)
        alongs.append(along)
        bands[start:end] = part.band

    def fill(parts: list[np.ndarray | None]) -> Any:
        # Of no pixel and no air slopes are no numbers, whatever its weight.
        return _fill(parts, starts, room, tile, repeat=True)

    def of_lines(values: list[np.ndarray]) -> np.ndarray:
        whole = np.zeros((room, values[0].shape[1], 2))
        for lines, two, (start, end) in zip(values, ends, pairwise(starts), strict=True):
            whole[start:end] = lines[two].swapaxes(1, 2)
        return whole

    return StencilTiles(
        heights=of_lines([part.heights for part in known]),
        fields={n: of_lines([part.fields[n] for part in known]) for n in known[0].fields},
        inner={n: of_lines([part.inner[n] for part in known]) for n in known[0].inner},
        band=bands,
        along=fill(list(alongs)),
        height=fill([part.height for part in known]),
        bend=fill([part.bend for part in known]),
        inside=fill([part.inside for part in known]),
    )


def _names(columns: Sequence[Columns]) -> list[str]:
    """Fields that some photo has."""
    return list(dict.fromkeys(name for c in columns for name in c.fields))


def _stacked_mix(columns: Sequence[Columns]) -> Float[np.ndarray, "photos 3 3"] | None:
    """As `Samples.mix`."""
    if all(c.mix is None for c in columns):
        return None
    rows = np.stack([np.eye(3) if c.mix is None else c.mix for c in columns])
    for row, c in zip(rows, columns, strict=True):
        row[c.copies] = 0
    return rows


def relit(samples: Samples, columns: Sequence[Columns]) -> Samples:
    """Samples on the device, of the same pixels with other light, clipped elsewhere if at all."""
    room, tile = samples.like.shape
    starts = _first_tiles(columns, tile)
    light = _fill([c.light for c in columns], starts, room, tile)
    clipped = _fill([c.clipped for c in columns], starts, room, tile)
    with float64():
        light, clipped = jax.device_put((light, clipped), may_alias=True)
    return eqx.tree_at(
        lambda s: (s.light, s.clipped), samples, (light, clipped), is_leaf=lambda x: x is None
    )


def _first_tiles(columns: Sequence[Columns], tile: int) -> Int[np.ndarray, " _"]:
    """Where each photo's tiles begin, and where the last one's end."""
    return np.cumsum([0, *(-(-len(c.index) // tile) for c in columns)])


def _fill(
    parts: Sequence[np.ndarray | None],
    starts: Int[np.ndarray, " _"],
    room: int,
    tile: int,
    *,
    repeat: bool = False,
) -> Any:
    """One array of tiles, [room, n] or [room, k, n]; 0 where a part is None, None if all are.

    repeat: what is left of a photo's last tile is its last pixel again, not 0.
    """
    known = [part for part in parts if part is not None]
    if not known:
        return None
    several = known[0].ndim == 2
    shape = (room, known[0].shape[1], tile) if several else (room, tile)
    whole = _zeros(shape, np.result_type(*known))
    for part, start in zip(parts, starts, strict=False):
        if part is None or not len(part):
            continue
        full, rest = divmod(len(part), tile)
        body = part[: full * tile].reshape((full, tile, *part.shape[1:]))
        whole[start : start + full] = body.swapaxes(1, 2) if several else body
        if rest:
            whole[start + full, ..., :rest] = part[full * tile :].T
            if repeat:
                whole[start + full, ..., rest:] = part[-1:].T
    return whole


def share_fields(columns: Sequence[Columns], samples: Samples) -> tuple[Columns, ...]:
    """The same columns, whose fields are views of the samples' own: large photos have many."""
    shared = []
    start, tile = 0, samples.like.shape[1]
    for c in columns:
        part = slice(start, start + len(c.index))
        fields = {n: np.asarray(samples.fields[n]).reshape(-1)[part] for n in c.fields}
        shared.append(replace(c, fields=fields))
        start += -(-len(c.index) // tile) * tile
    return tuple(shared)


def on_device(samples: Samples) -> Samples:
    """Samples as JAX arrays, float64; on a CPU without a copy, so leave the NumPy ones alone."""
    with float64():
        moved: Samples = jax.device_put(samples, may_alias=True)
    return moved


def _zeros(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """Zeros in pages of their own: aligned, so that a CPU's JAX takes them over as they are, and
    room in which nothing is ever written takes no memory. (NumPy's may come from a heap that has
    to be written over.)"""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    pages = mmap.mmap(-1, max(size, 1), access=mmap.ACCESS_COPY)
    if hasattr(mmap, "MADV_HUGEPAGE"):  # a fault for 2 MB, not for each 4 kB: a third of the time
        with contextlib.suppress(OSError):  # a kernel without them
            pages.madvise(mmap.MADV_HUGEPAGE)
    return np.frombuffer(pages, dtype, int(np.prod(shape))).reshape(shape)
