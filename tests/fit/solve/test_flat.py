"""What a photo cannot tell is said in words, held, and never given a standard error."""

import numpy as np
import pytest

from fit import FitResult, fit
from model_jax import Layers, LayersLook, Response

NOISE = 0.01
TRUTH = LayersLook(3.0, 0.2, (0.8, 0.9, 1.3), background=0.05)


def air(lit: np.ndarray, dark: np.ndarray) -> Layers:
    """Layers of given widths."""
    return Layers(np.zeros_like(lit), lit + dark, lit, lit + dark, planet=np.zeros_like(lit))


def shot(
    lit: np.ndarray,
    dark: np.ndarray,
    look: LayersLook = TRUTH,
    exposure: float = 1.0,
    seed: int = 1,
) -> np.ndarray:
    width = (lit + float(look.shadow) * dark)[..., None]
    light = float(look.brightness) * np.asarray(look.tint) * width + float(look.background)
    noise = np.random.default_rng(seed).normal(scale=NOISE, size=(*lit.shape, 3))
    return exposure * light + noise


@pytest.fixture(scope="module")
def widths() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(0.1, 0.6, (24, 32)), rng.uniform(0.0, 0.4, (24, 32))


def check_held(result: FitResult, name: str, *words: str) -> None:
    """Held at its start, named with the reason, without an error."""
    why = {item.what: item.why for item in result.left_out}
    assert name in why, result.message
    for word in words:
        assert word in why[name]
    estimate = result.parameters[name]
    assert estimate.role == "held"
    assert estimate.stderr is None
    assert estimate.interval is None
    assert name not in result.correlation_names
    assert estimate.value == pytest.approx(estimate.initial)


def test_brightness_and_exposure(widths: tuple[np.ndarray, np.ndarray]) -> None:
    """Only as a product: exposure is held, and the verdict says so, for it was asked for."""
    lit, dark = widths
    free = ("brightness", "shadow", "exposure")
    # Without a background: a known one would tell the exposure.
    photo = shot(lit, dark, LayersLook(3.0, 0.2, TRUTH.tint, background=0.0))
    look, response = LayersLook(1.0, 0.5, TRUTH.tint, background=0.0), Response(1.3)
    result = fit(photo, air(lit, dark), look, free=free, response=response)
    assert result.verdict == "not_identifiable"
    check_held(result, "exposure", "brightness and exposure only as a product", "another exposure")
    assert result.parameters["brightness"].stderr is not None
    assert result.look.brightness * 1.3 == pytest.approx(3.0, rel=0.01)
    priors = {"exposure": (1.0, 0.01)}
    known = fit(photo, air(lit, dark), look, free=free, response=response, priors=priors)
    assert known.verdict == "converged", known.message
    exposure, brightness = known.parameters["exposure"], known.parameters["brightness"]
    # The photo says nothing of it: what was known comes back, and brightness inherits the width.
    assert exposure.value == pytest.approx(1.0, abs=1e-4)
    assert exposure.stderr == pytest.approx(0.01, rel=1e-3)
    assert brightness.stderr == pytest.approx(0.03, rel=0.05)
    assert abs(brightness.value - 3.0) < 3 * 0.03


def test_background_and_black_level(widths: tuple[np.ndarray, np.ndarray]) -> None:
    lit, dark = widths
    free = ("brightness", "shadow", "tint", "background", "black_level")
    result = fit(shot(lit, dark), air(lit, dark), free=free)
    assert result.verdict == "not_identifiable"
    check_held(result, "black_level", "background and black_level only as a sum")
    assert result.look.background == pytest.approx(0.05, abs=5 * NOISE / np.sqrt(lit.size))


@pytest.mark.parametrize("count", [0, 10], ids=["none", "ten"])
def test_few_pixels_in_shadow(count: int, widths: tuple[np.ndarray, np.ndarray]) -> None:
    """In ten pixels the weight is told as badly as ten pixels do, and no better."""
    lit, dark = widths[0], np.zeros_like(widths[0])
    dark[4, 4 : 4 + count] = 0.3
    result = fit(shot(lit, dark), air(lit, dark), sampling="point")
    assert result.verdict == "converged"
    shadow = result.parameters["shadow"]
    if not count:
        assert shadow.stderr is None
        assert [item.what for item in result.left_out] == ["shadow"]
        return
    slopes = 3.0 * np.asarray(TRUTH.tint) * 0.3
    white = NOISE / np.sqrt(count * (slopes**2).sum())
    # One or two blocks hold all ten pixels, so the sandwich's own spread is a factor.
    assert shadow.stderr is not None
    assert white / 5 < shadow.stderr < 5 * white
    assert abs(shadow.value - 0.2) < 4 * white


