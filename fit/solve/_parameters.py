"""The parameters of a fit as records, and the vector of entries that the model computes with.

One `FitParameter` record stands for each number that a result reports (`_declare`): of the look
(brightness, shadow, tint.r …) and of each photo's response (exposure, gamma, black_level, with
several photos exposure.1, exposure.2 …). Below it all is one vector of *entries*: ten of the look
(a weight or a level that the look gives as one number stands there three times), then three for
each photo. A fit moves entries along *directions*, one column for each degree of freedom: a shared
number moves its entries together, tied parameters move together, and free tints keep their sum.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from model_jax import PARAMETERS, RESPONSE_PARAMETERS, Look, Parameter, Response

from ._bijections import from_tints, from_value, inside, mean_free

LOOK_ENTRIES = 10
RESPONSE_ENTRIES = 3
"""Numbers of the look and of each photo's response in the vector: exposure, gamma, black level."""
BRIGHTNESS, SHADOW, TINT, BACKGROUND = 0, slice(1, 4), slice(4, 7), slice(7, 10)

FAMILIES: dict[str, Parameter] = PARAMETERS | RESPONSE_PARAMETERS
"""Every field of `Look` and `Response`."""

Entries = Float[np.ndarray, " e"]

_ORDER = ("brightness", "tint", "shadow", "background", "exposure", "gamma", "black_level")
"""Who is told first: when two act alike in the pixels used, the later one is held."""


@dataclass(frozen=True)
class Prior:
    """What was known before the photo: a normal distribution."""

    mean: float
    sigma: float


@dataclass(frozen=True)
class FitParameter:
    """One number of a fit."""

    name: str
    """As in reports: brightness, tint.g, shadow, exposure.2 …"""
    family: str
    """Its field in `Look` or `Response`, a key of `FAMILIES`."""
    entries: tuple[int, ...]
    """Where it stands in the vector; all entries are equal."""
    value: float
    """Start value."""
    unit: str
    lower: float
    upper: float
    """Closed range of allowed values; infinite where there is no bound."""
    scale: float
    """Typical size, where the start does not tell it."""
    meaning: str
    role: Literal["free", "fixed", "tied"]
    tied_to: str | None = None
    """The parameter it equals."""
    prior: Prior | None = None

    def of(self, vector: Float[np.ndarray, "e ..."]) -> Any:
        """Its number in a vector, its row in a matrix."""
        return vector[self.entries[0]]


def to_entries(parameters: Sequence[FitParameter]) -> Entries:
    """The vector of the start values."""
    vector = np.zeros(1 + max(entry for p in parameters for entry in p.entries))
    for p in parameters:
        vector[list(p.entries)] = p.value
    return vector


def to_look(vector: Entries, like: Look) -> Look:
    """The look of a vector, with one number or three as in `like`."""

    def part(values: np.ndarray, old: Any) -> Any:
        return values.copy() if np.shape(old) else values[0]

    return Look(
        brightness=vector[BRIGHTNESS],
        shadow=part(vector[SHADOW], like.shadow),
        tint=vector[TINT].copy(),
        background=part(vector[BACKGROUND], like.background),
    )


def to_responses(vector: Entries) -> tuple[Response, ...]:
    """The response of each photo."""
    rows = vector[LOOK_ENTRIES:].reshape(-1, RESPONSE_ENTRIES)
    return tuple(Response(*row) for row in rows)


def followers(
    parameter: FitParameter, parameters: Sequence[FitParameter]
) -> tuple[FitParameter, ...]:
    """The parameter itself and all that are tied to it."""
    tied = [p for p in parameters if p.tied_to == parameter.name]
    return (parameter, *tied)


