"""fit.json, read again: the numbers of a fit by what they are, for exports."""

import json
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from model_jax._errors import InputError, shown
from model_jax._parameter import PARAMETERS, RESPONSE_PARAMETERS
from render_gl._files import PathLike, check_file

from .._choices import CHANNELS
from .._verdict import VERDICTS, Verdict

SCHEMA = 2
"""Form of the fit.json that this version writes and reads."""

PATHS = {
    "depth": "Widths of air are differences of eye depth, as in the paper.",
    "distance": "Widths of air are lengths along the ray: eye depths times 1 / cos of its angle.",
}
"""What `atmosphere.path` means for a shader."""

ROLES = ("free", "at_bound", "held", "fixed", "tied")
"""What a parameter can be to a fit."""

USABLE = (Verdict.CONVERGED.label, Verdict.AT_BOUND.label)
"""Verdicts whose values are the best that the photo has to say."""


@dataclass(frozen=True)
class Number:
    """One number of a fit."""

    name: str
    """As in fit.json: brightness, tint.r, exposure.2 …"""
    value: float
    """Finite."""
    stderr: float | None
    """One standard deviation; None where the photo did not tell the value."""
    initial: float | None
    free: bool
    role: str
    """free, at_bound, held, fixed or tied; "" for what is no parameter of the fit."""
    tied_to: str | None
    unit: str
    meaning: str


@dataclass(frozen=True)
class Fitted:
    """What a fit.json says that other programs may want."""

    path: str
    """The fit.json, as it was named."""
    verdict: str
    """A `Verdict`'s label."""
    sources: tuple[tuple[str, str | None], ...]
    """Each photo, with its scene file or layer file."""
    explained: float | None
    """Share of the light's variance that the model explains."""
    numbers: tuple[Number, ...]
    """All parameters: of the look, then of the response photo by photo."""
    scene: tuple[Number, ...]
    """What the look refers to, as far as the file has it: width_unit, brightness_per_length,
    color.r … color.a, planet_radius, atmosphere_height."""
    atmosphere_path: str | None
    """How widths are measured, a key of `PATHS`."""
    warnings: tuple[str, ...]
    """What makes the numbers less certain than they look, as the fit said."""

    @property
    def warning(self) -> str | None:
        """One line on why the numbers are not the best fit; None when they are."""
        if self.verdict in USABLE:
            return None
        sentence, remedy = explain(self.verdict)
        told = f"{sentence[0].lower()}{sentence[1:]}; {remedy}"
        return f"{self.path}: verdict {self.verdict}: {told}"


def read_fit(path: PathLike) -> Fitted:
    """Read a fit.json of this version's schema.

    Raises `InputError`, naming file, entry and remedy: no such file, no JSON, no fit.json or one of
    another schema, a fit that had no data, an unknown parameter or verdict, a look that is
    incomplete or not finite.
    """
    file = check_file(path)
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        what = str(error) or type(error).__name__
        raise InputError(f"{path}: is no JSON file ({what}); name a fit.json") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check the disk") from None
    try:
        return _fitted(os.fspath(path), document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


# --- reading ------------------------------------------------------------------------------------


def _fitted(path: str, document: Any) -> Fitted:
    if not isinstance(document, dict) or not isinstance(document.get("parameters"), dict):
        raise InputError("has no table `parameters`; name a fit.json, as `airlight fit` writes it")
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"schema is {shown(document.get('schema'))}, and this version reads {SCHEMA}; run the "
            "fit again"
        )
    verdict = document.get("verdict")
    if verdict not in [known.label for known in VERDICTS]:
        raise InputError(f"verdict is {shown(verdict)}, which is none; run the fit again")
    if verdict == Verdict.NO_DATA.label:
        sentence, remedy = explain(verdict)
        raise InputError(
            f"the verdict is no_data ({sentence.lower()}), its values are the start's; {remedy}, "
            "and fit again"
        )
    numbers = {name: _number(name, entry) for name, entry in document["parameters"].items()}
    _check_look({name: number.value for name, number in numbers.items()})
    warnings = document["warnings"] if isinstance(document.get("warnings"), list) else []
    warnings = [*warnings, *_other_scenes(document)]
    return Fitted(
        path=path,
        verdict=verdict,
        sources=tuple(_sources(document)),
        explained=_finite(document.get("explained")),
        numbers=tuple(sorted(numbers.values(), key=_rank)),
        scene=tuple(_scene(document)),
        atmosphere_path=next((p for p in PATHS if p == document.get("atmosphere_path")), None),
        warnings=tuple(text for text in warnings if isinstance(text, str)),
    )


def _number(name: str, entry: Any) -> Number:
    """One entry of `parameters`."""
    about = _known(name)
    if about is None:
        raise InputError(f"parameters: {shown(name)} is no parameter; run the fit again")
    if not isinstance(entry, dict) or "value" not in entry:
        raise InputError(f"parameters: {name} has no value; run the fit again")
    value = _finite(entry["value"])
    if value is None:
        raise InputError(
            f"parameters: {name} is {entry['value']!r}, not a finite number; run the fit again"
        )
    role = entry.get("role")
    if role not in ROLES:
        raise InputError(
            f"parameters: {name} has the role {shown(role)}, which is none of {', '.join(ROLES)}; "
            "run the fit again"
        )
    return Number(
        name=name,
        value=value,
        stderr=_finite(entry.get("stderr")),
        initial=_finite(entry.get("initial")),
        free=entry.get("free") is True,
        role=role,
        tied_to=None if entry.get("tied_to") is None else str(entry["tied_to"]),
        unit=about.unit,
        meaning=about.meaning,
    )


