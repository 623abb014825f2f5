"""From what a caller asks to `FitParameter` records: what is free, bounded, tied, known before."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from model_jax import InputError, Look, Response
from model_jax._errors import shown

from .._choices import CHANNELS
from ._layout import Layout
from ._parameters import FitParameter, Prior

NARROWEST = 1e-100
"""Least standard deviation of a prior: the square of float32 light over it is in float64's range,
(3.4e38 / 1e-100)² < 1.8e308."""


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
) -> tuple[FitParameter, ...]:
    """Records of all parameters, checked.

    What starts at its `least` or above, and has no bounds of its own, stays there.

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
    blurs = blurs_of(responses)
    names = default_free(type(look), len(responses), blurs) if free is None else free
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


def blurs_of(responses: Sequence[Response]) -> bool:
    """Whether the photos have a blur. Raises `InputError` if only some have."""
    found = {response.blur is not None for response in responses}
    if len(found) > 1:
        raise InputError("response: some photos have a blur, some none; give one to all or to none")
    return True in found


def default_free(kind: type[Look], photos: int, blurs: bool = False) -> tuple[str, ...]:
    """What is fitted when nobody says: the look; with several photos levels and exposures too; and
    blurs, if there are any.

    Exposures are relative to the first photo's, and each photo's level is its own.
    """
    blur = ("blur",) if blurs else ()
    if photos == 1:
        return (*kind.PARAMETERS, *blur)
    exposures = [f"exposure.{k}" for k in range(2, photos + 1)]
    own = [name for name in kind.PARAMETERS if name not in Look.PARAMETERS]
    return (*own, "black_level", *exposures, *blur)


def _unchanged(look: Look, responses: Sequence[Response]) -> list[FitParameter]:
    """All parameters, fixed, with the meaning that the look and the response give them."""
    found: list[FitParameter] = []
    layout = Layout(type(look), blurs_of(responses))
    # What hangs on a field is told after what does not, and the frame's own last.
    ordered = sorted(
        layout.kind.PARAMETERS,
        key=lambda name: (name in Look.PARAMETERS, layout.kind.PARAMETERS[name].of is not None),
    )
    orders = {name: k for k, name in enumerate([*ordered, *layout.response])}

    def add(name: str, family: str, entries: tuple[int, ...], value: Any) -> None:
        about = layout.families[family]
        found.append(
            FitParameter(
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
                order=orders[family],
                mean_one=about.mean_one,
                needs=about.of,
                least=about.least if value >= about.least else -math.inf,
            )
        )

    for family, part in layout.slices.items():
        value = getattr(look, family)
        entries = tuple(range(part.start, part.stop))
        if np.shape(value) == ():
            add(family, family, entries, value)
        else:
            table = isinstance(layout.kind.PARAMETERS[family].shape, int)
            endings = [str(k + 1) for k in range(len(entries))] if table else CHANNELS
            for entry, ending, number in zip(entries, endings, value, strict=True):
                add(f"{family}.{ending}", family, (entry,), number)
    for number, response in enumerate(responses):
        ending = f".{number + 1}" if len(responses) > 1 else ""
        for k, family in enumerate(layout.response):
            entry = layout.size + len(layout.response) * number + k
            add(family + ending, family, (entry,), getattr(response, family))
    return found


def _expand(
    what: str, names: Iterable[Any] | str, parameters: Mapping[str, FitParameter]
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


def _choices(parameters: Mapping[str, FitParameter]) -> list[str]:
    return list(dict.fromkeys([*(p.family for p in parameters.values()), *parameters]))


def _bounded(p: FitParameter, lower: float, upper: float) -> FitParameter:
    low, high = max(float(lower), p.lower), min(float(upper), p.upper)
    if not lower < upper or not low < high:  # NaN compares false
        raise InputError(
            f"bounds: {p.name} from {lower:g} to {upper:g} leaves no room in its range "
            f"{p.lower:g} to {p.upper:g}; give a lower bound below the upper one, inside the range"
        )
    return replace(p, lower=low, upper=high, least=-math.inf)


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


def _tie(parameters: dict[str, FitParameter], tied: Mapping[str, str]) -> None:
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
            least=master.least,
        )
