"""One row of `stress.csv`: a computation at its limits, in float32, float64 and 50 digits.

A loss has a name where no formula could avoid it: the given numbers, each moved by one rounding of
that precision, move the exact result as far.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import AirlightError

from ._wide import Wide

Area = Literal["render", "combine", "record"]

HOLDS = 2.0**-10
"""Share of the largest: a quarter of a code of 8 bits, which nobody sees."""
ROOM = 64.0
"""How much more than one rounding of what is given the roundings on the way may do: formulas have
up to some thousand of them, which mostly cancel."""
KINK = 1e-3
"""What one rounding of float64 may do, as a share of what one of float32 does, which is 2⁻²⁹ where
a function is smooth and 2⁻¹⁵ at a root."""
DRAWS = 2
"""Roundings of what is given; the worst counts."""
EPS = {"float32": 2.0**-24, "float64": 2.0**-53}

Arrays = Any
"""A pytree of float64 arrays."""


@dataclass(frozen=True)
class NumberRow:
    """A row. Errors are the largest, as a share of the largest result, and of the largest slope."""

    area: Area
    case: str
    float32: float | None = None
    float64: float | None = None
    given32: float | None = None
    """What one rounding of each given number to float32 does by itself."""
    given64: float | None = None
    opengl: float | None = None
    """Of widths that OpenGL drew, linear depths."""
    gradient_finite: bool | None = None
    """In both precisions."""
    gradient32: float | None = None
    """Slopes by the relative change of each given number, share of the largest."""
    gradient64: float | None = None
    gradient_given32: float | None = None
    gradient_given64: float | None = None
    verdict: str = ""
    """"holds", "float32 loses", "float64 loses", "refused", "not measured", "FAILS"."""
    kept: bool = True
    """No NaN, no infinity, no loss without a name."""
    note: str = ""


@dataclass(frozen=True)
class Cause:
    """Of a loss: what it is, and how much it explains."""

    words: str
    most: float
    """Largest error of float32; of float64 it is `EPS` times less."""


class Program:
    """A function and its slopes, in each precision and in 50 digits, made once for many probes.

    Args:
        function: from a pytree of arrays to an array, in the precision of what is given.
        example: what it is given, in float64; JAX's x64 has to be on.
    """

    def __init__(self, function: Callable[[Arrays], jax.Array], example: Arrays) -> None:
        shape = jax.eval_shape(function, example).shape
        weights = np.random.default_rng(0).uniform(0.5, 1.0, shape) / np.prod(shape)

        def total(given: Arrays) -> jax.Array:
            found = function(given)
            return (found * jnp.asarray(weights, found.dtype)).sum()

        self.run = jax.jit(function)
        self.slopes = jax.jit(jax.grad(total))
        self.exact = Wide(function, example)
        self.exact_slopes = Wide(jax.grad(total), example)


@dataclass(frozen=True)
class Probe:
    """What is computed, of what."""

    area: Area
    case: str
    program: Program
    given: Arrays
    right: Callable[[Arrays], Float[np.ndarray, "..."]] | None = None
    """The result by other means; None: by 50 digits of the function itself."""
    plain: Callable[[str], Float[np.ndarray, "..."]] | None = None
    """The result by name of the precision, where it is not the program's in that."""
    opengl: Callable[[], Float[np.ndarray, "..."]] | None = None
    cause: Cause | None = None
    """Why more is lost than one rounding of what is given explains."""


def cast(tree: Arrays, dtype: Any) -> Arrays:
    """All floats in one precision."""
    return jax.tree.map(
        lambda leaf: jnp.asarray(leaf, dtype) if eqx.is_inexact_array_like(leaf) else leaf, tree
    )


def measured(probe: Probe) -> NumberRow:
    """The row of a probe; JAX's x64 has to be on."""
    row = partial(NumberRow, probe.area, probe.case)
    try:
        return judged(row(**_errors(probe)), probe.cause)
    except AirlightError as error:
        return row(verdict="refused", note=str(error).partition("\n")[0])
    except NotImplementedError as error:
        return row(verdict="not measured", note=str(error))


