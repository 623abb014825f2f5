"""A planet's limb fitted to the light beside it, without air or with: least squares.

    light, limb, columns of air ──> edge, sky, light per column, what is left over

NumPy and SciPy.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

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
class Beside:
    """Light beside a limb, and what least squares need of that of all used pixels."""

    count: int
    mean: Float[np.ndarray, "3"]
    square: Float[np.ndarray, "3"]
    """About the mean."""
    limb: Limb
    light: Float[np.ndarray, "n 3"]
    """Of the limb's pixels, less the mean."""
    every: int = 1
    """Of so many pixels by the limb one stands for all."""
    share: float = 1.0
    """Pixels that each of these stands for."""

    @property
    def energy(self) -> float:
        """Square sum of the used pixels' light."""
        return float((self.square + self.count * self.mean**2).sum())

    @cached_property
    def rough(self) -> "Beside":
        return self._of_few(_SEARCHED[0])

    @cached_property
    def fine(self) -> "Beside":
        return self._of_few(_SEARCHED[1])

    @cached_property
    def first_discs(self) -> list[Float[np.ndarray, "n 3"]]:
        """The disc's light by each of the `starts`."""
        return [disc_light(self.limb, p) for p in starts()]

    def _of_few(self, most: int) -> "Beside":
        """The same with evenly chosen pixels of the limb in place of all."""
        every = -(-len(self.light) // most)
        if every <= 1:
            return self
        few = (np.asfortranarray(values[::every]) for values in vars(self.limb).values())
        light = np.asfortranarray(self.light[::every])
        share = len(self.light) / len(light)
        # Means and products with the chosen in place of all; a mixture of both would be no sum of
        # squares.
        mean = (share * light.sum(axis=0) - self.light.sum(axis=0)) / self.count
        square = share * (light**2).sum(axis=0) - (self.light**2).sum(axis=0)
        square += self.square - self.count * mean**2
        return Beside(self.count, self.mean + mean, square, Limb(*few), light - mean, every, share)


def light_beside(light: Light, used: Bool[np.ndarray, "h w"], limb: Limb) -> Beside:
    """What fits of a limb need of the used pixels' light, added up once."""
    count = max(int(used.sum()), 1)
    mean = sum(
        (light[r][used[r]].sum(axis=0, dtype=np.float64) for r in _strips(used)), np.zeros(3)
    )
    mean /= count
    square = np.zeros(3)
    for rows in _strips(used):
        square += ((light[rows][used[rows]].astype(np.float64) - mean) ** 2).sum(axis=0)
    at_limb = light[np.divmod(limb.index, used.shape[1])].astype(np.float64) - mean
    return Beside(count, mean, square, limb, np.asfortranarray(at_limb))


@dataclass(frozen=True)
class Air:
    """Columns of air, and what least squares need of them in all used pixels."""

    mean: Float[np.ndarray, " c"]
    light: Float[np.ndarray, "c 3"]
    """Products with the light, both about their means."""
    gram: Float[np.ndarray, "c c"]
    """Products with each other, likewise."""
    at_limb: Float[np.ndarray, "n c"]
    """The limb's pixels, less the means."""

    def of_few(self, whole: Beside, few: Beside) -> "Air":
        """The same with the few pixels of the limb in place of all."""
        if few is whole:
            return self
        at_limb, shift = np.asfortranarray(self.at_limb[:: few.every]), few.mean - whole.mean
        mean = (few.share * at_limb.sum(axis=0) - self.at_limb.sum(axis=0)) / whole.count
        products = few.share * at_limb.T @ (few.light + shift) - self.at_limb.T @ whole.light
        gram = few.share * at_limb.T @ at_limb - self.at_limb.T @ self.at_limb
        return Air(
            self.mean + mean,
            self.light + products - whole.count * np.outer(mean, shift),
            self.gram + gram - whole.count * np.outer(mean, mean),
            at_limb - mean,
        )


def no_air(beside: Beside) -> Air:
    return Air(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros((len(beside.light), 0)))


def air_of(
    light: Light,
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    beside: Beside,
) -> Air:
    """Air of columns as large as the photo."""
    mean = np.array([np.sum(width, where=used, dtype=np.float64) for width in widths])
    mean /= beside.count
    products, gram = np.zeros((len(widths), 3)), np.zeros((len(widths), len(widths)))
    for rows in _strips(used):
        here = used[rows]
        part = np.stack([width[rows][here] for width in widths], axis=-1) - mean
        products += part.T @ (light[rows][here].astype(np.float64) - beside.mean)
        gram += part.T @ part
    at_limb = [np.ravel(width)[beside.limb.index] for width in widths]
    return Air(mean, products, gram, np.stack(at_limb).T - mean)


def air_at(
    columns: Float[np.ndarray, "m c"],
    light: Float[np.ndarray, "m 3"],
    at_limb: Int[np.ndarray, " n"],
    beside: Beside,
) -> Air:
    """Air of some used pixels, the others have none.

    Args:
        light: of these pixels, less the mean of all.
        at_limb: which of these each of the limb's is; -1 where it is none.
    """
    mean = columns.sum(axis=0) / beside.count
    centred = columns - mean
    gram = centred.T @ centred + (beside.count - len(columns)) * np.outer(mean, mean)
    by_limb = np.zeros((len(at_limb), len(mean)), order="F")
    by_limb[at_limb >= 0] = columns[at_limb[at_limb >= 0]]
    return Air(mean, columns.T @ light, gram, by_limb - mean)


@dataclass(frozen=True)
class _Problem:
    """Light beside a limb, as a function of the edge; levels and light per width are solved for."""

    beside: Beside
    air: Air

    def solve(
        self, p: Float[np.ndarray, "8"]
    ) -> tuple[float, Float[np.ndarray, "c 3"], Float[np.ndarray, "3"]]:
        """Square sum, light per width, level."""
        return self.solve_with(disc_light(self.beside.limb, p))

    def solve_with(
        self, disc: Float[np.ndarray, "n 3"]
    ) -> tuple[float, Float[np.ndarray, "c 3"], Float[np.ndarray, "3"]]:
        beside, air = self.beside, self.air
        seen = beside.share * disc.sum(axis=0)
        square = beside.square + beside.share * (disc * (disc - 2 * beside.light)).sum(axis=0)
        square -= seen**2 / beside.count
        amounts, gain = _air(air.gram, air.light - beside.share * (air.at_limb.T @ disc))
        level = beside.mean - seen / beside.count - air.mean @ amounts
        return max(float(square.sum()) - gain, 0.0), amounts, level

    def derivative(
        self, p: Float[np.ndarray, "8"]
    ) -> tuple[Float[np.ndarray, "8"], Float[np.ndarray, "8 8"]]:
        """Half the square sum's gradient, and Gauss and Newton's half Hessian (Kaufman 1975, BIT
        15, 49: less what level and amounts take up)."""
        beside, air = self.beside, self.air
        disc, slopes = disc_slopes(beside.limb, p)
        _, amounts, level = self.solve_with(disc)
        shell = (amounts.T @ air.at_limb.T).T  # column after column, as the rest
        left = beside.light - disc - (level - beside.mean + air.mean @ amounts) - shell
        gradient, hessian = np.zeros(len(p)), np.zeros((len(p), len(p)))
        for k, slope in enumerate(slopes):
            gradient -= beside.share * slope.T @ left[:, k]
            seen = beside.share * slope.sum(axis=0)
            hessian += beside.share * (slope.T @ slope) - np.outer(seen, seen) / beside.count
            length = amounts[:, k] @ air.gram @ amounts[:, k]
            if length > 0:
                along = beside.share * slope.T @ shell[:, k]
                hessian -= np.outer(along, along) / length
        return gradient, hessian


def best_limb(
    beside: Beside,
    air: Air,
    begin: Sequence[Float[np.ndarray, "8"]] = (),
    height: float | None = None,
    rough: bool = False,
    anew: bool = False,
) -> LimbModel:
    """Least squares: from the best of the edges to begin with a descent by the edge.

    Anew, it may begin with each of the `starts` as well. A rough one looks at few pixels of the
    limb, and ends where a step gains less than a hundredth of a per cent.
    """
    problem = _Problem(beside, air)
    edge = np.zeros(PARAMETERS)
    if len(beside.limb.index) and beside.limb.disc.any():
        few = beside.rough if rough else beside.fine
        search = _Problem(few, air.of_few(beside, few))
        found = [(search.solve(p)[0], p) for p in begin]
        if anew:
            discs = zip(few.first_discs, starts(), strict=True)
            found += [(search.solve_with(disc)[0], p) for disc, p in discs]
        best = min(found, key=lambda one: one[0])[1]
        edge = _descend(search.solve, search.derivative, best, _ROUGH if rough else _GAIN)
    square_sum, amounts, level = problem.solve(edge)
    columns = len(air.mean)
    return LimbModel(
        square_sum=square_sum,
        # The edge's, three levels; the air's three colours, their share if unlit, its height.
        parameters=PARAMETERS + 3 + 3 * bool(columns) + max(columns - 1, 0) + (height is not None),
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
