"""The parameters of a fit as records, and the vector of entries that the model computes with.

`declare` makes one `Parameter` record for each number that a result reports: of the look
(brightness, shadow, tint.r …) and of each photo's response (exposure, gamma, black_level, with
several photos exposure.1, exposure.2 …). Below it all is one vector of *entries*: ten of the look
(a weight or a level that the look gives as one number stands there three times), then three for
each photo. A fit moves entries along *directions*, one column for each degree of freedom: a shared
number moves its entries together, tied parameters move together, and free tints keep their sum.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float

from model_jax import PARAMETERS, RESPONSE_PARAMETERS, InputError, Look, Response
from model_jax import Parameter as Meaning
from model_jax._errors import shown

from ._bijections import from_tints, from_value, inside, mean_free

CHANNELS = ("r", "g", "b")
LOOK_ENTRIES = 10
RESPONSE_ENTRIES = 3
BRIGHTNESS, SHADOW, TINT, BACKGROUND = 0, slice(1, 4), slice(4, 7), slice(7, 10)

FAMILIES: dict[str, Meaning] = PARAMETERS | RESPONSE_PARAMETERS
"""Every field of `Look` and `Response`."""

Entries = Float[np.ndarray, " e"]

NARROWEST = 1e-100
"""Least standard deviation of a prior: the square of float32 light over it is in float64's range,
(3.4e38 / 1e-100)² < 1.8e308."""

_ORDER = ("brightness", "tint", "shadow", "background", "exposure", "gamma", "black_level")
"""Who is told first: when two act alike in the pixels used, the later one is held."""


@dataclass(frozen=True)
class Prior:
    """What was known before the photo: a normal distribution."""

    mean: float
    sigma: float


@dataclass(frozen=True)
class Parameter:
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


def pairs(what: str, form: str, given: Any) -> dict[str, tuple[float, float]]:
    """Bounds or priors, once they are what `declare` takes: name → two numbers; {} for None.

    Raises:
        InputError: anything else, with the `form` to give.
    """
    found = {}
    for name, value in _items(what, f"a dict of name → {form}", given):
        try:
            if isinstance(value, str):
                raise TypeError
            first, second = map(float, value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"{what}: {name} has {shown(value)}; give two numbers, {form}"
            ) from None
        found[name] = (first, second)
    return found


def links(given: Any) -> dict[str, str]:
    """Ties, once they are name → name; {} for None. Raises `InputError` for anything else."""
    found = dict(_items("tied", "a dict of name → name", given))
    for name, other in found.items():
        if not isinstance(other, str):
            raise InputError(
                f"tied: {name} is tied to {shown(other)}; give the name it shall equal"
            )
    return found


def _items(what: str, form: str, given: Any) -> list[tuple[str, Any]]:
    if given is None:
        return []
    if not isinstance(given, Mapping) or not all(isinstance(name, str) for name in given):
        raise InputError(f"{what}: is {shown(given)}; give {form}")
    return list(given.items())


def declare(
    look: Look,
    responses: Sequence[Response],
    *,
    free: Any = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    tied: Mapping[str, str] | None = None,
) -> tuple[Parameter, ...]:
    """Records of all parameters, checked.

    Args:
        free: names or families to fit; None means `default_free`.
        bounds: name or family → (lower, upper), inside the parameter's own range.
        priors: name or family → (mean, sigma).
        tied: name → the name it shall equal, of the same family; may form chains.

    Raises:
        InputError: an unknown name, nothing free, contradictory bounds, a prior without width, a
            circle of ties, a start that is not a number, bounds or a prior of what is held.
    """
    parameters = {p.name: p for p in _unchanged(look, responses)}
    names = default_free(len(responses)) if free is None else free
    if not isinstance(names, Iterable):
        raise InputError(f"free: is {shown(names)}; give names, such as {_choices(parameters)[:2]}")
    for name in _expand("free", names, parameters):
        parameters[name] = replace(parameters[name], role="free")
    for key, (lower, upper) in (bounds or {}).items():
        for name in _expand("bounds", key, parameters):
            parameters[name] = _bounded(parameters[name], lower, upper)
    for key, (mean, sigma) in (priors or {}).items():
        for name in _expand("prior", key, parameters):
            parameters[name] = replace(parameters[name], prior=_prior(name, mean, sigma))
    _tie(parameters, tied or {})
    for name in {n for key in bounds or {} for n in _expand("bounds", key, parameters)}:
        p = parameters[name]
        if p.role == "fixed" and not p.lower <= p.value <= p.upper:
            raise InputError(
                f"bounds: {name} is held at {p.value:g}, outside {p.lower:g} to {p.upper:g}; "
                "free it or change one of them"
            )
    for what, keys in (("bounds", bounds or {}), ("prior", priors or {})):
        for key in keys:
            members = [parameters[name] for name in _expand(what, key, parameters)]
            if any(p.role == "free" for p in members):
                continue
            if members[0].tied_to is not None:
                raise InputError(
                    f"{what}: {key} is tied to {members[0].tied_to}; give its {what} to that one"
                )
            values = ", ".join(dict.fromkeys(f"{p.value:g}" for p in members))
            raise InputError(
                f"{what}: {key} is held at {values} and not fitted, so its {what} would say "
                "nothing; add it to free, or leave that out"
            )
    if not any(p.role == "free" for p in parameters.values()):
        raise InputError(f"free: names nothing to fit; choose from {_choices(parameters)}")
    return tuple(parameters.values())


def default_free(photos: int) -> tuple[str, ...]:
    """What is fitted when nobody says: the look; with several photos levels and exposures too.

    Exposures are relative to the first photo's, and each photo's level is its own.
    """
    if photos == 1:
        return tuple(PARAMETERS)
    exposures = [f"exposure.{k}" for k in range(2, photos + 1)]
    return ("brightness", "shadow", "tint", "black_level", *exposures)


def to_entries(parameters: Sequence[Parameter]) -> Entries:
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


def followers(parameter: Parameter, parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
    """The parameter itself and all that are tied to it."""
    tied = [p for p in parameters if p.tied_to == parameter.name]
    return (parameter, *tied)


def settle_tint(
    vector: Entries, free: Sequence[Parameter], parameters: Sequence[Parameter]
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


def directions(
    free: Sequence[Parameter], parameters: Sequence[Parameter]
) -> tuple[Float[np.ndarray, "e p"], list[tuple[Parameter, ...]]]:
    """Columns along which a fit moves the vector, told-first ones first.

    Returns:
        The columns, and for each the free parameters it moves (all free tints, or one parameter).
    """
    size = 1 + max(entry for p in parameters for entry in p.entries)
    columns: list[np.ndarray] = [np.zeros((size, 0))]
    moved: list[tuple[Parameter, ...]] = []
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


def chart(vector: Entries, free: Sequence[Parameter], parameters: Sequence[Parameter]) -> Chart:
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


def is_outside(vector: Entries, free: Sequence[Parameter]) -> bool:
    """Some free parameter has left its range."""
    return any(not p.lower <= p.of(vector) <= p.upper for p in free)


def _unchanged(look: Look, responses: Sequence[Response]) -> list[Parameter]:
    """All parameters, fixed, with the meaning that the look and the response give them."""
    found: list[Parameter] = []

    def add(name: str, family: str, entries: tuple[int, ...], value: Any) -> None:
        about = FAMILIES[family]
        found.append(
            Parameter(
                name=name,
                family=family,
                entries=entries,
                value=float(value),
                unit=about.unit,
                lower=about.lower,
                upper=about.upper,
                scale=about.scale,
                meaning=about.meaning,
                role="fixed",
            )
        )

    for family, start in (("brightness", 0), ("shadow", 1), ("tint", 4), ("background", 7)):
        value = getattr(look, family)
        if family == "brightness":
            add(family, family, (start,), value)
        elif np.shape(value) == ():
            add(family, family, (start, start + 1, start + 2), value)
        else:
            for k, channel in enumerate(CHANNELS):
                add(f"{family}.{channel}", family, (start + k,), value[k])
    for number, response in enumerate(responses):
        ending = f".{number + 1}" if len(responses) > 1 else ""
        for k, family in enumerate(RESPONSE_PARAMETERS):
            entry = LOOK_ENTRIES + RESPONSE_ENTRIES * number + k
            add(family + ending, family, (entry,), getattr(response, family))
    return found


def _expand(
    what: str, names: Iterable[Any] | str, parameters: Mapping[str, Parameter]
) -> list[str]:
    """Full names: a family stands for all its members."""
    found: list[str] = []
    for name in (names,) if isinstance(names, str) else tuple(names):
        members = [p.name for p in parameters.values() if name in (p.name, p.family)]
        if not members:
            raise InputError(
                f"{what}: {shown(name)} is no parameter; choose from {_choices(parameters)}"
            )
        found += members
    return found


def _choices(parameters: Mapping[str, Parameter]) -> list[str]:
    return list(dict.fromkeys([*(p.family for p in parameters.values()), *parameters]))


def _bounded(p: Parameter, lower: float, upper: float) -> Parameter:
    low, high = max(float(lower), p.lower), min(float(upper), p.upper)
    if not lower < upper or not low < high:  # NaN compares false
        raise InputError(
            f"bounds: {p.name} from {lower:g} to {upper:g} leaves no room in its range "
            f"{p.lower:g} to {p.upper:g}; give a lower bound below the upper one, inside the range"
        )
    return replace(p, lower=low, upper=high)


def _prior(name: str, mean: float, sigma: float) -> Prior:
    if not np.isfinite(mean):
        raise InputError(f"prior: {name} has the mean {mean!r}; give a finite number")
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError(
            f"prior: {name} has the width {sigma!r}; give a standard deviation above 0, "
            "or hold the parameter at its start value"
        )
    if sigma < NARROWEST:
        raise InputError(
            f"prior: {name} has the width {sigma!r}, too small to reckon with; give {NARROWEST:g} "
            "or more, or hold the parameter at its start value"
        )
    return Prior(float(mean), float(sigma))


def _tie(parameters: dict[str, Parameter], tied: Mapping[str, str]) -> None:
    """Tied parameters get the record of the one they follow to the end of the chain."""
    for name, other in tied.items():
        for known in (name, other):
            if known not in parameters:
                raise InputError(
                    f"tied: {shown(known)} is no parameter; choose from {list(parameters)}"
                )
        if parameters[name].family != parameters[other].family:
            raise InputError(
                f"tied: {name} and {other} are different quantities; tie members of one family"
            )
    for name in tied:
        chain = [name]
        while chain[-1] in tied:
            chain.append(tied[chain[-1]])
            if chain[-1] in chain[:-1]:
                raise InputError(f"tied: {' → '.join(chain)} is a circle; leave one of them untied")
        master = parameters[chain[-1]]
        if parameters[name].prior is not None:
            raise InputError(f"tied: {name} has a prior of its own; give it to {master.name}")
        parameters[name] = replace(
            parameters[name],
            role="tied",
            tied_to=master.name,
            value=master.value,
            lower=master.lower,
            upper=master.upper,
        )


def _tint_members(free: Sequence[Parameter], parameters: Sequence[Parameter]) -> np.ndarray:
    """Which of the three tints move."""
    members = np.zeros(3, dtype=bool)
    for parameter in free:
        if parameter.family == "tint":
            for p in followers(parameter, parameters):
                members[p.entries[0] - TINT.start] = True
    return members


def _tint_basis(
    free: Sequence[Parameter], parameters: Sequence[Parameter]
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
