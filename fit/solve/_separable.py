"""Where the model is linear but for a number or two: the least square sum there is.

With gamma 1 the light of a look that says so (`model_jax.Separable`) is a sum of products:
amplitude · factors · (first + weight · second) + levels. Given the weight, the best amplitudes and
levels are a linear least squares problem (variable projection: Golub and Pereyra, SIAM J. Numer.
Anal. 10, 413, 1973). `least_square_sum` scans the weight until the least square sum is known: an
answer that owes nothing to a start or a solver. Where each channel has a weight of its own,
amplitude · weight is free and nothing is left to scan.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from model_jax import Separable

from ._layout import Layout
from ._parameters import Entries, FitParameter, free_directions
from ._samples import Samples
from ._scaled import least_squares


class Places:
    """Where the parts of a separable look stand in the vector."""

    def __init__(self, layout: Layout, fact: Separable) -> None:
        self.layout, self.fact = layout, fact
        self.amplitude = layout.slices[fact.amplitude].start
        self.factors = layout.slices[fact.factors]
        self.weight = layout.slices[fact.weight]
        self.background = layout.slices["background"]
        self.black = slice(layout.size + 2, None, len(layout.response))
        self.exposure = slice(layout.size, None, len(layout.response))

    def response(self, photo: int) -> int:
        """First entry of a photo's response: exposure, gamma, black level."""
        return self.layout.size + len(self.layout.response) * photo


def places_of(layout: Layout) -> Places | None:
    """None of a look that is not separable."""
    return None if layout.kind.SEPARABLE is None else Places(layout, layout.kind.SEPARABLE)


def is_separable(layout: Layout) -> bool:
    """Whether it is: where not, starts and descents are `_approach`'s."""
    return layout.kind.SEPARABLE is not None


_GRID = 64
_ZOOMS = 6
_ZOOM_GRID = 17
"""Weights tried over the whole range, then about the best: to 1e-7 of its scale."""


@dataclass(frozen=True)
class Least:
    """Where the square sum is least."""

    vector: Entries
    square_sum: float


def least_square_sum(
    reduced: Samples,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    layout: Layout,
) -> Least | None:
    """The least square sum over all values of what is free, bounds of weights only.

    Args:
        reduced: `moments` of the pixels.
        vector: what is not free stays as it is.

    Returns:
        None where the model is no such sum: the look is not separable, exposures or gammas are
        free, the amplitude is with some of the factors, two of the channels share one of several
        weights, or a photo is grey.
    """
    at = places_of(layout)
    if at is None or reduced.mix is not None:
        return None
    directions, moved = free_directions(free, parameters)
    families = np.array([members[0].family for members in moved])
    factors = directions[at.factors][:, families == at.fact.factors]
    amplitudes = _amplitudes(vector, factors, at.fact.amplitude in families, at)
    weights = directions[at.weight][:, families == at.fact.weight]
    if amplitudes is None or np.isin(families, ("exposure", "gamma")).any():
        return None
    if weights.shape[1] > 1 and (weights.sum(axis=0) > 1).any():
        return None
    levels = directions[:, np.isin(families, ("background", "black_level"))]
    problem = _Sums(reduced, vector, *amplitudes, weights, levels, at)
    if weights.shape[1] == 1:
        (weight,) = (p for p in free if p.family == at.fact.weight)
        best = _scan(problem, weight)
    else:
        best = np.zeros(1)
    square_sums, found = problem.solve(best)
    return Least(problem.entries(found[0], float(best[0])), float(square_sums[0]))


