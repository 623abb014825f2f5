"""Where the model is linear but for a number or two: starts, and the least square sum there is.

With gamma 1 a photo's light is a sum of products: amplitude · (lit + shadow · dark) + levels. Given
the shadow weight, the best amplitudes and levels are a linear least squares problem (variable
projection: Golub and Pereyra, SIAM J. Numer. Anal. 10, 413, 1973).

`start_vectors` solves it for a fan of shadow weights. With tint free and one weight for all
channels, what is left is a Rayleigh quotient of two by two matrices in the direction (lit, dark),
which has one valley: 9 directions over the quarter circle of weights ≥ 0 cannot miss it. For plain
least squares without gamma the best of the fan is within the fan's width of the global optimum,
which keeps a descent out of wrong valleys; a free gamma gets a fan of its own, by taking the light
to its power.

`least_square_sum` scans the shadow weight until the least square sum is known: an answer that owes
nothing to a start or a solver. Where each channel has a weight of its own, amplitude · shadow is
free and nothing is left to scan.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    FitParameter,
    followers,
    free_directions,
)
from ._reduce import moments
from ._samples import Samples
from ._scaled import least_squares

WEIGHTS = np.tan(np.linspace(0, np.pi / 2, 10)[:-1])
"""Shadow weights of the fan, in units in which lit and dark are equally large."""

GAMMAS = (0.45, 0.7, 1.0, 1.4, 2.2)
"""Gammas of the fan: from a picture taken as sRGB that was linear, to the reverse."""


@dataclass(frozen=True)
class _Photo:
    """Moments of one photo: pseudo-pixels by columns, gamma undone."""

    one: Float[np.ndarray, " m"]
    lit: Float[np.ndarray, " m"]
    dark: Float[np.ndarray, " m"]
    surface: Float[np.ndarray, "m 3"]
    light: Float[np.ndarray, "m 3"]
    color: Float[np.ndarray, "3"]


def start_vectors(
    samples: Samples,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
) -> list[Entries]:
    """Vectors worth starting from, the given one first."""
    gammas = [p for p in free if p.family == "gamma"]
    moved = {entry for p in gammas for q in followers(p, parameters) for entry in q.entries}
    found = [vector]
    for gamma in GAMMAS if gammas else (None,):
        base = vector.copy()
        if gamma is not None:
            base[sorted(moved)] = gamma
        found += _fan(_linear_photos(samples, base), base, free, parameters)
    return [v for v in found if np.isfinite(v).all()]


def _linear_photos(samples: Samples, vector: Entries) -> list[_Photo]:
    responses = vector[LOOK_ENTRIES:].reshape(-1, RESPONSE_ENTRIES)
    if (responses[:, 1] != 1).any():
        photo = np.asarray(samples.photo)
        level = responses[photo, 2][:, None, None]
        gamma = responses[photo, 1][:, None, None]
        used = int(samples.used)  # tiles; the rest is room
        light = np.asarray(samples.light)[:used] - level[:used]
        straight = np.zeros(samples.light.shape)
        straight[:used] = np.sign(light) * np.abs(light) ** gamma[:used] + level[:used]
        samples = replace(samples, light=straight)
    found = samples if samples.one is not None else moments(samples)  # which these may be
    zero = np.zeros_like(np.asarray(found.lit))
    dark = zero if found.dark is None else np.asarray(found.dark)
    none = np.zeros((*zero.shape, 3))
    surface = none if found.surface is None else np.asarray(found.surface).swapaxes(1, 2)
    light = np.asarray(found.light).swapaxes(1, 2)
    one, colors = np.asarray(found.one), np.asarray(found.color)
    if found.mix is not None:  # a copy shows what its original does
        own = [np.argmax(mix != 0, axis=0) for mix in np.asarray(found.mix)]
        light = np.stack([part[:, k] for part, k in zip(light, own, strict=True)])
        surface = np.stack([part[:, k] for part, k in zip(surface, own, strict=True)])
        seen = np.einsum("pij,pj->pi", np.asarray(found.mix), colors)
        colors = np.stack([color[k] for color, k in zip(seen, own, strict=True)])
    return [
        _Photo(one[k], np.asarray(found.lit)[k], dark[k], surface[k], light[k], color)
        for k, color in enumerate(colors)
    ]


def _fan(
    photos: Sequence[_Photo],
    base: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
) -> list[Entries]:
    """One vector for each shadow weight, or for the base's own where it is not free."""
    first = photos[0]
    weights = [base[SHADOW]]
    shadows = [
        e for p in free if p.family == "shadow" for q in followers(p, parameters) for e in q.entries
    ]
    if shadows:
        sizes = [
            np.sqrt(sum((getattr(p, name) ** 2).sum() for p in photos)) for name in ("lit", "dark")
        ]
        ratio = sizes[0] / sizes[1] if min(sizes) > 0 else 1.0
        weights += [np.full(3, ratio * w) for w in WEIGHTS]
    found = []
    for weight in weights:
        vector = base.copy()
        for entry in shadows:
            vector[entry] = weight[entry - SHADOW.start]
        vector = _look_for(first, vector, free, parameters)
        for number, photo in enumerate(photos):
            vector = _response_for(photo, number, vector, free, parameters)
        found.append(vector)
    return found


