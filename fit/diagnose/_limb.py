"""A planet's limb in a photo: each pixel's distance from it, its normal, and the disc's light."""

from collections.abc import Iterator
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from ..photo._photo import Photo

Light = Photo | Float[np.ndarray, "h w 3"]
"""Linear light; of a photo only the parts that are asked for are decoded."""
_SMOOTH = 5.0
"""Gaussian, px, by which the distance from the limb and the disc's light next to it are found."""
_REACH = 20
"""Its support, four standard deviations."""
_NEAR = 16.0
"""Beyond this distance, px, nothing of the disc arrives: 3.25 of the widest blur beyond the most
shifted edge."""
_INSIDE = 4
"""The outermost pixels of the disc do not count as disc: they hold the blurred edge."""
_TILE = 64
"""Side of the tiles that are blurred, px, beside the support around them."""


@dataclass(frozen=True)
class Limb:
    """The used pixels that the disc's light can reach."""

    index: Int[np.ndarray, " n"]
    """Flat index in the photo."""
    distance: Float[np.ndarray, " n"]
    """From the mask's edge, px, positive outside."""
    normal: Float[np.ndarray, "n 2"]
    """Away from the planet: right, down."""
    disc: Float[np.ndarray, "n 3"]
    """The disc's light, continued outward."""


def limb_of(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
) -> Limb:
    """Distance, normal and the disc's light, which is continued by a Gaussian blur.

    Where the outline is no conic, distance and normal come from the blurred mask: a straight edge
    blurred by a Gaussian is the normal distribution of the distance from it. A limb of radius R px
    moves it by about `_SMOOTH² / 2R`, less than the edge's free place; where the limb runs along
    rows of pixels it is uncertain by half a pixel. Only tiles by the limb are blurred.
    """
    outline = _outline(planet)
    inside = _eroded(planet)
    smooth, slope = _gaussian(_TILE)
    found: list[tuple[np.ndarray, ...]] = []
    for y, x in _limb_tiles(planet, used):
        rows, cols = (
            np.arange(y - _REACH, y + _TILE + _REACH),
            np.arange(x - _REACH, x + _TILE + _REACH),
        )
        height, width = planet.shape
        # Beyond the frame the mask goes on as at its edge, and no light is known.
        part = np.ix_(rows.clip(0, height - 1), cols.clip(0, width - 1))
        framed = np.outer((rows >= 0) & (rows < height), (cols >= 0) & (cols < width))
        mask = planet[part].astype(np.float64)
        covered = smooth @ mask @ smooth.T
        distance = -_SMOOTH * np.interp(covered, _CUMULATIVE, _DEVIATE)
        down, right = slope @ mask @ smooth.T, smooth @ mask @ slope.T
        values = light[part]
        known = inside[part] & framed & np.isfinite(values).all(axis=-1)
        weight = smooth @ known.astype(np.float64) @ smooth.T
        here = np.zeros((_TILE, _TILE), dtype=bool)
        frame = used[y : y + _TILE, x : x + _TILE]
        here[: frame.shape[0], : frame.shape[1]] = frame
        here &= (distance < _NEAR) & (weight > 1e-7)
        if not here.any():
            continue
        values = np.where(known[..., None], values, 0).astype(np.float64)
        disc = [(smooth @ values[..., k] @ smooth.T)[here] / weight[here] for k in range(3)]
        normal = -np.stack([right[here], down[here]], axis=-1)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        row, col = np.nonzero(here)
        index = (row + y) * width + col + x
        away = distance[here]
        if outline is not None:
            away, normal = _from_conic(outline, col + x, row + y)
        found.append((index, away, normal, np.stack(disc, axis=-1)))
    if not found:
        return Limb(np.zeros(0, int), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 3)))
    return Limb(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


_DEVIATE = np.linspace(-6.0, 6.0, 2401)
_CUMULATIVE = np.array([NormalDist().cdf(t) for t in _DEVIATE])
"""The normal distribution in steps of 1/200: a line between two is within 1e-6 of it."""


def _outline(planet: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "6"] | None:
    """The conic `c · (1, x, y, x², xy, y²)`, positive outside, that parts the planet from space.

    Spheres and ellipsoids have such outlines. The shell's width knows the limb's place exactly, and
    so must its rival: all pixels by the limb tell it together, to one or two hundredths of a pixel
    (logistic regression: Cox 1958, J. R. Stat. Soc. B 20, 215). None where one of them is on the
    wrong side by more than half a pixel: relief.
    """
    border = np.zeros_like(planet)
    down, right = planet[1:] != planet[:-1], planet[:, 1:] != planet[:, :-1]
    border[1:] |= down
    border[:-1] |= down
    border[:, 1:] |= right
    border[:, :-1] |= right
    y, x = np.nonzero(border)
    if not len(x):
        return None
    side, unit = np.where(planet[border], -1.0, 1.0), max(planet.shape)
    terms = _monomials(x / unit, y / unit)
    conic = np.zeros(6)
    for _ in range(_LOGISTIC_STEPS):
        wrong = 1 / (1 + np.exp(np.clip(side * (terms @ conic), -20, 20)))
        root = np.sqrt(wrong * (1 - wrong))
        conic += np.linalg.lstsq(terms * root[:, None], side * wrong / root, rcond=None)[0]
    conic /= np.array([1, unit, unit, unit**2, unit**2, unit**2])
    distance, _ = _from_conic(conic, x, y)
    return conic if np.all(distance * side > -0.5) else None


_LOGISTIC_STEPS = 6
"""The first is that of least squares. After many more, the regression, sharper with each, would
follow single pixels."""


def _monomials(x: Any, y: Any) -> Float[np.ndarray, "*n 6"]:
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)


