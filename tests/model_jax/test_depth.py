"""Linearisation of window depth: its fixed points, its inverse and its rounding."""

import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    DepthTextures,
    Encoding,
    Layers,
    depth_constants,
    layer_widths,
    linearize_depth,
)

RANGES = {
    "near": (0.5, 8.0),
    "planet": (1.0, 1e4),
    "kilometres": (3.0, 40_000.0),
}


def window_of(z: np.ndarray, near: float, far: float) -> np.ndarray:
    """DESIGN §4: `w = far/(far-near) · (1 - near/z)`."""
    return far / (far - near) * (1 - near / z)


@pytest.mark.parametrize("ratio", [1.0001, 3.0, 1e4, 1e9, 1e15, np.inf])
@pytest.mark.parametrize("encoding", ["window", "reversed", "log"])
def test_the_ends_are_the_clip_planes(encoding: Encoding, ratio: float, dtype: np.dtype) -> None:
    """Exactly, whatever the constants round to, and nothing lies beyond them; logarithmic depths
    begin at the eye."""
    near, far = 0.3, 0.3 * ratio
    if encoding == "log" and far == np.inf:
        return
    top = np.nextafter(np.asarray(1, dtype), np.asarray(0, dtype))
    codes = np.array([0, np.finfo(dtype).tiny, 0.5, top, 1], dtype)
    found = np.asarray(linearize_depth(codes, near, far, encoding))
    assert found.dtype == dtype
    ends = found[[0, -1]] if encoding != "reversed" else found[[-1, 0]]
    assert ends[0] == (0 if encoding == "log" else dtype.type(near))
    assert ends[1] == dtype.type(far)
    assert not np.isnan(found).any()
    assert not np.signbit(found).any()
    order = found if encoding != "reversed" else found[::-1]
    assert np.all(np.diff(order[np.isfinite(order)]) >= 0)


@pytest.mark.parametrize("constant", [1.0, 0.001])
def test_logarithmic_depth_inverts_its_formula(constant: float, dtype: np.dtype) -> None:
    """Half an ulp of the code is ½ ε log(C far + 1) (C z + 1) / C of depth; the product with the
    logarithm rounds likewise, expm1 and the quotient by an ulp or two of the result."""
    far = 21050.0
    z = np.geomspace(8100.0, far, 401)
    steepness = np.log1p(constant * far)
    codes = (np.log1p(constant * z) / steepness).astype(dtype)
    found = np.asarray(linearize_depth(codes, 8100.0, far, "log", constant), np.float64)
    eps = np.finfo(dtype).eps
    bound = 1.5 * eps * steepness * (z + 1 / constant) + 4 * eps * z
    assert np.all(np.abs(found - z) <= bound)


@pytest.mark.parametrize("encoding", ["window", "reversed"])
def test_an_infinite_far_plane_is_the_limit_of_far_ones(encoding: Encoding) -> None:
    codes = np.linspace(0.01, 0.99, 50, dtype=np.float32)
    endless = np.asarray(linearize_depth(codes, 8.0, np.inf, encoding))
    np.testing.assert_allclose(endless, linearize_depth(codes, 8.0, 1e12, encoding), rtol=1e-6)


@pytest.mark.parametrize("encoding", ["window", "reversed"])
def test_textures_without_a_far_plane_have_finite_widths(encoding: Encoding) -> None:
    """Where there is no air both depths are infinite, and their difference no number."""
    near, z = 8.0, np.array([[10.0, 20.0, np.inf]])
    codes = [near / depth for depth in (z, z + 2)]
    if encoding == "window":
        codes = [1 - code for code in codes]
    front, back = codes
    textures = DepthTextures(front, back, None, None, near, np.inf, encoding)
    layers = textures.linearize()
    lit, _ = layer_widths(layers)
    np.testing.assert_allclose(lit, [[2, 2, 0]], rtol=1e-5)
    assert layers.width_unit == 1


