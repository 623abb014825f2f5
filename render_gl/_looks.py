"""A look's twin in GLSL: where its text is, its uniforms, and the switches that it asks for."""

import inspect
import re
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from model_jax import InputError, Look
from model_jax._composite import transmits
from model_jax._fields import OF_EYE, OF_SUN, OF_VIEW, UNDER_SUN
from model_jax._parameter import Parameter
from model_jax.looks._registry import checked, is_built_in

from ._shaders import shader_source

_UNIFORM = re.compile(
    r"\buniform\s+(?:highp\s+|mediump\s+)?(\w+)\s+(\w+)\s*(?:\[\s*(\d+)\s*\])?\s*;"
)
_COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)

AIR = "vec3 air(Fields fields, inout float alpha, inout vec3 transmittance)"
"""The function that the text of a look defines."""


def uniform_type(about: Parameter) -> str:
    """How a parameter is declared in GLSL, without its name: float, vec3, or float[8]."""
    if isinstance(about.shape, int):
        return f"float[{about.shape}]"
    return "float" if about.shape == "number" else "vec3"


@cache
def look_text(kind: type[Look]) -> str:
    """The GLSL of a look, once its uniforms are its parameters.

    It is the class's `GLSL`, else the file NAME.glsl beside its module (of built-in looks in
    `glsl/looks`).

    Raises `InputError` naming the look: no such text, a parameter without its uniform, a uniform
    that is no parameter or of another type, no function `air`.
    """
    checked(kind)
    text = _found(kind)
    bare = _COMMENT.sub("", text)
    declared = {
        name: type_ if not size else f"{type_}[{size}]"
        for type_, name, size in _UNIFORM.findall(bare)
    }
    wanted = {
        name: uniform_type(about)
        for name, about in kind.PARAMETERS.items()
        if name not in Look.PARAMETERS and name != kind.GROUND
    }
    where = f"look {kind.NAME}: its GLSL"
    for name, type_ in wanted.items():
        if name not in declared:
            raise InputError(
                f"{where} has no uniform for the parameter {name}; add `{_declared(type_, name)}`"
            )
        if declared[name] != type_:
            raise InputError(
                f"{where} declares {name} as {declared[name]}; write `{_declared(type_, name)}`"
            )
    for name in wanted.keys() & _taken():
        raise InputError(
            f"look {kind.NAME}: the parameter {name} has a name that airlight's shaders use; give "
            "it another"
        )
    for name in declared.keys() - wanted.keys() - {kind.GROUND}:
        raise InputError(f"{where} has a uniform {name}, which is no parameter of the look")
    if not re.search(r"\bvec3\s+air\s*\(", bare):
        raise InputError(f"{where} defines no function `{AIR}`; add it")
    return text


@cache
def _taken() -> frozenset[str]:
    """Names that the shader which a look is part of has given away."""
    texts = [shader_source(name) for name in ("combine.frag", "volume.vert")]
    text = re.sub(r"^(uniform|in|out|layout\(.*?\) out) ", "", "\n".join(texts), flags=re.MULTILINE)
    types = r"^(?:float|u?int|bool|[iub]?vec\d|mat\d|sampler2D|struct|#define)\s+(\w+)"
    return frozenset(re.findall(types, text, re.MULTILINE))


def _found(kind: type[Look]) -> str:
    if kind.GLSL is not None:
        return kind.GLSL
    if is_built_in(kind):
        name, *terms = kind.NAME.split("+")
        file = resources.files("render_gl") / "glsl" / "looks" / f"{name}.glsl"
        return _with_terms(file.read_text(encoding="utf-8"), terms)
    try:
        beside = Path(inspect.getfile(kind)).with_name(f"{kind.NAME}.glsl")
        return beside.read_text(encoding="utf-8")
    except (OSError, TypeError, UnicodeDecodeError) as error:
        raise InputError(
            f"look {kind.NAME}: has no GLSL to draw with ({error}); put {kind.NAME}.glsl beside "
            "its Python file, or its text into GLSL"
        ) from None


def _with_terms(text: str, terms: list[str]) -> str:
    """The lines of a look's text that its terms are asked for: `#ifdef TERM_…`, `#else`, `#endif`.

    What is for other terms is not there at all, neither for the compiler nor for `look_text`.
    """
    asked = {f"TERM_{name.upper().replace('-', '_')}" for name in terms}
    kept: list[str] = []
    open_: list[
        bool | None
    ] = []  # of each condition around: whether it holds; None: the compiler's
    for line in text.splitlines():
        word = line.split()
        if word[:1] and word[0] in ("#ifdef", "#ifndef", "#if"):
            own = len(word) > 1 and word[1].startswith("TERM_")
            open_.append((word[1] in asked) == (word[0] == "#ifdef") if own else None)
            if own:
                continue
        elif word[:1] == ["#else"] and open_[-1] is not None:
            open_[-1] = not open_[-1]
            continue
        elif word[:1] == ["#endif"] and open_.pop() is not None:
            continue
        if False not in open_:
            kept.append(line)
    return "\n".join(kept) + "\n"


def _declared(type_: str, name: str) -> str:
    base, bracket, size = type_.partition("[")
    return f"uniform {base} {name}{bracket}{size};"


def look_uniforms(look: Look) -> dict[str, Any]:
    """Values of a look's uniforms."""
    found: dict[str, Any] = {}
    for name, about in type(look).PARAMETERS.items():
        value = np.asarray(getattr(look, name), np.float64)
        if isinstance(about.shape, int):
            found[name] = value.tolist()
        elif about.shape == "number":
            found[name] = float(value)
        else:
            found[name] = tuple(np.broadcast_to(value, 3))
    return found


def look_defines(kind: type[Look]) -> dict[str, int]:
    """The switches of a look: its fields, and whether it has a transmittance."""
    fields = {f"FIELD_{name.upper()}": 1 for name in kind.NEEDS}
    fields |= {"PLACES": 1} if any(name in OF_VIEW for name in kind.NEEDS) else {}
    towards = any(name in (*OF_SUN, *UNDER_SUN) for name in kind.NEEDS)
    fields |= {"EYE": 1} if any(name in OF_EYE for name in kind.NEEDS) else {}
    fields |= {"TOWARD_SUN": 1} if towards else {}
    return fields | ({"TRANSMITS": 1} if transmits(kind) else {})
