"""Near the best fit of a look that is not separable: many starts, few descents, bounds as they are.

    spread over what the light is not linear in (`_starts`)
        ──> the best of what it is linear in: one exact pass, a bounded linear problem each
        ──> SciPy's trust region within a box from the best few, on few pixels
        ──> the lowest, and what it holds at a bound

Given all else, amplitudes and levels are a linear problem (variable projection: Golub and Pereyra,
SIAM J. Numer. Anal. 10, 413, 1973), so that starts need be spread over the others only. A solver
that knows no bounds sees one as infinitely far (`_bijections`), and a valley that is straight up to
it as bent: of air that hardly dims itself, an optical depth of 0 takes hundreds of such steps. So
this is done in values, with the bounds as a box (`_box`). What SciPy sees is the factor of an exact
pass: p + 1 residuals with the cost, gradient and curvature of all samples, as in `_gram`.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares, lsq_linear

from ._box import Box
from ._descend import Descent, exact_gram
from ._parameters import Entries, FitParameter, free_directions
from ._polish import put_inside
from ._problem import Problem
from ._reduce import factor_of
from ._samples import on_device
from ._starts import spread_starts

DESCENTS = 8
FIRST_STEPS = 12
"""Starts that a descent is made from, and its steps, before the lowest goes on: a valley that only
looked best makes room for another."""

TOLERANCE = 1e-10
"""Relative change of square sum and values at which a descent ends: the exact steps go on."""


class _Passes:
    """Exact passes in the coordinates of a box, the last one remembered."""

    def __init__(
        self, problem: Problem, free: Sequence[FitParameter], base: Entries, most: int = 0
    ) -> None:
        self.box = Box(free, problem.parameters, problem.model.layout.kind)
        self.base = base
        self.history: list[float] = []
        self._samples, self._model = on_device(problem.reduced), problem.model
        directions = free_directions(free, problem.parameters)[0]
        unused = np.zeros((len(directions), max(most - directions.shape[1], 0)))
        self._directions = np.concatenate([directions, unused], axis=1)
        self._last: tuple[np.ndarray, np.ndarray] | None = None

    def rows(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "q q"]:
        """p + 1 residuals, last, behind their slopes."""
        if self._last is None or (self._last[0] != values).any():
            found = self._gram(values)
            finite = np.isfinite(found).all()
            self._last = values.copy(), factor_of(found) if finite else np.full_like(found, np.nan)
        return self._last[1]

    def residuals(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " q"]:
        found = self.rows(values)[:, -1]
        square_sum = float(found @ found)
        if np.isfinite(square_sum) and square_sum < min(self.history, default=np.inf):
            self.history.append(square_sum)
        return found

    def slopes(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "q p"]:
        return self.rows(values)[:, :-1]

    def _gram(self, values: Float[np.ndarray, " n"]) -> Float[np.ndarray, "q q"]:
        vector = self.box.placed(self.base, values)
        found = np.asarray(
            exact_gram(
                jnp.asarray(vector), jnp.asarray(self._directions), self._samples, self._model
            )
        )
        if not np.isfinite(found).all():
            return np.full((len(values) + 1,) * 2, np.nan)
        # The box's coordinates move the vector along the same directions.
        along = np.linalg.pinv(self._directions) @ self.box.slopes(vector)
        turned = np.zeros((along.shape[1] + 1,) * 2)
        turned[:-1, :-1] = along.T @ found[:-1, :-1] @ along
        turned[-1, :-1] = turned[:-1, -1] = along.T @ found[:-1, -1]
        turned[-1, -1] = found[-1, -1]
        return turned


def approach(
    problem: Problem,
    held: Entries,
    free: Sequence[FitParameter],
    max_steps: int,
    starts: Sequence[Entries] | None = None,
    *,
    more: Sequence[Entries] = (),
    tolerance: float = TOLERANCE,
    most: int = 0,
) -> Descent:
    """The lowest place that a few descents find, from the best of starts, or of many spread ones.

    Square sums are of `problem.reduced`.

    Args:
        more: starts beside the spread ones.
        tolerance: where a descent ends.
        most: degrees of freedom that other calls have: one program then serves them all.
    """
    passes = _Passes(problem, free, held, most)
    if starts is None:
        linear = {"exposure", *(p.family for p in passes.box.levels)}
        if passes.box.amplitude is not None:
            linear.add(passes.box.amplitude.family)
        starts = [
            *spread_starts(held, free, problem.parameters, linear, problem.ranges),
            *more,
        ]
    placed = [_with_linear(put_inside(v, free, problem.parameters), passes) for v in starts]
    placed = sorted((p for p in placed if np.isfinite(p[0])), key=lambda p: p[0])[:DESCENTS]
    steps = max_steps if len(placed) == 1 else FIRST_STEPS
    found = [_descend(passes, values, steps, tolerance) for _, values in placed]
    found = [end for end in found if end.finite]
    if not found:
        return Descent(held, False, 0, ())
    best = min(found, key=lambda end: end.history[-1])
    if best.settled or len(placed) == 1:
        return best
    last = _descend(passes, passes.box.values(best.entries), max_steps, tolerance)
    history = (*best.history, *last.history[1:])
    return replace(last, steps=len(history) - 1, history=history)


def _with_linear(vector: Entries, passes: _Passes) -> tuple[float, Float[np.ndarray, " n"]]:
    """The least square sum over what the light is linear in, and where."""
    box = passes.box
    if box.amplitude is not None and not box.amplitude.of(vector) > 0:
        vector = vector.copy()
        vector[list(box.amplitude.entries)] = box.amplitude.scale
    values = np.clip(box.values(vector), box.lower, box.upper)
    rows = passes.rows(values)
    if not np.isfinite(rows).all():
        return np.inf, values
    if not box.linear:
        return float(rows[:, -1] @ rows[:, -1]), values
    first = np.s_[: box.linear]
    size = np.linalg.norm(rows[:, first], axis=0)
    size = np.where(size > 0, size, 1.0)
    lower, upper = ((edge[first] - values[first]) * size for edge in (box.lower, box.upper))
    room = 1e-9 * np.linalg.norm(rows[:, -1])  # SciPy takes no range without room
    found = lsq_linear(rows[:, first] / size, -rows[:, -1], (lower - room, upper + room))
    values = values.copy()
    values[first] += np.clip(found.x, lower, upper) / size
    return float(2 * found.cost), values


def _descend(
    passes: _Passes, values: Float[np.ndarray, " n"], max_steps: int, tolerance: float
) -> Descent:
    """SciPy's descent from a place in the box."""
    passes.history = []
    box = passes.box
    values = np.clip(values, box.lower, box.upper)  # rounding may have led out
    if not np.isfinite(passes.rows(values)).all():
        return Descent(box.placed(passes.base, values), False, 0, ())
    # Where no number moves the light SciPy's steps are 0 / 0; where one moves it beyond all
    # measure its powers overflow. Neither place is left for a better one, nor taken for one.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        found = least_squares(
            passes.residuals,
            values,
            passes.slopes,
            (box.lower, box.upper),
            x_scale="jac",
            ftol=tolerance,
            xtol=tolerance,
            gtol=None,
            max_nfev=max_steps,
        )
    if not np.isfinite(found.x).all():
        return Descent(box.placed(passes.base, values), False, 0, ())
    mask = found.active_mask
    values = np.select([mask < 0, mask > 0], [box.lower, box.upper], found.x)
    return Descent(
        entries=box.placed(passes.base, values),
        finite=True,
        steps=len(passes.history) - 1,
        history=tuple(passes.history),
        at_bound=tuple(box.at_bound(values)),
        settled=found.status > 0,
    )
