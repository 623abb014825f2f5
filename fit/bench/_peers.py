"""The peers: SciPy, and optimistix as its documentation shows it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from ..photo._columns import Columns


def scipy_fit(
    columns: Columns, start: Float[np.ndarray, "4"], tolerance: float
) -> Float[np.ndarray, "4"]:
    """Trust-region reflective, as a careful user calls it: analytic Jacobian, scaled columns."""
    from scipy.optimize import least_squares  # a tenth of a second to import, and only here

    lit, light, color = columns.fields["lit"], columns.light, columns.color
    dark = columns.fields.get("dark", np.zeros_like(lit))

    def tints(x: np.ndarray) -> np.ndarray:
        return np.array([x[2], x[3], 3 - x[2] - x[3]])

    def residual(x: np.ndarray) -> np.ndarray:
        return ((x[0] * color * tints(x)) * (lit + x[1] * dark)[:, None] - light).reshape(-1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        out = np.zeros((len(lit), 3, 4))
        width, t = (lit + x[1] * dark)[:, None], tints(x)
        out[..., 0] = color * t * width
        out[..., 1] = x[0] * color * t * dark[:, None]
        for k in (0, 1):
            out[:, k, 2 + k] = x[0] * color[k] * width[:, 0]
            out[:, 2, 2 + k] = -x[0] * color[2] * width[:, 0]
        return out.reshape(-1, 4)

    lower = np.array([0.0, 0.0, 0.0, 0.0])
    found = least_squares(
        residual,
        start,
        jacobian,
        bounds=(lower, np.inf),
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return np.asarray(found.x)


def dense_fit(columns: Columns, start: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """optimistix as its documentation shows it: all residuals in one array, float32."""
    lit = columns.fields["lit"]
    dark = columns.fields.get("dark", np.zeros_like(lit))
    arrays = (lit, dark, columns.light, columns.color)
    with jax.enable_x64(False):  # the command line switches it on
        return np.asarray(_dense_run(*(jnp.asarray(a, jnp.float32) for a in (*arrays, start))))


@jax.jit
def _dense_run(
    lit: jax.Array, dark: jax.Array, light: jax.Array, color: jax.Array, start: jax.Array
) -> jax.Array:
    def residual(x: jax.Array, _: Any) -> jax.Array:
        tints = jnp.stack([x[2], x[3], 3 - x[2] - x[3]])
        amplitude = x[0] * color * tints
        return amplitude[None] * (lit + x[1] * dark)[:, None] - light

    solver: Any = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5)
    return optx.least_squares(residual, solver, start, max_steps=64, throw=False).value
