"""Light that is not what the model says: found in what is left over, named, and priced.

Noise does not know where it is in the picture, how bright the light is or how thick the air. So
what is left over is held against what the usual causes would leave there: another tone curve, a
vignette, stray light, air that is no slab, blur and shift, colours that nobody fitted. Each cause
is a few columns beside the slopes of the fit, a linear least squares problem (a Lagrange multiplier
test: Breusch and Pagan, Rev. Econ. Stud. 47, 239, 1980). Its amounts β are judged against the
scatter of blocks, as the fit's own errors are (`_uncertainty`), so that noise may be correlated and
of any size: βᵀ V⁻¹ β is Hotelling's T², with the blocks' degrees of freedom.

How far a cause has moved the fitted values is the sum of each sample's influence times what the
cause adds to it. That much they may be off, and intervals widen by it.

A pixel may show a mean over its square where layers know its middle (`Sampling`). That is no fault
of the model: what it may move is counted, and what it explains is no misfit.

What acts as a parameter does shows in no test: a gain common to all pixels is exposure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import fdtrc

from model_jax import Layers

from ._parameters import Entries
from ._pixels import Columns, Sampling, on_device, to_samples, unlit_columns
from ._result import Misfit
from ._stream import Model
from ._uncertainty import (
    LEAST_BLOCK,
    LENGTHS,
    block_numbers,
    correlation,
    influences,
    inverse_root,
    predictions_of,
    stretch_of,
)

ALARM = 0.002
"""Chance of a false alarm of each cause and photo: about one fit in a hundred with all of them."""

MOST = 2**16
"""Pixels of a photo that are looked at: in that many a cause shows that is worth a word."""

SQUARE = 64
"""Pixels across the squares that these are chosen by, where a photo has more."""

PRIOR = 0.5
"""Amount of a cause that surprises nobody: a vignette of half the light, half a gamma, half a
pixel. Of what a test hardly sees no more is believed."""

APART = 6.0
"""Difference in Akaike's criterion up to which a photo does not tell two causes apart: odds of 20
to 1 (Akaike, IEEE Trans. Automat. Contr. 19, 716, 1974)."""

FEWEST = 3
"""Degrees of freedom for each amount, below which nothing is tested."""

SPANNED = 1e-8
"""Share of a cause's square sum below which others make it up, to the rounding of their sums."""

WINDOW = 256
"""Pixels across the part in which correlation is measured."""

CLIP = 4.0
"""Noise's distance from a clipped sample's bound within which no sample is looked at."""

ROUNDED = 0.25
"""Of half a code step, and"""
FAINT = 1e-4
"""of the light: what a cause must add for a word. Less may be rounding."""

_SEED = 16


@dataclass(frozen=True)
class Doubts:
    """What may be wrong with the fitted values beside noise."""

    misfits: tuple[Misfit, ...]
    """The plainest first."""
    covariance: Float[np.ndarray, "t t"]
    """Mean square of how far the told parameters are off: in each photo by the plainest cause, also
    one too faint for a word, and by pixels that show means over their squares."""


@dataclass(frozen=True)
class _Patch:
    """The pixels of one photo that are looked at."""

    columns: Columns
    size: tuple[int, int]
    light: Float[np.ndarray, "m 3"]
    """As predicted."""
    beside: Float[np.ndarray, "4 m 3"]
    """The same of the pixels to the left and right, above and below; NaN where it is not known."""

    @property
    def place(self) -> tuple[Float[np.ndarray, "m 1"], Float[np.ndarray, "m 1"]]:
        """Right and down of the picture's centre; 1 is half its diagonal."""
        row, column = np.divmod(self.columns.index, self.size[1])
        half = np.hypot(*self.size) / 2
        right = (column - (self.size[1] - 1) / 2) / half
        down = (row - (self.size[0] - 1) / 2) / half
        return right[:, None], down[:, None]


Pattern = Callable[[_Patch], list[Float[np.ndarray, "m 3"]]]
"""What a cause adds, by its amounts."""


def _tone(patch: _Patch) -> list[np.ndarray]:
    bright = np.maximum(patch.light, 0)
    top = np.nanmax(bright, initial=1e-300)
    share = bright / top
    return [bright * np.log(np.maximum(share, 1e-6)), bright * share]


def _places(patch: _Patch) -> list[np.ndarray]:
    right, down = patch.place
    return [right, down, right**2, right * down, down**2]


def _vignette(patch: _Patch) -> list[np.ndarray]:
    return [patch.light * place for place in _places(patch)]


