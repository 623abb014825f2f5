"""A look that does not match its photo: the verdict, its sentence, exit codes, and levels at 0."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fit import fit, load_photo
from fit.diagnose._residuals import structured_rms
from model_jax import Layers, LayersLook, Look, analytic_layers, composite, find_look
from tests.command import airlight
from tests.model_jax.scenes import RADIUS, scene_of
from tests.scene_text import SCENE

LAYERS = analytic_layers(scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0, shell=0.1))


def photo_of(look: Look, layers: Layers = LAYERS, noise: float = 1e-4) -> np.ndarray:
    picture = np.array(composite(layers, look)[..., :3], np.float32)
    return picture + np.random.default_rng(4).normal(0, noise, picture.shape).astype(np.float32)


def thin(height: float = 0.012 * RADIUS) -> Look:
    return find_look("air+density")(scale_height=height, brightness=5.0)


def test_a_slab_does_not_match_air_that_thins_out() -> None:
    result = fit(photo_of(thin()), LAYERS, sampling="point")
    assert result.verdict == "misfit"
    assert "--look air --terms density" in result.message
    assert "intervals hold for this look only" in result.message
    found = fit(photo_of(thin()), LAYERS, find_look("air+density")(), sampling="point")
    assert found.verdict == "converged", found.message
    assert found.explained is not None
    assert found.explained > 0.99
    height = found.parameters["scale_height"]
    assert height.interval is not None
    assert height.interval[0] < 0.012 * RADIUS < height.interval[1]


def test_noise_is_no_structure() -> None:
    """Neighbours' products have the mean 0; of 5,000 pairs and 3 channels that is 0 ± 0.01."""
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(50 * 70, 3))
    index = np.arange(50 * 70)
    assert structured_rms(noise, index, 70) < 0.2
    wave = np.repeat(np.sin(index / 5.0)[:, None], 3, axis=1)
    assert structured_rms(noise + wave, index, 70) == pytest.approx(
        np.sqrt(0.5), abs=0.1
    )  # to the right
    # In any order, without some, and rows do not hang together around the picture's edge.
    some = rng.permutation(index)[:2000]
    one = structured_rms(wave[np.sort(some)], np.sort(some), 70)
    assert structured_rms(wave[some], some, 70) == pytest.approx(one)
    column = index % 70
    edge = np.where(column == 69, 1.0, np.where(column == 0, -1.0, 0.0))
    found = structured_rms(np.repeat(edge[:, None], 3, axis=1), index, 70)
    assert found == pytest.approx(np.sqrt(2 / 70))  # below each other, and not across the edge


def test_explained_counts_dark_codes(tmp_path: Path) -> None:
    """By hand: 1 - Σ(y - ŷ)² / Σ(y - ȳ)² over used pixels and channels."""
    from PIL import Image

    dim = LayersLook(brightness=0.08)
    codes = np.round(255 * np.clip(composite(LAYERS, dim)[..., :3], 0, 1)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "dark.png")
    photo = load_photo(tmp_path / "dark.png", "linear")
    result = fit(photo, LAYERS, sampling="point")
    assert result.photos[0].clipped > 100
    used = result.used
    light = np.where(codes == 0, 0.5, codes)[used] / 255
    predicted = np.asarray(composite(LAYERS, result.look))[used][:, :3]
    by_hand = 1 - ((light - predicted) ** 2).sum() / ((light - light.mean(axis=0)) ** 2).sum()
    assert result.explained == pytest.approx(by_hand, abs=1e-5)


def test_levels_end_at_0_unless_asked() -> None:
    low = LayersLook(background=-0.01)
    result = fit(photo_of(low), LAYERS, sampling="point")
    assert result.parameters["background"].value == 0
    assert result.parameters["background"].role == "at_bound"
    assert result.verdict == "converged"
    assert "Held at 0" in " ".join(result.warnings)
    asked = {"background": (-1.0, 1.0)}
    for more in ({"bounds": asked}, {"look": replace(LayersLook(), background=-0.001)}):
        found = fit(photo_of(low), LAYERS, sampling="point", **more)
        assert found.parameters["background"].value == pytest.approx(-0.01, abs=1e-4)


def test_the_command_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    bare = SCENE.split("[look]")[0]
    values = '[look]\nkind = "air+density"\nscale_height = 60.0\nbrightness = 5.0\n'
    (tmp_path / "true.toml").write_text(bare + values)
    (tmp_path / "scene.toml").write_text(bare)
    assert airlight("render", "true.toml", "-o", "photo.exr") == 0
    named = ("--look", "layers", "--sampling", "point")
    asked = ("fit", "scene.toml", "photo.exr", *named, "-o", "out")
    assert airlight(*asked) == 1
    assert "The look does not match" in capsys.readouterr().out
    assert airlight(*asked, "--accept-misfit") == 0
    document = json.loads((tmp_path / "out/fit.json").read_text())
    assert document["verdict"] == "misfit"
    assert document["explained"] < 0.5 or document["structure"] > 0.4
    assert "The look does not match" in (tmp_path / "out/report.html").read_text()
    assert airlight("export", "out/fit.json", "--to", "glsl", "-o", "look.glsl") == 0
    assert "verdict misfit" in (tmp_path / "look.glsl").read_text() + capsys.readouterr().err
