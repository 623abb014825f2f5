"""The fit: recovery of known looks, errors that mean what they say, verdicts that are true."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.optimize import least_squares, minimize_scalar

from fit import FitResult, Photo, Verdict, fit, load_photo
from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    Look,
    Planet,
    Scene,
    Srgb,
    Sun,
    analytic_layers,
    composite,
    layer_widths,
)

TRUTH = Look(brightness=3.0, shadow=0.2, tint=(0.8, 0.9, 1.3), background=0.01)
START = Look(brightness=1.0, shadow=0.5)


def scene(unit: float = 1.0, sun: bool = True) -> Scene:
    """A thick shell all around a planet that the sun lights from the right; lengths × `unit`."""
    return Scene(
        camera=Camera(
            position=(0, 0, 3 * unit),
            forward=(0, 0, -1),
            up=(0, 1, 0),
            fov_y_deg=50,
            width=160,
            height=128,
            near=0.5 * unit,
            far=6 * unit,
        ),
        planet=Planet(radius=unit),
        atmosphere=Atmosphere(height=0.2 * unit),
        sun=Sun(direction=(1, 0.2, 0.3)) if sun else None,
    )


def picture(layers: Layers, look: Look) -> np.ndarray:
    return np.asarray(composite(layers, look))[..., :3]


@pytest.fixture(scope="module")
def layers() -> Layers:
    return analytic_layers(scene())


@pytest.fixture(scope="module")
def layers64() -> Layers:
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, analytic_layers(scene(), np.float64))


@pytest.fixture(scope="module")
def noisy(layers64: Layers) -> np.ndarray:
    """A photo that the model does not explain: noise, and a ramp that is no air."""
    rng = np.random.default_rng(7)
    with jax.enable_x64(True):
        clean = picture(layers64, TRUTH)
    ramp = np.linspace(0, 0.1, clean.shape[1])[:, None]
    return clean + ramp + rng.normal(scale=0.05, size=clean.shape)


def check_values(result: FitResult, truth: Look, tolerance: float) -> None:
    assert result.verdict == "converged", result.message
    for name in ("brightness", "shadow", "tint", "background"):
        np.testing.assert_allclose(
            getattr(result.look, name),
            getattr(truth, name),
            rtol=tolerance,
            atol=tolerance * 0.1,  # the background is a tenth of what is bright in the picture
            err_msg=name,
        )


def square_sum(photo: np.ndarray, layers: Layers, result: FitResult) -> float:
    with jax.enable_x64(True):
        residual = picture(layers, result.look) - photo
    return float((residual[result.used] ** 2).sum())


def oracle(photo: np.ndarray, layers: Layers, used: np.ndarray) -> tuple[float, float]:
    """Least square sum, and its shadow weight, by a search in the one weight (DESIGN §4).

    Given the weight, brightness × tint and the background are linear: NumPy's lstsq on all pixels.
    """
    with jax.enable_x64(True):
        widths = layer_widths(layers)
    lit, dark = (np.asarray(width)[used] for width in widths if width is not None)
    target = photo[used].T.reshape(-1)

    def cost(shadow: float) -> float:
        matrix = np.kron(np.eye(3), (lit + shadow * dark)[:, None])
        matrix = np.column_stack([matrix, np.ones_like(target)])
        solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return float(((matrix @ solution - target) ** 2).sum())

    grid = np.linspace(0, 3, 61)
    middle = int(np.argmin([cost(s) for s in grid]))
    best = minimize_scalar(
        cost,
        bounds=(grid[max(middle - 1, 0)], grid[min(middle + 1, 60)]),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return float(best.fun), float(best.x)


def test_recovers_from_float32_layers(layers: Layers) -> None:
    """Issue 2: to 1e-4 from float32 layers."""
    result = fit(picture(layers, TRUTH), layers, START)
    check_values(result, TRUTH, 1e-4)
    assert result.explained is not None
    assert result.explained > 1 - 1e-6
    assert result.parameters["brightness"].initial == 1.0
    assert result.brightness_per_length == pytest.approx(3.0 / 5.5, rel=1e-4)
    assert not jax.config.jax_enable_x64


def test_recovers_from_float64_layers(layers64: Layers) -> None:
    """Issue 2: to 1e-8 from analytic float64 layers, with JAX's x64 off in the caller."""
    with jax.enable_x64(True):
        photo = picture(layers64, TRUTH)
    check_values(fit(photo, layers64, START), TRUTH, 1e-8)


