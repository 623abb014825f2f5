"""The photo taken again: light, noise and codes as the camera's, compressed as the file was.

A JPEG says how it was compressed, so that it can be done again (`diagnose._compression` says what
for). A photo is taken in windows of whole blocks around its used pixels.
"""

import io
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt, UInt8
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

from ._columns import Columns, PhotoLike, with_codes
from ._photo import Jpeg, Photo
from ._read import orient

SEED = 20261123
"""Makes the noise, together with a photo's codes: a fit gives the same result each time, and
what few looks happen to say of one photo is not said of all."""

LEVELS = 8
"""Brightnesses for which the noise is found, on a line between them."""

UNLIKE = 2.0
"""Times the distance of files made up alike from each other, in their numbers of steps, from which
the photo is none of them. Photos compressed once, to quality 70 or more, were 0.6 to 1.5 times as
far, those compressed before with coarser steps 3.5 to 15 times."""

COARSEST = 16.0
"""Mean of the steps of low frequencies from which on nothing is undone: that of quality 50 is 15.
There the intervals of corrected values covered the truth in 85 to 93 of 100 fits, of quality 30 in
20 to 83, of 5 in 45: steps hide the noise, and what is made up in its place is a guess."""

_LOW = tuple((row, col) for row in range(5) for col in range(5) if 0 < row + col < 5)
"""Frequencies whose numbers of steps are compared: higher ones are 0 as a rule."""
_MOST_STEPS = 8
"""Numbers of steps from which on they count as one: larger ones are few."""
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""Weights of codes in luma, as JFIF weighs them (ITU-R BT.601)."""
_COMPARED = 8
"""Files made up to compare with."""

_TUNINGS = 5
"""Rounds in which the noise is found whose residuals after compression are the photo's."""
_BAND = 128
"""Rows of a window, whose encoding and decoding needs no other."""
_BLOCK = 16
"""The largest coded block, and a margin: more than any decoder smooths colour across."""
_REACH = 4
"""Half the squares over which unused pixels are averaged: a ninth of their noise is left."""
_CELLS = 2**18
"""Cells of light, with a code each: 1/80 of the narrowest code of sRGB."""
_ALIKE = 5.0
"""Standard deviations up to which an unused pixel agrees with the model."""


def is_coarse(jpeg: Jpeg) -> bool:
    """Too much was rounded away."""
    steps = np.reshape(jpeg.tables[0], (8, 8))
    return bool(np.mean([steps[place] for place in _LOW]) > COARSEST)