def _from_conic(
    conic: Float[np.ndarray, "6"], x: Int[np.ndarray, " n"], y: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Distance from the conic and the normal at its foot, by Newton's steps along the gradient."""
    start = foot = np.stack([x, y], axis=-1).astype(np.float64)
    normal = np.zeros_like(foot)
    bend = np.array([[2 * conic[3], conic[4]], [conic[4], 2 * conic[5]]])
    for _ in range(4):
        slope = conic[1:3] + foot @ bend
        steep = np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-30)
        normal = slope / steep
        foot = foot - (_monomials(*foot.T) @ conic)[:, None] / steep * normal
    return ((start - foot) * normal).sum(axis=-1), normal


def _gaussian(size: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices [size, size + 2 reach] that blur, and blur and differentiate, along one axis."""
    lag = np.arange(size + 2 * _REACH)[None, :] - np.arange(size)[:, None] - _REACH
    kernel = np.where(np.abs(lag) <= _REACH, np.exp(-0.5 * (lag / _SMOOTH) ** 2), 0.0)
    kernel /= kernel.sum(axis=1, keepdims=True)
    return kernel, kernel * lag / _SMOOTH**2


def _eroded(planet: Bool[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Planet with planet all around it at the distance `_INSIDE`; the frame's edge is no limb."""
    height, width = planet.shape
    inside = planet.copy()
    diagonal = round(_INSIDE / np.sqrt(2))
    for dy, dx in ((0, _INSIDE), (_INSIDE, 0), (diagonal, diagonal), (diagonal, -diagonal)):
        a = (slice(0, max(height - dy, 0)), slice(max(-dx, 0), max(min(width, width - dx), 0)))
        b = (slice(dy, height), slice(max(dx, 0), max(min(width, width + dx), 0)))
        inside[a] &= planet[b]
        inside[b] &= planet[a]
    return inside


def _limb_tiles(
    planet: Bool[np.ndarray, "h w"], used: Bool[np.ndarray, "h w"]
) -> Iterator[tuple[int, int]]:
    """Upper left corners of the tiles that hold used pixels and have planet within reach."""
    for y in range(0, used.shape[0], _TILE):
        for x in range(0, used.shape[1], _TILE):
            if used[y : y + _TILE, x : x + _TILE].any():
                top, left = max(y - _REACH, 0), max(x - _REACH, 0)
                if planet[top : y + _TILE + _REACH, left : x + _TILE + _REACH].any():
                    yield y, x


def normal_distribution(deviate: np.ndarray) -> np.ndarray:
    """The normal distribution by its table, to 1e-6; `np.interp` would search for each cell."""
    place = np.clip((deviate - _DEVIATE[0]) / (_DEVIATE[1] - _DEVIATE[0]), 0, len(_DEVIATE) - 1.001)
    cell = place.astype(int)
    return _CUMULATIVE[cell] + (place - cell) * (_CUMULATIVE[cell + 1] - _CUMULATIVE[cell])
