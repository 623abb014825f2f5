"""The fit: recovery of known looks, and errors that mean what they say."""

from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image

from fit import Photo, fit, load_photo
from fit._choices import SOLVERS
from fit.solve._polish import CHECK, KINK, is_on_kink, is_settled
from fit.solve._problem import Point
from model_jax import (
    Layers,
    LayersLook,
    Srgb,
    analytic_layers,
)

from .looks import (
    START,
    TRUTH,
    check_values,
    evidence_of,
    oracle,
    picture,
    scene,
    square_sum,
    to_values,
)


def test_recovers_from_float32_layers(layers: Layers) -> None:
    """Widths are rounded by 3e-7 of a typical one; 1e-4 leaves a factor of 300 for columns that are
    alike."""
    result = fit(picture(layers, TRUTH), layers, START)
    check_values(result, TRUTH, 1e-4)
    assert result.explained is not None
    assert result.explained > 1 - 1e-6
    assert result.parameters["brightness"].initial == 1.0
    assert result.per_length["brightness"] == pytest.approx(3.0 / 5.5, rel=1e-4)
    configuration: Any = jax.config  # its type does not list its settings
    assert not configuration.jax_enable_x64


def test_recovers_from_float64_layers(layers64: Layers) -> None:
    """To the root of float64's eps, below which a square sum tells nothing; with JAX's x64 off in
    the caller."""
    with jax.enable_x64(True):
        photo = picture(layers64, TRUTH)
    check_values(fit(photo, layers64, START), TRUTH, 1e-8)


def test_recovers_weights_and_levels_per_channel(layers64: Layers) -> None:
    truth = LayersLook(2.0, (0.1, 0.4, 0.0625), (1.1, 1.2, 0.7), background=(0.0, 0.02, 0.04))
    start = LayersLook(1.0, (0.2, 0.2, 0.2), background=(0.0, 0.0, 0.0))
    with jax.enable_x64(True):
        photo = picture(layers64, truth)
    result = fit(photo, layers64, start)
    check_values(result, truth, 1e-8)
    assert {"shadow.r", "background.b", "tint.g"} <= set(result.correlation_names)


def test_what_is_not_free_stays(layers: Layers) -> None:
    start = LayersLook(1.0, 0.5, (0.8, 0.9, 1.3), background=0.01)
    result = fit(picture(layers, TRUTH), layers, start, free=["brightness", "shadow"])
    check_values(result, TRUTH, 1e-4)
    assert result.correlation_names == ("brightness", "shadow")
    assert not result.parameters["tint.r"].free
    assert result.parameters["tint.r"].stderr is None


def test_free_tint_is_normalised(layers: Layers) -> None:
    start = LayersLook(2.0, 0.2, (2.0, 2.0, 4.0))
    result = fit(picture(layers, TRUTH), layers, start)
    check_values(result, TRUTH, 1e-4)
    assert np.mean(result.look.tint) == pytest.approx(1.0, abs=1e-12)
    assert result.parameters["tint.b"].initial == 4.0


def test_recovers_from_an_8_bit_png(layers: Layers, tmp_path: Path) -> None:
    """Within 1 %, and within three standard errors plus the bound on rounding's bias."""
    truth = LayersLook(brightness=3.0, shadow=0.2, tint=(0.9, 1.05, 1.05))
    codes = np.rint(255 * np.asarray(Srgb().encode(picture(layers, truth)))).astype(np.uint8)
    assert codes.max() < 255
    Image.fromarray(codes).save(tmp_path / "photo.png")
    result = fit(load_photo(tmp_path / "photo.png"), layers, START)
    assert result.verdict == "converged"
    for name, true in (("brightness", 3.0), ("shadow", 0.2), ("tint.r", 0.9), ("background", 0.0)):
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


def replace_light(look: LayersLook, scale: float) -> LayersLook:
    return LayersLook(
        look.brightness * scale, look.shadow, look.tint, background=look.background * scale
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_find_the_optimum(solver: str, layers64: Layers, noisy: np.ndarray) -> None:
    result = fit(noisy, layers64, START, solver=solver)
    best, _ = oracle(noisy, layers64, result.used)
    found = square_sum(noisy, layers64, result)
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
    result = fit(picture(layers, TRUTH), layers, LayersLook(start, start, (0.0, 0.0, start)))
    check_values(result, TRUTH, 1e-4)


@pytest.mark.parametrize("promise", [0.5, 2.0], ids=["inside", "outside"])
def test_the_end_is_judged_by_what_a_step_promises(
    promise: float, layers64: Layers, noisy: np.ndarray
) -> None:
    """Steps away from the optimum on purpose: beyond `CHECK` of a variance it is not settled.

    The exact steps at the end save every solver on a linear model, so the check is made by hand.
    """
    result = fit(noisy, layers64, START)
    evidence = evidence_of(result)
    point, end = evidence.point, evidence.end
    curved = end.gram[:-1, :-1]
    variance = end.square_sum / (point.problem.count - len(curved))
    step = np.zeros(len(curved))
    step[0] = np.sqrt(promise * CHECK * variance / curved[0, 0])
    away = point.moved(step)
    assert is_settled(point.problem, away.gram()) == (promise < 1)
    # Where the light is smooth a step keeps what it is promised.
    assert is_on_kink(away, away.gram()) == (promise < 1)


class _Kinked(Point):
    """Of one number: the square sum falls towards 0 from both sides, as `|x|` does."""

    def gram(self) -> np.ndarray:
        at = float(self.vector[0])
        slope = (0.005 if at >= 0 else -0.005) + at
        return np.array([[1.0, slope], [slope, 100 + 0.01 * abs(at) + at**2]])


def test_the_end_may_be_a_kink(layers64: Layers, noisy: np.ndarray) -> None:
    problem = evidence_of(fit(noisy, layers64, START)).point.problem
    kink = _Kinked(problem, np.zeros(1), np.ones((1, 1)))
    variance = 100 / (problem.count - 1)
    assert CHECK * variance < 0.005**2 < KINK * variance
    assert not is_settled(problem, kink.gram())
    assert is_on_kink(kink, kink.gram())
    beside = kink.moved(np.array([0.01]))
    assert not is_on_kink(beside, beside.gram())


@pytest.mark.full
def test_standard_errors_are_those_of_repetition(layers: Layers) -> None:
    """Over 200 noisy photos the scatter is what the standard errors say.

    The variance of 200 normal numbers has a relative standard deviation of sqrt(2/199) = 0.10, a
    correlation one of (1 - ρ²)/sqrt(200) ≤ 0.07; the bands are 5 of these. The mean is
    within 5/√200.
    """
    rng = np.random.default_rng(3)
    clean = picture(layers, TRUTH)
    photos = [clean + rng.normal(scale=0.02, size=clean.shape) for _ in range(200)]
    runs = [fit(photo, layers, sampling="point") for photo in photos]
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
        np.sqrt(np.diag(runs[0].covariance)),
        np.array([runs[0].parameters[n].stderr for n in names], float),
    )
