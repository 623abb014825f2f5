"""Light that is not what the model says: found in what is left over, named, and priced.

Noise does not know where it is in the picture, how bright the light is or how thick the air. So
what is left over is held against what the usual causes would leave there: another tone curve, a
vignette, stray light, air that is no slab, blur and shift, colours that nobody fitted. Each cause
is a few columns beside the slopes of the fit, a linear least squares problem (a Lagrange multiplier
test: Breusch and Pagan, Rev. Econ. Stud. 47, 239, 1980). Its amounts β are judged against the
scatter of blocks, as the fit's own errors are (`_spread`), so that noise may be correlated and
of any size: βᵀ V⁻¹ β is Hotelling's T², with the blocks' degrees of freedom.

How far a cause has moved the fitted values is the sum of each sample's influence times what the
cause adds to it. That much they may be off, and intervals widen by it.

A pixel may show a mean over its square where layers know its middle (`Sampling`). That is no fault
of the model: what it may move is counted, and what it explains is no misfit.

What acts as a parameter does shows in no test: a gain common to all pixels is exposure.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from model_jax import Layers

from .._choices import Sampling
from .._result import Misfit
from ..photo._blocks import block_numbers
from ..photo._columns import Columns, unlit_columns
from ..solve._problem import Point
from ._amounts import Amounts, Sums
from ._influence import influences
from ._patterns import Patch, rms
from ._residuals import predictions_of
from ._spread import LEAST_BLOCK

ALARM = 0.002
"""Chance of a false alarm of each cause and photo: about one fit in a hundred with all of them."""

MOST = 2**16
"""Pixels of a photo that are looked at: in that many a cause shows that is worth a word."""

SQUARE = 64
"""Pixels across the squares that these are chosen by, where a photo has more."""

APART = 6.0
"""Difference in Akaike's criterion up to which a photo does not tell two causes apart: odds of 20
to 1 (Akaike, IEEE Trans. Automat. Contr. 19, 716, 1974)."""

CLIP = 4.0
"""Noise's distance from a clipped sample's bound within which no sample is looked at."""

ROUNDED = 0.25
"""Share of half a code step, and"""
FAINT = 1e-4
"""of the light: what a cause must add for a word. Less may be rounding."""

_SEED = 16
"""Shuffles the squares: the same pixels are looked at each time."""


@dataclass(frozen=True)
class Doubts:
    """What may be wrong with the fitted values beside noise."""

    misfits: tuple[Misfit, ...]
    """The plainest first."""
    covariance: Float[np.ndarray, "t t"]
    """Mean square of how far the identified parameters are off: in each photo by the plainest
    cause, also one too faint for a word, and by pixels that show means over their squares."""


def find_doubts(
    point: Point,
    layers: Sequence[Layers],
    to_identified: Float[np.ndarray, "t p"],
    hessian: Float[np.ndarray, "p p"],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    believed: Sequence[Bool[np.ndarray, "_ 3"]],
    half_steps: Sequence[Float[np.ndarray, "_ 3"] | None],
    sampling: Sampling,
    look_for_causes: bool,
) -> Doubts:
    """What each photo's left over light says of the model.

    Args:
        to_identified: rows of the identified parameters along the free directions.
        hessian: half the second derivative of the square sum, as in `Spread`.
        residuals: by `residuals_of`.
        believed: samples that a robust loss did not dismiss.
        half_steps: of the photos' codes.
        look_for_causes: else only what sampling does is counted.
    """
    if not len(to_identified) or not (look_for_causes or sampling == "area"):
        return Doubts((), np.zeros((len(to_identified), len(to_identified))))
    columns, directions, known = point.problem.columns, point.directions, point.problem.model.prior
    influence = np.linalg.solve(hessian, to_identified.T)
    length = np.linalg.norm(influence, axis=1)
    length = np.where(length > 0, length, 1.0)
    slopes_of = np.linalg.pinv(influence / length[:, None]) / length
    size = directions.shape[1]
    prior = np.zeros((size, size)) if known is None else known.curvature(directions)
    nobody = np.zeros(0, np.intp)
    unit = float(layers[0].width_unit)
    found: list[Misfit] = []
    covariance = np.zeros((len(to_identified), len(to_identified)))
    for number, (c, of) in enumerate(zip(columns, layers, strict=True)):
        height, width = np.shape(of.front)
        size = (height, width)
        chosen = _chosen(c.index, size)
        if not len(chosen):
            continue

        def alone(part: Columns, number: int = number) -> list[Columns]:
            return [part if k == number else o.part(nobody) for k, o in enumerate(columns)]

        part = c.part(chosen)
        here = replace(point, problem=point.problem.beside(alone(part)))
        slopes = [slope for _, slope in influences(here, influence)]
        near, place = _neighbours(part.index, of)
        unlit = unlit_columns(of, near, part, unit)
        light = predictions_of(point.problem.beside(alone(unlit)), point.vector)[number]
        light = light[np.argsort(unlit.index, kind="stable")]  # as `near` is
        seen, *beside = np.concatenate([light, np.full((1, 3), np.nan)])[place]
        patch = Patch(part, size, seen, np.stack(beside))
        left = np.where(believed[number][chosen], residuals[number][chosen], np.nan)
        left[_may_clip(part, seen, CLIP * rms(left))] = np.nan
        steps = half_steps[number]
        least = max(FAINT * rms(seen), 0.0 if steps is None else ROUNDED * rms(steps[chosen]))
        share = len(chosen) / len(c.index)
        curved = hessian * share
        add_own = len(layers) == 1 and share < 1
        if add_own:  # a part's own products, for the sums of what nearly cancels are its own
            curved = prior * share
        sums = Sums.of(
            patch, np.concatenate(slopes, axis=-1), left, to_identified, slopes_of, curved, add_own
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
    sums: "Sums", number: int, least: float
) -> tuple[list[Misfit], Float[np.ndarray, "t t"]]:
    """What is worth a word in one photo, and by how much identified parameters may be off; a mean
    square.

    Args:
        least: what a cause must add for a word, as a root mean square of light.
    """
    moved = np.zeros((len(sums.identified), len(sums.identified)))
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


def _likely(average: Amounts | None) -> float:
    """Mean square of how much of the mean over its square a pixel shows, 0 to 1.

    The photo's own word and a prior of ½ ± ½, as normal distributions.
    """
    if average is None:
        return 0.5
    weight = 0.25 / (0.25 + average.covariance[0, 0])
    mean = weight * average.amounts[0] + (1 - weight) / 2
    return float(min(mean**2 + weight * average.covariance[0, 0], 1.0))


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
