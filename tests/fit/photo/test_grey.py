"""Grey photos: copies of a channel count once, and what they cannot tell gets no number."""

import json
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image

from fit import fit, load_photo
from fit.cli._cli import app
from fit.photo._columns import LUMINANCE
from model_jax import Layers, LayersLook, Response, Srgb
from tests.fit.looks import START, picture
from tests.scene_text import SCENE

BLUE = (0.35, 0.55, 1.0, 1.0)
TRUTH = LayersLook(brightness=0.9, shadow=0.3, background=0.05)
NAMES = ("brightness", "shadow", "background")
SIGMA = 0.02


def grey_light(layers: Layers, look: LayersLook, seed: int, noise: float = SIGMA) -> np.ndarray:
    """Luminance of coloured air, [h, w], with noise."""
    with jax.enable_x64(True):
        light = picture(layers, look).astype(np.float64) @ LUMINANCE
    return light + np.random.default_rng(seed).normal(scale=noise, size=light.shape)


@pytest.fixture
def blue(layers64: Layers) -> Layers:
    return replace(layers64, color=np.array(BLUE))


def test_grey_in_all_its_forms(blue: Layers, tmp_path: Path) -> None:
    """Stored as grey, as RGB, as JPEG of either kind: tint is not told, and the rest alike."""
    codes = np.round(255 * np.clip(np.asarray(Srgb().encode(grey_light(blue, TRUTH, 1))), 0, 1))
    grey = Image.fromarray(codes.astype(np.uint8))
    grey.save(tmp_path / "grey.png")
    grey.convert("RGB").save(tmp_path / "rgb.png")
    grey.save(tmp_path / "grey.jpg", quality=95)
    grey.convert("RGB").save(tmp_path / "rgb.jpg", quality=95)
    results = {
        name: fit(load_photo(tmp_path / name), blue, START)
        for name in ("grey.png", "rgb.png", "grey.jpg", "rgb.jpg")
    }
    for name, result in results.items():
        assert result.verdict == "converged", name
        assert [(item.what, item.why) for item in result.left_out] == [
            ("tint", "a grey photo does not tell colours")
        ]
        assert set(result.correlation_names) == set(NAMES)
        assert any("grey" in warning for warning in result.warnings)
        np.testing.assert_array_equal(result.look.tint, START.tint)
    for one, other in (("grey.png", "rgb.png"), ("grey.jpg", "rgb.jpg")):
        for name in NAMES:
            a, b = results[one].parameters[name], results[other].parameters[name]
            assert (a.value, a.stderr) == (b.value, b.stderr)
    asked = fit(load_photo(tmp_path / "grey.png"), blue, START, free=["brightness", "tint"])
    assert asked.verdict == "not_identifiable"
    undone = fit(load_photo(tmp_path / "rgb.jpg"), blue, START, jpeg="undo")
    assert "grey JPEG" in {item.what: item.why for item in undone.left_out}["what JPEG did"]


def test_a_grey_photo_is_fitted_by_its_luminance(blue: Layers) -> None:
    """Without noise the truth comes back, with gamma, a black level and a surface too."""
    rng = np.random.default_rng(2)
    surface = rng.uniform(0, 0.3, (*np.shape(blue.front), 3))
    shown = replace(blue, surface=surface)
    response = Response(gamma=1.4, black_level=0.02)
    light = grey_light(shown, TRUTH, 0, noise=0.0) ** (1 / 1.4) + 0.02
    photo = np.repeat(light[..., None], 3, axis=2)
    free = (*NAMES, "gamma", "black_level")
    result = fit(photo, shown, replace(START, background=0.03), free=free)
    assert result.verdict == "converged"
    for name, value in (("brightness", 0.9), ("shadow", 0.3), ("background", 0.05)):
        assert result.parameters[name].value == pytest.approx(value, rel=1e-6), name
    assert result.response.gamma == pytest.approx(response.gamma, rel=1e-6)
    assert result.residual_rms < 1e-9


