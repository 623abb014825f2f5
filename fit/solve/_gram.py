"""The exact pass over all samples, tile by tile, as a residual that any optimistix solver can use.

`Samples` holds the used pixels of all photos as tiles of a fixed size. `gram` runs over them once
and returns all that a step of least squares asks of them, a matrix of p + 1 by p + 1 numbers:

    G = Σ [[h J Jᵀ, s J], [s Jᵀ, cost]]        (J: slopes, s: score, h: curvature; see `_loss`)

`compressed` is its Cholesky factor, presented as a function with p + 1 residuals: its square sum is
the cost, its Jacobian times itself is the gradient and its Jacobian squared the curvature, exactly.
So Levenberg–Marquardt, dogleg, BFGS and the rest of optimistix run over a photo of any size in the
memory of one tile, one pass a step, and none of them knows.

The same tiles hold less than all pixels: `bins` averages pixels with alike fields, and `moments`
makes a few pseudo-pixels that stand for all, without loss where the model is linear in its fields.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from model_jax._shapes import AnyArray

from ._loss import Loss, weigh
from ._model import Model, PriorTerm, tile_slopes
from ._samples import Samples, Tile, tile_at

_JITTER = 64
"""Share of the unit diagonal, in eps, that keeps a Cholesky factor of p + 1 rounded rows real."""


def gram(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    samples: Samples,
    model: Model,
) -> Float[jax.Array, "q q"]:
    """The matrix G of one pass, q = p + 1."""
    directions = jnp.asarray(directions)
    if samples.clipped is None and model.loss.name == "linear" and model.linear:
        total = _linear_gram(entries, directions, samples, model)
    else:
        total = pixel_gram(entries, directions, samples, model)
    return total if model.prior is None else total + _prior_gram(entries, directions, model.prior)


def _linear_gram(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    samples: Samples,
    model: Model,
) -> Float[jax.Array, "q q"]:
    """Plain least squares of a model that is linear in its columns, residuals pixel by pixel.

    A prediction is then coefficients times the columns one, fields and the channel's surface, the
    same for all pixels of a photo. `predict` itself gives them, on the columns' unit vectors,
    and a pass sums no more than products of columns and residuals.
    """
    photos = jnp.arange(samples.color.shape[0])
    unit = jax.vmap(lambda photo: _unit_tile(samples, photo))(photos)
    coefficients, slopes = jax.vmap(lambda tile: tile_slopes(entries, directions, tile, model))(
        unit
    )
    shared = 1 + len(samples.fields)
    surfaces = 0 if samples.surface is None else 3

    def add(index: Any, total: jax.Array) -> jax.Array:
        tile = tile_at(samples, index)
        columns = tile_columns(samples, tile)
        factors = coefficients[tile.photo]
        residual = factors[:, :shared] @ columns[:shared] - tile.light
        if tile.surface is not None:
            residual = residual + factors[:, shared:] * tile.surface
        rows = jnp.concatenate([columns, residual])
        return total.at[tile.photo].add(weighted_squares(samples, tile, rows))

    size = shared + surfaces
    zero = jnp.zeros((len(photos), size + 3, size + 3), samples.like.dtype)
    total = jax.lax.fori_loop(0, samples.used, add, zero)
    square_sum = jnp.trace(total[:, size:, size:], axis1=1, axis2=2).sum()
    channel = np.arange(3)[:, None]
    of = np.concatenate([np.broadcast_to(np.arange(shared), (3, shared)), shared + channel], axis=1)
    of = of[:, : slopes.shape[-1]]  # without surfaces no column is a channel's own
    products = total[:, of[:, :, None], of[:, None, :]]
    pulled = jnp.einsum("qikm,qkmn->qikn", slopes, products)
    curved = jnp.einsum("qikn,qjkn->ij", pulled, slopes)
    gradient = jnp.einsum("qikm,qkm->i", slopes, total[:, of, size + channel])
    return _bordered(curved, gradient, square_sum)


def tile_columns(samples: Samples, tile: Tile) -> Float[jax.Array, "c n"]:
    """The columns one, fields and surface of a tile, without what no pixel has.

    Padding is 0 in all of them, and in the light.
    """
    one = tile.one
    if one is None:  # weights of pixels are 0 and 1, unless they are pseudo-pixels
        one = tile.weight if samples.weight is None else jnp.ones_like(tile.weight)
    rows = [one[None], *(field[None] for field in tile.fields.values())]
    if tile.surface is not None:
        rows.append(tile.surface)
    return jnp.concatenate(rows)


def weighted_squares(
    samples: Samples, tile: Tile, rows: Float[jax.Array, "r n"]
) -> Float[jax.Array, "r r"]:
    """Sums of products of rows over a tile."""
    left = rows if samples.weight is None else rows * tile.weight[None]
    return left @ rows.T


def _unit_tile(samples: Samples, photo: Int[jax.Array, ""]) -> Tile:
    """One pseudo-pixel for each column: 1 in it, 0 in the others."""
    size = 1 + len(samples.fields) + (samples.surface is not None)
    unit = jnp.eye(size, dtype=samples.like.dtype)
    surface = None
    if samples.surface is not None:
        surface = jnp.broadcast_to(unit[-1][None], (3, size))
    return Tile(
        fields={name: unit[1 + k] for k, name in enumerate(samples.fields)},
        light=jnp.zeros((3, size), samples.like.dtype),
        surface=surface,
        clipped=None,
        one=unit[0],
        weight=jnp.ones(size, samples.like.dtype),
        photo=photo,
        color=jnp.asarray(samples.color)[photo],
        mix=None if samples.mix is None else jnp.asarray(samples.mix)[photo],
    )


def _bordered(curved: Any, gradient: Any, square_sum: Any) -> Float[jax.Array, "q q"]:
    right = jnp.append(gradient, square_sum)
    return jnp.block([[curved, gradient[:, None]], [right[None, :]]])


def pixel_gram(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    samples: Samples,
    model: Model,
) -> Float[jax.Array, "q q"]:
    """Any model, any loss: the slopes of every sample."""
    size = directions.shape[1] + 1

    def add(index: Any, total: jax.Array) -> jax.Array:
        tile = tile_at(samples, index)
        predicted, slopes = tile_slopes(entries, directions, tile, model)
        residual = predicted - tile.light
        if tile.clipped is None and model.loss.name == "linear":
            rows = jnp.concatenate([slopes, residual[None]])
            weighted = rows * tile.weight[None, None]
            # Weights of 0 and 1 are their own squares, and one array in cache is better than two.
            left = weighted if samples.weight is None else rows
            return total + jnp.einsum("icn,jcn->ij", left, weighted)
        cost, score, curvature = _weigh_tile(residual, tile, model.loss)
        curved = jnp.einsum("icn,jcn->ij", slopes * (curvature * tile.weight[None])[None], slopes)
        gradient = jnp.einsum("icn,cn->i", slopes, score * tile.weight[None])
        return total + _bordered(curved, gradient, (cost * tile.weight[None]).sum())

    zero = jnp.zeros((size, size), samples.like.dtype)
    return jax.lax.fori_loop(0, samples.used, add, zero)


def _weigh_tile(
    residual: Float[jax.Array, "3 n"], tile: Tile, loss: Loss
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """`weigh`; a tile without clipped samples is spared the normal distribution."""
    if tile.clipped is None:
        return weigh(residual, None, loss)
    return jax.lax.cond(
        jnp.any(tile.clipped != 0),
        lambda: weigh(residual, tile.clipped, loss),
        lambda: weigh(residual, None, loss),
    )


def _prior_gram(entries: Any, directions: Any, prior: PriorTerm) -> Float[jax.Array, "q q"]:
    along, off = prior.rows @ directions, prior.rows @ jnp.asarray(entries) - prior.mean
    rows = jnp.concatenate([along.T, off[None]])
    return (rows * prior.weight[None]) @ rows.T


def cholesky(gram: Float[jax.Array, "q q"]) -> Float[jax.Array, "q q"]:
    """Upper R with RᵀR = G, of a G that rounding may have made singular.

    The rows are scaled to a unit diagonal first, so that small residuals keep their digits beside
    large slopes, and a multiple of eps is added to that diagonal.
    """
    diagonal = jnp.diagonal(gram)
    size = jnp.where(diagonal > 0, jnp.sqrt(jnp.where(diagonal > 0, diagonal, 1)), 1)
    eps = jnp.finfo(gram.dtype).eps
    scaled = gram / size[None] / size[:, None]
    unit = jnp.where(jnp.eye(len(size), dtype=bool), 1 + _JITTER * len(size) * eps, scaled)
    upper = jnp.linalg.cholesky(unit, upper=True) * size[None]
    return jnp.where(diagonal[None] > 0, upper, 0)


@eqx.filter_custom_jvp
def compressed(
    step: Float[jax.Array, " p"], make_gram: Callable[[jax.Array], jax.Array]
) -> Float[jax.Array, " q"]:
    """p + 1 residuals in place of all: same square sum, same gradient, same curvature.

    Args:
        step: what the solver moves.
        make_gram: the pass, a callable pytree: step → G along the steps.
    """
    return cholesky(make_gram(step))[:, -1]


@compressed.def_jvp
def _compressed_jvp(primals: Any, tangents: Any) -> Any:
    step, make_gram = primals
    factor = cholesky(make_gram(step))
    return factor[:, -1], factor[:, :-1] @ tangents[0]
