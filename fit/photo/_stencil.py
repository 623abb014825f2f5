"""What a blurred pixel near a planet's limb sees: the air at some heights above it, and the light
of the planet beside it.

Along the limb light hardly changes within a blur's reach, so a pixel's light is that of a line
across it (`model_jax._blur`): fields are found anew, exactly, at a few places of lines every few
pixels along the limb, and light between two of them is in proportion. The planet's own light nobody
models. It is measured inside the limb, deep enough that no blur reaches there, the air in front of
it taken off, and goes on to the limb as a line.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_matrix

from model_jax import InputError, Layers
from model_jax._blur import MOST_BLUR, REACH, inner_heights, profile_heights
from model_jax._intersect import squared_miss_distance
from model_jax._view import View, pixel_slopes, ray_offsets

from ._widths import fields_between

DEPTH = 3.0
"""Blur widths inside the limb from which light is the planet's own: 0.1 % of a Gaussian is
beyond."""
INSIDE = 8.0
"""Pixels across the band in which it is measured."""
ALONG = 16.0
"""Pixels along the limb over which it is averaged: clouds are as large, noise is not."""
SLOPE_ALONG = 64.0
"""Pixels along the limb over which its slope is, as a line: a slope reaches over the band's depth,
and what it is wrong by grows with that. A mean over 128 lost the terminator, and with it a tenth of
the dark air's light."""
SKY = 24.0
"""Pixels of sky beyond the air that are looked at, to tell what is there without it."""
LINES = 4.0
"""Pixels along the limb from line to line."""
ON_THE_GROUND = 1e-6
"""Height below the limb, px, at which a ray surely meets the ground."""
_ROWS = 2**18
"""Pixels looked at at once."""

_FLAT = 1e-12
"""A slope that is none, radii/px."""