@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.full)])
def test_copies_count_once(count: int, blue: Layers) -> None:
    """The scatter of fits is what the standard errors say; a prior weighs as much as for one
    channel; brightness's interval holds what is not known of the weights besides.

    From n fits a root mean square is known to 1 / √(2n), of 30 to 13 %; four of these are allowed.
    Copies that counted as three channels would make it √3.
    """
    off = []
    for seed in range(count):
        photo = np.repeat(grey_light(blue, TRUTH, seed)[..., None], 3, axis=2)
        result = fit(photo, blue, START)
        off.append(
            [
                (result.parameters[n].value - v) / (result.parameters[n].stderr or np.nan)
                for n, v in (("shadow", 0.3), ("background", 0.05))
            ]
        )
    size = np.sqrt(np.mean(np.square(off), axis=0))
    room = 4 / np.sqrt(2 * count)
    assert np.all(np.abs(size - 1) < room), size
    assert result.errors is not None
    assert result.errors.noise == pytest.approx(SIGMA, rel=0.1)
    assert result.photos[0].measured == result.used.sum()
    brightness, shadow = result.parameters["brightness"], result.parameters["shadow"]
    assert brightness.stderr is not None
    assert shadow.stderr is not None
    assert 0.03 < brightness.stderr / brightness.value < 0.3
    prior = fit(photo, blue, START, priors={"shadow": (0.3, shadow.stderr)})
    together = prior.parameters["shadow"].stderr
    assert together == pytest.approx(shadow.stderr / np.sqrt(2), rel=0.05)


def test_a_grey_photo_beside_one_in_colour(blue: Layers) -> None:
    """The one in colour tells the tint."""
    look = replace(TRUTH, tint=(0.8, 0.9, 1.3))
    with jax.enable_x64(True):
        light = picture(blue, look).astype(np.float64)
    light += np.random.default_rng(5).normal(scale=SIGMA, size=light.shape)
    grey = np.repeat(0.7 * grey_light(blue, look, 4)[..., None], 3, axis=2)
    free = ("brightness", "shadow", "tint", "background", "exposure.2")
    result = fit([light, grey], [blue, blue], START, free=free)
    assert result.verdict == "converged"
    assert result.photos[0].mix is None
    wanted = {"brightness": 0.9, "shadow": 0.3, "tint.r": 0.8, "tint.b": 1.3, "exposure.2": 0.7}
    for name, value in wanted.items():
        e = result.parameters[name]
        assert e.stderr is not None
        assert abs(e.value - value) < 4 * e.stderr, name
    brightness, exposure = (result.parameters[n].stderr for n in ("brightness", "exposure.2"))
    assert brightness is not None
    assert exposure is not None
    assert brightness / 0.9 < 0.01
    assert exposure / 0.7 > 0.03


def test_channels_are_alike_by_chance() -> None:
    """One pixel, and a photo clipped all over, are not called grey."""
    from fit.photo._columns import _mix

    assert _mix(np.array([[0.5, 0.5, 0.5]]), None) is None
    assert _mix(np.ones((4, 3)), np.ones((4, 3), np.int8)) is None
    light = np.random.default_rng(0).uniform(size=(4, 1)) * np.array([1.0, 1.0, 2.0])
    assert _mix(light, None) is None
    mix = _mix(light[:, [0, 0, 0]], None)
    assert mix is not None
    np.testing.assert_allclose(mix, np.tile(LUMINANCE, (3, 1)))


def test_the_residual_is_of_the_grey_picture(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from model_jax import analytic_layers
    from render_gl import load_scene
    from render_gl._exr import read_channels

    scene = str(tmp_path / "scene.toml")
    Path(scene).write_text(SCENE)
    file = load_scene(scene)
    layers = analytic_layers(file.scene)
    light = grey_light(layers, LayersLook(0.8, 0.3, background=0.05), 3, noise=0.01)
    codes = np.round(255 * np.clip(np.asarray(Srgb().encode(light)), 0, 1)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "grey.png")
    done = CliRunner().invoke(
        app,
        ["fit", scene, str(tmp_path / "grey.png"), "--source", "analytic", "-o", str(tmp_path)],
    )
    assert done.exit_code == 0, done.output
    channels, _ = read_channels(tmp_path / "residual.exr")
    np.testing.assert_array_equal(channels["R"], channels["B"])
    used = channels["used.Y"] > 0
    document = json.loads((tmp_path / "fit.json").read_text())
    rms = np.sqrt((channels["R"][used].astype(float) ** 2).mean())
    assert rms == pytest.approx(document["residual_rms"], rel=1e-3)
