"""Sentences that trials as a new user found false, or missing: each is true now."""

import copy
import dataclasses
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fit import FitResult, fit, load_photo
from fit.report._wording import close_pairs
from model_jax import InputError, Layers, analytic_layers
from render_gl import load_scene
from tests.command import airlight
from tests.fit.diagnose.discs import disc_scene, full_moon
from tests.scene_text import SCENE, resized

from .looks import START, TRUTH, picture, scene

NOISE = 1e-3


@pytest.fixture(scope="module")
def layers() -> Layers:
    return analytic_layers(scene())


@pytest.fixture(scope="module")
def clean(layers: Layers) -> np.ndarray:
    return picture(layers, TRUTH)


def noisy(light: np.ndarray) -> np.ndarray:
    return light + np.random.default_rng(1).normal(scale=NOISE, size=light.shape)


def bare_disc() -> tuple[np.ndarray, Layers]:
    """A planet without air, and the layers of a shell around it."""
    light = full_moon(99.5, 99.5) + np.random.default_rng(2).normal(scale=0.005, size=(200, 200, 3))
    return light, analytic_layers(disc_scene((200, 200), (99.5, 99.5, 60.0), 0.03))


def with_blotch(clean: np.ndarray) -> np.ndarray:
    """Something bright that is no air, over a fourteenth of the air's pixels."""
    light = noisy(clean)
    light[30:50, 110:150] += 0.3
    return light


# --- nothing to fit -----------------------------------------------------------------------------


def test_no_data_says_nothing_of_the_fit_that_was_thrown_away() -> None:
    result = fit(*bare_disc())
    assert result.verdict == "no_data"
    assert result.warnings == ()
    assert "left over" not in result.message
    assert "Intervals" not in result.message


def test_no_data_shows_no_picture_of_the_start_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(resized(80, 60))
    Image.fromarray(np.zeros((60, 80, 3), np.uint8)).save("black.png")
    Path("out").mkdir()
    Path("out/image.exr").write_text("an earlier fit's")
    assert airlight("fit", "scene.toml", "black.png", "-o", "out") == 1
    assert {path.name for path in Path("out").iterdir()} == {
        "fit.json",
        "report.html",
        "layers.exr",
    }
    page, printed = Path("out/report.html").read_text(), capsys.readouterr().out
    for text in ("Nothing was left out", "Photo and model", "fitted render", "1/width_unit"):
        assert text not in page.split("Command and versions")[0].split("</style>")[1], text
    for name in ("parameters", "correlation", "errors", "descent", "profile"):
        assert f'<section id="{name}' not in page
    assert "brightness" not in printed


# --- bounds and priors of what is held ----------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ({"bounds": {"gamma": (0.5, 2.0)}}, "bounds: gamma is held at 1"),
        ({"priors": {"gamma": (1.0, 0.05)}}, "prior: gamma is held at 1"),
        ({"free": ["brightness"], "bounds": {"background": (0, 1)}}, "background is held at 0 and"),
        ({"free": ["brightness"], "bounds": {"shadow": (0, 1)}}, "bounds: shadow is held at 0.5"),
        ({"free": ["tint.r"], "priors": {"tint.g": (1, 0.1)}}, "prior: tint.g is held at 1"),
    ],
)
def test_limits_of_what_is_held_are_refused(
    words: dict[str, Any], named: str, clean: np.ndarray, layers: Layers
) -> None:
    with pytest.raises(InputError, match=named) as error:
        fit(clean, layers, START, **words)
    assert "add it to free" in str(error.value)


def test_limits_of_what_is_tied_go_to_the_one_it_follows(clean: np.ndarray, layers: Layers) -> None:
    photos, sets = [noisy(clean), noisy(1.1 * clean)], [layers, layers]
    tied = {"gamma.2": "gamma.1"}
    free = ["brightness", "shadow", "tint", "gamma.1", "exposure.2"]
    with pytest.raises(
        InputError, match=r"bounds: gamma\.2 is tied to gamma\.1; give its bounds to"
    ):
        fit(photos, sets, START, free=free, tied=tied, bounds={"gamma.2": (0.5, 2.0)})
    result = fit(photos, sets, START, free=free, tied=tied, bounds={"gamma.1": (0.5, 2.0)})
    assert result.parameters["gamma.2"].bounds == (0.5, 2.0)
    assert result.parameters["gamma.2"].interval == result.parameters["gamma.1"].interval
    assert "gamma.1 and gamma.2 are hard to tell apart" not in result.report()


