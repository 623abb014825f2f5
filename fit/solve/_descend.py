"""The descent: from samples to the best vector, with optimistix.

What the solver sees is of order one whatever the photo's exposure and the scene's lengths: it moves
from a start along directions in which one unit changes the picture by as much as the picture is,
each independent of the others at the start (whitened), in coordinates that know no bounds
(`Chart`). It runs in float64 by a scoped switch that leaves the caller's JAX configuration alone.
Its own word on success is not taken: `_search` checks the end point.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from model_jax._shapes import AnyArray

from .._choices import SolverName, check_solver
from .._compile import float64, program
from ._bijections import to_shares, to_value
from ._gram import compressed, gram
from ._model import Model
from ._parameters import Chart, Entries, FitParameter
from ._samples import Samples, tile_at
from ._scaled import unit_diagonal

Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser

_SOLVERS: dict[SolverName, Any] = {
    "lm": optx.LevenbergMarquardt,
    "dogleg": optx.Dogleg,
    "bfgs": optx.BFGS,
}

TOLERANCE = 1e-12
"""Where a descent ends, absolute and relative, on numbers of order one: float64 has 2e-16, and 1e-8
in the parameters is promised."""

_ROOM = 256
"""Least number of square sums that are kept of a descent."""

FINISH = 1e-15
"""Where the exact Gauss–Newton steps at the end do: on, until they do nothing."""


@dataclass(frozen=True)
class Descent:
    """Where a descent ended."""

    entries: Entries
    finite: bool
    steps: int
    history: tuple[float, ...]
    """Square sum at each accepted step, start first."""
    at_bound: tuple[FitParameter, ...] = ()
    """What it holds at a bound."""
    settled: bool = False
    """It is known to have ended of itself."""


class Atlas(eqx.Module):
    """`Chart` and the whitened steps on it: what takes a solver's numbers to entries."""

    base: Float[AnyArray, " e"]
    matrix: Float[AnyArray, "e q"]
    lower: Float[AnyArray, " q"]
    upper: Float[AnyArray, " q"]
    scale: Float[AnyArray, " q"]
    basis: Float[AnyArray, "n m"]
    total: Float[AnyArray, ""]
    start: Float[AnyArray, " p"]
    whiten: Float[AnyArray, "p p"]
    shares: int = eqx.field(static=True)

    def entries(self, step: Float[AnyArray, " p"]) -> Float[jax.Array, " e"]:
        """The vector after a step."""
        u = self.start + self.whiten @ step
        plain = self.matrix.shape[1]
        values = to_value(u[:plain], self.lower, self.upper, self.scale)
        vector = jnp.asarray(self.base) + self.matrix @ values
        if not self.basis.shape[1]:
            return vector
        factors = to_shares(u[plain:], jnp.asarray(self.basis), self.total)
        return vector.at[self.shares : self.shares + len(factors)].add(factors)


@eqx.filter_jit
def _frame(
    atlas: Atlas, step: Float[AnyArray, " p"]
) -> tuple[Float[jax.Array, " e"], Float[jax.Array, "e p"]]:
    """The vector after a step, and its slopes; compiled: a solver's program traces it once."""

    def twice(step: Float[jax.Array, " p"]) -> tuple[jax.Array, jax.Array]:
        entries = atlas.entries(step)
        return entries, entries

    directions, entries = jax.jacfwd(twice, has_aux=True)(jnp.asarray(step))
    return entries, directions


class Pass(eqx.Module):
    """One exact pass as a function of the solver's numbers; square sums in units of `size`²."""

    atlas: Atlas
    samples: Samples
    model: Model
    size: Float[AnyArray, ""]

    def __call__(self, step: Float[jax.Array, " p"]) -> Float[jax.Array, "q q"]:
        entries, directions = _frame(self.atlas, step)
        found = _gram(entries, directions, self.samples, self.model) / self.size**2
        # Where light overflows no step is better; the factor of a NaN would pass for a cost of 0.
        return jnp.where(jnp.isfinite(found).all(), found, jnp.inf)


def make_solver(name: object, tolerance: float = TOLERANCE) -> Solver:
    """An optimistix solver by its name.

    Raises:
        InputError: a name that is not in the list.
    """
    solver: Solver = _SOLVERS[check_solver(name)](rtol=tolerance, atol=tolerance)
    return solver


def descend(
    chart: Chart,
    samples: Samples,
    model: Model,
    solver: Solver,
    max_steps: int,
    precision: Callable[[], AbstractContextManager[None]] = float64,
) -> Descent:
    """The best vector that a solver finds from the chart's start; never worse than the start.

    precision: JAX's settings meanwhile; the samples are of that precision.
    """
    p = len(chart.start)
    room = max(_ROOM, 1 << (max_steps - 1).bit_length())
    with precision():
        atlas = Atlas(
            base=jnp.asarray(chart.base),
            matrix=jnp.asarray(chart.matrix),
            lower=jnp.asarray(chart.lower),
            upper=jnp.asarray(chart.upper),
            scale=jnp.asarray(chart.scale),
            basis=jnp.asarray(chart.basis),
            total=jnp.asarray(chart.total),
            start=jnp.asarray(chart.start),
            whiten=jnp.asarray(np.eye(p)),
            shares=chart.shares,
        )
        most = jnp.asarray(max_steps)
        found = jax.device_get(_run(solver, atlas, samples, model, room, most))
    start, end, first, history, count = found
    costs = [float(first), *(float(c) for c in history if np.isfinite(c))]
    finite = bool(np.isfinite(end).all() and np.isfinite(costs[-1]))
    better = finite and not costs[-1] > costs[0]  # NaN compares false
    return Descent(np.asarray(end if better else start), finite, int(count), tuple(costs))


