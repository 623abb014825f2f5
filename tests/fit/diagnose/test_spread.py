"""The parts of the standard errors, each against what is known of it without them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student

from fit import Photo, fit
from fit.diagnose._autocorrelation import correlation
from fit.diagnose._spread import (
    MOST_CURVED,
    MOST_LEVERAGE,
    Spread,
    _border_share,
    _not_steeper,
    _unseen,
    inverse_root,
    reach_95,
    stretch_of,
)
from fit.photo._blocks import block_numbers
from fit.photo._columns import Columns
from model_jax import Layers, LayersLook
from model_jax._tone import Linear
from tests.fit.looks import START, TRUTH, picture
from tests.fit.noises import NOISES

SIZE = (256, 320)
BLUR = 2.0
"""Pixels. Blurred white noise has the autocorrelation exp(-d²/4σ²), whose integral is 4πσ²."""


def all_pixels(size: tuple[int, int]) -> Columns:
    n = size[0] * size[1]
    fields = {"lit": np.ones(n)}
    return Columns(np.arange(n), fields, np.zeros((n, 3)), None, None, np.ones(3), 0.0)


def blurred(rng: np.random.Generator) -> np.ndarray:
    noise = rng.normal(size=(*SIZE, 3))
    return gaussian_filter(noise, (BLUR, BLUR, 0), mode="wrap").reshape(-1, 3)


def test_reach_is_students() -> None:
    """Within what the docstring says of the expansion."""
    freedom = np.array([3.0, 4.5, 10.0, 40.0, 1e9])
    np.testing.assert_allclose(reach_95(freedom), student.ppf(0.975, freedom), rtol=1.3e-3)
    two = reach_95(np.array([2.0, 1.0]))
    np.testing.assert_allclose(two, student.ppf(0.975, 2), rtol=8e-3)


def test_white_noise_has_no_correlation(rng: np.random.Generator) -> None:
    residual = rng.normal(size=(SIZE[0] * SIZE[1], 3))
    length, area, products = correlation([all_pixels(SIZE)], [SIZE], [residual])
    assert length == 1.0
    assert area == 1.0
    assert _border_share(products, 8) == pytest.approx(1.0, abs=0.05)


def test_no_standard_error_is_0(layers64: Layers) -> None:
    """Not of a photo that the start meets to the last bit, either."""
    with jax.enable_x64(True):
        light = picture(layers64, TRUTH)
        light = np.asarray(light, np.float64)
    result = fit(light, layers64, TRUTH)
    assert all(result.parameters[name].stderr for name in result.correlation_names)


@pytest.mark.parametrize("colour", [(1.0, 1.0, 1.0), (1.0, 0.0, -1.0)], ids=["grey", "colour"])
def test_blurred_noise_is_measured(
    colour: tuple[float, float, float], rng: np.random.Generator
) -> None:
    """Also where it is in the colour only, as JPEG's is, and the mean of the channels is quiet.

    exp(-d²/16) falls below 1/20 at d = 6.9. One channel has 81,920 / 50 = 1,630 independent areas,
    so that its autocorrelation is uncertain by 1 / √1630 = 2.5 % of its height. The integral adds
    up 150 pixels, of which three areas or so are independent: 50 · 2.5 % · √3 · 3 standard
    deviations = 6.4 of 50.3, and what lies beyond 7 pixels, exp(-49/16) = 5 %, is left out: 2.4.
    """
    residual = blurred(rng)[:, :1] * np.array(colour)
    length, area, products = correlation([all_pixels(SIZE)], [SIZE], [residual])
    assert length in (6.0, 7.0, 8.0)
    expected = 4 * np.pi * BLUR**2
    assert expected - 2.4 - 6.4 < area < expected + 6.4

    d = np.arange(-9, 10)
    along = np.exp(-(d**2) / (4 * BLUR**2))
    kept = (along * (1 - np.abs(d) / 16)).sum() / along.sum()
    assert _border_share(products, 16) == pytest.approx(1 / kept**2, rel=0.1)


def test_border_share_is_what_blocks_lose(rng: np.random.Generator) -> None:
    """The variance of block sums, times the share, is what independent blocks would have.

    320 blocks × 3 channels tell a variance to √(2/960) = 4.6 %; three times that, and the share's
    own uncertainty as above.
    """
    residual = blurred(rng)
    products = correlation([all_pixels(SIZE)], [SIZE], [residual])[2]
    numbers = block_numbers(np.arange(SIZE[0] * SIZE[1]), SIZE, 16)
    sums = np.stack([np.bincount(numbers, channel) for channel in residual.T])
    whole = (sums**2).sum() * _border_share(products, 16)
    # White noise of variance 1 keeps its sums when blurred: each pixel adds 1 to the whole.
    assert whole == pytest.approx(residual.size, rel=3 * 0.046 + 0.1)


@pytest.mark.parametrize("light", [1e-30, 1e30], ids=str)
def test_the_unit_of_light_does_not_matter(light: float, rng: np.random.Generator) -> None:
    """The sums are float32, whose squares end at 1e±38. The factors round what is summed."""
    residual = blurred(rng)
    plain, other = (
        correlation([all_pixels(SIZE)], [SIZE], [residual * factor]) for factor in (1.0, light)
    )
    assert other[0] == plain[0] > 1
    assert other[1] == pytest.approx(plain[1], rel=1e-4)


def test_block_numbers() -> None:
    """Counted over the blocks that hold a pixel, whatever the frame's edge."""
    index = np.array([0, 7, 8, 20, 8 * 21 - 1, 8 * 21, 15 * 21 + 20])  # 21 across
    assert block_numbers(index, (16, 21), 8).tolist() == [0, 0, 1, 2, 2, 3, 4]
    assert block_numbers(np.array([], int), (16, 21), 8).tolist() == []


