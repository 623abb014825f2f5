"""The combine step: fields → light of the air → picture.

`air_light` asks a look for its light; `compose` is the one place where a picture is put together,
whoever made its parts: JAX, the shaders or a fit's samples.

All are pure and dtype-generic (the layers' dtype decides), and every gradient is finite: the only
kinks are min/max ties, where JAX takes half of each side.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._errors import InputError
from ._fields import Fields, fields_of
from ._kinds import as_jax, need
from ._layers import Layers
from ._look import Blend, Look, broadcast
from ._shapes import AnyArray, Rgba


class Air(NamedTuple):
    """What a look makes of fields."""

    light: Float[AnyArray, "*shape 3"]
    alpha: Float[AnyArray, "*shape 1"] | None
    """Coverage of the light; None where the look says nothing of it."""
    transmittance: Float[AnyArray, "*shape c"] | None
    """Share of what lies behind that passes, one or three channels; None where all passes."""


def air_light(
    look: Look,
    fields: Mapping[str, Float[AnyArray, "*shape"]],
    color: Float[AnyArray, "3"],
) -> Air:
    """Light of the air where the fields that a look needs are known, whoever measured them.

    Args:
        fields: by name, of one shape and dtype; one that is missing is 0 everywhere.
        color: linear RGB of the air.
    """
    need("look", look, Look)
    first = next(iter(fields.values()))
    rank, dtype = np.ndim(first) + 1, as_jax("fields", first).dtype
    shape = (1,) * (rank - 1) + (3,)
    values = {
        name: jnp.asarray(fields[name], dtype)[..., None] if name in fields else 0.0
        for name in type(look).NEEDS
    }
    met = Fields(as_jax("color", color).astype(dtype).reshape(shape), values)
    found = broadcast(look, rank, dtype).air(met)
    if not isinstance(found, tuple) or len(found) != 2:
        raise InputError(f"look {look.NAME}: air returns no pair; return light, transmittance")
    light, transmittance = found
    channels = np.shape(light)[-1] if np.ndim(light) == rank else 0
    whole = np.broadcast_shapes(np.shape(light)[:-1], np.shape(first)) if channels else ()
    if channels not in (3, 4) or whole != np.shape(first):
        raise InputError(
            f"look {look.NAME}: air returns light of shape {np.shape(light)} for fields of shape "
            f"{(*np.shape(first), 1)}; return [..., 3], or [..., 4] with alpha"
        )
    light = jnp.broadcast_to(light, (*np.shape(first), channels))
    alpha = light[..., 3:] if channels == 4 else None
    if transmittance is not None:
        transmittance = jnp.asarray(transmittance, dtype)
        form = np.shape(transmittance)
        if len(form) not in (0, rank) or (form and form[-1] not in (1, 3)):
            raise InputError(
                f"look {look.NAME}: air returns a transmittance of shape {form} for fields of "
                f"shape {(*np.shape(first), 1)}; return [..., 3], [..., 1], or None"
            )
        channels = form[-1] if form else 1
        transmittance = jnp.broadcast_to(transmittance, (*np.shape(first), channels))
    return Air(light[..., :3], alpha, transmittance)


def compose(
    air: Air,
    surface: AnyArray | None,
    background: Any,
    blend: Blend = "add",
    ground: AnyArray | None = None,
) -> Float[AnyArray, "*shape c"]:
    """The picture: `surface · ground · transmittance + light + background`.

    Args:
        air: light, alpha and transmittance; NumPy or JAX arrays, channels last or first, if only
            all broadcast.
        surface: light of what lies behind the air; None for nothing.
        background: light that the frame adds.
        blend: what alpha does to light and surface.
        ground: the look's factor on the surface; None is 1.
    """
    light, passed = air.light, air.transmittance
    if air.alpha is not None and blend != "add":
        passed = (1 - air.alpha) if passed is None else passed * (1 - air.alpha)
        light = light * air.alpha if blend == "over" else light
    light = light + background
    if surface is None:
        return light
    if ground is not None:
        surface = surface * ground
    return light + (surface if passed is None else surface * passed)


def combine(layers: Layers, look: Look) -> Rgba:
    """Light of the air, and its alpha; `background` and what lies behind are `composite`'s.

    Args:
        layers: depth layers [h, w] and the air's colour.
        look: how air is coloured.

    Returns:
        Linear light [h, w, 4]; alpha is the look's, or the colour's where there is air and 0
        elsewhere.

    Twin: `combine.frag`.
    """
    air, alpha = _air(layers, look)
    return jnp.concatenate([air.light, alpha], axis=-1)


def composite(layers: Layers, look: Look) -> Rgba:
    """The picture: surface · ground · transmittance + air + background, and the coverage of both.

    Returns:
        Linear light [h, w, 4]. Without a surface layer the planet is black; alpha is 1 in front of
        the planet where the layers know it, else the air's.
    """
    air, alpha = _air(layers, look)
    dtype = air.light.dtype
    background = jnp.asarray(look.background, dtype).reshape(1, 1, -1)
    surface = None if layers.surface is None else jnp.asarray(layers.surface, dtype)
    rgb = compose(air, surface, background, look.BLEND, ground_of(look, surface))
    if layers.planet is not None:
        alpha = jnp.maximum(alpha, jnp.asarray(layers.planet, dtype)[..., None])
    return jnp.concatenate([rgb, alpha], axis=-1)


def need_surface(layers: Layers, kind: type[Look]) -> None:
    """Raise `InputError` for a surface that the sun has lit where the look does so itself, and for
    one that nobody lights."""
    if layers.surface is None or layers.is_albedo == kind.LIGHTS_GROUND:
        return
    is_, wants = ("albedo", "light") if layers.is_albedo else ("light", "albedo")
    raise InputError(
        f"layers: their surface is the ground's {is_}, and the look {kind.NAME} asks for its "
        f"{wants}; make them for the look: render(scene, look=look)"
    )


def ground_of(look: Look, surface: AnyArray | None, axis: int = -1) -> AnyArray | None:
    """The look's factor on the surface, whose channels are an axis; None where there is none."""
    if surface is None or not look.GROUND:
        return None
    shape = [1] * np.ndim(surface)
    shape[axis] = 3
    return jnp.asarray(getattr(look, look.GROUND), surface.dtype).reshape(shape)


