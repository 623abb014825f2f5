"""What a residual costs: plain, robust and censored samples.

A loss gives for each sample the cost, the score (half the cost's derivative by the prediction) and
a curvature (what stands for half its second derivative): with these, whatever the loss, a fit is
Gauss–Newton on `[[JᵀhJ, Jᵀs], [·, Σ cost]]`, exact in cost and gradient. The robust losses are the
usual ones, with the weights of iteratively reweighted least squares as curvature (Holland and
Welsch, "Robust regression using iteratively reweighted least-squares", Comm. Statist. A6, 1977);
they are concave in the squared residual, so that the matrix above has no negative eigenvalue.

A censored sample is a normal one of which only a bound is known (Tobin, Econometrica 26, 1958): a
photo's highest code says "at least this bright", its lowest "at most this dark".
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from model_jax._shapes import Scalar

from .._choices import LossName

TUNING: dict[str, float] = {"huber": 1.345, "soft_l1": 1.345, "cauchy": 2.385}
"""Residual, in standard deviations of the noise, from which a loss doubts a sample: with these
Huber and Cauchy need 5 % more samples than least squares where all noise is normal (Holland and
Welsch 1977); soft-L1 has Huber's tails."""

_FAR = 8.0
"""Standard deviations below a bound from which on the continued fraction is used; nearer the
quotient loses less than 2 digits of 16."""

_DEPTH = 16
"""Terms of the continued fraction: exact to rounding from `_FAR` on."""

Residuals = Float[jax.Array, "..."]


class Loss(eqx.Module):
    """A loss and the noise it goes by."""

    name: LossName = eqx.field(static=True)
    noise: Scalar = 1.0
    """Standard deviation of a sample, recorded light; only robust losses and censoring use it."""

    @property
    def width(self) -> Scalar:
        """Residual from which a robust loss doubts a sample."""
        return self.noise * TUNING.get(self.name, 1.0)


def weigh(
    residual: Residuals, clipped: Int[jax.Array, "..."] | None, loss: Loss
) -> tuple[Residuals, Residuals, Residuals]:
    """Cost, score and curvature of samples.

    Args:
        residual: prediction minus recorded (for a clipped sample: minus the bound it tells).
        clipped: 0 for a measured sample, 1 for "at least", -1 for "at most"; None: all measured.

    Returns:
        cost ≥ 0 (a squared residual where the loss is plain), score, curvature ≥ 0.
    """
    cost, score, curvature = residual * residual, residual, jnp.ones_like(residual)
    if clipped is not None:
        bound = _tobit(residual * jnp.sign(clipped), loss.noise)
        is_bound = clipped != 0
        cost = jnp.where(is_bound, bound[0], cost)
        score = jnp.where(is_bound, jnp.sign(clipped) * bound[1], score)
        curvature = jnp.where(is_bound, bound[2], curvature)
    if loss.name == "linear":
        return cost, score, curvature
    square = jnp.square(jnp.asarray(loss.width))
    z = cost / square
    if loss.name == "huber":
        inner = z <= 1
        root = jnp.sqrt(jnp.where(inner, 1, z))
        rho, slope = jnp.where(inner, z, 2 * root - 1), 1 / root
    elif loss.name == "soft_l1":
        root = jnp.sqrt(1 + z)
        rho, slope = 2 * z / (root + 1), 1 / root
    else:
        rho, slope = jnp.log1p(z), 1 / (1 + z)
    return square * rho, slope * score, slope * curvature


def _tobit(excess: Residuals, noise: Scalar) -> tuple[Residuals, Residuals, Residuals]:
    """The three for "the truth is at least the bound"; `excess` is prediction minus bound.

    -2 σ² log Φ(t), t = excess / σ: nothing where the prediction is far above, the squared residual
    and a little more where it is below. Its slope is the hazard φ(t) / Φ(t), and far below, where
    that is a quotient of two vanishing numbers, Laplace's continued fraction (Abramowitz and Stegun
    26.2.14) has what it exceeds -t by to full precision.
    """
    noise = jnp.asarray(noise)
    t = excess / noise
    far = t < -_FAR
    near = jnp.where(far, -_FAR, t)
    share = jnp.exp(jax.scipy.stats.norm.logpdf(near) - jax.scipy.stats.norm.logcdf(near))
    below = jnp.where(far, -t, _FAR)
    beyond = jnp.zeros_like(t)
    for k in range(_DEPTH, 0, -1):
        beyond = k / (below + beyond)
    hazard = jnp.where(far, below + beyond, share)
    curvature = hazard * jnp.where(far, beyond, share + near)
    cost = -2 * noise * noise * jax.scipy.stats.norm.logcdf(t)
    return cost, -noise * hazard, curvature
