"""A fit as other solvers want it: all residuals in one array, and their slopes."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray

from .._compile import float64
from ..solve._model import Model, predict
from ..solve._parameters import Entries, FitParameter
from ..solve._samples import Samples, tile_at


class Flat(eqx.Module):
    """What the residuals of all pixels are made from; u counts from the start in typical sizes."""

    base: Float[AnyArray, " e"]
    steps: Float[AnyArray, "e p"]
    samples: Samples

    def entries(self, u: Float[jax.Array, " p"]) -> Float[jax.Array, " e"]:
        return jnp.asarray(self.base) + jnp.asarray(self.steps) @ u


def flat_residuals(u: Float[jax.Array, " p"], flat: Flat, model: Model) -> jax.Array:
    """Prediction less light, of every sample; 0 of what pads the tiles."""
    entries = flat.entries(u)

    def of_tile(index: jax.Array) -> jax.Array:
        tile = tile_at(flat.samples, index)
        return (predict(entries, tile, model) - tile.light) * tile.weight[None]

    found: jax.Array = jax.vmap(of_tile)(jnp.arange(flat.samples.like.shape[0]))
    return found.reshape(-1)


def loss(u: Float[jax.Array, " p"], flat: Flat, model: Model, size: jax.Array) -> jax.Array:
    """Half the square sum, of order one."""
    return 0.5 * ((flat_residuals(u, flat, model) / size) ** 2).sum()


residuals_of = eqx.filter_jit(flat_residuals)


@eqx.filter_jit
def slopes_of(u: Float[jax.Array, " p"], flat: Flat, model: Model) -> jax.Array:
    """[samples, p]."""
    found: jax.Array = jax.jacfwd(flat_residuals)(u, flat, model)
    return found


class Residuals:
    """Residuals of samples along directions from a start."""

    def __init__(
        self,
        whole: Samples,
        model: Model,
        start: Entries,
        directions: Float[np.ndarray, "e p"],
        free: Sequence[FitParameter],
    ) -> None:
        n = int(whole.used)
        self.model = model
        self.samples: Samples = jax.tree.map(
            lambda leaf: leaf[:n] if np.ndim(leaf) and len(leaf) == len(whole.count) else leaf,
            whole,
        )
        scales = np.array([p.scale for p in free])
        members = np.array([[p.of(column) for p in free] for column in directions.T])
        # A direction that moves several, such as factors of one mean, counts by the first's size.
        moved = np.abs(members).argmax(axis=1) if len(members) else np.zeros(0, int)
        self.scale = scales[moved] / np.abs(members).max(axis=1)
        self.start, self.steps = start, directions * self.scale
        norm = float(np.sqrt(np.sum(np.square(self.samples.light, dtype=np.float64))))
        self.size = norm or 1.0

    def flat(self) -> Flat:
        """Uploaded, in the precision of the caller's JAX."""
        moved: Flat = jax.device_put(Flat(self.start, self.steps, self.samples))
        return moved

    def bytes(self) -> int:
        """Of what one evaluation reads."""
        parts = [*self.samples.fields.values(), self.samples.light]
        return sum(part.nbytes for part in parts)

    def vector(self, u: np.ndarray) -> Entries:
        found: Entries = self.start + self.steps @ np.asarray(u, np.float64)
        return found

    def at(
        self, vector: Entries, directions: Float[np.ndarray, "e p"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and slopes along directions, as NumPy arrays."""
        with float64():
            flat: Flat = jax.device_put(Flat(vector, directions, self.samples))
            nothing = jnp.zeros(directions.shape[1])
            return (
                np.asarray(residuals_of(nothing, flat, self.model)),
                np.asarray(slopes_of(nothing, flat, self.model)),
            )

    def light(self, vector: Entries) -> np.ndarray:
        """Predicted light [samples], without what pads the tiles."""
        with float64():
            flat: Flat = jax.device_put(Flat(vector, self.steps, self.samples))
            residual = np.asarray(residuals_of(jnp.zeros(self.steps.shape[1]), flat, self.model))
        light = np.asarray(self.samples.light, np.float64)
        inside = np.arange(light.shape[-1]) < self.samples.count[:, None, None]
        return (residual.reshape(light.shape) + light)[np.broadcast_to(inside, light.shape)]
