"""airlight's own ways to fit, each setting by itself: what `fit` puts together, taken apart."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .._choices import SolverName
from .._compile import float64
from ..photo._columns import Columns
from ..solve._descend import TOLERANCE, descend, make_solver
from ..solve._parameters import Entries, chart, free_directions, is_outside
from ..solve._polish import gauss_newton
from ..solve._problem import Point, Problem
from ..solve._reduce import bins, moments
from ..solve._samples import Samples, on_device, to_samples
from ..solve._search import search
from ._problems import MAX_STEPS, Case, narrowed

Reduction = Literal["tiles", "moments", "bins"]


@dataclass(frozen=True)
class Setting:
    """How a descent is made."""

    solver: SolverName = "lm"
    dtype: Literal["float64", "float32"] = "float64"
    reduction: Reduction = "tiles"
    """"tiles": all pixels; "moments" and "bins": what stands for them (`solve._reduce`)."""
    every: int = 1
    """One of so many pixels is looked at."""
    exact: int = 0
    """Gauss–Newton steps over all pixels afterwards."""

    def __str__(self) -> str:
        words: list[str] = [self.solver, self.dtype, self.reduction]
        if self.every > 1:
            words.append(f"1/{self.every} of the pixels")
        return ", ".join(words)


class Ended(NamedTuple):
    """Where a run ended, and what it took."""

    vector: Entries
    evaluations: int
    bytes: int
    """Read."""


def run_setting(case: Case, setting: Setting, steps: int) -> Ended:
    """A descent of at most some steps from the case's start, from pixels in memory."""
    columns = case.columns
    if setting.every > 1:
        columns = columns.part(np.arange(len(columns.index)) % setting.every == 0)
    precision, few, read = _reduced(columns, setting)
    start = chart(case.start, case.free, case.parameters)
    solver = make_solver(setting.solver, _tolerance(setting.dtype))
    found = descend(start, few, case.model, solver, steps, precision)
    passes = found.steps + 1
    ended = Ended(found.entries, passes, read + passes * _bytes(few))
    return _polished(case, ended, setting.exact) if setting.exact else ended


def _tolerance(dtype: str) -> float:
    return TOLERANCE if dtype == "float64" else 1e-6


def _narrow() -> AbstractContextManager[None]:
    scope: AbstractContextManager[None] = jax.enable_x64(False)
    return scope


def _reduced(
    columns: Columns, setting: Setting
) -> tuple[Callable[[], AbstractContextManager[None]], Samples, int]:
    """JAX's settings, what the descent sees, and bytes that making it reads."""
    if setting.dtype == "float32":
        return _narrow, on_device(to_samples([narrowed(columns)])), 0
    with float64():
        if setting.reduction == "bins":
            return float64, on_device(bins([columns])), _bytes_of(columns)
        samples = on_device(to_samples([columns]))
        if setting.reduction == "moments":
            return float64, on_device(moments(samples)), _bytes(samples)
        return float64, samples, 0


def _polished(case: Case, ended: Ended, exact: int) -> Ended:
    """Plain Gauss–Newton steps over all pixels, as many as asked for."""
    directions, _ = free_directions(case.free, case.parameters)
    with float64():
        problem = case.problem()
        point = Point(problem, ended.vector, directions)
        for _ in range(exact):
            moved = point.moved(-gauss_newton(point.gram()))
            if not np.isfinite(moved.vector).all() or is_outside(moved.vector, case.free):
                break
            point = moved
    read = exact * _bytes_of(case.columns)
    return Ended(point.vector, ended.evaluations + exact, ended.bytes + read)


@dataclass(frozen=True)
class _Counting(Problem):
    """Counts its exact passes."""

    passes: list[int] = field(default_factory=list)

    def gram(
        self, vector: Entries, directions: Float[np.ndarray, "e p"]
    ) -> Float[np.ndarray, "q q"]:
        self.passes.append(_bytes(self.samples))
        return super().gram(vector, directions)


def run_search(case: Case) -> Ended:
    """What `fit` does between choosing pixels and judging: starts, descents, exact steps, checks.

    Of its evaluations those of single vectors are counted, over all pixels or pseudo-pixels.
    """
    with float64():
        plain = case.problem()
        problem = _Counting(plain.columns, plain.samples, plain.parameters, plain.model)
        end = search(problem, case.start, case.free, "lm", MAX_STEPS)
    passes = problem.passes
    return Ended(end.vector, len(passes) + end.steps, sum(passes))


def scaled(case: Case, every: int) -> Case:
    """The case of one in so many of its pixels."""
    return replace(case, columns=case.columns.part(np.arange(case.pixels) % every == 0))


def _bytes(samples: Samples) -> int:
    """Of the tiles in use."""
    share = float(samples.used) / max(len(samples.count), 1)
    parts = [*samples.fields.values(), samples.light]
    return int(share * sum(part.nbytes for part in parts))


def _bytes_of(columns: Columns) -> int:
    return sum(part.nbytes for part in (*columns.fields.values(), columns.light))
