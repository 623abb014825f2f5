"""A planet's limb fitted to the light beside it, without air or with: least squares.

    light, limb, columns of air ──> edge, sky, light per column, what is left over

NumPy and SciPy.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from ._edge import BLUR, PARAMETERS, disc_light, disc_slopes, within
from ._effective import Part
from ._limb import Light, Limb

_STEPS = 60
_GAIN = 1e-6
"""Most steps of a search, and the gain at which it ends: a ten-thousandth of `EVIDENCE` in a
thousand independent samples."""
_ROUGH = 1e-4
"""The same where heights are compared that are told apart by per cents."""
_SEARCHED = (10_000, 50_000)
"""Pixels by the limb that a rough and a fine search look at, evenly chosen; the square sum of the
end point is that of all."""


@dataclass(frozen=True)
class LimbModel:
    """A bare limb, or a bare limb and a shell, at its best."""

    square_sum: float
    """Residual squares over all used samples, linear light²."""
    parameters: int
    edge: Float[np.ndarray, "8"]
    """Where the edge is, how much blurred, how it is lit, by the places in `_edge`."""
    level: tuple[float, float, float]
    """Light of the sky."""
    widths: Float[np.ndarray, "columns 3"]
    """Light per width of each given column; no rows for the bare limb."""
    height_px: float | None = None
    """Scale height of the air; None of the bare limb, and of air of one density."""

    @property
    def blur_px(self) -> float:
        """Standard deviation of the camera's blur, within `BLUR_PX`."""
        return float(np.exp(self.edge[BLUR]))


def starts() -> list[Float[np.ndarray, "8"]]:
    """Edges from which a search may begin."""
    return [
        np.array([np.log(blur), outward, 0, 0, 0, 0, 0, 0])
        for blur in (0.5, 1, 2, 4)
        for outward in (-1.0, 0.0, 1.0)
    ]


@dataclass(frozen=True)
class _Sums:
    """What least squares need of all used pixels, about their means."""

    count: int
    mean: Float[np.ndarray, "3"]
    width_mean: Float[np.ndarray, " c"]
    square: Float[np.ndarray, "3"]
    width_light: Float[np.ndarray, "c 3"]
    gram: Float[np.ndarray, "c c"]


