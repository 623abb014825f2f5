"""Is there air at all? A planet without air, blurred by the camera, as the rival of the shell.

    light, planet, used ──> bare limb ─────────┐
                     widths ──> bare + shell ──┴──> ΔBIC at the effective sample size

A camera spreads the disc's light over its edge, and a scene is aligned to a photo to a pixel or
so: both put light where air would be. The bare limb is the photo's own disc, continued outward and
ended by a blurred edge. Blur neither makes light nor colours it, so the disc's light comes in with
the factor 1 and in its own colour; only the edge's place and width are free. The shell is tested on
top of it: a planet with air is seen by the same camera, so its limb leaks into the ring too.

NumPy and SciPy; knows nothing of looks and solvers.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import ndtr

from ._effective import Part, effective_samples
from ._limb import Light, Limb, Place, glows, limb_of

EVIDENCE = 10.0
"""Least ΔBIC that tells air: "very strong", odds of 150 to 1 (Kass & Raftery 1995, J. Am. Stat.
Assoc. 90, 773, §3.2 and 4.1.3)."""

NO_BARE_LIMB = 0.999
"""Share of the light's variance that no shell explains of a bare limb. A straight edge blurred by a
Gaussian, a shell's width that falls as the root of the distance from its top, and a sky level agree
to 0.9980 at most, whatever blur, place, height and lit share of the limb (0.9955 if all is lit)."""

MAX_SHIFT_PX = 3.0
"""How far the edge may lie from the mask's: two pixels of the scene, one of its own relief."""
BLUR_PX = (0.25, 4.0)
"""Standard deviations of the camera's blur: below a quarter of a pixel the pixel itself is wider;
above 4 px the disc would show no detail."""

HALO_PX = 8.0
MAX_HALO = 0.1
"""Halo of lens and film: a share of the light, spread much farther than the blur. More than a tenth
next to the disc would be a fault of the camera."""

_STEPS = 60
_GAIN = 1e-6
"""Most steps of a search, and the gain at which it ends: a ten-thousandth of `EVIDENCE` in a
thousand independent samples."""
_SEARCHED = (10_000, 50_000)
"""Pixels by the limb that the coarse and the fine search look at, evenly chosen; the square sum of
the end point is that of all."""


@dataclass(frozen=True)
class LimbModel:
    """A bare limb, or a bare limb and a shell, at its best."""

    square_sum: float
    """Residual squares over all used samples, linear light²."""
    parameters: int
    blur_px: float
    """Standard deviation of the camera's blur, within `BLUR_PX`."""
    shift_px: tuple[float, float, float]
    """How far the photo's edge lies from the mask's: outward, to the right, downward."""
    halo: float
    """Share of the disc's light that is spread by `HALO_PX`, within [0, `MAX_HALO`]."""
    level: tuple[float, float, float]
    """Light of the sky."""
    widths: Float[np.ndarray, "columns 3"]
    """Light per width of each given column; no rows for the bare limb."""


@dataclass(frozen=True)
class AirEvidence:
    """The comparison of the two."""

    bare: LimbModel
    shell: LimbModel
    samples_effective: float
    delta_bic: float
    """BIC(bare) − BIC(shell); above `EVIDENCE` there is air."""
    glows: bool
    """The bare limb needs a sky that is brighter beside it than beyond: a ring of even light."""

    @property
    def has_air(self) -> bool:
        return self.delta_bic > EVIDENCE or self.glows


