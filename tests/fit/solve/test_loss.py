"""Losses: SciPy's definitions, slopes by differentiation, and a matrix that stays positive."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import erfcx
from scipy.stats import norm

from fit._choices import LOSSES, LossName, check_loss
from fit.solve._loss import TUNING, Loss, weigh
from model_jax import InputError

NOISE = 0.02
EPS = np.finfo(np.float64).eps
FAR = np.array([1e2, 1e4, 1e6])
GRID = np.concatenate([-FAR[::-1], np.linspace(-12, 12, 241), FAR])
"""Residuals in standard deviations: zero, the edges of all losses, and far tails."""

pytestmark = pytest.mark.usefixtures("x64")


def parts(t: np.ndarray, name: LossName, clipped: int = 0) -> tuple[np.ndarray, ...]:
    """Cost, score and curvature of residuals t·σ."""
    sign = None if not clipped else jnp.full(t.shape, clipped)
    found = weigh(jnp.asarray(t * NOISE), sign, Loss(name, NOISE))
    return tuple(np.asarray(part) for part in found)


@pytest.mark.parametrize("name", LOSSES)
def test_cost_is_scipys(name: LossName) -> None:
    """`least_squares` halves the cost, and stops at the first of one evaluation."""
    cost, _, _ = parts(GRID, name)
    for t, own in zip(GRID, cost, strict=True):
        scale = NOISE * TUNING.get(name, 1.0)
        theirs = least_squares(lambda x: x, [t * NOISE], loss=name, f_scale=scale, max_nfev=1).cost
        # SciPy's soft-L1 subtracts 1 from a root near 1, where ours does not cancel.
        assert own == pytest.approx(2 * theirs, rel=8 * EPS, abs=8 * EPS * scale**2)


@pytest.mark.parametrize("clipped", [0, 1, -1], ids=["measured", "white", "black"])
@pytest.mark.parametrize("name", LOSSES)
def test_score_is_half_the_slope(name: LossName, clipped: int) -> None:
    """By JAX's derivative of the cost; its logcdf has its own, good to 1e-12 within 12 σ."""
    sign = jnp.asarray(clipped)
    loss = Loss(name, NOISE)
    near = GRID[np.abs(GRID) <= 12]

    def cost(residual: jax.Array) -> jax.Array:
        return weigh(residual, sign, loss)[0]

    slope = np.asarray(jax.vmap(jax.grad(cost))(jnp.asarray(near * NOISE)))
    _, score, _ = parts(near, name, clipped)
    np.testing.assert_allclose(score, slope / 2, rtol=1e-11, atol=1e-15)


@pytest.mark.parametrize("clipped", [0, 1, -1], ids=["measured", "white", "black"])
@pytest.mark.parametrize("name", LOSSES)
def test_the_matrix_is_positive(name: LossName, clipped: int) -> None:
    """[[h, s], [s, cost]] has no negative eigenvalue: h·cost ≥ s² (`_gram.cholesky` needs it).

    Equal for plain least squares and, to first order, far below a bound: a few roundings of slack.
    """
    cost, score, curvature = parts(GRID, name, clipped)
    assert np.isfinite([cost, score, curvature]).all()
    assert (cost >= 0).all()
    # A curvature of exp(-t²/2) is 0 in the end.
    assert (curvature >= 0).all()
    assert (curvature <= 1 + 4 * EPS).all()
    assert (score**2 <= curvature * cost * (1 + 16 * EPS) + 1e-300).all()


@pytest.mark.parametrize("name", ["huber", "soft_l1", "cauchy"])
def test_robust_curvature_is_the_weight(name: LossName) -> None:
    """score = weight · residual, with a weight that falls from 1 at 0."""
    _, score, curvature = parts(GRID, name)
    np.testing.assert_allclose(score, curvature * GRID * NOISE, rtol=4 * EPS)
    order = np.argsort(np.abs(GRID), kind="stable")
    assert (np.diff(curvature[order]) <= EPS).all()
    assert curvature[GRID == 0] == 1
    assert curvature[0] < 1e-5


def test_a_bound_is_the_normal_distributions_tail() -> None:
    """cost -2σ² log P(at least the bound), score and curvature its derivatives; ±10⁶ σ too.

    The hazard φ/Φ by SciPy's scaled complementary error function, which has no tail to lose.
    """
    cost, score, curvature = parts(GRID, "linear", 1)
    known = -2 * NOISE**2 * norm.logcdf(GRID)
    # Far above the bound it is the logarithm of a number within an eps of 1.
    np.testing.assert_allclose(cost, known, rtol=64 * EPS, atol=2 * NOISE**2 * EPS)
    below = GRID[GRID < 12]
    hazard = np.sqrt(2 / np.pi) / erfcx(-below / np.sqrt(2))
    # Near -8 the quotient of two numbers near exp(-33) is off by 33 eps and some.
    np.testing.assert_allclose(score[GRID < 12], -NOISE * hazard, rtol=100 * EPS, atol=1e-30)
    slope = jax.vmap(jax.grad(lambda r: weigh(r, jnp.asarray(1), Loss("linear", NOISE))[1]))
    np.testing.assert_allclose(slope(jnp.asarray(GRID * NOISE)), curvature, rtol=1e-12, atol=1e-30)
    assert (np.diff(curvature) <= 100 * EPS).all()
    # Far below it is a measured sample, far above it is none.
    assert cost[0] == pytest.approx((1e6 * NOISE) ** 2, rel=1e-10)
    assert curvature[0] == pytest.approx(1.0, rel=1e-11)
    assert (cost[-1], score[-1], curvature[-1]) == (0, 0, 0)


@pytest.mark.parametrize("name", LOSSES)
def test_black_mirrors_white(name: LossName) -> None:
    white, black = parts(GRID, name, 1), parts(-GRID, name, -1)
    for ours, theirs, sign in zip(white, black, (1, -1, 1), strict=True):
        np.testing.assert_array_equal(ours, sign * theirs)


@pytest.mark.parametrize("name", LOSSES)
def test_measured_samples_are_not_touched_by_clipped_ones(name: LossName) -> None:
    mixed = jnp.asarray([0, 1, -1] * 3)
    residual = jnp.asarray(np.repeat([-3.0, 0.0, 40.0], 3) * NOISE)
    loss = Loss(name, NOISE)
    together = weigh(residual, mixed, loss)
    for sign in (0, 1, -1):
        alone = weigh(residual, jnp.full(9, sign), loss)
        for part, own in zip(together, alone, strict=True):
            np.testing.assert_array_equal(part[mixed == sign], own[mixed == sign])


def test_losses_by_name() -> None:
    assert [check_loss(name) for name in LOSSES] == list(LOSSES)
    with pytest.raises(InputError, match=r"'tukey' is unknown; choose from \['linear'"):
        check_loss("tukey")
