"""The least square sum there is, where the model leaves no more than one number to search over.

With gamma 1 a photo's light is a sum of products: amplitude · (lit + shadow · dark) + levels. Of a
given shadow weight the best amplitudes and levels are a linear least squares problem; so are they
where each channel has a shadow weight of its own, for then amplitude · shadow is free. What is left
is a scan over one shadow weight, and its least value is that of the whole problem: an answer that
owes nothing to a start or a solver (variable projection: Golub and Pereyra, SIAM J. Numer. Anal.
10, 413, 1973).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from ._parameters import (
    BACKGROUND,
    BRIGHTNESS,
    LOOK_ENTRIES,
    RESPONSE_ENTRIES,
    SHADOW,
    TINT,
    Entries,
    Parameter,
    directions,
)
from ._samples import Samples

_BLACK = slice(LOOK_ENTRIES + 2, None, RESPONSE_ENTRIES)

_GRID = 64
_ZOOMS = 6
_ZOOM_GRID = 17
"""Shadow weights tried over the whole range, then about the best: to 1e-7 of its scale."""


@dataclass(frozen=True)
class Least:
    """Where the square sum is least."""

    vector: Entries
    square_sum: float


def least_square_sum(
    few: Samples, vector: Entries, free: Sequence[Parameter], parameters: Sequence[Parameter]
) -> Least | None:
    """The least square sum over all values of what is free, bounds of shadow weights only.

    Args:
        few: `moments` of the pixels.
        vector: what is not free stays as it is.

    Returns:
        None where the model is no such sum: exposures or gammas are free, brightness is with some
        of the tints, two of the channels share one of several shadow weights, or a photo is grey.
    """
    if few.mix is not None:
        return None
    along, moved = directions(free, parameters)
    families = np.array([members[0].family for members in moved])
    amplitudes = _amplitudes(vector, along[TINT][:, families == "tint"], families)
    shadows = along[SHADOW][:, families == "shadow"]
    if amplitudes is None or np.isin(families, ("exposure", "gamma")).any():
        return None
    if shadows.shape[1] > 1 and (shadows.sum(axis=0) > 1).any():
        return None
    levels = along[:, np.isin(families, ("background", "black_level"))]
    problem = _Sums(few, vector, *amplitudes, shadows, levels)
    if shadows.shape[1] == 1:
        (weight,) = (p for p in free if p.family == "shadow")
        best = _scan(problem, weight)
    else:
        best = np.zeros(1)
    square_sums, found = problem.solve(best)
    return Least(problem.entries(found[0], float(best[0])), float(square_sums[0]))


def _amplitudes(
    vector: Entries, tints: Float[np.ndarray, "3 t"], families: np.ndarray
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 a"]] | None:
    """Brightness · tint of the channels as a fixed part and columns; None where it is a product."""
    brightness, tint = vector[BRIGHTNESS], vector[TINT]
    if "brightness" not in families:
        beside = tint - tints @ (tints.T @ tint)
        return brightness * beside, brightness * tints
    if not tints.shape[1]:
        return np.zeros(3), tint[:, None]
    return (np.zeros(3), np.eye(3)) if tints.shape[1] == 2 else None


class _Sums:
    """Rows of the linear problem, all photos' and channels' below each other."""

    def __init__(
        self,
        few: Samples,
        vector: Entries,
        fixed: Float[np.ndarray, "3"],
        columns: Float[np.ndarray, "3 a"],
        shadows: Float[np.ndarray, "3 s"],
        levels: Float[np.ndarray, "e l"],
    ) -> None:
        exposure = vector[LOOK_ENTRIES::RESPONSE_ENTRIES][:, None, None]
        light = np.asarray(few.light, np.float64)
        one = np.broadcast_to(np.asarray(few.one)[:, None], light.shape)
        color = exposure * np.asarray(few.color)[:, :, None]
        lit = color * np.asarray(few.lit)[:, None]
        dark = np.zeros_like(lit) if few.dark is None else color * np.asarray(few.dark)[:, None]
        self.vector, self.fixed, self.columns = vector, fixed, columns
        self.shadows, self.levels = shadows, levels
        self.own = shadows.shape[1] > 1
        """Channels have shadow weights of their own: their dark amplitudes are free."""
        self.weights = np.where(shadows.any(axis=1), 0.0, vector[SHADOW])
        self.lit, self.dark = lit, dark
        held = np.where(levels.any(axis=1), 0.0, vector)
        level = exposure * held[BACKGROUND][:, None] + held[_BLACK][:, None, None]
        target = light - one * level
        if few.surface is not None:
            target = target - exposure * np.asarray(few.surface)
        self.target = target
        rise = levels[BACKGROUND].T[:, None, :, None] * exposure
        rise = (rise + levels[_BLACK].T[:, :, None, None]) * one
        own = [np.where(s[None, :, None], dark, 0) for s in shadows.T] if self.own else []
        self.steady = np.array([*rise, *own]).reshape(-1, target.size).T

    @property
    def scale(self) -> float:
        """Shadow weight at which the shadowed air is as bright as the lit."""
        return float(np.linalg.norm(self.lit) / (np.linalg.norm(self.dark) or 1.0)) or 1.0

    def solve(
        self, shadow: Float[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n c"]]:
        """Least square sums of n shadow weights, and the amplitudes and levels that give them."""
        weights = self.weights + (0.0 if self.own else shadow[:, None] * self.shadows.sum(axis=1))
        weights = np.broadcast_to(weights, (len(shadow), 3))
        width = self.lit + weights[:, None, :, None] * self.dark
        target = self.target - self.fixed[:, None] * width
        target = target.reshape(len(shadow), -1, 1)
        parts = width[..., None] * self.columns[:, None, :]
        moving = parts.reshape(len(shadow), self.target.size, -1)
        steady = np.broadcast_to(self.steady, (len(shadow), *self.steady.shape))
        matrix = np.concatenate([moving, steady], axis=2)
        size = np.linalg.norm(matrix, axis=1, keepdims=True)
        size = np.where(size > 0, size, 1.0)
        found = np.linalg.pinv(matrix / size, rcond=1e-12) @ target
        left = target - matrix / size @ found
        return (left[..., 0] ** 2).sum(axis=1), found[..., 0] / size[:, 0]

    def entries(self, found: Float[np.ndarray, " c"], shadow: float) -> Entries:
        """The vector that a solution is."""
        vector = self.vector.copy()
        first = self.columns.shape[1]
        amount, levels, own = np.split(found, [first, first + self.levels.shape[1]])
        moved = self.levels.any(axis=1)
        vector[moved] = (self.levels @ levels)[moved]
        amplitudes = self.fixed + self.columns @ amount
        if first:
            # Tints keep their sum, free or not.
            vector[BRIGHTNESS] = amplitudes.sum() / vector[TINT].sum()
            vector[TINT] = amplitudes / vector[BRIGHTNESS]
        dark = self.shadows @ own / amplitudes if self.own else shadow
        vector[SHADOW] = np.where(self.shadows.any(axis=1), dark, vector[SHADOW])
        return vector


def _scan(problem: _Sums, weight: Parameter) -> Float[np.ndarray, "1"]:
    """The best shadow weight within its bounds."""
    low, high = (float(np.arctan(b / problem.scale)) for b in (weight.lower, weight.upper))
    grid = np.linspace(low, high, _GRID)
    for _ in range(_ZOOMS):
        values = np.clip(problem.scale * np.tan(grid), weight.lower, weight.upper)
        square_sums, _ = problem.solve(values)
        best = int(np.argmin(square_sums))
        around = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        grid = np.linspace(*around, _ZOOM_GRID)
    return values[best : best + 1]
