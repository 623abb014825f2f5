"""The search, again and again while the noise it weighs samples by is not yet known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ._choices import LossName
from ._compile import float64
from .diagnose._residuals import residuals_of, square_sum_of
from .photo._columns import Columns
from .solve._loss import Loss
from .solve._model import Model, PriorTerm
from .solve._parameters import Entries, FitParameter, to_entries
from .solve._problem import Problem
from .solve._samples import on_device, share_fields, to_samples
from .solve._search import End, search
from .solve._task import Task

ROUNDING = 1e-9
"""Noise there is at least, of the brightest sample."""
_ROUNDS = 6
"""Most rounds of search and noise."""
_FIRST_NOISE = 0.01
"""Noise of the first round, of the brightest sample, which a table's smoothness is weighed by."""
_SAME_NOISE = 0.01
"""Relative change of the noise estimate below which no further round is made."""


def make_problem(task: Task, columns: tuple[Columns, ...]) -> Problem:
    """Samples on the device, with plain least squares as the model."""
    free = [p for p in task.parameters if p.role != "fixed"]
    gammas = [p for p in task.parameters if p.family == "gamma"]
    linear = not any(p in free for p in gammas) and all(p.value == 1 for p in gammas)
    square = 1 / 12 if task.sampling == "area" else 0.0
    samples = to_samples(columns)
    columns = share_fields(columns, samples)
    model = Model(Loss("linear"), None, task.layout, linear, square)
    return Problem(columns, on_device(samples), task.parameters, model)


def search_in_rounds(
    task: Task,
    problem: Problem,
    asked: tuple[FitParameter, ...],
    seeds: list[Entries] | None = None,
) -> tuple[Problem, End]:
    """The search; for all but plain least squares again and again, with the noise found before.

    Args:
        seeds: where to start from, instead of looking for it.
    """
    start = to_entries(task.parameters)
    known = _known(task, asked)
    if task.loss == "linear" and not len(known.mean) and problem.samples.clipped is None:
        return problem, search(problem, start, asked, task.solver, task.max_steps, seeds=seeds)
    believing = replace(problem.samples, clipped=None)
    begun = problem.model
    if known.smooth.any():  # a table with nothing known of it would run to its bounds first
        guessed = known.where(known.smooth).priced(_FIRST_NOISE * problem.light_max)
        begun = replace(begun, prior=guessed)
    rough = replace(problem, samples=believing, model=begun).rough()
    end = search(rough, start, asked, task.solver, task.max_steps, seeds=seeds, last=False)
    noise = 0.0
    # Cauchy has valleys of its own; Huber, which has none, shows it the right one.
    losses: list[LossName] = ["huber"] if task.loss == "cauchy" else []
    for number in range(_ROUNDS):
        if not end.finite:
            return problem, end
        found = noise_of(task, problem, end, residuals_of(problem, end.vector))
        if number > 1 and abs(found - noise) <= _SAME_NOISE * noise:
            break
        noise = found
        with float64():
            priced = Loss(losses.pop() if losses else task.loss, jnp.asarray(noise))
        prior = known.priced(noise) if len(known.mean) else None
        problem = replace(problem, model=replace(problem.model, loss=priced, prior=prior))
        end = search(
            problem.rough(),
            start,
            asked,
            task.solver,
            task.max_steps,
            seeds=[end.vector],
            last=False,
        )
    return problem, search(problem, start, asked, task.solver, task.max_steps, seeds=[end.vector])


def noise_of(
    task: Task, problem: Problem, end: End, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> float:
    """Standard deviation of a measured sample; for robust losses by the median.

    1.4826 median |r| is the standard deviation of normal residuals (Hampel, J. Am. Stat. Assoc. 69,
    1974). Never quite zero: a prior and a bound need something to be measured in.
    """
    least = ROUNDING * problem.light_max
    if task.loss == "linear":
        counted = [square_sum_of(r[:, k]) for r in residuals for k in range(3)]
        known, square_sum = np.sum(counted, axis=0)
        return max(float(np.sqrt(square_sum / max(known - len(end.free), 1))), least)
    known = np.concatenate([r[np.isfinite(r)] for r in residuals])
    if not known.size:
        return least
    return max(1.4826 * float(np.median(np.abs(known))), least)


@dataclass(frozen=True)
class _Known:
    """What was known before: rows · entries is normal."""

    rows: Float[np.ndarray, "r e"]
    mean: Float[np.ndarray, " r"]
    sigma: Float[np.ndarray, " r"]
    smooth: Bool[np.ndarray, " r"]
    """It is a table's that differs little from place to place, which nobody had to say."""

    def where(self, chosen: Bool[np.ndarray, " r"]) -> "_Known":
        parts = (self.rows, self.mean, self.sigma, self.smooth)
        return _Known(*(part[chosen] for part in parts))

    def priced(self, noise: float) -> PriorTerm:
        """As a part of the square sum of samples with a noise."""
        with float64():
            weight = (noise / self.sigma) ** 2
            return PriorTerm(*(jnp.asarray(part) for part in (self.rows, self.mean, weight)))


def _known(task: Task, asked: Sequence[FitParameter]) -> _Known:
    size = len(to_entries(task.parameters))
    found = [({p.entries[0]: 1.0}, p.prior.mean, p.prior.sigma, False) for p in asked if p.prior]
    free = {entry for p in asked for entry in p.entries}
    own = {p.family for p in asked if p.prior}
    for family, about in task.layout.kind.PARAMETERS.items():
        if about.smooth is None or family in own:
            continue
        part = task.layout.slices[family]
        for one, other in about.smooth.neighbours:
            # One past the end is the number 1.
            ends = [part.start + k for k in (one, other) if k < about.size]
            if not free.isdisjoint(ends):
                signs = dict(zip(ends, (1.0, -1.0), strict=False))
                found.append((signs, float(len(ends) == 1), about.smooth.sigma, True))
    rows = np.zeros((len(found), size))
    for row, (signs, *_) in zip(rows, found, strict=True):
        for entry, sign in signs.items():
            row[entry] = sign
    mean, sigma, smooth = (np.array([part[k] for part in found]) for k in (1, 2, 3))
    return _Known(rows, mean.astype(float), sigma.astype(float), smooth.astype(bool))