def _stray(patch: _Patch) -> list[np.ndarray]:
    level = np.full(patch.light.shape, _rms(patch.light))
    return [level * place for place in _places(patch)]


def _air(patch: _Patch) -> list[np.ndarray]:
    found = []
    for width in (patch.columns.lit, patch.columns.dark):
        if width is not None and width.any():
            found.append(patch.light * (width / width.max())[:, None])
    return found


def _edges(patch: _Patch) -> list[np.ndarray]:
    """Derivatives by place: a shift right and down, and a blur along each. 0 beside what is not
    known."""
    left, right, above, below = patch.beside
    twice = 2 * patch.light
    parts = (right - left) / 2, (below - above) / 2, left + right - twice, above + below - twice
    return [np.nan_to_num(part) for part in parts]


def _average(patch: _Patch) -> np.ndarray:
    """What a mean over a pixel's square is more than the light in its middle.

    Of light that is bent as a parabola: a place's variance in the square, 1/12 along each side,
    times half the second derivative.
    """
    bend = patch.beside.sum(axis=0) - 4 * patch.light
    return np.asarray(np.nan_to_num(bend) / 24)


def _colour(patch: _Patch) -> list[np.ndarray]:
    level = _rms(patch.light)
    found = []
    for k in range(2):
        own = np.arange(3) == k
        found += [patch.light * own, np.broadcast_to(level * own, patch.light.shape)]
    return found


CAUSES: dict[str, tuple[str, Pattern]] = {
    "tone": ("how bright it is (another tone curve, or air that is no uniform slab)", _tone),
    "air": ("how thick the air is (air that is no uniform slab, or another tone curve)", _air),
    "vignette": (
        "a brightness that changes with the place (a vignette, or air that is lit unevenly)",
        _vignette,
    ),
    "stray": ("a background that changes with the place (stray light)", _stray),
    "edges": ("edges (layers shifted against the photo, or blur)", _edges),
    "colour": ("colour (of the air or the background, which was not fitted)", _colour),
}
"""Name, what light that is left over goes with, and what that looks like."""


def find_doubts(
    columns: Sequence[Columns],
    layers: Sequence[Layers],
    model: Model,
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    to_told: Float[np.ndarray, "t p"],
    hessian: Float[np.ndarray, "p p"],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    believed: Sequence[Bool[np.ndarray, "_ 3"]],
    half_steps: Sequence[Float[np.ndarray, "_ 3"] | None],
    sampling: Sampling,
    look_for_causes: bool,
) -> Doubts:
    """What each photo's left over light says of the model.

    Args:
        to_told: rows of the told parameters along the free directions.
        hessian: half the second derivative of the square sum, as in `Spread`.
        residuals: by `residuals_of`.
        believed: samples that a robust loss did not dismiss.
        half_steps: of the photos' codes.
        look_for_causes: else only what sampling does is counted.
    """
    if not len(to_told) or not (look_for_causes or sampling == "area"):
        return Doubts((), np.zeros((len(to_told), len(to_told))))
    influence = np.linalg.solve(hessian, to_told.T)
    length = np.linalg.norm(influence, axis=1)
    length = np.where(length > 0, length, 1.0)
    slopes_of = np.linalg.pinv(influence / length[:, None]) / length
    weight = np.zeros(len(vector)) if model.prior is None else np.asarray(model.prior.weight)
    prior = (along.T * weight) @ along
    nobody = np.zeros(0, np.intp)
    unit = float(layers[0].width_unit)
    found: list[Misfit] = []
    covariance = np.zeros((len(to_told), len(to_told)))
    for number, (c, of) in enumerate(zip(columns, layers, strict=True)):
        height, width = np.shape(of.front)
        size = (height, width)
        chosen = _chosen(c.index, size)
        if not len(chosen):
            continue

        def alone(part: Columns, number: int = number) -> list[Columns]:
            return [part if k == number else _part(o, nobody) for k, o in enumerate(columns)]

        part = _part(c, chosen)
        samples = on_device(to_samples(alone(part)))
        slopes = [slope for _, slope in influences(samples, model, vector, along @ influence)]
        near, place = _neighbours(part.index, of)
        around = alone(unlit_columns(of, near, part, unit))
        light = predictions_of(around, on_device(to_samples(around)), model, vector)[number]
        seen, *beside = np.concatenate([light, np.full((1, 3), np.nan)])[place]
        patch = _Patch(part, size, seen, np.stack(beside))
        left = np.where(believed[number][chosen], residuals[number][chosen], np.nan)
        left[_may_clip(part, seen, CLIP * _rms(left))] = np.nan
        steps = half_steps[number]
        least = max(FAINT * _rms(seen), 0.0 if steps is None else ROUNDED * _rms(steps[chosen]))
        share = len(chosen) / len(c.index)
        curved = hessian * share
        add_own = len(layers) == 1 and share < 1
        if add_own:  # a part's own products, for the sums of what nearly cancels are its own
            curved = prior * share
        sums = _Sums.of(
            patch, np.concatenate(slopes, axis=-1), left, to_told, slopes_of, curved, add_own
        )
        if sums is None:
            continue
        if sampling == "area":
            shift = sums.shift_of(sums.average)
            average = sums.amounts(sums.average, [sums.slopes]) if look_for_causes else None
            covariance += shift @ shift.T * _likely(average)
            if average is not None:
                sums = sums.without_average(float(np.clip(average.amounts[0], 0, 1)))
        if look_for_causes:
            misfits, moved = _doubts_of(sums, number, least)
            found += misfits
            covariance += moved
    return Doubts(tuple(sorted(found, key=lambda misfit: -misfit.share)), covariance)


