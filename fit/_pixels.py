"""Which pixels can tell something, and why the others cannot.

A pixel counts when air lies in front of space, or in front of the planet where the layers say what
the planet looks like. What is left is handed on as tiles of float64 numbers of bounded size.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Bool, Float

from model_jax import InputError, Layers, layer_widths

from ._photo import Photo

TILE = 16384
"""Pixels of a tile: six float64 columns of it are 0.8 MB, the size of a core's cache."""


@dataclass(frozen=True)
class Pixels:
    """The choice of pixels. `used.sum() + sum(excluded.values()) == used.size`."""

    used: Bool[np.ndarray, "h w"]
    """True where a pixel takes part in the fit."""
    excluded: dict[str, int]
    """Reason → pixels; each pixel once, under the first reason that applies; no zero counts."""
    remarks: tuple[tuple[str, str], ...]
    """(what, why) of what could not be taken into account."""

    @property
    def count(self) -> int:
        return int(self.used.sum())


@dataclass(frozen=True)
class Tile:
    """Some of the used pixels, float64. Widths in `width_unit`s, light linear."""

    lit: Float[np.ndarray, " n"]
    dark: Float[np.ndarray, " n"]
    """Zero where the layers have no shadow."""
    light: Float[np.ndarray, "n 3"]
    """Photo minus surface."""
    half_step: Float[np.ndarray, "n 3"] | None
    """Half a code step of the photo; None for float photos."""


def as_picture(photo: Photo | np.ndarray | jax.Array) -> np.ndarray:
    """Linear light [h, w, 3] of a photo or an array of floats, as it is stored.

    Raises:
        InputError: an array of another shape, or of whole numbers (codes, not light).
    """
    picture = photo.linear if isinstance(photo, Photo) else np.asarray(photo)
    if picture.ndim != 3 or picture.shape[2] != 3:
        raise InputError(f"photo: has the shape {picture.shape}; it must be [height, width, 3]")
    if picture.dtype.kind != "f":
        raise InputError(
            f"photo: holds {picture.dtype} numbers, not linear light; "
            "load it with load_photo or convert it to float"
        )
    return picture


def choose_pixels(photo: Photo | np.ndarray | jax.Array, layers: Layers) -> Pixels:
    """The pixels that a fit uses.

    Excluded, in this order: "no air"; "planet without a surface layer"; what the photo itself
    excludes ("masked", "not finite", "saturated"); "layers not finite". Layers that do not know
    where the planet is, and bring no surface, use all pixels with air, with a remark.

    Raises:
        InputError: photo and layers differ in size; a photo of a wrong shape or type.
    """
    picture = as_picture(photo)
    size, layers_size = picture.shape[:2], np.shape(layers.front)
    if size != layers_size:
        raise InputError(
            f"photo: is {size[1]}×{size[0]}, the layers are {layers_size[1]}×{layers_size[0]}; "
            "render the layers in the photo's size"
        )
    remarks: list[tuple[str, str]] = []
    on_planet = np.zeros(size, dtype=bool)
    if layers.surface is None:
        if layers.planet is None:
            why = "the layers do not tell planet from space, so all pixels with air are used"
            remarks.append(("choice of sky pixels", why))
        else:
            on_planet = np.asarray(layers.planet) != 0
    reasons = {
        "no air": ~np.asarray(layers.has_air),
        "planet without a surface layer": on_planet,
        **_photo_reasons(photo, picture),
        "layers not finite": ~_finite(layers),
    }
    used = np.ones(size, dtype=bool)
    excluded: dict[str, int] = {}
    for reason, where in reasons.items():
        if count := int((used & where).sum()):
            excluded[reason] = count
        used &= ~where
    return Pixels(used, excluded, tuple(remarks))


def tiles(
    photo: Photo | np.ndarray | jax.Array, layers: Layers, used: Bool[np.ndarray, "h w"]
) -> Iterator[Tile]:
    """The used pixels, row by row, at most `TILE` at a time.

    The widths are `layer_widths` of the layers' depths taken to float64: from float32 layers they
    are the exact widths of the stored depths.
    """
    picture = as_picture(photo).reshape(-1, 3)
    half_steps = photo.quantisation if isinstance(photo, Photo) else None
    surface = None if layers.surface is None else np.asarray(layers.surface).reshape(-1, 3)
    unit = float(layers.width_unit)
    depths = [
        None if depth is None else np.asarray(depth).reshape(-1)
        for depth in (layers.front, layers.back, layers.shadow_front, layers.shadow_back)
    ]
    chosen = np.flatnonzero(used)
    for start in range(0, chosen.size, TILE):
        index = chosen[start : start + TILE]
        lit, dark = _widths([None if d is None else d[index] for d in depths], unit)
        light = picture[index].astype(np.float64)
        if surface is not None:
            light -= surface[index]
        steps = None
        if half_steps is not None:
            steps = half_steps.reshape(-1, 3)[index].astype(np.float64)
        yield Tile(lit, dark, light, steps)


_jit_widths = jax.jit(layer_widths)


def _widths(depths: list[np.ndarray | None], unit: float) -> tuple[np.ndarray, np.ndarray]:
    """Widths in float64 whatever JAX's setting, padded to one size so that JAX compiles once."""
    first = depths[0]
    assert first is not None
    n = first.size

    def padded(depth: np.ndarray | None) -> np.ndarray | None:
        if depth is None:
            return None
        row = np.zeros((1, TILE))
        row[0, :n] = depth
        return row

    with jax.enable_x64(True):
        front, back, shadow_front, shadow_back = (padded(depth) for depth in depths)
        assert front is not None
        assert back is not None
        lit, dark = _jit_widths(Layers(front, back, shadow_front, shadow_back, width_unit=unit))
        lit = np.asarray(lit)[0, :n]
        return lit, np.zeros_like(lit) if dark is None else np.asarray(dark)[0, :n]


def _photo_reasons(
    photo: Photo | np.ndarray | jax.Array, picture: np.ndarray
) -> dict[str, Bool[np.ndarray, "h w"]]:
    """Why the photo itself leaves pixels out.

    A `Photo` keeps one mask for all reasons. Which one it was is told from the light: what is
    neither broken nor at the highest code was masked.
    """
    broken = ~np.isfinite(picture).all(axis=-1)
    if not isinstance(photo, Photo):
        return {"not finite": broken}
    out = ~photo.valid
    brightest = np.zeros_like(out)
    if photo.excluded.get("saturated"):
        brightest = (picture >= np.max(picture[np.isfinite(picture)])).any(axis=-1)
    return {
        "masked": out & ~broken & ~brightest,
        "not finite": broken,
        "saturated": out,
    }


def _finite(layers: Layers) -> Bool[np.ndarray, "h w"]:
    """True where the fit can compute with the layers; an infinite shadow depth is clamped later."""
    finite = np.isfinite(np.asarray(layers.front)) & np.isfinite(np.asarray(layers.back))
    for shadow in (layers.shadow_front, layers.shadow_back):
        if shadow is not None:
            finite &= ~np.isnan(np.asarray(shadow))
    if layers.surface is not None:
        finite &= np.isfinite(np.asarray(layers.surface)).all(axis=-1)
    return finite
