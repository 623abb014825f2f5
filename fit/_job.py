"""The main job from files to files: scene and photo in, a folder with the fit and its report out.

    photo + scene ──> layers ──> fit ──> fit.json, report.html, image.exr, residual.exr, layers.exr

This is where `fit` and `render_gl` meet; the core of `fit` knows arrays only.
"""

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

import render_gl
from model_jax import (
    InputError,
    Layers,
    Look,
    Scene,
    analytic_layers,
    composite,
    layer_widths,
    limb_height,
)

from ._fit import fit
from ._parameters import named_free
from ._photo import Photo, load_photo
from ._report import report_html
from ._result import FitResult
from ._solve import make_solver

Source = Literal["raster", "analytic"]
FILES = ("fit.json", "report.html", "image.exr", "residual.exr", "layers.exr")
DISTRIBUTIONS = ("airlight", "jax", "optimistix", "numpy", "moderngl", "OpenEXR")


@dataclass(frozen=True)
class Job:
    """What to fit, and how."""

    photo: str
    scene: str | None = None
    """Scene file; exactly one of scene and layers is given."""
    layers: str | None = None
    """Layer EXR of some renderer."""
    near: float | None = None
    far: float | None = None
    source: Source = "raster"
    """Where a scene's layers come from."""
    depth_format: render_gl.DepthFormat = "linear"
    tone_curve: str | None = None
    mask: str | None = None
    free: tuple[str, ...] | None = None
    solver: str = "lm"
    command: str = ""
    """The command line, for the report."""


def run_job(
    job: Job, out: str, progress: Callable[[str], None] = lambda step: None
) -> tuple[FitResult, dict[str, Any]]:
    """Do the job and write `FILES` into the folder `out`, made if need be.

    Args:
        progress: called with the name of each step as it begins.

    Returns:
        The fit and the document written to fit.json.

    Raises `InputError` or `DriverError`; each file appears whole or not at all, and fit.json last,
    so that its presence means that all are there.
    """
    # Slips in names are found out before the work, not after.
    named_free(job.free)
    make_solver(job.solver)
    folder = prepare_folder(out)
    progress("reading the photo")
    file = render_gl.load_scene(job.scene) if job.scene is not None else None
    photo = _load(job, file)
    height, width = photo.linear.shape[:2]
    started = time.perf_counter()
    progress(f"drawing layers, {width}×{height}")
    scene = _at_photo_size(file.scene, width, height, job.photo) if file is not None else None
    if scene is not None:
        layers = make_layers(scene, job.source, job.depth_format)
    else:
        assert job.layers is not None
        layers = render_gl.read_layers(job.layers, job.near, job.far)
    seconds = {"render": time.perf_counter() - started}
    progress("fitting")
    look = file.look if file is not None else Look()
    result = fit(photo, layers, look, free=job.free, solver=job.solver)
    seconds |= result.seconds

    progress("writing the report")
    started = time.perf_counter()
    picture = np.asarray(composite(layers, result.look), dtype=np.float32)
    document = _document(job, photo, scene, result, seconds)
    page = report_html(
        document,
        photo.linear,
        picture[..., :3],
        result.used,
        limb_height(scene) if scene is not None else None,
        photo.tone_curve,
        job.command,
        shadowed=_shadowed(layers),
    )
    # An earlier fit.json would vouch for files that are now replaced one by one.
    (folder / "fit.json").unlink(missing_ok=True)
    render_gl.write_whole(folder / "report.html", lambda path: _write_text(path, page))
    render_gl.write_layers(folder / "layers.exr", layers, scene)
    render_gl.write_picture(folder / "image.exr", picture, scene)
    render_gl.write_channels(
        folder / "residual.exr", _residual_channels(photo, picture, result), {}
    )
    seconds["report"] = time.perf_counter() - started
    document["seconds"] = {name: round(value, 6) for name, value in seconds.items()}
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    render_gl.write_whole(folder / "fit.json", lambda path: _write_text(path, text))
    return result, document


def make_layers(scene: Scene, source: Source, depth_format: render_gl.DepthFormat) -> Layers:
    """Layers from the rasteriser or from exact intersection (which draws no relief, no albedo)."""
    if source == "raster":
        return render_gl.render(scene, depth_format)
    return analytic_layers(scene, jnp.float32)


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {name: metadata.version(name) for name in DISTRIBUTIONS}


def _load(job: Job, file: render_gl.SceneFile | None) -> Photo:
    """The photo; a scene's [photo] table speaks of the scene's own photo, of no other."""
    curve: object = job.tone_curve
    mask = job.mask
    own = file is not None and file.photo.path is not None
    if file is not None and own and Path(job.photo).resolve() == Path(str(file.photo.path)):
        curve = curve if curve is not None else file.photo.tone_curve
        mask = mask if mask is not None else file.photo.mask
    return load_photo(job.photo, curve, mask)


def _at_photo_size(scene: Scene, width: int, height: int, photo: str) -> Scene:
    """The scene on the photo's pixel grid; another aspect ratio is another picture."""
    camera = scene.camera
    # The same aspect ratio within half a pixel of the photo's width.
    if abs(camera.width / camera.height * height - width) > 0.5:
        raise InputError(
            f"{photo}: {width}×{height} pixels have another shape than the scene's "
            f"{camera.width}×{camera.height}; crop the photo or change camera.width and height"
        )
    if (camera.width, camera.height) == (width, height):
        return scene
    return Scene(
        camera.resized(width, height), scene.planet, scene.atmosphere, scene.sun, scene.occluders
    )


def _document(
    job: Job, photo: Photo, scene: Scene | None, result: FitResult, seconds: dict[str, float]
) -> dict[str, Any]:
    """The contents of fit.json, schema 1."""
    drawn = scene is not None and job.source == "raster"
    return {
        "schema": 1,
        "scene": job.scene,
        "layers": job.layers,
        "scene_hash": render_gl.scene_hash(scene) if scene is not None else None,
        "source": job.source if scene is not None else "file",
        "photo": job.photo,
        "tone_curve": photo.tone_curve.describe(),
        **result.to_dict(),
        "seconds": seconds,
        "versions": versions() | ({"OpenGL": render_gl.renderer_name()} if drawn else {}),
        "command": job.command,
    }


def _shadowed(layers: Layers) -> Bool[np.ndarray, "h w"] | None:
    """Where most of the ray's air is in shadow; None without shadow layers."""
    lit, dark = layer_widths(layers)
    return None if dark is None else np.asarray(dark > lit)


def _residual_channels(
    photo: Photo, picture: Float[np.ndarray, "h w 4"], result: FitResult
) -> dict[str, np.ndarray]:
    """Photo minus model, linear light, and which pixels were used."""
    residual = photo.linear - picture[..., :3]
    channels = {name: residual[..., k] for k, name in enumerate("RGB")}
    return channels | {"used.Y": result.used.astype(np.float32)}


def prepare_folder(out: str) -> Path:
    """The folder, made if need be; an unwritable one is found out before the work, not after."""
    folder = Path(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be made a folder ({error.strerror}); choose another with -o"
        ) from None
    probe = folder / ".airlight-probe"
    render_gl.write_whole(probe, lambda path: _write_text(path, ""))
    probe.unlink()
    return folder


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
