"""Looks as facts: what one declares decides what is drawn, read, computed and said; one with an
error is refused by name; and nothing outside of a look's files spells it.
"""

import json
import pickle
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import render_gl
from fit import fit
from fit.photo._pixels import choose_pixels, take_columns
from fit.report._export import Format, export_text
from fit.report._fitted import read_fit
from fit.solve._declare import declare
from fit.solve._reduce import BINS
from model_jax import (
    Fields,
    InputError,
    Layers,
    LayersLook,
    Look,
    Response,
    Separable,
    analytic_layers,
    composite,
    load_look,
    looks,
    parameter,
)
from model_jax.looks._check import check_look
from render_gl import check_scene
from render_gl._draw import draw
from render_gl._looks import look_text
from tests.command import airlight
from tests.data import REPOSITORY
from tests.fit.looks import evidence_of, scene
from tests.page import blocks, write_look, write_scene

_AIR = "vec3 air(Fields fields, inout float alpha, inout vec3 transmittance)"


class Glow(Look):
    """Air that shines by its width, lit or not."""

    gain: float = parameter("light per width", unit="1/width_unit", default=2.0, lower=0.0)
    NEEDS = ("width",)
    LINEAR_IN = ("width",)
    ROUNDINGS = (2.0, 0.0)
    GLSL = f"uniform float gain;\n{_AIR} {{ return gain * fields.color * fields.width; }}"

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        return self.gain * fields.color * fields.width, None


class Steps(Look):
    """Light by a table over the width."""

    table: Any = parameter("light at widths of 0, ¼, ½ …", default=(0.0, 0.4, 0.6, 0.7), shape=4)
    NEEDS = ("width",)
    ROUNDINGS = (8.0, 4.0)
    GLSL = f"""
        uniform float table[4];
        {_AIR} {{
            float at = clamp(fields.width * 12.0, 0.0, 3.0);
            int k = min(int(at), 2);
            return fields.color * (table[k] + (at - float(k)) * (table[k + 1] - table[k]));
        }}"""

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        at = jnp.clip(fields.width * 12.0, 0.0, 3.0)
        k = jnp.minimum(at.astype(np.int32), 2)
        low, high = self.table[k], self.table[k + 1]
        return fields.color * (low + (at - k) * (high - low)).astype(fields.width.dtype), None


class Veil(Look):
    """A coat with an alpha of its own, and less before the planet."""

    cover: float = parameter("alpha of one width", unit="1/width_unit", default=1.5, lower=0.0)
    ground: float = parameter(
        "share that is left before the planet", default=0.5, lower=0.0, upper=1.0
    )
    NEEDS = ("lit", "dark", "planet")
    ROUNDINGS = (16.0, 8.0)
    BLEND = "over"
    GLSL = f"""
        uniform float cover;
        uniform float ground;
        {_AIR} {{
            float share = 1.0 - fields.planet * (1.0 - ground);
            alpha = 1.0 - exp(-cover * (fields.lit + fields.dark) * share);
            return fields.color * (fields.lit / (fields.lit + fields.dark + 0.01));
        }}"""

    def air(self, fields: Fields) -> tuple[jax.Array, None]:
        share = 1.0 - fields.planet * (1.0 - self.ground)
        alpha = 1 - jnp.exp(-self.cover * (fields.lit + fields.dark) * share)
        light = fields.color * (fields.lit / (fields.lit + fields.dark + 0.01))
        return jnp.concatenate([light, alpha], axis=-1), None


def noisy(layers: Layers, look: Look, seed: int = 0) -> np.ndarray:
    light = np.asarray(composite(layers, look))[..., :3]
    return light + np.random.default_rng(seed).normal(scale=0.003, size=light.shape)


# --- facts and what follows from them -----------------------------------------------------------


def test_a_look_that_needs_no_shadow_has_none_anywhere() -> None:
    case = scene()
    assert draw(case, LayersLook(), "linear").shadows.shape[0] == 1
    assert draw(case, Glow(), "linear").shadows.shape[0] == 0
    assert not render_gl.render(case, "linear", look=Glow()).has_shadow
    layers = analytic_layers(case)
    assert layers.has_shadow
    assert not analytic_layers(case, look=Glow()).has_shadow
    photo = noisy(layers, Glow(gain=1.7))
    used = choose_pixels(photo, layers).used
    columns = take_columns(photo, layers, used, float(layers.width_unit), Glow)
    assert list(columns.fields) == ["width"]
    assert [p.family for p in declare(Glow(), [Response()])][:2] == ["gain", "background"]
    result = fit(photo, layers, Glow())
    assert result.verdict == "converged", result.message
    assert "edge of the shadow" not in result.excluded
    assert set(result.correlation_names) == {"gain", "background"}
    assert result.parameters["gain"].value == pytest.approx(1.7, abs=5e-3)
    assert check_scene(case, Glow(), "window24").passed