def _look_for(
    photo: _Photo, vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Entries:
    """Brightness, tint and background of the best picture of the first photo, shadow as given."""
    families = {p.family for p in free}
    exposure, _, level = vector[LOOK_ENTRIES : LOOK_ENTRIES + RESPONSE_ENTRIES]
    if exposure == 0:
        return vector
    light = (photo.light - level * photo.one[:, None]) / exposure - photo.surface
    width = photo.lit[:, None] + photo.dark[:, None] * vector[SHADOW]
    tints = [
        e - TINT.start
        for p in free
        if p.family == "tint"
        for q in followers(p, parameters)
        for e in q.entries
    ]
    levels: list[FitParameter | None] = [p for p in free if p.family == "background"]
    if not levels and "black_level" in families and _has_level(0, free):
        levels = [None]  # the response finds it again, with the look of now
    m = len(photo.one)
    columns: list[np.ndarray] = []
    fixed = np.zeros((m, 3))
    members = tints if "brightness" in families and len(tints) > 1 else []
    for k in range(3):
        if k in members:
            column = np.zeros((m, 3))
            column[:, k] = photo.color[k] * width[:, k]
            columns.append(column)
    if not members and "brightness" in families:
        columns.append(photo.color * vector[TINT] * width)
    elif not members:
        fixed = vector[BRIGHTNESS] * photo.color * vector[TINT] * width
    amplitudes = len(columns)
    for p in levels:
        column = np.zeros((m, 3))
        rows = [0, 1, 2] if p is None else [e - BACKGROUND.start for e in p.entries]
        column[:, rows] = photo.one[:, None]
        columns.append(column)
    if not levels:
        fixed = fixed + photo.one[:, None] * vector[BACKGROUND]
    solution = _solved(columns, light - fixed)
    vector = vector.copy()
    if members:
        rest = 3.0 - sum(vector[TINT.start + k] for k in range(3) if k not in members)
        brightness = solution[:amplitudes].sum() / rest if rest else 0.0
        if brightness > 0:
            vector[BRIGHTNESS] = brightness
            for k, amplitude in zip(sorted(members), solution, strict=False):
                vector[TINT.start + k] = amplitude / brightness
    elif amplitudes:
        vector[BRIGHTNESS] = solution[0]
    for p, value in zip(levels, solution[amplitudes:], strict=True):
        if p is not None:
            vector[list(p.entries)] = value
    return vector


def _has_level(photo: int, free: Sequence[FitParameter]) -> bool:
    """The black level of a photo is fitted."""
    entry = LOOK_ENTRIES + RESPONSE_ENTRIES * photo + 2
    return any(entry in p.entries for p in free if p.family == "black_level")


def _response_for(
    photo: _Photo,
    number: int,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
) -> Entries:
    """Exposure and black level of one photo, the look as given."""
    start = LOOK_ENTRIES + RESPONSE_ENTRIES * number
    has = {
        name: any(start + k in q.entries for p in free for q in followers(p, parameters))
        for name, k in (("exposure", 0), ("black_level", 2))
    }
    if not any(has.values()):
        return vector
    width = photo.lit[:, None] + photo.dark[:, None] * vector[SHADOW]
    scene = vector[BRIGHTNESS] * photo.color * vector[TINT] * width + photo.surface
    scene = scene + photo.one[:, None] * vector[BACKGROUND]
    level = np.repeat(photo.one[:, None], 3, axis=1)
    columns = [
        column for column, name in ((scene, "exposure"), (level, "black_level")) if has[name]
    ]
    target = photo.light.copy()
    if not has["exposure"]:
        target -= vector[start] * scene
    if not has["black_level"]:
        target -= vector[start + 2] * level
    solution = list(_solved(columns, target))
    vector = vector.copy()
    if has["exposure"]:
        exposure = solution.pop(0)
        if exposure > 0:
            vector[start] = exposure
    if has["black_level"]:
        vector[start + 2] = solution.pop(0)
    return vector


def _solved(columns: Sequence[np.ndarray], target: np.ndarray) -> Float[np.ndarray, " c"]:
    """Amounts of pictures that add up to another."""
    if not columns:
        return np.zeros(0)
    return least_squares(np.stack([c.reshape(-1) for c in columns], axis=1), target.reshape(-1))[0]


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
    reduced: Samples,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
) -> Least | None:
    """The least square sum over all values of what is free, bounds of shadow weights only.

    Args:
        reduced: `moments` of the pixels.
        vector: what is not free stays as it is.

    Returns:
        None where the model is no such sum: exposures or gammas are free, brightness is with some
        of the tints, two of the channels share one of several shadow weights, or a photo is grey.
    """
    if reduced.mix is not None:
        return None
    directions, moved = free_directions(free, parameters)
    families = np.array([members[0].family for members in moved])
    amplitudes = _amplitudes(vector, directions[TINT][:, families == "tint"], families)
    shadows = directions[SHADOW][:, families == "shadow"]
    if amplitudes is None or np.isin(families, ("exposure", "gamma")).any():
        return None
    if shadows.shape[1] > 1 and (shadows.sum(axis=0) > 1).any():
        return None
    levels = directions[:, np.isin(families, ("background", "black_level"))]
    problem = _Sums(reduced, vector, *amplitudes, shadows, levels)
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
        reduced: Samples,
        vector: Entries,
        fixed: Float[np.ndarray, "3"],
        columns: Float[np.ndarray, "3 a"],
        shadows: Float[np.ndarray, "3 s"],
        levels: Float[np.ndarray, "e l"],
    ) -> None:
        exposure = vector[LOOK_ENTRIES::RESPONSE_ENTRIES][:, None, None]
        light = np.asarray(reduced.light, np.float64)
        one = np.broadcast_to(np.asarray(reduced.one)[:, None], light.shape)
        color = exposure * np.asarray(reduced.color)[:, :, None]
        lit = color * np.asarray(reduced.lit)[:, None]
        dark = (
            np.zeros_like(lit)
            if reduced.dark is None
            else color * np.asarray(reduced.dark)[:, None]
        )
        self.vector, self.fixed, self.columns = vector, fixed, columns
        self.shadows, self.levels = shadows, levels
        self.own = shadows.shape[1] > 1
        """Channels have shadow weights of their own: their dark amplitudes are free."""
        self.weights = np.where(shadows.any(axis=1), 0.0, vector[SHADOW])
        self.lit, self.dark = lit, dark
        held = np.where(levels.any(axis=1), 0.0, vector)
        level = exposure * held[BACKGROUND][:, None] + held[_BLACK][:, None, None]
        target = light - one * level
        if reduced.surface is not None:
            target = target - exposure * np.asarray(reduced.surface)
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
        target = target.reshape(len(shadow), -1)
        parts = width[..., None] * self.columns[:, None, :]
        moving = parts.reshape(len(shadow), self.target.size, -1)
        steady = np.broadcast_to(self.steady, (len(shadow), *self.steady.shape))
        matrix = np.concatenate([moving, steady], axis=2)
        found, left = least_squares(matrix, target)
        return (left**2).sum(axis=1), found

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


def _scan(problem: _Sums, weight: FitParameter) -> Float[np.ndarray, "1"]:
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
