"""How far the values can be trusted: covariance, degrees of freedom, intervals.

Real residuals are correlated: a blurred sensor, a JPEG's blocks, a look that does not quite fit. So
the covariance is the sandwich of M-estimation, `H⁻¹ M H⁻¹`, whose middle is made of the scores
summed over square blocks of the photo, larger than the residuals' correlation length; within a
block they may be correlated in any way, and they may be of any size (White, Econometrica 48, 1980;
Conley, "GMM estimation with cross sectional dependence", J. Econometrics 92, 1999). What blocks cut
off at their borders is put back by the share that the measured autocorrelation gives it.

A small photo has few blocks, and a parameter may hang on a few of those: the fit has bent toward
their noise, so that their residuals are too small. Each block's score is therefore stretched by
`(1 - leverage)^-½`, which makes the sandwich exact on average for independent noise, and intervals
are as many standard errors wide as Student's t has at the sandwich's own degrees of freedom (Bell
and McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples",
Survey Methodology 28, 2002; CR2 in Cameron and Miller, J. Human Resources 50, 2015). Leverages are
by the slopes alone: second derivatives times noise are noise.

H is the full second derivative, of the loss and of the model, as far as slopes bear it out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray

from .._compile import float64, program
from ..photo._blocks import block_numbers
from ..solve._loss import weigh
from ..solve._model import Model, predict, tile_slopes
from ..solve._problem import Point
from ..solve._samples import Samples, tile_at
from ..solve._scaled import unit_diagonal
from ._autocorrelation import LAGS, correlation
from ._residuals import tile_groups

LEAST_BLOCK = 8
"""Pixels across a block at least, and its unit: JPEG's own blocks are 8 or 16 pixels."""
LENGTHS = 2
"""Correlation lengths across a block. Correlations that fall off linearly over a length lose
1 - (1 - 1/6)² = 31 % at its borders, which is put back; larger blocks lose less, but are fewer."""
FEWEST_BLOCKS = 20
"""With fewer, blocks are made smaller, down to the correlation length: a standard error from n
blocks is itself uncertain by 1 / sqrt(2n), 16 % at 20."""
MOST_LEVERAGE = 0.95
"""A block's highest: where a parameter hangs on one block alone its noise cannot be seen, and the
stretch stops at 4.5 instead of at infinity; what is missing then is that of all (`_unseen`)."""
MOST_CURVED = 1.5
"""The second derivative at most, as a share of the squares of slopes, which it is where the model
is linear. The rest is second derivatives times what is left over: along a valley in which slopes
tell nearly nothing that is noise, and would pass for knowledge."""
NORMAL_95 = 1.959963984540054
"""Standard errors to either side of a 95 % interval of a normal distribution."""


@dataclass(frozen=True)
class Spread:
    """Covariance along the free directions and what it rests on."""

    covariance: Float[np.ndarray, "p p"]
    hessian: Float[np.ndarray, "p p"]
    """Half the second derivative of the square sum."""
    correlation_px: float
    """Length over which residuals are correlated; 1 where neighbours are independent."""
    block_px: int
    blocks: int
    area: float
    """Pixels that count as one: the integral of the residuals' autocorrelation, ≥ 1."""
    root: Float[np.ndarray, "p p"]
    """H⁻¹ R⁻ᵀ, which is R where the model is linear: R Rᵀ = F⁻¹, F the squares of the slopes."""
    leverage: Float[np.ndarray, "blocks p p"]
    """Rᵀ S R of each block, S its part of F: shares in what is known, which add up to 1."""

    def freedom(self, to_identified: Float[np.ndarray, "t p"]) -> Float[np.ndarray, " t"]:
        """Degrees of freedom of each identified parameter's variance, ≥ 1.

        The variance is a square sum of the blocks' stretched scores z. Were residuals independent
        and alike, these had the covariance P = diag(aᵀBa) - (Ba)(Ba)ᵀ with a = (1 - B)^-½ Aᵀ c, B a
        block's leverage, A the root and c the parameter's row; a χ² with the same mean and variance
        has (tr P)² / tr P² degrees of freedom (Satterthwaite, Biometrics Bulletin 2, 1946).
        """
        stretch = stretch_of(self.leverage)
        found = np.ones(len(to_identified))
        for k, row in enumerate(to_identified @ self.root):
            a = stretch @ row
            pulled = np.einsum("gij,gj->gi", self.leverage, a)
            own = (a * pulled).sum(axis=1)
            squares = (pulled**2).sum(axis=1)
            trace = own.sum() - squares.sum()
            square = (own**2).sum() - 2 * (own * squares).sum() + ((pulled.T @ pulled) ** 2).sum()
            if trace > 0 and square > 0:
                found[k] = max(trace**2 / square, 1.0)
        return found


