"""From samples to a checked end point: start, descend, finish exactly, hold what is not told.

    starts ──> descend on few pseudo-pixels, or on all ──> exact steps ──> what is told?
    (_starts)  (_reduce, _descend; _approach)              (_polish)       within bounds?

What the pixels do not tell is held at its start value, what ran against its bounds is held there;
each time the rest is fitted again. The end point is judged here, not by the solver: by the square
sum that one more Gauss–Newton step promises, at a bound by the sign of the slope, and by a second
opinion (`_opinion`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from optimistix import LevenbergMarquardt

from .._compile import float64
from ._approach import approach
from ._descend import Descent, Solver, descend, make_solver, square_sums
from ._flat import Flat, find_flat
from ._opinion import second_opinion
from ._parameters import (
    Entries,
    FitParameter,
    chart,
    followers,
    free_directions,
    is_outside,
    settle_shares,
)
from ._polish import CHECK, finish, is_on_kink, is_settled, put_inside, sample_variance
from ._problem import Point, Problem
from ._samples import Samples
from ._separable import is_separable
from ._starts import start_vectors

_NEAR = 1e-3
"""Distance from a bound, in typical sizes, from which it is tried there."""
_ROUNDED = 1e-6
"""How far below its least value, in typical sizes, rounding may bring what is there."""
_OPINIONS = 2
"""How often a second descent that ends lower becomes the first."""


@dataclass(frozen=True)
class End:
    """Where the search ended."""

    vector: Entries
    free: tuple[FitParameter, ...]
    """Still free: neither at a bound nor held."""
    at_bound: tuple[FitParameter, ...]
    flat: tuple[Flat, ...]
    """What the pixels do not tell, held at the start."""
    finite: bool
    settled: bool
    """The checks of the end point hold."""
    gram: Float[np.ndarray, "q q"]
    """The exact pass at the end, along `free_directions(free)`."""
    history: tuple[float, ...]
    """Square sums at the accepted steps of the first descent."""
    steps: int
    second: str
    """How the second opinion came out, in words."""

    @property
    def square_sum(self) -> float:
        return float(self.gram[-1, -1])


def search(  # long: one loop, and each of its branches changes what the next round holds
    problem: Problem,
    start: Entries,
    asked: Sequence[FitParameter],
    solver: str,
    max_steps: int,
    *,
    seeds: list[Entries] | None = None,
    last: bool = True,
) -> End:
    """The best vector within bounds, and what of it the pixels tell.

    Args:
        start: what is held stays at these values.
        seeds: where to start from, instead of looking for it.
        last: get a second opinion.
    """
    method = make_solver(solver)
    parameters = problem.parameters
    free, held = list(asked), settle_shares(start, asked, parameters)
    flat: list[Flat] = []
    at_bound: list[FitParameter] = []
    inside: set[str] = set()  # tried at its bound, and better off it
    first: Descent | None = None
    candidates = seeds
    opinions = 0
    rough = problem  # where descents are made
    while True:
        descent = _descend(rough, held, free, method, max_steps, candidates)
        first = first or descent
        if not descent.finite:
            return _diverged(held, free, at_bound, flat, first)
        at_bound, free = [*at_bound, *descent.at_bound], _without(free, descent.at_bound)
        vector, gram = finish(problem, descent.entries, free)
        directions, moved = free_directions(free, parameters)
        if not np.isfinite(gram).all():
            return _diverged(vector, free, at_bound, flat, first)
        if rough is problem and _ends_elsewhere(problem, gram):
            rough, held, candidates = problem.whole(), vector, [vector]
            continue
        found = find_flat(Point(problem, vector, directions), gram, moved)
        if found:
            flat += found
            gone = [p for one in found for p in one.held]
            free = _without(free, gone)
            held = settle_shares(_restored(vector, start, gone, parameters), free, parameters)
            candidates = None
            continue
        margin = 1e-2 * CHECK * sample_variance(problem, gram) + problem.rounding
        near = [p for p in free if p.name not in inside and _is_near_bound(p, vector)]
        if near:
            beyond = is_outside(vector, near)
            rest = _without(free, near)
            tried = settle_shares(_at_bounds(vector, near, parameters), rest, parameters)
            tried = _best_from(rough, tried, rest, method, max_steps)
            if beyond or problem.square_sum(tried) <= float(gram[-1, -1]) + margin:
                at_bound, free = at_bound + near, rest
                held, candidates = tried, [tried]
            else:
                inside |= {p.name for p in near}
                held, candidates = vector, [vector]
            continue
        low = [p for p in free if p.of(vector) < p.least - _ROUNDED * p.scale]
        if low:
            held = _placed(vector, {p: p.least for p in low}, parameters)
            at_bound, free = at_bound + low, _without(free, low)
            held = settle_shares(held, free, parameters)
            candidates = [_best_from(rough, held, free, method, max_steps)]
            continue
        loose = _loose(problem, vector, free, at_bound, margin)
        if loose is not None and loose.name not in inside:
            inside.add(loose.name)
            at_bound.remove(loose)
            free.append(loose)
            held, candidates = vector, [vector]
            continue
        second = ""
        if last and directions.shape[1]:
            square_sum = float(gram[-1, -1])
            second, other = second_opinion(problem, vector, square_sum, free, solver, start, margin)
            if second == "lower" and opinions < _OPINIONS:
                opinions += 1
                held, candidates = other, [other]
                continue
        break
    return End(
        vector=vector,
        free=tuple(free),
        at_bound=tuple(at_bound),
        flat=tuple(flat),
        finite=True,
        settled=second != "lower"
        and (is_settled(problem, gram) or is_on_kink(Point(problem, vector, directions), gram)),
        gram=gram,
        history=first.history,
        steps=first.steps,
        second=second,
    )


def _descend(
    problem: Problem,
    held: Entries,
    free: Sequence[FitParameter],
    solver: Solver,
    max_steps: int,
    candidates: list[Entries] | None,
) -> Descent:
    """The solver's descent, on as few pseudo-pixels as serve."""
    if not free_directions(free, problem.parameters)[0].shape[1]:
        return Descent(held, True, 0, ())
    with float64():
        samples = problem.reduced
        if not is_separable(problem.model.layout):
            near = approach(problem, held, free, max_steps, candidates)
            if (near.settled and type(solver) is LevenbergMarquardt) or not near.finite:
                return near
            candidates = [near.entries]
        elif candidates is None:
            candidates = start_vectors(
                samples, held, free, problem.parameters, problem.model.layout
            )
        start = _lowest(candidates, samples, free, problem)
    return descend(
        chart(start, free, problem.parameters), samples, problem.model, solver, max_steps
    )


