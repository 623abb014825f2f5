"""Where a descent starts: the exact optimum of what is linear, for a fan of shadow weights.

Given the shadow weight the picture is linear in what remains, brightness × tint counting as one
number per channel. With tint free and one weight for all channels, what is left is a Rayleigh
quotient of two by two matrices in the direction (lit, dark), which has one valley: 9 directions
over the quarter circle of weights ≥ 0 cannot miss it. For plain least squares without gamma the
best of the fan is within the fan's width of the global optimum, which is what keeps a descent out
of wrong valleys; a free gamma gets a fan of its own, by taking the photo's light to its power.
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
    Parameter,
    followers,
)
from ._reduce import moments
from ._samples import Samples

WEIGHTS = np.tan(np.linspace(0, np.pi / 2, 10)[:-1])
"""Shadow weights of the fan, in units in which lit and dark are equally large."""

GAMMAS = (0.45, 0.7, 1.0, 1.4, 2.2)
"""Gammas of the fan: from a picture taken as sRGB that was linear, to the reverse."""


@dataclass(frozen=True)
class _Linear:
    """Moments of one photo: pseudo-pixels by columns, gamma undone."""

    one: Float[np.ndarray, " m"]
    lit: Float[np.ndarray, " m"]
    dark: Float[np.ndarray, " m"]
    surface: Float[np.ndarray, "m 3"]
    light: Float[np.ndarray, "m 3"]
    color: Float[np.ndarray, "3"]


def starts(
    samples: Samples,
    vector: Entries,
    free: Sequence[Parameter],
    parameters: Sequence[Parameter],
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


def _linear_photos(samples: Samples, vector: Entries) -> list[_Linear]:
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
        _Linear(one[k], np.asarray(found.lit)[k], dark[k], surface[k], light[k], color)
        for k, color in enumerate(colors)
    ]


def _fan(
    photos: Sequence[_Linear],
    base: Entries,
    free: Sequence[Parameter],
    parameters: Sequence[Parameter],
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
    photo: _Linear, vector: Entries, free: Sequence[Parameter], parameters: Sequence[Parameter]
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
    levels: list[Parameter | None] = [p for p in free if p.family == "background"]
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
    solution = _solve(columns, light - fixed)
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


def _has_level(photo: int, free: Sequence[Parameter]) -> bool:
    """The black level of a photo is fitted."""
    entry = LOOK_ENTRIES + RESPONSE_ENTRIES * photo + 2
    return any(entry in p.entries for p in free if p.family == "black_level")


def _response_for(
    photo: _Linear,
    number: int,
    vector: Entries,
    free: Sequence[Parameter],
    parameters: Sequence[Parameter],
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
    solution = list(_solve(columns, target))
    vector = vector.copy()
    if has["exposure"]:
        exposure = solution.pop(0)
        if exposure > 0:
            vector[start] = exposure
    if has["black_level"]:
        vector[start + 2] = solution.pop(0)
    return vector


def _solve(columns: Sequence[np.ndarray], target: np.ndarray) -> Float[np.ndarray, " c"]:
    """Linear least squares with columns scaled to one length."""
    if not columns:
        return np.zeros(0)
    matrix = np.stack([c.reshape(-1) for c in columns], axis=1)
    size = np.linalg.norm(matrix, axis=0)
    size = np.where(size > 0, size, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / size, target.reshape(-1), rcond=1e-12)[0] / size)
