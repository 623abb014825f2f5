"""The shader of the look `rim` against its twin, the ground it lights, and the water it mirrors the
sun by."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from model_jax import InputError, Look, Occluder, Scene, composite, find_look
from render_gl import (
    check_scene,
    load_scene,
    read_layers,
    render,
    render_layers_and_image,
    write_layers,
)
from render_gl._maps import load_water
from tests.data import REPOSITORY

from .scenes import by_chance, plant_fault

EXAMPLES = REPOSITORY / "examples"
WHOLE = "rim+gradient+specular"
TERMS = ("rim", "rim+gradient", "rim+specular", "rim+single", WHOLE, f"{WHOLE}+single")


def example() -> Scene:
    return load_scene(EXAMPLES / "rim.toml").scene.resized(160, 128)


def drawn_by_chance(seed: int) -> tuple[Scene, Look, str, Any]:
    """A scene, numbers, format and source from all over their ranges."""
    rng = np.random.default_rng(seed)
    scene = by_chance(rng)
    kind = find_look(str(rng.choice(TERMS)))
    values: dict[str, Any] = {
        "brightness": rng.uniform(0, 10),
        "tint": rng.dirichlet([2.0, 2.0, 2.0]) * 3,
        "opacity": rng.uniform(),
        "exponent": rng.uniform(0, 20),
        "slump": rng.uniform(0, 90),
        "specular": rng.uniform(0, 2),
        "shininess": rng.uniform(1, 100),
    } | {name: rng.uniform(0, 3, 9) for name in ("red", "green", "blue")}
    look = kind(**{name: value for name, value in values.items() if name in kind.PARAMETERS})
    form = str(rng.choice(["linear", "reversed32f", "auto"]))
    return scene, look, form, "mesh" if seed % 3 == 0 else "raster"


@pytest.mark.parametrize("terms", TERMS)
def test_every_term_agrees_with_its_twin_on_the_example(terms: str) -> None:
    parity = check_scene(example(), find_look(terms)()).parity
    assert parity.passed, parity.summary()
    assert np.ptp(parity.jax[..., 0]) > 0.1
    assert parity.summary()["bound_relative"] < 5e-4


@pytest.mark.parametrize("seed", range(30))
def test_shader_and_twin_agree_wherever_chance_puts_them(seed: int) -> None:
    scene, look, form, source = drawn_by_chance(seed)
    parity = check_scene(scene, look, form, source).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize("name", ["opacity", "exponent", "slump", "red", "specular", "shininess"])
def test_a_fault_of_a_percent_in_a_parameter_is_caught(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant_fault(monkeypatch, name)
    assert not check_scene(example(), find_look(WHOLE)()).parity.passed


@pytest.mark.parametrize("source", ["raster", "mesh"])
@pytest.mark.parametrize("form", ["linear", "window24"])
def test_the_picture_is_what_composite_makes_of_its_layers(form: str, source: Any) -> None:
    """Albedo, light on it, coat and glint: by the traditional blend on both sides."""
    look = find_look(WHOLE)()
    layers, picture = render_layers_and_image(example(), look, form, source)
    assert layers.is_albedo
    np.testing.assert_allclose(composite(layers, look), picture, atol=1e-5)
    # The surface is bright in the night too: the sun is the look's.
    lit = render(example(), form, source)
    assert layers.surface is not None
    assert lit.surface is not None
    assert not lit.is_albedo
    dark = np.asarray(layers.planet) * (np.asarray(lit.surface).max(-1) == 0) == 1
    assert dark.any()
    assert np.median(np.asarray(layers.surface)[dark].max(axis=-1)) > 0.02


def test_water_is_drawn_where_it_is_asked_for(tmp_path: Path) -> None:
    scene, look = example(), find_look("rim+specular")()
    layers = render(scene, look=look)
    assert layers.water is not None
    water, planet = np.asarray(layers.water), np.asarray(layers.planet)
    assert (water[planet == 0] == 0).all()
    assert 0.2 < water[planet == 1].mean() < 0.8
    # Open sea is dark in the map of albedo, land is not.
    red = np.asarray(layers.surface)[..., 0]
    assert np.median(red[water == 1]) < 0.2 * np.median(red[(planet == 1) & (water == 0)])
    assert render(scene, look=find_look("rim")()).water is None
    assert render(scene).water is None
    write_layers(tmp_path / "layers.exr", layers, scene)
    again = read_layers(tmp_path / "layers.exr")
    assert again.is_albedo
    np.testing.assert_array_equal(again.water, water)
    np.testing.assert_array_equal(composite(again, look), composite(layers, look))


def test_a_moon_has_no_water() -> None:
    scene, look = example(), find_look("rim+specular")()
    camera = np.asarray(scene.camera.position)
    moon = Occluder(0.7 * camera, 500.0)
    plain, hidden = (
        np.asarray(render(case, look=look).water)
        for case in (scene, replace(scene, occluders=(moon,)))
    )
    assert hidden[64, 80] == 0
    assert (hidden < plain).any()
    assert (hidden <= plain).all()


def test_a_mask_may_be_an_alpha_channel(tmp_path: Path) -> None:
    grey = np.arange(8, dtype=np.uint8).reshape(2, 4) * 32
    colors = np.random.default_rng(0).integers(0, 255, (2, 4, 3), np.uint8)
    pictures = {
        "grey": grey,
        "grey and alpha": np.stack([255 - grey, grey], axis=-1),
        "colours and alpha": np.concatenate([colors, grey[..., None]], axis=-1),
        "three equal": np.stack([grey] * 3, axis=-1),
    }
    for name, picture in pictures.items():
        path = tmp_path / f"{name}.png"
        Image.fromarray(picture).save(path)
        np.testing.assert_allclose(load_water(str(path)), grey / 255, atol=2**-11)
    Image.fromarray(colors).save(tmp_path / "colours.png")
    with pytest.raises(InputError, match="is a colour picture without alpha; save the mask"):
        load_water(str(tmp_path / "colours.png"))
    np.save(tmp_path / "mask.npy", grey.astype(np.float32))
    with pytest.raises(InputError, match=r"holds float32 numbers; save the mask"):
        load_water(str(tmp_path / "mask.npy"))
