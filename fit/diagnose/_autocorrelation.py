"""Autocorrelation of residuals within their photo, and the area over which they hang together."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..photo._columns import Columns

LAGS = 64
"""Most pixels over which residuals are compared: four of JPEG's largest blocks."""


def area_of(
    columns: Sequence[Columns],
    sizes: Sequence[tuple[int, int]],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
) -> float:
    """Pixels that count as one: `Spread.area`."""
    return correlation(columns, sizes, residuals)[1]


def correlation(
    columns: Sequence[Columns],
    sizes: Sequence[tuple[int, int]],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    window: int = 1024,
) -> tuple[float, float, list[np.ndarray]]:
    """Correlation length and area in pixels, and summed products of residuals by lag, a photo each.

    The length is the lag at which the mean over all directions has fallen below what is left of
    independent residuals by chance (three standard deviations), or below 1/20.
    """
    # Sums of squares in float32, whatever the unit of light: of residuals up to one.
    unit = 2.0 ** np.frexp(max((_largest(r) for r in residuals), default=0.0))[1]
    found = [
        _products(c.index, size, r, unit, window)
        for c, size, r in zip(columns, sizes, residuals, strict=True)
    ]
    products = [product for product, _ in found]
    total, pairs = np.sum(products, axis=0), np.sum([pair for _, pair in found], axis=0)
    lag = np.hypot(*np.meshgrid(*2 * [np.arange(-LAGS, LAGS + 1)], indexing="ij"))
    with np.errstate(invalid="ignore", divide="ignore"):
        rings = [np.round(lag) == k for k in range(LAGS)]
        mean = np.array([total[ring].sum() / max(pairs[ring].sum(), 1) for ring in rings])
        number = np.array([max(pairs[ring].sum(), 1.0) for ring in rings])
    if mean[0] <= 0:
        return 1.0, 1.0, products
    profile = mean / mean[0]
    quiet = profile < np.maximum(0.05, 3 / np.sqrt(number / 2))
    length = int(np.argmax(quiet)) if quiet.any() else LAGS
    inside = lag < length
    share = np.where(pairs > 0, total / np.maximum(pairs, 1), 0) / mean[0]
    area = float(np.maximum(share[inside].sum(), 1.0))
    return float(max(length, 1)), area, products


def _largest(residual: Float[np.ndarray, "_ 3"]) -> float:
    """Largest absolute value of what is no NaN; 0 of none."""
    highest = np.fmax.reduce(residual, axis=None, initial=0.0)
    return float(max(highest, -np.fmin.reduce(residual, axis=None, initial=0.0)))


def _products(
    index: np.ndarray, size: tuple[int, int], residual: np.ndarray, unit: float, window: int
) -> tuple[np.ndarray, np.ndarray]:
    """Σ r(x) r(x + d) and the number of pairs, for lags d up to `LAGS`; mean over channels.

    Residuals r in `unit`s.
    """
    if not index.size:
        nothing = np.zeros((2 * LAGS + 1, 2 * LAGS + 1))
        return nothing, nothing
    rows, cols = np.divmod(index, size[1])
    inside, rows, cols = _crowded(rows, cols, window)
    residual = residual[inside]
    mask = np.zeros((int(rows.max()) + 1, int(cols.max()) + 1), np.float32)
    mask[rows, cols] = 1
    padded = tuple(_fast_length(n + LAGS) for n in mask.shape)
    wanted = np.ix_(*(np.arange(-LAGS, LAGS + 1) % n for n in padded))

    def lagged(picture: np.ndarray) -> np.ndarray:
        power = np.abs(np.fft.rfft2(picture, padded)) ** 2
        return np.asarray(np.fft.irfft2(power, padded)[wanted])

    products = np.zeros((2 * LAGS + 1, 2 * LAGS + 1))
    image = np.zeros_like(mask)
    for channel in residual.T:  # not their mean: JPEG's errors of colour have none
        image[rows, cols] = np.nan_to_num(channel) / unit
        products += lagged(image) / residual.shape[1]
    return products, np.maximum(np.round(lagged(mask)), 0)


def _crowded(
    rows: np.ndarray, cols: np.ndarray, window: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A part of the frame is enough: the most crowded square of `window` pixels, of those side by
    side. Which pixels lie in it, their rows and columns there."""
    rows, cols = rows - rows.min(), cols - cols.min()
    across = int(cols.max()) // window + 1
    number = rows // window * across + cols // window
    best = int(np.argmax(np.bincount(number)))
    inside = np.flatnonzero(number == best)
    rows, cols = rows[inside], cols[inside]
    return inside, rows - rows.min(), cols - cols.min()


def _fast_length(n: int) -> int:
    """The next length of which NumPy's FFT is quick: 2^a 3^b 5^c."""
    while True:
        rest = n
        for factor in (2, 3, 5):
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return n
        n += 1
