"""The model of a sample: light of a look and a response, its slopes, and what is known before."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from model_jax import Look, Response, record
from model_jax._composite import Air, air_light, compose
from model_jax._shapes import AnyArray

from ._layout import Layout
from ._loss import Loss
from ._samples import Tile


class PriorTerm(eqx.Module):
    """Square sum that priors add: Σ weight (entry - mean)²."""

    mean: Float[AnyArray, " e"]
    weight: Float[AnyArray, " e"]


class Model(eqx.Module):
    """What turns entries and a tile into a prediction, and a residual into a cost."""

    loss: Loss
    prior: PriorTerm | None
    layout: Layout = eqx.field(static=True)
    """The kind of look, and where its numbers stand."""
    straight: bool = eqx.field(static=True)
    """Every gamma is 1 and stays so: no power is computed."""

    @property
    def linear(self) -> bool:
        """What is recorded is a sum of the fields and the surface, each times something."""
        return self.straight and self.layout.is_linear


def predict(
    entries: Float[AnyArray, " e"], tile: Tile, model: Model, *, bare: bool = False
) -> Float[jax.Array, "3 n"]:
    """Recorded light of a tile's pixels: `model_jax.composite` without alpha, then `record`.

    `bare`: as if there were no air.
    """
    entries = jnp.asarray(entries)
    look = model.layout.look(entries)
    one = jnp.ones_like(tile.weight) if tile.one is None else tile.one
    air = Air(jnp.zeros_like(tile.light), None, None) if bare else _air(look, tile, model)
    background = jnp.broadcast_to(look.background, (3,))[:, None] * one[None, :]
    dims = model.layout.dims  # then the surface is as it is, else what its channels show of it
    light = compose(air, tile.surface if dims else None, background, look.BLEND)
    if tile.mix is not None:
        light = tile.mix @ light
    if tile.surface is not None and not dims:
        light = light + tile.surface
    exposure, gamma, black_level = model.layout.responses(entries)[tile.photo]
    recorded = record(light, Response(exposure, gamma), linear=model.straight)
    level = black_level * one[None, :]
    if tile.mix is not None:
        level = jnp.any(tile.mix != 0, axis=1)[:, None] * level
    return recorded + level


def _air(look: Look, tile: Tile, model: Model) -> Air:
    """What the look makes of a tile, channels first; nothing of a pseudo-pixel that is no mean."""
    air = air_light(look, tile.fields, tile.color)
    light = jnp.moveaxis(air.light, -1, 0)
    alpha, passed = (
        None if p is None else jnp.moveaxis(p, -1, 0) for p in (air.alpha, air.transmittance)
    )
    if tile.one is not None and not model.layout.is_linear:
        light = light * tile.one[None]
    return Air(light, alpha, passed)


def tile_slopes(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    tile: Tile,
    model: Model,
) -> tuple[Float[jax.Array, "3 n"], Float[jax.Array, "p 3 n"]]:
    """Prediction and its slopes along directions."""
    predicted, push = jax.linearize(lambda e: predict(e, tile, model), jnp.asarray(entries))
    return predicted, jax.vmap(push, in_axes=1)(jnp.asarray(directions))
