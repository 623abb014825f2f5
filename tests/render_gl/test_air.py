"""The shader of the look `air` against its twin, term by term, and where numbers are extreme."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_jax import InputError, Planet, Scene, combine, composite, find_look
from render_gl import (
    check_scene,
    read_channels,
    read_layers,
    render,
    render_layers_and_image,
    write_channels,
    write_layers,
)
from render_gl._draw import draw
from tests.model_jax.scenes import PLACES, RADIUS, SHAPES, scene_of

from .scenes import plant_fault

VALUES: dict[str, dict[str, Any]] = {
    "": {},
    "density": {"scale_height": 8.0},
    "density-rgb": {"scale_height": (4.0, 8.0, 16.0)},
    "top": {"top": 60.0},
    "saturation": {"extinction": (2.0, 5.0, 11.0)},
    "phase": {"aerosol": 0.3, "asymmetry": 0.7},
    "density+sun": {"scale_height": 8.0, "extinction": (2.0, 5.0, 11.0)},
    "density-rgb+top+sun": {
        "scale_height": (4.0, 8.0, 16.0),
        "top": 60.0,
        "extinction": (2.0, 5.0, 11.0),
    },
    "density+saturation+sun+upwelling+phase": {
        "scale_height": 8.0,
        "extinction": (20.0, 50.0, 110.0),
        "upwelling": 0.3,
        "aerosol": 0.4,
        "asymmetry": -0.5,
    },
    "density+top+saturation": {
        "scale_height": 8.0,
        "top": 60.0,
        "extinction": (20.0, 50.0, 110.0),
    },
    "ground": {"ground": (0.1, 0.2, 0.4)},
}

STIFF: dict[str, dict[str, Any]] = {
    "a film": {"scale_height": 1e-4 * RADIUS},
    "uniform": {"scale_height": 1e4 * RADIUS},
    "clear": {"extinction": (0.0, 1e-9, 1e-6)},
    "opaque": {"extinction": (1e2, 1e4, 1e8)},
}


DAY = (0.5, 0.9, 0.35)
"""A sun that lights the ground in view."""
TEXTURE = str(Path(__file__).parents[2] / "examples/planet_albedo.jpg")

FEW = ("in shadow and shell", "far, off axis", "thick shell")
"""Scenes of the quick suite: inside of everything, far away, and a shadow that ends in the air."""


def limb(sun: tuple[float, float, float] = (-0.3, 0.9, 0.35), **more: Any) -> Scene:
    """From 400 km up, past the limb, a shadow in the air."""
    return scene_of(
        (1.06, 0.0, 0.0),
        (0.88, 0.3, 0.0),
        sun=sun,
        shell=100.0 / RADIUS,
        size=(120, 90),
        **more,
    )


@pytest.mark.parametrize("source", ["raster", "mesh"])
@pytest.mark.parametrize("terms", VALUES)
def test_every_term_agrees_with_its_twin(terms: str, source: Any) -> None:
    kind = find_look("air" + (terms and f"+{terms}"))
    parity = check_scene(limb(), kind(**VALUES[terms]), "auto", source).parity
    assert parity.passed, parity.summary()
    assert np.any(parity.jax[..., 0])


def test_without_a_sun_it_agrees() -> None:
    kind = find_look("air+density")
    parity = check_scene(replace(limb(), sun=None), kind()).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize("depth_format", ["window24", "reversed32f", "linear"])
def test_every_format_agrees(depth_format: str) -> None:
    kind = find_look("air+density+saturation")
    parity = check_scene(limb(), kind(scale_height=20.0), depth_format).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize("case", STIFF)
def test_extreme_numbers_agree(case: str) -> None:
    values = STIFF[case]
    kind = find_look("air+density" if "scale_height" in values else "air+saturation")
    parity = check_scene(limb(), kind(**values)).parity
    assert parity.passed, parity.summary()


@pytest.mark.parametrize("name", ["scale_height", "top", "extinction", "brightness"])
def test_a_fault_of_a_percent_in_a_parameter_is_caught(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bound is not so wide that anything passes."""
    plant_fault(monkeypatch, name)
    terms = "density+top+saturation"
    parity = check_scene(limb(), find_look(f"air+{terms}")(**VALUES[terms])).parity
    assert not parity.passed


