"""Equirectangular maps on disk: the planet's albedo and its relief, as float arrays.

Both have row 0 at the north pole and column 0 at -180 degrees of longitude.
"""

from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image

from model_jax import InputError, Srgb

from ._files import check_file


@cache
def load_albedo(path: str) -> Float[np.ndarray, "h w 3"]:
    """Linear reflectance in [0, 1] of an 8-bit sRGB picture, float16 (11 bits suffice for 8)."""
    stored = _picture(path, "RGB")
    table = np.asarray(Srgb().decode(np.arange(256) / 255.0), dtype=np.float16)
    return table[stored]


@cache
def load_relief(path: str) -> Float[np.ndarray, "h w"]:
    """Heights ≥ 0, float32: a picture's grey value in [0, 1], or the numbers of an .npy file.

    Negative heights (sea floor) become 0. Raises `InputError` for a missing or unreadable file,
    an array that is no map and heights that are not finite.
    """
    if Path(path).suffix == ".npy":
        try:
            heights = np.load(check_file(path), allow_pickle=False)
        except (ValueError, OSError, EOFError) as error:
            raise InputError(
                f"{path}: not a readable .npy array ({error}); save it again"
            ) from None
        if heights.ndim != 2 or heights.dtype.kind not in "fiu":
            raise InputError(
                f"{path}: has shape {heights.shape} of {heights.dtype}; "
                "a height map is numbers [h, w]"
            )
    else:
        heights = _picture(path, "I;16") / 65535.0
    if not np.all(np.isfinite(heights)):
        count = int(np.sum(~np.isfinite(heights)))
        raise InputError(f"{path}: {count} heights are not finite; fill them in")
    return np.maximum(heights, 0).astype(np.float32)


def _picture(path: str, mode: str) -> np.ndarray:
    file = check_file(path)
    try:
        with Image.open(file) as image:
            image.load()
            if mode == "RGB":
                return np.asarray(image.convert("RGB"))
            if image.mode.startswith("I;16"):
                return np.asarray(image, dtype=np.float64)
            return np.asarray(image.convert("L"), dtype=np.float64) * 257.0
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(f"{path}: not a readable picture ({error}); convert it to PNG") from None
