"""Vectors worth starting a descent from.

Of a separable look (`_separable`) all but the weight is a linear least squares problem, solved for
a fan of weights. With the factors free and one weight for all channels, what is left is a Rayleigh
quotient of two by two matrices in the direction of the two fields, which has one valley: 9
directions over the quarter circle of weights ≥ 0 cannot miss it. For plain least squares without
gamma the best of the fan is within the fan's width of the global optimum, which keeps a descent out
of wrong valleys; a free gamma gets a fan of its own, by taking the light to its power.

Of other looks the starts are spread over what is likely, and `_approach` chooses among them.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from ._layout import Layout
from ._parameters import Entries, FitParameter, followers, settle_shares
from ._reduce import moments
from ._samples import Samples
from ._scaled import least_squares
from ._separable import Places, places_of

WEIGHTS = np.tan(np.linspace(0, np.pi / 2, 10)[:-1])
"""Weights of the fan, in units in which both fields are equally large."""

GAMMAS = (0.45, 0.7, 1.0, 1.4, 2.2)
"""Gammas of a fan: from a picture taken as sRGB that was linear, to the reverse."""

SPREAD = 31
"""Starts beside the given one: on few pseudo-pixels their square sums cost less than a descent."""

DECADES = 1.0
"""How far, as a power of ten, a size may be from the given one, either way."""

LEVELS = 3.0
"""How far a number of any sign may be from the given one, in its typical size."""


@dataclass(frozen=True)
class _Photo:
    """Moments of one photo: pseudo-pixels by columns, gamma undone."""

    one: Float[np.ndarray, " m"]
    first: Float[np.ndarray, " m"]
    second: Float[np.ndarray, " m"]
    surface: Float[np.ndarray, "m 3"]
    light: Float[np.ndarray, "m 3"]
    color: Float[np.ndarray, "3"]


def start_vectors(
    samples: Samples,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    layout: Layout,
) -> list[Entries]:
    """Vectors worth starting from, the given one first."""
    at = places_of(layout)
    if at is None:
        return spread_starts(vector, free, parameters)
    gammas = [p for p in free if p.family == "gamma"]
    moved = {entry for p in gammas for q in followers(p, parameters) for entry in q.entries}
    found = [vector]
    for gamma in GAMMAS if gammas else (None,):
        base = vector.copy()
        if gamma is not None:
            base[sorted(moved)] = gamma
        found += _fan(_linear_photos(samples, base, at), base, free, parameters, at)
    return [v for v in found if np.isfinite(v).all()]


def _linear_photos(samples: Samples, vector: Entries, at: Places) -> list[_Photo]:
    responses = at.layout.responses(vector)
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
    first = np.asarray(found.fields[at.fact.first])
    zero = np.zeros_like(first)
    second = np.asarray(found.fields.get(at.fact.second, zero))
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
        _Photo(one[k], first[k], second[k], surface[k], light[k], color)
        for k, color in enumerate(colors)
    ]


def _fan(
    photos: Sequence[_Photo],
    base: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    at: Places,
) -> list[Entries]:
    """One vector for each weight, or for the base's own where it is not free."""
    weights = [base[at.weight]]
    moved = _moved(at.fact.weight, free, parameters)
    if moved:
        sizes = [
            np.sqrt(sum((getattr(p, name) ** 2).sum() for p in photos))
            for name in ("first", "second")
        ]
        ratio = sizes[0] / sizes[1] if min(sizes) > 0 else 1.0
        weights += [np.full(3, ratio * w) for w in WEIGHTS]
    found = []
    for weight in weights:
        vector = base.copy()
        for entry in moved:
            vector[entry] = weight[entry - at.weight.start]
        vector = _look_for(photos[0], vector, free, parameters, at)
        for number, photo in enumerate(photos):
            vector = _response_for(photo, number, vector, free, parameters, at)
        found.append(vector)
    return found


