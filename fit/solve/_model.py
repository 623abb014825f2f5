"""The model of a sample: light of a look and a response, its slopes, and what is known before."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from model_jax import Look, Response, air_light, record
from model_jax._shapes import AnyArray

from ._loss import Loss
from ._parameters import BACKGROUND, BRIGHTNESS, LOOK_ENTRIES, RESPONSE_ENTRIES, SHADOW, TINT
from ._samples import Tile


class PriorTerm(eqx.Module):
    """Square sum that priors add: Σ weight (entry - mean)²."""

    mean: Float[AnyArray, " e"]
    weight: Float[AnyArray, " e"]


class Model(eqx.Module):
    """What turns entries and a tile into a prediction, and a residual into a cost."""

    loss: Loss
    prior: PriorTerm | None
    linear: bool = eqx.field(static=True)
    """Every gamma is 1 and stays so: no power is computed."""


def predict(entries: Float[AnyArray, " e"], tile: Tile, linear: bool) -> Float[jax.Array, "3 n"]:
    """Recorded light of a tile's pixels: `model_jax.composite` without alpha, then `record`."""
    entries = jnp.asarray(entries)
    look = Look(entries[BRIGHTNESS], entries[SHADOW], entries[TINT], entries[BACKGROUND])
    dark = None if tile.dark is None else tile.dark[:, None]
    air = jnp.moveaxis(air_light(tile.lit[:, None], dark, tile.color, look), -1, 0)
    one = jnp.ones_like(tile.lit) if tile.one is None else tile.one
    light = air + entries[BACKGROUND][:, None] * one[None, :]
    if tile.mix is not None:
        light = tile.mix @ light
    if tile.surface is not None:
        light = light + tile.surface
    rows = entries[LOOK_ENTRIES:].reshape(-1, RESPONSE_ENTRIES)
    exposure, gamma, black_level = rows[tile.photo]
    recorded = record(light, Response(exposure, gamma), linear=linear)
    level = black_level * one[None, :]
    if tile.mix is not None:
        level = jnp.any(tile.mix != 0, axis=1)[:, None] * level
    return recorded + level


def tile_slopes(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    tile: Tile,
    linear: bool,
) -> tuple[Float[jax.Array, "3 n"], Float[jax.Array, "p 3 n"]]:
    """Prediction and its slopes along directions."""
    predicted, push = jax.linearize(lambda e: predict(e, tile, linear), jnp.asarray(entries))
    return predicted, jax.vmap(push, in_axes=1)(jnp.asarray(directions))