def _errors(probe: Probe) -> dict[str, Any]:
    """The fields of a row that are numbers."""
    program, given = probe.program, cast(probe.given, jnp.float64)
    result = probe.right or program.exact
    right, steep = np.asarray(result(given)), program.exact_slopes(given)
    scale = float(np.max(np.abs(right))) or 1.0
    size = jax.tree.map(lambda leaf: float(np.max(np.abs(leaf), initial=0.0)) or 1.0, given)
    most = _largest(np.abs(slope) * s for slope, s in _pairs(steep, size))
    most = max(most, HOLDS * scale)  # less than that nobody sees, however the number changes

    def off(found: Any) -> float:
        return _largest([np.abs(np.asarray(found, np.float64) - right)]) / scale

    def bent(found: Arrays) -> float:
        both = zip(_pairs(found, size), _pairs(steep, size), strict=True)
        with np.errstate(invalid="ignore"):  # infinite slopes are told as such
            return _largest(np.abs(a - b) * s for (a, s), (b, _) in both) / most

    told: dict[str, Any] = {}
    finite = True
    for dtype, eps in EPS.items():
        numbers, bits = cast(given, dtype), dtype.removeprefix("float")
        slopes = program.slopes(numbers)
        finite &= all(bool(np.isfinite(leaf).all()) for leaf in jax.tree.leaves(slopes))
        moved = [_moved(given, eps, draw) for draw in range(DRAWS)]
        told[dtype] = off(program.run(numbers) if probe.plain is None else probe.plain(dtype))
        told[f"given{bits}"] = max(off(result(near)) for near in moved)
        told[f"gradient{bits}"] = bent(slopes)
        told[f"gradient_given{bits}"] = max(bent(program.exact_slopes(near)) for near in moved)
    told["gradient_finite"] = finite
    if probe.opengl is not None:
        told["opengl"] = off(probe.opengl())
    return told


def _largest(parts: Iterable[np.ndarray]) -> float:
    """Of all arrays; NaN if one has some."""
    return float(np.max([np.max(part, initial=0.0) for part in parts], initial=0.0))


def _moved(given: Arrays, eps: float, seed: int) -> Arrays:
    """Each number moved by one rounding, up or down."""
    rng = np.random.default_rng(seed)

    def near(leaf: Any) -> Any:
        exact = np.asarray(leaf, np.float64)
        way = np.where(rng.random(exact.shape) < 0.5, -1.0, 1.0)
        return jnp.asarray(exact * (1 + 2 * way * eps))  # 1 ± eps is no double of its own

    return jax.tree.map(near, given)


def _pairs(tree: Arrays, size: Arrays) -> list[tuple[np.ndarray, float]]:
    leaves = [np.asarray(leaf, np.float64) for leaf in jax.tree.leaves(tree)]
    return list(zip(leaves, jax.tree.leaves(size), strict=True))


def judged(row: NumberRow, cause: Cause | None = None) -> NumberRow:
    """With verdict, and whether each loss has a name."""
    numbers = [value for value in vars(row).values() if isinstance(value, float)]
    if not row.gradient_finite or not np.isfinite(numbers).all():
        return replace(row, verdict="FAILS", kept=False, note="some number is not finite")
    words, lost, kept = [], [], True
    for what, about, precision, given in _JUDGED:
        error = getattr(row, what)
        if error is None or error <= HOLDS:
            continue
        lost.append(precision)
        by_given = getattr(row, f"{given}{precision.removeprefix('float')}")
        # Beside a kink of the slopes one rounding moves them in any precision: no excuse.
        is_kink = getattr(row, f"{given}64") > KINK * getattr(row, f"{given}32")
        share = EPS[precision] / EPS["float32"]
        if error <= ROOM * by_given and not is_kink:
            words.append(f"{about}: one rounding of what is given moves the result as far")
        elif cause is not None and error <= share * cause.most:
            words.append(f"{about}: {cause.words}")
        else:
            kept = False
            words.append(f"{about}: lost for no reason that is known")
    if not lost:
        return replace(row, verdict="holds")
    verdict = f"{max(lost)} loses" if kept else "FAILS"
    return replace(row, verdict=verdict, kept=kept, note="; ".join(words))


_JUDGED = (
    ("float32", "float32", "float32", "given"),
    ("opengl", "OpenGL", "float32", "given"),
    ("gradient32", "slopes in float32", "float32", "gradient_given"),
    ("float64", "float64", "float64", "given"),
    ("gradient64", "slopes in float64", "float64", "gradient_given"),
)
"""Errors: field, in words, precision, and the field of what one rounding does."""
