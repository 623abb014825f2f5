"""The parameters of a fit as records, and the vector of entries that the model computes with.

One `FitParameter` record stands for each number that a result reports (`_declare`): of the look
(as it declares them, colours as NAME.r, NAME.g, NAME.b) and of each photo's response (exposure,
gamma, black_level, with several photos exposure.1, exposure.2 …). Below it all is one vector of
*entries* (`_layout`): the look's (one number in place of a colour stands there three times), then
three for each photo, or four if it has a blur. A fit moves entries along *directions*, one column
for each degree of freedom: a shared number moves its entries together, tied parameters move
together, and free factors of mean one keep their sum.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from model_jax import Look, Response

from ._bijections import from_shares, from_value, inside, mean_free
from ._layout import Layout

Entries = Float[np.ndarray, " e"]


@dataclass(frozen=True)
class Prior:
    """What was known before the photo: a normal distribution."""

    mean: float
    sigma: float


@dataclass(frozen=True)
class FitParameter:
    """One number of a fit."""

    name: str
    """As in reports: its family, with an ending for a part of a colour or one of several photos."""
    family: str
    """Its field in the look or in `Response`."""
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
    order: int = 0
    """Who is told first: when two act alike in the pixels used, the later one is held."""
    mean_one: bool = False
    """One of three factors whose mean is kept at 1."""
    needs: str | None = None
    """The field without which it has no effect."""
    tied_to: str | None = None
    """The parameter it equals."""
    prior: Prior | None = None
    least: float = -math.inf
    """What a fit does not go below, though its range does: nobody asked for less."""

    @property
    def floor(self) -> float:
        """The least value that a fit ends at."""
        return max(self.lower, self.least)

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

    def part(value: Any, old: Any) -> Any:
        return np.array(value) if np.shape(old) else np.ravel(value)[0]

    kind = type(like)
    values = Layout(kind).values(vector)
    return kind(**{n: part(v, getattr(like, n)) for n, v in values.items()})


def to_responses(vector: Entries, layout: Layout) -> tuple[Response, ...]:
    """The response of each photo."""
    return tuple(Response(*row) for row in layout.responses(vector))


def followers(
    parameter: FitParameter, parameters: Sequence[FitParameter]
) -> tuple[FitParameter, ...]:
    """The parameter itself and all that are tied to it."""
    tied = [p for p in parameters if p.tied_to == parameter.name]
    return (parameter, *tied)


def shares_in(parameters: Sequence[FitParameter]) -> slice:
    """Entries of the factors of mean one; empty where the look has none."""
    entries = [e for p in parameters if p.mean_one for e in p.entries]
    return slice(min(entries), max(entries) + 1) if entries else slice(0, 0)


def settle_shares(
    vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Entries:
    """The vector with its free factors of mean one multiplied so that the mean of all is 1."""
    shares = shares_in(parameters)
    moved = np.flatnonzero(_members(free, parameters)) + shares.start
    if not len(moved):
        return vector
    settled = vector.copy()
    rest = 3.0 - (vector[shares].sum() - vector[moved].sum())
    total = vector[moved].sum()
    settled[moved] = vector[moved] * (rest / total) if total > 0 else rest / len(moved)
    return settled


def free_directions(
    free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> tuple[Float[np.ndarray, "e p"], list[tuple[FitParameter, ...]]]:
    """Columns along which a fit moves the vector, told-first ones first.

    Returns:
        The columns, and for each the free parameters it moves (all free factors of mean one, or
        one parameter).
    """
    size = 1 + max(entry for p in parameters for entry in p.entries)
    columns: list[np.ndarray] = [np.zeros((size, 0))]
    moved: list[tuple[FitParameter, ...]] = []
    for order in sorted({p.order for p in free}):
        members = [p for p in free if p.order == order]
        if members[0].mean_one:
            basis = shares_basis(free, parameters)
            unit = np.zeros((size, basis.shape[1]))
            unit[shares_in(parameters)] = basis
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
    """Value of a parameter that is no factor of mean one → its entries."""
    lower: Float[np.ndarray, " q"]
    upper: Float[np.ndarray, " q"]
    scale: Float[np.ndarray, " q"]
    basis: Float[np.ndarray, "n m"]
    """Log-ratio coordinates of the free factors of mean one."""
    shares: int
    """Their first entry."""
    total: float
    """Their sum."""
    start: Float[np.ndarray, " p"]
    """Coordinates of the start: the q values, then the m factors."""


def chart(
    vector: Entries, free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Chart:
    """Coordinates around a vector; what lies on or outside a bound starts a little inside."""
    plain = [p for p in free if not p.mean_one]
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
    basis = shares_basis(free, parameters)
    members = _members(free, parameters) & bool(basis.shape[1])  # a single factor cannot move
    base = np.where(matrix.any(axis=1), 0.0, vector)
    shares = shares_in(parameters)
    factors = vector[shares]
    total = float(factors[members].sum())
    base[shares] = np.where(members, 0.0, base[shares])
    # A share of nothing has no logarithm.
    factors = np.where(members, np.maximum(factors, 1e-6 * (total or 3.0)), factors)
    start = from_value(inside(values, lower, upper, scale), lower, upper, scale)
    return Chart(
        base=base,
        matrix=matrix,
        lower=lower,
        upper=upper,
        scale=scale,
        basis=basis,
        shares=shares.start,
        total=total or float(members.sum()),
        start=np.concatenate([start, from_shares(factors, basis)]),
    )


def at_least(p: FitParameter, vector: Entries) -> bool:
    """It stands where no light is taken away, and its range would go on: no fault of the fit."""
    return bool(p.of(vector) == p.least > p.lower)


def is_outside(vector: Entries, free: Sequence[FitParameter]) -> bool:
    """Some free parameter has left its range."""
    return any(not p.lower <= p.of(vector) <= p.upper for p in free)


def _members(free: Sequence[FitParameter], parameters: Sequence[FitParameter]) -> np.ndarray:
    """Which of the factors of mean one move."""
    shares = shares_in(parameters)
    members = np.zeros(shares.stop - shares.start, dtype=bool)
    for parameter in free:
        if parameter.mean_one:
            for p in followers(parameter, parameters):
                members[p.entries[0] - shares.start] = True
    return members


def shares_basis(
    free: Sequence[FitParameter], parameters: Sequence[FitParameter]
) -> Float[np.ndarray, "n m"]:
    """Orthonormal directions that keep the sum of the factors of mean one, and tied ones equal."""
    first = shares_in(parameters).start
    basis = mean_free(_members(free, parameters).tolist())
    for master in free:
        for p in followers(master, parameters)[1:] if master.mean_one else ():
            if not basis.shape[1]:
                break
            difference = basis[p.entries[0] - first] - basis[master.entries[0] - first]
            _, _, rows = np.linalg.svd(difference[None])
            basis = basis @ rows[1:].T
    return basis