def _may_clip(
    columns: Columns, light: Float[np.ndarray, "m 3"], room: float
) -> Bool[np.ndarray, "m 3"]:
    """Samples whose predicted light is within room of what was clipped: of these noise chose the
    measured ones."""
    found = np.zeros(light.shape, bool)
    if columns.clipped is None:
        return found
    for sign in (1, -1):
        bounds = sign * columns.light[columns.clipped == sign]
        if bounds.size:
            found |= sign * light > bounds.min() - room
    return found


def _doubts_of(
    sums: "_Sums", number: int, least: float
) -> tuple[list[Misfit], Float[np.ndarray, "t t"]]:
    """Of one photo: what is worth a word, and by how much told parameters may be off; a mean
    square.

    Args:
        least: what a cause must add for a word, as a root mean square of light.
    """
    moved = np.zeros((len(sums.told), len(sums.told)))
    misfits: list[Misfit] = []
    beside = [sums.slopes]
    causes = dict(sums.causes)
    while causes:
        tested = {cause: sums.amounts(part, beside) for cause, part in causes.items()}
        found = {cause: amounts for cause, amounts in tested.items() if amounts is not None}
        plain = {cause: amounts for cause, amounts in found.items() if amounts.chance <= ALARM}
        if not plain:
            break
        cause = max(plain, key=lambda c: plain[c].gained)
        one = plain[cause]
        near = {c: f for c, f in found.items() if one.information - f.information < APART}
        if len(beside) == 1:
            moved = np.mean([f.moved for f in near.values()], axis=0)
        if one.gained > sums.count * least**2:
            rivals = tuple(sorted(near.keys() - {cause}, key=lambda c: -near[c].information))
            misfits.append(Misfit(number, cause, rivals, one.gained / sums.left, one.chance))
        # What the plainest cause explains no other needs to.
        beside.append(causes.pop(cause))
    return misfits, moved


def _likely(average: "_Amounts | None") -> float:
    """Mean square of how much of the mean over its square a pixel shows, 0 to 1.

    The photo's own word and a prior of ½ ± ½, as normal distributions.
    """
    if average is None:
        return 0.5
    weight = 0.25 / (0.25 + average.covariance[0, 0])
    mean = weight * average.amounts[0] + (1 - weight) / 2
    return float(min(mean**2 + weight * average.covariance[0, 0], 1.0))


@dataclass(frozen=True)
class _Amounts:
    """What was found of a cause."""

    amounts: Float[np.ndarray, " k"]
    """Of each of its columns."""
    covariance: Float[np.ndarray, "k k"]
    """Of these, by the scatter of blocks."""
    chance: float
    """That noise looks like this."""
    gained: float
    """Square sum of the light that goes with the cause and with nothing beside it."""
    information: float
    """Akaike's criterion, negative: the more, the likelier is the cause."""
    moved: Float[np.ndarray, "t t"]
    """Mean square of how far all light of the cause moves the told parameters, in amounts that are
    likely by the photo and by `PRIOR`."""


