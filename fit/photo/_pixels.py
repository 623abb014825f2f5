"""Which pixels can tell something, and why the others cannot.

A pixel counts when air lies in front of space, or in front of the planet where the layers say what
the planet looks like. `_columns` takes what is chosen in numbers.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from model_jax import InputError, Layers

from .._choices import Sampling, Where
from ._columns import PhotoLike, as_picture, size_of
from ._photo import REASONS, Photo
from ._stencil import SKY, heights_above_limb, known_view


@dataclass(frozen=True)
class Pixels:
    """The choice of pixels of a photo. `used.sum() + sum(excluded.values()) == used.size`."""

    used: Bool[np.ndarray, "h w"]
    """True where a pixel takes part in the fit."""
    edges: Bool[np.ndarray, "h w"]
    """Pixels that would, were they not on an edge."""
    excluded: dict[str, int]
    """Reason → pixels; each pixel once, under the first reason that applies; no zero counts."""
    remarks: tuple[tuple[str, str], ...]
    """(what, why) of what could not be taken into account."""

    @property
    def count(self) -> int:
        return int(self.used.sum())


UNKNOWN_SURFACE = "planet without a surface layer"
"""Why pixels in front of a planet are left out of which the layers do not tell the light."""

LEAST_INSIDE = 0.25
"""Share of the air's pixels that must be left without those on edges, or these are kept."""

_ROUNDINGS = 4
"""Roundings up to which two depths are one."""


def choose_pixels(
    photo: PhotoLike,
    layers: Layers,
    sampling: Sampling = "area",
    where: Where = "all",
    *,
    blurs: bool = False,
) -> Pixels:
    """The pixels that a fit uses.

    The ring is air in front of space; "sky" is the ring, and space up to `SKY` pixels beyond it.
    Of a photo that `blurs` no pixel in front of the planet is used, for blur is known of the limb
    only, and "all" is "sky"; the planet's limb and the edge of the air are then no edges, but what
    tells the blur.

    Excluded, in this order: "no air", of the sky "far from the air"; of ring and sky "in front of
    the planet", else "planet without a surface layer"; of the "planet" that is "in front of space";
    of a photo sampled by area "planet's limb", "edge of the air" and "edge of the shadow", for
    layers know the light in the pixel's middle; what the photo itself excludes ("masked", "not
    finite"); "layers not finite". Layers that do not know where the planet is, and bring no
    surface, use all pixels with air, and air that is hardly more than edges keeps these; both with
    a remark.

    Raises:
        InputError: photo and layers differ in size; a photo of a wrong shape or type; ring, sky or
            planet asked for of layers that do not know where the planet is; sky or a blur of layers
            without a view; a blur, and the planet asked for.
    """
    if blurs and where == "planet":
        raise InputError(
            "where: 'planet' asks for pixels of which a fit with a blur uses none; give 'sky' or "
            "'ring', or a response without blur"
        )
    where = "sky" if blurs and where == "all" else where
    size, layers_size = size_of(photo), np.shape(layers.front)
    if size != layers_size:
        raise InputError(
            f"photo: is {size[1]}×{size[0]}, the layers are {layers_size[1]}×{layers_size[0]}; "
            "render the layers in the photo's size"
        )
    remarks: list[tuple[str, str]] = []
    asked = "response.blur" if blurs else "where: 'sky'"
    reasons = _airless(layers, where, asked) | _elsewhere(layers, where)
    if layers.surface is None and layers.planet is None:
        why = "the layers do not tell planet from space, so all pixels with air are used"
        remarks.append(("choice of sky pixels", why))
    edges: dict[str, np.ndarray] = {}
    if sampling == "area":
        edges = edges_of(layers)
        if blurs:
            edges = {name: part for name, part in edges.items() if name == "edge of the shadow"}
        air = ~np.logical_or.reduce(list(reasons.values()))
        inside = air & ~np.logical_or.reduce(list(edges.values()))
        if inside.sum() >= LEAST_INSIDE * air.sum():
            reasons |= edges
        else:
            edges = {}
            why = (
                "hardly a pixel of air is without an edge; these count as if sampled in the middle"
            )
            remarks.append(("averaging on edges", why))
    if isinstance(photo, Photo):
        reasons |= {name: photo.reason == k + 1 for k, name in enumerate(REASONS)}
    else:
        reasons["not finite"] = ~np.isfinite(as_picture(photo)).all(axis=-1)
    reasons["layers not finite"] = ~_finite(layers)
    used = np.ones(size, dtype=bool)
    left_out = np.zeros(size, dtype=bool)
    excluded: dict[str, int] = {}
    for reason, there in reasons.items():
        here = used & there
        if count := int(here.sum()):
            excluded[reason] = count
        if reason in edges:
            left_out |= here
        else:
            left_out &= ~there
        used &= ~there
    return Pixels(used, left_out, excluded, tuple(remarks))