@pytest.mark.parametrize(
    ("kind", "shortest", "longest"),
    [("gaussian", 1, 1), ("blurred", 6, 8), ("ramp", 9, 64)],
)
def test_blocks_are_no_smaller_than_the_correlation(
    kind: str,
    shortest: float,
    longest: float,
    layers64: Layers,
    noisy: np.ndarray,
    rng: np.random.Generator,
    tmp_path: Path,
) -> None:
    """In fits: of white noise, of noise blurred by 2 px (see above), of light that is no air."""
    photo: Any = noisy
    if kind != "ramp":
        with jax.enable_x64(True):
            photo = NOISES[kind].record(picture(layers64, TRUTH), rng, tmp_path)
    errors = fit(photo, layers64, START).errors
    assert errors is not None
    assert shortest <= errors.correlation_px <= longest
    assert errors.block_px >= max(errors.correlation_px, 8)


def make_spread(leverage: np.ndarray) -> Spread:
    p = leverage.shape[1]
    return Spread(np.eye(p), np.eye(p), 1.0, 8, len(leverage), 1.0, np.eye(p), leverage)


def test_freedom_of_a_mean() -> None:
    """G equal blocks tell one mean: the variance of their sums has G - 1 degrees of freedom."""
    equal = make_spread(np.full((12, 1, 1), 1 / 12))
    assert equal.freedom(np.ones((1, 1)))[0] == pytest.approx(11)
    lopsided = make_spread(np.array([0.9, *[0.1 / 11] * 11])[:, None, None])
    assert 1 <= lopsided.freedom(np.ones((1, 1)))[0] < 3


def test_freedom_is_that_of_the_sandwich(rng: np.random.Generator) -> None:
    """Against the blocks' whole covariance, built pixel by pixel for a small linear fit."""
    matrix = rng.normal(size=(60, 3)) * np.linspace(0.2, 2, 60)[:, None]
    blocks = np.arange(60) // 10
    root = inverse_root(matrix.T @ matrix)
    np.testing.assert_allclose(root @ root.T @ matrix.T @ matrix, np.eye(3), atol=1e-12)
    parts = [matrix[blocks == k] for k in range(6)]
    leverage = np.stack([root.T @ part.T @ part @ root for part in parts])
    spread = replace(make_spread(leverage), root=root)
    row = np.array([1.0, -0.5, 0.3])
    residual_maker = np.eye(60) - matrix @ root @ root.T @ matrix.T
    stretched = np.zeros((6, 60))
    for k, part in enumerate(parts):
        stretched[k, blocks == k] = part @ root @ stretch_of(leverage)[k] @ root.T @ row
    covariance = stretched @ residual_maker @ stretched.T
    expected = np.trace(covariance) ** 2 / np.sum(covariance**2)
    assert spread.freedom(row[None])[0] == pytest.approx(expected, rel=1e-9)
    # And the stretch does what it is for: the mean of the variance is the parameter's own.
    assert np.trace(covariance) == pytest.approx(row @ root @ root.T @ row, rel=1e-9)


def test_stretch_stops() -> None:
    """A block that alone tells a parameter, and one whose share is below zero."""
    stretch = stretch_of(np.array([[[1.0]], [[-0.2]], [[0.0]]]))
    assert stretch.ravel() == pytest.approx([1 / np.sqrt(1 - MOST_LEVERAGE), 1.0, 1.0])
    assert inverse_root(np.zeros((0, 0))).shape == (0, 0)


TINY = (4, 6)
TINY_LOOK = LayersLook(1.0, 0.3, (0.9, 1.0, 1.1), background=0.1)
FREE = ("brightness", "shadow", "tint", "background")


