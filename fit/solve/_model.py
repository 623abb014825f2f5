"""The model of a sample: light of a look and a response, its slopes, and what is known before."""

from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import Look, Response, record
from model_jax._blur import below_limb, inner_heights, line_weights
from model_jax._composite import Air, air_light, compose, ground_of
from model_jax._safe import safe_divide, safe_power
from model_jax._shapes import AnyArray

from ._layout import Layout
from ._loss import Loss
from ._samples import Tile


class PriorTerm(eqx.Module):
    """Square sum that priors add: Σ weight (rows · entries - mean)²."""

    rows: Float[AnyArray, "r e"]
    """An entry each, or the difference of two."""
    mean: Float[AnyArray, " r"]
    weight: Float[AnyArray, " r"]

    def curvature(self, directions: Float[np.ndarray, "e p"]) -> Float[np.ndarray, "p p"]:
        """Half the second derivative of the square sum along directions."""
        along = np.asarray(self.rows) @ directions
        return np.asarray((along.T * np.asarray(self.weight)) @ along)


class Model(eqx.Module):
    """What turns entries and a tile into a prediction, and a residual into a cost."""

    loss: Loss
    prior: PriorTerm | None
    layout: Layout = eqx.field(static=True)
    """The kind of look, and where its numbers stand."""
    straight: bool = eqx.field(static=True)
    """Every gamma is 1 and stays so: no power is computed."""
    square: float = eqx.field(static=True, default=0.0)
    """Variance, px², that pixels which show means over their squares add to a blur's."""

    @property
    def linear(self) -> bool:
        """What is recorded is a sum of the fields and the surface, each times something."""
        return self.straight and self.layout.is_linear and not self.layout.blurs


def predict(
    entries: Float[AnyArray, " e"], tile: Tile, model: Model, *, bare: bool = False
) -> Float[jax.Array, "3 n"]:
    """Recorded light of a tile's pixels: `model_jax.composite` without alpha, then `record`.

    `bare`: as if there were no air.
    """
    entries = jnp.asarray(entries)
    look = model.layout.look(entries)
    if tile.stencil is not None:
        return _blurred(entries, look, tile, model, bare=bare)
    one = jnp.ones_like(tile.weight) if tile.one is None else tile.one
    air = Air(jnp.zeros_like(tile.light), None, None) if bare else _air(look, tile, model)
    background = jnp.broadcast_to(look.background, (3,))[:, None] * one[None, :]
    dims = model.layout.dims  # then the surface is as it is, else what its channels show of it
    surface = tile.surface if dims else None
    light = compose(air, surface, background, look.BLEND, ground_of(look, surface, 0))
    if tile.mix is not None:
        light = tile.mix @ light
    if tile.surface is not None and not dims:
        light = light + tile.surface
    exposure, gamma, black_level, *_ = model.layout.responses(entries)[tile.photo]
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


def _blurred(
    entries: jax.Array, look: Look, tile: Tile, model: Model, *, bare: bool
) -> Float[jax.Array, "3 n"]:
    """Recorded light of pixels beside a planet, whose light was measured as it was recorded.

    Inside the limb that is the planet's through the air, and the air's. What is measured at two
    places deep inside, less the air's, divided by what passes there, goes on to the limb as a line,
    times what passes on the way.
    """
    stencil = tile.stencil
    assert stencil is not None
    exposure, gamma, black_level, blur = model.layout.responses(entries)[tile.photo]
    height, bend = stencil.height, stencil.bend
    width = jnp.sqrt(blur * blur + model.square)
    below = below_limb(height, bend, width)
    own = jnp.ones((3, 1), tile.light.dtype)
    if tile.mix is not None:
        own = jnp.any(tile.mix != 0, axis=1)[:, None].astype(own.dtype)
    level, change = stencil.inside[:3] - black_level, stencil.inside[3:]
    if not model.straight:  # the light that was recorded so
        straight = jnp.sign(level) * safe_power(jnp.abs(level), gamma)
        change = change * gamma * safe_divide(straight, level, 0.0)
        level = straight
    level, change = (own * safe_divide(part, exposure, 0.0) for part in (level, change))
    background = jnp.broadcast_to(look.background, (3,))[:, None]
    light = background * (1 - below[:1])
    between = jnp.stack([1 - stencil.along, stencil.along])

    def mixed(channels: jax.Array) -> jax.Array:
        return channels if tile.mix is None else jnp.einsum("ij,j...->i...", tile.mix, channels)

    def spread(weights: jax.Array, of_lines: jax.Array) -> jax.Array:
        """Light of pixels from that at places of the two lines."""
        return (jnp.einsum("kn,ckl->cln", weights, of_lines) * between[None]).sum(axis=1)

    light = mixed(light) + level * below[:1] + change * below[1:]
    if not bare:
        heights = stencil.heights @ between
        air, _ = _air_at(look, stencil.fields, tile)
        light = light + mixed(spread(line_weights(heights, height, bend, width), air))
        heights = jnp.asarray(inner_heights())
        weights = jnp.broadcast_to(heights[:, None], (len(heights), len(height)))
        weights = line_weights(weights, height, bend, width)
        air, passed = _air_at(look, stencil.inner, tile)
        air = mixed(air)
        places = len(heights)
        deep, shallow = stencil.band
        along = ((heights - deep) / (shallow - deep))[None, :, None]
        more = air[:, :places]
        for number, (end, share) in enumerate(((deep, 1 - along), (shallow, along))):
            there = places + number
            less = share * jnp.ones_like(more)
            if passed is not None:
                # Nothing passes air so dark; the slope of a quotient divides by its square.
                least = jnp.finfo(passed.dtype).tiny ** 0.5
                whole = jnp.where(passed[:, None, there] < least, 0, passed[:, None, there])
                less = share * jnp.minimum(safe_divide(passed[:, :places], whole, 0.0), 1)
                light = light + (level - change * end) * spread(weights, less - share)
            more = more - air[:, None, there] * less
        light = light + own * spread(weights, more)
    recorded = record(light, Response(exposure, gamma), linear=model.straight)
    return recorded + own * black_level


def _air_at(
    look: Look, fields: Mapping[str, AnyArray], tile: Tile
) -> tuple[Float[jax.Array, "3 k n"], Float[jax.Array, "c k n"] | None]:
    """Light and transmittance at several places for each pixel."""
    air = air_light(look, fields, tile.color)
    light = air.light if air.alpha is None or look.BLEND != "over" else air.light * air.alpha
    passed = air.transmittance
    if air.alpha is not None and look.BLEND != "add":
        passed = (1 - air.alpha) if passed is None else passed * (1 - air.alpha)
    return jnp.moveaxis(light, -1, 0), None if passed is None else jnp.moveaxis(passed, -1, 0)


def tile_slopes(
    entries: Float[AnyArray, " e"],
    directions: Float[AnyArray, "e p"],
    tile: Tile,
    model: Model,
) -> tuple[Float[jax.Array, "3 n"], Float[jax.Array, "p 3 n"]]:
    """Prediction and its slopes along directions."""
    predicted, push = jax.linearize(lambda e: predict(e, tile, model), jnp.asarray(entries))
    return predicted, jax.vmap(push, in_axes=1)(jnp.asarray(directions))
