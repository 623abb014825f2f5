"""The descent: from the reduced pixels to the best look, with optimistix.

What the solver sees is of order one whatever the photo's exposure and the scene's lengths: it moves
from a start that the data suggest, along directions each scaled so that one unit of it changes the
picture by as much as the picture is. It runs in float64 by a scoped switch that leaves the caller's
JAX configuration alone. Its own word on success is not taken: `_fit` judges the end point in NumPy,
with the derivatives written by hand here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from model_jax import InputError
from model_jax._shapes import AnyArray, namespace

from ._parameters import (
    BACKGROUND,
    BRIGHTNESS,
    SHADOW,
    TINT,
    FreeParameter,
    LookVector,
    directions,
    settle_tint,
)
from ._reduce import Reduced

Solver = optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser

_SOLVERS = {
    "lm": optx.LevenbergMarquardt,
    "dogleg": optx.Dogleg,
    "gauss_newton": optx.GaussNewton,
    "bfgs": optx.BFGS,
    "lbfgs": optx.LBFGS,
    "nelder_mead": optx.NelderMead,
}

_TOLERANCE = 1e-12
"""Solver tolerance, absolute and relative, on numbers of order one: float64 has 2e-16, and 1e-8 in
the parameters is promised."""

_DIRECTIONS = 9
"""Most degrees of freedom: brightness, 2 of tint, 3 shadow weights, 3 levels. Unused ones are held
at zero by a residual of their own, so that JAX compiles one program for every choice."""

CHECK = 1e-6
"""How far, as a share of the variance of one sample, the square sum at the end may lie above what a
Gauss–Newton step promises: the parameters are then within 1e-3 standard errors of the optimum."""


@dataclass(frozen=True)
class Problem:
    """Reduced pixels and the air's colour. Vectors are scaled: see `units`."""

    reduced: Reduced
    color: Float[np.ndarray, "3"]

    @property
    def units(self) -> LookVector:
        """Look vector = scaled vector × units."""
        light, width = self.reduced.light, self.reduced.width
        return np.array([light / width, *6 * [1.0], *3 * [light]])

    def square_sum(self, vector: LookVector) -> float:
        """Σ residual² over used pixels and channels, in units of light²."""
        return float((self.residual(vector) ** 2).sum()) + self.reduced.rest

    def residual(self, vector: LookVector) -> Float[np.ndarray, "3 3"]:
        """Reduced residual; row m, channel k."""
        return self.reduced.design @ coefficients(vector, self.color) - self.reduced.target

    def rounding(self) -> float:
        """Square sum that float64 cannot tell from zero: a QR of 6 columns is backward stable to a
        few times 6 eps of a column's norm (Higham, *Accuracy and Stability*, 19.4)."""
        return (64 * np.finfo(np.float64).eps) ** 2 * self.reduced.square_sum


@dataclass(frozen=True)
class Descent:
    """Where a descent ended. `vector` is scaled."""

    vector: LookVector
    finite: bool
    steps: int


def make_solver(name: str) -> Solver:
    """An optimistix solver by its name.

    Raises:
        InputError: a name that is not in the list.
    """
    if name not in _SOLVERS:
        raise InputError(f"solver: {name!r} is not known; choose from {list(_SOLVERS)}")
    solver: Solver = _SOLVERS[name](rtol=_TOLERANCE, atol=_TOLERANCE)
    return solver


def coefficients(vector: AnyArray, color: AnyArray) -> AnyArray:
    """What the columns 1, lit, dark are multiplied with, [3 columns, 3 channels].

    Twin of `model_jax.combine` plus background: level, B·c·t, B·c·t·s.
    """
    xp = namespace(vector)
    lit = vector[BRIGHTNESS] * (color * vector[TINT])
    return xp.stack([vector[BACKGROUND], lit, lit * vector[SHADOW]])


