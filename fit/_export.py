"""A fit's numbers for other programs: shader constants, a scene's [look], flat JSON, CSV.

    fit.json ──read_fit──> Fitted ──export_text──> text

The look is what a shader needs, with the air's colour, the lengths that it refers to and the
warnings of the fit. The camera's response (exposure, gamma, black level of each photo)
says what a photo made of the light and is no part of it; it is written beside it and marked so, as
is every parameter whose name this version does not know. Nothing here computes a fit or draws.
"""

import csv
import io
import json
import math
import os
import re
import struct
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from model_jax._errors import InputError, printable, shown
from model_jax._parameter import PARAMETERS, RESPONSE_PARAMETERS
from render_gl._files import PathLike, check_file, write_whole

from ._verdict import VERDICTS, Verdict
from ._wording import share

CHANNELS = ("r", "g", "b")
UNIFORM_TYPES = {"brightness": "float", "shadow": "vec3", "tint": "vec3", "background": "vec3"}
"""As `combine.glsl` declares them; background is the frame buffer's part there, per channel."""

PATHS = {
    "depth": "Widths of air are differences of eye depth, as in the paper.",
    "distance": "Widths of air are lengths along the ray: eye depths times 1 / cos of its angle.",
}
"""What `atmosphere.path` means for a shader."""

USABLE = (Verdict.CONVERGED.label, Verdict.AT_BOUND.label)
"""Verdicts whose values are the best that the photo has to say."""


class Format(StrEnum):
    """What `export_text` can write."""

    glsl = "glsl"
    glsl_uniform = "glsl-uniform"
    json = "json"
    toml = "toml"
    csv = "csv"


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
        sentence, remedy = _explain(self.verdict)
        told = f"{sentence[0].lower()}{sentence[1:]}; {remedy}"
        return f"{self.path}: verdict {_key(self.verdict)}: {told}"


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


def export_text(fitted: Fitted, to: Format) -> str:
    """A fit in another format, as a whole file's text that ends in a line break.

    - glsl: `const` lines that replace the uniforms of the same names in `combine.glsl`. Each
      literal is the shortest that reads back as the float32 nearest to the value. ASCII only.
    - glsl-uniform: declarations of the same names, with the values as comments. Both compile in
      OpenGL from 3.3 and in OpenGL ES from 3.0, so in WebGL 2, as they are.
    - toml: a `[look]` table for a scene file; what is no look follows as comments.
    - json: one flat object: name → value and, where there is one, name.stderr → error.
    - csv: one row for each number, under a header row.

    JSON, TOML and CSV hold every value to the last bit of its float64.

    Raises `InputError` for GLSL where a value is beyond the range of float32.
    """
    write = {
        Format.glsl: _glsl,
        Format.glsl_uniform: _glsl_uniform,
        Format.json: _json,
        Format.toml: _toml,
        Format.csv: _csv,
    }[to]
    try:
        return write(fitted)
    except InputError as error:
        raise InputError(f"{fitted.path}: {error}") from None


def write_export(path: PathLike, fitted: Fitted, to: Format) -> None:
    """`export_text` into a file, whole or not at all.

    Raises `InputError` as `export_text` and `write_whole` do, and when `path` is the fit.json that
    the numbers come from.
    """
    text = export_text(fitted, to)
    if os.path.realpath(path) == os.path.realpath(fitted.path):
        raise InputError(f"{path}: is the fit that is exported; choose another file with -o")

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_whole(path, write)


def float_literal(value: float) -> str:
    """The GLSL literal of fewest digits that reads back as the float32 nearest to `value`.

    Always with a decimal point: `3` would be an int. Raises `InputError` where no finite float32 is
    near. Below 1.2e-38 in size the literal is still exact, but drivers may take it as zero.
    """
    nearest = _float32(value)
    if not math.isfinite(nearest):
        raise InputError(f"{value!r} is beyond the float32 of shaders; choose another format")
    # Nine digits tell any two float32 apart.
    text = next(t for n in range(9) if _float32(float(t := f"{nearest:.{n}e}")) == nearest)
    mantissa, exponent = text.split("e")
    if nearest == 0 or _float32(1e-4) <= abs(nearest) < 1e7:
        digits = len(mantissa.partition(".")[2]) - int(exponent)
        return f"{float(text):.{max(1, digits)}f}"
    return f"{mantissa}{'' if '.' in mantissa else '.0'}e{int(exponent):+03d}"


def _float32(value: float) -> float:
    """The nearest float32, infinite beyond its range."""
    try:
        found: float = struct.unpack("<f", struct.pack("<f", value))[0]
    except OverflowError:
        return math.inf
    return found


# --- reading ------------------------------------------------------------------------------------


def _fitted(path: str, document: Any) -> Fitted:
    if not isinstance(document, dict) or not isinstance(document.get("parameters"), dict):
        raise InputError("has no table `parameters`; name a fit.json, as `airlight fit` writes it")
    verdict = str(document.get("verdict") or "unknown")
    if verdict == Verdict.NO_DATA.label:
        sentence, remedy = _explain(verdict)
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


