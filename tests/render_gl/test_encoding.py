"""Depths of other renderers: what they are coded as is used, and what cannot be is refused."""

from collections.abc import Callable
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import render_gl
from model_jax import (
    Camera,
    Encoding,
    InputError,
    Layers,
    Planet,
    Scene,
    analytic_layers,
    layer_widths,
)

from ..fit.looks import scene

NEAR, FAR = 0.5, 6.0
full = pytest.mark.full

CODES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "window": lambda z: FAR / (FAR - NEAR) * (1 - NEAR / z),
    "window inf": lambda z: 1 - NEAR / z,
    "reversed": lambda z: NEAR * (FAR - z) / (z * (FAR - NEAR)),
    "reversed inf": lambda z: NEAR / z,
    "log": lambda z: np.log1p(z) / np.log1p(FAR),
    "log 0.01": lambda z: np.log1p(0.01 * z) / np.log1p(0.01 * FAR),
    "linear": lambda z: z,
}


@pytest.fixture(scope="module")
def looked_past() -> Scene:
    """The planet off the picture's middle, as in most photos."""
    camera = scene().camera
    aside = Camera(
        position=(0, 0, 3), forward=(0.2, 0.1, -1), up=(0, 1, 0), fov_y_deg=50,
        width=camera.width, height=camera.height, near=NEAR, far=FAR,
    )  # fmt: skip
    return Scene(aside, scene().planet, scene().atmosphere, scene().sun)


@pytest.fixture(scope="module")
def exact(looked_past: Scene) -> Layers:
    return analytic_layers(looked_past)


def write(path: Path, layers: Layers, kind: str) -> Path:
    """A layer file of another renderer: four depths, and nothing in its header."""

    def code(depths: object) -> np.ndarray:
        return CODES[kind](np.asarray(depths, np.float64) + float(layers.reference))

    channels: dict[str, object] = {"front.Z": layers.front, "back.Z": layers.back}
    channels |= {"shadow_front.Z": layers.shadow_front, "shadow_back.Z": layers.shadow_back}
    render_gl.write_channels(path, {name: code(d) for name, d in channels.items()}, {})
    return path


def options(kind: str) -> dict[str, Any]:
    encoding, _, more = kind.partition(" ")
    if encoding == "linear":
        return {"encoding": "linear"}
    far = inf if more == "inf" else FAR
    found: dict[str, Any] = {"near": NEAR, "far": far, "encoding": encoding}
    return found | ({"constant": float(more)} if encoding == "log" and more else {})


@pytest.mark.parametrize("kind", CODES)
def test_every_encoding_gives_the_same_widths(kind: str, exact: Layers, tmp_path: Path) -> None:
    """Half an ulp of a code near 1 is 3e-8; of z ≈ 3 that is 3e-8 z² / NEAR = 5e-7 in window depths
    and 3e-8 · log(FAR + 1) · (z + 1) in logarithmic ones, and z itself rounds by 1e-7. A width has
    two depths, or four."""
    found = render_gl.read_layers(write(tmp_path / "a.exr", exact, kind), **options(kind))
    for got, true in zip(layer_widths(found), layer_widths(exact), strict=True):
        unit = float(found.width_unit) / float(exact.width_unit)
        np.testing.assert_allclose(np.asarray(got) * unit, np.asarray(true), atol=4 * 6e-7 * 6)


@pytest.mark.parametrize("said", [kind for kind in CODES if kind != "linear"])
@pytest.mark.parametrize("kind", [kind for kind in CODES if kind != "linear"])
def test_another_encoding_is_refused_by_the_name_of_the_right_one(
    kind: str, said: str, exact: Layers, tmp_path: Path
) -> None:
    if kind == said or (kind == "log 0.01" and "inf" in said) or (kind == "log" and "inf" in said):
        return  # with an infinite far plane there is no logarithmic depth to compare with
    if "inf" in said and "inf" not in kind:
        return  # and no finite one
    path = write(tmp_path / "a.exr", exact, kind)
    encoding, _, more = kind.partition(" ")
    remedy = f"--encoding {encoding}"
    remedy += " --far inf" if more == "inf" and "inf" not in said else ""
    remedy += f" --constant {more}" if encoding == "log" and more else ""
    told = f"no sphere's.* with {remedy}; give that|say how depths are coded"
    with pytest.raises(InputError, match=told):
        render_gl.read_layers(path, **options(said))


