"""The shader loader is strict, and every shader function has a JAX twin or a written exemption."""

import re
from importlib import resources

import pytest

import model_jax
from model_jax import (
    FIELDS,
    _analytic,
    _column,
    _intersect,
    _phase,
    _safe,
    _sun_column,
    _sunlight,
    _view,
)
from render_gl._shaders import DEFINES, shader_source

FILES = sorted(
    file.name
    for file in (resources.files("render_gl") / "glsl").iterdir()
    if file.name.endswith((".glsl", ".vert", ".frag"))
)

EXEMPT = {
    "main": "entry point",
    "eye_depth": "chooses between the depth formats; DepthTextures.linearize does that in JAX",
    "is_nearer": "which way window depths run; JAX compares eye depths",
    "picture_position": "pixels from below; those of `pixel_grid` run from above",
    "sorting_depth": "hidden surfaces of a rasteriser",
    "coded_depth": "what a rasteriser stores; `linearize_depth` is its inverse",
    "eye_position": "vertex stage; checked against exact intersection",
    "clip_position": "vertex stage; checked against exact intersection",
    "map_position": "texture look-up of the surface, which JAX takes as a layer",
    "ground_radius": "relief, which JAX takes as a layer",
    "surface_albedo": "texture look-up of the surface",
    "of_map": "likewise",
    "surface_normal": "shading of the surface",
    "eclipsed": "shading of the surface",
}

TWINS = {
    "ray_direction": _view.pixel_slopes,
    "ray_offset": _view.ray_offsets,
    "ray_sphere": _intersect.ray_sphere,
    "ray_cone": _intersect.ray_cone,
    "half_line": _intersect._half_line,
    "quotient": _safe.safe_divide,
    "is_ahead": _analytic.is_ahead,
    "column": _column.column,
    "pieces": _column.pieces,
    "mean_transmittance": _column.mean_transmittance,
    "rise_of": _column.rise_of,
    "scaled_tail": _sun_column.scaled_tail,
    "outward": _sun_column._outward,
    "sun_column": _sun_column.sun_column,
    "sun_column_at": _sun_column.sun_column_at,
    "place_at": _column.place_at,
    "sunlight_met": _sunlight.sunlight_met,
    "rayleigh": _phase.rayleigh,
    "henyey_greenstein": _phase.henyey_greenstein,
    "squared_distance": _phase.squared_distance,
    "cheap_cornette_shanks": _phase.cheap_cornette_shanks,
}
"""Of functions whose twin is not public, or has another name."""


def functions(text: str) -> set[str]:
    return set(re.findall(r"^(?:float|vec[234]|mat[34]|void|int|bool) (\w+)\(", text, re.MULTILINE))


def glsl(name: str) -> str:
    return (resources.files("render_gl") / "glsl" / name).read_text()


@pytest.mark.parametrize("name", FILES)
def test_every_function_has_a_twin_or_an_exemption(name: str) -> None:
    for function in functions(glsl(name)):
        twin = TWINS.get(function, getattr(model_jax, function, None))
        if twin is None:
            assert function in EXEMPT, f"{name}: {function} has neither a JAX twin nor an exemption"
        else:
            assert f"`{function}` in `{name}`" in (twin.__doc__ or "")


def test_exemptions_name_existing_functions() -> None:
    assert set(EXEMPT) <= set().union(*(functions(glsl(name)) for name in FILES))


@pytest.mark.parametrize("name", FILES)
def test_shaders_hold_no_copy_of_the_look(name: str) -> None:
    code = re.sub(r"//.*", "", glsl(name))
    assert not re.search(r"\b3\.0\b(?! :)|\b0\.2\b", code.replace("? 3.0 : -1.0", ""))


@pytest.mark.parametrize("name", FILES)
def test_shaders_open_with_what_they_provide(name: str) -> None:
    lines = glsl(name).splitlines()
    assert lines[1 if lines[0].startswith("#version") else 0].startswith("// ")


def test_unknown_define_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown define"):
        shader_source("combine.frag", {"SHADOW": 1})


def test_missing_file_is_refused() -> None:
    with pytest.raises(ValueError, match="no such shader"):
        shader_source("missing.frag")


def test_defines_follow_the_version_line() -> None:
    text = shader_source("combine.frag", dict.fromkeys(DEFINES, 2))
    lines = text.splitlines()
    assert lines[0] == "#version 330"
    known = sorted(
        {"CONE", "EXACT", "LINEAR", "REVERSED", "SHADOWS", "SORTED", "STRETCH", "TRANSMITS"}
    )
    known = sorted(
        {
            *known,
            "EYE",
            "PLACES",
            "TOWARD_SUN",
            "WATER",
            *(f"FIELD_{name.upper()}" for name in FIELDS),
        }
    )
    assert lines[1 : len(known) + 1] == [f"#define {name} 2" for name in known]
    assert "#include" not in text
