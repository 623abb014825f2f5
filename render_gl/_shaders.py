"""Shader files: a strict loader.

A missing include, an unknown or unused define, or a uniform that the shader does not have is an
error that names the file. Shaders hold no copy of a number that Python owns.
"""

import re
from collections.abc import Mapping
from functools import cache
from importlib import resources
from types import MappingProxyType
from typing import TYPE_CHECKING

from model_jax import FIELDS, InputError

from ._context import on_gl

if TYPE_CHECKING:
    import moderngl

DEFINES = frozenset(
    {
        "ALBEDO",
        "COLOR_DEPTH",
        "CONE",
        "EXACT",
        "EYE",
        *(f"FIELD_{name.upper()}" for name in FIELDS),
        "INSIDE",
        "LINEAR",
        "OCCLUDERS",
        "PLACES",
        "RELIEF",
        "REVERSED",
        "SHADOWS",
        "SORTED",
        "STRETCH",
        "SUN",
        "TEXTURE",
        "TOWARD_SUN",
        "TRANSMITS",
        "UNLIT",
        "WATER",
    }
)
"""Every switch a shader may ask for."""

NONE: Mapping[str, int] = MappingProxyType({})

_LOOK = "// (the look)\n"
_INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)


def shader_source(name: str, defines: Mapping[str, int] = NONE, look: str = "") -> str:
    """Text of a shader file with its includes and defines written out.

    `#include "look"` is the text of a look (`_looks.look_text`).

    Defines that the file does not use are left away, so that one set serves all stages; a name
    outside `DEFINES` raises `ValueError`, as does a missing file.
    """
    unknown = defines.keys() - DEFINES
    if unknown:
        raise ValueError(f"{name}: unknown define {sorted(unknown)}; known are {sorted(DEFINES)}")
    text = _read(name)
    for included in _INCLUDE.findall(text):
        if included != "look":
            text = text.replace(f'#include "{included}"', _read(included))
    # A look is somebody else's text: what is wrong with it the compiler says.
    text, look = text.replace('#include "look"', _LOOK), f"{look}\n"
    if "#include" in text:
        raise ValueError(f"{name}: an include inside an include, or a malformed one")
    if "defined(" in text:
        raise ValueError(f"{name}: asks by defined(…), which is not read; nest #ifdef and #ifndef")
    asked = set(re.findall(r"#ifn?def (\w+)", text))
    if asked - DEFINES:
        raise ValueError(f"{name}: asks for {sorted(asked - DEFINES)}, which nothing defines")
    asked |= set(re.findall(r"#ifn?def (\w+)", look)) & DEFINES
    version, body = text.replace(_LOOK, look).split("\n", 1)
    lines = [f"#define {define} {defines[define]}" for define in sorted(defines.keys() & asked)]
    return "\n".join([version, *lines, body])


def program(vertex: str, fragment: str, defines: Mapping[str, int] = NONE) -> "moderngl.Program":
    """Compiled program of two shader files; compiled once per process and set of defines."""
    return _compile(shader_source(vertex, defines), shader_source(fragment, defines))


def look_program(
    vertex: str, fragment: str, defines: Mapping[str, int], name: str, text: str
) -> "moderngl.Program":
    """The same with a look's text in it; `InputError` with the driver's words if it is no GLSL."""
    import moderngl

    try:
        return _compile(shader_source(vertex, defines), shader_source(fragment, defines, text))
    except moderngl.Error as error:
        found = re.findall(r"^.*(?:error|ERROR).*$", str(error), re.MULTILINE)
        told = "; ".join(line.strip() for line in found[1:3]) or str(error)
        raise InputError(f"look {name}: its GLSL does not compile ({told}); mend it") from None


@cache
def _compile(vertex: str, fragment: str) -> "moderngl.Program":
    return on_gl(lambda context: context.program(vertex_shader=vertex, fragment_shader=fragment))


def _read(name: str) -> str:
    file = resources.files("render_gl") / "glsl" / name
    if not file.is_file():
        raise ValueError(f"{name}: no such shader file")
    return file.read_text(encoding="utf-8")
