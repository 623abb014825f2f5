"""From samples to a checked end point: start, descend, finish exactly, hold what is not told.

    starts ──> descend on few pseudo-pixels, or on all ──> exact steps ──> what is told?
    (_start)   (_reduce, _solve)                           (_stream)       within bounds?

What the pixels do not tell is held at its start value, what ran against its bounds is held there;
each time the rest is fitted again. The end point is judged here, not by the solver: by the square
sum that one more Gauss–Newton step promises, at a bound by the sign of the slope, and by a second
opinion: the least square sum there is, where that has a closed form (`_closed_form`), else a second
descent, by another method from another start.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._closed_form import least_square_sum
from ._compile import float64
from ._flat import Flat, find_flat
from ._parameters import (
    Entries,
    Parameter,
    chart,
    directions,
    is_outside,
    settle_tint,
)
from ._pixels import Columns
from ._reduce import THIN, bins, moments, thinned
from ._solve import FINISH, Descent, Solver, descend, exact_gram, make_solver, square_sums
from ._start import starts
from ._stream import Model, Samples

CHECK = 1e-6
"""How far, as a share of the variance of one sample, the square sum at the end may lie above what a
Gauss–Newton step promises: the parameters are then within 1e-3 standard errors of the optimum."""

AGREE = 1e-6
"""Relative difference of two square sums that counts as one valley."""

_NEAR = 1e-3
"""Distance from a bound, in typical sizes, from which it is tried there."""

_FINISHES = 4
_FINISH_STEPS = 8
_SECOND_STEPS = 64
_OPINIONS = 2
"""How often a second descent that ends lower becomes the first."""


@dataclass(frozen=True)
class Problem:
    """Samples and what may be done with them."""

    columns: tuple[Columns, ...]
    samples: Samples
    """All of `columns`, on the device."""
    few: Samples
    """What stands for all until the exact steps: as few pseudo-pixels as serve."""
    parameters: tuple[Parameter, ...]
    model: Model
    count: int
    """Measured samples, three to a pixel; without clipped ones and copies."""
    light_max: float
    """Largest |light|."""

    @property
    def plain(self) -> bool:
        """Least squares of measured samples."""
        return self.model.loss.name == "linear" and self.samples.clipped is None

    @property
    def rounding(self) -> float:
        """Square sum that float64 makes of nothing: an eps of the brightest for each sample."""
        return self.count * (np.finfo(np.float64).eps * self.light_max) ** 2

    def with_model(self, model: Model) -> "Problem":
        """The same samples, another loss."""
        return replace(self, model=model, few=_few(self.columns, self.samples, model))

    def rough(self) -> "Problem":
        """The few in place of all: for answers that are asked again."""
        return replace(self, samples=self.few)

    def gram(self, vector: Entries, along: Float[np.ndarray, "e p"]) -> Float[np.ndarray, "q q"]:
        """The exact pass over all samples."""
        with float64():
            return np.asarray(
                exact_gram(jnp.asarray(vector), jnp.asarray(along), self.samples, self.model)
            )

    def square_sum(self, vector: Entries) -> float:
        """Cost of a vector over all samples."""
        return float(self.gram(vector, np.zeros((len(vector), 0)))[-1, -1])


def state(
    columns: tuple[Columns, ...],
    samples: Samples,
    parameters: tuple[Parameter, ...],
    model: Model,
) -> Problem:
    """The problem of some columns, which `samples` holds on the device."""
    clipped = sum(int((c.clipped != 0).sum()) for c in columns if c.clipped is not None)
    measured = sum((3 - len(c.copies)) * len(c.lit) for c in columns)
    return Problem(
        columns=columns,
        samples=samples,
        few=_few(columns, samples, model),
        parameters=parameters,
        model=model,
        count=measured - clipped,
        light_max=max(_largest(c.light) for c in columns),
    )


def _largest(values: np.ndarray) -> float:
    """Largest absolute value; 0 of none."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))


def _few(columns: tuple[Columns, ...], samples: Samples, model: Model) -> Samples:
    with float64():
        if model.loss.name == "linear" and samples.clipped is None and model.linear:
            return moments(samples)
        if model.loss.name == "linear" and samples.surface is None:
            if samples.clipped is None:
                columns = tuple(replace(c, clipped=None) for c in columns)
            return bins(columns)
        if sum(len(c.lit) for c in columns) > 2 * THIN:
            return thinned(columns)
        return samples