def test_lit_and_dark_in_proportion(widths: tuple[np.ndarray, np.ndarray]) -> None:
    lit = widths[0]
    asked = fit(shot(lit, lit / 2), air(lit, lit / 2), free=("brightness", "shadow", "tint"))
    assert asked.verdict == "not_identifiable"
    check_held(asked, "shadow", "brightness and shadow act alike")
    plain = fit(shot(lit, lit / 2), air(lit, lit / 2))
    assert plain.verdict == "converged"
    check_held(plain, "shadow")
    assert plain.look.brightness == pytest.approx(3.0, rel=0.01)


def test_almost_in_proportion_is_told_with_its_error(
    widths: tuple[np.ndarray, np.ndarray],
) -> None:
    """A part in a thousand off proportion: told, and the error is the dense covariance's."""
    lit = widths[0]
    dark = lit / 2 + 1e-3 * (widths[1] - widths[1].mean())
    result = fit(
        shot(lit, dark),
        air(lit, dark),
        LayersLook(3.0, 0.2, TRUTH.tint, background=0.05),
        free=FREE,
    )
    shadow = result.parameters["shadow"]
    assert not result.left_out
    rows = [
        (lit + 0.2 * dark)[..., None] * np.asarray(TRUTH.tint),
        3.0 * dark[..., None] * np.asarray(TRUTH.tint),
    ]
    jacobian = np.stack([row.reshape(-1) for row in rows], axis=1)
    white = NOISE * np.sqrt(np.linalg.inv(jacobian.T @ jacobian)[1, 1])
    assert white > 0.2  # as large as the value: the photo hardly tells it
    if result.verdict == "at_bound":  # in four standard errors a weight of 0 is not far
        assert shadow.value == 0
    else:
        assert shadow.stderr == pytest.approx(white, rel=0.5)
        assert abs(shadow.value - 0.2) < 4 * white


FREE = ("brightness", "shadow")


def test_two_exposures_and_brightness(widths: tuple[np.ndarray, np.ndarray]) -> None:
    """The ratio of two exposures is told, their size is not; the default does not ask for it."""
    lit, dark = widths
    look = LayersLook(3.0, 0.2, TRUTH.tint, background=0.0)
    photos = [shot(lit, dark, look), shot(lit, dark, look, exposure=2.0, seed=2)]
    layers = [air(lit, dark)] * 2
    result = fit(photos, layers, look, free=("brightness", "exposure.1", "exposure.2"))
    assert result.verdict == "not_identifiable"
    held = [name for name in ("exposure.1", "exposure.2") if name not in result.correlation_names]
    assert len(held) == 1
    check_held(result, held[0], "act alike")
    values = {name: result.parameters[name].value for name in ("exposure.1", "exposure.2")}
    ratio = values["exposure.2"] / values["exposure.1"]
    assert ratio == pytest.approx(2.0, rel=0.01)
    tied = fit(
        photos, layers, look, free=("brightness", "exposure"), tied={"exposure.2": "exposure.1"}
    )
    assert tied.verdict == "not_identifiable"
    assert "only as a product" in tied.left_out[0].why
    plain = fit(photos, layers, look)
    assert plain.verdict == "converged"
    assert plain.parameters["exposure.2"].value == pytest.approx(2.0, rel=0.01)
    assert plain.parameters["exposure.1"].role == "fixed"


def test_gamma_where_all_is_equally_bright() -> None:
    """One width only: brightness takes all, gamma and level have nothing left to explain."""
    lit = np.full((24, 32), 0.3)
    layers = Layers(np.zeros_like(lit), lit, planet=np.zeros_like(lit))
    photo = shot(lit, 0 * lit, LayersLook(3.0, 0.2))
    result = fit(photo, layers, LayersLook(2.0), free=("brightness", "gamma"))
    assert result.verdict == "not_identifiable"
    check_held(result, "gamma", "brightness and gamma")
    assert result.look.brightness == pytest.approx(3.0, rel=0.01)


def test_no_brightness_no_shadow_and_no_tint(widths: tuple[np.ndarray, np.ndarray]) -> None:
    """With brightness held at 0 nothing else of the air can be seen."""
    lit, dark = widths
    look = LayersLook(0.0, 0.2, (1, 1, 1), background=0.0)
    result = fit(shot(lit, dark), air(lit, dark), look, free=("shadow", "background"))
    assert result.verdict == "not_identifiable"
    check_held(result, "shadow", "brightness is 0")