_Way = float | Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Inside:
    """Light of the planet at its limb, as recorded; by the direction in which the limb lies."""

    angle: Float[np.ndarray, " m"]
    """Direction away from the planet, increasing, -π to π."""
    light: Float[np.ndarray, "m 6"]
    """Level at the limb, then its change for each pixel down from it, of each channel."""
    near: float
    """Depth below the limb, px, from which it was measured, over `INSIDE`."""
    noise: Float[np.ndarray, "3"]
    """Standard deviation of a pixel it was measured in, about its piece of the limb."""
    errors: Float[np.ndarray, "r m 2"]
    """What each independent error makes of level and change of all, where `noise` is 1."""

    @property
    def band(self) -> Float[np.ndarray, "2"]:
        """Heights, px, that stand for where it was measured: their mean and variance are its."""
        return -self.near - INSIDE * (0.5 + np.array([0.5, -0.5]) / np.sqrt(3))

    def at(self, angle: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 6"]:
        return np.asarray(self.shares(angle) @ self.light)

    def shares(self, angle: Float[np.ndarray, " n"]) -> csr_matrix:
        """How much of each piece's light is a direction's: that of the two beside it, `[n m]`."""
        rows, count = np.arange(len(angle)), len(self.angle)
        edges = np.append(self.angle - self.angle[0], 2 * np.pi)
        ahead = (angle - self.angle[0]) % (2 * np.pi)
        before = np.clip(np.searchsorted(edges, ahead, side="right") - 1, 0, count - 1)
        share = (ahead - edges[before]) / np.diff(edges)[before]
        pairs = np.concatenate([rows, rows]), np.concatenate([before, (before + 1) % count])
        return csr_matrix((np.concatenate([1 - share, share]), pairs), (len(angle), count))


@dataclass(frozen=True)
class Stencil:
    """What blurred pixels see: lines across the limb, and where beside them each pixel is.

    Pixels come by their `angle`, and lines too, so that the pixels of a tile lie between two.
    """

    lines: Float[np.ndarray, " m"]
    """Direction away from the planet of each line, increasing."""
    heights: Float[np.ndarray, "m k"]
    """Heights of its places above the limb, px, increasing."""
    fields: dict[str, Float[np.ndarray, "m k"]]
    """What the look needs, at each."""
    inner: dict[str, Float[np.ndarray, "m j"]]
    """The same in front of the planet: at `inner_heights`, then at `band`."""
    band: Float[np.ndarray, "2"]
    """Heights where the planet's light was measured (`Inside.band`)."""
    angle: Float[np.ndarray, " n"]
    """Direction of each pixel."""
    height: Float[np.ndarray, " n"]
    """Its own height, px."""
    bend: Float[np.ndarray, " n"]
    """Curvature of the limb there, 1/px."""
    inside: Float[np.ndarray, "n 6"]
    """Light of the planet beside it, as `Inside.light`."""

    @property
    def before(self) -> Int[np.ndarray, " n"]:
        """The line at or before each pixel."""
        return np.maximum(np.searchsorted(self.lines, self.angle, side="right") - 1, 0)

    def part(self, chosen: Int[np.ndarray, " m"]) -> "Stencil":
        """That of some of the pixels."""
        return replace(
            self,
            angle=self.angle[chosen],
            height=self.height[chosen],
            bend=self.bend[chosen],
            inside=self.inside[chosen],
        )


def heights_above_limb(
    view: View, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"], Float[np.ndarray, "2 n"]]:
    """Height of each pixel above the limb and that of the air's end, px, and the unit vector that
    leads away from the limb, in columns and rows.

    Distances in the picture, along the slope of the height above the ground at the pixel.
    """

    def altitude(along: _Way, right: _Way, down: _Way) -> np.ndarray:
        at = column + along * right, row + along * down
        squared, _ = squared_miss_distance(*pixel_slopes(view, *at), *ray_offsets(view.aim, *at))
        return np.asarray((squared - 1) / (np.sqrt(squared) + 1))

    def slope(along: _Way, right: _Way, down: _Way) -> np.ndarray:
        return altitude(along + 0.5, right, down) - altitude(along - 0.5, right, down)

    away = np.stack([slope(0.0, 1.0, 0.0), slope(0.0, 0.0, 1.0)])
    steep = np.hypot(*away)
    away[0] = np.where(steep > 0, away[0], _FLAT)  # from a disc's very middle all ways lead out
    steep = np.maximum(steep, _FLAT)
    away = away / steep
    # Newton's method: what it would gain in a fourth step is below 1e-6 px. Far from the limb, as
    # in the middle of a disc, where there is no way out, the first step is kept.
    found = []
    for end in (0.0, view.shell - 1):
        first = (end - altitude(0.0, *away)) / steep
        way = first
        for _ in range(3):
            step = (end - altitude(way, *away)) / np.maximum(slope(way, *away), _FLAT)
            way = way + np.clip(step, -np.abs(first) / 2, np.abs(first) / 2)
        found.append(np.where(np.isfinite(way), way, first))
    limb, air = found
    return -limb, air - limb, away


def bends_of(
    view: View, column: Float[np.ndarray, " n"], row: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Curvature of the limb at each pixel, 1/px: how much higher it is `REACH` along it."""
    height, _, (right, down) = heights_above_limb(view, column, row)
    sides = [
        heights_above_limb(view, column - s * REACH * down, row + s * REACH * right)[0]
        for s in (1.0, -1.0)
    ]
    return (sides[0] + sides[1] - 2 * height) / REACH**2


def known_view(layers: Layers, asked: str = "response.blur") -> View:
    """The view of layers that a blur, or sky, can be fitted over.

    Raises `InputError` of what was `asked` if they have none.
    """
    if layers.view is None or layers.planet is None:
        raise InputError(
            f"{asked}: the layers do not tell how rays pass the planet; give layers of a scene, a "
            "file that airlight wrote with its scene, or leave it out"
        )
    return layers.view


def light_inside(
    light: Float[np.ndarray, "h w 3"],
    usable: Bool[np.ndarray, "h w"],
    layers: Layers,
    width: float,
) -> Inside | None:
    """The planet's light at its limb; None where no pixel tells it.

    Args:
        light: what was recorded.
        usable: True where that is known.
        width: the widest blur to be expected, px.
    """
    view, planet_of = known_view(layers), np.asarray(layers.planet)
    near = DEPTH * min(width, MOST_BLUR)
    angles, depths, levels = [], [], []
    rows, columns = usable.shape
    step = max(1, _ROWS // columns)
    for start in range(0, rows, step):
        end = min(start + step, rows)
        planet = (planet_of[start:end] != 0) & usable[start:end]
        row, column = np.nonzero(planet)
        height, _, (right, down) = heights_above_limb(view, column * 1.0, row + start * 1.0)
        band = (height < -near) & (height > -near - INSIDE)
        angles.append(np.arctan2(down, right)[band])
        depths.append(-height[band])
        levels.append(np.asarray(light[start:end])[row[band], column[band]])
    angle, depth = np.concatenate(angles), np.concatenate(depths)
    level = np.concatenate(levels).astype(np.float64)
    if angle.size < INSIDE:
        return None
    order = np.argsort(angle)
    pieces = _along(angle[order], depth[order], level[order])
    smoothing, middle = _smoothing(pieces.angle), pieces.depth
    slope = smoothing @ pieces.slope
    # Errors of means are their pieces' own, those of slopes of all that were smoothed with them.
    of_means = np.zeros((len(middle), len(middle), 2))
    of_means[..., 0] = np.diag(pieces.count**-0.5)
    changes = (smoothing * (pieces.count * pieces.spread) ** -0.5).T
    return Inside(
        angle=pieces.angle,
        light=np.concatenate([pieces.level - slope * middle[:, None], slope], axis=-1),
        near=near,
        noise=pieces.noise,
        errors=np.concatenate([of_means, np.stack([-changes * middle, changes], axis=-1)]),
    )


@dataclass(frozen=True)
class _Pieces:
    """The band in pieces of the limb of about `ALONG`."""

    angle: Float[np.ndarray, " m"]
    level: Float[np.ndarray, "m 3"]
    """Mean light."""
    depth: Float[np.ndarray, " m"]
    """Mean depth."""
    slope: Float[np.ndarray, "m 3"]
    """Change of light with depth."""
    count: Int[np.ndarray, " m"]
    spread: Float[np.ndarray, " m"]
    """Variance of depths."""
    noise: Float[np.ndarray, "3"]
    """Of pixels about their piece's line."""


def _along(
    angle: Float[np.ndarray, " n"],
    depth: Float[np.ndarray, " n"],
    level: Float[np.ndarray, "n 3"],
) -> _Pieces:
    """The pieces of pixels that come along the limb."""
    pieces = max(round(len(angle) / (INSIDE * ALONG)), 1)
    number = np.arange(len(angle)) * pieces // len(angle)
    count = np.bincount(number, minlength=pieces)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.bincount(number, values, pieces) / count

    middle = mean(depth)
    off = depth - middle[number]
    spread = np.maximum(mean(off * off), 1e-12)
    levels = np.stack([mean(channel) for channel in level.T], axis=-1)
    slopes = np.stack([mean(off * channel) for channel in level.T], axis=-1) / spread[:, None]
    left = level - levels[number] - slopes[number] * off[:, None]
    noise = np.sqrt((left**2).sum(axis=0) / max(len(level) - 2 * pieces, 1))
    return _Pieces(mean(angle), levels, middle, slopes, count, spread, noise)


def _smoothing(angle: Float[np.ndarray, " m"]) -> Float[np.ndarray, "m m"]:
    """What makes of values of pieces those of the lines through all within `SLOPE_ALONG`."""
    pieces = int(SLOPE_ALONG / ALONG / 2)
    reach = (pieces + 0.5) * np.median(np.diff(angle)) if len(angle) > 1 else 1.0
    apart = ((angle - angle[:, None] + np.pi) % (2 * np.pi) - np.pi) / reach
    near = np.abs(apart) <= 1
    middle = apart.mean(axis=1, where=near, keepdims=True)
    off = np.where(near, apart - middle, 0)
    spread = np.maximum((off * off).sum(axis=1, keepdims=True), 1e-12)
    return np.asarray(near / near.sum(axis=1, keepdims=True) - off * middle / spread)


def along_limb(layers: Layers, index: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """The order of pixels of flat indices along the limb."""
    row, column = (part.astype(np.float64) for part in np.divmod(index, np.shape(layers.front)[1]))
    _, _, (right, down) = heights_above_limb(known_view(layers), column, row)
    return np.argsort(np.arctan2(down, right), kind="stable")


def stencil_of(
    layers: Layers,
    index: Int[np.ndarray, " n"],
    unit: float,
    needs: Sequence[str],
    inside: Inside,
) -> Stencil:
    """What the pixels of flat indices, `along_limb`, see of a photo of which the planet's light is
    known."""
    view = known_view(layers)
    row, column = (part.astype(np.float64) for part in np.divmod(index, np.shape(layers.front)[1]))
    height, top, (right, down) = heights_above_limb(view, column, row)
    angle, bend = np.arctan2(down, right), bends_of(view, column, row)
    # A line through the first pixel of each piece of the limb, and through the last of all.
    piece = (
        np.floor(angle / max(LINES * abs(float(np.median(bend))), 1e-9)) if len(index) else angle
    )
    first = np.append(np.flatnonzero(np.diff(piece, prepend=np.nan) != 0), len(index) - 1)
    first = first[: len(index)]

    def at(heights: np.ndarray, *, ground: bool) -> dict[str, np.ndarray]:
        off = heights - height[first, None]
        columns = column[first, None] + off * right[first, None]
        rows = row[first, None] + off * down[first, None]
        flat = columns.reshape(-1), rows.reshape(-1)
        fields = fields_between(layers, flat, unit, needs, ground=ground)
        return {name: field.reshape(off.shape) for name, field in fields.items()}

    reach = float(height.max(initial=0.0)) + REACH
    heights = profile_heights(np.minimum(top[first], reach)).T
    inner = np.minimum(np.concatenate([inner_heights(), inside.band]), -ON_THE_GROUND)
    return Stencil(
        lines=angle[first],
        heights=heights,
        fields=at(heights, ground=False),
        inner=at(inner[None], ground=True),
        band=inside.band,
        angle=angle,
        height=height,
        bend=bend,
        inside=inside.at(angle),
    )
