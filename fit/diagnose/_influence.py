"""Influence of each sample on the fitted values, and what its rounding to codes can do to them.

By the implicit function theorem the influence is `-H⁻¹ ∂score/∂light`, with H the full second
derivative, of the loss and of the model.
"""

from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray

from .._compile import float64, program
from ..solve._loss import weigh
from ..solve._model import Model, tile_slopes
from ..solve._problem import Point
from ..solve._samples import Samples, tile_at
from ._residuals import tile_groups


def rounding_bound(
    point: Point,
    half_steps: Sequence[Float[np.ndarray, "_ 3"] | None],
    to_identified: Float[np.ndarray, "t p"],
    hessian: Float[np.ndarray, "p p"],
) -> Float[np.ndarray, " t"]:
    """How far the photos' rounding to codes can move the parameters at most, to first order.

    Every sample is off by half a code step at most, and the worst case has all of them conspire:
    `Σ |influence| · half step`. No statistics enter, so it is a bound where rounding is no noise.
    """
    response = np.linalg.solve(hessian, to_identified.T)
    bound = np.zeros(len(to_identified))
    starts = [0] * len(half_steps)
    for photo, influence in influences(point, response):
        n = influence.shape[-1]
        steps = half_steps[photo]
        if steps is not None:
            here = steps[starts[photo] : starts[photo] + n].T
            bound += np.einsum("tcn,cn->t", np.abs(influence), here)
        starts[photo] += n
    return bound


def influence_maps(
    point: Point,
    sizes: Sequence[tuple[int, int]],
    to_identified: Float[np.ndarray, " p"],
    hessian: Float[np.ndarray, "p p"],
) -> list[Float[np.ndarray, "_ _ 3"]]:
    """Derivative of one fitted parameter by each recorded sample; 0 where no pixel was used.

    In parameter units per unit of recorded light.
    """
    # A plane for each channel, as files store them.
    maps = [np.moveaxis(np.zeros((3, *size), np.float32), 0, -1) for size in sizes]
    starts = [0] * len(sizes)
    response = np.linalg.solve(hessian, to_identified)
    for photo, influence in influences(point, response[:, None]):
        n = influence.shape[-1]
        index = point.problem.columns[photo].index[starts[photo] : starts[photo] + n]
        for k, plane in enumerate(np.moveaxis(maps[photo], -1, 0)):
            plane.reshape(-1)[index] = influence[0, k]
        starts[photo] += n
    return maps


def influences(
    point: Point, response: Float[np.ndarray, "p t"]
) -> Iterator[tuple[int, np.ndarray]]:
    """Photo and influence [t, 3, n] of each tile; `response` is H⁻¹ × what is asked."""
    samples, model, directions = (
        point.problem.samples,
        point.problem.model,
        point.directions @ response,
    )
    count, photo = np.asarray(samples.count), np.asarray(samples.photo)
    with float64():
        for filled, numbers in tile_groups(samples):
            found = np.asarray(_tile_influence(point.vector, directions, samples, model, numbers))
            for k in range(filled):
                number = numbers[k]
                yield int(photo[number]), found[k, ..., : count[number]]


@program
def _tile_influence(
    vector: AnyArray, directions: AnyArray, samples: Samples, model: Model, numbers: AnyArray
) -> jax.Array:
    def influence(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        predicted, slopes = tile_slopes(vector, directions, tile, model)

        def score_of(light: jax.Array) -> jax.Array:
            return weigh(predicted - light, tile.clipped, model.loss)[1]

        _, by_light = jax.jvp(score_of, (tile.light,), (jnp.ones_like(tile.light),))
        return -slopes * (by_light * tile.weight[None])[None]

    return jax.lax.map(influence, jnp.asarray(numbers))
