"""What a fit leaves out, where it ends at a bound, and verdicts that are true."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import least_squares

from fit import Verdict, fit, load_photo
from fit._verdict import VERDICTS, WELL_EXPLAINED
from fit.solve import _polish
from model_jax import (
    InputError,
    Layers,
    LayersLook,
    Planet,
    analytic_layers,
    layer_widths,
)

from .looks import START, TRUTH, check_values, picture, scene, square_sum, to_values


def test_without_sun_the_shadow_weight_is_left_out() -> None:
    layers = analytic_layers(scene(sun=False))
    result = fit(picture(layers, TRUTH), layers, START)
    assert result.verdict == "converged"
    assert [(item.what, item.why) for item in result.left_out] == [
        (
            "shadow",
            "the layers hold no shadow: no sun is given, or no air in view is in shadow",
        )
    ]
    shadow = result.parameters["shadow"]
    assert (shadow.value, shadow.stderr, shadow.free) == (0.5, None, False)
    assert result.look.brightness == pytest.approx(3.0, rel=1e-4)


def test_without_dark_pixels_the_shadow_weight_is_left_out(layers: Layers) -> None:
    photo = picture(layers, TRUTH).copy()
    photo[np.asarray(layer_widths(layers)[1]) > 0] = np.nan
    result = fit(photo, layers, START)
    assert result.verdict == "converged"
    assert [item.why for item in result.left_out] == ["no pixel used is in shadow"]
    asked = fit(photo, layers, START, free=["brightness", "shadow", "tint", "background"])
    assert asked.verdict == "not_identifiable"
    assert asked.left_out == result.left_out


def test_a_lone_tint_is_left_out(layers: Layers) -> None:
    """Tints keep their mean: one alone cannot move."""
    result = fit(picture(layers, TRUTH), layers, START, free=["brightness", "tint.r"])
    assert result.verdict == "not_identifiable"
    assert [item.what for item in result.left_out] == ["tint.r"]
    assert result.parameters["tint.r"].stderr is None


def test_without_lit_pixels_shadow_is_held(layers: Layers) -> None:
    lit, _ = layer_widths(layers)
    photo = picture(layers, TRUTH).copy()
    photo[np.asarray(lit) > 0] = np.nan
    result = fit(photo, layers, LayersLook(1.0, 0.1))
    assert "no pixel used is lit" in result.left_out[0].why
    assert result.look.brightness * 0.1 == pytest.approx(3.0 * 0.2, rel=1e-3)


def flat_layers(thickness: float) -> Layers:
    front = np.zeros((20, 30), np.float32)
    return Layers(front, front + np.float32(thickness))


def test_level_and_air_of_one_thickness(layers: Layers) -> None:
    """A background cannot be told from air that is equally thick everywhere: it is held."""
    photo = np.random.default_rng(0).normal(0.6, 0.01, size=(20, 30, 3))
    result = fit(photo, flat_layers(0.2), START)
    assert result.verdict == "misfit"  # noise about a constant is not explained by one
    assert "what is left over is noise" in result.message
    assert result.left_out[-1].what == "background"
    assert not result.parameters["background"].free
    assert result.look.brightness == pytest.approx(0.6 / 0.2, rel=0.01)
    asked = fit(photo, flat_layers(0.2), START, free=["brightness", "background"])
    assert asked.verdict == "not_identifiable"
    assert "brightness" in asked.left_out[-1].why


def test_colourless_channel(layers: Layers) -> None:
    """Where the air has no red, no photo tells the red tint; the others are told."""
    coloured = Layers(
        layers.front,
        layers.back,
        layers.shadow_front,
        layers.shadow_back,
        planet=layers.planet,
        color=(0.0, 0.5, 1.0, 1.0),
        width_unit=layers.width_unit,
    )
    result = fit(picture(coloured, LayersLook(3.0, 0.2, (1.0, 0.8, 1.2))), coloured, START)
    check_values(result, LayersLook(3.0, 0.2, (1.0, 0.8, 1.2)), 1e-4)
    assert [item.what for item in result.left_out] == ["tint.r"]


@pytest.mark.parametrize(
    ("look", "at_bound"),
    [
        # The shadow weight's bound is also met in `test_traced`, and by the command line.
        pytest.param((3.0, -0.1, (1.0, 1.0, 1.0)), "shadow", marks=pytest.mark.full, id="shadow"),
        # A tint's is also met where JPEG is undone.
        pytest.param((3.0, 0.2, (-0.1, 1.5, 1.6)), "tint.r", marks=pytest.mark.full, id="tint"),
        pytest.param((-1.0, 0.2, (1.0, 1.0, 1.0)), "brightness", id="brightness"),
    ],
)
def test_bounds(
    look: tuple[float, float, tuple[float, ...]], at_bound: str, layers: Layers
) -> None:
    """A photo whose best fit lies outside: the parameter ends at its bound, and the fit says so."""
    brightness, shadow, tint = look
    lit, dark = (np.asarray(width) for width in layer_widths(layers) if width is not None)
    photo = 1.0 + brightness * np.asarray(tint) * (lit + shadow * dark)[..., None]
    result = fit(photo, layers, START)
    # Without air of its own a look explains nothing.
    assert result.verdict == ("misfit" if at_bound == "brightness" else "at_bound")
    assert at_bound in result.message
    assert result.parameters[at_bound].value == 0.0
    assert result.parameters[at_bound].stderr is None
    assert np.mean(result.look.tint) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "seed", [pytest.param(s, marks=pytest.mark.full if s > 0 else ()) for s in range(6)]
)
def test_the_end_at_a_bound_is_the_best_corner(seed: int) -> None:
    """Against SciPy's bounded least squares from eight starts, where bounds are active.

    Channel amplitudes of random sign, a negative shadow weight; lit air alone keeps brightness up.
    """
    rng = np.random.default_rng(seed)
    lit, dark = rng.uniform(0.5, 1, (20, 20)), rng.uniform(0, 0.5, (20, 20))
    layers = Layers(np.zeros_like(lit), lit + dark, lit, lit + dark)
    amplitude = rng.permutation([-0.3, 0.5, 1.0])
    photo = amplitude * (lit - 0.2 * dark)[..., None] + rng.normal(scale=0.02, size=(20, 20, 3))
    result = fit(photo, layers, START, free=["brightness", "shadow", "tint"])

    def residual(x: np.ndarray) -> np.ndarray:
        return (x[:3] * (lit + x[3] * dark)[..., None] - photo).reshape(-1)

    runs = [least_squares(residual, rng.uniform(0, 2, 4), bounds=(0, np.inf)) for _ in range(8)]
    best = 2 * min(run.cost for run in runs)
    assert result.verdict == "misfit"  # most of its light is what no look can be
    # SciPy stays a little inside the bounds; ours may be lower, never higher.
    assert square_sum(photo, layers, result) <= best * (1 + 1e-6)


def test_intervals_end_at_bounds(layers: Layers) -> None:
    """A channel that hardly shines, under noise: no interval holds what is not allowed, and a value
    within its own error of 0 is told as "at most". Seeds of 0 to 5 show both kinds."""
    light = picture(layers, LayersLook(3.0, 0.02, (0.01, 1.2, 1.79), background=0.01)).astype(float)
    told = []
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(scale=0.2, size=light.shape)
        result = fit((light + noise).astype(np.float32), layers)
        for name in result.correlation_names:
            e = result.parameters[name]
            assert e.stderr is not None
            assert e.interval is not None
            low, high = e.interval
            assert e.bounds[0] <= low <= e.value <= high <= e.bounds[1], name
            beside = bool(e.value - e.stderr <= e.bounds[0])
            assert e.one_sided == (f"at most {high:.3g}" if beside else "")
            told.append(beside)
            assert any(f"{name} is at most" in w for w in result.warnings) == beside
            assert (f"≤ {high:.3g}" in result.report()) == (low == e.bounds[0])
    assert any(told)
    assert not all(told)


def test_surface_is_added(layers: Layers) -> None:
    surface = np.random.default_rng(5).uniform(0, 0.3, size=(128, 160, 3)).astype(np.float32)
    covered = Layers(
        layers.front,
        layers.back,
        layers.shadow_front,
        layers.shadow_back,
        surface * np.asarray(layers.planet)[..., None],
        layers.planet,
        width_unit=layers.width_unit,
    )
    result = fit(picture(covered, TRUTH), covered, START)
    check_values(result, TRUTH, 1e-4)
    assert result.pixels["used"] > fit(picture(layers, TRUTH), layers).pixels["used"]


@pytest.mark.parametrize(
    ("light", "word"),
    [(0.0, "black"), (0.3, "same"), (np.nan, "not finite"), (np.inf, "not finite")],
    ids=["black", "grey", "nan", "inf"],
)
def test_photos_that_show_nothing(light: float, word: str, layers: Layers) -> None:
    result = fit(np.full((128, 160, 3), light, np.float32), layers, START)
    assert result.verdict == "no_data"
    assert word in result.message
    assert to_values(result)["brightness"] == 1.0
    json.dumps(result.to_dict(), allow_nan=False)


def test_white_photo(layers: Layers, tmp_path: Path) -> None:
    Image.fromarray(np.full((128, 160, 3), 255, np.uint8)).save(tmp_path / "white.png")
    result = fit(load_photo(tmp_path / "white.png"), layers)
    assert result.verdict == "no_data"
    assert "saturated" in result.message


def test_mask_that_excludes_everything(layers: Layers, tmp_path: Path) -> None:
    Image.fromarray(np.full((128, 160, 3), 90, np.uint8)).save(tmp_path / "photo.png")
    Image.fromarray(np.zeros((128, 160), np.uint8)).save(tmp_path / "mask.png")
    result = fit(load_photo(tmp_path / "photo.png", mask=tmp_path / "mask.png"), layers)
    assert result.verdict == "no_data"
    assert result.pixels["excluded"]["masked"] > 0
    assert result.pixels["used"] == 0


def test_a_picture_full_of_planet_needs_its_colour() -> None:
    """The disc spans 39° and the picture's diagonal 37°; a black planet is told apart from none."""
    seen = scene()
    seen = replace(seen, camera=replace(seen.camera, fov_y_deg=24))
    black = analytic_layers(replace(seen, planet=Planet(1.0, albedo=(0, 0, 0))))
    assert np.all(black.planet)
    photo = picture(black, TRUTH)
    for where in ("all", "planet"):
        check_values(fit(photo, black, START, where=where), TRUTH, 1e-4)
    result = fit(photo, analytic_layers(seen), START)
    assert result.verdict == "no_data"
    assert result.pixels["excluded"] == {"planet without a surface layer": 128 * 160}
    assert (
        "give the planet one colour, [planet] albedo = [0, 0, 0] for a dark one" in result.message
    )
    ring = fit(photo, black, START, where="ring")
    assert ring.verdict == "no_data"
    assert ring.pixels["excluded"] == {"in front of the planet": 128 * 160}
    assert "albedo" not in ring.message


