"""The shader of the look `gradient` against its twin."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from model_jax import InputError, Look, Scene, composite, find_look
from render_gl import (
    check_scene,
    load_scene,
    read_layers,
    render_image,
    render_layers_and_image,
    write_layers,
)
from render_gl._depth_format import STORAGE
from render_gl._exr import read_channels
from render_gl._looks import look_text
from render_gl._maps import load_gradient
from render_gl._shaders import shader_source
from render_gl._uniforms import defines_of
from tests.data import REPOSITORY
from tests.model_jax.scenes import PLACES

from .scenes import by_chance, plant_fault

EXAMPLES = REPOSITORY / "examples"
WHOLE = "gradient+table+mie+lamp+veil"
TERMS = (
    "gradient", "gradient+table", "gradient+mie", "gradient+veil", "gradient+mie+lamp",
    "gradient+table+mie+veil", WHOLE,
)  # fmt: skip


def example() -> Scene:
    return load_scene(EXAMPLES / "gradient.toml").scene.resized(160, 128)


def drawn_by_chance(seed: int) -> tuple[Scene, Look, str, Any]:
    """A scene, numbers, format and source from all over their ranges; of a lamp those inside the
    planet and far from it, for beside one the direction to it is as uncertain as one likes."""
    rng = np.random.default_rng(seed)
    scene = by_chance(rng)
    kind = find_look(str(rng.choice(TERMS)))
    values: dict[str, Any] = {
        "falloff": rng.uniform(0, 3),
        "tint": rng.dirichlet([2.0, 2.0, 2.0]) * 3,
        "opacity": rng.uniform(0, 2),
        "stretch": rng.uniform(0, 1),
        "tweak": rng.uniform(0, 0.5),
        "asymmetry": rng.uniform(-0.95, 0.95),
        "light_distance": rng.choice([rng.uniform(0, 0.9), rng.uniform(10, 1e4)]),
    } | {name: rng.uniform(0, 1, 31) for name in ("red", "green", "blue", "cover")}
    look = kind(**{name: value for name, value in values.items() if name in kind.PARAMETERS})
    form = str(rng.choice(["linear", "reversed32f", "auto"]))
    return scene, look, form, "mesh" if seed % 3 == 0 else "raster"


@pytest.mark.parametrize("terms", TERMS)
def test_every_term_agrees_with_its_twin_on_the_example(terms: str) -> None:
    parity = check_scene(example(), find_look(terms)()).parity
    assert parity.passed, parity.summary()
    assert np.ptp(parity.jax[..., 0]) > 0.1
    assert parity.summary()["bound_relative"] < 2e-4


@pytest.mark.parametrize("name", ["paper", "rim", "epic", "reference"])
def test_it_agrees_with_its_twin_on_the_other_examples(name: str) -> None:
    scene = load_scene(EXAMPLES / f"{name}.toml").scene
    scene = scene.resized(96, round(96 * scene.camera.height / scene.camera.width))
    parity = check_scene(scene, find_look(WHOLE)()).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize("seed", range(30))
def test_shader_and_twin_agree_wherever_chance_puts_them(seed: int) -> None:
    scene, look, form, source = drawn_by_chance(seed)
    parity = check_scene(scene, look, form, source).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize(
    "name",
    [
        *("falloff", "opacity", "stretch", "asymmetry", "light_distance"),
        *("red", "green", "blue", "cover"),
    ],
)
def test_a_fault_of_a_percent_in_a_parameter_is_caught(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant_fault(monkeypatch, name)
    # The document's lamp stands next to the centre, where a percent of its way is nothing.
    lamp = find_look(WHOLE)(light_distance=0.5)
    assert not check_scene(example(), lamp).parity.passed


@pytest.mark.parametrize("source", ["raster", "mesh"])
@pytest.mark.parametrize("form", ["linear", "window24"])
def test_the_picture_is_what_composite_makes_of_its_layers(
    form: str, source: Any, tmp_path: Path
) -> None:
    """By the blend *one, inverse source alpha*: light lies over what of the ground alpha lets
    pass; from a file, too."""
    look = find_look(WHOLE)()
    layers, picture = render_layers_and_image(example(), look, form, source)
    np.testing.assert_allclose(composite(layers, look), picture, atol=1e-5)
    write_layers(tmp_path / "layers.exr", layers, example(), picture, look)
    _, header = read_channels(tmp_path / "layers.exr")
    assert header["airlight.blend"] == "premultiplied"
    assert header["airlight.look"] == WHOLE
    np.testing.assert_array_equal(
        composite(read_layers(tmp_path / "layers.exr"), look), composite(layers, look)
    )


def test_the_sky_hides_what_lies_behind_it_by_its_own_alpha() -> None:
    """A veil without light darkens the ground, one without cover brightens it."""
    scene = example()
    plain = render_image(scene, find_look("gradient")())[..., :3]
    dark = render_image(scene.resized(160, 128), find_look("gradient+veil")(opacity=5.0))[..., :3]
    clear = render_image(scene, find_look("gradient+veil")(opacity=0.0))[..., :3]
    assert (clear >= plain - 1e-6).all()
    assert (dark <= clear + 1e-6).all()
    assert (dark < clear - 0.05).any()


def test_a_camera_in_the_air_has_a_shader_without_the_near_point() -> None:
    """What INSIDE leaves out is asked for by no line, and the compiler drops it."""
    kind = find_look("gradient+veil")
    for place, inside in (("near", False), ("in the shell", True)):
        defines = defines_of(PLACES[place], kind, STORAGE["linear"], 0)
        assert ("INSIDE" in defines) == inside
        text = shader_source("combine.frag", defines, look_text(kind))
        assert ("#define INSIDE" in text) == inside
        assert check_scene(PLACES[place], kind(), "linear").parity.passed


def test_terms_that_are_not_there_are_not_compiled() -> None:
    plain = look_text(find_look("gradient"))
    for word in ("table_at", "asymmetry", "light_distance", "reach", "cover"):
        assert word not in plain
        assert word in look_text(find_look(WHOLE))


def test_a_scene_names_the_texture_of_its_sky(tmp_path: Path) -> None:
    """Codes over the highest, row 0 the air's edge; what is written beside it counts more."""
    u, v = np.meshgrid(np.arange(256) / 255, np.arange(64) / 63)
    painted = np.stack([0.2 + 0.6 * u, 0.8 - 0.3 * u, 0.4 + 0.5 * v, 0.3 + 0.7 * v], axis=-1)
    Image.fromarray(np.round(255 * painted).astype(np.uint8)).save(tmp_path / "sky.png")
    text = (EXAMPLES / "gradient.toml").read_text()
    text = text.replace('"planet_albedo.jpg"', "[0.2, 0.2, 0.2]")
    path = tmp_path / "scene.toml"
    path.write_text(text.replace("falloff = 1.5", 'texture = "sky.png"'))
    look = load_scene(path).look
    light = look.falloff / 1.5 * np.asarray(look.tint)
    np.testing.assert_allclose(light, [0.8, 0.5, 0.9], atol=0.01)
    night = light * [look.red[0], look.green[0], look.blue[0]]
    np.testing.assert_allclose(night, [0.2, 0.8, 0.4], atol=0.01)
    assert look.cover[0] == pytest.approx(0.3, abs=0.01)
    path.write_text(text.replace("stretch = 0.25", 'texture = "sky.png"'))
    assert load_scene(path).look.falloff == 1.5
    for wrong, says in (
        ('texture = "none.png"', r"look.texture: .*none.png: no such file"),
        ("texture = 3", r"look.texture: 3 must be a string"),
        ('texture = "scene.toml"', r"look.texture: .*is no PNG, JPEG"),
    ):
        path.write_text(text.replace("falloff = 1.5", wrong))
        with pytest.raises(InputError, match=says):
            load_scene(path)


def test_a_gradient_without_alpha_covers() -> None:
    grey = load_gradient(str(EXAMPLES / "planet_water.png"))
    assert grey.shape[-1] == 4
    assert (grey[..., 3] == 1).all()
    assert (grey[..., 0] == grey[..., 2]).all()
    color = load_gradient(str(EXAMPLES / "planet_albedo.jpg"))
    assert (color[..., 0] != color[..., 2]).any()
