"""Looks as facts: what one declares decides what is drawn, read, computed and said; and nothing
outside of a look's files spells it.
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
from fit.photo._columns import take_columns
from fit.photo._pixels import choose_pixels
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
from tests.data import REPOSITORY
from tests.fit.looks import evidence_of, scene
from tests.own_looks import AIR, Glow, Steps, Veil, noisy
from tests.page import write_look

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


def test_a_parameter_named_as_another_shaders_uniform_is_its_own() -> None:
    class Sunny(Glow):
        """With a parameter that pass 3 has, too."""

        sun: Any = parameter("its colour", default=(1.0, 0.5, 0.2), shape="rgb", lower=0.0)
        GLSL = f"""
            uniform float gain;
            uniform vec3 sun;
            {AIR} {{ return gain * sun * fields.width; }}"""

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
            {AIR} {{
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


# --- nothing outside of a look's files spells it ------------------------------------------------

OWN = {f"model_jax/looks/_{name}.py" for name in ("layers", "air", "rim", "gradient")}
OWN |= {f"render_gl/glsl/looks/{name}.glsl" for name in ("layers", "air", "rim", "gradient")}

NAMES = {
    "fit/bench/_scenes.py": "synthetic photos are made by looks with known numbers",
    "fit/stress/_fit_cases.py": "photos are made by looks with known numbers",
    "fit/stress/_random_fits.py": "photos are made by looks with random numbers",
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
    "model_jax/_column.py",
    "model_jax/_sunlight.py",
    "model_jax/looks/_check.py",  # sample rays
    "render_gl/glsl/column.glsl",
    *(f"render_gl/glsl/{n}" for n in ("combine.frag", "depth.frag", "fields.glsl", "rays.glsl")),
    "render_gl/glsl/volume.vert",
    "fit/bench/_exact.py",
    "fit/stress/_render_cases.py",
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
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=REPOSITORY)
    return set(done.stdout.split()) - OWN


def test_no_product_file_spells_the_papers_look() -> None:
    assert spelled("tint|brightness") <= NAMES.keys()
    assert spelled("shadow") <= GEOMETRY | NAMES.keys()


def test_no_product_file_asks_which_look_it_is() -> None:
    """But the registry, what a scene or a call has when nobody says, and the benchmark."""
    allowed = {"model_jax/__init__.py", "model_jax/__init__.pyi", "model_jax/looks/_registry.py"}
    allowed |= {f"render_gl/_{name}.py" for name in ("render", "scene_file")}
    allowed |= {f"fit/{name}.py" for name in ("_fit", "cli/_job", "photo/_columns")}
    allowed |= {"fit/bench/_scenes.py", "fit/stress/_fit_cases.py"}
    assert spelled("LayersLook") <= allowed
