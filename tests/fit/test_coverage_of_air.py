"""Do 95 % intervals of air that thins out and saturates hold the truth, sharp and blurred?

As in `test_coverage`: each photo has a look and noise of its own, and then becomes 8 bits. The blur
of a photo is a convolution of a picture four times as fine, so what the model leaves of it is in
the intervals, too.
"""

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fit import FitResult, fit
from fit.solve._declare import declare
from model_jax import Layers, Look, Planet, Response, analytic_layers, composite, find_look
from tests.fit.noises import rounded
from tests.model_jax.scenes import RADIUS, scene_of

from .looks import exact_layers
from .test_coverage import LEAST, MOST

AIR = find_look("air+density+saturation")
SCENE = scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0, shell=0.4)
FINE = 4
BLUR = 1.2


def draw_look(rng: np.random.Generator) -> Look:
    """Light of up to half of white; optical depths of 0.3 to 3 at the limb."""
    extinction = rng.uniform(4, 16, 3)
    tint = rng.uniform(0.7, 1.3, 3)
    return AIR(
        scale_height=RADIUS * rng.uniform(0.03, 0.06),
        extinction=extinction,
        brightness=0.5 * extinction.mean(),
        shadow=rng.uniform(0.1, 0.5),
        tint=tint / tint.mean(),
        background=rng.uniform(0.02, 0.04),
    )


def sharp(look: Look, layers: Layers, rng: np.random.Generator, folder: Path) -> FitResult:
    with jax.enable_x64(True):
        light = np.asarray(composite(layers, look))[..., :3]
    return fit(rounded(light, rng, folder), layers, AIR(), sampling="point")


def soft(look: Look, layers: Layers, rng: np.random.Generator, folder: Path) -> FitResult:
    camera = replace(SCENE.camera, width=97 * FINE, height=73 * FINE)
    lit = replace(SCENE, camera=camera, planet=Planet(RADIUS, albedo=(0.3, 0.35, 0.4)))
    light = np.asarray(composite(analytic_layers(lit), look), np.float64)[..., :3]
    light = gaussian_filter(light, (BLUR * FINE, BLUR * FINE, 0), mode="nearest")
    light = light.reshape(73, FINE, 97, FINE, 3).mean(axis=(1, 3))
    photo = rounded(light, rng, folder)
    return fit(photo, layers, AIR(), response=Response(blur=1.0))


KINDS = {"sharp": sharp, "soft": soft}


def covered(kind: str, count: int, seed: int, folder: Path) -> dict[str, list[bool | None]]:
    """Of each free parameter and fit, whether its interval holds the truth; None without one."""
    layers = exact_layers(SCENE)
    found: dict[str, list[bool | None]] = {}
    for child in np.random.SeedSequence(seed).spawn(count):
        rng = np.random.default_rng(child)
        look = draw_look(rng)
        result = KINDS[kind](look, layers, rng, folder)
        responses = [Response(blur=BLUR if kind == "soft" else None)]
        truth = {p.name: float(p.value) for p in declare(look, responses)}
        for name, p in result.parameters.items():
            if p.role != "fixed":
                inside = p.interval and p.interval[0] <= truth[name] <= p.interval[1]
                found.setdefault(name, []).append(inside)
    return found


@pytest.mark.full
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_air_cover_the_truth_in_many_fits(kind: str, tmp_path: Path) -> None:
    found = covered(kind, 1000, 20261128, tmp_path)
    told = {name: [inside for inside in part if inside is not None] for name, part in found.items()}
    shares = {name: float(np.mean(part)) for name, part in told.items()}
    print(kind, shares, {name: len(part) for name, part in told.items()})
    assert all(len(part) >= 950 for part in told.values()), told
    assert all(LEAST <= share <= MOST for share in shares.values()), shares
