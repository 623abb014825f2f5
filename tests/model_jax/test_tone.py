"""Tone curves: reference values, inverses, finite gradients at black and at saturation."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    Exposure,
    InputError,
    Linear,
    Power,
    Sampled,
    Srgb,
    ToneCurve,
    parse_tone_curve,
)

CURVES = {
    "linear": Linear(),
    "srgb": Srgb(),
    "exposure": Exposure(1.5),
    "exposure gamma 2.2": Exposure(2.0, 2.2),
    "exposure gamma 1/2": Exposure(0.7, 0.5),
    "power": Power(2.2),
}
curves = pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)

# IEC 61966-2-1: the break points, and 8-bit values whose linear light is tabulated widely.
SRGB = {
    0.0: 0.0,
    0.0031308: 0.04045,
    0.21404114: 0.5,
    0.5: 0.73535698,
    1.0: 1.0,
    0.00030353: 1 / 255,
    0.21586050: 128 / 255,
}


def test_srgb_reference_values(dtype: np.dtype) -> None:
    linear, stored = (np.array(list(side), dtype) for side in (SRGB, SRGB.values()))
    # The table has eight digits and the standard's two branches meet to 1e-6 of the stored value.
    np.testing.assert_allclose(Srgb().encode(linear), stored, rtol=0, atol=2e-6)
    np.testing.assert_allclose(Srgb().decode(stored), linear, rtol=0, atol=2e-6)


@curves
def test_decode_inverts_encode(curve: ToneCurve, dtype: np.dtype) -> None:
    """The round trip rounds the stored value by eps (of 1): times the slope of decode, at most
    13 for sRGB's inverse and exp(exposure·x)/exposure·gamma here (≤ 12 for x ≤ 1, see CURVES);
    a power adds a few eps more."""
    x = np.linspace(0, 1, 101, dtype=dtype)
    np.testing.assert_allclose(curve.decode(curve.encode(x)), x, atol=64 * np.finfo(dtype).eps)
    if not isinstance(curve, Linear):
        assert np.max(np.abs(np.asarray(curve.encode(x)) - x)) > 0.05


@curves
def test_numpy_in_numpy_out_and_the_same_as_jax(curve: ToneCurve, dtype: np.dtype) -> None:
    """XLA's own log1p, expm1 and power differ from the C library's by up to some 20 ulp."""
    x = np.linspace(0, 0.95, 20, dtype=dtype)
    for function in (curve.encode, curve.decode):
        host, device = function(x), function(jnp.asarray(x))
        assert isinstance(host, np.ndarray)
        assert isinstance(device, jax.Array)
        assert device.dtype == dtype
        np.testing.assert_allclose(host, device, rtol=64 * np.finfo(dtype).eps)


def test_exposure_saturates_at_one() -> None:
    assert Exposure(1.0).decode(np.array([1.0]))[0] == np.inf
    assert Exposure(1.0).encode(np.array([1e4]))[0] == 1.0


@curves
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_gradients_are_finite(curve: ToneCurve, mode: Callable[..., Any], dtype: np.dtype) -> None:
    """At black, below it, at the break of sRGB, at and beyond saturation."""
    x = np.array([-0.5, -1e-9, 0.0, 1e-30, 0.0031308, 0.5, 1.0, 2.0, 1e3, 1e6], dtype)
    for point in x:
        assert np.isfinite(mode(curve.encode)(jnp.asarray(point))), f"encode at {point}"
    for point in (0.0, 1e-30, 0.04045, 0.5, 1.0):
        assert np.isfinite(mode(curve.decode)(jnp.asarray(point, dtype))), f"decode at {point}"


@pytest.mark.parametrize("point", [0.0, 0.3, 50.0], ids=["black", "middle", "saturated"])
def test_gradients_in_the_curves_own_numbers_are_finite(point: float, dtype: np.dtype) -> None:
    def stored(exposure: jax.Array, gamma: jax.Array) -> jax.Array | np.ndarray:
        return Exposure(exposure, gamma).encode(jnp.asarray(point, dtype))

    gradient = jax.grad(stored, (0, 1))(jnp.asarray(1.5, dtype), jnp.asarray(2.2, dtype))
    assert np.all(np.isfinite(gradient))


@pytest.mark.usefixtures("x64")
@curves
@pytest.mark.parametrize("name", ["encode", "decode"])
def test_gradients_equal_central_differences(curve: ToneCurve, name: str) -> None:
    function = getattr(curve, name)
    step = 1e-5
    for x in (0.02, 0.3, 0.8):
        difference = (function(jnp.asarray(x + step)) - function(jnp.asarray(x - step))) / 2 / step
        assert abs(float(difference)) > 1e-3
        # The second-order error of the difference: step² f‴/6, with f‴/f′ ≤ 1e4 at 0.02.
        assert float(jax.grad(function)(x)) == pytest.approx(float(difference), rel=1e-6)


@curves
def test_describe_is_what_parse_reads(curve: ToneCurve) -> None:
    again = parse_tone_curve(curve.describe())
    assert type(again) is type(curve)
    assert again.describe() == curve.describe()


BAD = {
    "unknown": "rec709",
    "number": 2.2,
    "nothing": {},
    "unknown key": {"exposure": 1.0, "knee": 0.1},
    "zero": {"exposure": 0},
    "negative gamma": {"exposure": 1.0, "gamma": -1.0},
    "text": {"exposure": "1"},
    "yes": {"exposure": True},
    "infinite": {"exposure": float("inf")},
    "nan": {"exposure": float("nan")},
}


@pytest.mark.parametrize("value", BAD.values(), ids=BAD)
def test_bad_curves_are_named(value: object) -> None:
    with pytest.raises(InputError, match=r"^tone_curve.*(use|must)") as error:
        parse_tone_curve(value)
    assert "\n" not in str(error.value)


def test_a_sampled_curve_is_straight_between_its_values() -> None:
    curve = Sampled("mine", np.array([0.0, 0.1, 1.0]))
    stored, light = np.array([0, 0.25, 0.5, 0.75, 1]), np.array([0, 0.05, 0.1, 0.55, 1])
    np.testing.assert_allclose(curve.decode(stored), light, atol=1e-15)
    np.testing.assert_allclose(curve.encode(light), stored, atol=1e-15)
    assert float(jax.grad(curve.decode)(jnp.float32(0.8))) == pytest.approx(1.8)
    assert curve.describe() == "mine"
    for bad in ([0.0, 0.5, 0.4], [0.0, np.nan], [1.0], [0.5, 0.5]):
        with pytest.raises(InputError, match="tone curve mine"):
            Sampled("mine", np.array(bad))


def test_a_power_is_told_as_it_is_read() -> None:
    curve = parse_tone_curve({"gamma": 1.8})
    assert isinstance(curve, Power)
    assert curve.describe() == {"gamma": 1.8}
    np.testing.assert_allclose(curve.decode(np.array([0.5, -0.5])), [0.5**1.8, -(0.5**1.8)])