@dataclass(frozen=True)
class End:
    """Where the search ended."""

    vector: Entries
    free: tuple[Parameter, ...]
    """Still free: neither at a bound nor held."""
    at_bound: tuple[Parameter, ...]
    flat: tuple[Flat, ...]
    """What the pixels do not tell, held at the start."""
    finite: bool
    settled: bool
    """The checks of the end point hold."""
    gram: Float[np.ndarray, "q q"]
    """Of the exact pass at the end, along `directions(free)`."""
    history: tuple[float, ...]
    """Square sums at the accepted steps of the first descent."""
    steps: int
    second: str
    """How the second opinion came out, in words."""

    @property
    def square_sum(self) -> float:
        return float(self.gram[-1, -1])


def search(
    problem: Problem,
    start: Entries,
    asked: Sequence[Parameter],
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
    free, held = list(asked), settle_tint(start, asked, parameters)
    flat: list[Flat] = []
    at_bound: list[Parameter] = []
    inside: set[str] = set()  # tried at its bound, and better off it
    first: Descent | None = None
    candidates = seeds
    opinions = 0
    while True:
        descent = _descend(problem, held, free, method, max_steps, candidates)
        first = first or descent
        if not descent.finite:
            return _diverged(held, free, at_bound, flat, first)
        vector, gram = _finish(problem, descent.entries, free)
        along, moved = directions(free, parameters)
        if not np.isfinite(gram).all():
            return _diverged(vector, free, at_bound, flat, first)
        found = find_flat(problem, vector, free, gram, along, moved)
        if found is not None:
            flat.append(found)
            gone = {p.name for p in found.held}
            free = [p for p in free if p.name not in gone]
            held = settle_tint(_restored(vector, start, found.held, parameters), free, parameters)
            candidates = None
            continue
        margin = 1e-2 * CHECK * _variance(problem, gram, along) + problem.rounding
        near = [p for p in free if p.name not in inside and _is_near_bound(p, vector)]
        if near:
            beyond = is_outside(vector, near)
            rest = [p for p in free if p not in near]
            tried = settle_tint(_at_bounds(vector, near, parameters), rest, parameters)
            tried = _best_from(problem, tried, rest, method, max_steps)
            if beyond or problem.square_sum(tried) <= float(gram[-1, -1]) + margin:
                at_bound, free = at_bound + near, rest
                held, candidates = tried, [tried]
            else:
                inside |= {p.name for p in near}
                held, candidates = vector, [vector]
            continue
        loose = _loose(problem, vector, free, at_bound, margin)
        if loose is not None and loose.name not in inside:
            inside.add(loose.name)
            at_bound.remove(loose)
            free.append(loose)
            held, candidates = vector, [vector]
            continue
        second = ""
        if last and along.shape[1]:
            square_sum = float(gram[-1, -1])
            second, other = _second_opinion(
                problem, vector, square_sum, free, solver, start, margin
            )
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
        settled=_is_settled(problem, gram, along) and second != "lower",
        gram=gram,
        history=first.history,
        steps=first.steps,
        second=second,
    )


def _descend(
    problem: Problem,
    held: Entries,
    free: Sequence[Parameter],
    solver: Solver,
    max_steps: int,
    candidates: list[Entries] | None,
) -> Descent:
    """The solver's descent, on as few pseudo-pixels as serve."""
    if not directions(free, problem.parameters)[0].shape[1]:
        return Descent(held, True, 0, ())
    with float64():
        samples = problem.few
        if candidates is None:
            candidates = starts(samples, held, free, problem.parameters)
        start = _lowest(candidates, samples, free, problem)
    return descend(
        chart(start, free, problem.parameters), samples, problem.model, solver, max_steps
    )


def _lowest(
    candidates: Sequence[Entries],
    samples: Samples,
    free: Sequence[Parameter],
    problem: Problem,
) -> Entries:
    """The start with the least square sum, taken inside its bounds as the descent will."""
    if len(candidates) == 1:
        return candidates[0]
    inside = np.stack([_inside(vector, free, problem.parameters) for vector in candidates])
    costs = np.asarray(square_sums(jnp.asarray(inside), samples, problem.model))
    return candidates[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]


