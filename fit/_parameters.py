"""Between a `Look` and the ten numbers that a fit moves, and which of them it may move.

Everything below the `Look` works on one vector of ten entries (`ENTRIES`): a weight or a level that
the look gives as one number stands there three times. A fit moves it along *directions*, one column
for each degree of freedom: a shared number moves its three entries together, and the free tints
move so that their sum stays what it is (mean 1), n channels having n - 1 directions.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from model_jax import PARAMETERS, InputError, Look

CHANNELS = ("r", "g", "b")

ENTRIES = (
    "brightness",
    *(f"{name}.{channel}" for name in ("shadow", "tint", "background") for channel in CHANNELS),
)
"""The ten entries of the vector, in order."""

BRIGHTNESS, SHADOW, TINT, BACKGROUND = 0, slice(1, 4), slice(4, 7), slice(7, 10)

LookVector = Float[np.ndarray, "10"]

_ORDER = ("brightness", "tint", "shadow", "background")
"""Who is told first: when two act alike in the pixels used, the later one is held."""


@dataclass(frozen=True)
class FreeParameter:
    """One reported number of a fit: `brightness`, `tint.g`, `shadow`, `background.b` …"""

    name: str
    """As in reports."""
    family: str
    """Its field in `Look`, a key of `PARAMETERS`."""
    entries: tuple[int, ...]
    """Where it stands in the vector; all entries are equal."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Closed range of allowed values; infinite where there is no bound."""
        return PARAMETERS[self.family].lower, PARAMETERS[self.family].upper

    def of(self, vector: Float[np.ndarray, "10 ..."]) -> Any:
        """Its number in a vector, its row in a matrix."""
        return vector[self.entries[0]]


def named_free(free: Iterable[str] | str | None) -> tuple[str, ...]:
    """Names of look parameters to fit, checked; None means all of them.

    Raises:
        InputError: a name that is not in `PARAMETERS`, or none at all.
    """
    if free is None:
        return tuple(PARAMETERS)
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if name not in PARAMETERS:
            raise InputError(f"free: {name!r} is no look parameter; choose from {list(PARAMETERS)}")
    if not names:
        raise InputError(f"free: names nothing to fit; choose from {list(PARAMETERS)}")
    return names


def reported(look: Look) -> tuple[FreeParameter, ...]:
    """Every number a result reports, in `PARAMETERS`' order; per channel where the look is."""
    first = {"brightness": 0, "shadow": 1, "tint": 4, "background": 7}
    parameters: list[FreeParameter] = []
    for family, start in first.items():
        if family == "brightness":
            parameters.append(FreeParameter(family, family, (start,)))
        elif np.shape(getattr(look, family)) == ():
            parameters.append(FreeParameter(family, family, (start, start + 1, start + 2)))
        else:
            parameters += [
                FreeParameter(f"{family}.{channel}", family, (start + k,))
                for k, channel in enumerate(CHANNELS)
            ]
    return tuple(parameters)


def to_vector(look: Look) -> LookVector:
    """The ten numbers of a look, float64."""
    vector = np.empty(10)
    vector[BRIGHTNESS] = np.asarray(look.brightness)
    vector[SHADOW] = np.asarray(look.shadow)
    vector[TINT] = np.asarray(look.tint)
    vector[BACKGROUND] = np.asarray(look.background)
    return vector


def to_look(vector: LookVector, like: Look) -> Look:
    """The look of a vector, with one number or three as in `like`."""

    def part(values: np.ndarray, old: Any) -> Any:
        return values.copy() if np.shape(old) else values[0]

    return Look(
        brightness=vector[BRIGHTNESS],
        shadow=part(vector[SHADOW], like.shadow),
        tint=vector[TINT].copy(),
        background=part(vector[BACKGROUND], like.background),
    )


def settle_tint(vector: LookVector, free: Sequence[FreeParameter]) -> LookVector:
    """The vector with its free tints multiplied so that the mean of all three is 1."""
    moved = [p.entries[0] for p in free if p.family == "tint"]
    if not moved:
        return vector
    settled = vector.copy()
    rest = 3.0 - (vector[TINT].sum() - vector[moved].sum())
    total = vector[moved].sum()
    settled[moved] = vector[moved] * (rest / total) if total > 0 else rest / len(moved)
    return settled


def directions(
    free: Sequence[FreeParameter],
) -> tuple[Float[np.ndarray, "10 p"], list[tuple[FreeParameter, ...]]]:
    """Columns along which a fit moves the vector, told-first ones first.

    Returns:
        The columns, and for each the parameters it moves (all free tints, or one parameter).
    """
    columns: list[np.ndarray] = []
    moved: list[tuple[FreeParameter, ...]] = []
    for family in _ORDER:
        members = [p for p in free if p.family == family]
        unit = np.zeros((10, len(members)))
        for column, parameter in enumerate(members):
            unit[list(parameter.entries), column] = 1.0
        if family == "tint" and members:
            unit = unit @ _mean_free(len(members))
            moved += [tuple(members)] * unit.shape[1]
        else:
            moved += [(member,) for member in members]
        columns.append(unit)
    return np.concatenate(columns, axis=1), moved


def _mean_free(n: int) -> Float[np.ndarray, "n m"]:
    """Orthonormal basis of the n - 1 directions that keep a sum of n numbers (Helmert)."""
    basis = np.zeros((n, n - 1))
    for k in range(1, n):
        basis[:k, k - 1], basis[k, k - 1] = 1.0, -float(k)
        basis[:, k - 1] /= np.sqrt(k * (k + 1.0))
    return basis
