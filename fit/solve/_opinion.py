"""A second opinion on an end point: the least square sum there is, where that has a closed form
(`_separable`), else a second descent, by another method from another start.
"""

from collections.abc import Sequence

import jax
import numpy as np

from .._compile import float64
from ._approach import approach
from ._descend import descend, make_solver
from ._parameters import Entries, FitParameter, chart, free_directions, is_outside
from ._polish import finish, put_inside
from ._problem import Problem
from ._reduce import moments
from ._samples import Samples
from ._separable import is_separable, least_square_sum

AGREE = 1e-6
"""Relative difference of two square sums that counts as one valley."""
_ELSEWHERE = 1.1
"""Share of a square sum of the reduced samples from which another is of another valley."""
_SECOND_STEPS = 64
"""Steps of the second descent, on the reduced samples, where they cost little."""


def second_opinion(
    problem: Problem,
    vector: Entries,
    square_sum: float,
    free: Sequence[FitParameter],
    solver: str,
    start: Entries,
    margin: float,
) -> tuple[str, Entries]:
    """How the end compares with the best there is, and a better one if it is "lower".

    "closed form" where that is known and no lower; else how a descent by another method from
    another start came out: "same", "higher" or "lower".
    """
    directions, _ = free_directions(free, problem.parameters)
    margin = max(100 * margin, AGREE * square_sum)
    if problem.plain and problem.model.linear and problem.model.prior is None:
        reduced = problem.reduced if problem.reduced.one is not None else _moments_of_plain(problem)
        least = least_square_sum(
            jax.device_get(reduced), vector, free, problem.parameters, problem.model.layout
        )
        if least is not None and not is_outside(least.vector, free):
            # A factor of sums of products knows a square sum to some eps of all light.
            room = margin + 64 * np.finfo(np.float64).eps * problem.count * problem.light_max**2
            lower = least.square_sum < square_sum - room
            return ("lower" if lower else "closed form"), least.vector
    away = vector.copy()
    for p in problem.parameters:
        if p in free and not p.mean_one:
            away[list(p.entries)] = p.of(start)
    if np.allclose(away, vector, rtol=1e-3):
        away[directions.any(axis=1)] *= 1.3
    away = put_inside(away, free, problem.parameters)
    if is_separable(problem.model.layout):
        other = make_solver("lm" if solver != "lm" else "dogleg")
        near = chart(away, free, problem.parameters)
        descent = descend(near, problem.reduced, problem.model, other, _SECOND_STEPS)
    else:
        with float64():
            descent = approach(problem, away, free, _SECOND_STEPS, [away])
            here = float(problem.rough().gram(vector, directions)[-1, -1])
        if not descent.finite or descent.history[-1] > _ELSEWHERE * here:
            return "higher", vector
        free = [p for p in free if p not in descent.at_bound]
    if not descent.finite:
        return "higher", vector
    found, gram = finish(problem, descent.entries, free)
    best = float(gram[-1, -1])
    if best > square_sum + margin:
        return "higher", vector
    return ("lower" if best < square_sum - margin else "same"), found


def _moments_of_plain(problem: Problem) -> Samples:
    """Moments of a problem that was solved on all its samples."""
    with float64():
        return moments(problem.samples)