@dataclass(frozen=True)
class _Problem:
    """Light beside a limb, as a function of the edge; levels and light per width are solved for."""

    sums: _Sums
    limb: Limb
    light: Float[np.ndarray, "n 3"]
    widths: Float[np.ndarray, "n c"]
    """Both of the limb's pixels, less the means."""
    share: float = 1.0
    """Pixels that each of these stands for."""

    def solve(
        self, p: Float[np.ndarray, "8"]
    ) -> tuple[float, Float[np.ndarray, "c 3"], Float[np.ndarray, "3"]]:
        """Square sum, light per width, level."""
        sums, disc = self.sums, disc_light(self.limb, p)
        seen = self.share * disc.sum(axis=0)
        square = sums.square + self.share * (disc * (disc - 2 * self.light)).sum(axis=0)
        square -= seen**2 / sums.count
        width_light = sums.width_light - self.share * (self.widths.T @ disc)
        amounts, gain = _air(sums.gram, width_light)
        level = sums.mean - seen / sums.count - sums.width_mean @ amounts
        return max(float(square.sum()) - gain, 0.0), amounts, level

    def derivative(
        self, p: Float[np.ndarray, "8"]
    ) -> tuple[Float[np.ndarray, "8"], Float[np.ndarray, "8 8"]]:
        """Half the square sum's gradient, and Gauss and Newton's half Hessian (Kaufman 1975, BIT
        15, 49: less what level and amounts take up)."""
        sums, (_, amounts, level) = self.sums, self.solve(p)
        sky = level - sums.mean + sums.width_mean @ amounts
        left = self.light - disc_light(self.limb, p) - sky - self.widths @ amounts
        gradient, hessian = np.zeros(len(p)), np.zeros((len(p), len(p)))
        for k, slope in enumerate(disc_slopes(self.limb, p)):
            gradient -= self.share * slope.T @ left[:, k]
            seen = self.share * slope.sum(axis=0)
            hessian += self.share * slope.T @ slope - np.outer(seen, seen) / sums.count
            length = amounts[:, k] @ sums.gram @ amounts[:, k]
            if length > 0:
                along = self.share * slope.T @ (self.widths @ amounts[:, k])
                hessian -= np.outer(along, along) / length
        return gradient, hessian

    def of_few(self, most: int) -> "_Problem":
        """The same with evenly chosen pixels of the limb in place of all."""
        every = -(-len(self.light) // most)
        if every <= 1:
            return self
        limb = Limb(**{name: values[::every] for name, values in vars(self.limb).items()})
        light, widths, sums = self.light[::every], self.widths[::every], self.sums
        share = len(self.light) / len(light)
        # Means and products with the chosen in place of all; a mixture of both would be no sum of
        # squares.
        mean = (share * light.sum(axis=0) - self.light.sum(axis=0)) / sums.count
        width_mean = (share * widths.sum(axis=0) - self.widths.sum(axis=0)) / sums.count
        square = share * (light**2).sum(axis=0) - (self.light**2).sum(axis=0)
        products = share * widths.T @ light - self.widths.T @ self.light
        gram = share * widths.T @ widths - self.widths.T @ self.widths
        few = _Sums(
            sums.count,
            sums.mean + mean,
            sums.width_mean + width_mean,
            sums.square + square - sums.count * mean**2,
            sums.width_light + products - sums.count * np.outer(width_mean, mean),
            sums.gram + gram - sums.count * np.outer(width_mean, width_mean),
        )
        return _Problem(few, limb, light - mean, widths - width_mean, share)


def best_limb(
    light: Light,
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    limb: Limb,
    begin: Sequence[Float[np.ndarray, "8"]],
    height: float | None = None,
    rough: bool = False,
) -> LimbModel:
    """Least squares: from the best of the starts a descent by the edge.

    A rough one looks at few pixels of the limb, and ends where a step gains less than a hundredth
    of a per cent.
    """
    sums = _add_up(light, used, widths)
    at_limb = light[np.divmod(limb.index, used.shape[1])].astype(np.float64) - sums.mean
    columns = [np.asarray(width).reshape(-1)[limb.index].astype(np.float64) for width in widths]
    width_limb = np.stack(columns, axis=-1) if columns else np.zeros((len(limb.index), 0))
    whole = _Problem(sums, limb, at_limb, width_limb - sums.width_mean)
    edge = np.zeros(PARAMETERS)
    if len(limb.index) and limb.disc.any():
        few = whole.of_few(_SEARCHED[0 if rough else 1])
        best = min(begin, key=lambda p: few.solve(p)[0])
        edge = _descend(few.solve, few.derivative, best, _ROUGH if rough else _GAIN)
    square_sum, amounts, level = whole.solve(edge)
    return LimbModel(
        square_sum=square_sum,
        # The edge's, three levels; the air's three colours, their share if unlit, its height.
        parameters=PARAMETERS
        + 3
        + 3 * bool(widths)
        + max(len(widths) - 1, 0)
        + (height is not None),
        edge=edge,
        level=(float(level[0]), float(level[1]), float(level[2])),
        widths=amounts,
        height_px=height,
    )


def _descend(
    solve: Callable[[np.ndarray], tuple[float, Any, Any]],
    derivative: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    place: np.ndarray,
    least_gain: float,
) -> np.ndarray:
    """Levenberg & Marquardt (1963, J. SIAM 11, 431), steps cut to what is allowed; ends when a step
    gains less than the least of the square sum."""
    least, damping = solve(place)[0], 1e-3
    gradient, hessian = derivative(place)
    for _ in range(_STEPS):
        # What a step downhill would leave its range with stays.
        free = (within(place - 1e-6 * np.sign(gradient)) != place) | (gradient == 0)
        scale = np.sqrt(np.maximum(np.diag(hessian), 1e-30))
        matrix = hessian / np.outer(scale, scale) + damping * np.eye(len(place))
        step = np.zeros_like(place)
        step[free] = np.linalg.lstsq(
            matrix[np.ix_(free, free)], (gradient / scale)[free], rcond=None
        )[0]
        trial = within(place - step / scale)
        value = solve(trial)[0]
        if value < least:
            gain, place, least, damping = least - value, trial, value, damping / 10
            if gain < least_gain * value:
                break
            gradient, hessian = derivative(place)
        elif (damping := 10 * damping) > 1e6:
            break
    return place


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


def energy_of(light: Light, used: Bool[np.ndarray, "h w"]) -> float:
    return sum(float((light[r][used[r]].astype(np.float64) ** 2).sum()) for r in _strips(used))


def residual_of(
    light: Light,
    width: int,
    widths: Sequence[Float[np.ndarray, "h w"]],
    limb: Limb,
    model: LimbModel,
) -> Callable[[Part], Float[np.ndarray, "h w 3"]]:
    """Photo less model, window by window."""
    disc = disc_light(limb, model.edge)
    row, col = np.divmod(limb.index, width)

    def residual(window: Part) -> Float[np.ndarray, "h w 3"]:
        part = light[window] - np.asarray(model.level)
        for column, amounts in zip(widths, model.widths, strict=True):
            part -= np.asarray(column)[window][..., None].astype(np.float64) * amounts
        y, x = row - window[0].start, col - window[1].start
        inside = (y >= 0) & (y < part.shape[0]) & (x >= 0) & (x < part.shape[1])
        part[y[inside], x[inside]] -= disc[inside]
        return part

    return residual
