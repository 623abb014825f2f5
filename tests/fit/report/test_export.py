"""Exported numbers are the fit's: in a shader that is drawn, in a scene that is loaded, in tables.

The round trip through OpenGL pastes the exported lines into `combine.glsl` in place of the uniforms
of the same names, draws with a look in the uniforms that is *not* the fit's, and holds the picture
against JAX's picture of the fit by the bound of `render_gl._parity`.
"""

import csv
import dataclasses
import io
import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import moderngl
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import render_gl
from fit import fit
from fit.report._export import Format, export_text, float_literal
from fit.report._fitted import SCHEMA, read_fit
from model_jax import (
    InputError,
    LayersLook,
    Look,
    Scene,
    combine,
    composite,
    layer_widths,
)
from render_gl import DepthFormat, _shaders
from render_gl._context import on_gl
from render_gl._draw import draw
from render_gl._looks import look_text
from render_gl._parity import EPS, Parity, compare, measure_division
from render_gl._render import frame_layers
from tests.command import airlight
from tests.fit.looks import START, TRUTH, picture, scene
from tests.scene_text import resized

ODD = LayersLook(
    brightness=2.7182818284590455,
    shadow=[0.0, 1 / 3, 1.2345678901234567],
    tint=[0.1, 1.7000000000000002, 1.2],
    background=[-0.012345678901234567, 1e-30, 0.07],
)
"""Numbers that no float32 holds, zero, a negative one and a tiny one."""


def entry(value: Any, **changes: Any) -> dict[str, Any]:
    plain = {"value": value, "stderr": 0.01, "initial": 1.0, "free": True, "role": "free"}
    return plain | {"bounds": [0.0, None], "quantisation_bound": None} | changes


def _finite(bound: float) -> float | None:
    return bound if np.isfinite(bound) else None


def document_of(
    look: LayersLook, width_unit: float | None = None, **changes: Any
) -> dict[str, Any]:
    """A fit.json of a look."""
    parameters: dict[str, Any] = {}
    for family in LayersLook.PARAMETERS:
        value = getattr(look, family)
        if np.shape(value):
            names = [f"{family}.{channel}" for channel in "rgb"]
            parameters |= {n: entry(float(v)) for n, v in zip(names, value, strict=True)}
        else:
            parameters[family] = entry(float(value))
        about = LayersLook.PARAMETERS[family]
        for name in (n for n in parameters if n.partition(".")[0] == family):
            parameters[name] |= {"unit": about.unit, "meaning": about.meaning}
            parameters[name]["bounds"] = [_finite(about.lower), _finite(about.upper)]
    shapes = {name: about.shape for name, about in LayersLook.PARAMETERS.items()}
    told = {"look": {"kind": "layers", "light": "Air as a slab: `brightness ·`", "shapes": shapes}}
    unit = {} if width_unit is None else {"width_unit": width_unit}
    made = {"schema": SCHEMA, "verdict": "converged"} | told
    made |= {"photos": [{"photo": "limb.png", "scene": "limb.toml"}]}
    return made | unit | {"parameters": parameters} | changes


Writer = Callable[[dict[str, Any]], Path]


@pytest.fixture
def written(tmp_path: Path) -> Writer:
    """Writes a document as fit.json; returns its path."""

    def write(document: dict[str, Any]) -> Path:
        path = tmp_path / "fit.json"
        path.write_text(json.dumps(document))
        return path

    return write


# --- round trip through a shader ----------------------------------------------------------------


def pasted(shader: str, lines: str) -> str:
    """A shader's text without the uniforms that exported lines replace."""
    for shape, name in re.findall(r"^const highp (\w+) (\w+) = ", lines, re.MULTILINE):
        shader = re.sub(rf"^uniform {shape} {name};.*\n", "", shader, flags=re.MULTILINE)
    return shader


