"""Scene files: what is read, and the one-line error for each kind of mistake."""

from pathlib import Path

import numpy as np
import pytest

from model_jax import InputError
from render_gl import load_scene, scene_hash, scene_record

GOOD = """
[camera]
position = [0.0, -20000.0, 0.0]
target = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
fov_y_deg = 45.0
width = 64
height = 48
near = 10000.0
far = 30000.0

[planet]
radius = 6371.0

[atmosphere]
height = 100.0

[sun]
direction = [1.0, 0.0, 0.0]
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text)
    return path


def test_defaults(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD))
    np.testing.assert_array_equal(file.scene.camera.forward, [0, 1, 0])
    assert (file.look.brightness, file.look.shadow) == (3.0, 0.2)
    assert file.scene.planet.albedo is None
    assert file.photo.path is None


def test_optional_tables_may_be_absent(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD[: GOOD.index("[sun]")]))
    assert file.scene.sun is None


def test_paths_are_relative_to_the_scene_file(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD + '[photo]\npath = "a/b.png"\n'))
    assert file.photo.path == str(tmp_path / "a/b.png")


def test_hash_follows_the_numbers_only(tmp_path: Path) -> None:
    first = load_scene(write(tmp_path, GOOD)).scene
    spaced = load_scene(write(tmp_path, "# note\n" + GOOD)).scene
    moved = load_scene(write(tmp_path, GOOD.replace("100.0", "100.5"))).scene
    assert scene_hash(first) == scene_hash(spaced) != scene_hash(moved)
    assert scene_record(first)["planet"]["radius"] == 6371.0


MISTAKES = {
    "unknown table": ("[sun]", "[sunn]", "did you mean sun"),
    "unknown key": ("radius = 6371.0", "radius = 6371.0\nradus = 1", "did you mean radius"),
    "wrong type": ("width = 64", 'width = "64"', "camera.width: '64' must be a whole number"),
    "fraction of a pixel": ("width = 64", "width = 64.5", "must be a whole number"),
    "missing key": ("near = 10000.0", "", "camera.near is missing"),
    "missing table": ("[atmosphere]\nheight = 100.0", "", r"\[atmosphere\] is missing"),
    "near beyond far": ("far = 30000.0", "far = 9000.0", "camera.far: 9000"),
    "near zero": ("near = 10000.0", "near = 0.0", "camera.near: 0"),
    "no direction": ("direction = [1.0, 0.0, 0.0]", "direction = [0, 0, 0]", "sun.direction"),
    "target at camera": ("target = [0.0, 0.0, 0.0]", "target = [0, -20000, 0]", "camera.target"),
    "both aims": ("up =", "forward = [0, 1, 0]\nup =", "either forward or target"),
    "up along the view": ("up = [0.0, 0.0, 1.0]", "up = [0, 1, 0]", "camera.up"),
    "inside the planet": ("[0.0, -20000.0, 0.0]", "[0.0, -2000.0, 0.0]", "inside the planet"),
    "negative shell": ("height = 100.0", "height = -1.0", "atmosphere.height: -1"),
    "infinite": ("radius = 6371.0", "radius = inf", "planet.radius"),
    "not a number": ("radius = 6371.0", "radius = nan", "planet.radius"),
    "field of view": ("fov_y_deg = 45.0", "fov_y_deg = 180", "camera.fov_y_deg"),
    "two numbers": ("up = [0.0, 0.0, 1.0]", "up = [0.0, 1.0]", "a list of three numbers"),
    "no toml": ("[camera]", "[camera", "is no TOML file"),
    "sun too big": ("[1.0, 0.0, 0.0]", "[1, 0, 0]\nangular_radius_deg = 90", "angular_radius"),
    "tone curve": ("[sun]", '[photo]\ntone_curve = "gamma"\n[sun]', "tone_curve: 'gamma'"),
    "look": ("[sun]", "[look]\nbrightness = -1.0\n[sun]", "look.brightness"),
    "no table": ("[camera]", "occluder = 3\n[camera]", "must be written as a"),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_named_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["paper", "reference", "epic", "iss"])
def test_examples_are_read(name: str) -> None:
    assert load_scene(f"examples/{name}.toml").scene.planet.radius > 0
