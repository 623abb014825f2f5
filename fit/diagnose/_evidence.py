"""Samples and end point of a fit, for what a result computes on demand."""

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray

from .._compile import float64, program
from .._result import OnDemand
from ..solve._loss import Loss, weigh
from ..solve._parameters import FitParameter
from ..solve._problem import Point, Problem
from ..solve._search import End
from ..solve._task import Task
from ._influence import influence_maps
from ._residuals import predictions_of, residuals_of, square_sum_of
from ._spread import Spread

BELIEVED = 0.25
"""Weight from which a sample of a robust fit counts as light to be explained: with Cauchy's loss
that of four standard deviations of the noise."""


@dataclass(frozen=True)
class Evidence(OnDemand):
    """Samples and end point, for what a result computes on demand."""

    task: Task
    end: End
    point: Point
    """The end point, along `end.free`."""
    identified: tuple[FitParameter, ...]
    spread: Spread
    noise: float
    """Standard deviation of a sample."""

    @property
    def problem(self) -> Problem:
        return self.point.problem

    @cached_property
    def rows(self) -> Float[np.ndarray, "t p"]:
        """Rows of the identified parameters along the free directions."""
        rows = [p.of(self.point.directions) for p in self.identified]
        return np.array(rows).reshape(len(self.identified), self.point.directions.shape[1])

    def influence(self, name: str) -> list[Float[np.ndarray, "_ _ 3"]]:
        row = self.rows[[p.name for p in self.identified].index(name)]
        return influence_maps(self.point, self.task.sizes, row, self.spread.hessian)

    def weights(self) -> list[Float[np.ndarray, "_ _"]]:
        found = []
        sizes = self.task.sizes
        residuals = residuals_of(self.problem, self.point.vector)
        for c, size, residual in zip(self.problem.columns, sizes, residuals, strict=True):
            weights = np.full(size, np.nan, np.float32)
            believed = belief_in(residual, self.problem.model.loss)
            weights.reshape(-1)[c.index] = believed.min(axis=-1)
            found.append(weights)
        return found

    def predictions(self) -> list[Float[np.ndarray, "_ _ 3"]]:
        """What each photo would have recorded in its used pixels, NaN in the others."""
        found = []
        light = predictions_of(self.problem, self.point.vector)
        for c, size, seen in zip(self.problem.columns, self.task.sizes, light, strict=True):
            picture = np.full((*size, 3), np.nan, np.float32)
            picture.reshape(-1, 3)[c.index] = seen
            found.append(picture)
        return found


CHUNK = 65536
"""Samples at once: a megabyte and a half for each array on the way."""


def belief_in(residual: Float[np.ndarray, "n 3"], loss: Loss) -> Float[np.ndarray, "n 3"]:
    """Weight that a loss gives to samples, 0 to 1; 1 for clipped ones."""
    if loss.name == "linear":
        return np.broadcast_to(1.0, residual.shape)
    found = np.empty_like(residual)
    piece = np.zeros((CHUNK, 3))  # of one size, so that JAX compiles once
    with float64():
        for start in range(0, len(residual), CHUNK):
            part = np.nan_to_num(residual[start : start + CHUNK])
            piece[: len(part)] = part
            found[start : start + CHUNK] = np.asarray(_belief(piece, loss))[: len(part)]
    return found


@program
def _belief(residual: Float[AnyArray, "n 3"], loss: Loss) -> Float[jax.Array, "n 3"]:
    return weigh(jnp.asarray(residual), None, loss)[2]


def explained_share(
    light: Float[np.ndarray, "n 3"], residual: Float[np.ndarray, "n 3"], loss: Loss
) -> float | None:
    """`PhotoResult.explained`.

    Args:
        residual: of all samples (`left_over_of`); NaN in those that do not count.
    """
    believed = belief_in(residual, loss) > BELIEVED
    left, total = 0.0, 0.0
    for k in range(3):
        known = believed[:, k] & np.isfinite(residual[:, k])
        here = light[known, k].astype(np.float64)
        total += square_sum_of(here - here.mean() if len(here) else here)[1]
        left += square_sum_of(residual[known, k])[1]
    return 1 - left / total if total > 0 else None
