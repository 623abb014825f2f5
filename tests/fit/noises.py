"""Kinds of noise that a photo may have."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from fit import Photo, load_photo
from model_jax import Response
from model_jax._tone import Srgb

LOOK = ("brightness", "shadow", "tint.r", "tint.g", "tint.b")

Recorder = Callable[[np.ndarray, np.random.Generator, Path], "np.ndarray | Photo"]


@dataclass(frozen=True)
class Noise:
    """What lies between light and photo, and the levels at which it is tried."""

    record: Recorder
    background: tuple[float, float]
    brightness: tuple[float, float] = (1.0, 2.0)
    responses: Callable[[np.random.Generator], tuple[Response, ...]] = lambda rng: (Response(),)
    """Of each photo."""
    more: tuple[str, ...] = ("background",)
    """What is fitted besides `LOOK`."""
    jpeg: str = "keep"

    @property
    def names(self) -> tuple[str, ...]:
        return LOOK + self.more


def gaussian(light: np.ndarray, rng: np.random.Generator, folder: Path) -> np.ndarray:
    return light + rng.normal(scale=0.02, size=light.shape)


def by_brightness(light: np.ndarray, rng: np.random.Generator, folder: Path) -> np.ndarray:
    """Photons: the variance grows with the light, tenfold from the darkest to the brightest."""
    return light + rng.normal(size=light.shape) * np.sqrt(0.005**2 + 0.002 * light)


def blurred(light: np.ndarray, rng: np.random.Generator, folder: Path) -> np.ndarray:
    noise = gaussian_filter(rng.normal(size=light.shape), (2, 2, 0), mode="wrap")
    return light + 0.02 * np.sqrt(16 * np.pi) * noise  # 4πσ² pixels were averaged


def rounded(light: np.ndarray, rng: np.random.Generator, folder: Path) -> Photo:
    """0.005 is half a code at white, where codes are widest: a code is 2.27 / 255 of light."""
    noisy = light + rng.normal(scale=0.005, size=light.shape)
    Image.fromarray(to_codes(noisy)).save(folder / "photo.png", compress_level=1)
    return load_photo(folder / "photo.png")


def compressed(light: np.ndarray, rng: np.random.Generator, folder: Path) -> Photo:
    """JPEG as Pillow writes it, colour at half resolution, of noise that does not always dither it.

    A block's mean colour has steps of 5/8 code; noise of 0.03 is 5 to 10 codes, and 0.3 to 0.6 of
    such a step in the mean of 16 × 16 pixels. The ring of air is ten pixels wide, less than a
    block, and all of it is used.
    """
    noisy = light + rng.normal(scale=0.03, size=light.shape)
    Image.fromarray(to_codes(noisy)).save(folder / "photo.jpg", quality=85)
    return load_photo(folder / "photo.jpg")


def one_response(rng: np.random.Generator) -> tuple[Response, ...]:
    return (Response(gamma=rng.uniform(0.8, 1.3), black_level=rng.uniform(0, 0.05)),)


def two_responses(rng: np.random.Generator) -> tuple[Response, ...]:
    """Exposures are relative to the first photo's."""
    exposures = (1.0, rng.uniform(0.5, 0.8))
    return tuple(Response(exposure=e, black_level=rng.uniform(0, 0.05)) for e in exposures)


def to_codes(light: np.ndarray) -> np.ndarray:
    stored = np.asarray(Srgb().encode(light))
    return np.round(255 * np.clip(stored, 0, 1)).astype(np.uint8)


NOISES = {
    "gaussian": Noise(gaussian, (0.03, 0.08)),
    "rounded": Noise(rounded, (0.03, 0.08)),
    "by_brightness": Noise(by_brightness, (0.03, 0.08)),
    "blurred": Noise(blurred, (0.03, 0.08)),
    "clipped": Noise(rounded, (0.03, 0.08), (3.2, 4.2)),
    "compressed": Noise(compressed, (0.1, 0.2), jpeg="undo"),
    "response": Noise(
        gaussian, (0.03, 0.08), responses=one_response, more=("gamma", "black_level")
    ),
    "two photos": Noise(
        gaussian,
        (0.03, 0.08),
        responses=two_responses,
        more=("black_level.1", "exposure.2", "black_level.2"),
    ),
}