def drawn(
    case: Scene,
    lines: str,
    look: Look,
    depth_format: DepthFormat,
    monkeypatch: pytest.MonkeyPatch,
) -> Parity:
    """The exported shader's picture against JAX's of `look`, with what rounding explains."""
    original = _shaders._read
    own = pasted(look_text(LayersLook), lines)
    names = {name for _, name in re.findall(r"^const highp (\w+) (\w+) = ", lines, re.MULTILINE)}
    assert names >= {"brightness", "shadow", "tint", "background"}
    assert "uniform" not in own

    def read(name: str) -> str:
        text = pasted(original(name), lines)
        if name == "fields.glsl":
            return lines + text
        if name == "combine.frag":  # the frame buffer's part, where there is air
            assert "vec4(light, alpha)" in text
            return text.replace("vec4(light, alpha)", "vec4(light + background, alpha)")
        return text

    wrong = LayersLook(brightness=123.0, shadow=0.77, tint=[2.0, 0.5, 0.5], background=9.0)
    division = measure_division(case, depth_format)
    with monkeypatch.context() as patched:
        patched.setattr(_shaders, "_read", read)
        patched.setattr("render_gl._raster.look_text", lambda kind: own)
        frame = draw(case, wrong, depth_format)
    layers = frame_layers(case, frame, depth_format)
    air = np.asarray(layers.has_air)[..., None]
    whole = np.asarray(composite(layers, look))[..., :3]
    alpha = np.asarray(combine(layers, look))[..., 3:]
    parity = compare(case, look, frame, depth_format, division)
    # One addition more, ½ ulp on either side.
    adding = np.concatenate([EPS * np.abs(whole), np.zeros_like(alpha)], axis=-1)
    expected = np.concatenate([np.where(air, whole, 0), alpha], axis=-1)
    return dataclasses.replace(parity, jax=expected, bound=parity.bound + adding)


@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
@pytest.mark.parametrize("sun", [True, False], ids=["sun", "no sun"])
@pytest.mark.parametrize("with_unit", [True, False], ids=["width_unit constant", "uniform"])
def test_exported_shader_draws_the_looks_picture(
    written: Writer,
    monkeypatch: pytest.MonkeyPatch,
    depth_format: DepthFormat,
    sun: bool,
    with_unit: bool,
) -> None:
    case = scene(unit=6371.0, sun=sun)
    unit = float(case.camera.far - case.camera.near) if with_unit else None
    lines = export_text(read_fit(written(document_of(ODD, unit))), Format.glsl)
    parity = drawn(case, lines, ODD, depth_format, monkeypatch)
    assert parity.passed, parity.summary()
    assert np.max(parity.glsl) > 0.1  # comparing black with black would be no test