_gram = eqx.filter_jit(gram)
"""For the solver's program, which traces it once."""

exact_gram = program(gram)


@program
def square_sums(
    vectors: Float[AnyArray, "k e"], samples: Samples, model: Model
) -> Float[jax.Array, " k"]:
    """Costs of several vectors in one pass."""
    nothing = jnp.zeros((vectors.shape[1], 0))
    return jax.vmap(lambda vector: gram(vector, nothing, samples, model)[-1, -1])(vectors)


@program
def _run(
    solver: Solver, atlas: Atlas, samples: Samples, model: Model, room: int, most: jax.Array
) -> tuple[jax.Array, ...]:
    """Entries at the start and at the end, square sums at the start and of the steps, their number.

    All in one program: each costs a good part of a second to compile.
    """
    begin, directions = _frame(atlas, jnp.zeros_like(atlas.start))
    first = _gram(begin, directions, samples, model)
    size = jnp.sqrt(_light(samples))
    size = jnp.where(size > 0, size, 1.0)
    whitened = eqx.tree_at(lambda a: a.whiten, atlas, _whitening(first[:-1, :-1]) * size)
    step, history, count = run(solver, Pass(whitened, samples, model, size), room, most)
    end, _ = _frame(whitened, step)
    return begin, end, first[-1, -1], history * size**2, count


def _light(samples: Samples) -> Float[jax.Array, ""]:
    """Square sum of the light."""

    def add(index: jax.Array, total: jax.Array) -> jax.Array:
        tile = tile_at(samples, index)
        return total + (tile.light**2 * tile.weight[None]).sum()

    return jax.lax.fori_loop(0, samples.used, add, jnp.zeros((), samples.like.dtype))


def _whitening(curved: Float[jax.Array, "p p"]) -> Float[jax.Array, "p p"]:
    """W with Wᵀ G W = 1, where G tells; steps along what it does not tell stay of order one."""
    scaled, size = unit_diagonal(curved)
    scaled = jnp.where(jnp.isfinite(scaled), scaled, 0.0)
    values, vectors = jnp.linalg.eigh(scaled)
    floor = 1e-12 * jnp.maximum(values[-1], 1e-300)
    return vectors / jnp.sqrt(jnp.maximum(values, floor))[None] / size[:, None]


def run(
    solver: Solver, pass_: Pass, room: int, most: jax.Array | None = None
) -> tuple[Float[jax.Array, " p"], Float[jax.Array, " steps"], jax.Array]:
    """The solver on a pass: the step it ends with, square sums after each step, their number.

    Args:
        room: for how many square sums a program is compiled.
        most: steps, if not as many.
    """

    def residual(step: jax.Array, pass_: Any) -> Any:
        value = compressed(step, pass_)
        return value, (value * value).sum()

    recorded = _recorded(solver, room, jnp.asarray(room) if most is None else most)
    start = jnp.zeros_like(pass_.atlas.start)
    solution: optx.Solution = optx.least_squares(
        residual, recorded, start, pass_, max_steps=room, throw=False, has_aux=True
    )
    return solution.value, solution.stats["history"], solution.stats["num_steps"]


def _recorded(solver: Solver, room: int, most: jax.Array) -> Solver:
    is_minimiser = isinstance(solver, optx.AbstractMinimiser)
    kind: Any = _RecordedMinimiser if is_minimiser else _RecordedLeastSquares
    made: Solver = kind(solver.rtol, solver.atol, solver.norm, solver, most, room)
    return made


class _Recording(eqx.Module):
    """An optimistix solver that also returns the square sum at each of its steps, in `stats`, and
    ends after a number of them that it need not be compiled for."""

    rtol: float
    atol: float
    norm: Any
    inner: Any
    most: jax.Array
    room: int = eqx.field(static=True)

    def init(self, *arguments: Any) -> Any:
        return self.inner.init(*arguments), jnp.full(self.room, jnp.nan), jnp.array(0)

    def step(
        self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any
    ) -> tuple[Any, Any, Any]:
        inner, history, count = state
        y, inner, aux = self.inner.step(fn, y, args, options, inner, tags)
        return y, (inner, history.at[count].set(aux), count + 1), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        done, result = self.inner.terminate(fn, y, args, options, state[0], tags)
        return done | (state[2] >= self.most), result

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, tags: Any, result: Any
    ) -> tuple[Any, Any, dict[str, Any]]:
        y, aux, stats = self.inner.postprocess(fn, y, aux, args, options, state[0], tags, result)
        return y, aux, stats | {"history": state[1]}


class _RecordedLeastSquares(_Recording, optx.AbstractLeastSquaresSolver):
    pass


class _RecordedMinimiser(_Recording, optx.AbstractMinimiser):
    pass
