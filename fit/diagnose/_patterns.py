"""What the usual causes of misfit would leave over, each as a few columns of light."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from model_jax._fields import WIDTHS

from ..photo._columns import Columns


@dataclass(frozen=True)
class Patch:
    """The pixels of one photo that are looked at."""

    columns: Columns
    size: tuple[int, int]
    light: Float[np.ndarray, "m 3"]
    """As predicted."""
    beside: Float[np.ndarray, "4 m 3"]
    """The same of the pixels to the left and right, above and below; NaN where it is not known."""

    @property
    def place(self) -> tuple[Float[np.ndarray, "m 1"], Float[np.ndarray, "m 1"]]:
        """Right and down of the picture's centre; 1 is half its diagonal."""
        row, column = np.divmod(self.columns.index, self.size[1])
        half = np.hypot(*self.size) / 2
        right = (column - (self.size[1] - 1) / 2) / half
        down = (row - (self.size[0] - 1) / 2) / half
        return right[:, None], down[:, None]


Pattern = Callable[[Patch], list[Float[np.ndarray, "m 3"]]]
"""What a cause adds, by its amounts."""


def _tone(patch: Patch) -> list[np.ndarray]:
    bright = np.maximum(patch.light, 0)
    top = np.nanmax(bright, initial=1e-300)
    share = bright / top
    return [bright * np.log(np.maximum(share, 1e-6)), bright * share]


def _places(patch: Patch) -> list[np.ndarray]:
    right, down = patch.place
    return [right, down, right**2, right * down, down**2]


def _vignette(patch: Patch) -> list[np.ndarray]:
    return [patch.light * place for place in _places(patch)]


def _stray(patch: Patch) -> list[np.ndarray]:
    level = np.full(patch.light.shape, rms(patch.light))
    return [level * place for place in _places(patch)]


def _air(patch: Patch) -> list[np.ndarray]:
    found = []
    for name in WIDTHS:
        width = patch.columns.fields.get(name)
        if width is not None and width.any():
            found.append(patch.light * (width / width.max())[:, None])
    height = patch.columns.fields.get("altitude")
    if height is not None and height.any():
        found.append(patch.light * (height / np.abs(height).max())[:, None])
    return found


def _edges(patch: Patch) -> list[np.ndarray]:
    """Derivatives by place: a shift right and down, and a blur along each. 0 beside what is not
    known."""
    left, right, above, below = patch.beside
    twice = 2 * patch.light
    parts = (right - left) / 2, (below - above) / 2, left + right - twice, above + below - twice
    return [np.nan_to_num(part) for part in parts]


def pixel_average(patch: Patch) -> np.ndarray:
    """What a mean over a pixel's square is more than the light in its middle.

    Of light that is bent as a parabola: a place's variance in the square, 1/12 along each side,
    times half the second derivative.
    """
    bend = patch.beside.sum(axis=0) - 4 * patch.light
    return np.asarray(np.nan_to_num(bend) / 24)


def _colour(patch: Patch) -> list[np.ndarray]:
    level = rms(patch.light)
    found = []
    for k in range(2):
        own = np.arange(3) == k
        found += [patch.light * own, np.broadcast_to(level * own, patch.light.shape)]
    return found


CAUSES: dict[str, tuple[str, Pattern]] = {
    "tone": ("how bright it is (another tone curve, or air that is no uniform slab)", _tone),
    "air": ("how thick the air is (air that is no uniform slab, or another tone curve)", _air),
    "vignette": (
        "a brightness that changes with the place (a vignette, or air that is lit unevenly)",
        _vignette,
    ),
    "stray": ("a background that changes with the place (stray light)", _stray),
    "edges": ("edges (layers shifted against the photo, or blur)", _edges),
    "colour": ("colour (of the air or the background, which was not fitted)", _colour),
}
"""Name, what light that is left over goes with, and what that looks like."""


def rms(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known.astype(np.float64) ** 2))) if known.size else 0.0
