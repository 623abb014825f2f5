"""Fields: what a pixel's ray meets, computed only if a look asks for it.

`layer_widths` is the contract's first half: the same lines as in `fields.glsl`, in the same order,
so that the two differ by rounding only.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ._errors import InputError
from ._intersect import squared_miss_distance
from ._kinds import need
from ._layers import Layers
from ._safe import safe_sqrt
from ._shapes import AnyArray, Depth, Scalar, Shadows, Width, namespace
from ._view import View, pixel_grid, pixel_slopes, ray_offsets


@dataclass(frozen=True)
class Field:
    """What there is to know of a field."""

    meaning: str
    unit: str
    absent: str = ""
    """Why layers may have none of it; it is the number 0 then. Empty: layers must have it."""
    unseen: str = ""
    """What is said where it is 0 in all pixels."""
    of_shadow: bool = False
    """Whether shadows are drawn for it."""


_NO_SHADOW = "the layers hold no shadow: no sun is given, or no air in view is in shadow"
_NO_DARK = "no pixel used is in shadow"

FIELDS: dict[str, Field] = {
    "width": Field("width of the air on the ray", "width_unit"),
    "lit": Field(
        "width of lit air on the ray", "width_unit", unseen="no pixel used is lit", of_shadow=True
    ),
    "dark": Field(
        "width of shadowed air on the ray",
        "width_unit",
        absent=_NO_SHADOW,
        unseen=_NO_DARK,
        of_shadow=True,
    ),
    "planet": Field(
        "1 where the planet or an occluder ends the ray, 0 where space does",
        "1",
        unseen="no pixel used is in front of the planet",
    ),
    "water": Field(
        "how much of the ground that ends the ray mirrors, 0 to 1",
        "1",
        absent="the layers hold no water: planet.water names no mask",
        unseen="no pixel used shows water",
    ),
    "begin": Field(
        "where the air begins on the ray, from its point nearest to the planet", "length"
    ),
    "end": Field("where the air ends on the ray, likewise", "length"),
    "dark_begin": Field(
        "where the shadow begins in the air on the ray, likewise",
        "length",
        absent=_NO_SHADOW,
        of_shadow=True,
    ),
    "dark_end": Field(
        "where the shadow ends in the air on the ray, likewise",
        "length",
        absent=_NO_SHADOW,
        unseen=_NO_DARK,
        of_shadow=True,
    ),
    "altitude": Field("height of the ray's nearest point above the planet's radius", "length"),
    "impact": Field("distance of that point from the planet's centre", "length"),
    "per_length": Field("width of a unit of length along the ray", "width_unit/length"),
    "sunward": Field("how far towards the sun that point lies from the planet's centre", "length"),
    "sun_cos": Field("cosine of the angle between the ray and the direction to the sun", "1"),
    "begin_sun_cos": Field(
        "cosine of the angle between the vertical where the air begins and the direction to the "
        "sun",
        "1",
    ),
    "end_sun_cos": Field("the same where the air ends", "1"),
    "shell": Field("height at which the air ends", "length"),
    "nadir_cos": Field("cosine of the angle between the ray and straight down", "1"),
    "radius": Field("the planet's radius", "length"),
    "eye_height": Field("height of the camera above the planet's radius", "length"),
    "ground_horizon": Field("cosine of the angle between straight down and ground's horizon", "1"),
    "shell_horizon": Field("the same of the air's edge; 0 in the air", "1"),
    "eye_sun_cos": Field(
        "cosine of the angle between the vertical at the camera and the direction to the sun", "1"
    ),
}
"""Every field a look may ask for. All are `[..., 1]`; the air's `color`, `[..., 3]`, is always
there."""

WIDTHS = ("width", "lit", "dark")
"""Those that are lengths of air."""

PLACES = ("begin", "end", "dark_begin", "dark_end", "altitude", "impact", "per_length")
"""Those that tell where on the ray and how high the air is."""

OF_SUN = ("sunward", "sun_cos")
"""Those that tell where the sun is."""

UNDER_SUN = {"begin_sun_cos": "begin", "end_sun_cos": "end"}
"""Those that tell how high the sun stands, and where on the ray."""

OF_EYE = ("nadir_cos", "radius", "eye_height", "ground_horizon", "shell_horizon", "eye_sun_cos")
"""Those that tell where the camera is; but for the first they are one number each."""

FACES_SUN = (*OF_SUN, *UNDER_SUN, "eye_sun_cos")
"""Those for which one has to know where the sun is."""

OF_VIEW = (*PLACES, *OF_SUN, *UNDER_SUN, "shell", *OF_EYE)
"""Those for which one has to know how rays pass the planet."""


def amount_of(fields: Mapping[str, AnyArray], name: str) -> AnyArray:
    """How much of a field there is; of where shadow ends, the width of shadow before it."""
    if name != "dark_end":
        return fields[name]
    return (fields[name] - fields["dark_begin"]) * fields["per_length"]


OF_RAYS = ("altitude", "impact", "per_length", *OF_SUN, "shell", *OF_EYE)
"""Those of them that rays have without air too."""


class Fields(eqx.Module):
    """What a look asked for, as attributes; what nothing in view has is the number 0."""

    color: Any
    """Linear RGB of the air, [..., 3]."""
    values: dict[str, Any]

    def __getattr__(self, name: str) -> Any:
        values = self.__dict__.get("values", {})
        if name in values:
            return values[name]
        if name in FIELDS and "values" in self.__dict__:
            raise InputError(f"fields.{name}: is not in the look's NEEDS; add it there")
        known = ", ".join(("color", *FIELDS))
        raise AttributeError(f"fields have no {name!r}; there are {known}")


def fields_of(
    layers: Layers, needs: Sequence[str], at: tuple[AnyArray, AnyArray] | None = None
) -> dict[str, AnyArray]:
    """The fields that a look needs, [h, w] each; without those that the layers have none of.

    Args:
        at: column and row index of the pixels in the picture whose rays the layers know, if these
            are not all of it.

    Raises `InputError` naming a field that these layers cannot give.
    """
    need("layers", layers, Layers)
    found: dict[str, AnyArray] = {}
    if "width" in needs:
        found["width"] = air_width(layers)
    if "lit" in needs or "dark" in needs:
        lit, dark = layer_widths(layers)
        found |= {"lit": lit} if "lit" in needs else {}
        found |= {"dark": dark} if "dark" in needs and dark is not None else {}
    if "planet" in needs:
        if layers.planet is None:
            raise InputError(
                "layers: do not tell planet from space, which the look asks for (its field "
                "planet); give layers with a planet, or another look"
            )
        found["planet"] = jnp.asarray(layers.planet, jnp.asarray(layers.front).dtype)
    if "water" in needs and layers.water is not None:
        found["water"] = jnp.asarray(layers.water, jnp.asarray(layers.front).dtype)
    if any(name in OF_VIEW for name in needs):
        found |= _places(layers, needs, at)
    return {name: found[name] for name in needs if name in found}


def _places(
    layers: Layers, needs: Sequence[str], at: tuple[AnyArray, AnyArray] | None
) -> dict[str, AnyArray]:
    """Where on the ray and how high the air is.

    Twin: `main` in `combine.frag`.
    """
    view, front = layers.view, jnp.asarray(layers.front)
    if view is None:
        asked = next(name for name in needs if name in OF_VIEW)
        raise InputError(
            "layers: do not tell how rays pass the planet, which the look asks for (its field "
            f"{asked}); give layers of a scene, a file that airlight wrote with its scene, or "
            "another look"
        )
    dtype = front.dtype
    # In float64 where the view is of plain numbers: heights are small differences of large ones.
    height, width = front.shape
    column, row = pixel_grid(height, width, np.float64) if at is None else at
    x, y = pixel_slopes(view, column, row)
    mx, my = ray_offsets(view.aim, column, row)
    squared, dd = squared_miss_distance(x, y, mx, my)
    xp = namespace(squared)
    impact, slant = safe_sqrt(squared), xp.sqrt(dd)
    nearest = view.depth - layers.reference - view.radius * (mx * x + my * y) / dd
    altitude = (squared - 1) / (impact + 1) * view.radius

    def here(value: Any) -> AnyArray:
        return jnp.broadcast_to(jnp.asarray(value, dtype), front.shape)

    def along(depth: AnyArray) -> AnyArray:
        return (depth - here(nearest)) * here(slant)

    back = jnp.asarray(layers.back)
    unit = layers.width_unit * (1.0 if layers.stretch is not None else slant)
    found = {
        "begin": along(front),
        "end": along(back),
        "altitude": here(altitude),
        "impact": here(impact * view.radius),
        "per_length": here(1 / unit),
        "shell": here((view.shell - 1) * view.radius),
    }
    if any(name in OF_EYE for name in needs):
        found |= {name: here(value) for name, value in _eye(view, x, y, slant).items()}
    if any(name in FACES_SUN for name in needs):
        if not view.cones:
            asked = next(name for name in needs if name in FACES_SUN)
            raise InputError(
                "layers: do not tell where the sun is, which the look asks for (its field "
                f"{asked}); give the scene a sun, or use another look"
            )
        right, up, ahead = view.cones[0].axes[2]
        towards = x * right + y * up + ahead
        nearest_point = (mx * x + my * y) / dd
        sunward = mx * right + my * up - nearest_point * towards
        found |= {"sunward": here(sunward * view.radius), "sun_cos": here(towards / slant)}
        for name, place in UNDER_SUN.items():
            distance = jnp.sqrt(found["impact"] ** 2 + found[place] ** 2)
            upward = found["sunward"] + found[place] * found["sun_cos"]
            found[name] = upward / jnp.where(distance > 0, distance, 1)
    found |= {name: along(depth) for name, depth in _shadow(layers, needs).items()}
    return found


def _shadow(layers: Layers, needs: Sequence[str]) -> dict[str, AnyArray]:
    """Depths of the shadow in the air, if it is asked for and there is one."""
    front, back = jnp.asarray(layers.front), jnp.asarray(layers.back)
    begin, until = layers.shadow_front, layers.shadow_back
    if not ("dark_begin" in needs or "dark_end" in needs) or begin is None or until is None:
        return {}
    if np.ndim(begin) > front.ndim:
        raise InputError(
            f"layers: hold {len(begin)} shadows, and the look asks where in the air the shadow is "
            "(its field dark_begin); remove the occluders, or use another look"
        )
    return {
        "dark_begin": jnp.clip(begin, front, back),
        "dark_end": jnp.clip(until, front, back),
    }


def straight_down(view: View) -> tuple[AnyArray, Scalar]:
    """Unit vector from the camera to the planet's centre in eye axes, and how far it is, radii."""
    center = view.aim.center
    xp = namespace(center)
    distance = xp.sqrt(xp.sum(center * center))
    return center / distance, distance


