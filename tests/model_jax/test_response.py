"""What a camera records: values, slopes that are finite at and below black, errors."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import RESPONSE_PARAMETERS, InputError, Response, record

LIGHT = np.array([-2.0, -1e-3, -1e-30, 0.0, 1e-30, 1e-3, 0.5, 2.0])


def test_defaults_change_nothing(dtype: np.dtype) -> None:
    light = LIGHT.astype(dtype)
    for linear in (False, True):
        recorded = record(light, Response(), linear=linear)
        assert recorded.dtype == dtype
        np.testing.assert_allclose(recorded, light, rtol=4 * np.finfo(dtype).eps)


def test_values(dtype: np.dtype) -> None:
    """black_level + (exposure · light)^(1/gamma), odd about zero light.

    A power of an argument off by eps is off by eps / gamma, and XLA's own by some ulp of the
    logarithm, which is at most 69 for 1e-30.
    """
    camera = Response(exposure=3.0, gamma=2.2, black_level=0.05)
    recorded = record(LIGHT.astype(dtype), camera)
    expected = 0.05 + np.sign(LIGHT) * (3 * np.abs(LIGHT)) ** (1 / 2.2)
    np.testing.assert_allclose(recorded, expected, rtol=128 * np.finfo(dtype).eps)
    assert float(record(jnp.asarray(2.0), Response(0.5, 3.0, 0.25))) == pytest.approx(1.25)


@pytest.mark.parametrize("shape", [(), (3,), (2, 4, 3)], ids=str)
def test_any_shape(shape: tuple[int, ...]) -> None:
    light = np.full(shape, 0.25, np.float32)
    recorded = record(light, Response(gamma=2.0, black_level=0.5))
    assert recorded.shape == shape
    np.testing.assert_allclose(recorded, 1.0, rtol=1e-6)


def test_gamma_1_is_the_linear_record(dtype: np.dtype) -> None:
    """Values and slopes of exposure, black level and light agree with and without the power."""
    light = LIGHT.astype(dtype)
    camera = Response(1.7, 1.0, -0.3)

    def both(
        exposure: jax.Array, level: jax.Array, light: jax.Array, *, linear: bool
    ) -> jax.Array | np.ndarray:
        return record(light, Response(exposure, camera.gamma, level), linear=linear)

    arguments = (jnp.asarray(1.7, dtype), jnp.asarray(-0.3, dtype), jnp.asarray(light))
    for part in (lambda f: f, jax.jacfwd, lambda f: jax.jacrev(f, (0, 1)), jax.jacrev):
        plain, power = (part(lambda *a, k=k: both(*a, linear=k))(*arguments) for k in (True, False))
        for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(power), strict=True):
            np.testing.assert_allclose(one, other, rtol=128 * np.finfo(dtype).eps, atol=1e-30)


@pytest.mark.parametrize("gamma", [0.45, 1.0, 2.2])
@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
def test_slopes(mode: Callable[..., Any], gamma: float, x64: None) -> None:
    """Finite at zero and below, in all four arguments; elsewhere those of central differences.

    A step of 1e-6 of the argument leaves 1e-12 of curvature and 1e-10 of rounding.
    """
    light = np.array([-2.0, -0.1, 0.0, 0.3, 2.0])
    at: tuple[Any, ...] = (light, 1.3, gamma, 0.02)

    def recorded(light: Any, exposure: Any, gamma: Any, level: Any) -> jax.Array | np.ndarray:
        camera = Response(jnp.asarray(exposure), jnp.asarray(gamma), jnp.asarray(level))
        return record(jnp.asarray(light), camera)

    slopes = mode(recorded, argnums=(0, 1, 2, 3))(*map(jnp.asarray, at))
    for k, slope in enumerate(slopes):
        found = np.asarray(slope)
        assert np.isfinite(found).all()
        step = 1e-6
        high, low = (
            np.asarray(recorded(*(a + sign * step * (j == k) for j, a in enumerate(at))))
            for sign in (1, -1)
        )
        there = light != 0
        own = np.diag(found) if k == 0 else found
        np.testing.assert_allclose(own[there], ((high - low) / (2 * step))[there], rtol=1e-7)
    zero = np.diag(np.asarray(slopes[0]))[2]
    assert zero == 0.0
    assert np.abs(slopes[2]).max() > 0.1


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ({"exposure": -1.0}, r"response\.exposure: .*from 0 to inf"),
        ({"exposure": np.inf}, r"response\.exposure: .*finite"),
        ({"gamma": 0.0}, r"response\.gamma: .*from 0\.1 to 10"),
        ({"gamma": 11.0}, r"response\.gamma"),
        ({"gamma": np.nan}, r"response\.gamma: .*finite"),
        ({"black_level": np.nan}, r"response\.black_level: .*finite"),
        ({"exposure": "bright"}, r"response\.exposure: 'bright' is not a number"),
    ],
    ids=lambda value: None if isinstance(value, str) else "_".join(map(str, value)),
)
def test_impossible_values(camera: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message) as error:
        Response(**camera)
    assert "\n" not in str(error.value)


def test_parameters_are_the_fields() -> None:
    camera = Response()
    assert list(RESPONSE_PARAMETERS) == list(vars(camera))
    for name, about in RESPONSE_PARAMETERS.items():
        assert getattr(camera, name) == (None if name == "blur" else about.default)
        assert about.lower <= float(np.asarray(about.default)) <= about.upper