def _moved(
    family: str, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> list[int]:
    """Entries of a family that are free, or tied to what is."""
    masters = [p for p in free if p.family == family]
    return [e for p in masters for q in followers(p, parameters) for e in q.entries]


def _look_for(
    photo: _Photo,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    at: Places,
) -> Entries:
    """Amplitude, factors, background of the best picture of the first photo, given the weight."""
    families = {p.family for p in free}
    exposure, _, level, *_ = at.layout.responses(vector)[0]
    if exposure == 0:
        return vector
    light = (photo.light - level * photo.one[:, None]) / exposure - photo.surface
    width = photo.first[:, None] + photo.second[:, None] * vector[at.weight]
    factors = [e - at.factors.start for e in _moved(at.fact.factors, free, parameters)]
    has_amplitude = at.fact.amplitude in families
    levels: list[FitParameter | None] = [p for p in free if p.family == "background"]
    if not levels and "black_level" in families and _has_level(at.response(0), free):
        levels = [None]  # the response finds it again, with the look of now
    m = len(photo.one)
    columns: list[np.ndarray] = []
    fixed = np.zeros((m, 3))
    members = factors if has_amplitude and len(factors) > 1 else []
    for k in range(3):
        if k in members:
            column = np.zeros((m, 3))
            column[:, k] = photo.color[k] * width[:, k]
            columns.append(column)
    if not members and has_amplitude:
        columns.append(photo.color * vector[at.factors] * width)
    elif not members:
        fixed = vector[at.amplitude] * photo.color * vector[at.factors] * width
    amplitudes = len(columns)
    for p in levels:
        column = np.zeros((m, 3))
        rows = [0, 1, 2] if p is None else [e - at.background.start for e in p.entries]
        column[:, rows] = photo.one[:, None]
        columns.append(column)
    if not levels:
        fixed = fixed + photo.one[:, None] * vector[at.background]
    solution = _solved(columns, light - fixed)
    vector = vector.copy()
    if members:
        start = at.factors.start
        rest = 3.0 - sum(vector[start + k] for k in range(3) if k not in members)
        whole = solution[:amplitudes].sum() / rest if rest else 0.0
        if whole > 0:
            vector[at.amplitude] = whole
            for k, amplitude in zip(sorted(members), solution, strict=False):
                vector[start + k] = amplitude / whole
    elif amplitudes:
        vector[at.amplitude] = solution[0]
    for p, value in zip(levels, solution[amplitudes:], strict=True):
        if p is not None:
            vector[list(p.entries)] = value
    return vector


def _has_level(response: int, free: Sequence[FitParameter]) -> bool:
    """The black level of the photo whose response begins there is fitted."""
    return any(response + 2 in p.entries for p in free if p.family == "black_level")


def _response_for(
    photo: _Photo,
    number: int,
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    at: Places,
) -> Entries:
    """Exposure and black level of one photo, the look as given."""
    start = at.response(number)
    has = {
        name: any(start + k in q.entries for p in free for q in followers(p, parameters))
        for name, k in (("exposure", 0), ("black_level", 2))
    }
    if not any(has.values()):
        return vector
    width = photo.first[:, None] + photo.second[:, None] * vector[at.weight]
    scene = vector[at.amplitude] * photo.color * vector[at.factors] * width + photo.surface
    scene = scene + photo.one[:, None] * vector[at.background]
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


def spread_starts(
    vector: Entries,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    but: Collection[str] = ("exposure",),
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> list[Entries]:
    """The vector itself, then others evenly over what is likely (Sobol, 1967).

    Factors of mean one stay.

    Args:
        but: families that stay as well, for the rest does not hang on them.
        ranges: by unit, what is likely in the scene at hand; without, it is near the vector.
    """
    moved = [p for p in free if not p.mean_one and p.family not in but]
    if not moved:
        return [vector]
    points = qmc.Sobol(len(moved), scramble=False).random(SPREAD + 1)[1:]  # the first is all 0
    found = [vector]
    for point in points:
        start = vector.copy()
        for share, p in zip(point, moved, strict=True):
            value = _likely(p, float(p.of(vector)), float(share), ranges or {})
            for q in followers(p, parameters):
                start[list(q.entries)] = value
        found.append(settle_shares(start, free, parameters))
    return found


def _likely(
    p: FitParameter, value: float, share: float, ranges: Mapping[str, tuple[float, float]]
) -> float:
    """The value at a share of what a parameter may likely be."""
    if p.unit in ranges:
        low, high = np.clip(ranges[p.unit], p.lower, p.upper)
        return float(low * (high / low) ** share) if low > 0 else value
    if p.lower > 0 and np.isfinite(p.upper):
        return float(p.lower * (p.upper / p.lower) ** share)
    if np.isfinite(p.lower) and np.isfinite(p.upper):
        return p.lower + share * (p.upper - p.lower)
    if np.isfinite(p.lower) or np.isfinite(p.upper):
        bound, side = (p.lower, 1.0) if np.isfinite(p.lower) else (p.upper, -1.0)
        size = abs(value - bound) or p.scale
        return float(bound + side * size * 10 ** (DECADES * (2 * share - 1)))
    return value + LEVELS * p.scale * (2 * share - 1)