def test_exported_shader_draws_the_fits_picture(
    written: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = scene()
    layers = render_gl.render(case, "linear")
    found = fit(picture(layers, TRUTH), layers, START)
    document = {"schema": SCHEMA, "photo": "p.png"} | found.to_dict()
    lines = export_text(read_fit(written(document)), Format.glsl)
    parity = drawn(case, lines, found.look, "linear", monkeypatch)
    assert parity.passed, parity.summary()


@pytest.mark.parametrize(
    "constant", ["brightness", "shadow", "tint", "background", "width_unit"], ids=str
)
@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
def test_fault_one_constant_off_by_half_a_percent_is_found(
    written: Writer, monkeypatch: pytest.MonkeyPatch, constant: str, depth_format: DepthFormat
) -> None:
    case = scene()
    lines = export_text(read_fit(written(document_of(ODD, 5.5))), Format.glsl)
    line = next(
        line for line in lines.splitlines() if re.match(rf"const highp \w+ {constant} = ", line)
    )
    old = re.findall(r"-?\d+\.\d+(?:e-?\d+)?", line.split("//")[0])[-1]
    faulty = line.replace(old, float_literal(float(old) * 1.005), 1)
    assert faulty != line
    assert drawn(case, lines, ODD, depth_format, monkeypatch).passed
    assert not drawn(case, lines.replace(line, faulty), ODD, depth_format, monkeypatch).passed


# --- literals -----------------------------------------------------------------------------------

GLSL_FLOAT = re.compile(r"-?(\d+\.\d+)(e[+-]?\d+)?")
"""What airlight writes of GLSL 4.60 §4.1.4, floating constants without suffix."""

LITERALS = [
    (0.0, "0.0"),
    (-0.0, "-0.0"),
    (3.0, "3.0"),
    (-7.0, "-7.0"),
    (0.1, "0.1"),
    (1 / 3, "0.33333334"),
    (1e-30, "1.0e-30"),
    (1e30, "1.0e+30"),
    (16777217.0, "1.6777216e+07"),
    (1.1754944e-38, "1.1754944e-38"),
    (1e-45, "1.0e-45"),
    (3.4028235e38, "3.4028235e+38"),
]


@pytest.mark.parametrize(("value", "literal"), LITERALS, ids=[text for _, text in LITERALS])
def test_literals_are_the_shortest(value: float, literal: str) -> None:
    assert float_literal(value) == literal


@given(st.floats(allow_nan=False, allow_infinity=False, width=32) | st.floats(-1e30, 1e30))
@example(1e-40)
@example(-1e-45)
@example(float(np.finfo(np.float32).max))
def test_literals_read_back_as_the_same_float32(value: float) -> None:
    literal = float_literal(value)
    assert GLSL_FLOAT.fullmatch(literal)
    assert np.float32(literal).tobytes() == np.float32(value).tobytes()


@pytest.mark.parametrize("value", [1e39, -1e300, float("inf"), float("nan")])
def test_a_literal_beyond_float32_is_refused(value: float) -> None:
    with pytest.raises(InputError, match="beyond the float32"):
        float_literal(value)


def test_the_driver_reads_literals_as_the_same_float32(rng: np.random.Generator) -> None:
    """Through a real GLSL compiler, bit for bit. Subnormals may be flushed, so there are none."""
    odd = [0.1, -0.1, 3, -7, 1e-30, 1e30, 1 / 3, 16777217.0, 1.1754944e-38, 3.4028235e38]
    drawn_at_random = rng.standard_normal(118) * 10.0 ** rng.integers(-30, 30, 118)
    values = np.array([*odd, *drawn_at_random])
    listed = ", ".join(map(float_literal, values))
    vertex = """#version 330
        void main() {
            vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
            gl_Position = vec4(corner, 0.0, 1.0);
        }"""
    fragment = f"""#version 330
        const float values[{len(values)}] = float[]({listed});
        out float value;
        void main() {{ value = values[int(gl_FragCoord.x)]; }}"""

    def draw(context: moderngl.Context) -> bytes:
        shader = context.program(vertex_shader=vertex, fragment_shader=fragment)
        texture = context.texture((len(values), 1), 1, dtype="f4")
        context.framebuffer([texture]).use()
        context.enable_only(0)
        context.vertex_array(shader, []).render(vertices=3)
        return texture.read()

    assert on_gl(draw) == values.astype(np.float32).tobytes()


# --- the other formats --------------------------------------------------------------------------

LOOKS = {
    "odd": ODD,
    "default": LayersLook(),
    "one number each": LayersLook(brightness=1e-300, shadow=0.1 + 0.2, background=-5e-324),
    "integers": LayersLook(brightness=3, shadow=0, tint=(1, 2, 0), background=1e22),
}


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS.keys())
def test_toml_is_a_look_that_scenes_load_bit_for_bit(
    written: Writer, tmp_path: Path, look: LayersLook
) -> None:
    document = document_of(look, 5.5, photos=[{"photo": 'odd "name"\n\x7f é.png'}])
    document["parameters"]["exposure"] = entry(1.5)
    text = export_text(read_fit(written(document)), Format.toml)
    rest = "[camera]\nposition=[0,0,3]\nforward=[0,0,-1]\nup=[0,1,0]\nfov_y_deg=50\nwidth=16\n"
    rest += "height=8\nnear=0.5\nfar=6\n[planet]\nradius=1\n[atmosphere]\nheight=0.2\n"
    (tmp_path / "scene.toml").write_text(rest + text)
    loaded = render_gl.load_scene(tmp_path / "scene.toml").look
    for family in LayersLook.PARAMETERS:
        mine, theirs = np.asarray(getattr(look, family)), np.asarray(getattr(loaded, family))
        assert mine.shape == theirs.shape
        assert mine.tobytes() == theirs.tobytes()


