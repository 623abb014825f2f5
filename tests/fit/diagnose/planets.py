"""Planets drawn four times finer than their pixels, without air and with, blurred and noisy."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.special import erfcx

from model_jax import Layers, Srgb, Sun, analytic_layers
from tests.fit.diagnose.discs import disc_scene

FINER = 4
CURVE = Srgb()


@dataclass(frozen=True)
class Drawn:
    light: np.ndarray
    """Linear, of an 8-bit sRGB picture."""
    layers: Layers
    about: str


@dataclass(frozen=True)
class _Grid:
    """A sphere on pixels of a quarter's size; lengths in its radii."""

    radius: float
    size: int
    middle: np.ndarray
    sun: np.ndarray

    @property
    def places(self) -> tuple[np.ndarray, np.ndarray]:
        fine = (np.arange(self.size * FINER) + 0.5) / FINER - 0.5
        x, y = np.meshgrid(fine, fine)
        return (x - self.middle[0]) / self.radius, -(y - self.middle[1]) / self.radius

    @property
    def inside(self) -> np.ndarray:
        return np.hypot(*self.places) < 1

    @property
    def mu(self) -> np.ndarray:
        """Cosine of the angle at which the surface is seen."""
        x, y = self.places
        return np.asarray(np.sqrt(np.maximum(1 - x * x - y * y, 0)))

    @property
    def sunward(self) -> np.ndarray:
        """Cosine of the sun's angle."""
        x, y = self.places
        return np.asarray(x * self.sun[0] + y * self.sun[1] + self.mu * self.sun[2])

    def seen(self, fine: np.ndarray, blur: float) -> np.ndarray:
        blurred = gaussian_filter(fine, (FINER * blur, FINER * blur, 0))
        size = self.size
        return np.asarray(blurred.reshape(size, FINER, size, FINER, 3).mean(axis=(1, 3)))


def airless(rng: np.random.Generator) -> Drawn:
    """Blurred by 0.3 to 4 px, in a scene up to a pixel off in each of place and radius.

    Light is that of Lommel and Seeliger with up to 30 % of Lambert's, on ground rough by 0.1
    to 0.4 in its slopes: a smooth one's limb would be a line of light no body shows.
    """
    grid = _grid(rng, 60)
    rough, lambert = rng.uniform(0.1, 0.4), rng.uniform(0, 0.3)
    raw = grid.sunward
    lit = (raw + np.sqrt(raw**2 + rough**2 / 4)) / 2 * (raw > -rough)
    slanted = np.sqrt(grid.mu**2 + rough**2)
    shade = (1 - lambert) * lit / (lit + slanted) + lambert * lit
    blur, noise = rng.uniform(0.3, 4), rng.uniform(0.3, 3)
    light = grid.seen(_painted(rng, grid, shade), blur)
    height = max(rng.uniform(0.01, 0.12), 1.5 / grid.radius)
    layers = _layers(rng, grid, height, off=1.0)
    about = f"radius {grid.radius:.0f}, shell {height * grid.radius:.1f}, blur {blur:.2f} px"
    return Drawn(_picture(rng, light, noise), layers, about)


def with_air(rng: np.random.Generator, thin: bool = False) -> Drawn:
    """Blurred by 0.3 to 1 px, with air of a scale height of 0.5 to 6 px in a shell of 5 to 12 of
    these, that shines with 20 to 150 codes beside the limb, in a scene that is aligned.

    Args:
        thin: a scale height of 0.4 to 0.5 px.
    """
    heights = (0.4, 0.5) if thin else (0.5, 6.0)
    height = float(np.exp(rng.uniform(*np.log(heights))))
    grid = _grid(rng, 120)
    x, y = grid.places
    away = (np.hypot(x, y) - 1) * grid.radius
    top = max(height * rng.uniform(5, 12), 1.5)
    # In front of the planet half a column of air, seen through ever less of it.
    front = 0.5 * erfcx(np.sqrt(np.maximum(-away, 0) / height))
    thick = np.where(away < 0, front, np.exp(-np.maximum(away, 0) / height) * (away < top))
    across = (x * grid.sun[0] + y * grid.sun[1]) / np.maximum(np.hypot(x, y), 0.01)
    layers = _layers(rng, grid, top / grid.radius, off=0.0)
    day = 1 / (1 + np.exp(-across / 0.1)) if layers.shadow_front is not None else 1.0
    hue = np.array([rng.uniform(0.2, 1), rng.uniform(0.4, 1), 1.0])
    hue = hue if rng.random() < 0.7 else rng.uniform(0.3, 1, 3)
    blur, peak = rng.uniform(0.3, 1), rng.uniform(20, 150)
    air = grid.seen((thick * day)[..., None] * hue / hue.max(), blur)
    brightest = air[np.asarray(layers.planet) == 0].max()
    shade = np.clip(grid.sunward, 0, 1) ** rng.uniform(0, 1)
    light = grid.seen(_painted(rng, grid, shade), blur)
    light = light + air * float(CURVE.decode(np.array([peak / 255]))[0]) / brightest
    about = f"radius {grid.radius:.0f}, scale height {height:.2f}, blur {blur:.2f} px, {peak:.0f}"
    return Drawn(_picture(rng, light, 1.0), layers, about)


def _grid(rng: np.random.Generator, margin: int) -> _Grid:
    radius = float(np.exp(rng.uniform(np.log(40), np.log(160))))
    size = int(2 * radius) + margin
    azimuth, phase = rng.uniform(0, 2 * np.pi), rng.uniform(0, 2.3)
    across = np.sin(phase)
    sun = np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(phase)])
    return _Grid(radius, size, (size - 1) / 2 + rng.uniform(-0.5, 0.5, 2), sun)


def _painted(rng: np.random.Generator, grid: _Grid, shade: np.ndarray) -> np.ndarray:
    """With an albedo of 0.1 to 0.9, some colour, and features of up to 5 %."""
    color = rng.uniform(0.1, 0.9) * np.array([1, rng.uniform(0.8, 1.1), rng.uniform(0.6, 1.2)])
    features = gaussian_filter(rng.normal(size=(grid.size, grid.size)), rng.uniform(2, 8))
    features = np.clip(1 + rng.uniform(0, 0.05) * features / features.std(), 0.2, 2)
    features = np.kron(features, np.ones((FINER, FINER)))
    return np.asarray((shade * features * grid.inside)[..., None] * color)


def _layers(rng: np.random.Generator, grid: _Grid, height: float, off: float) -> Layers:
    """Seven of ten scenes have a sun."""
    sun = Sun((grid.sun[0], grid.sun[1], grid.sun[2])) if rng.random() < 0.7 else None
    x, y, radius = np.array([*grid.middle, grid.radius]) + off * rng.uniform(-1, 1, 3)
    return analytic_layers(disc_scene((grid.size, grid.size), (x, y, radius), height, sun))


def _picture(rng: np.random.Generator, light: np.ndarray, noise: float) -> np.ndarray:
    codes = 255 * np.asarray(CURVE.encode(np.clip(light, 0, 1)))
    codes = np.rint(codes + rng.normal(scale=noise, size=light.shape))
    return np.asarray(CURVE.decode(np.clip(codes, 0, 255) / 255), np.float32)