def test_recovers_weights_and_levels_per_channel(layers64: Layers) -> None:
    truth = Look(2.0, (0.1, 0.4, 0.0625), (1.1, 1.2, 0.7), (0.0, 0.02, 0.04))
    start = Look(1.0, (0.2, 0.2, 0.2), background=(0.0, 0.0, 0.0))
    with jax.enable_x64(True):
        photo = picture(layers64, truth)
    result = fit(photo, layers64, start)
    check_values(result, truth, 1e-8)
    assert {"shadow.r", "background.b", "tint.g"} <= set(result.correlation_names)


def test_what_is_not_free_stays(layers: Layers) -> None:
    start = Look(1.0, 0.5, (0.8, 0.9, 1.3), 0.01)
    result = fit(picture(layers, TRUTH), layers, start, free=["brightness", "shadow"])
    check_values(result, TRUTH, 1e-4)
    assert result.correlation_names == ("brightness", "shadow")
    assert not result.parameters["tint.r"].free
    assert result.parameters["tint.r"].stderr is None


def test_free_tint_is_normalised(layers: Layers) -> None:
    start = Look(2.0, 0.2, (2.0, 2.0, 4.0))
    result = fit(picture(layers, TRUTH), layers, start)
    check_values(result, TRUTH, 1e-4)
    assert np.mean(result.look.tint) == pytest.approx(1.0, abs=1e-12)
    assert result.parameters["tint.b"].initial == 4.0


def test_recovers_from_an_8_bit_png(layers: Layers, tmp_path: Path) -> None:
    """Issue 2: within 1 %, and within three standard errors plus the bound on rounding's bias."""
    truth = Look(brightness=3.0, shadow=0.2)
    codes = np.rint(255 * np.asarray(Srgb().encode(picture(layers, truth)))).astype(np.uint8)
    assert codes.max() < 255
    Image.fromarray(codes).save(tmp_path / "photo.png")
    result = fit(load_photo(tmp_path / "photo.png"), layers, START)
    assert result.verdict == "converged"
    for name, true in (("brightness", 3.0), ("shadow", 0.2), ("tint.r", 1.0), ("background", 0.0)):
        estimate = result.parameters[name]
        assert estimate.stderr is not None
        assert estimate.quantisation_bound is not None
        off = abs(estimate.value - true)
        assert off <= 3 * estimate.stderr + estimate.quantisation_bound, name
        assert off <= 0.01 * (true or 0.1), name


def test_photo_and_array_agree(layers: Layers, tmp_path: Path) -> None:
    codes = np.rint(255 * np.asarray(Srgb().encode(picture(layers, TRUTH)))).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "photo.png")
    photo = load_photo(tmp_path / "photo.png")
    assert isinstance(photo, Photo)
    first, second = fit(photo, layers), fit(photo.linear, layers)
    assert to_values(first) == to_values(second)
    assert second.parameters["shadow"].quantisation_bound is None


def to_values(result: FitResult) -> dict[str, float]:
    return {name: estimate.value for name, estimate in result.parameters.items()}


@pytest.mark.parametrize("scale", [1e-8, 1.0, 1e8], ids=str)
@pytest.mark.parametrize("unit", [1e-6, 1e6], ids=str)
def test_scales_do_not_matter(scale: float, unit: float) -> None:
    """Exposure and length unit change numbers, not what is found (DESIGN §5, the LM trap)."""
    layers = analytic_layers(scene(unit))
    photo = picture(layers, TRUTH).astype(np.float64) * scale
    result = fit(photo, layers, START)
    truth = replace_light(TRUTH, scale)
    assert result.verdict == "converged"
    for name in ("brightness", "shadow", "tint"):
        np.testing.assert_allclose(getattr(result.look, name), getattr(truth, name), rtol=1e-4)
    assert float(result.look.background) == pytest.approx(0.01 * scale, rel=1e-3)