def test_reductions_follow_from_the_facts() -> None:
    """Sums where the look is linear in its fields, bins of one or two fields, else pixels."""
    layers = analytic_layers(scene())
    for look, free, rows in (
        (Glow(), None, 1 + 1 + 3),
        (Steps(), ["table.1", "table.2"], BINS + 1),
        (Veil(), ["cover"], None),
    ):
        result = fit(noisy(layers, look), layers, look, free=free)
        problem = evidence_of(result).point.problem
        count = int(np.asarray(problem.reduced.count).sum())
        assert count == len(problem.columns[0].index) if rows is None else count <= rows


def test_a_table_is_drawn_fitted_and_exported(tmp_path: Path) -> None:
    case = scene()
    assert check_scene(case, Steps(), "linear").parity.passed
    layers = analytic_layers(case)
    truth = (0.05, 0.5, 0.8, 0.75)
    result = fit(noisy(layers, Steps(table=np.array(truth))), layers, Steps(), free=["table"])
    assert result.verdict == "converged", result.message
    for k, value in enumerate(truth):
        estimate = result.parameters[f"table.{k + 1}"]
        assert abs(estimate.value - value) < 5 * (estimate.stderr or 0)
    document = {"schema": 3, "photo": "p.png"} | result.to_dict()
    (tmp_path / "fit.json").write_text(json.dumps(document))
    fitted = read_fit(tmp_path / "fit.json")
    assert "const highp float table[4] = float[4](0.0" in export_text(fitted, Format.glsl)
    assert "uniform highp float table[4];  // set to float[4](" in export_text(
        fitted, Format.glsl_uniform
    )
    assert re.search(r"^table = \[0\.0\d+, ", export_text(fitted, Format.toml), re.MULTILINE)


def test_alpha_and_blend_reach_the_picture_on_both_sides() -> None:
    """`surface (1 - alpha) + light alpha`, in JAX, by the shader and in a fit."""
    case = render_gl.load_scene(REPOSITORY / "examples" / "paper.toml").scene.resized(96, 72)
    layers = render_gl.render(case, "linear", look=Veil())
    assert layers.surface is not None
    look = Veil(cover=2.0)
    assert check_scene(case, look, "linear").parity.passed
    drawn, made = render_gl.render_image(case, look, "linear"), np.asarray(composite(layers, look))
    np.testing.assert_allclose(drawn, made, atol=1e-5)
    alone = np.asarray(composite(Layers(layers.front, layers.back, planet=layers.planet), look))
    assert not np.allclose(made[..., :3], alone[..., :3], atol=1e-2)
    layers = jax.tree.map(lambda part: np.asarray(part, np.float64), layers)
    result = fit(noisy(layers, Veil(cover=2.0, ground=0.3)), layers, Veil(), sampling="point")
    assert result.verdict == "converged", result.message
    for name, value in (("cover", 2.0), ("ground", 0.3)):
        estimate = result.parameters[name]
        assert abs(estimate.value - value) < 5 * (estimate.stderr or 0)


def test_a_field_that_layers_lack_is_named() -> None:
    layers = analytic_layers(scene())
    bare = Layers(layers.front, layers.back)
    with pytest.raises(InputError, match=r"do not tell planet from space.*planet"):
        composite(bare, Veil())
    with pytest.raises(InputError, match="do not tell planet from space"):
        fit(np.ones((*np.shape(bare.front), 3)), bare, Veil())


@pytest.mark.parametrize("kind", looks().values(), ids=looks().keys())
def test_a_built_in_look_is_what_it_says(kind: type[Look]) -> None:
    check_look(kind)
    assert look_text(kind)


# --- errors by name -----------------------------------------------------------------------------