def horizon(distance: Scalar, size: Scalar) -> AnyArray:
    """Cosine of the angle between straight down and a sphere's horizon; 0 at it and inside."""
    xp = namespace(distance, size)
    outside = distance > size
    squared = (distance - size) * (distance + size) / (distance * distance)
    return xp.where(outside, safe_sqrt(xp.where(outside, squared, 1.0)), 0.0)


def _eye(view: View, x: AnyArray, y: AnyArray, slant: AnyArray) -> dict[str, Any]:
    """Where the camera is.

    Twin: `main` in `combine.frag`, and `_eye_uniforms`.
    """
    down, distance = straight_down(view)
    sun = view.cones[0].axes[2] if view.cones else None
    above = {} if sun is None else {"eye_sun_cos": -sum(down[k] * sun[k] for k in range(3))}
    return above | {
        "nadir_cos": (down[0] * x + down[1] * y + down[2]) / slant,
        "radius": view.radius,
        "eye_height": (distance - 1) * view.radius,
        "ground_horizon": horizon(distance, view.planet),
        "shell_horizon": horizon(distance, view.shell),
    }


def uses_shadow(needs: Sequence[str]) -> bool:
    """Whether shadows have to be drawn and read for a look."""
    return any(FIELDS[name].of_shadow for name in needs)


