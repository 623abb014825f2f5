"""Pictures on disk as float arrays: the planet's albedo, relief and water, and a look's table.

Maps are equirectangular and have row 0 at the north pole and column 0 at -180 degrees of longitude.
A file is read by what it contains, not by its name, and as it is stored: an EXIF orientation does
not turn it.
"""

import os
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped
from PIL.JpegImagePlugin import JpegImageFile

from model_jax import InputError, Planet, Srgb

from ._exr import MAGIC as EXR
from ._exr import read_channels
from ._files import JPEG, PNG, TIFF, check_file, decoding
from ._tiff import check_size, read_page

MAX_PIXELS = 2**28
"""Largest map read, 32768×8192: a small damaged or hostile file can claim any size."""

_NPY = b"\x93NUMPY"


@cache
def load_albedo(path: str) -> Float[np.ndarray, "h w 3"]:
    """Linear reflectance in [0, 1] of an sRGB picture, float16 (relative rounding of 2^-11).

    PNG, TIFF or JPEG of at most 16 bits; grey becomes three equal channels, alpha is dropped.
    Raises `InputError` for a file that is missing, damaged or larger than `MAX_PIXELS`, for float
    and other numbers that are no sRGB codes, and for CMYK.
    """
    samples, top = _read(path)
    if top is None:
        raise InputError(
            f"{path}: holds {samples.dtype} numbers, which are no sRGB codes; "
            "save the albedo as a PNG of 8 or 16 bits"
        )
    table = np.asarray(Srgb().decode(np.arange(top + 1) / top), dtype=np.float16)
    return np.broadcast_to(table[samples], (*samples.shape[:2], 3))


def relief_heights(planet: Planet) -> Float[np.ndarray, "h w"]:
    """Heights ≥ 0 of the planet's relief, in planet radii, float32, before `relief_scale`.

    Raises `InputError` as `load_relief` does, and for heights that reach the planet's radius.
    """
    assert planet.relief is not None
    heights = load_relief(planet.relief)
    unit, radius = float(planet.relief_unit), float(planet.radius)
    row, column = _first_of_largest(heights)
    largest = float(heights[row, column])
    if largest * abs(unit) >= radius:
        raise InputError(
            f"{planet.relief}: its largest height, {largest:g} at row {row}, column {column}, is "
            f"{largest * unit:g} with planet.relief_unit = {unit:g}, as large as planet.radius = "
            f"{radius:g}; set planet.relief_unit to the length of the map's unit"
        )
    return heights * np.float32(unit / radius)


@cache
def load_relief(path: str) -> Float[np.ndarray, "h w"]:
    """Heights ≥ 0, float32, in units of `Planet.relief_unit`; negative ones (sea floor) become 0.

    Pictures of unsigned integers of at most 16 bits (PNG, JPEG, TIFF) give their codes over the
    highest code: black is 0, white is 1. Everything else gives its numbers as they are: TIFF of
    float, of signed or of 32-bit integers, EXR, and .npy of floats or integers of any size. RGB
    with equal channels is grey, alpha is dropped; of a TIFF the first page counts.

    Raises `InputError` for a file that is missing, damaged, of another kind or larger than
    `MAX_PIXELS`, for an array that is no map, for colour, and for heights that are not finite.
    """
    samples, top = _read(path)
    with np.errstate(over="ignore"):  # found below
        heights = samples.astype(np.float32)
    if top is not None:
        heights /= np.float32(top)
    lost = ~np.isfinite(heights)
    if lost.any():
        row, column, k = _first_of_largest(lost)
        raise InputError(
            f"{path}: {np.count_nonzero(lost)} of its heights are not finite, the first, "
            f"{samples[row, column, k]}, at row {row}, column {column}; fill them in"
        )
    coloured = heights != heights[..., :1]
    if coloured.any():
        row, column, _ = _first_of_largest(coloured)
        raise InputError(
            f"{path}: is a colour picture, {samples[row, column].tolist()} at row {row}, column "
            f"{column}; save heights as grey"
        )
    return np.maximum(heights[..., 0], 0)


@cache
def load_water(path: str) -> Float[np.ndarray, "h w"]:
    """How much of the ground mirrors, float16 in [0, 1]: the alpha channel of a PNG that has one,
    else a grey picture's codes over the highest, of PNG, JPEG and TIFF.

    Raises `InputError` as `load_relief`, for float numbers, and for colour without alpha.
    """
    samples, top = _read(path, "alpha")
    if top is None:
        raise InputError(
            f"{path}: holds {samples.dtype} numbers; save the mask of water as a grey PNG"
        )
    if (samples != samples[..., :1]).any():
        raise InputError(
            f"{path}: is a colour picture without alpha; save the mask of water as grey, or in the "
            "alpha channel of a PNG"
        )
    return (samples[..., 0] / np.float32(top)).astype(np.float16)


def _first_of_largest(values: Shaped[np.ndarray, "..."]) -> tuple[int, ...]:
    """Index of the largest value, or of the first that is true."""
    return tuple(map(int, np.unravel_index(np.argmax(values), values.shape)))


class _Stored(NamedTuple):
    """What a file holds."""

    samples: Shaped[np.ndarray, "h w c"]
    """One channel, or three of colour."""
    top: int | None
    """The highest code of a picture; None where samples are numbers."""


