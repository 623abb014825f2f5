"""The numbers of a result: what may be wrong with each identified value, beside noise."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ._of_photo import Alignment, PhotoResult
from ._result import Estimate
from ._verdict import MOST_CLIPPED, STRUCTURED_PX
from .diagnose._compression import Debiased, undo_compression
from .diagnose._evidence import BELIEVED, Evidence, belief_in, explained_share, square_sum_of
from .diagnose._influence import rounding_bound
from .diagnose._misfit import Doubts, find_doubts
from .diagnose._patterns import rms
from .diagnose._residuals import (
    air_light_of,
    left_over_of,
    structured_rms,
    width_slopes_of,
)
from .photo._camera import is_coarse
from .photo._columns import Columns, PhotoLike, grey_spread
from .photo._photo import Photo
from .photo._pixels import Pixels
from .solve._loss import Loss
from .solve._parameters import Entries, FitParameter, to_responses
from .solve._problem import Problem
from .solve._search import End
from .solve._task import Task


def grey_variance(
    problem: Problem, identified: Sequence[FitParameter], vector: Entries
) -> Float[np.ndarray, " t"]:
    """What is not known of how photos were made grey, as variance of the identified parameters.

    It is a factor on a grey photo's light: a separable look's amplitude, or the exposure beside a
    photo in colour. Of other looks no parameter is known to take it all.
    """
    columns, layout = problem.columns, problem.model.layout
    fact = layout.kind.SEPARABLE
    factors = np.ones(3) if fact is None else layout.values(vector)[fact.factors]
    grey = [c.mix is not None for c in columns]
    found = np.zeros(len(identified))
    for k, p in enumerate(identified):
        number = int(p.name.partition(".")[2] or 1) - 1 if p.family == "exposure" else 0
        unsure = grey[number] != grey[0] if p.family == "exposure" else grey[0]
        if unsure and p.family in ("exposure", fact.amplitude if fact is not None else ""):
            color = columns[number].color * factors
            found[k] = (grey_spread(color) * float(p.of(vector))) ** 2
    return found


def rounding_bias(evidence: Evidence) -> list[float | None]:
    """Each identified parameter's bound on the bias by the photos' rounding to codes."""
    half_steps = _half_steps(evidence.task.photos, evidence.problem.columns)
    return _shifted(evidence, half_steps)


def doubts_of(
    evidence: Evidence,
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    look_for_causes: bool,
) -> Doubts:
    """What may be wrong with the identified values beside noise."""
    problem = evidence.problem
    return find_doubts(
        evidence.point,
        evidence.task.layers,
        evidence.rows,
        evidence.spread.hessian,
        residuals,
        [belief_in(r, problem.model.loss) > BELIEVED for r in residuals],
        _half_steps(evidence.task.photos, problem.columns),
        evidence.task.sampling,
        look_for_causes,
    )


def _half_steps(
    photos: Sequence[PhotoLike], columns: Sequence[Columns]
) -> list[Float[np.ndarray, "_ 3"] | None]:
    """Half a code step of each used sample."""
    found: list[np.ndarray | None] = []
    for photo, c in zip(photos, columns, strict=True):
        steps = None
        if isinstance(photo, Photo) and photo.codes is not None and photo.half_steps is not None:
            steps = photo.half_steps[photo.codes.reshape(-1, 3)[c.index]]
        found.append(steps)
    return found


def layer_errors(evidence: Evidence) -> list[float | None]:
    """How far the layers' own errors can shift each identified parameter."""
    problem = evidence.problem
    if all(c.drawn_error is None for c in problem.columns):
        return [None] * len(evidence.identified)
    slopes = width_slopes_of(problem, evidence.point.vector)
    steps = [
        None if c.drawn_error is None else slope * c.drawn_error[:, None]
        for c, slope in zip(problem.columns, slopes, strict=True)
    ]
    return _shifted(evidence, steps)


def _shifted(evidence: Evidence, steps: Sequence[np.ndarray | None]) -> list[float | None]:
    """How far each identified parameter moves if all samples are off by so much, all conspiring."""
    rows = evidence.rows
    if not len(rows) or all(step is None for step in steps):
        return [None] * len(rows)
    bound = rounding_bound(evidence.point, steps, rows, evidence.spread.hessian)
    return [float(b) for b in bound]


