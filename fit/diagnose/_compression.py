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

import os
import zlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import Layers

from .._compile import float64
from ..photo._camera import SEED, JpegCamera, left_over, near_used
from ..photo._columns import Columns, PhotoLike, size_of, take_columns
from ..photo._photo import Photo
from ..solve._model import Model
from ..solve._parameters import Entries, FitParameter, is_outside
from ..solve._polish import gauss_newton
from ..solve._problem import Point, Problem
from ..solve._samples import relit
from ._autocorrelation import area_of
from ._residuals import predictions_of

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
_MEASURED = 4
"""Pairs of a round whose residuals' area is measured; more than the largest one counts."""
_ROBUST_STEPS = 4
"""A robust loss's step leaves a fifth of the way: it weighs samples as they lay before."""
_HALVINGS = 20
"""After that many a step is a millionth of itself, and its centre is within bounds."""


@dataclass(frozen=True)
class Debiased:
    """What the line says, along the free directions."""

    shift: Float[np.ndarray, " p"]
    """From the fitted vector to the look before compression."""
    covariance: Float[np.ndarray, "p p"]
    freedom: float
    """Degrees of freedom of the covariance: pairs less the line's numbers."""


def undo_compression(
    point: Point,
    photos: Sequence[PhotoLike],
    layers: Sequence[Layers],
    free: Sequence[FitParameter],
    covariance: Float[np.ndarray, "p p"],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    area: float,
    noise: float,
    structured: bool,
) -> Debiased | str:
    """The look before compression, or why the photos do not tell it, in words.

    Args:
        point: where the fit ended, along the directions of what is free.
        covariance: of it, by the residuals: how wide to look at first.
        residuals: of each photo, by `residuals_of`.
        area: pixels of the residuals that count as one.
        noise: standard deviation of a sample, which priors are measured in.
        structured: the residuals hang together as noise does not; compression may be why.
    """
    again = _Again.of(point, photos, layers, residuals, noise)
    if structured and area > ALIKE * again.area(np.random.SeedSequence(SEED)):
        return "what is left over hangs together as compression does not make it"
    p = point.directions.shape[1]
    count = max(PAIRS, 4 * (p + 1))
    chance = [SEED, *(_checksum(photo) for photo in photos)]
    shift = np.zeros(p)
    found: Debiased | None = None
    with ThreadPoolExecutor(_threads(point.problem)) as pool:
        for number in range(ROUNDS):
            *seeds, own = np.random.SeedSequence([*chance, number]).spawn(count + 1)
            steps = _draw(shift, covariance, count, np.random.default_rng(own))
            steps = np.stack([_inside(step, shift, point, free) for step in steps])
            measured = [k < _MEASURED for k in range(count)]
            ends, areas = zip(*pool.map(again.fitted, steps, seeds, measured), strict=True)
            read = _read_backwards(steps, np.stack(ends))
            if read is None:
                covariance = 4 * covariance
                continue
            before, (shift, covariance) = covariance, read
            shift = _bounded(shift, covariance, point, free)
            # Made-up noise does not hang together before compression; noise that did tells less.
            covariance = covariance * max(1.0, area / max(areas))
            found = Debiased(shift, covariance, float(count - p - 1))
            if _growth(before, covariance) <= SETTLED:
                break
    if found is None:
        return "files compressed alike are the same for all looks near"
    return again.unlike(found.shift) or found


