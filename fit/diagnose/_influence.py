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
from ..photo._pixels import Columns
from ..solve._loss import weigh
from ..solve._model import Model, tile_slopes
from ..solve._parameters import Entries
from ..solve._samples import Samples, tile_at
from ._residuals import tile_groups


def rounding_bound(
    columns: Sequence[Columns],
    half_steps: Sequence[Float[np.ndarray, "_ 3"] | None],
    samples: Samples,
    model: Model,
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    to_told: Float[np.ndarray, "t p"],
    hessian: Float[np.ndarray, "p p"],
) -> Float[np.ndarray, " t"]:
    """How far the photos' rounding to codes can move the parameters at most, to first order.

    Every sample is off by half a code step at most, and the worst case has all of them conspire:
    `Σ |influence| · half step`. No statistics enter, so it is a bound where rounding is no noise.
    """
    response = np.linalg.solve(hessian, to_told.T)
    bound = np.zeros(len(to_told))
    starts = [0] * len(columns)
    for photo, influence in influences(samples, model, vector, along @ response):
        n = influence.shape[-1]
        steps = half_steps[photo]
        if steps is not None:
            here = steps[starts[photo] : starts[photo] + n].T
            bound += np.einsum("tcn,cn->t", np.abs(influence), here)
        starts[photo] += n
    return bound


def influence_maps(
    columns: Sequence[Columns],
    sizes: Sequence[tuple[int, int]],
    samples: Samples,
    model: Model,
    vector: Entries,
    along: Float[np.ndarray, "e p"],
    to_told: Float[np.ndarray, " p"],
    hessian: Float[np.ndarray, "p p"],
) -> list[Float[np.ndarray, "_ _ 3"]]:
    """Derivative of one fitted parameter by each recorded sample; 0 where no pixel was used.

    In parameter units per unit of recorded light.
    """
    # A plane for each channel, as files store them.
    maps = [np.moveaxis(np.zeros((3, *size), np.float32), 0, -1) for size in sizes]
    starts = [0] * len(columns)
    response = np.linalg.solve(hessian, to_told)
    for photo, influence in influences(samples, model, vector, along @ response[:, None]):
        n = influence.shape[-1]
        index = columns[photo].index[starts[photo] : starts[photo] + n]
        for k, plane in enumerate(np.moveaxis(maps[photo], -1, 0)):
            plane.reshape(-1)[index] = influence[0, k]
        starts[photo] += n
    return maps


def influences(
    samples: Samples, model: Model, vector: Entries, along: Float[np.ndarray, "e t"]
) -> Iterator[tuple[int, np.ndarray]]:
    """Photo and influence [t, 3, n] of each tile; `along` is directions × H⁻¹ × what is asked."""
    count, photo = np.asarray(samples.count), np.asarray(samples.photo)
    with float64():
        for filled, numbers in tile_groups(samples):
            found = np.asarray(_tile_influence(vector, along, samples, model, numbers))
            for k in range(filled):
                number = numbers[k]
                yield int(photo[number]), found[k, ..., : count[number]]


@program
def _tile_influence(
    vector: AnyArray, along: AnyArray, samples: Samples, model: Model, numbers: AnyArray
) -> jax.Array:
    def influence(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        predicted, slopes = tile_slopes(vector, along, tile, model.linear)

        def score_of(light: jax.Array) -> jax.Array:
            return weigh(predicted - light, tile.clipped, model.loss)[1]

        _, by_light = jax.jvp(score_of, (tile.light,), (jnp.ones_like(tile.light),))
        return -slopes * (by_light * tile.weight[None])[None]

    return jax.lax.map(influence, jnp.asarray(numbers))
