"""The camera's blur: of pictures against SciPy, of lines across a limb against quadrature."""

from collections.abc import Callable
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter

from model_jax import InputError, Response, record
from model_jax._blur import (
    REACH,
    SHARPEST,
    below_limb,
    blurred,
    inner_heights,
    line_weights,
    profile_heights,
)

WIDTHS = (0.0, 0.3, 0.6, 1.0, 2.0, 3.0)
HEIGHTS = np.array([1e-3, 0.02, 0.3, 0.7, 1.5, 2.5, 4.0, 6.0, 9.0, 20.0, 40.0])

Profile = Callable[[np.ndarray], np.ndarray]


def picture(dtype: np.dtype, size: tuple[int, int] = (40, 33)) -> np.ndarray:
    return np.random.default_rng(3).random((*size, 3)).astype(dtype)


@pytest.mark.parametrize("width", WIDTHS)
def test_pictures_are_convolved(width: float, dtype: np.dtype) -> None:
    """Up to 25 products along each axis, of numbers up to 1."""
    light = picture(dtype)
    radius = int(REACH)
    expected = gaussian_filter(
        light.astype(float), (width, width, 0), mode="nearest", radius=radius
    )
    found = blurred(light, width)
    assert found.dtype == dtype
    np.testing.assert_allclose(found, expected, atol=64 * np.finfo(dtype).eps)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("size", [(1, 1), (1, 30), (5, 2)])
def test_small_pictures_have_their_size_and_light(size: tuple[int, int]) -> None:
    flat = np.full((*size, 3), 0.25)
    np.testing.assert_allclose(blurred(flat, 2.0), flat, rtol=1e-12)


@pytest.mark.usefixtures("x64")
def test_slopes_by_the_width() -> None:
    """A central difference of step h is off by h² f'''/6; h = 1e-4 leaves 1e-7 or so."""

    def energy(width: float | jax.Array) -> jax.Array:
        return (blurred(picture(np.dtype(np.float64)), width) ** 2).sum()

    assert float(jax.grad(energy)(0.0)) == 0
    for width in (0.4, 1.5):
        step = 1e-4
        by_steps = float(energy(width + step) - energy(width - step)) / (2 * step)
        assert float(jax.grad(energy)(width)) == pytest.approx(by_steps, rel=1e-5)


def test_a_response_records_blurred_light(dtype: np.dtype) -> None:
    light = picture(dtype)
    sharp, soft = Response(2.0, 1.5, 0.1), Response(2.0, 1.5, 0.1, blur=1.2)
    expected = record(blurred(light, 1.2), sharp)
    np.testing.assert_array_equal(record(light, soft), expected)
    np.testing.assert_array_equal(record(light, Response(blur=0.0), linear=True), light)
    with pytest.raises(InputError, match=r"light: has shape \(3,\); a response with a blur"):
        record(light[0, 0], soft)


@pytest.mark.parametrize("wrong", [-0.1, 3.5, float("nan"), [1.0, 2.0], "1"])
def test_wrong_blurs(wrong: object) -> None:
    with pytest.raises(InputError, match=r"response\.blur"):
        Response(blur=wrong)  # type: ignore[arg-type]


def spread(profile: Profile, height: float, top: float, width: float) -> float:
    """Light at a height, by adaptive quadrature."""
    width = float(np.hypot(width, SHARPEST))
    near = height + width * np.array([-8, -4, -2, -1, 0, 1, 2, 4, 8])
    ends = sorted({0.0, top, *np.clip(near, 0, top).tolist()})

    def light(z: float) -> float:
        density = np.exp(-(((z - height) / width) ** 2) / 2) / width / np.sqrt(2 * np.pi)
        return float(profile(np.array(z)) * density)

    pieces = pairwise(ends)
    return sum(quad(light, a, b, epsabs=1e-12)[0] for a, b in pieces)


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("depth", [0.01, 5.0])
@pytest.mark.parametrize("fall", [0.2, 0.5, 1.0, 3.0, 10.0, 30.0])
def test_light_on_a_line_is_spread(fall: float, depth: float) -> None:
    """The error that the module states, of the light at the limb."""
    top = min(12 * fall + 2, 200.0)

    def profile(z: np.ndarray) -> np.ndarray:
        return np.expm1(-depth * np.exp(-z / fall)) / np.expm1(-depth)

    here = HEIGHTS[top > HEIGHTS]
    heights = np.repeat(profile_heights(np.array([top])), len(here), axis=1)
    assert (np.diff(heights, axis=0) >= 0).all()
    assert (heights >= 0).all()
    assert (heights <= top).all()
    bound = 0.003 if fall <= 1 or fall >= 10 else 0.008
    for width in WIDTHS:
        weights = line_weights(heights, here, np.zeros(len(here)), width)
        found = np.asarray((weights * profile(heights)).sum(axis=0))
        expected = np.array([spread(profile, z, top, width) for z in here])
        assert np.abs(found - expected).max() <= bound * 1.1, (width, found - expected)