def reach_95(freedom: Float[np.ndarray, " t"]) -> Float[np.ndarray, " t"]:
    """Standard errors to either side of a 95 % interval: Student's t quantile.

    By its expansion about the normal one (Abramowitz and Stegun 26.7.5), within 0.13 % from 3
    degrees of freedom on, 0.8 % low at 2; below 2, where hardly anything is known, 2 is taken.
    """
    x = NORMAL_95
    terms = (
        (x**3 + x) / 4,
        (5 * x**5 + 16 * x**3 + 3 * x) / 96,
        (3 * x**7 + 19 * x**5 + 17 * x**3 - 15 * x) / 384,
        (79 * x**9 + 776 * x**7 + 1482 * x**5 - 1920 * x**3 - 945 * x) / 92160,
    )
    inverse = 1 / np.maximum(freedom, 2.0)
    return np.asarray(x + sum(term * inverse ** (k + 1) for k, term in enumerate(terms)))


def spread_of(
    point: Point,
    sizes: Sequence[tuple[int, int]],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    noise: float,
    rounding: float,
) -> Spread:
    """The covariance at an end point.

    Args:
        sizes: height and width of each photo.
        residuals: of each photo, by `residuals_of`.
        noise: standard deviation of a sample, which priors are measured in.
        rounding: noise that there is at least, also where the model meets every sample: no value is
            known better than numbers are.
    """
    columns, prior_of = point.problem.columns, point.problem.model.prior
    p = point.directions.shape[1]
    length, area, products = correlation(columns, sizes, residuals)
    unit = LEAST_BLOCK
    side = unit * int(np.ceil(max(LENGTHS * length, unit) / unit)) if length > 1 else unit
    while True:
        numbers = [
            block_numbers(c.index, size, side) for c, size in zip(columns, sizes, strict=True)
        ]
        blocks = sum(int(n.max(initial=-1)) + 1 for n in numbers)
        if blocks >= max(FEWEST_BLOCKS, 3 * p) or side <= unit or side - unit < length:
            break
        side -= unit
    scores, squares, hessian = _block_sums(point, numbers)
    prior = np.zeros((p, p))
    if prior_of is not None:
        prior = prior_of.curvature(point.directions)
        hessian = hessian + prior
    whiten = inverse_root(squares.sum(axis=0) + prior)
    leverage = whiten.T @ squares @ whiten
    whitened = np.einsum("gij,gj->gi", stretch_of(leverage), scores @ whiten)
    middle = whitened.T @ whitened * _border_share(products, side)
    middle += noise**2 * (area * _unseen(leverage) + whiten.T @ prior @ whiten)
    middle += rounding**2 * leverage.sum(axis=0)
    middle += whiten.T @ _planet_noise(point) @ whiten
    root = whiten @ np.linalg.inv(_not_steeper(whiten.T @ hessian @ whiten))
    covariance = root @ middle @ root.T
    return Spread(covariance, hessian, length, side, blocks, area, root, leverage)


