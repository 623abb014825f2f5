"""Columns: a photo's used pixels as the model sees them; `solve._samples` lays them out for the
solver.
"""

from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Int8, UInt

from model_jax import InputError, Layers, LayersLook, Look
from model_jax._composite import dims, need_surface

from ._photo import Photo
from ._stencil import Inside, Stencil, along_limb, light_inside, stencil_of
from ._widths import fields_at, rounding_of_widths

PhotoLike = Photo | np.ndarray | jax.Array


@dataclass(frozen=True)
class Columns:
    """The used pixels of one photo, float64; widths in `width_unit`s of the first photo."""

    index: Int[np.ndarray, " n"]
    """Flat index of each in its photo; row by row, but those with a clipped sample last. With a
    stencil along the limb instead."""
    fields: dict[str, Float[np.ndarray, " n"]]
    """What the look needs, by name, as far as the layers have it."""
    light: Float[np.ndarray, "n 3"]
    """What the photo recorded, float32 of codes; for a clipped sample the bound that it tells."""
    surface: Float[np.ndarray, "n 3"] | None
    """Light behind the air; None: there is none, or it is black."""
    clipped: Int8[np.ndarray, "n 3"] | None
    """1: at least this bright, -1: at most, 0: measured; None: all are measured."""
    color: Float[np.ndarray, "3"]
    width_error: float
    """Bound on the rounding of a width, from the layers' dtype and depths."""
    drawn_error: Float[np.ndarray, " n"] | None = None
    """How far each width may be off by what drew the layers; None where they are exact."""
    mix: Float[np.ndarray, "3 3"] | None = None
    """What each channel of a grey photo shows of red, green and blue. Channels that are copies of
    an earlier one have light 0 and no surface here. None where no channel is a copy."""
    dims: bool = False
    """The look dims the surface, which then is what it is, not what a grey photo shows of it."""
    stencil: Stencil | None = None
    """What the pixels see along a line across the limb, if the photo is blurred."""
    inside: Inside | None = None
    """Light of the planet that is blurred into them."""

    @property
    def copies(self) -> list[int]:
        """The channels that are copies of an earlier one."""
        if self.mix is None:
            return []
        return [k for k in range(3) if (self.mix[:k] == self.mix[k]).all(axis=1).any()]

    def part(self, chosen: Int[np.ndarray, " m"] | Bool[np.ndarray, " n"]) -> "Columns":
        """Some of the pixels."""

        def some(values: np.ndarray | None) -> Any:
            return None if values is None else values[chosen]

        return replace(
            self,
            index=self.index[chosen],
            fields={name: field[chosen] for name, field in self.fields.items()},
            light=self.light[chosen],
            surface=some(self.surface),
            clipped=some(self.clipped),
            drawn_error=some(self.drawn_error),
            stencil=None if self.stencil is None else self.stencil.part(chosen),
        )


def as_picture(photo: PhotoLike) -> np.ndarray:
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


def grey_spread(color: Float[np.ndarray, "3"]) -> float:
    """How much the light of coloured air in a grey photo hangs on how it was made grey.

    Relative to `LUMINANCE`'s: root mean square over the usual weights, of light and of codes.
    """
    light = _GREYS @ color
    codes = (_GREYS @ color ** (1 / _CODES)) ** _CODES
    own = LUMINANCE @ color
    if not own > 0:
        return 0.0
    return float(np.sqrt(np.mean((np.concatenate([light, codes]) / own - 1) ** 2)))


def size_of(photo: PhotoLike) -> tuple[int, int]:
    """Height and width. Raises as `as_picture`."""
    return photo.shape if isinstance(photo, Photo) else as_picture(photo).shape[:2]


