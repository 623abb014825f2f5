"""How many independent samples a photo's residuals by the limb amount to."""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

Part = tuple[slice, slice]
"""Rows and columns of the photo."""


def effective_samples(
    residual: Callable[[Part], Float[np.ndarray, "h w 3"]],
    used: Bool[np.ndarray, "h w"],
    squares: bool = False,
) -> float:
    """Number of independent samples that would tell as much as the used ones.

    Of means (and so of what is linear in the residual) that is the used pixels over the area of the
    residual's autocorrelation ρ, its sum over all lags (Priestley 1981, §5.3.2; Thiébaux & Zwiers
    1984, J. Clim. Appl. Meteorol. 23, 800, eq. 2.1). A square sum knows more: with `squares` the
    area is the sum of ρ² (Bretherton et al. 1999, J. Clim. 12, 1990). White noise blurred by a
    Gaussian of σ px has the areas 4πσ² and 2πσ². Either is multiplied by the channels that vary
    independently, `(tr C)² / tr C²` (the same paper).

    The sum ends where ρ, averaged over rings of lags, first falls below twice the standard error of
    a correlation; lags up to 64 px, within tiles of 128 px, and of more than 64 tiles, 64 evenly
    chosen ones. Structure that is longer counts as more samples than it is.

    Args:
        residual: gives a window's; what is not used in it does not matter.
        used: the samples' pixels.
        squares: count them for square sums.

    Returns:
        From 1 to three times the used pixels.
    """
    count = int(used.sum())
    covariance, area = _correlation(residual, used, squares)
    total = float(np.trace(covariance))
    if not total > 0:
        return float(max(3 * count, 1))
    channels = 1 / float(((covariance / total) ** 2).sum())
    return float(np.clip(count / area * channels, 1.0, 3.0 * count))


QUIET = 0.05
"""Correlation of residuals that is as good as none."""
_PAIRS = 4000
"""Pairs of pixels in the nearest bin of distances, of which chance correlates by less than `QUIET`;
each further bin has twice as many."""


def scattered_samples(
    places: Sequence[Int[np.ndarray, "2 _"]], residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> tuple[float, bool]:
    """Number of independent samples whose square sum tells as much as that of scattered pixels, and
    whether these are independent of their neighbours.

    Of n samples whose residuals have correlations ρ it is n / (1 + Σ ρ² / n) over pairs, up to the
    distance where the mean correlation is `QUIET`, or what chance leaves of none, three standard
    errors; times the channels that vary independently, as `effective_samples` with `squares`.

    Args:
        places: row and column of the pixels of each photo.
        residuals: of these, NaN where a sample is not known.
    """
    total, independent = 0.0, True
    for place, residual in zip(places, residuals, strict=True):
        known = np.nan_to_num(residual)
        covariance = known.T @ known
        trace = float(np.trace(covariance))
        if not trace > 0:
            total += known.size
            continue
        inflation = _inflation(place, known)
        total += len(known) * trace**2 / float((covariance**2).sum()) / inflation
        independent &= inflation == 1
    return max(total, 2.0), independent


def _inflation(place: Int[np.ndarray, "2 n"], residual: Float[np.ndarray, "n 3"]) -> float:
    """Variance of a square sum of residuals over that of independent ones; 1 where neighbours
    are."""
    first, second = np.triu_indices(place.shape[1], 1)
    apart = np.hypot(*(place[:, first] - place[:, second]))
    near = np.argsort(apart, kind="stable")
    products = np.einsum("ni,ni->n", residual[first[near]], residual[second[near]])
    mean = float((residual**2).sum()) / len(residual)
    added, start, many = 0.0, 0, _PAIRS
    while start < len(products):
        part = products[start : start + many]
        correlation = float(part.mean()) / mean
        if correlation < max(QUIET, 3 / np.sqrt(len(part))):
            break
        added += 2 * len(part) * correlation**2
        start, many = start + many, 2 * many
    return 1 + added / len(residual)


_LAGS = 64
_WINDOW = 128
_WINDOWS = 64
"""Most lag and sides of the tiles, px, and how many of these are looked at: a megapixel in all."""


def _correlation(
    residual: Callable[[Part], Float[np.ndarray, "h w 3"]],
    used: Bool[np.ndarray, "h w"],
    squares: bool,
) -> tuple[Float[np.ndarray, "3 3"], float]:
    """Products of the channels, and the correlation's area.

    The area is the sum of the autocorrelation, or of its square, over the lags about 0, px²; at
    least 1. Each lag counts by its share of pixels that have a partner: a ring 3 px wide has no
    more than 3 px of correlation across it.
    """
    corners = [
        (y, x)
        for y in range(0, used.shape[0], _WINDOW)
        for x in range(0, used.shape[1], _WINDOW)
        if used[y : y + _WINDOW, x : x + _WINDOW].any()
    ]
    chosen = np.unique(np.linspace(0, len(corners) - 1, min(len(corners), _WINDOWS)).astype(int))
    size = (_WINDOW + _LAGS, _WINDOW + _LAGS)
    power = np.zeros((size[0], size[1] // 2 + 1))
    pairs_power = np.zeros_like(power)
    count = 0
    covariance = np.zeros((3, 3))
    for y, x in (corners[k] for k in chosen):
        window = slice(y, y + _WINDOW), slice(x, x + _WINDOW)
        here = used[window]
        values = np.where(here[..., None], residual(window), 0)
        covariance += np.einsum("hwi,hwj->ij", values, values, dtype=np.float64)
        power += (np.abs(np.fft.rfft2(values, size, axes=(0, 1))) ** 2).sum(axis=2)
        pairs_power += np.abs(np.fft.rfft2(here.astype(np.float32), size)) ** 2
        count += int(here.sum())
    products, pairs = np.fft.irfft2(power, size), np.fft.irfft2(pairs_power, size)
    if not products[0, 0] > 0:
        return covariance, 1.0
    share = np.maximum(pairs / count, 0.5 / count)
    correlation = products / products[0, 0] / share
    lag = np.minimum(np.arange(size[0]), size[0] - np.arange(size[0]))
    ring = np.rint(np.hypot(*np.meshgrid(lag, lag))).astype(int)
    ring[ring > _LAGS] = _LAGS

    def over_rings(values: np.ndarray) -> np.ndarray:
        return np.bincount(ring.ravel(), values.ravel())[:_LAGS]

    average = over_rings(correlation * share) / over_rings(share)
    ended = np.flatnonzero(average < 2 / np.sqrt(count))
    within = ring < (ended[0] if ended.size else _LAGS)
    area = float(((correlation ** (2 if squares else 1)) * share)[within].sum())
    return covariance, max(1.0, area)