@pytest.mark.usefixtures("x64")
def test_without_blur_a_pixel_is_itself() -> None:
    """`SHARPEST` reaches a few thousandths of a pixel; a smooth light differs by its square."""
    inside = (HEIGHTS > 0.01) & (HEIGHTS < 20)
    heights = np.repeat(profile_heights(np.array([30.0])), len(HEIGHTS), axis=1)
    weights = np.asarray(line_weights(heights, HEIGHTS, np.zeros(len(HEIGHTS)), 0.0))
    found = (weights * np.exp(-heights / 2)).sum(axis=0)
    # Between the heights light is that of parabolas: of 2 px fall within 1.5e-3 of the limb's.
    np.testing.assert_allclose(found[inside], np.exp(-HEIGHTS / 2)[inside], atol=1.5e-3)
    beyond = np.asarray(line_weights(heights[:, -1:], HEIGHTS[-1:], np.zeros(1), 0.0))
    np.testing.assert_array_equal(beyond, 0)


@pytest.mark.usefixtures("x64")
def test_light_below_the_limb_is_spread() -> None:
    """Lines by their closed form, parabolas exactly, for they are what a stencil is made of."""
    here, none = HEIGHTS[:8], np.zeros(8)
    inner = np.broadcast_to(inner_heights()[:, None], (len(inner_heights()), 8))
    for width in WIDTHS[1:]:
        level, slope = np.asarray(below_limb(here, none, width))
        weights = np.asarray(line_weights(inner, here, none, width))
        cut = 1e-4  # what lies beyond REACH of the widest
        np.testing.assert_allclose(weights.sum(axis=0), level, atol=cut)
        np.testing.assert_allclose((weights * -inner).sum(axis=0), slope, atol=cut * REACH)


@pytest.mark.usefixtures("x64")
def test_a_bent_limb_is_met_by_a_bent_line() -> None:
    """Across the line the Gaussian reaches higher places: against a true convolution over a disc of
    40 px. Left out are the bend's square, (σ/R)² of σ²/2R, and 9·10⁻⁵ by quadrature."""
    radius, width, z = 40.0, 2.0, np.array([0.5, 3.0])
    across = np.linspace(-5 * width, 5 * width, 401)
    share = np.exp(-((across / width) ** 2) / 2)
    share /= share.sum()
    found, plain = (
        np.asarray(below_limb(z, np.full(2, bend), width)[0]) for bend in (1 / radius, 0.0)
    )
    middle = np.sqrt(np.maximum(radius**2 - across**2, 0)) - radius - z[:, None]
    exact = (share * np.asarray(jax.scipy.special.ndtr(middle / width))).sum(axis=1)
    assert np.abs(found - exact).max() < 0.1 * np.abs(plain - exact).max()


@pytest.mark.usefixtures("x64")
def test_slopes_by_the_width_on_a_line() -> None:
    heights = np.repeat(profile_heights(np.array([30.0])), len(HEIGHTS), axis=1)

    def light(width: float | jax.Array) -> jax.Array:
        weights = line_weights(heights, HEIGHTS, np.zeros(len(HEIGHTS)), width)
        below = below_limb(HEIGHTS, np.zeros(len(HEIGHTS)), width)
        return (weights * jnp.exp(-heights / 2)).sum() + below.sum()

    for width in (0.2, 1.0, 3.0):
        step = 1e-5
        by_steps = float(light(width + step) - light(width - step)) / (2 * step)
        assert float(jax.grad(light)(width)) == pytest.approx(by_steps, rel=1e-5)
    assert float(jax.grad(light)(0.0)) == 0
