"""The command line's `NAME=…` options: one assignment to an option, given again for the next.

    --start gamma=1.2   --bounds exposure=:2   --prior gamma=1:0.05   --tie gamma.2=gamma.1

Their form is checked here; which parameters a look has and which values are possible is
`declare`'s. Paths and tone curves are checked here too.
"""

import math
import re
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from model_jax._errors import InputError, shown

from .._choices import AUTO

T = TypeVar("T")


def without_blur(terms: str | None) -> tuple[str | None, bool]:
    """The terms of a look, if there are any, and whether the camera's blur was among them."""
    if terms is None:
        return None, False
    names = [term.strip() for term in terms.split(",")]
    rest = [name for name in names if name != "blur"]
    return ",".join(rest) if rest else None, len(rest) < len(names)


def look_of(look: str | None, terms: str | None) -> str | None:
    """A look's name with its terms, as `find_look` takes it: air+density."""
    terms, blurs = without_blur(terms)
    if blurs:
        raise InputError("--terms: blur is the camera's, no look's, and goes with fit only")
    if terms is None:
        return look
    if look == AUTO:
        raise InputError("--terms: --look auto chooses them; name another look, or leave them out")
    if look is None or look.endswith(".py"):
        raise InputError("--terms: goes with --look and a look that has terms, such as --look air")
    return "+".join([look, *(term.strip() for term in terms.split(","))])


def starts(texts: Sequence[str]) -> dict[str, float]:
    """NAME=VALUE: finite start values."""
    return _each("--start", "NAME=VALUE, such as gamma=1.2", texts, _finite)


def bounds(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """NAME=LOW:HIGH; an end left out is open."""

    def limits(text: str) -> tuple[float, float]:
        low, high = _two(text)
        return (
            _not_nan(low) if low else -math.inf,
            _not_nan(high) if high else math.inf,
        )

    return _each("--bounds", "NAME=LOW:HIGH, such as gamma=0.5:2 or exposure=:2", texts, limits)


def priors(texts: Sequence[str]) -> dict[str, tuple[float, float]]:
    """NAME=MEAN:SIGMA of a normal distribution."""

    def normal(text: str) -> tuple[float, float]:
        mean, sigma = _two(text)
        return _finite(mean), _finite(sigma)

    return _each("--prior", "NAME=MEAN:SIGMA, such as gamma=1:0.05", texts, normal)


def ties(texts: Sequence[str]) -> dict[str, str]:
    """NAME=OTHER: the name that it equals."""
    found = _each("--tie", "NAME=OTHER, such as gamma.2=gamma.1", texts, _name)
    for name, other in found.items():
        _check_name(f"--tie {name}={other}", other)
    return found


def names(text: str | None) -> tuple[str, ...] | None:
    """Comma-separated names; None stays None."""
    if text is None:
        return None
    found = tuple(name.strip() for name in text.split(","))
    for name in found:
        _check_name(f"--free {text}", name)
    return found


def check_paths(paths: list[str], layers: str | None) -> None:
    """SCENE PHOTO pairs, or one PHOTO for layers."""
    if layers is not None and len(paths) != 1:
        raise InputError(
            f"fit: got {len(paths)} paths with --layers; give --layers LAYERS.exr PHOTO"
        )
    if layers is None and (len(paths) % 2 or not paths):
        raise InputError(
            f"fit: got {len(paths)} paths; give SCENE PHOTO, for several photos "
            "SCENE1 PHOTO1 SCENE2 PHOTO2, or --layers LAYERS.exr PHOTO"
        )


def tone_curve(text: str | None) -> Any:
    """The option's text in the form that scene files use; `InputError` for anything else."""
    if text in (None, "linear", "srgb"):
        return text
    try:
        exposure, gamma = (float(number) for number in str(text).split(","))
    except ValueError:
        raise InputError(f"--tone-curve {text}: must be linear, srgb or EXPOSURE,GAMMA") from None
    return {"exposure": exposure, "gamma": gamma}


def _each(option: str, form: str, texts: Sequence[str], read: Callable[[str], T]) -> dict[str, T]:
    found: dict[str, T] = {}
    for text in texts:
        name, equals, rest = (part.strip() for part in text.partition("="))
        try:
            if not (name and equals):
                raise ValueError
            value = read(rest)
        except ValueError:
            raise InputError(f"{option} {text}: must be {form}, with finite numbers") from None
        _check_name(f"{option} {text}", name)
        if name in found:
            raise InputError(f"{option} {text}: {name} is given twice; leave one of them away")
        found[name] = value
    return found


def _check_name(given: str, name: str) -> None:
    if not re.fullmatch(r"[A-Za-z]\w*(\.\w+)?", name):
        raise InputError(
            f"{given}: {shown(name)} is no parameter's name; `airlight looks` has them"
        )


def _two(text: str) -> tuple[str, str]:
    first, colon, second = (part.strip() for part in text.partition(":"))
    if not colon:
        raise ValueError
    return first, second


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError
    return value


def _not_nan(text: str) -> float:
    value = float(text)
    if math.isnan(value):
        raise ValueError
    return value


def _name(text: str) -> str:
    if not text:
        raise ValueError
    return text
