"""Makes the planet of `paper.toml` and `rim.toml`: maps of height, albedo and water of a world that
does not exist.

The heights are a Gaussian random field on the sphere, a sum of plane waves with random directions
and amplitudes falling as k^-0.8, which has no seam and no poles. 45 % is sea; the land's
colour follows height and latitude. Deterministic.

    python examples/make_planet.py
"""

from pathlib import Path

import numpy as np
from PIL import Image

WIDTH, HEIGHT = 1024, 512
WAVES = 1500
SEED = 5


def heights() -> np.ndarray:
    """Relief [h, w] in [0, 1], float64; 0 is sea. Equirectangular, north up."""
    rng = np.random.default_rng(SEED)
    latitude = np.pi * (0.5 - (np.arange(HEIGHT) + 0.5) / HEIGHT)[:, None]
    longitude = 2 * np.pi * ((np.arange(WIDTH) + 0.5) / WIDTH - 0.5)[None, :]
    points = np.stack(
        np.broadcast_arrays(
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        )
    )
    size = 3.0 * 40.0 ** rng.random(WAVES)  # radians⁻¹, 3 to 120, log-uniform
    direction = rng.normal(size=(WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    phase = 2 * np.pi * rng.random(WAVES)
    field = np.zeros((HEIGHT, WIDTH))
    for k, along, shift in zip(size, direction, phase, strict=True):
        field += k**-0.8 * np.cos(k * np.tensordot(along, points, 1) + shift)
    land = np.maximum(field - np.quantile(field, 0.45), 0)
    return (land / land.max()) ** 1.3  # broad plains, few peaks


def albedo(relief: np.ndarray) -> np.ndarray:
    """Linear reflectance [h, w, 3] of sea, plains, rock and ice."""
    latitude = np.abs(np.linspace(90, -90, HEIGHT))[:, None]
    anchors = np.array([0.0, 0.05, 0.2, 0.45, 1.0])
    colors = np.array(
        [
            [0.010, 0.030, 0.075],  # sea
            [0.060, 0.110, 0.035],
            [0.160, 0.140, 0.060],
            [0.230, 0.180, 0.130],
            [0.450, 0.420, 0.400],
        ]
    )
    height = np.where(relief > 0, np.maximum(relief, 0.02), 0)
    ground = np.stack([np.interp(height, anchors, colors[:, c]) for c in range(3)], axis=-1)
    ice = 1 / (1 + np.exp(-(latitude - 72 + 25 * relief) / 2.0))
    return ground + (0.75 - ground) * ice[..., None]


def main() -> None:
    """Write `planet_relief.png` (16 bit), `planet_albedo.jpg` and `planet_water.png` beside this
    file."""
    folder = Path(__file__).parent
    relief = heights()
    Image.fromarray(np.round(relief * 65535).astype(np.uint16)).save(
        folder / "planet_relief.png", optimize=True
    )
    linear = albedo(relief)
    stored = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    Image.fromarray(np.round(stored * 255).astype(np.uint8)).save(
        folder / "planet_albedo.jpg", quality=88
    )
    Image.fromarray(np.where(relief > 0, 0, 255).astype(np.uint8)).save(
        folder / "planet_water.png", optimize=True
    )


if __name__ == "__main__":
    main()