@pytest.fixture(scope="module")
def tiny() -> tuple[Layers, Photo]:
    """24 pixels with all there is, 16-bit codes, linear light."""
    rng = np.random.default_rng(5)
    lit, dark = rng.uniform(0.1, 0.5, TINY), rng.uniform(0, 0.4, TINY)
    layers = Layers(np.zeros(TINY), lit + dark, lit, lit + dark)
    width = (lit + 0.3 * dark)[..., None]
    light = 0.1 + width * np.array([0.9, 1.0, 1.1]) + rng.normal(scale=0.01, size=(*TINY, 3))
    codes = np.round(light * 65535).astype(np.uint16)
    photo = Photo(
        path=Path("tiny.png"),
        stored=codes,
        reason=np.zeros(TINY, np.uint8),
        tone_curve=Linear(),
        bits=16,
        light=np.arange(65536) / 65535,
        half_steps=np.full(65536, 0.5 / 65535),
    )
    return layers, photo


def test_rounding_bound_is_reached(tiny: tuple[Layers, Photo]) -> None:
    """Every sample moved by half a code in its worst direction moves the value by the bound.

    To first order: what is left is of the relative size of the move, half a code in a tenth of the
    light, 1e-4. No other pattern of the same size moves it further.
    """
    layers, photo = tiny
    result = fit(photo, layers, TINY_LOOK, free=FREE)
    patterns = np.random.default_rng(6).choice([-1, 1], size=(2, *photo.linear.shape))
    for name in ("shadow", "tint.g"):
        bound = result.parameters[name].quantisation_bound
        assert bound is not None
        assert bound > 0

        def moved(pattern: np.ndarray, name: str = name) -> float:
            shifted = photo.linear + pattern * (0.5 / 65535)
            value = fit(shifted, layers, TINY_LOOK, free=FREE).parameters[name].value
            return float(value - result.parameters[name].value)

        worst = np.sign(result.influence(name))
        assert moved(worst) == pytest.approx(bound, rel=1e-3)
        assert all(abs(moved(pattern)) < bound for pattern in patterns)


def test_influence_is_the_slope_of_refits(tiny: tuple[Layers, Photo]) -> None:
    """Central differences by 1e-4 of light of order one leave 1e-8 of a curvature of order one."""
    layers, photo = tiny
    light = np.asarray(photo.linear)
    result = fit(light, layers, TINY_LOOK, free=FREE)
    for name in ("brightness", "shadow", "tint.r", "background"):
        influence = result.influence(name)
        for place in [(0, 0, 0), (2, 3, 1), (3, 5, 2)]:
            values = []
            for step in (1e-4, -1e-4):
                moved = light.copy()
                moved[place] += step
                values.append(fit(moved, layers, TINY_LOOK, free=FREE).parameters[name].value)
            slope = (values[0] - values[1]) / 2e-4
            assert slope == pytest.approx(influence[place], rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.5, MOST_LEVERAGE, 0.97, 1.0])
def test_what_a_block_hides_is_put_back(share: float) -> None:
    """A share b of one block, 1 - b of another: scores of b (1 - b) each, stretched as far as it
    goes, and what they lack, are the variance 1 of the whole."""
    leverage = np.array([[[share]], [[1 - share]]])
    seen = sum((stretch_of(b[None])[0, 0, 0] ** 2) * b[0, 0] * (1 - b[0, 0]) for b in leverage)
    assert seen + _unseen(leverage)[0, 0] == pytest.approx(1.0, rel=1e-12)


def test_curvature_that_slopes_do_not_bear_out_is_not_believed(rng: np.random.Generator) -> None:
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))

    def curved(*values: float) -> np.ndarray:
        return np.asarray(turned * np.array(values)) @ turned.T

    np.testing.assert_allclose(_not_steeper(curved(0.6, 1.0, 1.2)), curved(0.6, 1.0, 1.2))
    np.testing.assert_allclose(_not_steeper(curved(0.6, 1.0, 1e4)), curved(0.6, 1.0, MOST_CURVED))


def test_others_bear_what_noise_alone_put_at_its_end(layers64: Layers) -> None:
    """A background of 0, which noise puts below in every other photo: errors of the others are
    then those of a fit in which it may be below."""
    look = replace(TRUTH, background=0.0)
    with jax.enable_x64(True):
        light = picture(layers64, look).astype(np.float64)
    ended = 0
    for seed in range(6):
        noise = np.random.default_rng(seed).normal(scale=0.02 * light.max(), size=light.shape)
        bound = fit(light + noise, layers64, START, sampling="point")
        below = fit(
            light + noise, layers64, START, sampling="point", bounds={"background": (-1.0, 1.0)}
        )
        if bound.parameters["background"].role != "at_bound":
            continue
        ended += 1
        for name in bound.correlation_names:
            one, other = bound.parameters[name].stderr, below.parameters[name].stderr
            assert one == pytest.approx(other, rel=0.05), (seed, name)
    assert ended >= 1
