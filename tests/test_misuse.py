"""Slips at the entrances of the Python interface are named, with what to give instead.

In a process of its own: here jaxtyping's hook would find most of them before airlight does.
"""

import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent


def run(*words: str) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        cwd=REPOSITORY,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_public_function_names_every_wrong_kind() -> None:
    """Eleven wrong things for each parameter."""
    *faults, count = run("-m", "tests.misuse").splitlines()
    assert faults == []
    assert int(count.removesuffix(" calls")) > 1000


SLIPS = {
    'render("scene.toml")': "scene: 'scene.toml' is a path; give "
    "render_gl.load_scene('scene.toml').scene",
    "render(file)": "scene: is a SceneFile; give its .scene",
    "render_image(scene, file)": "look: is a SceneFile; give its .look",
    "check_scene(layers, look)": "scene: is of type Layers; give a Scene, such as "
    "render_gl.load_scene(path).scene",
    "choose_format(None)": "scene: is of type NoneType; give a Scene, such as "
    "render_gl.load_scene(path).scene",
    "analytic_layers(file)": "scene: is a SceneFile; give its .scene",
    'analytic_layers(scene, "x")': "dtype: 'x' must be float32 or float64",
    "composite(scene, look)": "layers: is a Scene; give analytic_layers(scene) or "
    "render_gl.render(scene)",
    'combine("layers.exr", look)': "layers: 'layers.exr' is a path; give "
    "render_gl.read_layers('layers.exr')",
    "combine(layers, 3.0)": "look: is of type float; give a Look",
    "layer_widths(look)": "layers: is of type LayersLook; give Layers, from analytic_layers, "
    "render_gl.render or render_gl.read_layers",
    "fit(photo, file)": "layers: is of type SceneFile; give Layers, from analytic_layers, "
    "render_gl.render or render_gl.read_layers",
    'write_layers("a.exr", file)': "layers: is of type SceneFile; give Layers, from "
    "analytic_layers, render_gl.render or render_gl.read_layers",
    'write_layers("a.exr", layers, file)': "scene: is a SceneFile; give its .scene",
    'write_picture("a.exr", photo[0])': "picture: has shape (4, 3); give [h, w, 3] or [h, w, 4]",
    "load_photo(None)": "path: is of type NoneType; give the path of a file",
    "load_scene(None)": "path: is of type NoneType; give the path of a file",
    "read_layers(3)": "path: is of type int; give the path of a file",
    "Scene(scene.planet, scene.planet, scene.atmosphere)": "scene.camera: is of type Planet; "
    "give a Camera",
    "Scene(scene.camera, scene.planet, scene.atmosphere, (0, 1, 0))": "scene.sun: is of type "
    "tuple; give a Sun",
    "Layers([1.0], [2.0])": "layers.front: is of type list; give an array [h, w]",
    "Layers(photo[..., 0], photo[..., 0], planet=True)": "layers.planet: is of type bool; give an "
    "array [h, w]",
    'linearize_depth(photo, 1, 2, "windows")': "encoding: 'windows' is unknown; use one of "
    "window, reversed, linear, log",
    "linearize_depth(photo, 2, 1)": "near, far: 2 and 1 are no clip planes; give 0 < near < far",
    'Power("x")': "tone_curve.gamma: 'x' must be a finite number above 0",
}


def test_slips_are_told_apart() -> None:
    code = f"""
import numpy as np
from fit import *
from model_jax import *
from render_gl import *
file = load_scene("examples/paper.toml")
scene, look, photo = file.scene, file.look, np.ones((3, 4, 3), np.float32)
layers = Layers(photo[..., 0], photo[..., 0])
for slip in {list(SLIPS)}:
    try:
        print(eval(slip))
    except InputError as error:
        print(error)
"""
    assert run("-c", code).splitlines() == list(SLIPS.values())