def _of(fitted: Fitted, kind: str) -> tuple[Number, ...]:
    """The numbers that are "look", "response" or "unknown"."""
    wanted = ("look", "response", "unknown").index(kind)
    return tuple(number for number in fitted.numbers if _rank(number)[0] == wanted)


# --- writing ------------------------------------------------------------------------------------


def _glsl(fitted: Fitted) -> str:
    lines = [f"// {line}" for line in _heading(fitted)]
    lines += ["// Replaces the uniforms of the same names in combine.glsl:"]
    lines += ["// light = brightness * color.rgb * tint * (lit + shadow * dark) + background,"]
    lines += ["// with lit and dark the widths of air on the ray, divided by width_unit.", ""]
    for family, shape in UNIFORM_TYPES.items():
        lines.append(_constant(family, shape, _family(fitted, family)))
    color = tuple(number for number in fitted.scene if number.name.startswith("color."))
    lengths = [number for number in fitted.scene if number not in color]
    if len(color) == 4:
        lines.append(_constant("color", "vec4", color))
    lines += [
        "",
        "// brightness is per width_unit = far - near of the fitted scene. With one of your own,",
        "// multiply brightness by your own far - near over this one's, in the same length unit.",
        *(_constant(number.name, "float", (number,)) for number in lengths),
    ]
    if response := _of(fitted, "response"):
        lines += [
            "",
            "// Camera response of each photo, not part of the look:",
            "// recorded = black_level + pow(exposure * light, 1.0 / gamma)",
            *(_constant(number.name.replace(".", "_"), "float", (number,)) for number in response),
        ]
    if unknown := _of(fitted, "unknown"):
        lines += ["", "// Parameters that this version of airlight does not know."]
        lines += _unknown_constants(unknown)
    return "\n".join(lines) + "\n"


def _glsl_uniform(fitted: Fitted) -> str:
    """The same names for a program to set, to the values in the comments: OpenGL ES knows no
    uniforms with a default."""
    text = re.sub(
        r"^const (highp \w+ \w+) = (.*?);(?:  // )?(.*)$",
        lambda found: (
            f"uniform {found[1]};  // set to {found[2]}" + (f"; {found[3]}" if found[3] else "")
        ),
        _glsl(fitted),
        flags=re.MULTILINE,
    )
    return text.replace("// Replaces the uniforms", "// The uniforms")


def _unknown_constants(numbers: tuple[Number, ...]) -> Iterator[str]:
    """Prefixed, so that no name is a word of GLSL or of the shader; three channels as a vec3."""
    by_name = {number.name: number for number in numbers}
    used: set[str] = set()
    while by_name:
        name = next(iter(by_name))
        family, _, ending = name.rpartition(".")
        members = [f"{family}.{channel}" for channel in CHANNELS]
        if ending not in CHANNELS or not all(member in by_name for member in members):
            family, members = name, [name]
        found = tuple(by_name.pop(member) for member in members)
        plain = "_".join(["fit", *re.findall("[A-Za-z0-9]+", family)])
        identifier, count = plain, 1
        while identifier in used:
            identifier, count = f"{plain}_{count + 1}", count + 1
        used.add(identifier)
        line = _constant(identifier, "vec3" if len(found) == 3 else "float", found)
        yield line if identifier == f"fit_{family}" else f"{line} [{_quoted(family)}]"


def _constant(identifier: str, shape: str, numbers: tuple[Number, ...]) -> str:
    """One line: declaration, and a comment with unit, error and meaning."""
    try:
        literals = [float_literal(number.value) for number in numbers]
    except InputError as error:
        raise InputError(f"{numbers[0].name}: {error}") from None
    value = literals[0] if shape == "float" else f"{shape}({', '.join(literals)})"
    about = [numbers[0].unit] if numbers[0].unit not in ("", "1") else []
    about += [remark] if (remark := _remark(numbers)) else []
    comment = "; ".join([", ".join(about), numbers[0].meaning] if about else [numbers[0].meaning])
    # Older GLSL takes ASCII only, and a backslash at the end of a line continues the comment.
    comment = _plain(comment).rstrip("; ")
    # OpenGL ES has no precision of its own for fragments, and the least one ends at 16,384.
    return f"const highp {shape} {identifier} = {value};" + (f"  // {comment}" if comment else "")


def _toml(fitted: Fitted) -> str:
    lines = [f"# {line}" for line in _heading(fitted)]
    if unit := next((n for n in fitted.scene if n.name == "width_unit"), None):
        lines += [
            f"# brightness is per far - near = {unit.value!r}; with another one in the scene,",
            "# multiply brightness by the scene's own far - near over this one.",
        ]
    lines += ["", "[look]"]
    for family in PARAMETERS:
        numbers = _family(fitted, family)
        values = [repr(number.value) for number in numbers]
        value = values[0] if len(values) == 1 else f"[{', '.join(values)}]"
        lines.append(f"{family} = {value}" + _trailing(numbers))
    if extra := (*fitted.scene, *_of(fitted, "response"), *_of(fitted, "unknown")):
        lines += ["", "# Not part of the look:"]
        lines += [f"# {_key(n.name)} = {n.value!r}{_trailing((n,))}" for n in extra]
    return "\n".join(lines) + "\n"


