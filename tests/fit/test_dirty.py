"""Dirty photos: outliers, white and black samples, and something dark in front of the limb."""

from functools import cache
from itertools import product
from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image
from scipy.optimize import least_squares

from fit import FitResult, fit, load_photo
from fit.solve._loss import TUNING
from model_jax import Layers, LayersLook, Srgb, layer_widths
from render_gl._exr import write_channels
from tests.fit.looks import evidence_of
from tests.fit.photo.files import png

from .looks import START, exact_layers, picture, scene

TRUTH = LayersLook(3.0, 0.2, (0.8, 0.9, 1.3), background=0.1)
"""A background worth a relative error: one-sided outliers lift a level before all else."""

VALUES = {
    "brightness": 3.0,
    "shadow": 0.2,
    "tint.r": 0.8,
    "tint.g": 0.9,
    "tint.b": 1.3,
    "background": 0.1,
}
NOISE = 0.01
"""Two and a half of 256 codes. The shift of Huber and soft-L1 is in proportion to it: each outlier
pulls as hard as a residual of 1.345 noise does, however far off it is."""

SHARE = 0.05
"""Share of outliers: one pixel in twenty."""

ROBUST = ("cauchy", "huber", "soft_l1")
ALLOWED = {"cauchy": 0.01, "huber": 0.03, "soft_l1": 0.03}
"""Relative shift of any parameter that a robust loss may leave; Cauchy may instead move by two
standard errors."""


@cache
def air() -> tuple[Layers, np.ndarray]:
    """Layers in float64, and where the fit looks: air in front of space."""
    layers = exact_layers(scene())
    return layers, np.asarray(layers.has_air) & (np.asarray(layers.planet) == 0)


def shown(look: LayersLook, noise: float, seed: int) -> np.ndarray:
    with jax.enable_x64(True):
        clean = picture(air()[0], look)
    return clean + np.random.default_rng(seed).normal(scale=noise, size=clean.shape)


def soil(photo: np.ndarray, kind: str, seed: int = 1) -> np.ndarray:
    """The photo with outliers in a twentieth of its samples."""
    rng = np.random.default_rng(seed)
    size = photo.shape[:2]
    where = rng.random(size) < SHARE
    dirty = photo.copy()
    if kind == "salt and pepper":  # sample by sample, both ends
        which = rng.random(photo.shape) < SHARE
        dirty[which] = rng.choice([0.0, 1.5], which.sum())
    elif kind == "stars":  # one-sided, of any brightness
        dirty[where] += rng.uniform(0.1, 2.0, where.sum())[:, None]
    elif kind == "hot pixels":  # beyond what 8 bits hold
        dirty[where] = 5.0
    else:  # blocks of 7 × 7 pixels, each of one colour
        where[:] = False
        ring = air()[1]
        places = np.argwhere(ring)
        while where[ring].mean() < SHARE:
            row, column = places[rng.integers(len(places))]
            block = np.s_[max(row - 3, 0) : row + 4, max(column - 3, 0) : column + 4]
            where[block] = True
            dirty[block] = rng.uniform(0.5, 1.5, 3)
    return dirty


def to_png(light: np.ndarray, path: Path, bits: int = 8) -> Path:
    top = 2**bits - 1
    codes = np.rint(top * np.clip(np.asarray(Srgb().encode(np.maximum(light, 0))), 0, 1))
    path.write_bytes(png(codes.astype(np.uint8 if bits == 8 else np.uint16)))
    return path


@cache
def clean_fit(loss: str) -> FitResult:
    return fit(shown(TRUTH, NOISE, 0), air()[0], START, loss=loss, sampling="point")


def shifts(dirty: FitResult, clean: FitResult) -> dict[str, tuple[float, float]]:
    """Relative, and in standard errors of the dirty fit."""
    found = {}
    for name in VALUES:
        one, other = clean.parameters[name], dirty.parameters[name]
        assert other.stderr is not None
        shift = abs(other.value - one.value)
        found[name] = (shift / abs(one.value), shift / other.stderr)
    return found