def light_at(photo: PhotoLike, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Linear light of the pixels of flat indices."""
    if isinstance(photo, Photo):
        return photo.linear_at(index)
    return as_picture(photo).reshape(-1, 3)[index]


LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Shares of red, green and blue in linear light's luminance, ITU-R BT.709-6, table 3."""

_GREYS = np.array([[0.2126, 0.7152, 0.0722], [0.299, 0.587, 0.114], [1 / 3] * 3, [0.0, 1.0, 0.0]])
"""Weights that make pictures grey: luminance, luma (BT.601), the mean, the green channel."""
_CODES = 2.2
"""Power of the tone curve of codes, of which they are taken as often as of light."""


def planet_light(photo: PhotoLike, layers: Layers, width: float) -> Inside:
    """Light of the planet inside its limb in a photo with a blur.

    Args:
        width: the widest blur to be expected, px.

    Raises:
        InputError: the photo shows nothing of it.
    """
    if isinstance(photo, Photo):
        usable = photo.reason == 0
        light = photo.linear
    else:
        light = as_picture(photo)
        usable = np.isfinite(light).all(axis=-1)
    found = light_inside(light, usable, layers, width)
    if found is None:
        raise InputError(
            "response.blur: the photo shows no planet inside its limb, whose light a blur spreads; "
            "give a photo or a mask that does, or a response without blur"
        )
    return found


def take_columns(
    photo: PhotoLike,
    layers: Layers,
    used: Bool[np.ndarray, "h w"],
    width_unit: float,
    kind: type[Look] = LayersLook,
    inside: Inside | None = None,
) -> Columns:
    """The used pixels in numbers, for looks of a kind; of a blurred photo with the planet's light
    `inside` its limb.

    The fields are of the layers' depths taken to float64: from float32 layers widths are the exact
    ones of the stored depths. A sample at a photo's highest code is known to be at
    least the light half a code below it, one at code 0 at most the light half a code above.
    """
    need_surface(layers, kind)
    index = np.flatnonzero(used).astype(np.int32)  # `load_photo` reads fewer than 2^28
    if inside is not None:
        index = index[along_limb(layers, index)]
    clipped = None
    if isinstance(photo, Photo) and photo.codes is not None:
        clipped = _clipped(photo, photo.codes.reshape(-1, 3)[index])
        if not clipped.any():
            clipped = None
    if clipped is not None and inside is None:
        last = np.argsort(clipped.any(axis=1), kind="stable")
        index, clipped = index[last], clipped[last]
    light = light_at(photo, index)
    light = light.astype(np.result_type(light, np.float32), copy=False)
    if clipped is not None and isinstance(photo, Photo):
        light = _bounded(photo, light, clipped)
    air = np.asarray(layers.has_air)
    fields = fields_at(layers, index, width_unit, kind.NEEDS)
    if inside is not None:  # sky is among the pixels
        fields = {n: np.where(air.reshape(-1)[index], f, 0) for n, f in fields.items()}
    columns = Columns(
        index=index,
        fields=fields,
        light=light,
        surface=_surface_at(layers, index),
        clipped=clipped,
        color=np.asarray(layers.color, np.float64)[:3],
        width_error=rounding_of_widths(layers, used & air, width_unit),
        drawn_error=None
        if layers.width_error is None
        else np.asarray(layers.width_error).reshape(-1)[index] / width_unit,
        mix=_mix(light, clipped),
        dims=dims(kind),
        stencil=None
        if inside is None
        else stencil_of(layers, index, width_unit, kind.NEEDS, inside),
        inside=inside,
    )
    return columns if columns.mix is None else _without_copies(columns)


def unlit_columns(
    layers: Layers, index: Int[np.ndarray, " n"], like: Columns, width_unit: float
) -> Columns:
    """Any pixels of a photo of which `like` has the used ones, without light: for predictions.

    Where there is no air its fields are 0. With a stencil they come along the limb.
    """
    if like.inside is not None:
        index = index[along_limb(layers, index)]
    air = np.asarray(layers.has_air).reshape(-1)[index]
    with np.errstate(invalid="ignore"):
        fields = fields_at(layers, index, width_unit, tuple(like.fields))
    found = replace(
        like,
        index=index,
        fields={name: np.where(air, field, 0) for name, field in fields.items()},
        light=np.zeros((len(index), 3), like.light.dtype),
        surface=_surface_at(layers, index),
        clipped=None,
        drawn_error=None,
        stencil=None
        if like.inside is None
        else stencil_of(layers, index, width_unit, tuple(like.fields), like.inside),
    )
    return found if like.mix is None else _without_copies(found)


def _surface_at(layers: Layers, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"] | None:
    """Light behind the air of these pixels; None where there is none, which costs no time."""
    if layers.surface is None:
        return None
    surface = np.asarray(layers.surface).reshape(-1, 3)[index].astype(np.float64)
    return surface if surface.any() else None


def _mix(
    light: Float[np.ndarray, "n 3"], clipped: Int8[np.ndarray, "n 3"] | None
) -> Float[np.ndarray, "3 3"] | None:
    """What each channel shows of red, green and blue, if they are equal in all pixels.

    A picture made grey shows luminance; by which weights nobody knows, and `LUMINANCE` is taken.
    Of less than two pixels with light, not clipped, nothing is said.
    """
    measured = light if clipped is None else light[~clipped.any(axis=1)]
    if len(measured) < 2 or not measured.any() or not (light == light[:, :1]).all():
        return None
    return np.tile(LUMINANCE, (3, 1))


def _without_copies(columns: Columns) -> Columns:
    """Copies count once: the first channel of those that are equal."""
    assert columns.mix is not None
    own = np.isin(np.arange(3), columns.copies, invert=True)
    surface = columns.surface
    if surface is not None and not columns.dims:
        surface = surface @ columns.mix.T * own
    return replace(
        columns,
        light=columns.light * own.astype(columns.light.dtype),
        surface=surface,
        clipped=None if columns.clipped is None else columns.clipped * own.astype(np.int8),
    )


def with_codes(columns: Columns, photo: Photo, codes: UInt[np.ndarray, "n 3"]) -> Columns:
    """The columns as if the photo had stored these codes in the used pixels.

    Of columns without clipped samples none is taken as one.
    """
    assert photo.light is not None
    light = photo.light[codes]
    if columns.clipped is None:
        return replace(columns, light=light)
    clipped = _clipped(photo, codes)
    return replace(columns, light=_bounded(photo, light, clipped), clipped=clipped)


def _clipped(photo: Photo, codes: UInt[np.ndarray, "n 3"]) -> Int8[np.ndarray, "n 3"]:
    """Which samples are at the lowest or the highest code."""
    clipped = (codes == photo.top).astype(np.int8)
    clipped -= codes == 0
    return clipped


def _bounded(
    photo: Photo, light: Float[np.ndarray, "n 3"], clipped: Int8[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """The light, and the bound that it tells where it is clipped."""
    black, white = photo.limits
    return np.where(clipped > 0, white, np.where(clipped < 0, black, light))
