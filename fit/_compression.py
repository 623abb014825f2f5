"""What JPEG has done to the fitted values, undone: the fit again on photos that are made up.

A JPEG rounds each block's frequencies in steps, of colours at half the resolution. Where noise does
not dither these steps the errors hang together along the whole limb, and nothing in the residuals
shows it. But the file says how it was compressed, so that it can be done again: looks drawn around
the fitted one are pictured, given the photo's noise, compressed as it was, and fitted. A straight
line through those pairs,

    fitted = a + A look + scatter,

read backwards at what the photo gave, is the look before compression; the scatter, read backwards
too, is its covariance (indirect inference: Gouriéroux, Monfort and Renault, "Indirect inference",
J. Applied Econometrics 8, S85, 1993). Where steps swallow what the look changes, A falls below one
and the covariance grows.

All this holds if the files made up are such as the photo's. Their frequencies tell: a file that was
compressed before, with other steps, has some numbers of steps too often and others never
(Lukáš and Fridrich, "Estimation of primary quantization matrix in double compressed JPEG images",
DFRWS 2003). Where they differ, or hardly any frequency is left, nothing is undone.
"""

import io
import os
import zlib
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int, UInt, UInt8
from PIL import Image
from PIL.JpegImagePlugin import JpegImageFile

from model_jax import Layers

from ._compile import float64
from ._parameters import Entries, Parameter, is_outside
from ._photo import Jpeg, Photo, orient
from ._pixels import (
    Columns,
    PhotoLike,
    on_device,
    relit,
    size_of,
    take_columns,
    to_samples,
    with_codes,
)
from ._search import Problem, gauss_newton
from ._stream import Model, Prior
from ._uncertainty import area_of, predictions_of

SEED = 20261123
"""Of the made-up noise, together with a photo's codes: a fit gives the same result each time, and
what few looks happen to say of one photo is not said of all."""

PAIRS = 32
"""Looks a round, at least; four for each number of the line with many free parameters."""

ROUNDS = 4
SETTLED = 4.0
"""Rounds end when no direction's variance has grown by more than this: looks were then drawn
`WIDTH` / 2 standard errors wide at least. From so few looks a covariance that has not grown at all
seems to have grown by about 2 in one of six directions."""

WIDTH = 1.5
"""Looks are drawn so many standard errors wide: narrower leaves the line's slope to the scatter,
wider takes the bend of what is no line for scatter."""

LEVEL = 0.05
"""A line that rises by less in some direction says nothing there; looks are drawn wider."""

ALIKE = 2.0
"""Times the area of residuals that compression makes, up to which it is why a photo's hang
together: those of a dozen such photos were 0.7 to 1.5 times as large, those of a look that does not
fit the air 600 times."""

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
_LUMA = np.array([0.299, 0.587, 0.114], np.float32)
"""Of codes, as JFIF weighs them (ITU-R BT.601)."""
_COMPARED = 8
"""Files made up to compare with."""

_TUNINGS = 5
_MEASURED = 4
"""Pairs of a round whose residuals' area is measured; more than the largest one counts."""
_ROBUST_STEPS = 4
"""A robust loss's step leaves a fifth of the way: it weighs samples as they lay before."""
_HALVINGS = 20
_BAND = 128
"""Rows of a window, whose encoding and decoding needs no other."""
_BLOCK = 16
"""The largest coded block, and a margin: more than any decoder smooths colour across."""
_REACH = 4
"""Half the squares over which unused pixels are averaged: a ninth of their noise is left."""
_CELLS = 2**18
"""Of light, with a code each: 1/80 of the narrowest code of sRGB."""
_ALIKE = 5.0
"""Standard deviations up to which an unused pixel agrees with the model."""


@dataclass(frozen=True)
class Undone:
    """What the line says, along the free directions."""

    shift: Float[np.ndarray, " p"]
    """From the fitted vector to the look before compression."""
    covariance: Float[np.ndarray, "p p"]
    freedom: float
    """Degrees of freedom of the covariance: pairs less the line's numbers."""


def is_coarse(jpeg: Jpeg) -> bool:
    """Too much was rounded away."""
    steps = np.reshape(jpeg.tables[0], (8, 8))
    return bool(np.mean([steps[place] for place in _LOW]) > COARSEST)


