"""Layers are as exact as the photo: rasterised ones tell the same look as exact ones."""

from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest
from PIL import Image

import render_gl
from fit import fit
from model_jax import Layers, LayersLook, Planet, Scene, analytic_layers, composite

SIZES = ((240, 180), (480, 360), (1280, 960))
NOISE = 0.003
FREE = ("brightness", "shadow", "tint", "background")
TRUTH = LayersLook(brightness=2.0, shadow=0.3, background=0.02)


def scene(size: tuple[int, int]) -> Scene:
    found = render_gl.load_scene("examples/reference.toml").scene
    return found.resized(*size)


def exact_light(case: Scene, look: LayersLook) -> np.ndarray:
    """The picture by float64 layers."""
    with jax.enable_x64(True):
        return np.asarray(composite(analytic_layers(case, np.float64), look))[..., :3]


@pytest.mark.parametrize("size", SIZES, ids=lambda size: f"{size[0]}x{size[1]}")
def test_rasterised_layers_bias_by_less_than_the_noise(size: tuple[int, int]) -> None:
    """Of a picture without noise, in standard errors of a noisy one; the paper's meshes are off by
    more than 5 of them at the largest size, which is how this was found."""
    case = scene(size)
    light = exact_light(case, TRUTH)
    noisy = light + np.random.default_rng(1).normal(scale=NOISE, size=light.shape)
    layers = render_gl.render(case, "linear")
    errors = fit(noisy, layers, LayersLook(), free=FREE).parameters
    clean = fit(light, layers, LayersLook(), free=FREE).parameters
    truth = {"brightness": 2.0, "shadow": 0.3, "background": 0.02}
    for name, value in truth.items():
        stderr = errors[name].stderr
        assert stderr is not None
        assert abs(clean[name].value - value) < 0.05 * stderr, name
    if size == SIZES[-1]:
        mesh = fit(light, render_gl.render(case, "linear", "mesh"), LayersLook(), free=FREE)
        off = abs(mesh.parameters["brightness"].value - 2.0)
        stderr = errors["brightness"].stderr
        assert stderr is not None
        assert off > 5 * stderr


def test_a_mesh_in_the_layers_is_named() -> None:
    """The paper's own depths shift the look by more than its interval, and the fit says so; by how
    much is right within a factor of 3."""
    case = scene((480, 360))
    light = exact_light(case, TRUTH)
    noisy = light + np.random.default_rng(1).normal(scale=NOISE, size=light.shape)
    exact = fit(noisy, render_gl.render(case, "linear"), LayersLook(), free=FREE)
    assert exact.parameters["brightness"].layer_error is None
    assert not any("mesh" in warning for warning in exact.warnings)
    drawn = fit(noisy, render_gl.render(case, "linear", "mesh"), LayersLook(), free=FREE)
    shift = abs(drawn.parameters["brightness"].value - exact.parameters["brightness"].value)
    told = drawn.parameters["brightness"].layer_error
    assert told is not None
    assert shift < told < 3 * shift
    assert any("--source raster" in warning for warning in drawn.warnings)


def test_relief_is_named_where_its_mesh_is_coarse(tmp_path: Path) -> None:
    """Mountains of 60 km and a mesh of 1,000 triangles against one of 800,000."""
    rows, columns = np.mgrid[:128, :256]
    heights = 0.5 + 0.5 * np.sin(rows / 6) * np.cos(columns / 6)
    np.save(tmp_path / "relief.npy", heights)
    Image.fromarray(np.full((16, 32, 3), 128, np.uint8)).save(tmp_path / "grey.png")
    case = scene((240, 180))
    errors = {}
    for triangles in (1_000, 800_000):
        planet = Planet(
            case.planet.radius,
            relief=str(tmp_path / "relief.npy"),
            relief_unit=0.01 * float(case.planet.radius),
            albedo=str(tmp_path / "grey.png"),
            triangles=triangles,
        )
        layers = render_gl.render(eqx.tree_at(lambda s: s.planet, case, planet), "linear")
        light = np.asarray(composite(layers, TRUTH))[..., :3]
        noisy = light + np.random.default_rng(1).normal(scale=NOISE, size=light.shape)
        result = fit(noisy, layers, LayersLook(), free=FREE)
        told = result.parameters["brightness"].layer_error
        assert told is not None
        errors[triangles] = told
        named = any("mesh" in warning for warning in result.warnings)
        assert named == (triangles == 1_000), (triangles, result.warnings)
    assert 0 < errors[800_000] < 0.1 * errors[1_000]


@pytest.mark.full
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("source", ["raster", "analytic"])
def test_intervals_cover_the_truth_over_layers_of(source: str) -> None:
    """200 fits of looks and noise of their own, of all sizes: 95 % intervals hold the truth in at
    least 91 %, of which a true 95 % falls short in one run of 170 for each parameter."""
    count = 200
    drawn: dict[tuple[int, int], tuple[Scene, Layers]] = {}
    for size in SIZES:
        case = scene(size)
        made = analytic_layers(case) if source == "analytic" else render_gl.render(case, "linear")
        drawn[size] = case, made
    covered: dict[str, list[bool]] = {}
    for number, child in enumerate(np.random.SeedSequence(20261126).spawn(count)):
        rng = np.random.default_rng(child)
        look = replace(
            TRUTH, brightness=float(rng.uniform(1, 3)), shadow=float(rng.uniform(0.1, 0.5))
        )
        case, layers = drawn[SIZES[number % len(SIZES)]]
        light = exact_light(case, look)
        photo = (light + rng.normal(scale=NOISE, size=light.shape)).astype(np.float32)
        result = fit(photo, layers, LayersLook(), free=FREE, sampling="point")
        assert result.verdict == "converged", result.message
        truth = {"brightness": look.brightness, "shadow": look.shadow, "background": 0.02}
        truth |= {f"tint.{c}": 1.0 for c in "rgb"}
        for name, value in truth.items():
            interval = result.parameters[name].interval
            assert interval is not None
            low, high = interval
            covered.setdefault(name, []).append(bool(low <= value <= high))
    shares = {name: float(np.mean(held)) for name, held in covered.items()}
    print(source, shares)
    assert min(shares.values()) >= 0.91, shares