def _block_sums(
    point: Point, blocks: Sequence[np.ndarray]
) -> tuple[
    Float[np.ndarray, "blocks p"], Float[np.ndarray, "blocks p p"], Float[np.ndarray, "p p"]
]:
    """Sums over each block of scores and of squares of slopes, and half the second derivative of
    all, without priors."""
    vector, directions = point.vector, point.directions
    samples, model = point.problem.samples, point.problem.model
    p = directions.shape[1]
    pairs = np.tril_indices(p)
    counts = [int(numbers.max(initial=-1)) + 1 for numbers in blocks]
    sums = [np.zeros((n, p + len(pairs[0]))) for n in counts]
    starts = [0] * len(blocks)
    count, photo = np.asarray(samples.count), np.asarray(samples.photo)
    hessian = np.zeros((p, p))
    with float64():
        for filled, tiles in tile_groups(samples):
            found, second = map(np.asarray, _tile_scores(vector, directions, samples, model, tiles))
            hessian += second[:filled].sum(axis=0)
            for k in range(filled):
                n, which = count[tiles[k]], photo[tiles[k]]
                numbers = blocks[which][starts[which] : starts[which] + n]
                # Pixels come row by row: one sum for each run within a block.
                runs = np.append(0, np.flatnonzero(np.diff(numbers)) + 1)
                totals = np.add.reduceat(found[k, :, :n], runs, axis=1)
                np.add.at(sums[which], numbers[runs], totals.T)
                starts[which] += n
    total = np.concatenate(sums)
    squares = np.zeros((len(total), p, p))
    squares[:, pairs[0], pairs[1]] = total[:, p:]
    squares[:, pairs[1], pairs[0]] = total[:, p:]
    return total[:, :p], squares, hessian


@program
def _tile_scores(
    vector: AnyArray, directions: AnyArray, samples: Samples, model: Model, numbers: AnyArray
) -> tuple[jax.Array, jax.Array]:
    """p scores of each pixel, then the lower half of its slopes' products, [tiles, q, n]; and half
    the second derivative of each tile, [tiles, p, p]."""
    start, columns = jnp.asarray(vector), jnp.asarray(directions)
    pairs = np.tril_indices(columns.shape[1])

    def scores(number: jax.Array) -> tuple[jax.Array, jax.Array]:
        tile = tile_at(samples, number)

        def score_at(step: jax.Array) -> tuple[jax.Array, jax.Array]:
            predicted, slopes = tile_slopes(start + columns @ step, columns, tile, model)
            _, score, curved = weigh(predicted - tile.light, tile.clipped, model.loss)
            found = jnp.einsum("icn,cn->in", slopes, score * tile.weight[None])
            squares = jnp.einsum("icn,icn,cn->in", slopes[pairs[0]], slopes[pairs[1]], curved)
            return found.sum(axis=1), jnp.concatenate([found, squares * tile.weight[None]])

        second, rows = jax.jacfwd(score_at, has_aux=True)(jnp.zeros(columns.shape[1]))
        return rows, second

    return jax.lax.map(scores, jnp.asarray(numbers))


def _planet_noise(point: Point) -> Float[np.ndarray, "p p"]:
    """What the noise of the planet's light inside its limb adds to the covariance of the scores.

    It is measured in pixels of its own, and what it is wrong by is so for many beside them; more of
    them along the limb than a block has, so that sums over blocks do not tell.
    """
    problem, p = point.problem, point.directions.shape[1]
    found = np.zeros((p, p))
    if all(c.stencil is None for c in problem.columns):
        return found
    samples = problem.samples
    count, photo = np.asarray(samples.count), np.asarray(samples.photo)
    insides = [c.inside for c in problem.columns]
    pulls = [np.zeros((0 if i is None else len(i.angle), 6 * p)) for i in insides]
    starts = [0] * len(pulls)
    with float64():
        for filled, tiles in tile_groups(samples):
            rows = np.asarray(
                _tile_pulls(point.vector, point.directions, samples, problem.model, tiles)
            )
            for k in range(filled):
                n, which = count[tiles[k]], photo[tiles[k]]
                inside, stencil = insides[which], problem.columns[which].stencil
                assert inside is not None
                assert stencil is not None
                angle = stencil.angle[starts[which] : starts[which] + n]
                pulls[which] += inside.shares(angle).T @ rows[k, :, :n].T
                starts[which] += n
    for inside, pull in zip(insides, pulls, strict=True):
        if inside is not None:
            pieces = pull.reshape(-1, 2, 3, p)
            errors = np.einsum("rmk,mkcp->crp", inside.errors, pieces, optimize=True)
            errors = errors * inside.noise[:, None, None]
            found += np.einsum("crp,crq->pq", errors, errors)
    return found


