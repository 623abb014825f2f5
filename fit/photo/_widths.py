"""Fields of a photo's pixels, in pieces of one size."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from model_jax import InputError, Layers
from model_jax._analytic import trace, trace_view
from model_jax._fields import OF_RAYS, OF_VIEW, fields_of, uses_shadow
from model_jax._shapes import AnyArray
from model_jax._view import pixel_slopes

from .._compile import float64

_CHUNK = 65536
"""Pixels at once: half a megabyte for each array on the way."""
_jit_fields = partial(jax.jit, static_argnames="needs")(fields_of)


def fields_at(
    layers: Layers, index: np.ndarray, unit: float, needs: Sequence[str]
) -> dict[str, Float[np.ndarray, " n"]]:
    """Fields in float64 whatever JAX's setting, in pieces of one size so that JAX compiles once.

    Raises `InputError` naming a field that the layers cannot give.
    """
    found: dict[str, np.ndarray] = {}

    def part(depth: AnyArray, chosen: np.ndarray) -> np.ndarray:
        """Depths [1, chunk] of the chosen pixels, or of several shadows [n, 1, chunk]."""
        several = depth.shape[:-2]
        row = np.zeros((*several, 1, _CHUNK))
        row[..., 0, : chosen.size] = np.asarray(depth).reshape(*several, -1)[..., chosen]
        return row

    # Only where they are asked for: programs of other looks stay as they are.
    view = layers.view if any(name in OF_VIEW for name in needs) else None
    width = np.shape(layers.front)[1]
    shadows = [s for s in (layers.shadow_front, layers.shadow_back) if s is not None]
    shadows = shadows if uses_shadow(needs) else []
    maps = {"stretch": layers.stretch}
    maps |= {name: getattr(layers, name) for name in ("planet", "water") if name in needs}
    with float64():
        for start in range(0, max(index.size, 1), _CHUNK):  # of no pixels their names are told
            end = min(start + _CHUNK, index.size)
            chosen = index[start:end]
            front, back = part(layers.front, chosen), part(layers.back, chosen)
            begin, until = [part(s, chosen) for s in shadows] or (None, None)
            more: dict[str, Any] = {
                name: None if m is None else part(m, chosen) for name, m in maps.items()
            }
            piece = Layers(front, back, begin, until, width_unit=unit, **more)
            piece = replace(piece, view=view, reference=layers.reference)
            at = None if view is None else np.divmod(_row(chosen), width)[::-1]
            for name, field in _jit_fields(piece, needs=tuple(needs), at=at).items():
                whole = found.setdefault(name, np.empty(index.size))
                whole[start:end] = np.asarray(field)[0, : end - start]
    return found


def with_shadows(layers: Layers) -> Layers:
    """The layers with the shadow that their view knows of, where they were drawn for a look that
    asks for none."""
    view = layers.view
    if layers.has_shadow or view is None or not view.cones:
        return layers
    *_, begin, until = trace_view(view, *np.shape(layers.front))
    center = float(view.depth) - float(layers.reference)
    depths = [np.asarray(depth) * float(view.radius) + center for depth in (begin, until)]
    return replace(layers, shadow_front=depths[0], shadow_back=depths[1])


def fields_between(
    layers: Layers,
    places: tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]],
    unit: float,
    needs: Sequence[str],
    *,
    ground: bool,
) -> dict[str, Float[np.ndarray, " n"]]:
    """Fields at columns and rows between pixels too, of rays that the ground ends, or of rays that
    pass as if there were none. Where there is no air, all that tells of it is 0.

    Exact, whatever drew the layers, whose view must be known.
    """
    assert layers.view is not None
    if "water" in needs and layers.water is not None:
        raise InputError(
            "response.blur: light between pixels is not known of water, which the look mirrors the "
            "sun by; leave out the blur, or that term"
        )
    view, (column, row) = layers.view, places
    shaded = layers.has_shadow and uses_shadow(needs)
    planet = view.planet if ground else 0.0
    beyond = replace(view, planet=planet, cones=view.cones if shaded else ())
    found: dict[str, np.ndarray] = {}
    with float64():
        for start in range(0, max(column.size, 1), _CHUNK):
            end = min(start + _CHUNK, column.size)
            at = np.zeros((2, 1, _CHUNK))
            at[:, 0, : end - start] = column[start:end], row[start:end]
            front, back, hit, *shadow = (np.asarray(p) for p in trace(beyond, *at))
            begin, until = [s * view.radius for s in shadow] or (None, None)
            stretch = None
            if layers.stretch is not None:
                x, y = pixel_slopes(view, *at)
                stretch = np.sqrt(1 + x * x + y * y)
            piece = Layers(
                front * view.radius,
                back * view.radius,
                begin,
                until,
                planet=hit,
                stretch=stretch,
                width_unit=unit,
                reference=view.depth,
                view=view,
            )
            fields = _jit_fields(piece, needs=tuple(needs), at=tuple(at))
            for name, field in fields.items():
                whole = found.setdefault(name, np.empty(column.size))
                here = np.asarray(field)[0, : end - start]
                if name not in OF_RAYS:
                    here = np.where((front != back)[0, : end - start], here, 0)
                whole[start:end] = here
    return found


def _row(chosen: Int[np.ndarray, " n"]) -> Float[np.ndarray, "1 chunk"]:
    """Flat indices of a piece, 0 where it is not filled."""
    row = np.zeros((1, _CHUNK))
    row[0, : chosen.size] = chosen
    return row


def rounding_of_widths(layers: Layers, used: Bool[np.ndarray, "h w"], unit: float) -> float:
    """Four depths enter a width, each off by half an ulp of the largest at most."""
    if not used.any():
        return 0.0
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    depth = max(float(np.abs(front[used]).max()), float(np.abs(back[used]).max()))
    if layers.stretch is not None:
        depth *= float(np.asarray(layers.stretch)[used].max())
    return 2.0 * float(np.finfo(front.dtype).eps) * depth / unit