@pytest.mark.parametrize(("near", "far"), RANGES.values(), ids=RANGES)
def test_inverts_the_projection(near: float, far: float, dtype: np.dtype) -> None:
    """A step ε of window depth is ε z² (far-near)/(far·near) of eye depth (DESIGN §4); window
    depth, `a` and their difference round by half an ulp of 1 each."""
    eps = np.finfo(dtype).eps
    z = np.geomspace(near, far, 401)
    window = window_of(z, near, far).astype(dtype)
    got = np.asarray(linearize_depth(window, near, far), np.float64)
    bound = 2 * eps * z**2 * (far - near) / (far * near) + 3 * eps * z
    # At the far end of float32 the step is no longer small against z: allow for the second order.
    bound = bound / (1 - np.minimum(bound / z, 0.5))
    assert np.all(np.abs(got - z) <= bound)
    assert np.all(np.diff(got) >= 0), "not monotone"


@pytest.mark.parametrize("ratio", [2.0, 1e4, 1e9, 1e15])
def test_reversed_depth_keeps_its_digits(ratio: float, dtype: np.dtype) -> None:
    """Reversed window depth falls as 1/z: its float is relative to what z is, at any far / near.

    Window, both constants, the sum, the quotient: half an ulp each, relative; and the sum of two
    terms of one sign cancels nothing.
    """
    near, far = 0.5, 0.5 * ratio
    z = np.geomspace(near, far, 401)
    window = (near * (far - z) / (z * (far - near))).astype(dtype)
    got = np.asarray(linearize_depth(window, near, far, "reversed"), np.float64)
    np.testing.assert_allclose(got, z, rtol=3 * np.finfo(dtype).eps)
    assert np.all(np.diff(got) >= 0), "not monotone"


def test_float32_against_float64_of_the_same_textures() -> None:
    """The same window values in both: the constant `a` rounds (half an ulp of 1), so does the
    difference, and the quotient."""
    near, far = RANGES["planet"]
    eps = np.finfo(np.float32).eps
    window = np.linspace(0, 0.999, 1000, dtype=np.float32)
    a, b = depth_constants(near, far)
    exact = b / (window.astype(np.float64) - a)
    got = np.asarray(linearize_depth(window, near, far), np.float64)
    bound = eps * exact**2 * (far - near) / (far * near) + 2 * eps * exact
    assert np.all(np.abs(got - exact) <= bound)


def test_traced_planes_give_the_same_depth(dtype: np.dtype) -> None:
    near, far = (jnp.asarray(plane, dtype) for plane in RANGES["near"])
    window = np.linspace(0, 0.9, 10, dtype=dtype)
    got = linearize_depth(window, near, far)
    assert got.dtype == dtype
    np.testing.assert_allclose(
        got, linearize_depth(window, *RANGES["near"]), rtol=32 * np.finfo(dtype).eps
    )


def textures(dtype: np.dtype, encoding: Encoding, shadow: bool = True) -> DepthTextures:
    window = np.linspace(0.1, 0.8, 12).reshape(3, 4).astype(dtype)
    later = window + np.asarray(0.05, dtype)
    begin, end = (window + np.asarray(0.01, dtype), later) if shadow else (None, None)
    return DepthTextures(window, later, begin, end, 0.5, 8.0, encoding, 2.0)


def test_textures_become_layers(dtype: np.dtype) -> None:
    depth = textures(dtype, "window")
    layers = depth.linearize()
    assert isinstance(layers, Layers)
    np.testing.assert_array_equal(layers.front, linearize_depth(depth.front, 0.5, 8.0))
    np.testing.assert_array_equal(layers.shadow_back, linearize_depth(depth.back, 0.5, 8.0))
    assert (layers.reference, layers.width_unit) == (0.0, 7.5)


def test_linear_textures_pass_through_with_their_reference(dtype: np.dtype) -> None:
    depth = textures(dtype, "linear")
    layers = depth.linearize()
    np.testing.assert_array_equal(layers.back, depth.back)
    assert (layers.reference, layers.width_unit) == (2.0, 7.5)


@pytest.mark.parametrize("encoding", ["window", "reversed", "linear"])
def test_absent_shadow_stays_absent(encoding: Encoding) -> None:
    layers = textures(np.dtype("float32"), encoding, shadow=False).linearize()
    assert layers.shadow_front is None
    assert layers.shadow_back is None
    assert not layers.has_shadow
