"""Independent samples of scattered pixels, against what is known of blurred noise."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from fit.diagnose._effective import scattered_samples


def blurred(sigma: float, size: int, rng: np.random.Generator) -> np.ndarray:
    """White noise, blurred far from any border."""
    room = int(np.ceil(5 * sigma))
    white = rng.normal(size=(size + 2 * room, size + 2 * room, 3))
    noise = white if sigma == 0 else gaussian_filter(white, (sigma, sigma, 0))
    return np.asarray(noise[room : room + size, room : room + size])


@pytest.mark.parametrize("size", [36, 200])
def test_white_noise_is_as_many_samples_as_it_has(size: int) -> None:
    """But for the channels' chance correlation: of n pixels (tr C)² / tr C² is 3 (1 - 2 / n) or
    so."""
    rng = np.random.default_rng(2)
    noise = blurred(0, size, rng)
    places = rng.permutation(size * size)[:1300]
    residual = noise.reshape(-1, 3)[places]
    count, independent = scattered_samples([np.stack(np.divmod(places, size))], [residual])
    assert independent
    assert count == pytest.approx(3 * len(places), rel=0.01)


@pytest.mark.parametrize(("sigma", "size"), [(1.0, 36), (2.0, 36), (2.0, 120)])
def test_blurred_noise_is_as_many_as_it_has_areas(sigma: float, size: int) -> None:
    """Each counts for its own part of 2πσ² pixels (Priestley 1981), of every k-th pixel for a k-th
    of that. A fifth off is what one draw of a hundred such areas is by chance, and what borders
    take."""
    rng = np.random.default_rng(3)
    noise = blurred(sigma, size, rng)
    places = rng.permutation(size * size)[:1296]
    residual = noise.reshape(-1, 3)[places]
    count, independent = scattered_samples([np.stack(np.divmod(places, size))], [residual])
    share = len(places) / size**2
    expected = 3 * len(places) / (1 + share * (2 * np.pi * sigma**2 - 1))
    assert not independent
    assert count == pytest.approx(expected, rel=0.2)


def test_channels_that_vary_together_count_once_and_photos_add_up() -> None:
    rng = np.random.default_rng(4)
    noise = blurred(0, 36, rng)
    places = np.stack(np.divmod(np.arange(36 * 36), 36))
    grey = np.repeat(noise.reshape(-1, 3)[:, :1], 3, axis=1)
    one, _ = scattered_samples([places], [grey])
    assert one == pytest.approx(36 * 36, rel=1e-9)
    both, _ = scattered_samples([places, places], [grey, grey])
    assert both == pytest.approx(2 * one)
    nothing, independent = scattered_samples([places], [0 * grey])
    assert nothing == grey.size
    assert independent
