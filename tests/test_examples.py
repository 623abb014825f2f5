"""Every example runs, and shows what it is there to show."""

import importlib.util
import json
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import render_gl
from fit import fit, load_photo
from fit.cli._job import Job, run_job
from model_jax import Layers, LayersLook, Look, analytic_layers, combine, find_look

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(scene: str, photo: Path, out: Path, look: str = "layers") -> dict:
    job = Job(photos=(str(photo),), scenes=(str(EXAMPLES / scene),), look=look)
    _, document = run_job(job, str(out))
    assert json.loads((out / "fit.json").read_text())["verdict"] == document["verdict"]
    return document


def test_gradient_example_descends() -> None:
    done = subprocess.run(
        [sys.executable, EXAMPLES / "gradient.py"],
        capture_output=True,
        text=True,
        check=True,
        cwd=EXAMPLES.parent,
    )
    losses = [float(line.split()[-1]) for line in done.stdout.splitlines() if "loss at" in line]
    assert losses[1] < 0.01 * losses[0]


@pytest.mark.parametrize(
    ("name", "size"), [("paper", (1280, 1024)), ("rim", (640, 512)), ("gradient", (640, 512))]
)
def test_scenes_of_documents_pass_the_check(name: str, size: tuple[int, int]) -> None:
    file = render_gl.load_scene(EXAMPLES / f"{name}.toml")
    assert (file.scene.camera.width, file.scene.camera.height) == size
    found = render_gl.check_scene(file.scene, file.look)
    assert found.passed, found.summary()


@pytest.mark.parametrize(
    "name",
    [
        "paper",
        "rim",
        "gradient",
        *(pytest.param(n, marks=pytest.mark.full) for n in ("reference", "epic", "iss")),
    ],
)
def test_no_gradient_is_nan_on_any_example(name: str) -> None:
    file = render_gl.load_scene(EXAMPLES / f"{name}.toml")
    scene, kind = file.scene, type(file.look)
    camera = scene.camera
    scene = scene.resized(camera.width // 4, camera.height // 4)
    layers = analytic_layers(scene)

    def loss(layers: Layers, look: Look) -> jax.Array:
        return jnp.sum(combine(layers, look) ** 2)

    floats = eqx.filter(layers, lambda leaf: isinstance(leaf, jax.Array))
    rest = eqx.filter(layers, lambda leaf: not isinstance(leaf, jax.Array))
    by_layers = jax.jit(jax.grad(lambda a, look: loss(eqx.combine(a, rest), look), (0, 1)))
    gradients = by_layers(floats, kind())
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))
    light = jax.grad(lambda s: jnp.sum(combine(analytic_layers(s), kind())))
    by_scene = eqx.filter_jit(light)(scene)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(by_scene))
    assert any(np.any(leaf) for leaf in jax.tree.leaves(by_scene))


def test_reference_picture_is_what_its_script_makes() -> None:
    """The committed picture, averaged to 36×27 blocks, against a coarse march of the same scene."""
    march = example("march_reference")
    photo = load_photo(EXAMPLES / "reference.png")
    scene = tomllib.loads((EXAMPLES / "reference.toml").read_text())
    coarse = march.EXPOSURE * march.march(scene, 144, 108, 24)
    blocks = photo.linear.reshape(108, 5, 144, 5, 3).mean(axis=(1, 3))
    # Blocks average what the coarse march samples at their centres; the ring's profile bends within
    # a block, and 24 samples are off by 2 % of the peak (see the script's docstring).
    assert np.sqrt(np.mean((coarse - blocks) ** 2)) < 0.02 * blocks.max()


def test_reference_fit(tmp_path: Path) -> None:
    """Air of 8 km marched with two constituents, many scatterings and ozone: a slab does not match
    it, and air that thins out and dims itself finds the 8 km within 15 %."""
    slab = run("reference.toml", EXAMPLES / "reference.png", tmp_path / "slab")
    assert slab["verdict"] == "misfit"
    assert slab["explained"] < 0.5
    look = "air+density+saturation"
    document = run("reference.toml", EXAMPLES / "reference.png", tmp_path / "air", look)
    assert document["explained"] > 0.7
    assert document["parameters"]["scale_height"]["value"] == pytest.approx(8.0, rel=0.15)
    assert (EXAMPLES / "reference.png").stat().st_size < 1_000_000