def coefficient_slopes(
    vector: LookVector, color: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3 10"]:
    """Derivative of `coefficients` by the ten entries, by hand."""
    slopes = np.zeros((3, 3, 10))
    brightness, shadow, tint = vector[BRIGHTNESS], vector[SHADOW], vector[TINT]
    for k in range(3):
        slopes[0, k, 7 + k] = 1.0
        for row, share in ((1, 1.0), (2, shadow[k])):
            slopes[row, k, 0] = color[k] * tint[k] * share
            slopes[row, k, 4 + k] = brightness * color[k] * share
        slopes[2, k, 1 + k] = brightness * color[k] * tint[k]
    return slopes


def jacobian(
    problem: Problem, vector: LookVector, along: Float[np.ndarray, "10 p"]
) -> Float[np.ndarray, "9 p"]:
    """Change of the reduced residual along directions of the scaled vector."""
    slopes = coefficient_slopes(vector, problem.color) @ along
    return np.einsum("im,mkp->ikp", problem.reduced.design, slopes).reshape(9, along.shape[1])


def descend(
    problem: Problem,
    start: LookVector,
    free: Sequence[FreeParameter],
    solver: Solver,
    max_steps: int,
) -> Descent:
    """The best vector that moves only what is free.

    Starts where the square sum is lowest: at `start`, or at the exact optimum for one of the shadow
    weights of a scan (`scan`), which is what keeps it from a wrong valley.
    """
    start = settle_tint(start, free)
    best = min([start, *scan(problem, start, free)], key=problem.square_sum)
    along, _ = directions(free)
    p = along.shape[1]
    if p == 0:
        return Descent(best, True, 0)
    norms = np.linalg.norm(jacobian(problem, best, along), axis=0)
    size = np.sqrt(problem.reduced.square_sum)
    steps_to_vector = np.zeros((10, _DIRECTIONS))
    steps_to_vector[:, :p] = along * np.divide(size, norms, out=np.ones(p), where=norms > 0)
    idle = np.zeros(_DIRECTIONS)
    idle[p:] = 1.0
    arguments = (
        best,
        steps_to_vector,
        idle,
        problem.color,
        problem.reduced.design / size,
        problem.reduced.target / size,
    )
    with jax.enable_x64(True):
        end, steps = _run(solver, jax.tree.map(jnp.asarray, arguments), max_steps)
        vector = best + steps_to_vector @ np.asarray(end)
    finite = bool(np.isfinite(vector).all())
    if finite and problem.square_sum(vector) > problem.square_sum(best):
        vector = best  # never worse than the start; the check decides whether it is good enough
    return Descent(vector, finite, int(steps))


@eqx.filter_jit
def _run(
    solver: Solver, arguments: tuple[jax.Array, ...], max_steps: int
) -> tuple[jax.Array, jax.Array]:
    def residual(step: jax.Array, arguments: Any) -> Any:
        start, steps_to_vector, idle, color, design, target = arguments
        terms = coefficients(start + steps_to_vector @ step, color)
        return design @ terms - target, idle * step

    start = jnp.zeros(_DIRECTIONS, arguments[0].dtype)
    solution: optx.Solution = optx.least_squares(
        residual, solver, start, arguments, max_steps=max_steps, throw=False
    )
    return solution.value, solution.stats["num_steps"]


def scan(problem: Problem, start: LookVector, free: Sequence[FreeParameter]) -> list[LookVector]:
    """Exact optima for a fan of shadow weights (for the start's own where shadow is not free).

    Given the weight the picture is linear in what remains, brightness × tint counting as one number
    per channel. With tint free and one weight for all channels, what is left is a Rayleigh
    quotient of two by two matrices in the direction (lit, dark), which has one valley: 33
    directions over the quarter circle of weights ≥ 0 cannot miss it.
    """
    families = {p.family for p in free}
    weights = [start[SHADOW]]
    if "shadow" in families:
        lit, dark = (np.linalg.norm(problem.reduced.design[:, column]) for column in (1, 2))
        ratio = lit / dark if lit > 0 and dark > 0 else 1.0
        weights += [np.full(3, ratio * w) for w in np.tan(np.linspace(0, np.pi / 2, 34)[:-1])]
    others = [p for p in free if p.family != "shadow"]
    return [_optimum_for(problem, start, others, weight, free) for weight in weights]


def _optimum_for(
    problem: Problem,
    start: LookVector,
    others: Sequence[FreeParameter],
    weight: np.ndarray,
    free: Sequence[FreeParameter],
) -> LookVector:
    """The best vector with the free shadow weights at `weight`; linear least squares."""
    vector = start.copy()
    for p in free:
        if p.family == "shadow":
            vector[list(p.entries)] = weight[p.entries[0] - 1]
    tints = [p.entries[0] for p in others if p.family == "tint"]
    if any(p.family == "brightness" for p in others) and len(tints) > 1:
        return _free_amplitudes(problem, vector, others, tints)
    return _linear_step(problem, vector, directions(others)[0])


def _free_amplitudes(
    problem: Problem, vector: LookVector, others: Sequence[FreeParameter], tints: list[int]
) -> LookVector:
    """As `_linear_step`, where brightness and tint are both free: their product is linear."""
    flat = vector.copy()
    flat[BRIGHTNESS] = 1.0  # the tints then stand for the products
    columns = [np.eye(10)[tint] for tint in tints]
    columns += list(directions([p for p in others if p.family == "background"])[0].T)
    flat = _linear_step(problem, flat, np.array(columns).T)
    rest = 3.0 - sum(vector[t] for t in range(TINT.start, TINT.stop) if t not in tints)
    brightness = flat[tints].sum() / rest
    if brightness == 0 or not np.isfinite(brightness):
        return vector
    flat[tints] /= brightness
    # Held tints belong to channels without colour, or are zero: they need no product.
    flat[BRIGHTNESS] = brightness
    return flat


def _linear_step(
    problem: Problem, vector: LookVector, along: Float[np.ndarray, "10 p"]
) -> LookVector:
    if along.shape[1] == 0:
        return vector
    slope, residual = jacobian(problem, vector, along), problem.residual(vector).reshape(-1)
    step = np.linalg.lstsq(slope, -residual, rcond=None)[0]
    moved: LookVector = vector + along @ step
    return moved