def test_limits_of_a_family_speak_of_its_free_members(clean: np.ndarray, layers: Layers) -> None:
    """The first exposure is held, the second is not."""
    photos = [noisy(clean), noisy(1.1 * clean)]
    result = fit(photos, [layers, layers], START, bounds={"exposure": (0.5, 2.0)})
    assert result.parameters["exposure.2"].bounds == (0.5, 2.0)


# --- photos of another shape --------------------------------------------------------------------


def test_a_cropped_photo_is_told_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """To change camera.width moves the planet, by half of what was cut off on one side."""
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE)
    Image.fromarray(np.full((120, 100, 3), 9, np.uint8)).save("crop.png")
    assert airlight("fit", "scene.toml", "crop.png", "-o", "out") == 2
    line = capsys.readouterr().err
    assert "100×120 pixels have another shape than the scene's 160×120" in line
    assert "put it back into its place there and --mask the rest" in line


def test_the_advice_for_a_crop_holds(clean: np.ndarray, layers: Layers) -> None:
    """The cut-out in its place, the rest masked, gives the look."""
    light = noisy(clean)
    light[:, :70] = np.nan  # as a mask does
    result = fit(light, layers, START)
    assert result.parameters["brightness"].value == pytest.approx(3.0, abs=0.02)
    assert not np.any(result.used[:, :70])


# --- several photos -----------------------------------------------------------------------------


def test_negative_black_levels_are_warned_of(clean: np.ndarray, layers: Layers) -> None:
    photos = [noisy(clean), noisy(1.1 * clean - 0.05)]
    below = {"black_level": (-1.0, 1.0)}
    (warning,) = fit(photos, [layers, layers], START, bounds=below).warnings
    assert warning.startswith("Negative by more than three standard errors: black_level.2.")


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_photo_without_air_is_named_beside_one_with(
    order: tuple[int, int], clean: np.ndarray, layers: Layers
) -> None:
    """The test for air stopped at the first photo that has some."""
    seen = [(noisy(clean), layers), bare_disc()]
    photos, sets = zip(*(seen[k] for k in order), strict=True)
    result = fit(list(photos), list(sets), START)
    assert result.verdict != "no_data"
    told = [text for text in result.warnings if "no atmosphere shows" in text]
    assert len(told) == 1
    assert told[0].startswith(f"Photo {order.index(1) + 1}: no atmosphere shows")


# --- what is said of residuals and correlations -------------------------------------------------


def test_a_perfect_fit_says_nothing_of_its_rounding_errors(
    clean: np.ndarray, layers: Layers
) -> None:
    result = fit(clean, layers, START)
    size = np.abs(result.correlation - np.eye(len(result.correlation)))
    assert size.max() > 0.9, "there are close pairs"
    assert "hard to tell apart" not in result.report()
    # With noise a thousand times smaller than a code step the same pairs matter.
    assert "hard to tell apart" in fit(noisy(clean), layers, START).report()


def test_errors_that_matter_by_the_typical_size_where_the_value_is_zero() -> None:
    def pairs(stderr: float) -> int:
        row = {"value": 0.0, "stderr": stderr, "scale": 0.01}
        matrix = [[1.0, 0.95], [0.95, 1.0]]
        names = ["a", "b"]
        document = {
            "parameters": dict.fromkeys(names, row),
            "correlation": {"names": names, "matrix": matrix},
        }
        return len(close_pairs(document))

    assert pairs(2e-6) == 1
    assert pairs(0.5e-6) == 0


def hanging(result: FitResult) -> str:
    (told,) = [text for text in result.warnings if "hangs together" in text]
    return told


def test_a_robust_loss_is_not_advised_where_it_was_used(clean: np.ndarray, layers: Layers) -> None:
    light = with_blotch(clean)
    assert "or use a robust loss" in hanging(fit(light, layers, START))
    for text in fit(light, layers, START, loss="cauchy").warnings:
        assert "robust loss" not in text
        assert "mask" not in text


def test_masks_are_not_advised_where_all_of_the_air_is_off(
    clean: np.ndarray, layers: Layers
) -> None:
    """Pictures of nothing but air were to be masked."""
    y, x = np.mgrid[:128, :160]
    sectors = 1 + 0.3 * np.sin(3 * np.arctan2(y - 63.5, x - 79.5))
    result = fit(noisy(clean * sectors[..., None]), layers, START)
    assert "no noise" in hanging(result)
    for text in result.warnings:
        assert "mask" not in text
        assert "robust loss" not in text


