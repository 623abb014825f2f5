"""Exact Gauss–Newton steps over all samples, and whether an end point needs another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import optimistix as optx
from jaxtyping import Float

from ._descend import FINISH, Solver, descend
from ._parameters import Entries, FitParameter, chart, free_directions, is_outside, settle_shares
from ._problem import Point, Problem
from ._scaled import unit_diagonal

CHECK = 1e-6
"""How far, as a share of the variance of one sample, the square sum at the end may lie above what a
Gauss–Newton step promises: the parameters are then within 1e-3 standard errors of the optimum."""

KINK = 1e-2
"""The same where steps break their promise: a look with a kink in it, such as `max(0, …)`, may have
its optimum on one pixel's, where slopes are those of one side. That is a tenth of a standard
error."""

_FINISHES = 4
_FINISH_STEPS = 8
"""Tries, and steps of each: Gauss–Newton doubles the digits where the model is nearly linear."""


def put_inside(
    vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Entries:
    """The vector with free parameters clipped to their bounds."""
    clipped = vector.copy()
    for p in free:
        clipped[list(p.entries)] = np.clip(p.of(vector), p.lower, p.upper)
    return settle_shares(clipped, free, parameters)


def finish(
    problem: Problem, vector: Entries, free: Sequence[FitParameter]
) -> tuple[Entries, Float[np.ndarray, "q q"]]:
    """Exact Gauss–Newton steps until the gradient over all samples is at rounding level.

    On the entries themselves, for the chart's maps round by several eps, all pixels alike; where
    such a step leaves the bounds or makes things worse, through optimistix on the chart.

    Returns the vector and the exact pass there, along `free_directions(free)`.
    """
    directions, _ = free_directions(free, problem.parameters)
    point = Point(problem, vector, directions)
    gram = point.gram()
    if not directions.shape[1]:
        return vector, gram
    point, gram = _steps(point, gram, free)
    solver: Solver = optx.GaussNewton(rtol=FINISH, atol=FINISH)
    for _ in range(_FINISHES):
        if _is_done(problem, gram):
            break
        near = chart(point.vector, free, problem.parameters)
        descent = descend(near, problem.samples, problem.model, solver, _FINISH_STEPS)
        if not descent.finite or not descent.history[-1] < gram[-1, -1]:
            break
        point = replace(point, vector=descent.entries)
        point, gram = _steps(point, point.gram(), free)
    return point.vector, gram


def _steps(
    point: Point, gram: Float[np.ndarray, "q q"], free: Sequence[FitParameter]
) -> tuple[Point, Float[np.ndarray, "q q"]]:
    """Plain steps until the gradient is at its own rounding, or they keep no promise; and the pass
    where they end.

    A promise over the square sum is the squared cosine between residuals and slopes, and a cosine
    of sums is known to some eps. Two sums of n squares that should be one differ by 2 √n eps.
    """
    eps = float(np.finfo(np.float64).eps)
    same = 1 + 2 * eps * np.sqrt(point.problem.count)
    promise = _promise(gram)
    for _ in range(_FINISH_STEPS):
        square_sum = float(gram[-1, -1])
        if not (64 * eps) ** 2 * square_sum + eps * point.problem.rounding < promise < np.inf:
            break
        tried = point.moved(-gauss_newton(gram))
        if not np.isfinite(tried.vector).all() or is_outside(tried.vector, free):
            break
        after = tried.gram()
        left = _promise(after)
        if not (after[-1, -1] <= same * square_sum and left < promise):
            break
        point, gram, promise = tried, after, left
    return point, gram


def _is_done(problem: Problem, gram: np.ndarray) -> bool:
    """A hundredth of the accuracy that is checked in the end, in the square sum."""
    room = 1e-2 * CHECK * sample_variance(problem, gram) + problem.rounding / 4
    return bool(_promise(gram) <= room)


def _promise(gram: Float[np.ndarray, "q q"]) -> float:
    """Gauss–Newton's word on how far the square sum would still fall: the gradient, scaled."""
    return float(gram[:-1, -1] @ gauss_newton(gram)) if np.isfinite(gram).all() else np.inf


def gauss_newton(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " p"]:
    """The step, to be subtracted, along the directions of the matrix."""
    scaled, size = unit_diagonal(gram[:-1, :-1])
    return np.asarray(np.linalg.lstsq(scaled, gram[:-1, -1] / size, rcond=1e-14)[0] / size)


def is_settled(problem: Problem, gram: np.ndarray) -> bool:
    """The check of the end point: no step would make the square sum smaller by what counts."""
    return bool(_promise(gram) <= CHECK * sample_variance(problem, gram) + problem.rounding)


def is_on_kink(point: Point, gram: np.ndarray) -> bool:
    """Whether a step is promised a little, and none, however short, keeps it."""
    variance = sample_variance(point.problem, gram)
    if not _promise(gram) <= KINK * variance:
        return False
    step, least = -gauss_newton(gram), float(gram[-1, -1])
    kept = [least - float(point.moved(share * step).gram()[-1, -1]) for share in (1, 1 / 4, 1 / 16)]
    return bool(max(kept) <= CHECK * variance + point.problem.rounding)


def sample_variance(problem: Problem, gram: np.ndarray) -> float:
    """What is left of the square sum for each sample that no direction has used up."""
    return float(gram[-1, -1]) / max(problem.count - (len(gram) - 1), 1)
