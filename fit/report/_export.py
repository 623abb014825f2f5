"""A fit's numbers for other programs: shader constants, a scene's [look], flat JSON, CSV.

    fit.json ──read_fit──> Fitted ──export_text──> text

The look is what a shader needs, with the air's colour, the lengths that it refers to and the
warnings of the fit. The camera's response (exposure, gamma, black level of each photo) says what a
photo made of the light and is no part of it; it is written beside it and marked so. Nothing here
computes a fit or draws.
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
from enum import StrEnum
from pathlib import Path
from typing import Any

from model_jax._errors import InputError, printable
from model_jax._parameter import PER_UNIT, Shape
from render_gl._files import PathLike, write_whole

from .._numbers import share
from .._verdict import Verdict
from ._fitted import PATHS, Fitted, Number, explain, of_family, of_kind, quoted


class Format(StrEnum):
    """What `export_text` can write."""

    glsl = "glsl"
    glsl_uniform = "glsl-uniform"
    json = "json"
    toml = "toml"
    csv = "csv"


def export_text(fitted: Fitted, to: Format) -> str:
    """A fit in another format, as a whole file's text that ends in a line break.

    - glsl: `const` lines that replace the uniforms of the same names in the look's GLSL. Each
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


# --- writing ------------------------------------------------------------------------------------


def _glsl(fitted: Fitted) -> str:
    lines = [f"// {line}" for line in _heading(fitted)]
    lines += [f"// Replaces the uniforms of the same names in {_plain(fitted.kind)}.glsl:"]
    lines += [f"// {line}" for line in textwrap.wrap(_plain(fitted.light), 96)]
    lines += ["// Widths of air on the ray are divided by width_unit; background is added.", ""]
    for family, shape in fitted.shapes.items():
        lines.append(_constant(family, shape, of_family(fitted, family)))
    color = tuple(number for number in fitted.scene if number.name.startswith("color."))
    lengths = [number for number in fitted.scene if number not in color]
    if len(color) == 4:
        lines.append(_constant("color", "rgba", color))
    lines += [""]
    if per := " and ".join(_per_unit(fitted)):
        verb = "are" if len(_per_unit(fitted)) > 1 else "is"
        lines += [
            f"// {per} {verb} per width_unit = far - near of the fitted scene. With one of your",
            f"// own, multiply {per} by your own far - near over this one's, in the same length",
            "// unit.",
        ]
    lines += [_constant(number.name, "number", (number,)) for number in lengths]
    if response := of_kind(fitted, "response"):
        lines += [
            "",
            "// Camera response of each photo, not part of the look:",
            "// recorded = black_level + pow(exposure * light, 1.0 / gamma)",
            *(_constant(number.name.replace(".", "_"), "number", (number,)) for number in response),
        ]
    return "\n".join(lines) + "\n"


def _glsl_uniform(fitted: Fitted) -> str:
    """The same names for a program to set, to the values in the comments: OpenGL ES knows no
    uniforms with a default."""
    text = re.sub(
        r"^const (highp \w+ [\w\[\]]+) = (.*?);(?:  // )?(.*)$",
        lambda found: (
            f"uniform {found[1]};  // set to {found[2]}" + (f"; {found[3]}" if found[3] else "")
        ),
        _glsl(fitted),
        flags=re.MULTILINE,
    )
    return text.replace("// Replaces the uniforms", "// The uniforms")


def _per_unit(fitted: Fitted) -> list[str]:
    """Parameters that are per width unit."""
    names = [number.name.partition(".")[0] for number in fitted.numbers if number.unit == PER_UNIT]
    return list(dict.fromkeys(names))


_GLSL_TYPES = {"number": "float", "rgb": "vec3", "either": "vec3", "rgba": "vec4"}