def test_json_is_flat_and_ordered(written: Writer) -> None:
    document = document_of(ODD, 5.5, per_length={"brightness": 0.5})
    shuffled = dict(reversed(document["parameters"].items()))
    text = export_text(read_fit(written(document)), Format.json)
    assert export_text(read_fit(written(document | {"parameters": shuffled})), Format.json) == text
    flat = json.loads(text)
    assert flat["brightness"] == float(ODD.brightness)
    assert flat["tint.g"] == float(ODD.tint[1])
    assert flat["tint.g.stderr"] == 0.01
    assert flat["width_unit"] == 5.5
    assert all(isinstance(value, str | float) for value in flat.values())
    assert list(flat)[:4] == ["verdict", "look", "brightness", "brightness.stderr"]


def test_csv_has_a_row_for_each_number(written: Writer) -> None:
    document = document_of(ODD, 5.5)
    document["parameters"]["gamma.2"] = entry(1.0, stderr=None, free=False, role="fixed")
    rows = list(csv.DictReader(io.StringIO(export_text(read_fit(written(document)), Format.csv))))
    assert [row["name"] for row in rows][:2] == ["brightness", "shadow.r"]
    assert float(rows[0]["value"]) == float(ODD.brightness)
    assert (rows[0]["stderr"], rows[0]["free"], rows[0]["verdict"]) == ("0.01", "true", "converged")
    odd = next(row for row in rows if row["name"] == "gamma.2")
    assert (odd["stderr"], odd["free"]) == ("", "false")


# --- what else is in a fit.json -----------------------------------------------------------------

MORE = {
    "exposure.1": entry(1.0, role="fixed", free=False, stderr=None),
    "gamma.1": entry(2.2, unit="1"),
    "black_level.1": entry(0.002, unit="recorded light"),
    "exposure.2": entry(1.25),
    "gamma.2": entry(2.2, role="tied", tied_to="gamma.1", free=False, stderr=None),
    "black_level.2": entry(0.003),
}
"""The response of two photos."""


@pytest.mark.parametrize("to", list(Format))
def test_no_parameter_is_lost(written: Writer, to: Format) -> None:
    document = document_of(LayersLook())
    document["parameters"] |= MORE
    text = export_text(read_fit(written(document)), to)
    for known in MORE.values():
        assert repr(known["value"]) in text
    text.encode("ascii")