def find_air(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    place: Place = (0.0, 0.0, 0.0),
    sky: Bool[np.ndarray, "h w"] | None = None,
) -> AirEvidence:
    """Does a shell of air explain what a bare limb, blurred by the camera, does not?

    Args:
        light: linear light; not finite where it is unknown, but finite in the used pixels.
        planet: where the planet ends the ray; may be empty.
        used: pixels to explain; those on the planet are left out.
        widths: of air, lit and shadowed (either may be missing), any unit, finite where used.
        place: of the photo's limb beside the planet's edge, as `limb_beside` finds it.
        sky: pixels beyond the air, if there are any.
    """
    used = used & ~planet
    widths = [width for width in widths if np.any(width[used])]
    if not used.any():
        nothing = LimbModel(
            0.0, 8, BLUR_PX[0], (0.0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0), np.zeros((0, 3))
        )
        return AirEvidence(nothing, nothing, 1.0, 0.0, glows=False)
    limb = limb_of(light, planet, used, place)
    bare = _best(light, used, (), limb)
    shell = _best(light, used, widths, limb, bare)
    samples = effective_samples(_residual(light, used.shape[1], widths, limb, shell), used, True)
    floor = float(np.finfo(np.float32).eps) ** 2 * _energy(light, used)
    evidence = air_evidence(bare, shell, samples, floor)
    return AirEvidence(bare, shell, samples, evidence, glows(light, limb, bare.level, sky))


def bare_limb(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
) -> LimbModel:
    """The best explanation of the used pixels by a planet without air; arguments as `find_air`."""
    used = used & ~planet
    return _best(light, used, (), limb_of(light, planet, used))


def air_evidence(bare: LimbModel, shell: LimbModel, samples: float, floor: float = 0.0) -> float:
    """BIC(bare) − BIC(shell), BIC = samples · log(square sum) + parameters · log(samples).

    Schwarz 1978, Ann. Stat. 6, 461, for errors of equal unknown variance. Square sums below `floor`
    count as `floor`: the rounding of the photo tells nothing.
    """
    tiny = np.finfo(np.float64).tiny
    ratio = max(bare.square_sum, floor, tiny) / max(shell.square_sum, floor, tiny)
    more = shell.parameters - bare.parameters
    return float(samples * np.log(ratio) - more * np.log(samples))


@dataclass(frozen=True)
class _Sums:
    """What least squares need of all used pixels, about their means."""

    count: int
    mean: Float[np.ndarray, "3"]
    width_mean: Float[np.ndarray, " c"]
    square: Float[np.ndarray, "3"]
    width_light: Float[np.ndarray, "c 3"]
    gram: Float[np.ndarray, "c c"]