def test_air_over_the_planet_alone_is_air() -> None:
    """A planet unlike its declared colour is fitted badly, but no bare limb explains its disc."""
    layers = analytic_layers(replace(scene(), planet=Planet(1.0, albedo=(0.3, 0.3, 0.3))))
    photo = picture(layers, TRUTH)
    spots = np.asarray(layers.planet) * np.random.default_rng(0).uniform(0, 1, (128, 160))
    result = fit(photo + spots[..., None].astype(np.float32), layers, START, where="planet")
    assert result.explained is not None
    assert result.explained < WELL_EXPLAINED
    assert result.verdict != "no_data", result.message


def test_single_pixel() -> None:
    layers = Layers(np.zeros((1, 1), np.float32), np.ones((1, 1), np.float32))
    result = fit(np.full((1, 1, 3), 0.5), layers)
    assert result.verdict == "no_data"
    assert "used is 1, needed are 5" in result.message


def test_broken_pixels_change_nothing_else(layers: Layers) -> None:
    photo = picture(layers, TRUTH).copy()
    photo[10:40, 20:60, 1] = np.nan
    photo[100, 100] = np.inf
    result = fit(photo, layers, START)
    check_values(result, TRUTH, 1e-4)
    pixels = result.pixels
    assert pixels["used"] + sum(pixels["excluded"].values()) == pixels["total"]
    assert pixels["excluded"]["not finite"] > 0