def test_response_constants_are_marked_and_named_by_photo(
    written: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = document_of(ODD, 5.5)
    document["parameters"] |= MORE
    photos = [{"photo": "a.png", "scene": "a.toml"}, {"photo": "b.png", "scene": "b.toml"}]
    text = export_text(read_fit(written(document | {"photos": photos})), Format.glsl)
    look, response = text.split("// Camera response of each photo, not part of the look:")
    assert "exposure" not in look
    assert '//   2: "b.png" with "b.toml"' in look
    names = re.findall(r"const highp (\w+ \w+) =", response)
    assert names == [f"float {n}_{k}" for k in "12" for n in ("exposure", "gamma", "black_level")]
    assert "const highp float gamma_2 = 2.2;  // tied to gamma.1" in response
    # The whole of it compiles, and the extra lines change nothing.
    assert drawn(scene(), text, ODD, "linear", monkeypatch).passed


def test_glsl_says_where_numbers_come_from_and_what_they_are(written: Writer) -> None:
    document = document_of(LayersLook(), 5.5, explained=0.98765)
    document["parameters"]["brightness"] |= {"stderr": 0.0123}
    document["parameters"]["background"] |= {"role": "held", "free": False, "stderr": None}
    text = export_text(read_fit(written(document)), Format.glsl)
    assert text.startswith('// Look of the air, fitted by airlight to "limb.png" with "limb.toml".')
    assert "// Verdict: converged.\n// Explains 98.76 % of the light's variance." in text
    assert "const highp float brightness = 3.0;  // 1/width_unit, +- 0.012; light per width" in text
    assert "const highp vec3 shadow = vec3(0.2);  // +- 0.01; light of shadowed air" in text
    assert "not told by the photo, start value" in text
    assert "multiply brightness by your own far - near over this one's" in text
    assert "const highp float width_unit = 5.5;" in text


VERSIONS = {"OpenGL 3.3": "#version 330", "OpenGL ES 3.0": "#version 300 es"}
SCENE_FACTS = {
    "color": [0.175, 0.408, 1.0, 0.9],
    "planet_radius": 6371.0,
    "atmosphere_height": 60.0,
    "atmosphere_path": "depth",
}


@pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)
@pytest.mark.parametrize("to", [Format.glsl, Format.glsl_uniform])
def test_both_forms_compile_as_they_are_and_hold_the_numbers(
    written: Writer, to: Format, version: str
) -> None:
    """By the driver's compiler; what a fragment reads is the float32 nearest to each value."""
    document = document_of(ODD, 12950.0, per_length={"brightness": 1e-5}, **SCENE_FACTS)
    lines = export_text(read_fit(written(document)), to)
    vertex = f"""{version}
        in vec2 place;
        void main() {{ gl_Position = vec4(place, 0.0, 1.0); }}"""
    fragment = f"""{version}
        {lines}
        layout(location = 0) out highp vec4 look;
        layout(location = 1) out highp vec4 air;
        layout(location = 2) out highp vec4 lengths;
        void main() {{
            look = vec4(shadow.z, tint.x, background.x, brightness);
            air = color;
            lengths = vec4(width_unit, brightness_per_length, planet_radius, atmosphere_height);
        }}"""
    told = dict(re.findall(r"^uniform highp \w+ (\w+);  // set to (.*?)(?:;|$)", lines, re.M))
    assert (to == Format.glsl) == (not told)
    assert "=" not in re.sub("//.*", "", lines) or to == Format.glsl, "no initialisers"

    def draw_one(context: moderngl.Context) -> list[np.ndarray]:
        context.enable_only(0)
        shader = context.program(vertex_shader=vertex, fragment_shader=fragment)
        for name, text in told.items():
            values = [
                float(number) for number in re.findall(r"-?[\d.]+(?:e[-+]\d+)?(?=[,)]|$)", text)
            ]
            uniform = shader[name]
            assert isinstance(uniform, moderngl.Uniform)
            shape = uniform.dimension
            values = values * shape if len(values) == 1 else values  # vec3(x) is x three times
            uniform.value = values[0] if shape == 1 else tuple(values)
        targets = [context.texture((1, 1), 4, dtype="f4") for _ in range(3)]
        context.framebuffer(targets).use()
        corners = context.buffer(np.array([-1, -1, 3, -1, -1, 3], np.float32).tobytes())
        context.vertex_array(shader, [(corners, "2f", "place")]).render()
        return [np.frombuffer(target.read(), np.float32) for target in targets]

    look, air, lengths = on_gl(draw_one)
    shadow, tint, background = (np.asarray(x) for x in (ODD.shadow, ODD.tint, ODD.background))
    wanted = [shadow[2], tint[0], background[0], ODD.brightness]
    np.testing.assert_array_equal(look, np.array(wanted, np.float32))
    np.testing.assert_array_equal(air, np.array(SCENE_FACTS["color"], np.float32))
    np.testing.assert_array_equal(lengths, np.array([12950.0, 1e-5, 6371.0, 60.0], np.float32))


@pytest.mark.parametrize("to", list(Format))
def test_what_the_look_refers_to_is_there(written: Writer, to: Format) -> None:
    document = document_of(ODD, 12950.0, **SCENE_FACTS)
    text = export_text(read_fit(written(document)), to)
    for number in ("0.175", "0.408", "0.9", "6371.0", "60.0", "12950.0"):
        assert number in text
    if to != Format.csv:
        assert ("depth" if to == Format.json else "differences of eye depth") in text


@pytest.mark.parametrize("to", [Format.glsl, Format.glsl_uniform, Format.toml, Format.json])
def test_warnings_of_the_fit_are_in_the_export(
    written: Writer, capsys: pytest.CaptureFixture[str], to: Format
) -> None:
    """A background below zero went into shaders without its warning."""
    warning = "The background came out negative: the model takes light away. \a ≤ 3.1 · 10⁻⁵ \\"
    path = written(document_of(ODD, warnings=[warning, 3]))
    text = export_text(read_fit(path), to)
    text.encode("ascii")
    words = " ".join(re.sub(r"^(//|#)", "", line) for line in text.splitlines())
    words = " ".join(words.split())
    assert "The background came out negative: the model takes light" in words
    if to != Format.json:
        assert "<= 3.1 * 10^-5" in words, "numbers stay readable"
        assert "\a" not in text
    if to == Format.toml:
        assert tomllib.loads(text)["look"]["brightness"] == float(ODD.brightness)
    assert not any(line.endswith("\\") for line in text.splitlines())
    assert airlight("export", path, "--to", to.value) == 0
    assert "warning: The background came out negative" in capsys.readouterr().err