def test_fit_json_holds_the_same_sentences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clean: np.ndarray
) -> None:
    """Message and warnings of a result are those of its document."""
    below = {"background": (-1.0, 1.0)}
    result = fit(noisy(clean - 0.05), analytic_layers(scene()), START, bounds=below)
    document = json.loads(json.dumps(result.to_dict()))
    assert document["warnings"] == list(result.warnings)
    assert any("came out negative" in text for text in document["warnings"])
    assert all(text in result.message for text in result.warnings)


# --- a result in a shell, a notebook and a pickle -----------------------------------------------


@pytest.fixture(scope="module")
def fitted(clean: np.ndarray, layers: Layers) -> FitResult:
    return fit(noisy(clean), layers, START, loss="cauchy")


def test_a_result_prints_as_its_report(fitted: FitResult) -> None:
    assert str(fitted) == fitted.report()
    assert repr(fitted).startswith("<FitResult converged: brightness 3.00")
    assert len(repr(fitted)) < 300


def test_a_notebook_shows_the_report(fitted: FitResult) -> None:
    html = fitted._repr_html_()
    assert html.startswith("<pre")
    assert "brightness" in html
    assert "converged</span>" in html, "the verdict has its colour"
    marked = dataclasses.replace(fitted, warnings=("<b>not markup</b>",))
    assert "<b>" not in marked._repr_html_()
    assert "#000000" not in html, "black is not read on dark"


def test_a_notebook_shows_it_once(fitted: FitResult, monkeypatch: pytest.MonkeyPatch) -> None:
    """There rich shows by itself what is printed to it."""
    monkeypatch.setattr("rich.console._is_jupyter", lambda: True)
    assert str(fitted) == fitted.report()
    assert "brightness" in str(fitted)
    assert "brightness" in fitted._repr_html_()


def test_a_pickle_holds_all_but_the_photo(fitted: FitResult) -> None:
    text = pickle.dumps(fitted)
    # The mask of used pixels is there, a byte each, and two matrices; the light alone is 12 times.
    assert len(text) < 2 * fitted.used.size
    back = pickle.loads(text)
    assert back.to_dict() == fitted.to_dict()
    assert str(back) == str(fitted)
    np.testing.assert_array_equal(back.covariance, fitted.covariance)
    for of in (back, copy.copy(fitted)):
        for ask in (lambda of=of: of.influence("shadow"), of.weights):
            with pytest.raises(InputError, match="no pickle and no copy of a result holds; fit"):
                ask()
    assert np.nanmax(fitted.weights()) > 0.9, "the result itself still has them"


# --- the photo that a scene names ---------------------------------------------------------------


def test_the_photo_of_a_scene_has_its_tone_curve_and_mask(tmp_path: Path) -> None:
    codes = np.random.default_rng(4).integers(0, 255, (6, 8, 3)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "photo.png")
    mask = np.zeros((6, 8), np.uint8)
    mask[2:, :] = 255
    Image.fromarray(mask).save(tmp_path / "mask.png")
    table = '[photo]\npath = "photo.png"\ntone_curve = { gamma = 1.8 }\nmask = "mask.png"\n'
    (tmp_path / "scene.toml").write_text(SCENE + table)
    settings = load_scene(tmp_path / "scene.toml").photo
    photo = load_photo(settings)
    assert photo.tone_curve.describe() == {"gamma": 1.8}
    assert (photo.reason != 0).tolist() == (mask == 0).tolist()
    assert load_photo(settings, "srgb").tone_curve.describe() == "srgb"
    Image.fromarray(255 - mask).save(tmp_path / "other.png")
    other = load_photo(settings, mask=tmp_path / "other.png")
    assert (other.reason != 0).tolist() == (mask != 0).tolist()
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(InputError, match="the scene names none; write path into its"):
        load_photo(load_scene(tmp_path / "scene.toml").photo)
    slips: tuple[Any, ...] = ("", {}, 0)
    for slip in slips:
        with pytest.raises(InputError, match="none of the known curves"):
            load_photo(settings, slip)
    with pytest.raises(InputError, match=r"is a SceneFile; give its \.photo"):
        load_photo(load_scene(tmp_path / "scene.toml"))  # type: ignore[arg-type]