def debias_jpeg(
    evidence: Evidence, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> Debiased | str:
    """The look before JPEG, or why it is not known."""
    task, problem, end = evidence.task, evidence.problem, evidence.end
    if task.blurs:
        return "with a blur it is not known how a photo is compressed"
    lossy = [p for p in task.photos if isinstance(p, Photo) and p.lossy]
    if not lossy:
        return "no photo is a JPEG"
    if any(p.jpeg is None for p in lossy) or problem.samples.mix is not None:
        return "a grey JPEG, or one of an uncommon kind, cannot be compressed again alike"
    if any(is_coarse(p.jpeg) for p in lossy if p.jpeg is not None):
        return "the file is compressed so much that it does not show its noise"
    if not end.settled or not evidence.point.directions.shape[1]:
        return "nothing was told that it could be taken off"
    clipped = 3 * sum(len(c.index) for c in problem.columns) - problem.count
    if clipped > MOST_CLIPPED * problem.count:
        return f"more than {MOST_CLIPPED:.0%} of the samples are clipped"
    return undo_compression(
        evidence.point,
        task.photos,
        task.layers,
        end.free,
        evidence.spread.covariance,
        residuals,
        evidence.spread.area,
        evidence.noise,
        evidence.spread.correlation_px > STRUCTURED_PX,
    )


def photo_results(
    task: Task,
    problem: Problem,
    end: End,
    pixels: Sequence[Pixels],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    alignments: Sequence[Alignment | None],
) -> list[PhotoResult]:
    """What each photo says of the end point."""
    found = []
    responses = to_responses(end.vector, task.layout)
    left_over, air = left_over_of(problem, end.vector), air_light_of(problem, end.vector)
    for number, (c, px, layers, residual, response) in enumerate(
        zip(problem.columns, pixels, task.layers, residuals, responses, strict=True)
    ):
        sums = [square_sum_of(channel) for channel in residual.T]
        count, square_sum = sum(n for n, _ in sums), sum(square for _, square in sums)
        found.append(
            PhotoResult(
                used=px.used,
                excluded=px.excluded,
                clipped=0 if c.clipped is None else int((c.clipped != 0).sum()),
                mix=c.mix,
                residual_rms=float(np.sqrt(square_sum / max(count, 1))),
                explained=explained_share(c.light, left_over[number], problem.model.loss)
                if end.finite
                else None,
                structure=_structure(c, residual, air[number], px.used.shape[1], problem.model.loss)
                if end.finite
                else None,
                response=response,
                width_unit=float(layers.width_unit),
                alignment=alignments[number],
            )
        )
    return found


def _structure(
    columns: Columns,
    residual: Float[np.ndarray, "n 3"],
    air: Float[np.ndarray, "n 3"],
    width: int,
    loss: Loss,
) -> float | None:
    """`PhotoResult.structure`; a robust loss's outliers are no structure of the look's."""
    believed = np.where(belief_in(residual, loss) > BELIEVED, residual, np.nan)
    light = rms(air)
    return structured_rms(believed, columns.index, width) / light if light > 0 else None


def _interval(p: FitParameter, value: float, reach: float) -> tuple[float, float]:
    """What is within reach of a value and allowed: no truth lies beyond a bound, so the interval
    that ends there covers as often."""
    return (
        min(max(value - reach, p.lower), value),
        max(min(value + reach, p.upper), value),
    )


def estimate(
    p: FitParameter,
    value: float,
    *,
    role: str,
    stderr: float | None = None,
    reach: float | None = None,
    bias: float | None = None,
    drawn: float | None = None,
    debiased: float | None = None,
) -> Estimate:
    return Estimate(
        value=value,
        stderr=stderr,
        interval=None if reach is None else _interval(p, value, reach),
        initial=p.value,
        role=role,
        unit=p.unit,
        bounds=(p.lower, p.upper),
        scale=p.scale,
        prior=None if p.prior is None else (p.prior.mean, p.prior.sigma),
        tied_to=p.tied_to,
        quantisation_bound=bias,
        layer_error=drawn,
        compression_shift=debiased,
        meaning=p.meaning,
    )