def _lowest(
    candidates: Sequence[Entries],
    samples: Samples,
    free: Sequence[FitParameter],
    problem: Problem,
) -> Entries:
    """The start with the least square sum, taken inside its bounds as the descent will."""
    if len(candidates) == 1:
        return candidates[0]
    inside = np.stack([put_inside(vector, free, problem.parameters) for vector in candidates])
    costs = np.asarray(square_sums(jnp.asarray(inside), samples, problem.model))
    return candidates[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]


def _ends_elsewhere(problem: Problem, gram: np.ndarray) -> bool:
    """Whether few pixels led to a place from which exact steps do not end: then all have to lead.

    Where a valley is long, its lowest place for a few pixels is far from that for all, and steps
    that know no bounds stop at the first.
    """
    return (
        not is_separable(problem.model.layout)
        and not problem.is_rough
        and problem.reduced is not problem.samples
        and not is_settled(problem, gram)
    )


def _is_near_bound(p: FitParameter, vector: Entries) -> bool:
    """So near a bound, or beyond it, that being on it has to be tried."""
    value = float(p.of(vector))
    room = _NEAR * max(abs(p.value), p.scale)
    return value - p.lower <= room or p.upper - value <= room


def _best_from(
    problem: Problem,
    vector: Entries,
    free: Sequence[FitParameter],
    solver: Solver,
    max_steps: int,
) -> Entries:
    descent = _descend(problem, vector, free, solver, max_steps, [vector])
    if not descent.finite:
        return vector
    return finish(problem, descent.entries, _without(free, descent.at_bound))[0]


def _without(free: Sequence[FitParameter], held: Sequence[FitParameter]) -> list[FitParameter]:
    names = {p.name for p in held}
    return [p for p in free if p.name not in names]


def _loose(
    problem: Problem,
    vector: Entries,
    free: Sequence[FitParameter],
    at_bound: Sequence[FitParameter],
    margin: float,
) -> FitParameter | None:
    """A parameter at a bound from which the square sum falls by more than the margin."""
    for p in at_bound:
        directions = np.zeros((len(vector), 1))
        directions[list(p.entries)] = 1.0
        if p.mean_one:  # the others make room
            others = [q.entries[0] for q in free if q.mean_one]
            directions[others, 0] -= vector[others] / (vector[others].sum() or 1.0)
        curved, slope = problem.gram(vector, directions)[0]
        inward = slope if p.of(vector) <= p.floor else -slope
        if inward < 0 and slope**2 > margin * curved:
            return p
    return None


def _at_bounds(
    vector: Entries, stuck: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Entries:
    def nearer(p: FitParameter) -> float:
        value = float(p.of(vector))
        return p.lower if abs(value - p.lower) <= abs(p.upper - value) else p.upper

    return _placed(vector, {p: nearer(p) for p in stuck}, parameters)


def _placed(
    vector: Entries, values: Mapping[FitParameter, float], parameters: Sequence[FitParameter]
) -> Entries:
    """The vector with some parameters, and what is tied to them, at values."""
    held = vector.copy()
    for p, value in values.items():
        for q in followers(p, parameters):
            held[list(q.entries)] = value
    return held


def _restored(
    vector: Entries,
    start: Entries,
    held: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
) -> Entries:
    """The vector with what is not told back at its start."""
    names = {p.name for p in held}
    back = vector.copy()
    for p in parameters:
        if p.name in names or p.tied_to in names:
            back[list(p.entries)] = start[list(p.entries)]
    return back


def _diverged(
    held: Entries,
    free: Sequence[FitParameter],
    at_bound: Sequence[FitParameter],
    flat: Sequence[Flat],
    first: Descent,
) -> End:
    nothing = np.full((1, 1), np.nan)
    return End(
        held,
        tuple(free),
        tuple(at_bound),
        tuple(flat),
        False,
        False,
        nothing,
        first.history,
        first.steps,
        "",
    )