@pytest.mark.parametrize("to", [Format.glsl, Format.toml, Format.json])
def test_several_scenes_are_told_apart(written: Writer, to: Format) -> None:
    """Of photos of several scenes the first one's colour and lengths are exported."""
    first = SCENE_FACTS | {"photo": "a.png", "scene": "a.toml", "width_unit": 5.5}
    second = first | {"photo": "b.png", "planet_radius": 6300.0}
    document = document_of(ODD, 5.5, **SCENE_FACTS, photos=[first, second])
    told = "Of photo 1 only: planet_radius. Photo 2's scene has others."
    assert told in export_text(read_fit(written(document)), to)
    alike = document | {"photos": [first, first | {"photo": "b.png"}]}
    assert "Of photo 1 only" not in export_text(read_fit(written(alike)), to)


@pytest.mark.parametrize("path", ["depth", "distance"])
def test_the_light_can_be_rebuilt_from_an_export(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], path: str
) -> None:
    """From the flat JSON and the widths of the layers alone."""
    monkeypatch.chdir(tmp_path)
    air = f'[atmosphere]\npath = "{path}"\n'
    Path("scene.toml").write_text(resized(80, 60).replace("[atmosphere]\n", air))
    assert airlight("render", "scene.toml", "-o", "photo.png") == 0
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out") == 0
    capsys.readouterr()
    assert airlight("export", "out/fit.json", "--to", "json") == 0
    look = json.loads(capsys.readouterr().out)
    assert look["atmosphere_path"] == path
    assert (look["planet_radius"], look["atmosphere_height"]) == (6371.0, 600.0)
    lit, dark = layer_widths(render_gl.read_layers("out/layers.exr"))
    shown, _ = render_gl.read_channels("out/image.exr")
    for channel in "rgb":
        rebuilt = (
            look["brightness"]
            * look[f"color.{channel}"]
            * look[f"tint.{channel}"]
            * (np.asarray(lit) + look["shadow"] * np.asarray(dark))
            + look["background"]
        )
        # Ten roundings of float32 in a product and a sum of numbers of one sign.
        np.testing.assert_allclose(rebuilt, shown[channel.upper()], rtol=10 * 6e-8, atol=1e-9)


# --- the command --------------------------------------------------------------------------------


@pytest.mark.parametrize("verdict", ["converged", "at_bound"])
def test_command_prints_the_text(
    written: Writer, capsys: pytest.CaptureFixture[str], verdict: str
) -> None:
    path = written(document_of(ODD, verdict=verdict))
    assert airlight("export", path, "--to", "glsl") == 0
    told = capsys.readouterr()
    assert told.out == export_text(read_fit(path), Format.glsl)
    assert f"Verdict: {verdict}" in told.out
    assert told.err == ""


@pytest.mark.parametrize("verdict", ["not_converged", "not_identifiable", "diverged"])
def test_command_warns_of_another_verdict_in_one_line(
    written: Writer, capsys: pytest.CaptureFixture[str], verdict: str
) -> None:
    assert airlight("export", written(document_of(ODD, verdict=verdict)), "--to", "toml") == 0
    told = capsys.readouterr()
    assert told.err.startswith("airlight: warning: ")
    assert told.err.count("\n") == 1
    assert "Take these numbers with care" in told.out
    assert "[look]" in told.out