@pytest.mark.parametrize("albedo", [(0.5, 0.4, 0.2), TEXTURE])
@pytest.mark.parametrize("terms", ["ground", "density+saturation+sun+ground"])
def test_ground_is_drawn_as_composite_says(terms: str, albedo: Any) -> None:
    """What the frame buffer adds is what JAX adds: two roundings of each product more than in the
    parts, which are checked above, and light of at most 1."""
    look = find_look(f"air+{terms}")(ground=(0.2, 0.3, 0.5))
    scene = replace(limb(DAY), planet=Planet(RADIUS, albedo=albedo))
    layers, picture = render_layers_and_image(scene, look)
    assert layers.surface is not None
    assert layers.surface[np.asarray(layers.planet) == 1].max() > 0.01
    parity = check_scene(scene, look).parity
    of_passed = parity.bound[..., 4:] if parity.bound.shape[-1] > 4 else 0
    bound = parity.bound[..., :3] + np.asarray(layers.surface) * (of_passed + 4e-7)
    apart = np.abs(np.float64(picture) - np.asarray(composite(layers, look)))[..., :3]
    assert (apart <= bound + 4e-7 * picture[..., :3]).all()


@pytest.mark.parametrize("source", ["raster", "mesh"])
def test_what_lies_behind_the_air_at_night_passes_it(source: Any) -> None:
    """The sun's way dims the ground alone, also where a mesh's shell is lower than it should be."""
    scene = replace(limb(), atmosphere=replace(limb().atmosphere, height=0.01 * RADIUS))
    look = find_look("air+density+sun")(extinction=(500.0, 1000.0, 2000.0))
    frame = draw(scene, look, "linear", source)
    assert frame.transmittance is not None
    np.testing.assert_array_equal(frame.transmittance[frame.planet == 0], 1)
    assert frame.transmittance[frame.planet == 1].min() < 0.01


def test_a_file_of_layers_keeps_its_view(tmp_path: Any) -> None:
    """Every digit of it, so that the air's light is the same."""
    layers, look = render(limb()), find_look("air+density")()
    write_layers(tmp_path / "layers.exr", layers)
    again = read_layers(tmp_path / "layers.exr")
    np.testing.assert_array_equal(combine(again, look), combine(layers, look))


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"aim": {}}', '{"aim": 1, "pixel": 2}'])
def test_damaged_views_are_refused_by_name(text: str, tmp_path: Any) -> None:
    write_layers(tmp_path / "layers.exr", render(limb()))
    channels, header = read_channels(tmp_path / "layers.exr")
    kept = {name: header[name] for name in ("airlight.depth", "airlight.width_unit")}
    write_channels(tmp_path / "damaged.exr", channels, {**kept, "airlight.view": text})
    with pytest.raises(
        InputError, match=r"damaged\.exr: airlight\.view is .*; write the file anew"
    ):
        read_layers(tmp_path / "damaged.exr")


@pytest.mark.parametrize(
    "name",
    [
        name if name in FEW else pytest.param(name, marks=pytest.mark.full)
        for name in PLACES | SHAPES
    ],
)
def test_air_that_thins_out_agrees_everywhere(name: str) -> None:
    given = (PLACES | SHAPES)[name]
    height = 0.2 * given.atmosphere.height
    look = find_look("air+density+saturation")(scale_height=height, extinction=(3.0, 6.0, 12.0))
    parity = check_scene(given, look).parity
    assert parity.passed, parity.summary()


def test_a_picture_of_several_bands_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of a band know which rows of the picture they are, also where meshes give the depths."""
    from render_gl import _raster

    given = limb(fov=30.0)
    given = replace(given, atmosphere=replace(given.atmosphere, path="distance"))
    monkeypatch.setattr(_raster, "BAND", 64 * given.camera.width)
    for terms in ("", "density"):
        kind = find_look("air" + (terms and f"+{terms}"))
        parity = check_scene(given, kind(), "auto", "mesh").parity
        assert parity.passed, parity.summary()
