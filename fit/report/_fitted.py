"""fit.json, read again: the numbers of a fit by what they are, for exports."""

import json
import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from model_jax._errors import InputError, shown
from model_jax._parameter import RESPONSE_PARAMETERS, Parameter, Shape
from render_gl._files import PathLike, check_file

from .._choices import CHANNELS
from .._verdict import VERDICTS, Verdict

SCHEMA = 3
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
    """As in fit.json: a parameter, one channel of a colour, one of several photos' …"""
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
    kind: str
    """Name of the look."""
    light: str
    """What it makes of the air, in a line."""
    shapes: dict[str, Shape]
    """Its parameters, in their order, and what each is."""
    explained: float | None
    """Share of the light's variance that the model explains."""
    numbers: tuple[Number, ...]
    """All parameters: of the look, then of the response photo by photo."""
    scene: tuple[Number, ...]
    """What the look refers to, as far as the file has it: width_unit, NAME_per_length of what is
    per width unit, color.r … color.a, planet_radius, atmosphere_height."""
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
    kind, light, shapes = _look(document.get("look"))
    entries = document["parameters"]
    numbers = {name: _number(name, entry, shapes) for name, entry in entries.items()}
    for family, shape in shapes.items():
        _check_family(family, shape, numbers, entries)
    warnings = document["warnings"] if isinstance(document.get("warnings"), list) else []
    warnings = [*warnings, *_other_scenes(document)]
    return Fitted(
        path=path,
        verdict=verdict,
        sources=tuple(_sources(document)),
        kind=kind,
        light=light,
        shapes=shapes,
        explained=_finite(document.get("explained")),
        numbers=tuple(sorted(numbers.values(), key=lambda number: _rank(number, shapes))),
        scene=tuple(_scene(document)),
        atmosphere_path=next((p for p in PATHS if p == document.get("atmosphere_path")), None),
        warnings=tuple(text for text in warnings if isinstance(text, str)),
    )


def _look(entry: Any) -> tuple[str, str, dict[str, Shape]]:
    """Name, line and parameters of the look."""
    again = "run the fit again"
    shapes = entry.get("shapes") if isinstance(entry, dict) else None
    if not isinstance(entry, dict) or not isinstance(shapes, dict) or not shapes:
        raise InputError(f"has no table `look` with its parameters; {again}")
    for name, shape in shapes.items():
        # They become identifiers of shaders.
        if not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or name.startswith("gl_"):
            raise InputError(f"look: {shown(name)} is no name of a parameter; {again}")
        table = isinstance(shape, int) and not isinstance(shape, bool) and 2 <= shape <= 4096
        if shape not in ("number", "rgb", "either") and not table:
            raise InputError(f"look: {name} has the shape {shown(shape)}, which is none; {again}")
    kind = entry.get("kind")
    if not isinstance(kind, str) or not kind:
        raise InputError(f"look: kind is {shown(kind)}, which is no name; {again}")
    return kind, str(entry.get("light") or ""), dict(shapes)


def _number(name: str, entry: Any, shapes: dict[str, Shape]) -> Number:
    """One entry of `parameters`."""
    response = _response(name)
    if response is None and _family(name, shapes) is None:
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
        unit=str(entry.get("unit") or "") if response is None else response.unit,
        meaning=str(entry.get("meaning") or "") if response is None else response.meaning,
    )


def _check_family(
    family: str, shape: Shape, numbers: dict[str, Number], entries: dict[str, Any]
) -> None:
    """Raise `InputError` unless the numbers of a parameter are all there, each in its range."""
    parts = _parts(family, shape)
    there = [name for name in (family, *parts) if name in numbers]
    if there not in ([family], parts):
        state = f"has {' and '.join(there)} only" if there else f"has no {family}"
        if family in there:
            many = "in rows" if isinstance(shape, int) else "per channel"
            state = f"has {family} as one number and {many}"
        raise InputError(f"parameters: {state}; run the fit again")
    if shape != "either" and there != ([family] if shape == "number" else parts):
        form = "one number" if shape == "number" else f"{len(parts)} numbers"
        raise InputError(f"parameters: {family} must be {form}; run the fit again")
    for name in there:
        bounds = entries[name].get("bounds")
        lower = _finite(bounds[0]) if isinstance(bounds, list) and bounds else None
        if lower is not None and numbers[name].value < lower:
            raise InputError(
                f"look.{family}: {shown(numbers[name].value)} must be at least {lower:g}; run the "
                "fit again"
            )


def _parts(family: str, shape: Shape) -> list[str]:
    """Names of the parts of a colour or a table."""
    endings = [str(k + 1) for k in range(shape)] if isinstance(shape, int) else CHANNELS
    return [f"{family}.{ending}" for ending in endings]


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
            ("width_unit", "scene length", "far - near of the fit, which widths refer to"),
            ("planet_radius", "scene length", "of the planet without its air"),
            ("atmosphere_height", "scene length", "of the shell of air above the planet"),
        )
    }
    per_length = document.get("per_length")
    for name, value in (per_length if isinstance(per_length, dict) else {}).items():
        found[f"{name}_per_length"] = (value, "1/scene length", f"{name} / width_unit")
    color = document.get("color")
    for k, channel in enumerate("rgba"):
        value = color[k] if isinstance(color, list) and len(color) == 4 else None
        meaning = "coverage where there is air" if channel == "a" else "of the air"
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


def _rank(number: Number, shapes: dict[str, Shape]) -> tuple[int, int, int, int]:
    """Look first, in its own order, then photo by photo the response."""
    family, _, ending = number.name.partition(".")
    if family in shapes:
        parts = [family, *_parts(family, shapes[family])]
        return (0, 0, list(shapes).index(family), parts.index(number.name))
    return (1, int(ending or 1), list(RESPONSE_PARAMETERS).index(family), -1)


def _family(name: str, shapes: dict[str, Shape]) -> str | None:
    """The parameter of the look that a name belongs to, or None."""
    family = name.partition(".")[0]
    known = family in shapes and name in (family, *_parts(family, shapes[family]))
    return family if known else None


def _response(name: str) -> Parameter | None:
    """The entry of `RESPONSE_PARAMETERS` that a name belongs to, or None."""
    family, dot, ending = name.partition(".")
    if dot and not re.fullmatch("[1-9][0-9]{0,8}", ending):
        return None
    return RESPONSE_PARAMETERS.get(family)


def of_kind(fitted: Fitted, kind: str) -> tuple[Number, ...]:
    """The numbers that are of the "look" or the "response"."""
    wanted = ("look", "response").index(kind)
    return tuple(number for number in fitted.numbers if _rank(number, fitted.shapes)[0] == wanted)


def explain(verdict: str) -> tuple[str, str]:
    """Sentence and remedy of a verdict's label."""
    return next(texts for known, texts in VERDICTS.items() if known.label == verdict)


def of_family(fitted: Fitted, family: str) -> tuple[Number, ...]:
    """A look's parameter: one number, or its parts; a vec3 of one number is GLSL's own form."""
    return tuple(n for n in of_kind(fitted, "look") if n.name.partition(".")[0] == family)


def quoted(text: str) -> str:
    """In quotes, ASCII, on one line, and never ending in a backslash."""
    return json.dumps(text).replace("\x7f", "\\u007f")  # TOML forbids it, JSON does not