def _best(
    light: Light,
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    limb: Limb,
    start: LimbModel | None = None,
) -> LimbModel:
    """Least squares: a scan of blur and radius, then descents in blur, place and halo.

    Levels and light per width are solved for at each step.
    """
    sums = _add_up(light, used, widths)
    at_limb = light[np.divmod(limb.index, used.shape[1])].astype(np.float64) - sums.mean
    columns = [np.asarray(width).reshape(-1)[limb.index].astype(np.float64) for width in widths]
    width_limb = np.stack(columns, axis=-1) if columns else np.zeros((len(limb.index), 0))
    width_limb = width_limb - sums.width_mean

    def solve(
        p: np.ndarray, every: int = 1
    ) -> tuple[float, Float[np.ndarray, "c 3"], Float[np.ndarray, "3"]]:
        part = slice(None, None, every)
        disc = limb.disc[part] * _edge(limb, p, part)[:, None]
        share = len(limb.index) / max(len(disc), 1)
        seen = disc.sum(axis=0) * share
        square = sums.square + share * (disc * (disc - 2 * at_limb[part])).sum(axis=0)
        square -= seen**2 / sums.count
        width_light = sums.width_light - share * (width_limb[part].T @ disc)
        amounts, gain = _air(sums.gram, width_light)
        level = sums.mean - seen / sums.count - sums.width_mean @ amounts
        return max(float(square.sum()) - gain, 0.0), amounts, level

    def derivative(p: np.ndarray, every: int) -> tuple[np.ndarray, np.ndarray]:
        """Half the square sum's gradient, and Gauss and Newton's half Hessian (Kaufman 1975, BIT
        15, 49: less what level and amounts take up)."""
        part = slice(None, None, every)
        _, amounts, level = solve(p, every)
        slope = _edge_slope(limb, p, part)
        disc = limb.disc[part]
        share = len(limb.index) / max(len(disc), 1)
        model = disc * _edge(limb, p, part)[:, None] + (level - sums.mean)
        left = at_limb[part] - model - (width_limb[part] + sums.width_mean) @ amounts
        gradient = -share * slope.T @ (disc * left).sum(axis=1)
        hessian = share * slope.T @ (slope * (disc**2).sum(axis=1)[:, None])
        seen = share * slope.T @ disc
        hessian -= seen @ seen.T / sums.count
        for k in range(3):
            length = amounts[:, k] @ sums.gram @ amounts[:, k]
            if length > 0:
                along = share * slope.T @ (disc[:, k] * (width_limb[part] @ amounts[:, k]))
                hessian -= np.outer(along, along) / length
        return gradient, hessian

    place = np.zeros(5)
    if len(limb.index) and limb.disc.any():
        few, most = (-(-len(limb.index) // count) for count in _SEARCHED)
        starts = [np.array([np.log(s), r, 0, 0, 0]) for s in (0.5, 1, 2, 4) for r in (-1.0, 0, 1.0)]
        if start is not None:
            starts.append(np.array([np.log(start.blur_px), *start.shift_px, start.halo]))
        place = min(starts, key=lambda p: solve(p, few)[0])
        for every in (few, most):
            if start is not None and solve(starts[-1], every)[0] < solve(place, every)[0]:
                place = starts[-1]
            place = _descend(partial(solve, every=every), partial(derivative, every=every), place)
    square_sum, amounts, level = solve(place)
    return LimbModel(
        square_sum=square_sum,
        # Blur, halo, three of place, three levels; the air's three colours, their share if unlit.
        parameters=8 + (3 * bool(widths)) + max(len(widths) - 1, 0),
        blur_px=float(np.exp(place[0])),
        shift_px=(float(place[1]), float(place[2]), float(place[3])),
        halo=float(place[4]),
        level=(float(level[0]), float(level[1]), float(level[2])),
        widths=amounts,
    )


def _edge(
    limb: Limb, p: np.ndarray, part: slice | Bool[np.ndarray, " _"]
) -> Float[np.ndarray, " _"]:
    """Share of the disc's light beyond a blurred edge; p: log blur, outward, right, down, halo."""
    beyond = limb.distance[part] - p[1] - limb.normal[part] @ p[2:4]
    return (1 - p[4]) * ndtr(-beyond * np.exp(-p[0])) + p[4] * ndtr(-beyond / HALO_PX)


def _edge_slope(limb: Limb, p: np.ndarray, part: slice) -> Float[np.ndarray, "n 5"]:
    """Derivative of `_edge` by p."""
    normal = limb.normal[part]
    beyond = limb.distance[part] - p[1] - normal @ p[2:4]
    sharp, wide = beyond * np.exp(-p[0]), beyond / HALO_PX
    dense = (1 - p[4]) * np.exp(-0.5 * sharp**2) / np.sqrt(2 * np.pi)
    halo = p[4] * np.exp(-0.5 * wide**2) / np.sqrt(2 * np.pi)
    outward = dense * np.exp(-p[0]) + halo / HALO_PX
    return np.stack(
        [
            dense * sharp,
            outward,
            outward * normal[:, 0],
            outward * normal[:, 1],
            ndtr(-wide) - ndtr(-sharp),
        ],
        axis=-1,
    )


def _descend(
    solve: Callable[[np.ndarray], tuple[float, Any, Any]],
    derivative: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    place: np.ndarray,
) -> np.ndarray:
    """Levenberg & Marquardt (1963, J. SIAM 11, 431), steps cut to what is allowed; ends when a step
    gains less than `_GAIN` of the square sum."""
    least, damping = solve(place)[0], 1e-3
    gradient, hessian = derivative(place)
    for _ in range(_STEPS):
        # What a step downhill would leave its range with stays.
        free = (_within(place - 1e-6 * np.sign(gradient)) != place) | (gradient == 0)
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
        matrix = hessian / np.outer(scale, scale) + damping * np.eye(len(place))
        step = np.zeros_like(place)
        step[free] = np.linalg.lstsq(
            matrix[np.ix_(free, free)], (gradient / scale)[free], rcond=None
        )[0]
        trial = _within(place - step / scale)
        value = solve(trial)[0]
        if value < least:
            gain, place, least, damping = least - value, trial, value, damping / 10
            if gain < _GAIN * value:
                break
            gradient, hessian = derivative(place)
        elif (damping := 10 * damping) > 1e6:
            break
    return place


def _within(p: np.ndarray) -> np.ndarray:
    """The nearest allowed blur and place."""
    blur = np.clip(p[:1], *np.log(BLUR_PX))
    farthest = abs(p[1]) + np.hypot(p[2], p[3])
    place = p[1:4] * min(1.0, MAX_SHIFT_PX / max(farthest, 1e-30))
    return np.concatenate([blur, place, np.clip(p[4:], 0, MAX_HALO)])


_SHADOWS = np.append(0.0, np.geomspace(1 / 64, 16, 41))
"""Shadow weights that are tried: the evidence does not ask for them to better than a fifth."""


def _air(
    gram: Float[np.ndarray, "c c"], target: Float[np.ndarray, "c 3"]
) -> tuple[Float[np.ndarray, "c 3"], float]:
    """Light per width, and by how much it lowers the square sum.

    As in `model_jax.combine`: a colour times (lit + one weight · shadowed), not negative.
    """
    amounts = np.zeros(target.shape)
    if not len(target):
        return amounts, 0.0
    mixes = np.ones((1, 1)) if len(target) == 1 else np.stack([_SHADOWS**0, _SHADOWS], axis=-1)
    lengths = np.einsum("mi,ij,mj->m", mixes, gram, mixes)
    colors = np.maximum(mixes @ target, 0) / np.maximum(lengths, 1e-300)[:, None]
    gains = (colors**2).sum(axis=1) * lengths
    best = int(np.argmax(gains))
    return mixes[best][:, None] * colors[best], float(gains[best])


def _strips(used: Bool[np.ndarray, "h w"]) -> Iterator[slice]:
    """Rows in pieces of a quarter of a million pixels, so that copies stay small."""
    rows = max(1, 2**18 // max(used.shape[1], 1))
    for start in range(0, used.shape[0], rows):
        yield slice(start, start + rows)


def _columns(
    light: Light,
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    rows: slice,
) -> Float[np.ndarray, "n columns"]:
    here = used[rows]
    return np.column_stack(
        [light[rows][here].astype(np.float64)] + [np.asarray(w)[rows][here] for w in widths]
    )


def _add_up(
    light: Light,
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
) -> _Sums:
    count = int(used.sum())
    mean = np.zeros(3 + len(widths))
    for rows in _strips(used):
        mean += _columns(light, used, widths, rows).sum(axis=0)
    mean /= max(count, 1)
    square = np.zeros((len(mean), len(mean)))
    for rows in _strips(used):
        part = _columns(light, used, widths, rows) - mean
        square += part.T @ part
    return _Sums(
        count, mean[:3], mean[3:], np.diag(square)[:3].copy(), square[3:, :3], square[3:, 3:]
    )


def _energy(light: Light, used: Bool[np.ndarray, "h w"]) -> float:
    return sum(float((light[r][used[r]].astype(np.float64) ** 2).sum()) for r in _strips(used))


def _residual(
    light: Light,
    width: int,
    widths: Sequence[Float[np.ndarray, "h w"]],
    limb: Limb,
    model: LimbModel,
) -> Callable[[Part], Float[np.ndarray, "h w 3"]]:
    """Photo less model, window by window."""
    p = np.array([np.log(model.blur_px), *model.shift_px, model.halo])
    row, col = np.divmod(limb.index, width)

    def residual(window: Part) -> Float[np.ndarray, "h w 3"]:
        part = light[window] - np.asarray(model.level)
        for column, amounts in zip(widths, model.widths, strict=True):
            part -= np.asarray(column)[window][..., None].astype(np.float64) * amounts
        y, x = row - window[0].start, col - window[1].start
        inside = (y >= 0) & (y < part.shape[0]) & (x >= 0) & (x < part.shape[1])
        disc = limb.disc[inside] * _edge(limb, p, inside)[:, None]
        part[y[inside], x[inside]] -= disc
        return part

    return residual