def _amplitudes(
    vector: Entries, free: Float[np.ndarray, "3 t"], has_amplitude: bool, at: Places
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 a"]] | None:
    """Amplitude · factors as a fixed part and columns; None where both are free in part."""
    amplitude, factors = vector[at.amplitude], vector[at.factors]
    if not has_amplitude:
        beside = factors - free @ (free.T @ factors)
        return amplitude * beside, amplitude * free
    if not free.shape[1]:
        return np.zeros(3), factors[:, None]
    return (np.zeros(3), np.eye(3)) if free.shape[1] == 2 else None


class _Sums:
    """Rows of the linear problem, all photos' and channels' below each other."""

    def __init__(
        self,
        reduced: Samples,
        vector: Entries,
        fixed: Float[np.ndarray, "3"],
        columns: Float[np.ndarray, "3 a"],
        moving: Float[np.ndarray, "3 s"],
        levels: Float[np.ndarray, "e l"],
        at: Places,
    ) -> None:
        exposure = vector[at.exposure][:, None, None]
        light = np.asarray(reduced.light, np.float64)
        one = np.broadcast_to(np.asarray(reduced.one)[:, None], light.shape)
        color = exposure * np.asarray(reduced.color)[:, :, None]
        first = color * np.asarray(reduced.fields[at.fact.first])[:, None]
        second = np.zeros_like(first)
        if at.fact.second in reduced.fields:
            second = color * np.asarray(reduced.fields[at.fact.second])[:, None]
        self.vector, self.fixed, self.columns, self.at = vector, fixed, columns, at
        self.moving, self.levels = moving, levels
        self.own = moving.shape[1] > 1
        """Channels have weights of their own: their amplitudes of the second field are free."""
        self.weights = np.where(moving.any(axis=1), 0.0, vector[at.weight])
        self.first, self.second = first, second
        held = np.where(levels.any(axis=1), 0.0, vector)
        level = exposure * held[at.background][:, None] + held[at.black][:, None, None]
        target = light - one * level
        if reduced.surface is not None:
            target = target - exposure * np.asarray(reduced.surface)
        self.target = target
        rise = levels[at.background].T[:, None, :, None] * exposure
        rise = (rise + levels[at.black].T[:, :, None, None]) * one
        own = [np.where(s[None, :, None], second, 0) for s in moving.T] if self.own else []
        self.steady = np.array([*rise, *own]).reshape(-1, target.size).T

    @property
    def scale(self) -> float:
        """Weight at which both fields are as bright."""
        return float(np.linalg.norm(self.first) / (np.linalg.norm(self.second) or 1.0)) or 1.0

    def solve(
        self, weight: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n c"]]:
        """Least square sums of n weights, and the amplitudes and levels that give them."""
        weights = self.weights + (0.0 if self.own else weight[:, None] * self.moving.sum(axis=1))
        weights = np.broadcast_to(weights, (len(weight), 3))
        width = self.first + weights[:, None, :, None] * self.second
        target = self.target - self.fixed[:, None] * width
        target = target.reshape(len(weight), -1)
        parts = width[..., None] * self.columns[:, None, :]
        moving = parts.reshape(len(weight), self.target.size, -1)
        steady = np.broadcast_to(self.steady, (len(weight), *self.steady.shape))
        matrix = np.concatenate([moving, steady], axis=2)
        found, left = least_squares(matrix, target)
        return (left**2).sum(axis=1), found

    def entries(self, found: Float[np.ndarray, " c"], weight: float) -> Entries:
        """The vector that a solution is."""
        vector, at = self.vector.copy(), self.at
        count = self.columns.shape[1]
        amount, levels, own = np.split(found, [count, count + self.levels.shape[1]])
        moved = self.levels.any(axis=1)
        vector[moved] = (self.levels @ levels)[moved]
        amplitudes = self.fixed + self.columns @ amount
        if count:
            # Factors keep their sum, free or not.
            vector[at.amplitude] = amplitudes.sum() / vector[at.factors].sum()
            vector[at.factors] = amplitudes / vector[at.amplitude]
        found_weight = self.moving @ own / amplitudes if self.own else weight
        vector[at.weight] = np.where(self.moving.any(axis=1), found_weight, vector[at.weight])
        return vector


def _scan(problem: _Sums, weight: FitParameter) -> Float[np.ndarray, "1"]:
    """The best weight within its bounds."""
    low, high = (float(np.arctan(b / problem.scale)) for b in (weight.lower, weight.upper))
    grid = np.linspace(low, high, _GRID)
    for _ in range(_ZOOMS):
        values = np.clip(problem.scale * np.tan(grid), weight.lower, weight.upper)
        square_sums, _ = problem.solve(values)
        best = int(np.argmin(square_sums))
        around = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        grid = np.linspace(*around, _ZOOM_GRID)
    return values[best : best + 1]