def _check_look(values: dict[str, float]) -> None:
    """Raise `InputError` unless the values hold a look that `Look` would take."""
    for family, about in PARAMETERS.items():
        channels = [f"{family}.{channel}" for channel in CHANNELS]
        there = [name for name in (family, *channels) if name in values]
        if there not in ([family], channels):
            state = f"has {' and '.join(there)} only" if there else f"has no {family}"
            if family in there:
                state = f"has {family} as one number and per channel"
            raise InputError(f"parameters: {state}; run the fit again")
        if there != {"brightness": [family], "tint": channels}.get(family, there):
            raise InputError(
                "parameters: brightness must be one number, and tint three; run the fit again"
            )
        for name in there:
            if values[name] < about.lower:
                raise InputError(
                    f"look.{family}: {shown(values[name])} must be at least {about.lower:g}; run "
                    "the fit again"
                )


def _photos(document: dict[str, Any]) -> list[dict[str, Any]]:
    """What it says of each photo."""
    photos = document.get("photos")
    return [p for p in photos if isinstance(p, dict)] if isinstance(photos, list) else []


def _sources(document: dict[str, Any]) -> Iterator[tuple[str, str | None]]:
    """Photos by their names, with their scenes or layers."""
    for photo in _photos(document):
        scene = photo.get("scene") or document.get("layers")
        yield str(photo.get("photo") or "unnamed"), None if scene is None else str(scene)


def _scene(document: dict[str, Any]) -> Iterator[Number]:
    """Lengths and the air's colour; a fit to a layer file knows less."""
    found: dict[str, tuple[Any, str, str]] = {
        name: (document.get(name), unit, meaning)
        for name, unit, meaning in (
            ("width_unit", "scene length", "far - near of the fit, which brightness refers to"),
            ("brightness_per_length", "1/scene length", "brightness / width_unit"),
            ("planet_radius", "scene length", "of the planet without its air"),
            ("atmosphere_height", "scene length", "of the shell of air above the planet"),
        )
    }
    color = document.get("color")
    for k, channel in enumerate("rgba"):
        value = color[k] if isinstance(color, list) and len(color) == 4 else None
        meaning = (
            "coverage where there is air" if channel == "a" else "of the air, which tint multiplies"
        )
        found[f"color.{channel}"] = (value, "linear light" if channel != "a" else "1", meaning)
    for name, (value, unit, meaning) in found.items():
        if (number := _finite(value)) is not None:
            yield Number(name, number, None, None, False, "", None, unit, meaning)


def _other_scenes(document: dict[str, Any]) -> Iterator[str]:
    """What is of the first photo's scene only, of several photos."""
    first, *others = _photos(document) or [{}]
    keys = ("color", "planet_radius", "atmosphere_height", "atmosphere_path", "width_unit")
    for number, photo in enumerate(others, 2):
        if differing := [key for key in keys if photo.get(key) != first.get(key)]:
            yield f"Of photo 1 only: {', '.join(differing)}. Photo {number}'s scene has others."


def _finite(value: Any) -> float | None:
    """A JSON number as float; None for what is no finite number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None


def _rank(number: Number) -> tuple[int, int, int, int]:
    """Look first, in its own order, then photo by photo the response."""
    family, _, ending = number.name.partition(".")
    if family in PARAMETERS:
        channel = CHANNELS.index(ending) if ending in CHANNELS else -1
        return (0, 0, list(PARAMETERS).index(family), channel)
    return (1, int(ending or 1), list(RESPONSE_PARAMETERS).index(family), -1)


def _known(name: str) -> Any:
    """The entry of `PARAMETERS` or `RESPONSE_PARAMETERS` that a name belongs to, or None."""
    family, dot, ending = name.partition(".")
    if family in PARAMETERS and (not dot or ending in CHANNELS):
        return PARAMETERS[family]
    if family in RESPONSE_PARAMETERS and (not dot or re.fullmatch("[1-9][0-9]{0,8}", ending)):
        return RESPONSE_PARAMETERS[family]
    return None


def of_kind(fitted: Fitted, kind: str) -> tuple[Number, ...]:
    """The numbers that are of the "look" or the "response"."""
    wanted = ("look", "response").index(kind)
    return tuple(number for number in fitted.numbers if _rank(number)[0] == wanted)


def explain(verdict: str) -> tuple[str, str]:
    """Sentence and remedy of a verdict's label."""
    return next(texts for known, texts in VERDICTS.items() if known.label == verdict)


def of_family(fitted: Fitted, family: str) -> tuple[Number, ...]:
    """The one number of a look's field, or its three; a vec3 of one number is GLSL's own form."""
    return tuple(n for n in of_kind(fitted, "look") if n.name.partition(".")[0] == family)


def quoted(text: str) -> str:
    """In quotes, ASCII, on one line, and never ending in a backslash."""
    return json.dumps(text).replace("\x7f", "\\u007f")  # TOML forbids it, JSON does not