def check_shifts(dirty: FitResult, clean: FitResult, loss: str) -> None:
    assert dirty.verdict == "converged", dirty.message
    for name, (relative, errors) in shifts(dirty, clean).items():
        allowed = relative <= ALLOWED[loss] or (loss == "cauchy" and errors <= 2)
        assert allowed, f"{name}: {relative:.2%}, {errors:.1f} standard errors"


KINDS = ("salt and pepper", "stars", "blocks")


@pytest.mark.parametrize(
    ("loss", "kind"),
    [
        # Each loss and each kind once.
        pytest.param(loss, kind, marks=() if k == j else pytest.mark.full)
        for (k, loss), (j, kind) in product(enumerate(ROBUST), enumerate(KINDS))
    ],
)
def test_outliers(loss: str, kind: str) -> None:
    result = fit(soil(shown(TRUTH, NOISE, 0), kind), air()[0], START, loss=loss, sampling="point")
    check_shifts(result, clean_fit(loss), loss)
    # The scale that decides what an outlier is: a twentieth of them raises the median by 7 %.
    assert result.errors is not None
    assert result.errors.noise == pytest.approx(NOISE, rel=0.15)
    weights = result.weights()
    doubted = np.abs(soil(shown(TRUTH, NOISE, 0), kind) - shown(TRUTH, NOISE, 0)).max(axis=-1) > 0.3
    ring = air()[1]
    assert np.nanmax(weights[ring & doubted]) < 0.25
    assert np.nanmedian(weights[ring & ~doubted]) > 0.7


@pytest.mark.parametrize(
    "kind", [KINDS[0], *(pytest.param(kind, marks=pytest.mark.full) for kind in KINDS[1:])]
)
def test_least_squares_believes_outliers(kind: str) -> None:
    """What the losses are for: by some parameter more than 10 %."""
    result = fit(soil(shown(TRUTH, NOISE, 0), kind), air()[0], START, sampling="point")
    assert max(relative for relative, _ in shifts(result, clean_fit("linear")).values()) > 0.1


@pytest.mark.parametrize(
    "loss", ["cauchy", *(pytest.param(name, marks=pytest.mark.full) for name in ROBUST[1:])]
)
def test_hot_pixels_that_are_white(loss: str, tmp_path: Path) -> None:
    """In 8 bits they only say "at least this bright", and are doubted all the same."""
    photo = shown(TRUTH, NOISE, 0)
    clean = fit(
        load_photo(to_png(photo, tmp_path / "clean.png")),
        air()[0],
        START,
        loss=loss,
        sampling="point",
    )
    hot = load_photo(to_png(soil(photo, "hot pixels"), tmp_path / "hot.png"))
    result = fit(hot, air()[0], START, loss=loss, sampling="point")
    assert result.photos[0].clipped > 0.04 * 3 * result.used.sum()
    check_shifts(result, clean, loss)