def _json(fitted: Fitted) -> str:
    flat: dict[str, Any] = {"verdict": fitted.verdict}
    if fitted.warnings:
        flat["warnings"] = " ".join(fitted.warnings)
    if fitted.atmosphere_path is not None:
        flat["atmosphere_path"] = fitted.atmosphere_path
    for number in (*fitted.numbers, *fitted.scene):
        flat[number.name] = number.value
        if number.stderr is not None:
            flat[f"{number.name}.stderr"] = number.stderr
    return json.dumps(flat, indent=2, allow_nan=False) + "\n"


def _csv(fitted: Fitted) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["name", "value", "stderr", "unit", "free", "role", "initial", "verdict"])
    for n in (*fitted.numbers, *fitted.scene):
        error, start = ("" if x is None else repr(x) for x in (n.stderr, n.initial))
        free = str(n.free).lower()
        row = [n.name, repr(n.value), error, n.unit, free, n.role, start, fitted.verdict]
        table.writerow([_ascii(cell) for cell in row])
    return text.getvalue()


def _heading(fitted: Fitted) -> Iterator[str]:
    """Where the numbers come from and what they are worth, in ASCII lines."""
    sources = [
        _quoted(photo) + ("" if scene is None else f" with {_quoted(scene)}")
        for photo, scene in fitted.sources
    ]
    if len(sources) == 1:
        yield f"Look of the air, fitted by airlight to {sources[0]}."
    else:
        yield f"Look of the air, fitted by airlight to {len(sources)} photos:"
        yield from (f"  {k}: {source}" for k, source in enumerate(sources, start=1))
    sentence, remedy = _explain(fitted.verdict)
    converged = fitted.verdict == Verdict.CONVERGED.label
    yield f"Verdict: {_key(fitted.verdict)}." + ("" if converged else f" {sentence}.")
    if fitted.explained is not None:
        yield _plain(f"Explains {share(fitted.explained)} of the light's variance.")
    if fitted.warning is not None:
        yield f"Take these numbers with care: {remedy}."
    for warning in fitted.warnings:
        yield from textwrap.wrap(_plain(f"Warning: {warning}"), 96, subsequent_indent="  ")
    if fitted.atmosphere_path is not None:
        yield PATHS[fitted.atmosphere_path]


def _explain(verdict: str) -> tuple[str, str]:
    """Sentence and remedy of a verdict's label."""
    for known, texts in VERDICTS.items():
        if known.label == verdict:
            return texts
    return "This version of airlight does not know that verdict", "run the fit again"


def _family(fitted: Fitted, family: str) -> tuple[Number, ...]:
    """The one number of a look's field, or its three; a vec3 of one number is GLSL's own form."""
    return tuple(n for n in _of(fitted, "look") if n.name.partition(".")[0] == family)


def _remark(numbers: Iterable[Number]) -> str:
    """Error of each number, or why there is none; said once when it is the same for all."""
    said = [_error(number) for number in numbers]
    return said[0] if len(set(said)) == 1 else ", ".join(said)


def _error(number: Number) -> str:
    words = {
        "at_bound": "at a bound",
        "held": "not told by the photo, start value",
        "fixed": "not fitted",
        "tied": f"tied to {_key(str(number.tied_to))}",
        "free": "error unknown",
        "": "",
    }
    if number.stderr is not None:
        bound = " at a bound" if number.role == "at_bound" else ""
        return f"+- {number.stderr:.2g}{bound}"
    return words.get(number.role, _key(number.role))


def _trailing(numbers: Iterable[Number]) -> str:
    """A TOML comment at a line's end."""
    remark = _remark(numbers)
    return f"  # {remark}" if remark else ""


def _key(name: str) -> str:
    """A name as it is, or quoted when it is no plain word."""
    return name if re.fullmatch("[A-Za-z0-9_.]+", name) else _quoted(name)


def _quoted(text: str) -> str:
    """In quotes, ASCII, on one line, and never ending in a backslash."""
    return json.dumps(text).replace("\x7f", "\\u007f")  # TOML forbids it, JSON does not


_SIGNS = str.maketrans(
    {"−": "-", "·": "*", "×": "x", "±": "+-", "≤": "<=", "≥": ">=", "…": "...", "→": "->"}
    | {"Δ": "Delta", "χ": "chi", "σ": "sigma", "’": "'"}
)
_POWERS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")


def _plain(text: str) -> str:
    """Text as a comment of any language can hold it: ASCII on one line, without backslashes, which
    at a line's end continue it; numbers stay readable, as 3.1 * 10^-5."""
    powers = re.sub("[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+", lambda found: "^" + found[0].translate(_POWERS), text)
    return _ascii(printable(powers.translate(_SIGNS))).replace("\\", "/")


def _ascii(text: str) -> str:
    return text.encode("ascii", "backslashreplace").decode("ascii")