@dataclass(frozen=True)
class _Sums:
    """Products of slopes, causes and what is left over, summed over blocks.

    Every question is one of least squares in few columns, and these answer all of them.
    """

    products: Float[np.ndarray, "blocks k k"]
    count: int
    told: Float[np.ndarray, "t p"]
    """Rows of the told parameters."""
    slopes_of: Float[np.ndarray, "t p"]
    """Makes slopes along the free directions of influences."""
    curved: Float[np.ndarray, "p p"]
    """Half the second derivative of the square sum, of so many pixels."""
    slopes: slice
    causes: dict[str, slice]
    average: slice
    """The column of `_average`; what is left over comes after it, the last."""

    @staticmethod
    def of(
        patch: _Patch,
        slopes: Float[np.ndarray, "t 3 m"],
        left: Float[np.ndarray, "m 3"],
        told: Float[np.ndarray, "t p"],
        slopes_of: Float[np.ndarray, "t p"],
        curved: Float[np.ndarray, "p p"],
        add_own: bool,
    ) -> "_Sums | None":
        """Of measured samples; None if there is none.

        Blocks are larger than what is left over without all causes hangs together. `curved` is
        without these samples' own products where they are to be added.
        """
        known = np.isfinite(left)
        if not known.any():
            return None
        columns = [slope.T for slope in slopes]
        causes = {}
        for name, (_, pattern) in CAUSES.items():
            parts = pattern(patch)
            causes[name] = slice(len(columns), len(columns) + len(parts))
            columns += parts
        columns += [_average(patch), left]
        rows = np.stack([column[known] for column in columns], axis=1)
        numbers = block_numbers(patch.columns.index, patch.size, LEAST_BLOCK)
        products = _summed(rows, np.broadcast_to(numbers[:, None], known.shape)[known])
        count = len(columns)
        rest = np.full(left.shape, np.nan)
        rest[known] = rows[:, -1] - rows[:, :-2] @ _solved(
            products.sum(axis=0), np.arange(count - 2)
        )
        length, _, _ = correlation([patch.columns], [patch.size], [rest], WINDOW)
        units = int(np.ceil(LENGTHS * length / LEAST_BLOCK)) if length > 1 else 1
        if units > 1:
            # Blocks of 8 pixels side by side make up one of several times 8.
            larger = block_numbers(patch.columns.index, patch.size, LEAST_BLOCK * units)
            _, first = np.unique(numbers, return_index=True)
            whole = np.zeros((int(larger.max()) + 1, count, count))
            np.add.at(whole, larger[first[: len(products)]], products)
            products = whole
        slope = slice(0, len(slopes))
        if add_own:
            curved = curved + slopes_of.T @ products.sum(axis=0)[slope, slope] @ slopes_of
        average = slice(count - 2, count - 1)
        return _Sums(products, len(rows), told, slopes_of, curved, slope, causes, average)

    @cached_property
    def total(self) -> Float[np.ndarray, "k k"]:
        """Over all blocks."""
        return np.asarray(self.products.sum(axis=0))

    @property
    def left(self) -> float:
        """Square sum of what is left over."""
        return float(self.total[-1, -1])

    def shift_of(self, part: slice) -> Float[np.ndarray, "t q"]:
        """By which one unit of columns moves the told parameters, were all pixels such as these."""
        pulled = self.slopes_of.T @ self.total[self.slopes, part]
        root = inverse_root(self.curved)
        return np.asarray(self.told @ root @ (root.T @ pulled))

    def without_average(self, share: float) -> "_Sums":
        """The same with so much of the mean over pixels' squares taken from what is left over."""
        change = np.eye(len(self.total))
        change[self.average, -1] = -share
        return replace(self, products=change.T @ self.products @ change)

    def amounts(self, part: slice, beside: Sequence[slice]) -> _Amounts | None:
        """How much of a cause's columns is in what is left over, others beside it.

        None where the others span the columns, or blocks are too few to tell.
        """
        size = len(self.total)
        others = np.concatenate([np.arange(size)[one] for one in beside])
        own = np.zeros((size, part.stop - part.start))
        own[part] = np.eye(own.shape[1])
        own[others] = -_solved(self.total, others, part)
        kept = _independent(own.T @ self.total @ own, np.diag(self.total)[part])
        q = kept.shape[1]
        if not q:
            return None
        white = own @ kept
        amounts = white.T @ self.total[:, -1]
        rest = -white @ amounts
        rest[-1] = 1.0
        rest[others] -= _solved(self.total, others)
        squares = np.einsum("ki,gkl,lj->gij", white, self.products, white, optimize=True)
        scores = np.einsum("ki,gkl,l->gi", white, self.products, rest, optimize=True)
        scores = np.einsum("gij,gj->gi", stretch_of(squares), scores)
        share = np.trace(squares, axis1=1, axis2=2) / q
        freedom = 1 / float(share @ share)  # of equal blocks their number
        if freedom < FEWEST * q:
            return None
        middle = scores.T @ scores
        if not np.linalg.cond(middle) < 1 / SPANNED:
            return None  # nothing scatters: what is left over is rounding
        ratio = float(amounts @ np.linalg.solve(middle, amounts)) / q
        ratio *= (freedom - q + 1) / freedom
        # What the photo says of the amounts and what is said before, multiplied.
        told = np.linalg.inv(middle)
        likely = np.linalg.inv(told + kept.T @ kept / PRIOR**2)
        mean = likely @ told @ amounts
        moved = self.shift_of(part) @ kept
        return _Amounts(
            amounts=kept @ amounts,
            covariance=kept @ middle @ kept.T,
            chance=float(fdtrc(q, freedom - q + 1, ratio)),
            gained=float(amounts @ amounts),
            information=float(amounts @ amounts) * q / float(np.trace(middle)) - 2 * q,
            moved=moved @ np.outer(mean, mean) @ moved.T,
        )