def left_over(columns: Columns, light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Residuals, as `residuals_of` gives them."""
    left = columns.light - light
    if columns.clipped is not None:
        left[columns.clipped != 0] = np.nan
    return left


@dataclass(frozen=True)
class _Noise:
    """Standard deviation of recorded light before compression, on a line between levels."""

    level: Float[np.ndarray, " k"]
    sigma: Float[np.ndarray, " k"]

    def at(self, light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        return np.interp(light, self.level, self.sigma).astype(np.float32)


class _Bands:
    """Samples sorted by their light."""

    def __init__(self, light: Float[np.ndarray, "n 3"]) -> None:
        step = -(-len(light) // 2**16)
        edges = np.quantile(light[::step], np.linspace(0, 1, LEVELS + 1)[1:-1])
        number = np.searchsorted(edges, light)
        parts = [number == k for k in range(LEVELS)]
        self._parts = [part for part in parts if part.any()]
        self.level = np.array([light[part].mean() for part in self._parts])

    def spread(self, left: Float[np.ndarray, "n 3"], robust: bool) -> Float[np.ndarray, " k"]:
        """Root mean squares of what is left, or what medians say of them."""
        return np.array([_size(left[part], robust) for part in self._parts])


def _size(values: Float[np.ndarray, " m"], robust: bool) -> float:
    known = values[np.isfinite(values)]
    if not known.size:
        return 0.0
    return float(1.4826 * np.median(np.abs(known)) if robust else np.sqrt(np.mean(known**2)))


class _Window(NamedTuple):
    """A part of a file that is encoded and decoded by itself."""

    codes: UInt8[np.ndarray, "h w 3"]
    place: Int[np.ndarray, " m"]
    """Flat index in the window of each pixel that is pictured anew."""
    rank: Int[np.ndarray, " m"]
    """Which one it is, of those used and then of those near."""
    told_place: Int[np.ndarray, " u"]
    told_rank: Int[np.ndarray, " u"]
    """Where those are that are used and in no margin: in the window, and in the columns."""
    blocks: Int[np.ndarray, " b"]
    """Numbers of the whole blocks that hold one of these."""


class JpegCamera:
    """Takes a photo as one was taken, of other light: noise, codes, compression.

    Unused pixels that share coded blocks with used ones share their errors. What the file shows of
    them has been rounded as those blocks were, and would be rounded so again; so they are pictured
    anew too. Where the file agrees with the model, in the sky and at the edge of a mask, with the
    model's light; elsewhere, such as on the planet, with means over squares.
    """

    def __init__(
        self,
        photo: PhotoLike,
        columns: Columns,
        near: Columns,
        light: Float[np.ndarray, "n 3"],
        near_light: Float[np.ndarray, "k 3"],
        residual: Float[np.ndarray, "n 3"],
        robust: bool,
    ) -> None:
        """Find the noise, and which of the pixels near are as the model says.

        Args:
            columns, near: of the used pixels and of those that share blocks with them.
            light, near_light: of the fitted look there.
            residual: by `residuals_of`.
            robust: measure noise by medians.
        """
        self._columns = columns
        self._photo = photo if isinstance(photo, Photo) and photo.codes is not None else None
        self._jpeg: Jpeg | None = None
        self._windows: list[_Window] = []
        self._agrees = np.zeros((0, 1), bool)
        self._means = np.zeros((0, 3), np.float32)
        if self._photo is not None:
            top, curve = self._photo.top, self._photo.tone_curve
            edges = np.asarray(curve.decode((np.arange(top) + 0.5) / top), np.float32)
            middles = ((np.arange(_CELLS) + 0.5) / _CELLS).astype(np.float32)
            self._edges: Float[np.ndarray, " codes"] = edges
            self._codes = np.searchsorted(edges, middles).astype(self._photo.stored.dtype)
            self._jpeg = self._photo.jpeg
        bands = _Bands(light)
        wanted = bands.spread(residual, robust)
        self._noise = _Noise(bands.level, wanted)
        if self._photo is not None and self._jpeg is not None:
            off = np.abs(near.light - near_light)
            with np.errstate(invalid="ignore"):  # where the layers have no depth
                self._agrees = (off < _ALIKE * self._noise.at(near_light)).all(axis=1)[:, None]
            self._see(self._photo, self._jpeg, near)
        for seed in np.random.SeedSequence(SEED).spawn(_TUNINGS):
            taken = self.take(light, near_light, np.random.default_rng(seed))
            found = bands.spread(left_over(taken, light), robust)
            sigma = self._noise.sigma * np.clip(wanted / np.maximum(found, 1e-30), 0.5, 2)
            self._noise = _Noise(bands.level, sigma)

    def take(
        self,
        light: Float[np.ndarray, "n 3"],
        near_light: Float[np.ndarray, "k 3"],
        rng: np.random.Generator,
    ) -> Columns:
        """The columns with what a photo of this light would have recorded."""
        photo = self._photo
        if photo is None:
            return replace(self._columns, light=self._noisy(light, rng))
        if self._jpeg is None:
            return with_codes(self._columns, photo, self._encoded(light, rng))
        found = np.empty(light.shape, self._codes.dtype)
        for window, picture in self._files(light, near_light, rng):
            decoded = picture.reshape(-1, picture.shape[2])
            found[window.told_rank] = np.take(decoded, window.told_place, axis=0)
        return with_codes(self._columns, photo, found)

    def unlike(self, light: Float[np.ndarray, "n 3"], near_light: Float[np.ndarray, "k 3"]) -> str:
        """Why files made of this light are not such as the photo; empty if they are.

        Numbers of steps of one frequency are counted in all blocks that hold a used pixel; the
        distance of two such counts is χ² over all numbers and frequencies.
        """
        if self._jpeg is None:
            return ""
        steps = np.reshape(self._jpeg.tables[0], (8, 8))

        def counted(files: Iterable[tuple[_Window, UInt8[np.ndarray, "h w c"]]]) -> Any:
            return np.sum([_counts_of(seen, w.blocks, steps) for w, seen in files], axis=0)

        own = counted((window, window.codes) for window in self._windows)
        made = []
        for seed in np.random.SeedSequence(SEED + 1).spawn(_COMPARED):
            files = self._files(light, near_light, np.random.default_rng(seed))
            made.append(counted(files))
        mean = np.mean(made, axis=0)

        def distance(counts: Any) -> float:
            return float(((counts - mean) ** 2 / (mean + 0.5)).sum())

        # What is in the mean is nearer to it than what is not: (n - 1) / n for (n + 1) / n.
        among = np.mean([distance(counts) for counts in made])
        expected = among * (_COMPARED + 1) / (_COMPARED - 1)
        if distance(own) > UNLIKE * expected:
            return "the file was compressed more than once, or not by steps of its own alone"
        return ""

    def _files(
        self,
        light: Float[np.ndarray, "n 3"],
        near_light: Float[np.ndarray, "k 3"],
        rng: np.random.Generator,
    ) -> Iterator[tuple[_Window, UInt8[np.ndarray, "h w c"]]]:
        """The windows as a file of this light would show them."""
        assert self._jpeg is not None
        codes = self._encoded(light, rng)
        around = self._encoded(np.where(self._agrees, near_light, self._means), rng)
        codes = np.concatenate([codes, around])
        for window in self._windows:
            picture = window.codes.copy()
            picture.reshape(-1, picture.shape[2])[window.place] = np.take(
                codes, window.rank, axis=0
            )
            yield window, _round_trip(picture, self._jpeg)

    def _noisy(
        self, light: Float[np.ndarray, "n 3"], rng: np.random.Generator
    ) -> Float[np.ndarray, "n 3"]:
        return light + self._noise.at(light) * rng.standard_normal(light.shape, np.float32)

    def _encoded(
        self, light: Float[np.ndarray, "n 3"], rng: np.random.Generator
    ) -> UInt[np.ndarray, "n 3"]:
        noisy = self._noisy(light, rng)
        # Cells cover light up to one, in which the film curve has but some of its codes.
        if self._jpeg is None or self._edges[-1] > 1:
            return np.searchsorted(self._edges, noisy).astype(self._codes.dtype)
        cell = np.clip(noisy * np.float32(_CELLS), 0, _CELLS - 1)
        return np.take(self._codes, cell.astype(np.int32))

    def _see(self, photo: Photo, jpeg: Jpeg, near: Columns) -> None:
        """Cut the file into bands of rows, as wide as what is pictured in them, with margins."""
        assert photo.light is not None
        n = len(self._columns.index)
        rank = np.full(photo.reason.size, -1, np.int32)
        rank[self._columns.index] = np.arange(n, dtype=np.int32)
        rank[near.index] = np.arange(n, n + len(near.index), dtype=np.int32)
        grid = _file_grid(photo.shape, jpeg.orientation)
        stored = photo.stored.reshape(-1, 3)
        strange = np.append(np.zeros(n, bool), ~self._agrees[:, 0])
        self._means = np.zeros(near.light.shape, np.float32)
        for start in range(0, len(grid), _BAND):
            pictured = rank[grid[start : start + _BAND]] >= 0
            across = np.flatnonzero(pictured.any(axis=0))
            if not len(across):
                continue
            left = max(int(across[0]) // _BLOCK - 1, 0) * _BLOCK
            right = (int(across[-1]) // _BLOCK + 2) * _BLOCK
            top = max(start - _BLOCK, 0)
            shown = grid[top : start + _BAND + _BLOCK, left:right]
            numbers = rank[shown].reshape(-1)
            place = np.flatnonzero(numbers >= 0).astype(np.int32)
            number = numbers[place]
            row = place // shown.shape[1] + top
            own = (row >= start) & (row < start + _BAND)
            codes = stored[shown]
            part = (numbers < 0) | strange[numbers]
            means = _means_of(photo.light[codes], part.reshape(shown.shape)).reshape(-1, 3)
            mine = own & strange[number]
            self._means[number[mine] - n] = means[place[mine]]
            told = own & (number < n)
            blocks = _whole_blocks(place[told], shown.shape)
            window = _Window(codes, place, number, place[told], number[told], blocks)
            self._windows.append(window)


def near_used(photo: PhotoLike, used: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Unused pixels that share a coded block with used ones."""
    near = np.zeros(used.size, bool)
    if isinstance(photo, Photo) and photo.jpeg is not None:
        grid = _file_grid(photo.shape, photo.jpeg.orientation)
        inside = used.reshape(-1)[grid]
        size = [-(-n // _BLOCK) * _BLOCK for n in grid.shape]
        padded = np.zeros(size, bool)
        padded[: grid.shape[0], : grid.shape[1]] = inside
        blocks = padded.reshape(size[0] // _BLOCK, _BLOCK, size[1] // _BLOCK, _BLOCK)
        shared = np.broadcast_to(blocks.any(axis=(1, 3), keepdims=True), blocks.shape)
        shared = shared.reshape(size)[: grid.shape[0], : grid.shape[1]]
        near[grid[shared & ~inside]] = True
    return near.reshape(used.shape)


def _file_grid(shape: tuple[int, int], orientation: int) -> Int[np.ndarray, "rows columns"]:
    """Flat index in the picture as shown of each pixel of the file."""
    height, width = shape
    number = np.arange(height * width, dtype=np.int32)
    size = (width, height) if orientation in (5, 6, 7, 8) else shape
    grid = np.empty_like(number)
    grid[orient(number.reshape(size), orientation).reshape(-1)] = number
    return grid.reshape(size)


def _means_of(
    light: Float[np.ndarray, "h w 3"], part: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Means over squares, of what is in the part only; 0 where nothing is."""
    weight = part[..., None].astype(np.float64)
    total = np.concatenate([light * weight, weight], axis=2)
    for axis in (0, 1):
        sides = [(0, 0)] * 3
        sides[axis] = (_REACH + 1, _REACH)
        sums = np.cumsum(np.pad(total, sides), axis=axis)
        side = 2 * _REACH + 1
        total = np.split(sums, [side], axis=axis)[1] - np.split(sums, [-side], axis=axis)[0]
    return (total[..., :-1] / np.maximum(total[..., -1:], 1)).astype(np.float32)


def _whole_blocks(place: Int[np.ndarray, " u"], shape: tuple[int, ...]) -> Int[np.ndarray, " b"]:
    """Numbers of the blocks of 8 pixels that hold these, without those that the border cuts."""
    rows, cols = (part // 8 for part in np.divmod(place, shape[1]))
    whole = (rows < shape[0] // 8) & (cols < shape[1] // 8)
    return np.unique(rows[whole] * (shape[1] // 8) + cols[whole])


def _counts_of(
    codes: UInt8[np.ndarray, "h w c"], blocks: Int[np.ndarray, " b"], steps: Int[np.ndarray, "8 8"]
) -> Float[np.ndarray, "f m"]:
    """How often each number of steps of luma occurs in the blocks, for each of `_LOW`.

    Decoded codes are rounded, but their frequencies are off by half a code's step at most as a
    rule, and whole steps are larger.
    """
    from scipy.fft import dctn

    rows, cols = codes.shape[0] // 8, codes.shape[1] // 8
    luma = codes[: 8 * rows, : 8 * cols].astype(np.float32) @ _LUMA
    square = luma.reshape(rows, 8, cols, 8).swapaxes(1, 2).reshape(-1, 8, 8)[blocks]
    number = np.rint(dctn(square, axes=(1, 2), norm="ortho") / steps)
    number = np.clip(number, -_MOST_STEPS, _MOST_STEPS).astype(int) + _MOST_STEPS
    bins = 2 * _MOST_STEPS + 1
    return np.array([np.bincount(number[:, r, c], minlength=bins) for r, c in _LOW], float)


def _round_trip(codes: UInt8[np.ndarray, "h w 3"], jpeg: Jpeg) -> UInt8[np.ndarray, "h w c"]:
    """Encoded and decoded again."""
    tables: Any = [list(table) for table in jpeg.tables]
    stream = io.BytesIO()
    Image.fromarray(codes).save(stream, "JPEG", qtables=tables, subsampling=jpeg.sampling)
    stream.seek(0)
    with JpegImageFile(stream) as decoded:
        return np.asarray(decoded)
