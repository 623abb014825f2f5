"""A planet's limb in a photo: each pixel's distance from it, its normal, and the disc's light."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import distance_transform_edt, gaussian_filter

from ..photo._photo import Photo

Light = Photo | Float[np.ndarray, "h w 3"]
"""Linear light; of a photo only the parts that are asked for are decoded."""
_SMOOTH, _SHARP = 5.0, 2.5
"""Gaussians, px, by which the disc's light next to the limb is found, and how it changes there."""
_REACH = 20
"""The support of both, four standard deviations of the wider."""
_LEAST_RUN = 0.05
"""Least difference of the depth's root, px^½, between the two from which a slope is taken."""
_NEAR = 16.0
"""Beyond this distance, px, nothing of the disc arrives: 3.25 of the widest blur beyond the most
shifted edge."""
_INSIDE = 4
"""The outermost pixels of the disc do not count as disc: they hold the blurred edge."""
GLARE = 0.05
GLARE_NOISE = 3.0
"""Most by which the sky beside a bare limb is brighter than beyond, as a share of the disc's
brightest channel, half of what a halo may hold, and in standard deviations of the sky: the Moon's
is by 0.01."""
_SKY_PIXELS = 10_000
TILE = 64
"""Side of the tiles that are blurred, px, beside the support around them."""


Place = tuple[float, float, float]
"""How far a limb lies from the mask's, px: outward, to the right, downward."""


@dataclass(frozen=True)
class Limb:
    """The used pixels that the disc's light can reach."""

    index: Int[np.ndarray, " n"]
    """Flat index in the photo."""
    distance: Float[np.ndarray, " n"]
    """From the mask's edge, px, positive outside."""
    turn: Float[np.ndarray, "n 5"]
    """By how much the limb moves there if it moves outward, to the right, down, and by the cosine
    and sine of the doubled angle: where the sun stands low on one side, the lit disc is oval."""
    disc: Float[np.ndarray, "n 3"]
    """The disc's light inside, averaged next to the pixel."""
    slope: Float[np.ndarray, "n 3"]
    """How it changes with the root of the depth below the limb, per px^½."""
    root: Float[np.ndarray, " n"]
    """Root of the depth where `disc` was taken, px^½."""


def limb_of(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    place: Place = (0.0, 0.0, 0.0),
    outline: "Outline | None" = None,
) -> Limb:
    """What a bare limb's light is made of, pixel by pixel.

    Distances are from the photo's limb, at a `place` beside the mask's, and negative within it.
    """
    outline = outline or outline_of(planet)
    # What of the mask lies beyond the photo's limb is no disc either.
    inward = max(0.0, float(np.hypot(*place[1:])) - place[0])
    inside = _eroded(planet, round(_INSIDE + inward))
    smooth, sharp = _gaussian(TILE, _SMOOTH), _gaussian(TILE, _SHARP)
    height, width = planet.shape
    found: list[tuple[np.ndarray, ...]] = []
    for y, x in limb_tiles(planet, used):
        row, col = np.nonzero(used[y : y + TILE, x : x + TILE])
        distance, turn = _beside(outline, col + x, row + y, place)
        rows, cols = (
            np.arange(y - _REACH, y + TILE + _REACH),
            np.arange(x - _REACH, x + TILE + _REACH),
        )
        # Beyond the frame no light is known.
        part = np.ix_(rows.clip(0, height - 1), cols.clip(0, width - 1))
        framed = np.outer((rows >= 0) & (rows < height), (cols >= 0) & (cols < width))
        values = light[part]
        known = inside[part] & framed & np.isfinite(values).all(axis=-1)
        weight = (smooth @ known.astype(np.float64) @ smooth.T)[row, col]
        here = (distance < _NEAR) & (weight > _LEAST_WEIGHT)
        if not here.any():
            continue
        row, col = row[here], col[here]
        right, down = np.meshgrid(cols, rows)
        depth = -_beside(outline, right[known], down[known], place)[0]
        seen = np.zeros((4, *known.shape))
        seen[0][known] = np.sqrt(np.maximum(depth, 0))
        seen[1:, known] = values[known].T
        root, *disc = _averages(smooth, known, seen, row, col)
        nearer, *nearby = _averages(sharp, known, seen, row, col)
        run = nearer - root
        told = run < -_LEAST_RUN
        slope = (np.stack(nearby, -1) - np.stack(disc, -1)) / np.where(told, run, np.inf)[:, None]
        index = (row + y) * width + col + x
        found.append((index, distance[here], turn[here], np.stack(disc, -1), slope, root))
    if not found:
        none = np.zeros((0, 3))
        return Limb(np.zeros(0, int), np.zeros(0), np.zeros((0, 5)), none, none, np.zeros(0))
    # One column after the other: sums and products over pixels run several times as fast.
    return Limb(*(np.asfortranarray(np.concatenate(part)) for part in zip(*found, strict=True)))