def test_command_writes_the_file(
    written: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(document_of(ODD))
    assert airlight("export", path, "--to", "json", "-o", tmp_path / "look.json") == 0
    assert (tmp_path / "look.json").read_text() == export_text(read_fit(path), Format.json)
    assert capsys.readouterr() == ("", "")


def without(*names: str) -> dict[str, Any]:
    document = document_of(ODD)
    for name in names:
        del document["parameters"][name]
    return document


def changed(name: str, value: Any) -> dict[str, Any]:
    document = document_of(ODD)
    document["parameters"][name] = entry(value)
    return document


BAD: dict[str, tuple[str, str]] = {
    "empty": ("", "is empty"),
    "no JSON": ("{", "is no JSON file"),
    "a deep one": ("[" * 100_000, "is no JSON file"),
    "no text": ("\udcff", "is no JSON file"),
    "a list": ("[1]", "name a fit.json"),
    "no parameters": ("{}", "name a fit.json"),
    "parameters no table": ('{"parameters": [3]}', "name a fit.json"),
    "no brightness": (json.dumps(without("brightness")), "has no brightness; run the fit again"),
    "no tint.g": (json.dumps(without("tint.g")), "has tint.r and tint.b only"),
    "shadow twice": (json.dumps(changed("shadow", 0.2)), "as one number and per channel"),
    "null": (json.dumps(changed("brightness", None)), "brightness is None, not a finite number"),
    "NaN": (json.dumps(changed("tint.r", float("nan"))), "tint.r is nan, not a finite number"),
    "infinite": (json.dumps(changed("gamma", float("inf"))), "gamma is inf"),
    "a huge whole number": (json.dumps(changed("gamma", 10**400)), "not a finite number"),
    "text": (json.dumps(changed("gamma", "1.0")), "gamma is '1.0', not a finite number"),
    "true": (json.dumps(changed("gamma", True)), "gamma is True, not a finite number"),
    "another schema": (json.dumps(document_of(ODD, schema=1)), "schema is 1, and this version"),
    "no schema": (json.dumps(document_of(ODD, schema=None)), "schema is None"),
    "another verdict": (json.dumps(document_of(ODD, verdict="sideways")), "verdict is 'sideways'"),
    "no verdict": (json.dumps(document_of(ODD, verdict=["x\n"])), "verdict is ['x\\n']"),
    "an unknown parameter": (json.dumps(changed("haze", 1.0)), "'haze' is no parameter; run the"),
    "one of a fourth channel": (json.dumps(changed("tint.a", 1.0)), "'tint.a' is no parameter"),
    "no text as a name": (json.dumps(changed("\ud800", 1.0)), "is no parameter; run the fit"),
    "negative brightness": (json.dumps(changed("brightness", -1.0)), "look.brightness: "),
    "an entry without value": (
        json.dumps(document_of(ODD) | {"parameters": {"gamma": 3.0}}),
        "gamma has no value; run the fit again",
    ),
    "no data": (
        json.dumps(document_of(ODD, verdict="no_data")),
        "the verdict is no_data (there is nothing to fit)",
    ),
    "beyond float32": (json.dumps(changed("brightness", 1e39)), "brightness: 1e+39 is beyond"),
}


@pytest.mark.parametrize(("content", "told"), BAD.values(), ids=BAD.keys())
def test_bad_files_are_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: str, told: str
) -> None:
    path = tmp_path / "fit.json"
    path.write_text(content, encoding="utf-8", errors="surrogateescape")
    assert airlight("export", path, "--to", "glsl", "-o", tmp_path / "out.glsl") == 2
    error = capsys.readouterr().err
    assert told in error
    assert "fit.json" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out.glsl").exists()


def test_bad_options_are_told_in_one_line(
    written: Writer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(document_of(ODD))
    before = path.read_bytes()
    for words, told in (
        ([tmp_path / "missing.json", "--to", "csv"], "no such file; check the path"),
        ([tmp_path, "--to", "csv"], "is a folder; name a file in it"),
        (
            [path, "--to", "yaml"],
            "'yaml' is not one of 'glsl', 'glsl-uniform', 'json', 'toml', 'csv'",
        ),
        ([path], "Missing option '--to'"),
        ([path, "--to", "csv", "-o", tmp_path / "no" / "x.csv"], "no such folder"),
        ([path, "--to", "csv", "-o", tmp_path], "is no regular file"),
        ([path, "--to", "csv", "-o", path], "is the fit that is exported"),
    ):
        assert airlight("export", *words) == 2
        error = capsys.readouterr().err
        assert told in error
        assert error.count("\n") == 1
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


def test_values_do_not_depend_on_jax_precision(written: Writer) -> None:
    path = written(document_of(ODD, 5.5))
    with jax.enable_x64(True):
        wide = export_text(read_fit(path), Format.glsl)
    assert wide == export_text(read_fit(path), Format.glsl)