@pytest.mark.parametrize(("density", "tolerance"), [(1.0, 0.05), (1e-3, 1e-3)])
def test_reduced_march_gives_its_scale_height_back(
    density: float, tolerance: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Molecules alone, light scattered once, the limb below the sun: what is left that the look
    does not have is dimming on the sun's way, a vertical optical depth of up to 0.26 (blue), which
    costs 2 %; a thousandth of the air has none. Towards the terminator, where the sun's way is as
    long as the eye's, it costs 12 %."""
    march = example("march_reference")
    monkeypatch.setattr(march, "RAYLEIGH_SCATTERING", density * march.RAYLEIGH_SCATTERING)
    monkeypatch.setattr(march, "AEROSOL_SCATTERING", 0.0)
    monkeypatch.setattr(march, "AEROSOL_EXTINCTION", 0.0)
    monkeypatch.setattr(march, "OZONE_ABSORPTION", np.zeros(3))
    monkeypatch.setattr(march, "SCATTERING_ORDERS", 1)
    toward = {"target": [2550.0, 5840.0, 120.0], "up": [0.0, 1.0, -0.5]}
    parsed = tomllib.loads((EXAMPLES / "reference.toml").read_text())
    parsed["camera"] |= toward
    light = march.march(parsed, 360, 270, 48)
    scene = render_gl.load_scene(EXAMPLES / "reference.toml").scene.resized(360, 270)
    away = np.array(toward["target"]) - scene.camera.position
    camera = replace(scene.camera, forward=away, up=np.array(toward["up"]))
    air = replace(scene.atmosphere, height=march.AIR_TOP)
    layers = analytic_layers(replace(scene, camera=camera, atmosphere=air))
    look = find_look("air+density+saturation")
    found = fit((light / light.max()).astype(np.float32), layers, look(), sampling="point")
    assert found.verdict == "converged", found.message
    assert found.explained > 0.999
    assert found.parameters["scale_height"].value == pytest.approx(
        march.RAYLEIGH_SCALE_HEIGHT, rel=tolerance
    )


def test_sunlit_air_is_the_march_of_one_constituent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Molecules alone, light scattered once, a black ground and a sun that is a point: every pixel
    within 1 % of the brightest, from the limb below the sun across the terminator; without the
    sun's way some are wrong by more than all of it."""
    march = example("march_reference")
    monkeypatch.setattr(march, "AEROSOL_SCATTERING", 0.0)
    monkeypatch.setattr(march, "AEROSOL_EXTINCTION", 0.0)
    monkeypatch.setattr(march, "OZONE_ABSORPTION", np.zeros(3))
    monkeypatch.setattr(march, "SCATTERING_ORDERS", 1)
    monkeypatch.setattr(march, "GROUND_ALBEDO", 0.0)
    parsed = tomllib.loads((EXAMPLES / "reference.toml").read_text())
    parsed["sun"]["angular_radius_deg"] = 0.0
    light = march.march(parsed, 120, 90, 96)
    scene = render_gl.load_scene(EXAMPLES / "reference.toml").scene.resized(120, 90)
    air = replace(
        scene.atmosphere, height=march.AIR_TOP, path="distance", color=(1.0, 1.0, 1.0, 1.0)
    )
    assert scene.sun is not None
    sun = replace(scene.sun, angular_radius_deg=0.0)
    layers = analytic_layers(replace(scene, atmosphere=air, sun=sun))
    depth = march.RAYLEIGH_SCATTERING * float(layers.width_unit)
    values = {
        "scale_height": march.RAYLEIGH_SCALE_HEIGHT,
        "extinction": depth,
        "brightness": float(depth.mean()) / (4 * np.pi),
        "tint": depth / depth.mean(),
        "shadow": 0.0,
        "aerosol": 0.0,
    }
    for terms, holds in (("density+saturation+sun+phase", True), ("density+saturation+phase", 0)):
        drawn = np.asarray(combine(layers, find_look(f"air+{terms}")(**values)))[..., :3]
        error = np.abs(drawn - light).max() / light.max()
        assert error < 0.01 if holds else error > 1, error


def test_epic_disc_lies_on_the_photos_limb(data_dir: Path) -> None:
    scenes = example("make_photo_scenes")
    photo = data_dir / scenes.EPIC_PHOTO
    assert scenes.limb_rms(EXAMPLES / "epic.toml", photo) < scenes.THRESHOLD_PX == 1.0
    for shift in ((2, 0), (0, 2), (-2, 0), (0, -2)):
        assert scenes.limb_rms(EXAMPLES / "epic.toml", photo, shift) > scenes.THRESHOLD_PX


def test_a_disc_off_the_axis_lies_on_its_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of AS11-44-6692, a fifth in size: where it is seen, an ellipse is a circle to 0.2 px."""
    monkeypatch.syspath_prepend(str(EXAMPLES))
    x, y, radius = 178.0, 393.0, 303.8
    scene = example("photos").disc((x, y, radius), 734.0, 400, 6371.0, (128, 77))
    planet = np.asarray(analytic_layers(scene).planet) != 0
    rows, columns = np.nonzero(planet[1:] != planet[:-1])  # an edge half a pixel below the upper
    off = np.hypot(columns - x, rows + 0.5 - y) - radius
    assert len(off) > 300
    assert np.abs(off).max() < 0.2 + 0.5


def test_epic_fit(tmp_path: Path, data_dir: Path) -> None:
    scenes = example("make_photo_scenes")
    photo = data_dir / scenes.EPIC_PHOTO
    document = run("epic.toml", photo, tmp_path)
    assert document["verdict"] == "misfit"  # the air of a slab, and no planet's
    assert document["explained"] < 0.5


@pytest.mark.full  # 13.6 megapixels, half of the time for writing its noise
def test_iss_photo_does_not_tell_the_shadow_weight(tmp_path: Path, data_dir: Path) -> None:
    scenes = example("make_photo_scenes")
    photo = data_dir / scenes.ISS_PHOTO
    assert scenes.limb_rms(EXAMPLES / "iss.toml", photo) < scenes.THRESHOLD_PX
    document = run("iss.toml", photo, tmp_path)
    shadow = document["parameters"]["shadow"]
    assert document["verdict"] == "converged"
    assert (shadow["free"], shadow["stderr"], shadow["value"]) == (False, None, 0.2)
    assert [item["what"] for item in document["left_out"]] == ["shadow"]


def test_rendered_linear_layers_give_the_look_back(tmp_path: Path) -> None:
    """Step 1: brightness 3.0 and shadow 0.2 to 1e-4 from a GLSL-rendered linear EXR."""
    file = render_gl.load_scene(EXAMPLES / "paper.toml")
    scene = file.scene.resized(320, 256)
    picture = render_gl.render_image(scene, file.look, "linear")
    layers = render_gl.render(scene, "linear")
    render_gl.write_layers(tmp_path / "layers.exr", layers, scene)
    render_gl.write_picture(tmp_path / "photo.exr", picture)
    photo = load_photo(tmp_path / "photo.exr")
    result = fit(photo, render_gl.read_layers(tmp_path / "layers.exr"))
    assert result.verdict == "converged"
    for name, truth in (("brightness", 3.0), ("shadow", 0.2)):
        assert result.parameters[name].value == pytest.approx(truth, rel=1e-4)


@pytest.mark.usefixtures("x64")
def test_exact_layers_give_the_look_back_to_1e8() -> None:
    scene = render_gl.load_scene(EXAMPLES / "paper.toml").scene
    scene = scene.resized(320, 256)
    layers = analytic_layers(scene, jnp.float64)
    result = fit(np.asarray(combine(layers, LayersLook()))[..., :3], layers)
    for name, truth in (("brightness", 3.0), ("shadow", 0.2)):
        assert result.parameters[name].value == pytest.approx(truth, rel=1e-8)