def _inside(vector: Entries, free: Sequence[Parameter], parameters: Sequence[Parameter]) -> Entries:
    clipped = vector.copy()
    for p in free:
        clipped[list(p.entries)] = np.clip(p.of(vector), p.lower, p.upper)
    return settle_tint(clipped, free, parameters)


def _finish(
    problem: Problem, vector: Entries, free: Sequence[Parameter]
) -> tuple[Entries, Float[np.ndarray, "q q"]]:
    """Exact Gauss–Newton steps until the gradient over all samples is at rounding level.

    On the entries themselves, for the chart's maps round by several eps, all pixels alike; where
    such a step leaves the bounds or makes things worse, through optimistix on the chart.

    Returns the vector and the exact pass there, along `directions(free)`.
    """
    along, _ = directions(free, problem.parameters)
    gram = problem.gram(vector, along)
    if not along.shape[1]:
        return vector, gram
    vector, gram = _steps(problem, vector, gram, free, along)
    solver = make_solver("gauss_newton", FINISH)
    for _ in range(_FINISHES):
        if _is_done(problem, gram, along):
            break
        near = chart(vector, free, problem.parameters)
        descent = descend(near, problem.samples, problem.model, solver, _FINISH_STEPS)
        if not descent.finite or not descent.history[-1] < gram[-1, -1]:
            break
        vector = descent.entries
        vector, gram = _steps(problem, vector, problem.gram(vector, along), free, along)
    return vector, gram


def _steps(
    problem: Problem,
    vector: Entries,
    gram: Float[np.ndarray, "q q"],
    free: Sequence[Parameter],
    along: Float[np.ndarray, "e p"],
) -> tuple[Entries, Float[np.ndarray, "q q"]]:
    """Plain steps until the gradient is at its own rounding, or they keep no promise; and the pass
    where they end.

    A promise over the square sum is the squared cosine between residuals and slopes, and a cosine
    of sums is known to some eps.
    """
    eps = float(np.finfo(np.float64).eps)
    promise = _promise(gram)
    for _ in range(_FINISH_STEPS):
        square_sum = float(gram[-1, -1])
        if not (64 * eps) ** 2 * square_sum + eps * problem.rounding < promise < np.inf:
            break
        tried = vector - along @ gauss_newton(gram)
        if not np.isfinite(tried).all() or is_outside(tried, free):
            break
        after = problem.gram(tried, along)
        left = _promise(after)
        if not (after[-1, -1] <= (1 + 4 * eps) * square_sum and left < promise):
            break
        vector, gram, promise = tried, after, left
    return vector, gram


def _is_done(problem: Problem, gram: np.ndarray, along: np.ndarray) -> bool:
    """A hundredth of the accuracy that is checked in the end, in the square sum."""
    room = 1e-2 * CHECK * _variance(problem, gram, along) + problem.rounding / 4
    return bool(_promise(gram) <= room)


def _promise(gram: Float[np.ndarray, "q q"]) -> float:
    """Gauss–Newton's word on how far the square sum would still fall: the gradient, scaled."""
    return float(gram[:-1, -1] @ gauss_newton(gram)) if np.isfinite(gram).all() else np.inf


def gauss_newton(gram: Float[np.ndarray, "q q"]) -> Float[np.ndarray, " p"]:
    """The step, to be subtracted, along the directions of the matrix."""
    size = np.sqrt(np.maximum(np.diag(gram)[:-1], 0))
    size = np.where(size > 0, size, 1.0)
    scaled = gram[:-1, :-1] / size / size[:, None]
    return np.asarray(np.linalg.lstsq(scaled, gram[:-1, -1] / size, rcond=1e-14)[0] / size)


def _is_settled(problem: Problem, gram: np.ndarray, along: np.ndarray) -> bool:
    """The check of the end point: no step would make the square sum smaller by what counts."""
    return bool(_promise(gram) <= CHECK * _variance(problem, gram, along) + problem.rounding)


def _variance(problem: Problem, gram: np.ndarray, along: np.ndarray) -> float:
    return float(gram[-1, -1]) / max(problem.count - along.shape[1], 1)