def _air(layers: Layers, look: Look) -> tuple[Air, AnyArray]:
    """What the look makes of layers, nothing where there is no air; and the picture's alpha."""
    need("look", look, Look)
    need("layers", layers, Layers)
    need_surface(layers, type(look))
    air = air_light(look, fields_of(layers, type(look).NEEDS), jnp.asarray(layers.color)[:3])
    dtype, here = air.light.dtype, layers.has_air[..., None]
    alpha = jnp.asarray(layers.color, dtype)[3] if air.alpha is None else air.alpha
    alpha = jnp.where(here, alpha, 0).astype(dtype)
    passed = None if air.transmittance is None else jnp.where(here, air.transmittance, 1)
    light = jnp.where(here, air.light, 0)
    return Air(light, None if air.alpha is None else alpha, passed), alpha


@cache
def transmits(kind: type[Look]) -> bool:
    """Whether looks of a kind have a transmittance."""
    return _abstract(kind).transmittance is not None


@cache
def dims(kind: type[Look]) -> bool:
    """Whether looks of a kind change what lies behind the air: by transmittance, by alpha, or by a
    factor of their own."""
    return (
        transmits(kind)
        or bool(kind.GROUND)
        or (_abstract(kind).alpha is not None and kind.BLEND != "add")
    )


def _abstract(kind: type[Look]) -> Air:
    """What looks of a kind make of fields, as shapes alone."""
    one = {name: jax.ShapeDtypeStruct((1,), np.float32) for name in kind.NEEDS}
    color = jax.ShapeDtypeStruct((3,), np.float32)
    return jax.eval_shape(lambda fields, color: air_light(kind(), fields, color), one, color)
