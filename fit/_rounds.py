"""The search, again and again while the noise it weighs samples by is not yet known."""

from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

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
    has_priors = any(p.prior is not None for p in asked)
    if task.loss == "linear" and not has_priors and problem.samples.clipped is None:
        return problem, search(problem, start, asked, task.solver, task.max_steps, seeds=seeds)
    believing = replace(problem.samples, clipped=None)
    rough = replace(problem, samples=believing).rough()
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
        prior = _prior(asked, noise, len(start))
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


def _prior(asked: Sequence[FitParameter], noise: float, size: int) -> PriorTerm | None:
    mean, weight = np.zeros(size), np.zeros(size)
    for p in asked:
        if p.prior is not None:
            mean[p.entries[0]], weight[p.entries[0]] = p.prior.mean, (noise / p.prior.sigma) ** 2
    with float64():
        return PriorTerm(jnp.asarray(mean), jnp.asarray(weight)) if weight.any() else None