def test_json_has_the_schemas_keys(layers: Layers) -> None:
    made = fit(picture(layers, TRUTH), layers).to_dict()
    json.dumps(made, allow_nan=False)
    assert {"verdict", "message", "parameters", "correlation", "residual_rms"} <= made.keys()
    assert {"pixels", "left_out", "seconds"} <= made.keys()
    keys = {"value", "stderr", "initial", "free", "unit", "bounds"}
    assert all(keys <= entry.keys() for entry in made["parameters"].values())
    assert made["parameters"]["brightness"]["bounds"] == [0.0, None]
    assert {"reduce", "solve", "errors"} == made["seconds"].keys()


def test_wrong_names_and_sizes(layers: Layers) -> None:
    photo = picture(layers, TRUTH)
    with pytest.raises(InputError, match="'haze'"):
        fit(photo, layers, free=["brightness", "haze"])
    with pytest.raises(InputError, match="nothing to fit"):
        fit(photo, layers, free=[])
    with pytest.raises(InputError, match="'newton'"):
        fit(photo, layers, solver="newton")
    with pytest.raises(InputError, match=r"160×127.*160×128"):
        fit(photo[1:], layers)


def test_verdicts_have_labels() -> None:
    assert [verdict.label for verdict in Verdict] == [
        "converged",
        "at_bound",
        "not_identifiable",
        "not_converged",
        "diverged",
        "no_data",
        "misfit",
    ]