FAULTS: dict[str, tuple[str, str, str]] = {
    "parameter without uniform": ("glsl", "uniform float kappa;\n", ""),
    "uniform of another type": ("glsl", "uniform vec3 tint", "uniform float tint"),
    "uniform that is no parameter": (
        "glsl",
        "uniform float kappa",
        "uniform float fog;\nuniform float kappa",
    ),
    "no function": ("glsl", "vec3 air(", "vec3 fog("),
    "name of a shader's own": ("both", "kappa", "plane_depths"),
    "no GLSL": ("glsl", "exp(", "exp2pow("),
    "field that NEEDS lacks": ("py", '("lit", "dark")', '("dark", "width")'),
    "unknown field": ("py", '("lit", "dark")', '("lit", "dark", "haze")'),
    "gradient that is not finite": (
        "py",
        "jnp.exp(-self.kappa * (",
        "jnp.exp(-self.kappa * jnp.sqrt(",
    ),
    "light that is not finite": ("py", "light = 1 -", "light = jnp.log(fields.lit) -"),
    "false linearity": ("py", "    ROUNDINGS", '    LINEAR_IN = ("lit", "dark")\n    ROUNDINGS'),
    "blend without alpha": ("py", "    ROUNDINGS", '    BLEND = "over"\n    ROUNDINGS'),
    "no name": ("py", "    ROUNDINGS", '    NAME = "Haze 2"\n    ROUNDINGS'),
    "no annotation": ("py", "kappa: float =", "kappa ="),
    "no roundings": ("py", "    ROUNDINGS = (14.0, 8.0)\n", ""),
    "default of another shape": ("py", "default=1.0, lower", "default=(1.0, 2.0), lower"),
    "a name that is taken": ("py", "kappa", "gamma"),
    "light of another shape": ("py", "return light,", "return light[..., :2],"),
    "no pair": (
        "py",
        "return light, jnp.exp(-self.kappa * (fields.lit + fields.dark))",
        "return light",
    ),
    "a word of GLSL": ("py", "kappa", "half"),
    "a transmittance of another shape": (
        "py",
        "return light, jnp.exp(",
        "return light, jnp.ones((1, 2)) * (",
    ),
    "an air that fails": ("py", "return light,", "return light.fog,"),
    "a transmittance above 1": ("py", "return light, jnp.exp(-", "return light, jnp.exp("),
    "too many roundings": ("py", "(14.0, 8.0)", "(14.0, 1e9)"),
    "a table of one": ("py", "default=1.0, lower", "default=(1.0,), shape=1, lower"),
    "a mark of the preprocessor": (
        "glsl",
        "uniform float kappa",
        "#include <fog>\nuniform float kappa",
    ),
    "no Python": ("py", "class Haze", "klass Haze"),
    "no look": ("py", "class Haze(Look)", "class Haze(object)"),
}
SAID = {
    "parameter without uniform": "no uniform for the parameter kappa; add `uniform float kappa;`",
    "uniform of another type": "declares tint as float; write `uniform vec3 tint;`",
    "uniform that is no parameter": "has a uniform fog, which is no parameter",
    "name of a shader's own": "the parameter plane_depths has a name that airlight's shaders use",
    "no function": "defines no function `vec3 air(",
    "no GLSL": "does not compile",
    "field that NEEDS lacks": "fields.lit: is not in the look's NEEDS; add it there",
    "unknown field": "no field is called 'haze'; there are width, lit, dark, planet",
    "gradient that is not finite": "the gradient by field dark is not finite at the defaults",
    "light that is not finite": "light or transmittance is not finite at the defaults",
    "false linearity": "light is not linear in lit, dark; correct LINEAR_IN",
    "blend without alpha": "BLEND is 'over', and air returns no alpha",
    "no name": "NAME is 'Haze 2'; give small letters",
    "no annotation": "kappa has no annotation; write kappa: float",
    "no roundings": "ROUNDINGS is (0.0, 0.0); give two numbers",
    "default of another shape": "parameter kappa has the default (1.0, 2.0); give one number",
    "a name that is taken": "parameter gamma has a name that is taken",
    "light of another shape": "air returns light of shape",
    "no pair": "air returns no pair",
    "a word of GLSL": "parameter half has a name that is taken",
    "a transmittance of another shape": "air returns a transmittance of shape (",
    "an air that fails": "air cannot be run (AttributeError",
    "a transmittance above 1": "transmittance leaves 0 to 1 at the defaults",
    "too many roundings": "ROUNDINGS is (14.0, 1000000000.0); give two numbers",
    "a table of one": "has the shape 1; give",
    "a mark of the preprocessor": "does not compile",
    "no Python": "cannot be run (SyntaxError",
    "no look": "must define one look, a subclass of Look; it defines none",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_look_with_an_error_is_refused_by_name(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_look(tmp_path)
    write_scene(tmp_path)
    ending, right, wrong = FAULTS[fault]
    endings = ("py", "glsl") if ending == "both" else (ending,)
    for path in (tmp_path / f"haze.{ending}" for ending in endings):
        text = path.read_text()
        assert right in text
        path.write_text(text.replace(right, wrong))
    if ending == "both":
        Path("scene.toml").write_text(blocks("toml")[0].replace(right, wrong))
    assert airlight("render", "scene.toml", "--look", "haze.py", "-o", "out.png") == 2
    told = capsys.readouterr().err
    assert SAID[fault] in told, told
    assert "haze" in told.lower()
    assert told.count("\n") == 1
    assert not Path("out.png").exists()


def test_linearity_at_the_defaults_alone_is_refused() -> None:
    class Bent(Glow):
        """Linear where `bend` is 0."""

        bend: float = parameter("second order", default=0.0)
        LINEAR_IN = ("width",)

        def air(self, fields: Fields) -> tuple[Any, Any]:
            return self.gain * fields.color * fields.width * (1 + self.bend * fields.width), None

    with pytest.raises(InputError, match="look bent: light is not linear in width"):
        check_look(Bent)


def test_the_nearest_class_says_what_a_parameter_is() -> None:
    class Less(Glow):
        """Less of it."""

        gain: float = parameter("half of it at most", default=0.1, lower=0.0, upper=0.5)

    assert Less.PARAMETERS["gain"].upper == 0.5
    assert list(Less.PARAMETERS) == ["gain", "background"]
    assert Glow.PARAMETERS["gain"].upper == np.inf
    with pytest.raises(InputError, match="parameter background has a name that is taken"):

        class Own(Glow):
            """Another background."""

            background: float = parameter("own", default=0.1)


def test_a_parameter_named_as_another_shaders_uniform_is_its_own() -> None:
    class Sunny(Glow):
        """With a parameter that pass 3 has, too."""

        sun: Any = parameter("its colour", default=(1.0, 0.5, 0.2), shape="rgb", lower=0.0)
        GLSL = f"""
            uniform float gain;
            uniform vec3 sun;
            {_AIR} {{ return gain * sun * fields.width; }}"""

        def air(self, fields: Fields) -> tuple[Any, Any]:
            return self.gain * self.sun * fields.width, None

    case = render_gl.load_scene(REPOSITORY / "examples" / "paper.toml").scene.resized(64, 48)
    with_it, without = draw(case, Sunny(), "linear"), draw(case, Glow(), "linear")
    assert with_it.surface is not None
    np.testing.assert_array_equal(with_it.surface, without.surface)
    assert check_scene(case, Sunny(), "linear").parity.passed


@pytest.mark.parametrize("path", ["depth", "distance"])
def test_an_alpha_of_its_own_is_bounded_as_light_is(path: str) -> None:
    """By errors of the fields too: lengths along rays, and the widths that two shadows leave."""

    class Sheet(Look):
        """Opaque at a width."""

        gain: float = parameter("alpha of one width", default=2.0, lower=0.0)
        NEEDS = ("width",)
        ROUNDINGS = (3.0, 0.0)
        BLEND = "over"
        GLSL = f"""
            uniform float gain;
            {_AIR} {{
                alpha = min(gain * fields.width, 1.0);
                return fields.color;
            }}"""

        def air(self, fields: Fields) -> tuple[Any, Any]:
            alpha = jnp.minimum(self.gain * fields.width, 1.0)
            light = jnp.broadcast_to(fields.color, (*alpha.shape[:-1], 3))
            return jnp.concatenate([light, alpha], axis=-1), None

    base = scene()
    case = replace(base, atmosphere=replace(base.atmosphere, path=path))
    for depth in ("window24", "reversed32f", "linear"):
        parity = check_scene(case, Sheet(gain=5.0), depth).parity
        assert parity.passed, parity.summary()
        drawn = parity.glsl[..., 3]
        assert ((drawn > 0) & (drawn < 1)).any()
        assert (parity.bound[..., 3] < 1e-3 * np.maximum(drawn, 1e-2)).all()


def test_two_files_of_one_name_are_two_looks(tmp_path: Path) -> None:
    kinds = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        path = write_look(tmp_path / folder)
        text = (tmp_path / folder / "haze.glsl").read_text()
        (tmp_path / folder / "haze.glsl").write_text(f"// {folder}\n{text}")
        kinds.append(load_look(path))
    assert [look_text(kind).splitlines()[0] for kind in kinds] == ["// a", "// b"]
    for kind in kinds:
        again = pickle.loads(pickle.dumps(kind()))
        assert type(again) is kind


def test_a_false_product_is_refused() -> None:
    class Squared(LayersLook):
        """Not linear in its weight."""

        SEPARABLE = Separable("brightness", "tint", "shadow", "lit", "dark")

        def air(self, fields: Fields) -> tuple[Any, Any]:
            return self.brightness * fields.color * self.tint * (
                fields.lit + self.shadow**2 * fields.dark
            ), None

    with pytest.raises(InputError, match="look squared: SEPARABLE: the light is not that product"):
        check_look(Squared)


def test_scenes_run_no_code_and_name_what_they_miss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_scene(tmp_path)
    write_look(tmp_path)
    assert airlight("render", path, "-o", tmp_path / "out.png") == 2
    assert "'haze' is unknown; choose from layers, install" in capsys.readouterr().err
    path.write_text(blocks("toml")[0].replace('"haze"', '"haze.py"'))
    assert airlight("render", path, "-o", tmp_path / "out.png") == 2
    assert "is a Python file; write the look's name there" in capsys.readouterr().err
    path.write_text(blocks("toml")[0].replace("kappa", "cappa"))
    assert airlight("render", path, "--look", tmp_path / "haze.py", "-o", tmp_path / "o.png") == 2
    assert "unknown key 'cappa'; did you mean kappa?" in capsys.readouterr().err


def test_another_look_than_the_scenes_starts_at_its_defaults(tmp_path: Path) -> None:
    path = write_scene(tmp_path)
    write_look(tmp_path)
    kind = load_look(tmp_path / "haze.py")
    assert render_gl.load_scene(path, tmp_path / "haze.py").look.kappa == 0.5
    plain = render_gl.load_scene(path, "layers").look
    assert isinstance(plain, LayersLook)
    assert plain.brightness == 3.0
    assert kind is load_look(tmp_path / "haze.py")


# --- nothing outside of a look's files spells it ------------------------------------------------

OWN = ("model_jax/looks/_layers.py", "render_gl/glsl/looks/layers.glsl")

NAMES = {
    "fit/bench/_case.py": "the race is run with the look `layers`, whose optimum is known",
    "fit/bench/_peers.py": "likewise",
    "fit/bench/_race.py": "likewise",
    "model_jax/__init__.py": "shows how the package is used",
    "fit/diagnose/_patterns.py": "the word for how bright something is",
    "fit/report/templates/report.html": "the word for how bright something is",
}
"""Files with the words brightness or tint, and why."""

GEOMETRY = {
    *(f"model_jax/_{n}.py" for n in ("analytic", "fields", "intersect", "layers", "safe", "scene")),
    *(f"model_jax/_{name}.py" for name in ("shapes", "tolerance", "view")),
    *(f"render_gl/_{n}.py" for n in ("draw", "frame", "layers_file", "mesh", "parity", "raster")),
    *(f"render_gl/_{name}.py" for name in ("render", "scene_file", "shaders", "uniforms")),
    *(f"render_gl/glsl/{n}" for n in ("combine.frag", "depth.frag", "fields.glsl", "rays.glsl")),
    "render_gl/glsl/volume.vert",
    "fit/cli/_written.py",  # which pixels are mostly in shadow
    "fit/photo/_pixels.py",  # edges of the shadow
    "fit/photo/_widths.py",
    "fit/report/_panels.py",  # lit pixels and those in shadow apart
    "fit/report/_report.py",
    "fit/report/templates/report.html",
}
"""Files in which a shadow is a volume that a body casts."""


def spelled(word: str) -> set[str]:
    """Product files in which a word stands."""
    folders = ("model_jax", "render_gl", "fit", "airlight")
    command = ["git", "grep", "-l", "-w", "-E", word, "--", *folders]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=REPOSITORY)
    return set(done.stdout.split()) - set(OWN)


def test_no_product_file_spells_the_papers_look() -> None:
    assert spelled("tint|brightness") <= NAMES.keys()
    assert spelled("shadow") <= GEOMETRY | NAMES.keys()


def test_no_product_file_asks_which_look_it_is() -> None:
    """But the registry, what a scene or a call has when nobody says, and the race."""
    allowed = {"model_jax/__init__.py", "model_jax/__init__.pyi", "model_jax/looks/_registry.py"}
    allowed |= {f"render_gl/_{name}.py" for name in ("render", "scene_file")}
    allowed |= {f"fit/{name}.py" for name in ("_fit", "cli/_job", "photo/_pixels")}
    allowed |= {f"fit/bench/_{name}.py" for name in ("case", "race")}
    assert spelled("LayersLook") <= allowed
