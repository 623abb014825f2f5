"""Pictures of all kinds that the look `layers` made: `auto` says so."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image

from fit import fit, load_photo
from fit.photo._columns import PhotoLike
from model_jax import (
    Atmosphere,
    Camera,
    Layers,
    LayersLook,
    Planet,
    Scene,
    Sun,
    analytic_layers,
    composite,
)

MANY, FALSE = 300, 3
"""Pictures, and for how many of them, a hundredth, another look may be chosen."""


def drawn_scene(rng: np.random.Generator) -> Scene:
    """A planet with any shell, sun and part of it in view, some without a sun."""
    height, width = [(96, 128), (128, 160), (160, 240)][rng.integers(3)]
    shell = float(np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
    away = rng.uniform(2.2, 4) * (1 + shell)
    whole = 2.3 * np.degrees(np.arctan((1 + shell) / np.sqrt(away**2 - 1)))
    turn, around = rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
    sun = (np.sin(turn) * np.cos(around), np.sin(turn) * np.sin(around), np.cos(turn))
    return Scene(
        camera=Camera(
            position=(0, 0, away),
            forward=(0, 0, -1),
            up=(0, 1, 0),
            fov_y_deg=min(whole * rng.uniform(0.6, 1.1), 100),
            width=width,
            height=height,
            near=0.2,
            far=away + 2,
        ),
        planet=Planet(radius=1.0),
        atmosphere=Atmosphere(height=shell),
        sun=Sun(direction=sun) if rng.random() < 0.9 else None,
    )


def drawn_light(rng: np.random.Generator, seen: Scene, samples: int) -> np.ndarray:
    """Its picture with some look, of so many samples to a pixel each way, scaled to be bright, some
    of it too bright, with noise or without."""
    look = LayersLook(
        brightness=1.0,
        shadow=rng.uniform(0, 1),
        tint=rng.dirichlet([20] * 3) * 3,
        background=rng.choice([0.0, 0.01]),
    )
    height, width = seen.camera.height, seen.camera.width
    fine = seen.resized(width * samples, height * samples) if samples > 1 else seen
    with jax.enable_x64(True):
        layers = jax.tree.map(np.asarray, analytic_layers(fine, np.float64))
        light = np.asarray(composite(layers, look))[..., :3]
    bright = max(float(np.quantile(light[np.asarray(layers.has_air)], 0.99)), 1e-9)
    light = light.reshape(height, samples, width, samples, 3).mean((1, 3))
    noise = rng.choice([0, 1e-3, 5e-3, 2e-2])
    made: np.ndarray = light * rng.uniform(0.4, 1.1) / bright + noise * rng.normal(size=light.shape)
    return made


def stored(rng: np.random.Generator, light: np.ndarray, folder: Path) -> PhotoLike:
    """As floats, PNG or JPEG."""
    kind = rng.choice(["float", "jpg", "png"], p=[0.3, 0.2, 0.5])
    if kind == "float":
        return light.astype(np.float32)
    light = np.clip(light, 0, 1)
    codes = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    file = folder / f"photo.{kind}"
    options: dict[str, Any] = {"quality": 90} if kind == "jpg" else {"compress_level": 1}
    Image.fromarray(np.rint(255 * codes).astype(np.uint8)).save(file, **options)
    return load_photo(file)


@pytest.mark.full
def test_of_three_hundred_pictures_by_layers(tmp_path: Path) -> None:
    chosen = []
    for seed in range(MANY):
        rng = np.random.default_rng([7, seed])
        seen = drawn_scene(rng)
        samples, sampling = [(1, "point"), (1, "area"), (3, "area")][rng.integers(3)]
        photo = stored(rng, drawn_light(rng, seen, samples), tmp_path)
        layers: Layers = jax.tree.map(np.asarray, analytic_layers(seen))
        where = str(rng.choice(["all", "ring"]))
        result = fit(photo, layers, "auto", where=where, sampling=sampling)
        chosen.append((seed, type(result.look).NAME))
    others = [one for one in chosen if one[1] != LayersLook.NAME]
    assert len(others) <= FALSE, others
