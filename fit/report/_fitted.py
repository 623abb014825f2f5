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

from .._verdict import VERDICTS, Verdict

CHANNELS = ("r", "g", "b")

PATHS = {
    "depth": "Widths of air are differences of eye depth, as in the paper.",
    "distance": "Widths of air are lengths along the ray: eye depths times 1 / cos of its angle.",
}
"""What `atmosphere.path` means for a shader."""

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
    """A `Verdict`'s label, or whatever the file has in its place."""
    sources: tuple[tuple[str, str | None], ...]
    """Each photo, with its scene file or layer file."""
    explained: float | None
    """Share of the light's variance that the model explains."""
    numbers: tuple[Number, ...]
    """All parameters: look, response photo by photo, and unknown ones by name."""
    scene: tuple[Number, ...]
    """What the look refers to, as far as the file has it: width_unit, brightness_per_length,
    color.r … color.a, planet_radius, atmosphere_height."""
    atmosphere_path: str | None
    """How widths are measured, a key of `PATHS`."""
    warnings: tuple[str, ...]
    """Of the fit."""

    @property
    def warning(self) -> str | None:
        """One line on why the numbers are not the best fit; None when they are."""
        if self.verdict in USABLE:
            return None
        sentence, remedy = explain(self.verdict)
        told = f"{sentence[0].lower()}{sentence[1:]}; {remedy}"
        return f"{self.path}: verdict {plain_key(self.verdict)}: {told}"


def read_fit(path: PathLike) -> Fitted:
    """Read a fit.json of any schema so far.

    Raises `InputError`, naming file, entry and remedy: no such file, no JSON, no fit.json, a fit
    that had no data, a look that is incomplete or not finite.
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
    verdict = str(document.get("verdict") or "unknown")
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
    """One entry of `parameters`; schema 1 has no role and no meaning."""
    if not isinstance(entry, dict) or "value" not in entry:
        raise InputError(f"parameters: {name} has no value; run the fit again")
    value = _finite(entry["value"])
    if value is None:
        raise InputError(
            f"parameters: {name} is {entry['value']!r}, not a finite number; run the fit again"
        )
    free = entry.get("free") is True
    about = _known(name)
    return Number(
        name=name,
        value=value,
        stderr=_finite(entry.get("stderr")),
        initial=_finite(entry.get("initial")),
        free=free,
        role=str(entry.get("role") or ("free" if free else "fixed")),
        tied_to=None if entry.get("tied_to") is None else str(entry["tied_to"]),
        unit=str(entry.get("unit") or (about.unit if about else "")),
        meaning=str(entry.get("meaning") or (about.meaning if about else "")),
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
    """What it says of each photo; schema 1 has no list of them."""
    photos = document.get("photos")
    return [p for p in photos if isinstance(p, dict)] if isinstance(photos, list) else []


def _sources(document: dict[str, Any]) -> Iterator[tuple[str, str | None]]:
    """Photos by their names; schema 1 names its one photo at the top only."""
    named = _photos(document)
    for photo in named if all("photo" in p for p in named) and named else [document]:
        scene = photo.get("scene") or document.get("layers")
        yield str(photo.get("photo") or "unnamed"), None if scene is None else str(scene)


def _scene(document: dict[str, Any]) -> Iterator[Number]:
    """Lengths and the air's colour; files of earlier versions have less."""
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


def _rank(number: Number) -> tuple[int, int, int, str, int]:
    """Look first, in its own order, then photo by photo the response, then the unknown by name."""
    family, _, ending = number.name.partition(".")
    known = [*PARAMETERS, *RESPONSE_PARAMETERS]
    channel = CHANNELS.index(ending) if ending in CHANNELS else -1
    if _known(number.name) is None:
        return (2, 0, 0, family, channel)
    if family in PARAMETERS:
        return (0, 0, known.index(family), "", channel)
    return (1, int(ending or 1), known.index(family), "", -1)


def _known(name: str) -> Any:
    """The entry of `PARAMETERS` or `RESPONSE_PARAMETERS` that a name belongs to, or None."""
    family, dot, ending = name.partition(".")
    if family in PARAMETERS and (not dot or ending in CHANNELS):
        return PARAMETERS[family]
    if family in RESPONSE_PARAMETERS and (not dot or re.fullmatch("[1-9][0-9]{0,8}", ending)):
        return RESPONSE_PARAMETERS[family]
    return None


def of_kind(fitted: Fitted, kind: str) -> tuple[Number, ...]:
    """The numbers that are "look", "response" or "unknown"."""
    wanted = ("look", "response", "unknown").index(kind)
    return tuple(number for number in fitted.numbers if _rank(number)[0] == wanted)


def explain(verdict: str) -> tuple[str, str]:
    """Sentence and remedy of a verdict's label."""
    for known, texts in VERDICTS.items():
        if known.label == verdict:
            return texts
    return "This version of airlight does not know that verdict", "run the fit again"


def of_family(fitted: Fitted, family: str) -> tuple[Number, ...]:
    """The one number of a look's field, or its three; a vec3 of one number is GLSL's own form."""
    return tuple(n for n in of_kind(fitted, "look") if n.name.partition(".")[0] == family)


def plain_key(name: str) -> str:
    """A name as it is, or quoted when it is no plain word."""
    return name if re.fullmatch("[A-Za-z0-9_.]+", name) else quoted(name)


def quoted(text: str) -> str:
    """In quotes, ASCII, on one line, and never ending in a backslash."""
    return json.dumps(text).replace("\x7f", "\\u007f")  # TOML forbids it, JSON does not