def test_verdicts_have_a_sentence_and_a_remedy() -> None:
    """Without full stops; what went well needs no remedy."""
    assert list(VERDICTS) == list(Verdict)
    for verdict, (sentence, remedy) in VERDICTS.items():
        assert len(sentence.split()) >= 3
        assert (remedy == "") == (verdict == Verdict.CONVERGED)
        assert len({sentence, remedy, sentence.rstrip("."), remedy.rstrip(".")}) == 2
    assert len(set(VERDICTS.values())) == len(Verdict)


def test_light_beyond_what_float64_squares_diverges(layers: Layers) -> None:
    result = fit(picture(layers, TRUTH), layers, bounds={"brightness": (1e200, np.inf)})
    assert result.verdict == "diverged"
    assert VERDICTS[Verdict.DIVERGED][1] in result.message
    assert {e.stderr for e in result.parameters.values()} == {None}
    assert to_values(result)["shadow"] == LayersLook().shadow
    json.dumps(result.to_dict(), allow_nan=False)


def test_too_few_steps_do_not_converge(layers: Layers, monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact steps at the end save every descent that is known, so they are left out."""
    for name in ("_FINISHES", "_FINISH_STEPS"):
        monkeypatch.setattr(_polish, name, 0)
    result = fit(picture(layers, TRUTH), layers, START, max_steps=1, sampling="point")
    assert result.verdict == "not_converged"
    assert VERDICTS[Verdict.NOT_CONVERGED][1] in result.message
    assert result.look.shadow != pytest.approx(TRUTH.shadow, rel=1e-6)
    assert fit(picture(layers, TRUTH), layers, START).verdict == "converged"


def test_importing_fit_needs_no_opengl() -> None:
    """`fit`'s core works where there is no OpenGL, and does not pay for plots."""
    code = (
        "import sys, fit; print(sorted({'render_gl', 'moderngl', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_result_is_a_plain_record(layers: Layers) -> None:
    result = fit(picture(layers, TRUTH), layers)
    assert replace(result, verdict="x").look is result.look