@program
def _tile_pulls(
    vector: AnyArray, directions: AnyArray, samples: Samples, model: Model, numbers: AnyArray
) -> jax.Array:
    """How much each pixel's p scores change with level and change of the planet's light beside it,
    by channel: [tiles, 6 p, n]."""

    def pull(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        _, slopes = tile_slopes(vector, directions, tile, model)
        inside = tile.stencil.inside  # type: ignore[union-attr]

        def seen(light: jax.Array) -> jax.Array:
            return predict(vector, eqx.tree_at(lambda t: t.stencil.inside, tile, light), model)

        ways = jnp.repeat(jnp.eye(2), 3, axis=1)[:, :, None] * jnp.ones_like(inside)[None]
        predicted, push = jax.linearize(seen, inside)
        _, _, curved = weigh(predicted - tile.light, tile.clipped, model.loss)
        by_light = jax.vmap(push)(ways) * (curved * tile.weight[None])[None]
        return jnp.einsum("kcn,pcn->kcpn", by_light, slopes).reshape(-1, inside.shape[-1])

    return jax.lax.map(pull, jnp.asarray(numbers))


def inverse_root(hessian: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """R with R Rᵀ = H⁻¹, by eigenvalues of H with a unit diagonal."""
    scaled, size = unit_diagonal(hessian)
    values, vectors = np.linalg.eigh(scaled)
    floor = len(values) * np.finfo(np.float64).eps
    return np.asarray(vectors / np.sqrt(np.maximum(values, floor)) / size[:, None])


def stretch_of(leverage: Float[np.ndarray, "blocks p p"]) -> Float[np.ndarray, "blocks p p"]:
    """(1 - B)^-½ of each block's leverage B."""
    values, vectors = np.linalg.eigh(leverage)
    # A robust loss or a strongly curved model can make a block's share negative.
    stretched = 1 / np.sqrt(1 - np.clip(values, 0, MOST_LEVERAGE))
    return np.asarray((vectors * stretched[:, None, :]) @ vectors.swapaxes(1, 2))


def _not_steeper(curved: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "p p"]:
    """A second derivative in units of the squares of slopes, with eigenvalues up to
    `MOST_CURVED`."""
    values, vectors = np.linalg.eigh(curved)
    return np.asarray((vectors * np.minimum(values, MOST_CURVED)) @ vectors.T)


def _unseen(leverage: Float[np.ndarray, "blocks p p"]) -> Float[np.ndarray, "p p"]:
    """What the stretched scores lack of their variance where the stretch stops, noise being 1.

    A share b of a block's leverage has scores of variance b (1 - b) of what is left over, b of the
    noise itself; stretched by `(1 - MOST_LEVERAGE)^-½` they lack the rest.
    """
    values, vectors = np.linalg.eigh(leverage)
    seen = np.minimum((1 - values) / (1 - MOST_LEVERAGE), 1.0)
    lacking = np.clip(values, 0, 1) * (1 - np.maximum(seen, 0.0))
    return np.einsum("gij,gj,gkj->ik", vectors, lacking, vectors)


def _border_share(products: Sequence[np.ndarray], side: int) -> float:
    """How much larger the middle is without the blocks' borders, which cut products in two."""
    total = np.asarray(sum(products))
    center = total[LAGS, LAGS]
    if center <= 0:
        return 1.0
    lags = np.abs(np.arange(-LAGS, LAGS + 1))
    reach = lags <= min(side // LENGTHS + 1, LAGS)
    kept = np.maximum(1 - lags / side, 0)
    window = np.outer(reach, reach)
    whole = float((total * window).sum())
    cut = float((total * window * np.outer(kept, kept)).sum())
    return float(np.clip(whole / cut, 1.0, 2.0)) if cut > 0 else 1.0
