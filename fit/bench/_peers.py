"""The peers: other solvers on the same pixels, as their documentation shows them.

All get the same residual, written in JAX and compiled, and count from the same start in typical
sizes. SciPy and lmfit are handed NumPy arrays, as they want them. Bounds are told to those that
take some: trf, lmfit, and Adam by projection. A budget is in each one's own measure: evaluations of
SciPy and lmfit, steps of the others.
"""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._compile import float64
from ..solve._model import Model
from ._problems import Case
from ._residuals import Flat, flat_residuals, loss, residuals_of, slopes_of
from ._settings import Ended

Peer = Callable[[Case, int], Ended]

TIGHT = 1e-15
"""Tolerance that leaves the end to the budget: budgets are what a curve is made of."""

LEARNING_RATE = 0.05
"""Of Adam, in typical sizes a step."""


def _scipy(case: Case, budget: int, method: str) -> Ended:
    from scipy.optimize import least_squares  # a tenth of a second to import, and only here

    with float64():
        flat, model = case.residuals.flat(), case.model
        lower, upper = _box(case)
        bounds = {"bounds": (lower, upper)} if method == "trf" else {}
        found = least_squares(
            lambda u: np.asarray(residuals_of(jnp.asarray(u), flat, model)),
            np.clip(np.zeros(len(lower)), lower, upper),
            lambda u: np.asarray(slopes_of(jnp.asarray(u), flat, model)),
            method=method,
            x_scale="jac",
            max_nfev=budget,
            ftol=TIGHT,
            xtol=TIGHT,
            gtol=TIGHT,
            **bounds,
        )
    return _ended(case, found.x, int(found.nfev) + int(found.njev or 0))


def _box(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of u where a direction is one parameter's."""
    lower = np.full(case.directions.shape[1], -np.inf)
    upper = -lower
    for p in case.free:
        column = np.flatnonzero(case.directions[p.entries[0]])
        if not p.mean_one and len(column) == 1:
            scale = case.residuals.scale[column[0]]
            lower[column], upper[column] = (
                (bound - float(p.of(case.start))) / scale for bound in (p.floor, p.upper)
            )
    return np.minimum(lower, -1e-12), np.maximum(upper, 1e-12)


def _lmfit(case: Case, budget: int) -> Ended:
    import lmfit

    with float64():
        flat, model = case.residuals.flat(), case.model
        names = [f"u{k}" for k in range(case.directions.shape[1])]
        given = lmfit.Parameters()
        for name, low, high in zip(names, *_box(case), strict=True):
            given.add(name, value=0.0, min=low, max=high)

        def residual(values: Any) -> np.ndarray:
            u = jnp.asarray([float(values[name]) for name in names])
            return np.asarray(residuals_of(u, flat, model))

        tight = {"ftol": TIGHT, "xtol": TIGHT, "gtol": TIGHT}
        fitter = lmfit.Minimizer(residual, given, max_nfev=budget, calc_covar=False)
        found = fitter.minimize(method="leastsq", **tight)
    return _ended(case, np.array([float(found.params[name]) for name in names]), int(found.nfev))


def _adam(case: Case, budget: int) -> Ended:
    with float64():
        size, most = jnp.asarray(case.residuals.size), jnp.asarray(budget)
        u = _run_adam(case.residuals.flat(), case.model, size, most, *map(jnp.asarray, _box(case)))
    return _ended(case, np.asarray(u), budget)


@eqx.filter_jit
def _run_adam(
    flat: Flat,
    model: Model,
    size: jax.Array,
    most: jax.Array,
    lower: jax.Array,
    upper: jax.Array,
) -> jax.Array:
    import optax

    solver = optax.adam(LEARNING_RATE)
    u = jnp.zeros(flat.steps.shape[1])

    def step(_: Any, state: Any) -> Any:
        u, inner = state
        slope = jax.grad(loss)(u, flat, model, size)
        change, inner = solver.update(slope, inner)
        return optax.projections.projection_box(u + change, lower, upper), inner

    found: jax.Array = jax.lax.fori_loop(0, most, step, (u, solver.init(u)))[0]
    return found


def _lbfgs(case: Case, budget: int) -> Ended:
    with float64():
        size = jnp.asarray(case.residuals.size)
        u, count = _run_lbfgs(case.residuals.flat(), case.model, size, jnp.asarray(budget))
    return _ended(case, np.asarray(u), int(count))


@eqx.filter_jit
def _run_lbfgs(
    flat: Flat, model: Model, size: jax.Array, most: jax.Array
) -> tuple[jax.Array, jax.Array]:
    import optax

    solver = optax.lbfgs()
    value = lambda u: loss(u, flat, model, size)  # noqa: E731 (optax wants the bare function)
    both = optax.value_and_grad_from_state(value)
    u = jnp.zeros(flat.steps.shape[1])

    def step(_: Any, state: Any) -> Any:
        u, inner, count = state
        cost, slope = both(u, state=inner)
        change, inner = solver.update(slope, inner, u, value=cost, grad=slope, value_fn=value)
        searched = optax.tree.get(inner, "num_linesearch_steps")
        return optax.apply_updates(u, change), inner, count + 1 + searched

    begin = u, solver.init(u), jnp.asarray(0)
    found: Any = jax.lax.fori_loop(0, most, step, begin)
    return found[0], found[2]


def _optimistix(case: Case, budget: int) -> Ended:
    with float64():
        u, steps = _run_optimistix(case.residuals.flat(), case.model, budget)
    return _ended(case, np.asarray(u), int(steps) + 1)


@eqx.filter_jit
def _run_optimistix(flat: Flat, model: Model, budget: int) -> tuple[jax.Array, jax.Array]:
    solver: Any = optx.LevenbergMarquardt(rtol=TIGHT, atol=TIGHT)
    u = jnp.zeros(flat.steps.shape[1])
    found: Any = optx.least_squares(
        lambda u, flat: flat_residuals(u, flat, model),
        solver,
        u,
        flat,
        max_steps=budget,
        throw=False,
    )
    return found.value, found.stats["num_steps"]


def _ended(case: Case, u: np.ndarray, evaluations: int) -> Ended:
    vector = case.residuals.vector(u)
    return Ended(vector, evaluations, evaluations * case.residuals.bytes())


PEERS: dict[str, Peer] = {
    "SciPy trf": lambda case, budget: _scipy(case, budget, "trf"),
    "SciPy lm": lambda case, budget: _scipy(case, budget, "lm"),
    "lmfit leastsq": _lmfit,
    "optax Adam": _adam,
    "optax L-BFGS": _lbfgs,
    "optimistix LM": _optimistix,
}
"""By name, which begins with the package's."""


def installed(peer: str) -> bool:
    """Whether its package is there."""
    return find_spec(peer.partition(" ")[0].lower()) is not None