def near_limb(
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    place: Place,
    within: float,
    outline: "Outline | None" = None,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "n 5"]]:
    """Used pixels within a distance of the limb, px: flat index, distance, and `Limb.turn`."""
    outline, (height, width) = outline or outline_of(planet), planet.shape
    y, x = (np.arange(0, size, TILE) for size in (height, width))
    left, top = (axis.ravel() for axis in np.meshgrid(x, y))
    middle = (left + TILE // 2).clip(0, width - 1), (top + TILE // 2).clip(0, height - 1)
    # Of tiles near the middle of a planet the distance is anything, but negative.
    close = outline.distances(*middle)[0] < within + TILE
    found: list[tuple[np.ndarray, ...]] = []
    for y0, x0 in zip(top[close], left[close], strict=True):
        row, col = np.nonzero(used[y0 : y0 + TILE, x0 : x0 + TILE])
        distance, turn = _beside(outline, col + x0, row + y0, place)
        here = distance < within
        found.append(((row + y0)[here] * width + (col + x0)[here], distance[here], turn[here]))
    if not found:
        return np.zeros(0, int), np.zeros(0), np.zeros((0, 5))
    index, away, turns = (np.asfortranarray(np.concatenate(p)) for p in zip(*found, strict=True))
    return index, away, turns


_LEAST_WEIGHT = 1e-7
"""Of the Gaussian's, below which an average is one of roundings."""


def _averages(
    gaussian: Float[np.ndarray, "size reach"],
    known: Bool[np.ndarray, "reach reach"],
    values: Float[np.ndarray, "k reach reach"],
    row: Int[np.ndarray, " n"],
    col: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "k n"]:
    """Of known pixels, by a Gaussian; where it reaches none, of all of them."""
    weight = (gaussian @ known.astype(np.float64) @ gaussian.T)[row, col]
    blurred = np.stack([(gaussian @ one @ gaussian.T)[row, col] for one in values])
    whole = values[:, known].mean(axis=1, keepdims=True)
    reached = weight > _LEAST_WEIGHT
    return np.asarray(np.where(reached, blurred / np.where(reached, weight, 1.0), whole))


def _beside(
    outline: "Outline", x: Int[np.ndarray, " n"], y: Int[np.ndarray, " n"], place: Place
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 5"]]:
    """Distances of pixels from the photo's limb, and `Limb.turn`."""
    distance, normal = outline.distances(x, y)
    right, down = normal.T
    turn = np.stack(
        [np.ones(len(right)), right, down, right**2 - down**2, 2 * right * down], axis=-1
    )
    return distance - turn[:, :3] @ np.asarray(place), turn


def glows(
    light: Light,
    limb: Limb,
    level: tuple[float, float, float],
    sky: Bool[np.ndarray, "h w"] | None,
) -> bool:
    """Whether a level of light by the limb lies above the sky's by more than a lens makes of the
    disc."""
    if sky is None or not sky.any():
        return False
    y, x = np.nonzero(sky)
    few = slice(None, None, -(-len(y) // _SKY_PIXELS))
    beyond = light[y[few], x[few]].astype(np.float64)
    middle = np.median(beyond, axis=0)
    noise = 1.4826 * np.median(np.abs(beyond - middle), axis=0)
    disc = float(np.percentile(limb.disc, 95, axis=0).max()) if len(limb.disc) else 0.0
    return bool((np.asarray(level) - middle > np.maximum(GLARE * disc, GLARE_NOISE * noise)).any())


@dataclass(frozen=True)
class Outline:
    """Where a mask ends: a conic, or what the mask itself tells."""

    radius: float
    """Of the circle that curves as it does, or has as many pixels, px."""
    conic: Float[np.ndarray, "6"] | None
    signed: Float[np.ndarray, "h w"] | None
    """Distance from the mask's edge, px, where that is no conic."""

    def distances(
        self, x: Int[np.ndarray, " n"], y: Int[np.ndarray, " n"]
    ) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
        """Distances of pixels, px, positive outside, and normals: right, down."""
        if self.conic is not None:
            return _from_conic(self.conic, x, y)
        assert self.signed is not None
        height, width = self.signed.shape
        right = self.signed[y, (x + 1).clip(0, width - 1)] - self.signed[y, (x - 1).clip(0)]
        down = self.signed[(y + 1).clip(0, height - 1), x] - self.signed[(y - 1).clip(0), x]
        normal = np.stack([right, down], axis=-1).astype(np.float64)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
        return self.signed[y, x].astype(np.float64), normal


def outline_of(planet: Bool[np.ndarray, "h w"]) -> Outline:
    """The outline of a mask.

    Where it is no conic, distances are those between pixels' middles, smoothed by 1.5 px: a limb
    that runs along rows of pixels is uncertain by half a pixel.
    """
    conic = _conic(planet)
    if conic is not None:
        return Outline(_radius(conic, planet), conic, None)
    away, within = distance_transform_edt(~planet), distance_transform_edt(planet)
    signed = np.where(planet, 0.5 - within, away - 0.5).astype(np.float32)
    return Outline(float(np.sqrt(planet.sum() / np.pi)), None, gaussian_filter(signed, 1.5))


def _radius(conic: Float[np.ndarray, "6"], planet: Bool[np.ndarray, "h w"]) -> float:
    """Radius of curvature of the conic, the mean over its pixels in the picture."""
    y, x = np.nonzero(planet[:, 1:] != planet[:, :-1])
    if len(x) < 2:
        y, x = np.nonzero(planet[1:] != planet[:-1])
    right = conic[1] + 2 * conic[3] * x + conic[4] * y
    down = conic[2] + conic[4] * x + 2 * conic[5] * y
    bend = 2 * (conic[3] * down**2 - conic[4] * right * down + conic[5] * right**2)
    curvature = float(np.mean(bend / np.maximum(np.hypot(right, down), 1e-30) ** 3))
    return 1 / max(abs(curvature), 1e-9)


def _conic(planet: Bool[np.ndarray, "h w"]) -> Float[np.ndarray, "6"] | None:
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
    # By components: stacked in pairs, pixels would be gone through two by two.
    level, across, along, wide, slanted, high = conic
    foot_x, foot_y = x.astype(np.float64), y.astype(np.float64)
    for _ in range(4):
        right = across + 2 * wide * foot_x + slanted * foot_y
        down = along + slanted * foot_x + 2 * high * foot_y
        steep = np.maximum(np.sqrt(right**2 + down**2), 1e-30)
        right, down = right / steep, down / steep
        value = level + foot_x * (across + wide * foot_x + slanted * foot_y)
        value += foot_y * (along + high * foot_y)
        foot_x, foot_y = foot_x - value / steep * right, foot_y - value / steep * down
    return (x - foot_x) * right + (y - foot_y) * down, np.stack([right, down], axis=-1)


def _gaussian(size: int, sigma: float) -> np.ndarray:
    """Matrix [size, size + 2 reach] that blurs along one axis."""
    lag = np.arange(size + 2 * _REACH)[None, :] - np.arange(size)[:, None] - _REACH
    kernel = np.where(np.abs(lag) <= _REACH, np.exp(-0.5 * (lag / sigma) ** 2), 0.0)
    return kernel / kernel.sum(axis=1, keepdims=True)


def _eroded(planet: Bool[np.ndarray, "h w"], by: int) -> Bool[np.ndarray, "h w"]:
    """Planet with planet all around it at a distance, px; the frame's edge is no limb."""
    height, width = planet.shape
    inside = planet.copy()
    diagonal = round(by / np.sqrt(2))
    for dy, dx in ((0, by), (by, 0), (diagonal, diagonal), (diagonal, -diagonal)):
        a = (slice(0, max(height - dy, 0)), slice(max(-dx, 0), max(min(width, width - dx), 0)))
        b = (slice(dy, height), slice(max(dx, 0), max(min(width, width + dx), 0)))
        inside[a] &= planet[b]
        inside[b] &= planet[a]
    return inside


def limb_tiles(
    planet: Bool[np.ndarray, "h w"], used: Bool[np.ndarray, "h w"]
) -> Iterator[tuple[int, int]]:
    """Upper left corners of the tiles that hold used pixels and have planet within reach."""
    for y in range(0, used.shape[0], TILE):
        for x in range(0, used.shape[1], TILE):
            if used[y : y + TILE, x : x + TILE].any():
                top, left = max(y - _REACH, 0), max(x - _REACH, 0)
                if planet[top : y + TILE + _REACH, left : x + TILE + _REACH].any():
                    yield y, x