def _is_near_bound(p: Parameter, vector: Entries) -> bool:
    """So near a bound, or beyond it, that being on it has to be tried."""
    value = float(p.of(vector))
    room = _NEAR * max(abs(p.value), p.scale)
    return value - p.lower <= room or p.upper - value <= room


def _best_from(
    problem: Problem,
    vector: Entries,
    free: Sequence[Parameter],
    solver: Solver,
    max_steps: int,
) -> Entries:
    descent = _descend(problem, vector, free, solver, max_steps, [vector])
    return _finish(problem, descent.entries, free)[0] if descent.finite else vector


def _loose(
    problem: Problem,
    vector: Entries,
    free: Sequence[Parameter],
    at_bound: Sequence[Parameter],
    margin: float,
) -> Parameter | None:
    """A parameter at a bound from which the square sum falls by more than the margin."""
    for p in at_bound:
        along = np.zeros((len(vector), 1))
        along[list(p.entries)] = 1.0
        if p.family == "tint":  # the other tints make room
            others = [q.entries[0] for q in free if q.family == "tint"]
            along[others, 0] -= vector[others] / (vector[others].sum() or 1.0)
        curved, slope = problem.gram(vector, along)[0]
        inward = slope if p.of(vector) <= p.lower else -slope
        if inward < 0 and slope**2 > margin * curved:
            return p
    return None


def _at_bounds(
    vector: Entries, stuck: Sequence[Parameter], parameters: Sequence[Parameter]
) -> Entries:
    held = vector.copy()
    for p in stuck:
        low = abs(float(p.of(vector)) - p.lower) <= abs(p.upper - float(p.of(vector)))
        for q in parameters:
            if q is p or q.tied_to == p.name:
                held[list(q.entries)] = p.lower if low else p.upper
    return held


def _restored(
    vector: Entries, start: Entries, held: Sequence[Parameter], parameters: Sequence[Parameter]
) -> Entries:
    """The vector with what is not told back at its start."""
    names = {p.name for p in held}
    back = vector.copy()
    for p in parameters:
        if p.name in names or p.tied_to in names:
            back[list(p.entries)] = start[list(p.entries)]
    return back


def _second_opinion(
    problem: Problem,
    vector: Entries,
    square_sum: float,
    free: Sequence[Parameter],
    solver: str,
    start: Entries,
    margin: float,
) -> tuple[str, Entries]:
    """How the end compares with the best there is, and a better one if it is "lower".

    "closed form" where that is known and no lower; else how a descent by another method from
    another start came out: "same", "higher" or "lower".
    """
    along, _ = directions(free, problem.parameters)
    margin = max(100 * margin, AGREE * square_sum)
    if problem.plain and problem.model.linear and problem.model.prior is None:
        few = problem.few if problem.few.one is not None else _few_of_plain(problem)
        least = least_square_sum(jax.device_get(few), vector, free, problem.parameters)
        if least is not None and not is_outside(least.vector, free):
            # A factor of sums of products knows a square sum to some eps of all light.
            room = margin + 64 * np.finfo(np.float64).eps * problem.count * problem.light_max**2
            lower = least.square_sum < square_sum - room
            return ("lower" if lower else "closed form"), least.vector
    other = make_solver("lm" if solver != "lm" else "dogleg")
    away = vector.copy()
    for p in problem.parameters:
        if p in free and p.family != "tint":
            away[list(p.entries)] = p.of(start)
    if np.allclose(away, vector, rtol=1e-3):
        away[along.any(axis=1)] *= 1.3
    away = _inside(away, free, problem.parameters)
    descent = descend(
        chart(away, free, problem.parameters), problem.few, problem.model, other, _SECOND_STEPS
    )
    if not descent.finite:
        return "higher", vector
    found, gram = _finish(problem, descent.entries, free)
    best = float(gram[-1, -1])
    if best > square_sum + margin:
        return "higher", vector
    return ("lower" if best < square_sum - margin else "same"), found


def _few_of_plain(problem: Problem) -> Samples:
    """Moments of a problem that was solved on all its samples."""
    with float64():
        return moments(problem.samples)


def _diverged(
    held: Entries,
    free: Sequence[Parameter],
    at_bound: Sequence[Parameter],
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