def settle_tint(
    vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Entries:
    """The vector with its free tints multiplied so that the mean of all three is 1."""
    moved = np.flatnonzero(_tint_members(free, parameters)) + TINT.start
    if not len(moved):
        return vector
    settled = vector.copy()
    rest = 3.0 - (vector[TINT].sum() - vector[moved].sum())
    total = vector[moved].sum()
    settled[moved] = vector[moved] * (rest / total) if total > 0 else rest / len(moved)
    return settled


def free_directions(
    free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> tuple[Float[np.ndarray, "e p"], list[tuple[FitParameter, ...]]]:
    """Columns along which a fit moves the vector, told-first ones first.

    Returns:
        The columns, and for each the free parameters it moves (all free tints, or one parameter).
    """
    size = 1 + max(entry for p in parameters for entry in p.entries)
    columns: list[np.ndarray] = [np.zeros((size, 0))]
    moved: list[tuple[FitParameter, ...]] = []
    for family in _ORDER:
        members = [p for p in free if p.family == family]
        if family == "tint":
            unit = np.zeros((size, 0))
            if members:
                basis = _tint_basis(free, parameters)
                unit = np.zeros((size, basis.shape[1]))
                unit[TINT] = basis
            moved += [tuple(members)] * unit.shape[1]
        else:
            unit = np.zeros((size, len(members)))
            for column, parameter in enumerate(members):
                for p in followers(parameter, parameters):
                    unit[list(p.entries), column] = 1.0
            moved += [(member,) for member in members]
        columns.append(unit)
    return np.concatenate(columns, axis=1), moved


@dataclass(frozen=True)
class Chart:
    """Unbounded coordinates for the free parameters: a solver's map of the allowed values."""

    base: Entries
    """The vector where nothing is free; 0 where something is."""
    matrix: Float[np.ndarray, "e q"]
    """Value of a parameter other than tint → its entries."""
    lower: Float[np.ndarray, " q"]
    upper: Float[np.ndarray, " q"]
    scale: Float[np.ndarray, " q"]
    basis: Float[np.ndarray, "3 m"]
    """Log-ratio coordinates of the free tints."""
    tint_total: float
    start: Float[np.ndarray, " p"]
    """Coordinates of the start: the q values, then the m tints."""


def chart(
    vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Chart:
    """Coordinates around a vector; what lies on or outside a bound starts a little inside."""
    plain = [p for p in free if p.family != "tint"]
    matrix = np.zeros((len(vector), len(plain)))
    for column, parameter in enumerate(plain):
        for p in followers(parameter, parameters):
            matrix[list(p.entries), column] = 1.0
    lower = np.array([p.lower for p in plain])
    upper = np.array([p.upper for p in plain])
    values = np.array([float(p.of(vector)) for p in plain])
    anchor = np.where(np.isfinite(lower), lower, np.where(np.isfinite(upper), upper, 0.0))
    distance = np.abs(values - anchor)
    typical = np.array([p.scale for p in plain])
    scale = np.where(distance > 0, distance, typical)
    basis = _tint_basis(free, parameters)
    members = _tint_members(free, parameters) & bool(basis.shape[1])  # a single tint cannot move
    base = np.where(matrix.any(axis=1), 0.0, vector)
    tints = vector[TINT]
    tint_total = float(tints[members].sum())
    base[TINT] = np.where(members, 0.0, base[TINT])
    # A share of nothing has no logarithm.
    tints = np.where(members, np.maximum(tints, 1e-6 * (tint_total or 3.0)), tints)
    start = from_value(inside(values, lower, upper, scale), lower, upper, scale)
    return Chart(
        base=base,
        matrix=matrix,
        lower=lower,
        upper=upper,
        scale=scale,
        basis=basis,
        tint_total=tint_total or float(members.sum()),
        start=np.concatenate([start, from_tints(tints, basis)]),
    )


def is_outside(vector: Entries, free: Sequence[FitParameter]) -> bool:
    """Some free parameter has left its range."""
    return any(not p.lower <= p.of(vector) <= p.upper for p in free)


def _tint_members(free: Sequence[FitParameter], parameters: Sequence[FitParameter]) -> np.ndarray:
    """Which of the three tints move."""
    members = np.zeros(3, dtype=bool)
    for parameter in free:
        if parameter.family == "tint":
            for p in followers(parameter, parameters):
                members[p.entries[0] - TINT.start] = True
    return members


def _tint_basis(
    free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Float[np.ndarray, "3 m"]:
    """Orthonormal directions that keep the tints' sum, and tied ones equal."""
    members = _tint_members(free, parameters)
    basis = mean_free(members.tolist())
    for master in free:
        for p in followers(master, parameters)[1:] if master.family == "tint" else ():
            if not basis.shape[1]:
                break
            difference = basis[p.entries[0] - TINT.start] - basis[master.entries[0] - TINT.start]
            _, _, rows = np.linalg.svd(difference[None])
            basis = basis @ rows[1:].T
    return basis