def undo_compression(
    photos: Sequence[PhotoLike],
    layers: Sequence[Layers],
    problem: Problem,
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    free: Sequence[Parameter],
    covariance: Float[np.ndarray, "p p"],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    area: float,
    noise: float,
    structured: bool,
) -> Undone | str:
    """The look before compression, or why the photos do not tell it, in words.

    Args:
        vector: where the fit ended.
        covariance: of it, by the residuals: how wide to look at first.
        residuals: of each photo, by `residuals_of`.
        area: pixels of the residuals that count as one.
        noise: standard deviation of a sample, which priors are measured in.
        structured: the residuals hang together as noise does not; compression may be why.
    """
    unit = float(layers[0].width_unit)
    near = []
    for photo, of, c in zip(photos, layers, problem.columns, strict=True):
        used = np.zeros(size_of(photo), bool)
        used.reshape(-1)[c.index] = True
        near.append(take_columns(photo, of, _near(photo, used), unit))
    around = on_device(to_samples(near))
    model = problem.model

    def picture(here: Entries) -> list[tuple[np.ndarray, np.ndarray]]:
        """Light of the used pixels and of those near, photo by photo."""
        light = predictions_of(problem.columns, problem.samples, model, here)
        near_light = predictions_of(near, around, model, here)
        return list(zip(light, near_light, strict=True))

    robust = model.loss.name != "linear"
    fitted_parts = zip(photos, problem.columns, near, picture(vector), residuals, strict=True)
    cameras = [_Camera(p, c, by, *seen, left, robust) for p, c, by, seen, left in fitted_parts]
    sizes = [size_of(photo) for photo in photos]
    p = along.shape[1]
    count = max(PAIRS, 4 * (p + 1))

    def fitted(
        step: Float[np.ndarray, " p"], seed: np.random.SeedSequence, measured: bool
    ) -> tuple[Float[np.ndarray, " p"], float]:
        """What a fit would give for a look a step away; the area of its residuals."""
        rng = np.random.default_rng(seed)
        here = vector + along @ step
        seen = picture(here)
        shots = [c.take(*parts, rng) for c, parts in zip(cameras, seen, strict=True)]
        again = replace(problem, samples=relit(problem.samples, shots))
        if model.prior is not None:
            again = replace(again, model=_reminded(model, here, noise, rng))
        end = step
        for _ in range(_ROBUST_STEPS if robust else 1):
            end = end - gauss_newton(again.gram(vector + along @ end, along))
        if not measured:
            return end, 0.0
        left = [_left(shot, light) for shot, (light, _) in zip(shots, seen, strict=True)]
        return end, area_of(problem.columns, sizes, left)

    def made_area(seed: np.random.SeedSequence) -> float:
        """The area of residuals that are made of noise and compression alone."""
        rng = np.random.default_rng(seed)
        shots = [c.take(*parts, rng) for c, parts in zip(cameras, picture(vector), strict=True)]
        again = replace(problem, samples=relit(problem.samples, shots))
        end = vector - along @ gauss_newton(again.gram(vector, along))
        light = predictions_of(problem.columns, problem.samples, model, end)
        left = [_left(*pair) for pair in zip(shots, light, strict=True)]
        return area_of(problem.columns, sizes, left)

    if structured and area > ALIKE * made_area(np.random.SeedSequence(SEED)):
        return "what is left over hangs together as compression does not make it"
    chance = [SEED, *(_checksum(photo) for photo in photos)]
    shift = np.zeros(p)
    found: Undone | None = None
    with ThreadPoolExecutor(_threads(problem)) as pool:
        for number in range(ROUNDS):
            *seeds, own = np.random.SeedSequence([*chance, number]).spawn(count + 1)
            steps = _draw(shift, covariance, count, np.random.default_rng(own))
            steps = np.stack([_inside(step, shift, vector, along, free) for step in steps])
            measured = [k < _MEASURED for k in range(count)]
            ends, areas = zip(*pool.map(fitted, steps, seeds, measured), strict=True)
            read = _read_backwards(steps, np.stack(ends))
            if read is None:
                covariance = 4 * covariance
                continue
            before, (shift, covariance) = covariance, read
            shift = _bounded(shift, covariance, vector, along, free)
            # Made-up noise does not hang together before compression; noise that did tells less.
            covariance = covariance * max(1.0, area / max(areas))
            found = Undone(shift, covariance, float(count - p - 1))
            if _growth(before, covariance) <= SETTLED:
                break
    if found is None:
        return "files compressed alike are the same for all looks near"
    light = picture(vector + along @ found.shift)
    for camera, parts in zip(cameras, light, strict=True):
        unlike = camera.unlike(*parts)
        if unlike:
            return unlike
    return found


def _checksum(photo: PhotoLike) -> int:
    codes = photo.codes if isinstance(photo, Photo) else None
    return 0 if codes is None else zlib.crc32(np.ascontiguousarray(codes).data)


