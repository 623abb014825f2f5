"""Every public function given every wrong kind of thing, in a process of its own.

    python -m tests.misuse

Prints a line for each call that ends in anything but an answer or an `InputError`, and how many
calls were made. Run without pytest, whose jaxtyping hook would find most slips before airlight.
"""

import inspect
import os
import tempfile
from dataclasses import is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

import fit
import model_jax
import render_gl
from model_jax import DriverError, InputError, LayersLook, Scene, analytic_layers
from render_gl import SceneFile, load_scene

RESULTS = {fit, render_gl}
"""Their records are what airlight answers with; nobody fills them in."""

PASSED_OVER = {
    "Encoding": "a type for annotations",
    "DepthFormat": "a type for annotations",
    "Source": "a type for annotations",
    "Verdict": "an enumeration, which Python itself checks",
    "Parameter": "what a look says of its parameters, checked with the look",
    "parameter": "likewise",
    "Separable": "likewise",
    "Smooth": "likewise",
    "Look": "is abstract: a look is a subclass of it",
    "Fields": "what a look is given",
    "WidthRanges": "an answer",
    "write_whole": "takes a function",
}
"""Public names that are not tried, and why."""


def scene_file() -> SceneFile:
    return load_scene(Path(__file__).parent.parent / "examples" / "paper.toml")


def right(scene: Scene) -> dict[str, Any]:
    """An argument of each name that public functions require."""
    depth, number = np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(3, 4), 1.0
    layers = analytic_layers(scene)
    size = (scene.camera.height, scene.camera.width)
    return {
        "scene": scene,
        "camera": scene.camera,
        "planet": scene.planet,
        "atmosphere": scene.atmosphere,
        "layers": layers,
        "look": LayersLook(),
        "photo": np.ones((*size, 3), np.float32),
        "picture": np.ones((*size, 4), np.float32),
        "response": model_jax.Response(),
        "front": depth,
        "back": depth,
        "shadow_front": None,
        "shadow_back": None,
        "encoding": "window",
        "depth": depth,
        "light": np.linspace(0, 1, 9),
        "near": number,
        "far": 2.0,
        "position": (0, 0, 3),
        "forward": (0, 0, -1),
        "up": (0, 1, 0),
        "direction": (0, 1, 0),
        "center": (0, 9, 0),
        "fov_y_deg": 30.0,
        "width": 4,
        "height": 3,
        "radius": number,
        "inner": 0.0,
        "outer": 0.0,
        "gamma": number,
        "exposure": number,
        "name": "curve",
        "value": "srgb",
        "band": slice(0, 2),
        "linear": depth,
        "stored": depth,
        "path": "layers.exr",
        "channels": {"front.Z": depth},
        "attributes": {},
    }


def public(module: ModuleType) -> dict[str, Any]:
    """What a module offers that can be called and is not passed over."""
    found = {name: getattr(module, name) for name in dir(module) if not name.startswith("_")}
    return {
        name: offered
        for name, offered in found.items()
        if callable(offered)
        and name not in PASSED_OVER
        and not (isinstance(offered, type) and issubclass(offered, Exception))
        and not (is_dataclass(offered) and module in RESULTS)
    }


def methods(scene: Scene, layers: model_jax.Layers) -> dict[str, Any]:
    """Those of records that users hold, by name."""
    depth = np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(3, 4)
    curves = (
        model_jax.Srgb(),
        model_jax.Linear(),
        model_jax.Power(2.2),
        model_jax.Exposure(1.0, 2.2),
        model_jax.Sampled("curve", np.linspace(0, 1, 9)),
    )
    textures = model_jax.DepthTextures(depth, depth, None, None, 1.0, 2.0, "window")
    return {
        f"{type(record).__name__}.{name}": getattr(record, name)
        for record in (scene, scene.camera, layers, textures, LayersLook(), *curves)
        for name, method in inspect.getmembers(type(record), inspect.isfunction)
        if not name.startswith("_") and name != "air"  # which airlight calls, not its user
    }


def sweep() -> tuple[int, list[str]]:
    """How many calls were made, and those that ended in a way that helps nobody."""
    given = scene_file()
    scene = given.scene.resized(16, 12)
    known, calls, faults = right(scene), 0, []
    wrong: tuple[Any, ...]
    wrong = (
        "x.exr",
        None,
        3,
        object(),
        scene,
        given,
        LayersLook(),
        known["layers"],
        [1, "a"],
        {},
        b"x",
    )
    functions = methods(scene, known["layers"])
    for module in (model_jax, render_gl, fit):
        functions |= {f"{module.__name__}.{name}": f for name, f in public(module).items()}
    for name, function in functions.items():
        parameters = inspect.signature(function).parameters.values()
        required = {p.name: known[p.name] for p in parameters if p.default is p.empty}
        for parameter in parameters:
            for thing in wrong:
                calls += 1
                call = f"{name}({parameter.name}: {type(thing).__name__})"
                try:
                    function(**(required | {parameter.name: thing}))
                except (InputError, DriverError) as error:
                    if "\n" in str(error) or len(str(error)) > 300:
                        faults.append(f"{call}: long: {' '.join(str(error).split())}")
                except Exception as error:
                    told = " ".join(str(error).split())
                    faults.append(f"{call}: {type(error).__name__}: {told:.200}")
    return calls, faults


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        made, ends = sweep()
    print("\n".join([*ends, f"{made} calls"]))
