"""Where a photo's limb lies beside the scene's: shift, scale, and how well one limb tells them.

    light across the limb, block by block ──> edges ──> outward, right, down; what is left over

In each block along the limb the edge is where light changes most, of steep places the one next to
the scene's limb. Blocks at night have none, and those where air outshines the disc show the air's.
Outward is the radius' change. Of an arc its ends tell outward from sideways, so that each alone is
uncertain where half a limb is lit; what counts is how far the limb lies off where it is seen.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from model_jax import Layers

from .._of_photo import Alignment
from ..photo._columns import PhotoLike, as_picture
from ..photo._photo import Photo
from ._limb import TILE, Light, Outline, limb_tiles, outline_of

OFF_PX = 1.0
"""Distance of two limbs, px, from which it is worth a word."""
FOUND_PX = 12.0
"""How far from the scene's limb the photo's is looked for."""
MOST_RMS = 3.0
"""Root mean square distance, px, of edges that are no limb any more."""
_BLOCK = 16
_BIN = 0.5
"""Side of a block along the limb, and step across it, px."""
_WITHIN = 16.0
"""How far to either side light is looked at, px."""
_REACH = 2.0
"""How far to either side an edge's change of light is taken over, px."""
_TILES = 256
"""Most tiles that are looked at, evenly chosen."""
_BRIGHT = 0.5
"""Share of the strongest edges from which a block is taken for lit: where the sun is low, light
falls long before the limb."""
_STEEP = 0.5
"""Share of a block's steepest change that counts as an edge."""
_DISC = 0.5
"""Share of an edge's change that lies between disc and sky; less, and it is the air's."""
_LOOSE_PX = 10.0
"""Standard deviation of a place before the photo is looked at, px: an arc tells not all three."""
_LEAST_EDGES = 8
_ROUNDS = 8


def alignment_of(photo: PhotoLike, layers: Layers) -> Alignment | None:
    """The photo's limb beside that of layers that know their planet."""
    if layers.planet is None:
        return None
    light = photo if isinstance(photo, Photo) else as_picture(photo)
    return limb_beside(light, np.asarray(layers.planet) != 0, known_pixels(photo))


def known_pixels(photo: PhotoLike) -> Bool[np.ndarray, "h w"]:
    """Pixels whose light the photo tells."""
    if isinstance(photo, Photo):
        return np.asarray(photo.reason == 0)
    return np.asarray(np.isfinite(as_picture(photo)).all(axis=-1))


def misaligned(found: Alignment | None) -> str:
    """In words how far the photo's limb lies off; empty where that is little, or no more than how
    far the edges lie from any one limb."""
    if found is None or found.off <= max(OFF_PX, found.rms):
        return ""
    outward, right, down = (
        f"{abs(value):.1f} ± {error:.1f} px {words[value < 0]}"
        for value, error, words in zip(
            (found.outward, found.right, found.down),
            found.stderr,
            (("farther out", "farther in"), ("to the right", "to the left"), ("down", "up")),
            strict=True,
        )
    )
    return (
        f"the photo's limb lies {found.off:.1f} px beside the scene's where it is seen: {outward} "
        f"(a planet {found.scale:.4f} times as large), {right}, {down}"
    )


def limb_beside(
    light: Light, planet: Bool[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]
) -> Alignment | None:
    """The photo's limb beside a mask's.

    Args:
        light: linear light, finite where it is known.
        planet: where the scene's planet is.
        known: pixels that may be looked at.

    Returns:
        None where no limb is seen: fewer than eight blocks show an edge within `FOUND_PX`, or half
        of them lie on no one limb.
    """
    if not planet.any() or planet.all():
        return None
    outline = outline_of(planet)
    offsets, normals = _edges(light, planet, outline, known)
    if len(offsets) < _LEAST_EDGES:
        return None
    slopes = np.column_stack([np.ones(len(offsets)), normals])
    left = offsets - np.median(offsets)
    for _ in range(_ROUNDS):
        scatter = max(1.4826 * float(np.median(np.abs(left))), _BIN / 10)
        # Tukey's biweight: Beaton & Tukey 1974, Technometrics 16, 147.
        weights = np.maximum(1 - (left / (4.685 * scatter)) ** 2, 0) ** 2
        matrix = (slopes * weights[:, None]).T @ slopes / scatter**2 + np.eye(3) / _LOOSE_PX**2
        place = np.linalg.solve(matrix, slopes.T @ (weights * offsets) / scatter**2)
        left = offsets - slopes @ place
    rms = float(np.sqrt(np.average(left**2, weights=weights)))
    if rms > MOST_RMS or (weights > 0).mean() < 0.5:
        return None
    stderr = np.sqrt(np.diag(np.linalg.inv(matrix)))
    return Alignment(
        outward=float(place[0]),
        right=float(place[1]),
        down=float(place[2]),
        stderr=(float(stderr[0]), float(stderr[1]), float(stderr[2])),
        scale=float(1 + place[0] / outline.radius),
        off=float(np.sqrt(np.average((slopes @ place) ** 2, weights=weights))),
        rms=rms,
        edges=int((weights > 0).sum()),
    )