def _airless(layers: Layers, where: Where, asked: str) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Pixels that no air, or none near enough, is in."""
    none = ~np.asarray(layers.has_air)
    if where != "sky":
        return {"no air": none}
    view = known_view(layers, asked)
    far = np.zeros(none.shape, bool)
    rows = max(1, 2**18 // none.shape[1])
    for start in range(0, none.shape[0], rows):
        row, column = np.nonzero(none[start : start + rows])
        height, top, _ = heights_above_limb(view, column * 1.0, row + start * 1.0)
        far[row + start, column] = height > top + SKY
    return {"far from the air": far & none}


def _elsewhere(layers: Layers, where: Where) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Pixels with another thing behind their air than is asked for or known."""
    if layers.planet is None:
        if where != "all":
            raise InputError(
                f"where: {where!r} asks where the planet is, which the layers do not tell; give "
                "layers with a planet mask (planet.A in a file), or 'all'"
            )
        return {}
    planet = np.asarray(layers.planet) != 0
    if where in ("ring", "sky"):
        return {"in front of the planet": planet}
    found = {} if layers.surface is not None else {UNKNOWN_SURFACE: planet}
    return found if where == "all" else found | {"in front of space": ~planet}


def edges_of(layers: Layers) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Pixels that an edge runs through, by what it is the edge of.

    Of a straight edge through a pixel's square, the middle of the pixel or of a neighbour beside or
    above it lies on the other side.
    """
    kinds = {"edge of the air": [np.asarray(layers.has_air)]}
    if layers.planet is not None:
        kinds = {"planet's limb": [np.asarray(layers.planet) != 0]} | kinds
    if layers.has_shadow:
        kinds["edge of the shadow"] = _shade(layers)
    known = _finite(layers)
    return {
        name: np.logical_or.reduce([_border(part, known) for part in parts])
        for name, parts in kinds.items()
    }


def _shade(layers: Layers) -> list[Bool[np.ndarray, "h w"]]:
    """Where some of the air is in each body's shadow, and where all of it is."""
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    begin, until = np.asarray(layers.shadow_front), np.asarray(layers.shadow_back)
    with np.errstate(invalid="ignore"):
        rounding = _ROUNDINGS * np.finfo(front.dtype).eps * np.abs(back)
        some = np.minimum(back, until) - np.maximum(front, begin) > rounding
        all_of = (begin < front + rounding) & (until > back - rounding)
    air = np.asarray(layers.has_air)
    return [air & one for part in (some, all_of) for one in part.reshape(-1, *air.shape)]


def _border(
    part: Bool[np.ndarray, "h w"], known: Bool[np.ndarray, "h w"]
) -> Bool[np.ndarray, "h w"]:
    """Pixels beside one of the other kind, and that one; of those that are known."""
    found = np.zeros(part.shape, bool)
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        differ = (part[a] != part[b]) & known[a] & known[b]
        found[a] |= differ
        found[b] |= differ
    return found


def _finite(layers: Layers) -> Bool[np.ndarray, "h w"]:
    """True where the fit can compute with the layers; an infinite shadow depth is clamped later."""
    finite = np.isfinite(np.asarray(layers.front)) & np.isfinite(np.asarray(layers.back))
    for shadow in (layers.shadow_front, layers.shadow_back):
        if shadow is not None:
            unknown = np.isnan(np.asarray(shadow))
            finite &= ~unknown.reshape(-1, *finite.shape).any(axis=0)
    if layers.surface is not None:
        finite &= np.isfinite(np.asarray(layers.surface)).all(axis=-1)
    if layers.stretch is not None:
        finite &= np.isfinite(np.asarray(layers.stretch))
    return finite