def _independent(
    products: Float[np.ndarray, "k k"], squares: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k q"]:
    """Combinations of columns that others do not span, which make their products the unit matrix.

    Args:
        products: of the columns without what others span.
        squares: of the columns themselves.
    """
    size = np.sqrt(np.where(squares > 0, squares, np.inf))
    values, vectors = np.linalg.eigh(products / size / size[:, None])
    own = values > SPANNED
    return np.asarray(vectors[:, own] / np.sqrt(values[own]) / size[:, None])


def _solved(
    products: Float[np.ndarray, "k k"], of: Int[np.ndarray, " n"], part: slice | None = None
) -> np.ndarray:
    """Least squares of columns `of` for a part of the others, or for what is left over.

    By the normal equations, of columns of one length; told tints are dependent.
    """
    target = products[of, -1] if part is None else products[of, part]
    size = np.sqrt(np.diag(products)[of])
    size = np.where(size > 0, size, 1.0)
    scaled = products[np.ix_(of, of)] / size / size[:, None]
    found = np.linalg.pinv(scaled, rcond=SPANNED**1.5, hermitian=True) @ (target.T / size).T
    return np.asarray((found.T / size).T)


def _summed(
    rows: Float[np.ndarray, "n k"], numbers: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "blocks k k"]:
    """Products of columns over the rows of each number, which come in order."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1))
    found = np.zeros((int(numbers[-1]) + 1, rows.shape[1], rows.shape[1]))
    for start, part in zip(starts, np.split(rows, starts[1:]), strict=True):
        found[numbers[start]] = part.T @ part
    return found


def _chosen(index: Int[np.ndarray, " n"], size: tuple[int, int]) -> Int[np.ndarray, " m"]:
    """Positions of the pixels that are looked at, block by block: whole squares, until they are
    enough."""
    chosen = np.arange(len(index))
    if len(index) > MOST:
        number = block_numbers(index, size, SQUARE)
        order = np.random.default_rng(_SEED).permutation(int(number.max()) + 1)
        enough = np.searchsorted(np.cumsum(np.bincount(number)[order]), MOST) + 1
        chosen = np.flatnonzero(np.isin(number, order[:enough]))
    return chosen[np.argsort(block_numbers(index[chosen], size, LEAST_BLOCK), kind="stable")]


def _neighbours(
    index: Int[np.ndarray, " m"], layers: Layers
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "5 m"]]:
    """Pixels whose light is known from the layers, of these and those beside them; and where among
    them each pixel, its left, right, upper and lower neighbour are, the end where they are not."""
    height, width = np.shape(layers.front)
    known = ~np.isnan(np.asarray(layers.front) + np.asarray(layers.back))
    if layers.surface is None and layers.planet is not None:
        known &= np.asarray(layers.planet) == 0
    row, column = np.divmod(index, width)
    steps = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))
    rows, columns = (np.stack([part + s[k] for s in steps]) for k, part in enumerate((row, column)))
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    flat = np.where(inside, rows * width + columns, 0)
    inside &= known.reshape(-1)[flat]
    near = np.unique(flat[inside])
    return near, np.where(inside, np.searchsorted(near, flat), len(near))


def _part(columns: Columns, chosen: Int[np.ndarray, " m"]) -> Columns:
    def part(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[chosen]

    return replace(
        columns,
        index=columns.index[chosen],
        lit=columns.lit[chosen],
        dark=part(columns.dark),
        light=columns.light[chosen],
        surface=part(columns.surface),
        clipped=part(columns.clipped),
        drawn_error=part(columns.drawn_error),
    )


def _rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known.astype(np.float64) ** 2))) if known.size else 0.0
