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

from ._context import on_gl

if TYPE_CHECKING:
    import moderngl

DEFINES = frozenset(
    {
        "ALBEDO",
        "COLOR_DEPTH",
        "CONE",
        "EXACT",
        "LINEAR",
        "OCCLUDERS",
        "RELIEF",
        "REVERSED",
        "SHADOWS",
        "SORTED",
        "STRETCH",
        "SUN",
    }
)
"""Every switch a shader may ask for."""

NONE: Mapping[str, int] = MappingProxyType({})

_INCLUDE = re.compile(r'^#include "([\w.]+)"$', re.MULTILINE)


def shader_source(name: str, defines: Mapping[str, int] = NONE) -> str:
    """Text of a shader file with its includes and defines written out.

    Defines that the file does not use are left away, so that one set serves all stages; a name
    outside `DEFINES` raises `ValueError`, as does a missing file.
    """
    unknown = defines.keys() - DEFINES
    if unknown:
        raise ValueError(f"{name}: unknown define {sorted(unknown)}; known are {sorted(DEFINES)}")
    text = _read(name)
    for included in _INCLUDE.findall(text):
        text = text.replace(f'#include "{included}"', _read(included))
    if "#include" in text:
        raise ValueError(f"{name}: an include inside an include, or a malformed one")
    asked = set(re.findall(r"#ifn?def (\w+)", text))
    if asked - DEFINES:
        raise ValueError(f"{name}: asks for {sorted(asked - DEFINES)}, which nothing defines")
    version, body = text.split("\n", 1)
    lines = [f"#define {define} {defines[define]}" for define in sorted(defines.keys() & asked)]
    return "\n".join([version, *lines, body])


def program(vertex: str, fragment: str, defines: Mapping[str, int] = NONE) -> "moderngl.Program":
    """Compiled program of two shader files; compiled once per process and set of defines."""
    return _compile(shader_source(vertex, defines), shader_source(fragment, defines))


@cache
def _compile(vertex: str, fragment: str) -> "moderngl.Program":
    return on_gl(lambda context: context.program(vertex_shader=vertex, fragment_shader=fragment))


def _read(name: str) -> str:
    file = resources.files("render_gl") / "glsl" / name
    if not file.is_file():
        raise ValueError(f"{name}: no such shader file")
    return file.read_text(encoding="utf-8")