def only_needed(layers: Layers, needs: Sequence[str]) -> Layers:
    """The layers without shadows that a look does not ask for: it knows no edges of theirs."""
    if layers.shadow_front is None or uses_shadow(needs):
        return layers
    return replace(layers, shadow_front=None, shadow_back=None)


def air_width(layers: Layers) -> Width:
    """Width of air along each pixel's ray, lit or not, in units of `layers.width_unit`."""
    front = jnp.asarray(layers.front)
    return _in_units(jnp.asarray(layers.back) - front, layers)


def layer_widths(layers: Layers) -> tuple[Width, Width | None]:
    """Lit and shadowed width of air along each pixel's ray, in units of `layers.width_unit`.

    Returns:
        `(lit, dark)`; `dark` is `None` when the layers have no shadow. Both are along the camera's
        axis (eye depth), as in the paper, unless the layers bring a `stretch`. `lit + dark` is the
        width of the air; rounding can make either negative by an ulp of the depths. What several
        shadows cover counts once.

    Twin: `layer_widths` in `fields.glsl`.
    """
    need("layers", layers, Layers)
    lit, dark = _depth_widths(layers)
    return _in_units(lit, layers), None if dark is None else _in_units(dark, layers)


def _in_units(width: Width, layers: Layers) -> Width:
    dtype = jnp.asarray(layers.front).dtype
    if layers.stretch is not None:
        width = width * jnp.asarray(layers.stretch, dtype)
    return width / jnp.asarray(layers.width_unit, dtype)


