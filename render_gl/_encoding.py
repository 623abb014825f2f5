"""Whether depths are coded as somebody says they are.

The near side of the air is a sphere. Where a pixel's ray is (s·u, s·v, 1) and its eye depth z, a
sphere around c of radius r means z² (s² (u² + v²) + 1) − 2 z (s u cx + s v cy + cz) + c² − r² = 0,
which is linear in s², s cx, s cy, cz and c² − r²: neither field of view nor planet need be known. A
wrong decoding turns the sphere into something else, and shows how far from one it is.
"""

from collections.abc import Iterator
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from model_jax import DepthTextures, Encoding, InputError, linearize_depth

from ._files import PathLike

_FEWEST = 200
"""Pixels of air that tell a sphere from something else."""
_MOST = 20_000
"""Pixels that are looked at, at most, evenly chosen."""
_BETTER = 10.0
"""How much closer to a sphere another encoding must be. Wrong ones are 500 times as far off as the
right one and more in layers as exact as float32, 43 times in those of meshes of 20,000 triangles,
and 4 times in those of 2,000, of which this cannot tell."""
_WRONG = 1e-3
"""Misfit from which numbers in [0, 1] are no eye depths: float32 has 1e-6, the others 2e-3 up."""
_CONSTANTS = (1.0, *(10.0**k for k in range(-6, 4) if k))
"""C of logarithmic depths that are tried, the usual one first."""


def check_encoding(path: PathLike, textures: DepthTextures) -> None:
    """Raise `InputError` where another encoding makes a sphere of the air's near side, and the one
    that is given does not; and for eye depths that look like coded ones."""
    found = _misfit(textures)
    if found is None:
        return
    if textures.encoding == "linear":
        if found > _WRONG and np.nanmin(textures.front) >= 0 and np.nanmax(textures.back) <= 1:
            raise InputError(
                f"{path}: as eye depths, front.Z is no sphere's (off by {found:.1g} of its depths) "
                "and all are within 0 to 1, as coded depths are; give --near, --far and --encoding"
            )
        return
    others = {remedy: _misfit(other) for remedy, other in _others(textures)}
    remedy, better = min(
        ((name, off) for name, off in others.items() if off is not None),
        key=lambda other: other[1],
        default=("", np.inf),
    )
    if better * _BETTER < found:
        raise InputError(
            f"{path}: as {textures.encoding} depths, front.Z is no sphere's, as the air's is: off "
            f"by {found:.1g} of its depths, and by {better:.1g} with {remedy}; give that"
        )


def _others(textures: DepthTextures) -> Iterator[tuple[str, DepthTextures]]:
    """What the depths may be instead, and the options that say so."""
    far, constant = float(textures.far), float(textures.constant)
    coded: tuple[Encoding, ...] = ("window", "reversed")
    for encoding in coded:
        if encoding != textures.encoding:
            yield f"--encoding {encoding}", replace(textures, encoding=encoding)
        if far < np.inf:
            endless = replace(textures, encoding=encoding, far=np.inf)
            yield f"--encoding {encoding} --far inf", endless
    if far < np.inf:
        for other in _CONSTANTS:
            if textures.encoding != "log" or other != constant:
                told = "" if other == 1 else f" --constant {other:g}"
                yield (
                    f"--encoding log{told}",
                    replace(textures, encoding="log", constant=other),
                )


def _misfit(textures: DepthTextures) -> float | None:
    """How far the air's near side is from a sphere: median |Δz| over that of z about its median;
    None where too little is seen of it."""
    begin, end = np.asarray(textures.front), np.asarray(textures.back)
    # A camera inside the air sees it begin at the near plane.
    inside = (begin == 0) | (begin == 1) if textures.encoding != "linear" else False
    seen = np.isfinite(begin) & (begin != end) & ~np.asarray(inside)
    index = np.flatnonzero(seen)
    if len(index) < _FEWEST:
        return None
    index = index[:: -(-len(index) // _MOST)]
    height, width = begin.shape
    row, column = np.unravel_index(index, begin.shape)
    v, u = (row + 0.5 - height / 2) / width, (column + 0.5) / width - 0.5
    z = _eye_depth(begin.reshape(-1)[index], textures)
    usable = np.isfinite(z) & (z > 0)
    if usable.sum() < _FEWEST:
        return None
    u, v, z = u[usable], v[usable], z[usable]
    inverse = np.median(z) / z
    rows = np.stack([u * u + v * v, *(-2 * inverse * part for part in (u, v, 1.0)), inverse**2], -1)
    solution = np.linalg.lstsq(rows, -np.ones(len(z)), rcond=None)[0]
    slope = -2 * (u * solution[1] + v * solution[2] + solution[3]) + 2 * inverse * solution[4]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.abs((rows @ solution + 1) / slope * z / inverse)
    spread = float(np.median(np.abs(z - np.median(z))))
    return float(np.nanmedian(off)) / spread if spread > 0 else None


def _eye_depth(stored: Float[np.ndarray, " n"], textures: DepthTextures) -> Float[np.ndarray, " n"]:
    """In float64, on the host."""
    near, far, constant = (float(part) for part in (textures.near, textures.far, textures.constant))
    with jax.enable_x64(True):
        codes = stored.astype(np.float64)
        found = np.asarray(linearize_depth(codes, near, far, textures.encoding, constant))
    return found + float(textures.reference) if textures.encoding == "linear" else found
