"""How a camera records light: blur, exposure, gamma and black level, one set per photo.

    recorded = black_level + (exposure · blurred light)^(1/gamma)

A look says how bright the air is; a `Response` says what one photo made of that. A photo that was
decoded with the right tone curve has the defaults, which change nothing.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._blur import blurred
from ._errors import InputError, shown
from ._kinds import as_jax, need
from ._parameter import RESPONSE_PARAMETERS
from ._safe import safe_power
from ._shapes import AnyArray, Scalar, converter


def _optional(name: str) -> Callable[[Any], Any]:
    """As `converter`, of what may be absent."""
    convert = converter(name)
    return lambda value: None if value is None else convert(value)


class Response(eqx.Module):
    """Parameters of a camera's response; a pytree, so that losses can be differentiated by it."""

    exposure: Scalar = eqx.field(converter=converter("response.exposure"), default=1.0)
    """Factor on light; > 0. One photo tells only its product with what the air emits."""
    gamma: Scalar = eqx.field(converter=converter("response.gamma"), default=1.0)
    """What is left of the tone curve after decoding; 0.1 to 10, 1 for none."""
    black_level: Scalar = eqx.field(converter=converter("response.black_level"), default=0.0)
    """Recorded value without light, in units of recorded light."""
    blur: Scalar | None = eqx.field(converter=_optional("response.blur"), default=None)
    """Standard deviation of the Gaussian that lens, film and pixels spread light by, px, 0 to 3;
    None for none, which costs nothing."""

    def __check_init__(self) -> None:
        for name, info in RESPONSE_PARAMETERS.items():
            value = getattr(self, name)
            if value is None and name == "blur":
                continue
            if np.shape(value) != ():
                raise InputError(f"response.{name}: {shown(value)} must be one number")
            if isinstance(value, jax.core.Tracer):
                continue
            if not np.isfinite(value) or not info.lower <= value <= info.upper:
                raise InputError(
                    f"response.{name}: {shown(value)} must be a finite number"
                    f" from {info.lower:g} to {info.upper:g}"
                )


def record(
    light: Float[AnyArray, "*shape"], response: Response, *, linear: bool = False
) -> Float[AnyArray, "*shape"]:
    """What the camera records of light.

    Args:
        light: linear light, any shape; with a blur a picture [h, w, c].
        response: of one photo. Light below zero, which a background below zero can make, goes
            through the power odd-symmetrically.
        linear: gamma is known to be 1; leaves the power out.

    Returns:
        Recorded light, same shape and dtype. The slope is finite everywhere; where light is
        exactly zero it is taken as zero when gamma is not 1.

    Raises:
        InputError: a blur, and light that is no picture.
    """
    need("response", response, Response)
    light = as_jax("light", light)
    dtype = light.dtype
    if response.blur is not None:
        if light.ndim != 3:
            raise InputError(
                f"light: has shape {light.shape}; a response with a blur records pictures [h, w, c]"
            )
        light = blurred(light, response.blur)
    exposed = jnp.asarray(response.exposure, dtype) * light
    if not linear:
        exponent = 1 / jnp.asarray(response.gamma, dtype)
        exposed = jnp.sign(exposed) * safe_power(jnp.abs(exposed), exponent)
    return exposed + jnp.asarray(response.black_level, dtype)