def _depth_widths(layers: Layers) -> tuple[Width, Width | None]:
    """Widths along the camera's axis, scene length units."""
    front, back = jnp.asarray(layers.front), jnp.asarray(layers.back)
    if layers.shadow_front is None or layers.shadow_back is None:
        return back - front, None
    if np.ndim(layers.shadow_front) > back.ndim:
        return _union_widths(front, back, layers.shadow_front, layers.shadow_back)
    shadow_back = jnp.minimum(jnp.maximum(layers.shadow_back, front), back)
    shadow_front = jnp.minimum(jnp.maximum(layers.shadow_front, front), back)
    lit = (back - shadow_back) + (shadow_front - front)
    return lit, shadow_back - shadow_front


def _union_widths(
    front: Depth, back: Depth, shadow_front: Shadows, shadow_back: Shadows
) -> tuple[Width, Width]:
    """Lengths between front and back, outside and inside the union of the shadows.

    From front to back, each shadow adds what lies beyond all that ended before; summing parts
    instead of subtracting lengths from the whole leaves nothing to cancel.
    """
    front, back = front[None], back[None]
    begin, end = (jnp.clip(depth, front, back) for depth in (shadow_front, shadow_back))
    order = jnp.argsort(begin, axis=0)
    begin, end = (jnp.take_along_axis(depth, order, axis=0) for depth in (begin, end))
    reached = jax.lax.cummax(end, axis=0)
    before = jnp.concatenate([front, reached[:-1]])
    lit = jnp.sum(jnp.maximum(begin - before, 0), axis=0) + (back[0] - reached[-1])
    dark = jnp.sum(jnp.maximum(end - jnp.maximum(begin, before), 0), axis=0)
    return lit, dark