def load_gradient(path: str) -> Float[np.ndarray, "h w 4"]:
    """Red, green, blue and alpha of a look's table as stored, codes over the highest, float32.

    PNG, TIFF or JPEG of at most 16 bits; alpha is 1 where there is none, as in all but PNGs.
    Raises `InputError` for a file that is missing, damaged or larger than `MAX_PIXELS`, and for
    numbers that are no codes.
    """
    samples, top = _read(path, "all")
    if top is None:
        raise InputError(f"{path}: holds {samples.dtype} numbers; save the gradient as a PNG")
    values = samples.astype(np.float32) / np.float32(top)
    colours = 3 if values.shape[-1] >= 3 else 1
    alpha = values[..., colours:] if values.shape[-1] > colours else np.ones_like(values[..., :1])
    color = np.broadcast_to(values[..., :colours], (*values.shape[:2], 3))
    return np.concatenate([color, alpha], axis=-1)


Channels = Literal["colour", "alpha", "all"]


def _read(path: str, keep: Channels = "colour") -> _Stored:
    """What a file holds. Of a PNG with an alpha channel: the other channels, that alone, or all."""
    file = check_file(path)
    with open(file, "rb") as stream:
        start = stream.read(8)
    readers: tuple[tuple[bytes | tuple[bytes, ...], Callable[[Path], _Stored]], ...] = (
        (PNG, partial(_read_png, keep=keep)),
        (JPEG, _read_jpeg),
        (TIFF, _read_tiff),
        (EXR, _read_exr),
        (_NPY, _read_npy),
    )
    reader = next((reader for magic, reader in readers if start.startswith(magic)), None)
    if reader is None:
        raise InputError(
            f"{path}: is no PNG, JPEG, TIFF, EXR or .npy file; save it as one of these"
        )
    with decoding(file):
        return reader(file)


def _read_png(path: Path, keep: Channels) -> _Stored:
    import imagecodecs  # Pillow keeps 8 of the 16 bits of colour PNGs

    data = path.read_bytes()
    width, height = (int.from_bytes(data[k : k + 4], "big") for k in (16, 20))  # the first chunk's
    check_size(path, (width, height), MAX_PIXELS)
    samples = np.asarray(imagecodecs.png_decode(data))  # palettes looked up, 1 to 4 bits made 8
    samples = samples.reshape(height, width, -1)
    channels = samples.shape[-1]
    colours = 3 if channels >= 3 else 1  # the rest is alpha
    kept = {"colour": slice(colours), "alpha": slice(colours, None), "all": slice(None)}
    chosen = kept[keep if channels > colours else "colour"]
    return _Stored(samples[..., chosen], int(np.iinfo(samples.dtype).max))


def _read_jpeg(path: Path) -> _Stored:
    # By its class: `Image.open` warns of sizes that real maps have.
    with JpegImageFile(path) as image:
        check_size(path, image.size, MAX_PIXELS)
        if image.mode not in ("L", "RGB"):
            raise InputError(f"{path}: is {image.mode}; convert it to RGB")
        samples = np.asarray(image)
    return _Stored(samples.reshape(*samples.shape[:2], -1), 255)


def _read_tiff(path: Path) -> _Stored:
    page = read_page(path, MAX_PIXELS)
    samples = page.samples
    if samples.dtype.kind not in "buif":
        raise InputError(
            f"{path}: its samples are {samples.dtype}; save it with 8 or 16 bits or as float"
        )
    count = samples.shape[-1]
    if count != page.colours + len(page.extra) or page.extra not in ((), ("UNASSALPHA",)):
        raise InputError(
            f"{path}: has {count} samples a pixel, {page.colours} of colour and "
            f"{list(page.extra) or 'nothing'}; save one flat picture without alpha"
        )
    samples = samples[..., : page.colours]
    if samples.dtype.kind not in "bu" or page.bits > 16:
        return _Stored(samples, None)
    top = 2**page.bits - 1
    samples = samples.astype(np.uint16)
    return _Stored(top - samples if page.white_is_zero else samples, top)


def _read_exr(path: Path) -> _Stored:
    channels, _ = read_channels(path)
    names = sorted({*channels} - {"A"}, reverse=True)
    if len(names) != 1 and names != ["R", "G", "B"]:
        raise InputError(
            f"{path}: has the channels {sorted(channels)}; save heights as the only one"
        )
    check_size(path, channels[names[0]].shape[::-1], MAX_PIXELS)
    return _Stored(np.stack([channels[name] for name in names], axis=-1), None)


def _read_npy(path: Path) -> _Stored:
    """An array of any version of the format; its header is believed once the file's size agrees."""
    size = os.path.getsize(path)
    with open(path, "rb") as stream:
        # Version 3 differs from 2 in how names of fields are spelt, which maps do not have.
        form = np.lib.format
        first = form.read_magic(stream) == (1, 0)
        read_header = form.read_array_header_1_0 if first else form.read_array_header_2_0
        shape, by_columns, dtype = read_header(stream)
        if len(shape) != 2 or dtype.kind not in "fiu":
            raise InputError(
                f"{path}: has shape {shape} of {dtype}; a height map is numbers [h, w]"
            )
        check_size(path, shape[::-1], MAX_PIXELS)
        count = shape[0] * shape[1]
        if stream.tell() + count * dtype.itemsize > size:
            raise InputError(
                f"{path}: claims shape {shape} of {dtype}, which cannot be in {size} bytes; "
                "it is damaged or cut off: copy or save it again"
            )
        heights = np.fromfile(stream, dtype, count).reshape(shape, order="F" if by_columns else "C")
    return _Stored(heights[..., None], None)