def replace_light(look: Look, scale: float) -> Look:
    return Look(look.brightness * scale, look.shadow, look.tint, look.background * scale)


@pytest.mark.parametrize("solver", ["lm", "dogleg", "gauss_newton", "bfgs", "lbfgs", "nelder_mead"])
def test_solvers_find_the_optimum_or_say_so(
    solver: str, layers64: Layers, noisy: np.ndarray
) -> None:
    result = fit(noisy, layers64, START, solver=solver)
    best, _ = oracle(noisy, layers64, result.used)
    found = square_sum(noisy, layers64, result)
    if solver == "nelder_mead":  # has no derivatives: it may give up, but must not boast
        assert result.verdict == "not_converged" or found <= best * (1 + 1e-6)
    else:
        assert result.verdict == "converged"
        assert found <= best * (1 + 1e-12)


def test_finds_the_oracles_optimum(layers64: Layers, noisy: np.ndarray) -> None:
    """Shadow weight as the one-dimensional search finds it; residual rms and share explained."""
    result = fit(noisy, layers64, START)
    best, shadow = oracle(noisy, layers64, result.used)
    # A square sum known to eps places its minimum to about sqrt(eps) standard errors × sqrt(n).
    assert result.parameters["shadow"].value == pytest.approx(shadow, abs=1e-6)
    used = noisy[result.used]
    assert result.residual_rms == pytest.approx(np.sqrt(best / used.size), rel=1e-9)
    variance = ((used - used.mean(axis=0)) ** 2).sum()
    assert result.explained == pytest.approx(1 - best / variance, rel=1e-9)


@pytest.mark.parametrize("start", [0.0, 1e-6, 1e6], ids=str)
def test_poor_starts(start: float, layers: Layers) -> None:
    result = fit(picture(layers, TRUTH), layers, Look(start, start, (0.0, 0.0, start)))
    check_values(result, TRUTH, 1e-4)


def test_one_step_is_not_called_converged(layers64: Layers, noisy: np.ndarray) -> None:
    result = fit(noisy, layers64, START, solver="nelder_mead", max_steps=3)
    assert result.verdict == "not_converged"
    assert "lm" in result.message


def test_standard_errors_are_those_of_repetition(layers: Layers) -> None:
    """Over 200 noisy photos the scatter is what the standard errors say.

    The variance of 200 normal numbers has a relative standard deviation of sqrt(2/199) = 0.10, a
    correlation one of (1 - ρ²)/sqrt(200) ≤ 0.07; the bands are 5 of these. The mean is
    within 5/√200.
    """
    rng = np.random.default_rng(3)
    clean = picture(layers, TRUTH)
    runs = [fit(clean + rng.normal(scale=0.02, size=clean.shape), layers) for _ in range(200)]
    names = runs[0].correlation_names
    true = {"brightness": 3.0, "shadow": 0.2, "background": 0.01}
    true |= dict(zip(("tint.r", "tint.g", "tint.b"), (0.8, 0.9, 1.3), strict=True))
    values = np.array([[run.parameters[name].value for name in names] for run in runs])
    errors = np.array([[run.parameters[name].stderr for name in names] for run in runs])
    scores = (values - [true[name] for name in names]) / errors
    assert np.all(np.abs(scores.var(axis=0) - 1) < 0.5)
    assert np.all(np.abs(scores.mean(axis=0)) < 5 / np.sqrt(200))
    assert np.abs(np.corrcoef(values.T) - runs[0].correlation).max() < 0.35
    np.testing.assert_allclose(
        np.sqrt(np.diag(runs[0].covariance)), [runs[0].parameters[n].stderr for n in names]
    )