@pytest.mark.parametrize("kind", ["window", "window inf", "reversed", "reversed inf", "log"])
def test_coded_depths_are_no_eye_depths(kind: str, exact: Layers, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"0 to 1, as coded depths are|the sign of the depths"):
        render_gl.read_layers(write(tmp_path / "a.exr", exact, kind))


@pytest.mark.parametrize(
    ("depth", "triangles"),
    [
        pytest.param(*case, marks=() if case in (("window16", 2000), ("linear", 20000)) else full)
        for case in product(("window16", "window24", "reversed32f", "linear"), (2000, 20000))
    ],
)
def test_layers_of_meshes_and_of_16_bits_are_let_through(
    depth: render_gl.DepthFormat, triangles: int, looked_past: Scene, tmp_path: Path
) -> None:
    planet = Planet(1.0, triangles=triangles)
    coarse = Scene(looked_past.camera, planet, looked_past.atmosphere, looked_past.sun)
    layers = render_gl.render(coarse, depth, "mesh")
    for kind in CODES:
        render_gl.read_layers(write(tmp_path / "a.exr", layers, kind), **options(kind))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"near": 0.5, "far": inf, "encoding": "log"}, "log depths have no infinite far plane"),
        ({"near": 0.5, "far": 6.0, "encoding": "log", "constant": 0.0}, r"is 0\.0; give"),
        (
            {"near": 6.0, "far": 0.5},
            r"near < far, not near 6.0 and far 0\.5; give --near and --far",
        ),
        ({"near": inf, "far": inf}, "clip planes 0 < near < far, not near inf"),
        ({"near": np.nan, "far": 6.0}, "clip planes 0 < near < far, not near nan"),
    ],
)
def test_what_cannot_be_is_named(
    given: dict[str, Any], told: str, exact: Layers, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=told):
        render_gl.read_layers(write(tmp_path / "a.exr", exact, "window"), **given)


def test_files_of_other_renderers(data_dir: Path) -> None:
    """`log_depth_layers.exr` was taken for window depths, and brightness was 4.9 times off."""
    cases = data_dir / "cases"
    exact = analytic_layers(render_gl.load_scene(cases / "small.toml").scene)
    width = np.asarray(layer_widths(exact)[0]) * float(exact.width_unit)
    with pytest.raises(InputError, match="with --encoding log; give that"):
        render_gl.read_layers(cases / "log_depth_layers.exr", 8100.0, 21050.0)
    files: list[tuple[str, float, float, Encoding]] = [
        ("log_depth_layers.exr", 8100.0, 21050.0, "log"),
        ("reversed_infinite_layers.exr", 8100.0, inf, "reversed"),
    ]
    for name, near, far, encoding in files:
        layers = render_gl.read_layers(cases / name, near, far, encoding)
        found = np.asarray(layer_widths(layers)[0]) * float(layers.width_unit)
        # float32 codes of log(z + 1) / log(far + 1) resolve 0.01 km at these depths.
        np.testing.assert_allclose(found, width, atol=0.06)
    with pytest.raises(InputError, match="with --encoding reversed --far inf; give that"):
        render_gl.read_layers(
            cases / "reversed_infinite_layers.exr", 8100.0, 21050.0, encoding="reversed"
        )


def test_an_unknown_encoding_in_the_header_is_named(exact: Layers, tmp_path: Path) -> None:
    channels = {"front.Z": np.asarray(exact.front), "back.Z": np.asarray(exact.back)}
    render_gl.write_channels(tmp_path / "a.exr", channels, {"airlight.depth": "w"})
    with pytest.raises(InputError, match="coded as 'w' are not read; use one of window, reversed"):
        render_gl.read_layers(tmp_path / "a.exr")
