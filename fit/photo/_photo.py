"""A reference photo: linear light, which of its pixels count, and its codes' steps.

`_read` makes one of a file. What follows (residuals, diagnosis) sees this record, never a file
format.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt, UInt8

from model_jax import InputError, Scene
from model_jax._tone import ToneCurve

REASONS = ("masked", "not finite")
"""Why a photo leaves a pixel out, in the order in which the reasons apply."""


@dataclass(frozen=True)
class Jpeg:
    """How a JPEG file was compressed: what it takes to do the same to another picture."""

    tables: tuple[tuple[int, ...], ...]
    """Steps of the 64 frequencies, for each component."""
    sampling: int
    """How colour is thinned out, in Pillow's numbers: 0 is 4:4:4, 1 is 4:2:2, 2 is 4:2:0."""
    orientation: int
    """By EXIF: pixels are compressed as stored, not as shown."""


@dataclass(frozen=True)
class Photo:
    """A photo: what is stored, and what it says of linear light.

    `bits` is the depth of the stored code, 32 for float.
    """

    path: Path
    stored: UInt[np.ndarray, "h w 3"] | Float[np.ndarray, "h w 3"]
    """Codes, or linear light of float photos."""
    reason: UInt8[np.ndarray, "h w"]
    """0: the pixel counts; else 1 + the index in `REASONS` of the first that applies."""
    tone_curve: ToneCurve
    bits: int
    light: Float[np.ndarray, " codes"] | None
    """Linear light of each code; None for float photos. Float32's relative rounding of 2^-24 is
    1/256 of half a step of a 16-bit code."""
    half_steps: Float[np.ndarray, " codes"] | None
    """Half a code step in linear light for each code; covers rounding to codes only, not JPEG's
    losses. None for float photos."""
    lossy: bool = False
    """Whether the file is compressed as JPEG is."""
    jpeg: Jpeg | None = None
    """How a JPEG file of a common kind was compressed; None for other files."""
    remarks: tuple[str, ...] = ()
    """What the file says of its colours that is not used, in sentences."""

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width."""
        return self.reason.shape

    @property
    def codes(self) -> UInt[np.ndarray, "h w 3"] | None:
        """As stored; None for float photos."""
        return None if self.light is None else self.stored

    @property
    def linear(self) -> Float[np.ndarray, "h w 3"]:
        """Linear light, float32: in [0, 1] for integer photos, as stored otherwise.

        Of codes it is made anew each time; large photos are better asked for parts.
        """
        return self[...]

    def __getitem__(self, part: Any) -> Float[np.ndarray, "..."]:
        """Linear light of a part, by what would index an array [h, w, 3]."""
        stored: np.ndarray = self.stored[part]
        return stored if self.light is None else self.light[stored]

    def linear_at(self, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Linear light of the pixels of flat indices."""
        stored: np.ndarray = self.stored.reshape(-1, 3)[index]
        return stored if self.light is None else self.light[stored]

    @property
    def valid(self) -> Bool[np.ndarray, "h w"]:
        """The pixels that count."""
        return self.reason == 0

    @property
    def excluded(self) -> dict[str, int]:
        """Pixels left out, by reason."""
        return {name: int((self.reason == k + 1).sum()) for k, name in enumerate(REASONS)}

    @property
    def top(self) -> int:
        """The highest code."""
        return int(2**self.bits - 1)

    @property
    def limits(self) -> tuple[float, float]:
        """Light that the lowest code tells at most and the highest at least: half a code inside."""
        codes = np.array([0.5, self.top - 0.5]) / self.top
        black, white = np.asarray(self.tone_curve.decode(codes), dtype=np.float64)
        return float(black), float(white)

    @property
    def quantisation(self) -> Float[np.ndarray, "h w 3"] | None:
        """Half a code step for every sample."""
        if self.codes is None or self.half_steps is None:
            return None
        return self.half_steps[self.codes]


def at_photo_size(scene: Scene, width: int, height: int, photo: str) -> Scene:
    """The scene on the photo's pixel grid; another aspect ratio is another picture."""
    camera = scene.camera
    # The same aspect ratio within half a pixel of the photo's width.
    if abs(camera.width / camera.height * height - width) > 0.5:
        raise InputError(
            f"{photo}: {width}×{height} pixels have another shape than the scene's "
            f"{camera.width}×{camera.height}; if it is cut out of such a picture, put it back into "
            "its place there and --mask the rest, for the camera looks through the picture's "
            "middle; if not, give the scene that camera's width, height and fov_y_deg"
        )
    if (camera.width, camera.height) == (width, height):
        return scene
    return scene.resized(width, height)
