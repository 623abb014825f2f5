"""TIFF files: the first page as an array, checked; photos and maps are read from it."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Shaped

from model_jax._errors import InputError

_TAGS = (274, 301, 319, 34675)
"""Orientation, transfer function, primaries and ICC profile."""


class Page(NamedTuple):
    """The first page of a TIFF."""

    samples: Shaped[np.ndarray, "h w c"]
    """As stored: colours, then whatever else there is."""
    bits: int
    """Bits of a sample."""
    colours: int
    """1 or 3."""
    extra: tuple[str, ...]
    """What follows the colours, in the standard's words, such as "UNASSALPHA"."""
    white_is_zero: bool
    lossy: bool
    """Whether it is compressed as JPEG is."""
    tags: Mapping[int, Any]
    """By number, of those that say how to show it."""


def read_page(path: Path, most_pixels: int) -> Page:
    """The first page of a TIFF.

    Raises `InputError` for a thumbnail, kinds of colour other than grey and RGB, samples of a mixed
    kind, more pixels than `most_pixels`, and missing parts; decoders raise anything on damage.
    """
    import tifffile  # a quarter of a second to import, and only here

    with tifffile.TiffFile(path) as tiff:
        page: Any = tiff.pages[0]
        check_size(path, (page.imagewidth, page.imagelength), most_pixels)
        if page.is_reduced:
            raise InputError(f"{path}: holds a thumbnail first, as raw files do; export it as TIFF")
        photometric = tifffile.PHOTOMETRIC(page.photometric).name
        lossy = page.compression == tifffile.COMPRESSION.JPEG
        jpeg_colour = photometric == "YCBCR" and lossy
        if photometric not in ("RGB", "MINISBLACK", "MINISWHITE") and not jpeg_colour:
            raise InputError(f"{path}: is a {photometric} TIFF; convert it to grey or RGB")
        if page.dtype is None:
            raise InputError(f"{path}: its samples are of a mixed kind; save it with 8 or 16 bits")
        # A segment that is missing, past the end, or of no bytes would be filled in with zeros.
        size = path.stat().st_size
        segments = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        if len(segments) < math.prod(page.chunked) or any(
            count == 0 or offset + count > size for offset, count in segments
        ):
            raise InputError(
                f"{path}: parts of its first page are missing, or cut off after {size} bytes; "
                "copy or export it again"
            )
        samples, axes = page.asarray(), page.axes
        if sorted(axes.replace("S", "")) != ["X", "Y"]:
            raise InputError(f"{path}: its first page has axes {axes}; save one flat picture")
        if "S" in axes:
            samples = np.moveaxis(samples, axes.index("S"), -1)
        return Page(
            samples=samples.reshape(*samples.shape[:2], -1),
            bits=int(page.bitspersample),
            colours=3 if photometric in ("RGB", "YCBCR") else 1,
            extra=tuple(tifffile.EXTRASAMPLE(kind).name for kind in page.extrasamples),
            white_is_zero=photometric == "MINISWHITE",
            lossy=lossy,
            tags={number: page.tags.valueof(number) for number in _TAGS},
        )


def check_size(path: Path, size: tuple[int, ...], most_pixels: int) -> None:
    """Raise `InputError` for a picture without pixels, or with more than are read.

    Args:
        size: width and height.
    """
    width, height = size
    if width < 1 or height < 1:
        raise InputError(f"{path}: has {width}×{height} pixels; export it again")
    if width * height > most_pixels:
        raise InputError(
            f"{path}: {width}×{height} pixels are more than the {most_pixels} that are read; "
            "scale it down or crop it"
        )