def _edges(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    outline: Outline,
    known: Bool[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 2"]]:
    """Distance of the photo's edge from the outline, and the normal there, block by block."""
    away_from = set(limb_tiles(~planet, known))  # and not far within it
    tiles = [tile for tile in limb_tiles(planet, known) if tile in away_from]
    chosen = np.unique(np.linspace(0, len(tiles) - 1, min(len(tiles), _TILES)).astype(int))
    parts: list[tuple[np.ndarray, ...]] = []
    for y, x in (tiles[k] for k in chosen):
        tile = np.s_[y : y + TILE, x : x + TILE]
        row, col = np.nonzero(known[tile])
        away, normal = outline.distances(col + x, row + y)
        near = np.abs(away) < _WITHIN
        if near.any():
            row, col, away, normal = row[near], col[near], away[near], normal[near]
            shown = np.asarray(light[tile], np.float64)[row, col]
            foot = np.stack([col + x, row + y], axis=-1) - away[:, None] * normal
            parts.append((np.floor(foot / _BLOCK).astype(int), away, normal, shown))
    if not parts:
        return np.zeros(0), np.zeros((0, 2))
    foot, away, normal, shown = (np.concatenate(part) for part in zip(*parts, strict=True))
    profile, normal = _profiles(foot, away, normal, shown)
    if not len(normal):
        return np.zeros(0), np.zeros((0, 2))
    # Mean of the light within reach inside a place less that outside, at the bins' borders.
    reach = round(_REACH / _BIN)
    sums = np.pad(np.cumsum(profile, axis=2), ((0, 0), (0, 0), (1, 0)))
    mid = np.arange(reach, profile.shape[2] - reach + 1)
    change = (2 * sums[..., mid] - sums[..., mid - reach] - sums[..., mid + reach]) / reach
    fall = np.abs(change).sum(axis=0)
    most = fall.max(axis=1)
    ends = round(8 / _BIN)
    contrast = (profile[..., :ends].mean(axis=2) - profile[..., -ends:].mean(axis=2)).sum(axis=0)
    lit = (most > 0) & (most >= _BRIGHT * np.percentile(most, 90)) & (contrast > _DISC * most)
    fall, normal, most = fall[lit], normal[lit], most[lit]
    # The steep edge next to the scene's limb: air may have one above, clouds within.
    around = np.pad(fall, ((0, 0), (1, 1)), constant_values=np.inf)
    peak = (fall >= around[:, :-2]) & (fall > around[:, 2:]) & (fall > _STEEP * most[:, None])
    far = np.where(peak, np.abs(mid * _BIN - _WITHIN), np.inf)
    last, found = far.argmin(axis=1), peak.any(axis=1)
    fall, normal, last = fall[found], normal[found], last[found]
    rows = np.arange(len(fall))
    inner, top, outer = (fall[rows, (last + k).clip(0, fall.shape[1] - 1)] for k in (-1, 0, 1))
    bend = inner - 2 * top + outer
    shift = np.where(bend < 0, 0.5 * (inner - outer) / np.where(bend < 0, bend, 1), 0.0)
    offset = (mid[last] + shift.clip(-1, 1)) * _BIN - _WITHIN
    near = np.abs(offset) < FOUND_PX
    return offset[near], normal[near]


def _profiles(
    foot: Int[np.ndarray, "n 2"],
    away: Float[np.ndarray, " n"],
    normal: Float[np.ndarray, "n 2"],
    shown: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "3 blocks bins"], Float[np.ndarray, "blocks 2"]]:
    """Mean light at each distance from the outline, and the normal, of blocks that have all."""
    bins = round(2 * _WITHIN / _BIN)
    _, block = np.unique(foot, axis=0, return_inverse=True)
    block = block.ravel()
    count = int(block.max()) + 1
    cell = block * bins + np.floor((away + _WITHIN) / _BIN).astype(int).clip(0, bins - 1)
    members = np.bincount(cell, minlength=count * bins).reshape(count, bins)
    total = np.stack([np.bincount(cell, shown[:, k], count * bins) for k in range(3)])
    light = total.reshape(3, count, bins) / np.maximum(members, 1)
    sums = np.stack([np.bincount(block, normal[:, k], count) for k in range(2)], axis=-1)
    mean = sums / np.maximum(np.linalg.norm(sums, axis=1, keepdims=True), 1e-30)
    full = (members > 0).all(axis=1)
    return light[:, full], mean[full]