@dataclass(frozen=True)
class _Again:
    """The photos taken again of looks by a point, each fitted as the photos were."""

    point: Point
    near: Problem
    """Unused pixels that share a coded block with used ones."""
    sizes: tuple[tuple[int, int], ...]
    cameras: tuple[JpegCamera, ...]
    noise: float
    robust: bool

    @classmethod
    def of(
        cls,
        point: Point,
        photos: Sequence[PhotoLike],
        layers: Sequence[Layers],
        residuals: Sequence[Float[np.ndarray, "_ 3"]],
        noise: float,
    ) -> "_Again":
        problem, unit = point.problem, float(layers[0].width_unit)
        kind = problem.model.layout.kind
        near = []
        for photo, of, c in zip(photos, layers, problem.columns, strict=True):
            used = np.zeros(size_of(photo), bool)
            used.reshape(-1)[c.index] = True
            near.append(take_columns(photo, of, near_used(photo, used), unit, kind))
        around = problem.beside(near)
        robust = problem.model.loss.name != "linear"
        parts = zip(photos, problem.columns, near, _picture(point, around), residuals, strict=True)
        cameras = tuple(JpegCamera(p, c, by, *seen, left, robust) for p, c, by, seen, left in parts)
        sizes = tuple(size_of(photo) for photo in photos)
        return cls(point, around, sizes, cameras, noise, robust)

    def fitted(
        self, step: Float[np.ndarray, " p"], seed: np.random.SeedSequence, measured: bool
    ) -> tuple[Float[np.ndarray, " p"], float]:
        """What a fit would give for a look a step away; the area of its residuals, if measured."""
        rng, here = np.random.default_rng(seed), self.point.moved(step)
        seen, shots = self._shots(here, rng)
        model = self.point.problem.model
        if model.prior is not None:
            model = _reminded(model, here.vector, self.noise, rng)
        again = self._retaken(shots, model)
        end = step
        for _ in range(_ROBUST_STEPS if self.robust else 1):
            end = end - gauss_newton(again.moved(end).gram())
        if not measured:
            return end, 0.0
        left = [left_over(shot, light) for shot, (light, _) in zip(shots, seen, strict=True)]
        return end, area_of(self.point.problem.columns, self.sizes, left)

    def area(self, seed: np.random.SeedSequence) -> float:
        """The area of residuals that are made of noise and compression alone."""
        _, shots = self._shots(self.point, np.random.default_rng(seed))
        step = -gauss_newton(self._retaken(shots, self.point.problem.model).gram())
        light = predictions_of(self.point.problem, self.point.moved(step).vector)
        left = [left_over(*pair) for pair in zip(shots, light, strict=True)]
        return area_of(self.point.problem.columns, self.sizes, left)

    def unlike(self, shift: Float[np.ndarray, " p"]) -> str | None:
        """How the files made up differ from the photos'; None where they are alike."""
        seen = _picture(self.point.moved(shift), self.near)
        told = (camera.unlike(*parts) for camera, parts in zip(self.cameras, seen, strict=True))
        return next((why for why in told if why), None)

    def _shots(
        self, here: Point, rng: np.random.Generator
    ) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[Columns]]:
        """What a point predicts, and the photos taken of it."""
        seen = _picture(here, self.near)
        return seen, [c.take(*parts, rng) for c, parts in zip(self.cameras, seen, strict=True)]

    def _retaken(self, shots: Sequence[Columns], model: Model) -> Point:
        """The point, of the photos taken again."""
        problem = self.point.problem
        samples = relit(problem.samples, shots)
        return replace(self.point, problem=replace(problem, samples=samples, model=model))


def _picture(here: Point, near: Problem) -> list[tuple[np.ndarray, np.ndarray]]:
    """Light of the used pixels and of those near, photo by photo."""
    light = predictions_of(here.problem, here.vector)
    return list(zip(light, predictions_of(near, here.vector), strict=True))


def _checksum(photo: PhotoLike) -> int:
    codes = photo.codes if isinstance(photo, Photo) else None
    return 0 if codes is None else zlib.crc32(np.ascontiguousarray(codes).data)


def _threads(problem: Problem) -> int:
    """As many as there are cores, but no more than have a few hundred megabytes together."""
    has_affinity = hasattr(os, "sched_getaffinity")
    cores = len(os.sched_getaffinity(0)) if has_affinity else os.cpu_count() or 1
    pixels = sum(len(c.index) for c in problem.columns)
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
    point: Point,
    free: Sequence[FitParameter],
) -> Float[np.ndarray, " p"]:
    """The step, its way from the centre halved until it stays within all bounds."""
    for _ in range(_HALVINGS):
        if not is_outside(point.moved(step).vector, free):
            return step
        step = (center + step) / 2
    return center


def _bounded(
    shift: Float[np.ndarray, " p"],
    covariance: Float[np.ndarray, "p p"],
    point: Point,
    free: Sequence[FitParameter],
) -> Float[np.ndarray, " p"]:
    """The likeliest shift within all bounds, given that they hold: what is beyond goes to its
    bound, and what is correlated with it follows."""
    for _ in range(2 * len(free)):
        here = point.moved(shift).vector
        beyond = [p for p in free if not p.lower <= p.of(here) <= p.upper]
        if not beyond:
            break
        row = point.directions[beyond[0].entries[0]]
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
    mean = np.asarray(prior.rows) @ here + sigma * rng.normal(size=len(weight))
    with float64():
        return replace(model, prior=replace(prior, mean=jnp.asarray(mean)))