def _constant(identifier: str, shape: Shape | str, numbers: tuple[Number, ...]) -> str:
    """One line: declaration, and a comment with unit, error and meaning."""
    try:
        literals = [float_literal(number.value) for number in numbers]
    except InputError as error:
        raise InputError(f"{numbers[0].name}: {error}") from None
    if isinstance(shape, int):
        # ES wants the size behind the name in declarations, and before the brackets of the value.
        type_, name = "float", f"{identifier}[{shape}]"
        value = f"float[{shape}]({', '.join(literals)})"
    else:
        type_, name = _GLSL_TYPES[shape], identifier
        value = literals[0] if type_ == "float" else f"{type_}({', '.join(literals)})"
    about = [numbers[0].unit] if numbers[0].unit not in ("", "1") else []
    about += [remark] if (remark := _remark(numbers)) else []
    comment = "; ".join([", ".join(about), numbers[0].meaning] if about else [numbers[0].meaning])
    # Older GLSL takes ASCII only, and a backslash at the end of a line continues the comment.
    comment = _plain(comment).rstrip("; ")
    # OpenGL ES has no precision of its own for fragments, and the least one ends at 16,384.
    return f"const highp {type_} {name} = {value};" + (f"  // {comment}" if comment else "")


def _toml(fitted: Fitted) -> str:
    lines = [f"# {line}" for line in _heading(fitted)]
    if unit := next((n for n in fitted.scene if n.name == "width_unit"), None):
        for name in _per_unit(fitted):
            lines += [
                f"# {name} is per far - near = {unit.value!r}; with another one in the scene,",
                f"# multiply {name} by the scene's own far - near over this one.",
            ]
    lines += ["", "[look]", f"kind = {quoted(fitted.kind)}"]
    for family in fitted.shapes:
        numbers = of_family(fitted, family)
        values = [repr(number.value) for number in numbers]
        value = values[0] if len(values) == 1 else f"[{', '.join(values)}]"
        lines.append(f"{family} = {value}" + _trailing(numbers))
    if extra := (*fitted.scene, *of_kind(fitted, "response")):
        lines += ["", "# Not part of the look:"]
        lines += [f"# {n.name} = {n.value!r}{_trailing((n,))}" for n in extra]
    return "\n".join(lines) + "\n"


def _json(fitted: Fitted) -> str:
    flat: dict[str, Any] = {"verdict": fitted.verdict, "look": fitted.kind}
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
        quoted(photo) + ("" if scene is None else f" with {quoted(scene)}")
        for photo, scene in fitted.sources
    ]
    if len(sources) == 1:
        yield f"Look of the air, fitted by airlight to {sources[0]}."
    else:
        yield f"Look of the air, fitted by airlight to {len(sources)} photos:"
        yield from (f"  {k}: {source}" for k, source in enumerate(sources, start=1))
    sentence, remedy = explain(fitted.verdict)
    converged = fitted.verdict == Verdict.CONVERGED.label
    yield f"Verdict: {fitted.verdict}." + ("" if converged else f" {sentence}.")
    if fitted.explained is not None:
        yield _plain(f"Explains {share(fitted.explained)} of the light's variance.")
    if fitted.warning is not None:
        yield f"Take these numbers with care: {remedy}."
    for warning in fitted.warnings:
        yield from textwrap.wrap(_plain(f"Warning: {warning}"), 96, subsequent_indent="  ")
    if fitted.atmosphere_path is not None:
        yield PATHS[fitted.atmosphere_path]


def _remark(numbers: Iterable[Number]) -> str:
    """Error of each number, or why there is none; said once when it is the same for all."""
    said = [_error(number) for number in numbers]
    return said[0] if len(set(said)) == 1 else ", ".join(said)


def _error(number: Number) -> str:
    words = {
        "at_bound": "at a bound",
        "held": "not told by the photo, start value",
        "fixed": "not fitted",
        "tied": f"tied to {number.tied_to}",
        "free": "error unknown",
        "": "",
    }
    if number.stderr is not None:
        bound = " at a bound" if number.role == "at_bound" else ""
        return f"+- {number.stderr:.2g}{bound}"
    return words[number.role]


def _trailing(numbers: Iterable[Number]) -> str:
    """A TOML comment at a line's end."""
    remark = _remark(numbers)
    return f"  # {remark}" if remark else ""


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
