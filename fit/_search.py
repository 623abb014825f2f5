"""Descents until every free parameter is told by the pixels and within its bounds.

What the pixels do not tell is held at its start value, what left its bounds is held at the bound;
each time the rest is fitted again.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ._parameters import BRIGHTNESS, FreeParameter, LookVector, directions, settle_tint
from ._solve import Problem, Solver, descend, jacobian


@dataclass(frozen=True)
class End:
    """Where the search ended. Vectors are scaled (`Problem.units`)."""

    vector: LookVector
    free: tuple[FreeParameter, ...]
    """Still free: neither at a bound nor held."""
    at_bound: tuple[FreeParameter, ...]
    untold: tuple[tuple[FreeParameter, str], ...]
    """Held at the start because the pixels do not tell it, and why."""
    finite: bool


def search(
    problem: Problem,
    start: LookVector,
    asked: tuple[FreeParameter, ...],
    solver: Solver,
    max_steps: int,
) -> End:
    """The best vector within bounds, and what of it the pixels tell."""
    free, held = list(asked), start
    untold: list[tuple[FreeParameter, str]] = []
    at_bound: tuple[FreeParameter, ...] = ()
    while True:
        descent = descend(problem, held, free, solver, max_steps)
        if not descent.finite:
            return End(settle_tint(held, free), tuple(free), at_bound, tuple(untold), False)
        weak = _weakest(problem, descent.vector, free)
        if weak:
            parameters, why = weak
            untold += [(p, why) for p in parameters]
            held = settle_tint(held, free)
            free = [p for p in free if p not in parameters]
        elif not at_bound and _is_outside(descent.vector, free):
            at_bound = _best_bounds(problem, held, free, solver, max_steps)
            held = _hold_at_bounds(held, at_bound)
            free = [p for p in free if p not in at_bound]
        else:
            return End(descent.vector, tuple(free), at_bound, tuple(untold), True)


def _best_bounds(
    problem: Problem,
    held: LookVector,
    free: list[FreeParameter],
    solver: Solver,
    max_steps: int,
) -> tuple[FreeParameter, ...]:
    """Which parameters to hold at their lower bound: the set with the lowest square sum.

    All sets are tried (14 for one shadow weight, 56 for three, and brightness alone, beside which
    nothing else has an effect), because holding the worst offender first can end in a wrong corner.
    Upper bounds need no sets of their own: only tints have one, and no tint passes 3 before
    another one passes 0.
    """
    bounded = [p for p in free if p.family in ("tint", "shadow")]
    tints = {p for p in free if p.family == "tint"}
    sets = [
        chosen
        for size in range(1, len(bounded) + 1)
        for chosen in combinations(bounded, size)
        if not tints or not tints <= set(chosen)
    ]
    best: tuple[float, tuple[FreeParameter, ...]] = (np.inf, tuple(bounded))
    for chosen in [*sets, *((p,) for p in free if p.family == "brightness")]:
        rest = [p for p in free if p not in chosen]
        if chosen[0].family == "brightness":
            rest = [p for p in rest if p.family == "background"]
        descent = descend(problem, _hold_at_bounds(held, chosen), rest, solver, max_steps)
        if descent.finite and not _is_outside(descent.vector, rest):
            best = min(best, (problem.square_sum(descent.vector), chosen), key=lambda end: end[0])
    return best[1]


def _hold_at_bounds(vector: LookVector, parameters: tuple[FreeParameter, ...]) -> LookVector:
    held = vector.copy()
    for parameter in parameters:
        held[list(parameter.entries)] = parameter.bounds[0]
    return held


def _weakest(
    problem: Problem, vector: LookVector, free: list[FreeParameter]
) -> tuple[tuple[FreeParameter, ...], str] | None:
    """The first parameters whose effect on the picture the earlier ones can imitate, and why.

    Gram–Schmidt over the columns of the Jacobian, what is told first standing first. A column
    counts as imitated when what is left of it is below the error that rounded widths put there.
    """
    along, moved = directions(free)
    columns = jacobian(problem, vector, along)
    norms = np.linalg.norm(columns, axis=0)
    size = np.linalg.norm(problem.reduced.design)
    n = problem.reduced.count
    threshold = 64 * np.finfo(float).eps + 2 * problem.reduced.width_error * np.sqrt(n) / size
    basis = np.zeros((9, 0))
    for j, parameters in enumerate(moved):
        if norms[j] == 0:
            if vector[BRIGHTNESS] == 0 and parameters[0].family in ("tint", "shadow"):
                return parameters, "brightness is 0, so it has no effect"
            return parameters, "it has no effect in the pixels used"
        column = columns[:, j] / norms[j]
        for _ in range(2):  # the second pass removes what rounding left
            column = column - basis @ (basis.T @ column)
        left = np.linalg.norm(column)
        if left <= threshold:
            likeness = basis.T @ columns[:, j] / norms[j]
            like = sorted({moved[i][0].family for i in np.flatnonzero(np.abs(likeness) > 0.1)})
            other = " and ".join(like) if like else "the others"
            return parameters, f"in the pixels used it acts like {other}; held at its start value"
        basis = np.column_stack([basis, column / left])
    return None


def _is_outside(vector: LookVector, free: list[FreeParameter]) -> bool:
    return any(not p.bounds[0] <= p.of(vector) <= p.bounds[1] for p in free)