@pytest.mark.parametrize("loss", ROBUST)
def test_scipy_finds_the_same(loss: str) -> None:
    """`least_squares(loss=…, f_scale=…)` on all samples, with the scale that our fit settled on."""
    layers, ring = air()
    photo = soil(shown(TRUTH, NOISE, 0), "stars")
    result = fit(photo, layers, START, loss=loss, sampling="point")
    with jax.enable_x64(True):
        lit, dark = (np.asarray(w)[ring] for w in layer_widths(layers) if w is not None)
    target = photo[ring]
    last = np.array([-1.0, -1.0])  # of the third tint: what the others take

    def residual(x: np.ndarray) -> np.ndarray:
        brightness, shadow, background = x[0], x[1], x[4]
        tint = np.append(x[2:4], 3 - x[2] - x[3])
        light = brightness * tint * (lit + shadow * dark)[:, None] + background
        return (light - target).reshape(-1)

    def slopes(x: np.ndarray) -> np.ndarray:
        tint = np.append(x[2:4], 3 - x[2] - x[3])
        width = (lit + x[1] * dark)[:, None]
        by_tint = np.concatenate([np.eye(2), last[None]])  # [channel, tint]
        return np.stack(
            [
                width * tint,
                x[0] * tint * dark[:, None],
                x[0] * width * by_tint[:, 0],
                x[0] * width * by_tint[:, 1],
                np.ones_like(target),
            ],
            axis=-1,
        ).reshape(-1, 5)

    scale = float(evidence_of(result).problem.model.loss.noise) * TUNING[loss]
    tiny = 1e-15
    theirs = least_squares(
        residual,
        [3.0, 0.2, 0.8, 0.9, 0.1],
        slopes,
        loss=loss,
        f_scale=scale,
        xtol=tiny,
        ftol=tiny,
        gtol=tiny,
    ).x
    names = ("brightness", "shadow", "tint.r", "tint.g", "background")
    ours = [result.parameters[name].value for name in names]
    np.testing.assert_allclose(ours, theirs, rtol=1e-6)


def overexposed(brightness: float) -> LayersLook:
    return LayersLook(brightness, TRUTH.shadow, TRUTH.tint, background=0.02)


def off(result: FitResult, brightness: float) -> dict[str, float]:
    """Relative errors of what an overexposed photo is asked."""
    truth = {**VALUES, "brightness": brightness}
    del truth["background"]
    return {name: result.parameters[name].value / true - 1 for name, true in truth.items()}


@pytest.mark.parametrize(
    ("brightness", "noise", "bits"),
    [
        pytest.param(*case, marks=() if case == (5.0, 0.01, 8) else pytest.mark.full)
        for case in product((5.0, 7.0), (0.0, 0.01), (8, 16))
    ],
)
def test_white_samples_tell_a_bound(
    brightness: float, noise: float, bits: int, tmp_path: Path
) -> None:
    """A seventh and a third of the samples are white; within 3 standard errors and 1 %.

    Without noise rounding is none, and its bound is allowed for.
    """
    light = shown(overexposed(brightness), noise, 3)
    photo = load_photo(to_png(light, tmp_path / "photo.png", bits))
    layers, ring = air()
    assert photo.codes is not None
    white = photo.codes == photo.top
    assert 0.1 < white[ring].mean() < 0.4
    result = fit(photo, layers, START, sampling="point")
    assert result.verdict == "converged", result.message
    assert result.photos[0].clipped >= white[ring].sum()
    assert not result.warnings
    for name, error in off(result, brightness).items():
        estimate = result.parameters[name]
        true = estimate.value / (1 + error)
        assert estimate.stderr is not None
        assert estimate.quantisation_bound is not None
        room = 3 * estimate.stderr + (0.0 if noise else estimate.quantisation_bound)
        assert abs(estimate.value - true) <= room, name
        assert abs(error) <= 0.01, name
    believed = fit(photo.linear, layers, START, sampling="point")
    assert max(map(abs, off(believed, brightness).values())) > 0.1


@pytest.mark.full  # what the test above is for
def test_dropping_white_samples_is_biased(tmp_path: Path) -> None:
    """Noise decides which samples near white survive: the dark ones. Mean of eight photos.

    What is left of the mean of eight is 1 / √8 of a standard error.
    """
    layers, _ = air()
    kept, dropped, stderr = [], [], 0.0
    for seed in range(8):
        photo = load_photo(to_png(shown(overexposed(5.0), 0.05, seed), tmp_path / "photo.png"))
        assert photo.codes is not None
        light = photo.linear.copy()
        light[(photo.codes == photo.top).any(axis=-1)] = np.nan
        result = fit(photo, layers, START, sampling="point")
        stderr = result.parameters["brightness"].stderr or np.nan
        kept.append(float(result.look.brightness) - 5.0)
        result = fit(light, layers, START, sampling="point")
        dropped.append(float(result.look.brightness) - 5.0)
    assert abs(np.mean(kept)) <= 3 * stderr / np.sqrt(8)
    assert np.mean(dropped) < -6 * stderr / np.sqrt(8)