def test_without_sun_the_shadow_weight_is_left_out() -> None:
    layers = analytic_layers(scene(sun=False))
    result = fit(picture(layers, TRUTH), layers, START)
    assert result.verdict == "converged"
    assert [(item.what, item.why) for item in result.left_out] == [
        (
            "shadow weight",
            "the layers hold no shadow: no sun is given, or no air in view is in shadow",
        )
    ]
    shadow = result.parameters["shadow"]
    assert (shadow.value, shadow.stderr, shadow.free) == (0.5, None, False)
    assert result.look.brightness == pytest.approx(3.0, rel=1e-4)


def test_without_dark_pixels_the_shadow_weight_is_left_out(layers: Layers) -> None:
    photo = picture(layers, TRUTH).copy()
    photo[np.asarray(layer_widths(layers)[1]) > 0] = np.nan
    result = fit(photo, layers, START, free=["brightness", "shadow", "tint", "background"])
    assert result.verdict == "converged"
    assert [item.why for item in result.left_out] == ["no pixel used is in shadow"]


def test_without_lit_pixels_shadow_is_held(layers: Layers) -> None:
    lit, _ = layer_widths(layers)
    photo = picture(layers, TRUTH).copy()
    photo[np.asarray(lit) > 0] = np.nan
    result = fit(photo, layers, Look(1.0, 0.1))
    assert "no pixel used is lit" in result.left_out[0].why
    assert result.look.brightness * 0.1 == pytest.approx(3.0 * 0.2, rel=1e-3)


def flat_layers(thickness: float) -> Layers:
    front = np.zeros((20, 30), np.float32)
    return Layers(front, front + np.float32(thickness))


def test_level_and_air_of_one_thickness(layers: Layers) -> None:
    """A background cannot be told from air that is equally thick everywhere: it is held."""
    photo = np.random.default_rng(0).normal(0.6, 0.01, size=(20, 30, 3))
    result = fit(photo, flat_layers(0.2), START)
    assert result.verdict == "converged"
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
    result = fit(picture(coloured, Look(3.0, 0.2, (1.0, 0.8, 1.2))), coloured, START)
    check_values(result, Look(3.0, 0.2, (1.0, 0.8, 1.2)), 1e-4)
    assert [item.what for item in result.left_out] == ["tint.r"]


@pytest.mark.parametrize(
    ("look", "at_bound"),
    [
        ((3.0, -0.1, (1.0, 1.0, 1.0)), "shadow"),
        ((3.0, 0.2, (-0.1, 1.5, 1.6)), "tint.r"),
        ((-1.0, 0.2, (1.0, 1.0, 1.0)), "brightness"),
    ],
    ids=["shadow", "tint", "brightness"],
)
def test_bounds(
    look: tuple[float, float, tuple[float, ...]], at_bound: str, layers: Layers
) -> None:
    """A photo whose best fit lies outside: the parameter ends at its bound, and the fit says so."""
    brightness, shadow, tint = look
    lit, dark = (np.asarray(width) for width in layer_widths(layers) if width is not None)
    photo = 1.0 + brightness * np.asarray(tint) * (lit + shadow * dark)[..., None]
    result = fit(photo, layers, START)
    assert result.verdict == "at_bound"
    assert at_bound in result.message
    assert result.parameters[at_bound].value == 0.0
    assert result.parameters[at_bound].stderr is None
    assert np.mean(result.look.tint) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(6))
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
    assert result.verdict == "at_bound"
    # SciPy stays a little inside the bounds; ours may be lower, never higher.
    assert square_sum(photo, layers, result) <= best * (1 + 1e-6)


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
    assert {"reduce", "solve"} == made["seconds"].keys()


def test_wrong_names_and_sizes(layers: Layers) -> None:
    photo = picture(layers, TRUTH)
    with pytest.raises(InputError, match="'exposure'"):
        fit(photo, layers, free=["brightness", "exposure"])
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
    ]


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
