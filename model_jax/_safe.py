"""Safe-gradient primitives: the only place where a square root, a power or a quotient may meet
the point at which its derivative does not exist.

Masking the *result* of such a function is not enough: reverse mode multiplies the masked zero by
an infinite derivative and returns NaN. Each function here therefore masks the *argument* first
(the double-`where` form) and defines the derivative at the bad point as zero.

All take NumPy or JAX arrays and return the same kind.
"""

import jax.numpy as jnp
import numpy as np

from ._shapes import AnyArray, Scalar, namespace


def safe_sqrt(x: AnyArray) -> AnyArray:
    """`sqrt(max(x, 0))`, with derivative 0 for x ≤ 0.

    The naive form breaks at x = 0 (tangent rays): its derivative there is infinite.
    """
    xp = namespace(x)
    positive = x > 0
    return xp.where(positive, xp.sqrt(xp.where(positive, x, 1)), 0)


def safe_power(x: AnyArray, exponent: Scalar) -> AnyArray:
    """`max(x, 0) ** exponent` for exponent > 0, with derivative 0 for x ≤ 0.

    The naive form breaks at x = 0: for exponents below one the derivative is infinite, and the
    derivative with respect to the exponent takes `log(0)`.
    """
    xp = namespace(x, exponent)
    positive = x > 0
    return xp.where(positive, xp.power(xp.where(positive, x, 1), exponent), 0)


def safe_divide(
    numerator: AnyArray, denominator: AnyArray, otherwise: float | AnyArray
) -> AnyArray:
    """`numerator / denominator`, and `otherwise` (derivative 0) where the denominator is zero or
    where the quotient would leave the dtype's range.

    The naive form breaks at denominator = 0 (a ray along the shadow's cone), and also just beside
    it, where the quotient overflows to inf. The bound used is the square root of the largest
    number of the dtype, so that products of two such quotients stay finite.

    Twin: `quotient` in `rays.glsl`.
    """
    xp = namespace(numerator, denominator)
    limit = jnp.finfo(xp.result_type(numerator, denominator)).max ** 0.5
    usable = xp.abs(numerator) < limit * xp.abs(denominator)
    usable = usable & (denominator != 0)
    return xp.where(usable, numerator / xp.where(usable, denominator, 1), otherwise)


def is_host(*arrays: object) -> bool:
    """True when every leaf is concrete NumPy data or a Python number (nothing is traced)."""
    return namespace(*arrays) is np