def _left(columns: Columns, light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """As `residuals_of`."""
    left = columns.light - light
    if columns.clipped is not None:
        left[columns.clipped != 0] = np.nan
    return left


def _threads(problem: Problem) -> int:
    """As many as there are cores, but no more than have a few hundred megabytes together."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    pixels = sum(len(c.lit) for c in problem.columns)
    return max(1, min(cores, 2**22 // max(pixels, 1)))


def _draw(
    center: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, "n p"]:
    """Steps `WIDTH` standard errors wide, in opposite pairs: they tell level and slope apart."""
    values, vectors = np.linalg.eigh(covariance)
    root = WIDTH * np.sqrt(np.maximum(values, 0)) * vectors
    half = rng.normal(size=(-(-count // 2), len(center))) @ root.T
    return np.asarray(center + np.concatenate([half, -half])[:count])


def _inside(
    step: Float[np.ndarray, " p"],
    center: Float[np.ndarray, " p"],
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    free: Sequence[Parameter],
) -> Float[np.ndarray, " p"]:
    """The step, its way from the centre halved until it stays within all bounds."""
    for _ in range(_HALVINGS):
        if not is_outside(vector + along @ step, free):
            return step
        step = (center + step) / 2
    return center


def _bounded(
    shift: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    free: Sequence[Parameter],
) -> Float[np.ndarray, " p"]:
    """The likeliest shift within all bounds, given that they hold: what is beyond goes to its
    bound, and what is correlated with it follows."""
    for _ in range(2 * len(free)):
        here = vector + along @ shift
        beyond = [p for p in free if not p.lower <= p.of(here) <= p.upper]
        if not beyond:
            break
        row = along[beyond[0].entries[0]]
        pull = covariance @ row
        excess = beyond[0].of(here) - np.clip(beyond[0].of(here), beyond[0].lower, beyond[0].upper)
        # An ulp further, or rounding leaves it outside.
        shift = shift - pull * (excess * (1 + 1e-9) / (row @ pull))
    return shift


def _read_backwards(
    steps: Float[np.ndarray, "n p"], ends: Float[np.ndarray, "n p"]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "p p"]] | None:
    """Which step ends at 0, and the covariance of that; None where the line is nearly level.

    In coordinates in which the steps are white: a line that rises by 1 in all directions must not
    seem level where two parameters are correlated.
    """
    count, p = steps.shape
    size = steps.std(axis=0)
    if not ((size > 0).all() and np.isfinite(ends).all()):
        return None
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov((steps / size).T)))
    if not values[0] > 0:
        return None
    root = size[:, None] * vectors * np.sqrt(values)
    white = np.linalg.inv(root).T
    rows = np.column_stack([np.ones(count), steps @ white])
    line = np.linalg.lstsq(rows, ends @ white, rcond=None)[0]
    left = ends @ white - rows @ line
    scatter = left.T @ left / (count - p - 1)
    level, slope = line[0], line[1:].T
    if np.linalg.svd(slope, compute_uv=False)[-1] < LEVEL:
        return None
    back = np.linalg.inv(slope)
    found = -back @ level
    here = np.append(1.0, found)
    unsure = 1 + here @ np.linalg.solve(rows.T @ rows, here)
    covariance = back @ scatter @ back.T * unsure
    return root @ found, root @ covariance @ root.T


def _growth(before: Float[np.ndarray, "p p"], after: Float[np.ndarray, "p p"]) -> float:
    """Largest ratio of variances in any direction."""
    values, vectors = np.linalg.eigh(before)
    root = vectors / np.sqrt(np.maximum(values, 1e-12 * values[-1]))
    return float(np.linalg.eigvalsh(root.T @ after @ root)[-1])


def _reminded(model: Model, here: Entries, noise: float, rng: np.random.Generator) -> Model:
    """The prior of a look that is a step away is one step away, and as unsure as it says."""
    prior = model.prior
    assert prior is not None
    weight = np.asarray(prior.weight)
    sigma = np.where(weight > 0, noise / np.sqrt(np.where(weight > 0, weight, 1)), 0)
    mean = here + sigma * rng.normal(size=len(here))
    with float64():
        return replace(model, prior=Prior(jnp.asarray(mean), prior.weight))


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
    """Of those that are used, and not in the margins."""
    blocks: Int[np.ndarray, " b"]
    """Numbers of the whole blocks that hold one of these."""


class _Camera:
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
            found = bands.spread(_left(taken, light), robust)
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


def _near(photo: PhotoLike, used: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
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
    """How often each number of steps of brightness occurs in the blocks, for each of `_LOW`.

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