def test_black_samples_tell_a_bound(tmp_path: Path) -> None:
    """A level below black: what falls below 0 is cut off, and taken as measured lifts the level."""
    look = LayersLook(3.0, 0.2, (0.8, 0.9, 1.3), background=-0.1)
    photo = load_photo(to_png(shown(look, 0.02, 4), tmp_path / "photo.png"))
    layers, ring = air()
    assert photo.codes is not None
    assert (photo.codes == 0)[ring].mean() > 0.05
    below = {"background": (-1.0, 1.0)}
    result, believed = (
        fit(photo, layers, START, sampling="point", bounds=below),
        fit(photo.linear, layers, START, sampling="point", bounds=below),
    )
    for name, true in {**VALUES, "background": -0.1}.items():
        estimate = result.parameters[name]
        assert estimate.stderr is not None
        assert abs(estimate.value - true) <= 3 * estimate.stderr, name
    assert believed.look.background + 0.1 > 3 * (result.parameters["background"].stderr or np.nan)
    assert believed.misfits  # and it is seen that this is no noise
    assert not result.misfits


@pytest.mark.parametrize(("code", "word"), [(0, "black"), (255, "saturated")])
def test_nothing_but_bounds(code: int, word: str, tmp_path: Path) -> None:
    Image.fromarray(np.full((128, 160, 3), code, np.uint8)).save(tmp_path / "photo.png")
    result = fit(load_photo(tmp_path / "photo.png"), air()[0], START, sampling="point")
    assert result.verdict == "no_data"
    assert f"the photo is {word} where the air is" in result.message


SIDES = {"left": 180, "top": -90, "right": 0, "bottom": 90}


def panel(side: str) -> np.ndarray:
    """A third of the limb, as a spacecraft's solar panel would cover it."""
    rows, columns = np.indices((128, 160))
    angle = np.degrees(np.arctan2(rows - 63.5, columns - 79.5))
    return np.abs((angle - SIDES[side] + 180) % 360 - 180) < 60


@pytest.mark.parametrize(
    "side",
    ["top", *(pytest.param(s, marks=pytest.mark.full) for s in ("left", "right", "bottom"))],
)
def test_a_dark_panel(side: str, tmp_path: Path) -> None:
    """≤ 1 % with its mask, PNG or EXR; without one the fit does not look like a good one."""
    layers, ring = air()
    hidden = panel(side)
    assert 0.3 < hidden[ring].mean() < 0.36
    light = shown(TRUTH, 0.01, 6)
    light[hidden] = np.random.default_rng(7).normal(0.02, 0.01, (int(hidden.sum()), 3))
    path = to_png(light, tmp_path / "photo.png")
    Image.fromarray(np.where(hidden, 0, 255).astype(np.uint8)).save(tmp_path / "mask.png")
    write_channels(tmp_path / "mask.exr", {"Y": np.where(hidden, 0.0, 1.0)}, {})
    results = [
        fit(load_photo(path, mask=tmp_path / name), layers, START, sampling="point")
        for name in ("mask.png", "mask.exr")
    ]
    for result in results:
        assert result.verdict == "converged", result.message
        assert not result.warnings
        assert result.pixels["excluded"]["masked"] == int((hidden & ring).sum())
        for name, true in VALUES.items():
            assert result.parameters[name].value == pytest.approx(true, rel=0.01), name
    assert results[0].parameters == results[1].parameters
    for loss in ("linear", "cauchy"):
        bare = fit(load_photo(path), layers, START, loss=loss, sampling="point")
        assert bare.verdict != "converged" or bare.warnings
        assert "mask" in bare.message
