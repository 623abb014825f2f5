"""The main job from files to files: scenes and photos in, a folder with the fit and its report out.

    photo + scene ──> layers ──> fit ──> fit.json, report.html, image.exr, residual.exr, layers.exr,
    (as many as there are)               influence.exr (of several photos image-1.exr …)

This is where `fit` and `render_gl` meet; the core of `fit` knows arrays only. Photos are large and
several: pictures are made in bands of rows, and of one photo at a time.
"""

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

import render_gl
from model_jax import (
    Encoding,
    InputError,
    Layers,
    Look,
    Response,
    Scene,
    analytic_layers,
    composite,
    layer_widths,
    limb_height,
    record,
)
from model_jax._shapes import AnyArray
from render_gl._files import path_text

from ._choices import LayerSource, check_jpeg, check_loss, check_sampling, check_solver, check_steps
from ._fit import fit
from ._memory import give_back, map_large_blocks
from ._outputs import prepare_folder, remove, versions, write_text
from ._parameters import declare, to_entries, to_look, to_responses
from ._photo import Photo, load_photo
from ._report import Section, photo_section, report_html
from ._result import FitResult
from ._verdict import Verdict

FILES = ("fit.json", "report.html", "image.exr", "residual.exr", "layers.exr", "influence.exr")
"""What a fit of one photo leaves; pictures of the fit where there is one, the last only where a
value was told."""

_BAND = 2**18
"""Pixels whose picture is computed at once: a few MB for each quantity on the way to it."""


@dataclass(frozen=True)
class Job:
    """What to fit, and how."""

    photos: tuple[str, ...]
    scenes: tuple[str, ...] = ()
    """Scene files, one for each photo; none where layers are given."""
    layers: str | None = None
    """Layer EXR of some renderer, for one photo."""
    near: float | None = None
    far: float | None = None
    encoding: Encoding | None = None
    """Of the layers' depths; None: as their file says."""
    constant: float = 1.0
    """Of logarithmic depths."""
    source: LayerSource = "raster"
    """Where a scene's layers come from."""
    depth_format: str = "linear"
    tone_curve: str | None = None
    """Of one photo; several have theirs in their scenes."""
    mask: str | None = None
    """Of one photo, as its tone curve."""
    free: tuple[str, ...] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    """Start values of look and response, by name; without one the first scene's look."""
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)
    loss: str = "linear"
    jpeg: str = "keep"
    sampling: str = "area"
    solver: str = "lm"
    max_steps: int | None = None
    command: str = ""
    """The command line, for the report."""


@dataclass(frozen=True)
class View:
    """A photo and how it was seen."""

    name: str
    """The photo's path as given."""
    photo: Photo
    scene: Scene | None
    """On the photo's pixel grid; None where layers came from a file."""
    scene_path: str | None


def run_job(
    job: Job, out: str, progress: Callable[[str], None] = lambda step: None
) -> tuple[FitResult, dict[str, Any]]:
    """Do the job and write its files into the folder `out`, made if need be.

    Args:
        progress: called with the name of each step as it begins.

    Returns:
        The fit, without the samples that influence maps are made from, and the document written to
        fit.json.

    Raises `InputError` or `DriverError`; each file appears whole or not at all, and fit.json last,
    so that its presence means that all are there.
    """
    files = [render_gl.load_scene(path) for path in job.scenes]
    look, responses = start_values(job, files[0].look if files else Look())
    _check_names(job, look, responses)  # slips are found out before the work, not after
    folder = prepare_folder(out)
    map_large_blocks()
    views: list[View] = []
    layers: list[Layers] = []
    seconds = {"render": 0.0}
    for number in range(len(job.photos)):
        progress(f"reading {job.photos[number]}")
        view = _view(job, number, files[number] if files else None)
        started = time.perf_counter()
        progress("drawing layers, {1}×{0}".format(*view.photo.shape))
        views.append(view)
        layers.append(_layers(job, view))
        seconds["render"] += time.perf_counter() - started
    give_back()  # the driver's
    progress("fitting")
    result = fit(
        [view.photo for view in views],
        layers,
        look,
        free=job.free,
        response=responses,
        bounds=job.bounds,
        priors=job.priors,
        tied=job.tied,
        loss=job.loss,
        jpeg=job.jpeg,
        sampling=job.sampling,
        solver=job.solver,
        max_steps=job.max_steps,
    )
    seconds |= result.seconds

    progress("writing the report")
    started = time.perf_counter()
    # An earlier fit.json would vouch for files that are now replaced one by one.
    remove(folder / "fit.json")
    document = _document(job, views, layers, result, seconds)
    maps = [_write_maps(folder, result, number) for number in range(len(views))]
    result = replace(result, evidence=None)  # samples and layers, as large as the photos
    give_back()
    sections = [
        _write_photo(folder, view, layers.pop(0), result, number, maps[number])
        for number, view in enumerate(views)
    ]
    page = report_html(document, sections, document["command"])
    render_gl.write_whole(folder / "report.html", lambda path: write_text(path, page))
    seconds["report"] = time.perf_counter() - started
    document["seconds"] = {name: round(value, 6) for name, value in seconds.items()}
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    render_gl.write_whole(folder / "fit.json", lambda path: write_text(path, text))
    return result, document


def start_values(job: Job, look: Look) -> tuple[Look, tuple[Response, ...]]:
    """Look and responses to start from: the given look, with what the job says.

    Raises:
        InputError: an unknown name, or a value that the look or a response cannot have.
    """
    parameters = declare(look, [Response()] * len(job.photos))
    vector = to_entries(parameters)
    for name, value in job.start.items():
        members = [p for p in parameters if name in (p.name, p.family)]
        if not members:
            known = dict.fromkeys([*(p.family for p in parameters), *(p.name for p in parameters)])
            raise InputError(f"start: {name!r} is no parameter; choose from {list(known)}")
        for p in members:
            vector[list(p.entries)] = value
    return to_look(vector, look), to_responses(vector)


def _check_names(job: Job, look: Look, responses: Sequence[Response]) -> None:
    """What `fit` would refuse, before anything is read or drawn."""
    declare(look, responses, free=job.free, bounds=job.bounds, priors=job.priors, tied=job.tied)
    check_loss(job.loss)
    check_jpeg(job.jpeg)
    check_sampling(job.sampling)
    check_solver(job.solver)
    check_steps("max-steps", job.max_steps)


def make_layers(scene: Scene, source: LayerSource, depth_format: str) -> Layers:
    """Layers from the rasteriser or from exact intersection (which draws no relief, no albedo)."""
    if source == "analytic":
        return analytic_layers(scene, jnp.float32)
    return render_gl.render(scene, depth_format, source)


def _view(job: Job, number: int, file: render_gl.SceneFile | None) -> View:
    """The photo; a scene's [photo] table speaks of the scene's own photo, of no other."""
    name = job.photos[number]
    own = file is not None and os.path.realpath(name) == file.photo.path
    photo = load_photo(
        replace(file.photo, path=name) if file is not None and own else name,
        job.tone_curve,
        job.mask,
    )
    if file is None:
        return View(path_text(name), photo, None, None)
    height, width = photo.shape
    scene = _at_photo_size(file.scene, width, height, name)
    return View(path_text(name), photo, scene, path_text(job.scenes[number]))


def _layers(job: Job, view: View) -> Layers:
    """Drawn, or read."""
    if view.scene is not None:
        return make_layers(view.scene, job.source, job.depth_format)
    assert job.layers is not None
    return render_gl.read_layers(job.layers, job.near, job.far, job.encoding, job.constant)


def _at_photo_size(scene: Scene, width: int, height: int, photo: str) -> Scene:
    """The scene on the photo's pixel grid; another aspect ratio is another picture."""
    camera = scene.camera
    # The same aspect ratio within half a pixel of the photo's width.
    if abs(camera.width / camera.height * height - width) > 0.5:
        raise InputError(
            f"{photo}: {width}×{height} pixels have another shape than the scene's "
            f"{camera.width}×{camera.height}; if it is cut out of such a picture, put it back into "
            "its place there and --mask the rest, for the camera looks through the picture's "
            "middle; if not, give the scene that camera's width, height and fov_y_deg"
        )
    if (camera.width, camera.height) == (width, height):
        return scene
    return Scene(
        camera.resized(width, height), scene.planet, scene.atmosphere, scene.sun, scene.occluders
    )


def _document(
    job: Job,
    views: Sequence[View],
    layers: Sequence[Layers],
    result: FitResult,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """The contents of fit.json, schema 2; what it says of a photo at the top is of the first."""
    drawn = bool(job.scenes) and job.source != "analytic"
    made = result.to_dict()
    about = [_about(view, seen) for view, seen in zip(views, layers, strict=True)]
    photos = [facts | told for facts, told in zip(about, made["photos"], strict=True)]
    return {
        "schema": 2,
        **about[0],
        "layers": None if job.layers is None else path_text(job.layers),
        "source": job.source if job.scenes else "file",
        **made,
        "photos": photos,
        "seconds": seconds,
        "versions": versions() | ({"OpenGL": render_gl.renderer_name()} if drawn else {}),
        "command": path_text(job.command),
    }


def _about(view: View, layers: Layers) -> dict[str, Any]:
    """A photo, and what its layers are of: with the look all that its light is made from."""
    scene = view.scene
    return {
        "scene": view.scene_path,
        "scene_hash": None if view.scene is None else render_gl.scene_hash(view.scene),
        "photo": view.name,
        "tone_curve": view.photo.tone_curve.describe(),
        "color": [float(part) for part in np.asarray(layers.color)],
        "planet_radius": None if scene is None else float(scene.planet.radius),
        "atmosphere_height": None if scene is None else float(scene.atmosphere.height),
        "atmosphere_path": "depth" if layers.stretch is None else "distance",
    }


@dataclass(frozen=True)
class Maps:
    """What each pixel of a photo meant to the fit."""

    influence: tuple[str, Float[np.ndarray, "h w"]] | None
    """A parameter, and its derivative by each pixel's light, summed over channels."""
    weights: Float[np.ndarray, "h w"] | None
    """How much a robust loss believed each pixel."""


def _write_maps(folder: Path, result: FitResult, number: int) -> Maps:
    """The influence map as a file, and what the report shows of it; none where nothing was told."""
    path = folder / f"influence{_ending(result, number)}"
    weights = result.weights(number) if result.loss != "linear" and result.evidence else None
    name = told_first(result)
    if name is None:
        remove(path)  # an earlier fit's
        return Maps(None, weights)
    found = result.influence(name, number)
    channels = {channel: found[..., k] for k, channel in enumerate("RGB")}
    render_gl.write_channels(path, channels, {"airlight.parameter": name})
    return Maps((name, found.sum(axis=-1)), weights)


def told_first(result: FitResult) -> str | None:
    """The parameter whose influence map is shown: the shadow weight, else the first one told."""
    names = result.correlation_names
    shadows = [name for name in names if name.startswith("shadow")]
    return next(iter([*shadows, *names]), None)


def _write_photo(
    folder: Path, view: View, layers: Layers, result: FitResult, number: int, maps: Maps
) -> Section:
    """Write the EXR files of one photo; returns its part of the report."""
    told, ending = result.photos[number], _ending(result, number)
    render_gl.write_layers(folder / f"layers{ending}", layers, view.scene)
    if result.verdict == Verdict.NO_DATA.label:
        for name in ("image", "residual"):  # an earlier fit's; of the start look nobody asked
            remove(folder / f"{name}{ending}")
        count = len(result.photos)
        return photo_section(view.name, view.photo, None, told.used, None, count=count)
    # Brightness refers to the first photo's width unit; so must the widths.
    layers = replace(jax.tree.map(np.asarray, layers), width_unit=result.width_unit)
    planes, shadowed = predict(layers, result.look, told.response, told.mix)
    del layers
    give_back()
    picture = np.moveaxis(planes, 0, -1)
    render_gl.write_picture(folder / f"image{ending}", picture, view.scene)
    section = photo_section(
        view.name,
        view.photo,
        picture[..., :3],
        told.used,
        None if view.scene is None else limb_height(view.scene, np.float32),
        shadowed=shadowed,
        influence=maps.influence,
        weights=maps.weights,
        count=len(result.photos),
    )
    channels = {}
    for k, name in enumerate("RGB"):
        np.subtract(view.photo[..., k], planes[k], out=planes[k])
        planes[k][~told.used] = 0
        channels[name] = planes[k]
    planes[3] = told.used
    channels["used.Y"] = planes[3]
    render_gl.write_channels(folder / f"residual{ending}", channels, {})
    return section


def _ending(result: FitResult, number: int) -> str:
    """Of file names: with the photo's number where there are several."""
    return f"-{number + 1}.exr" if len(result.photos) > 1 else ".exr"


def predict(
    layers: Layers,
    look: Look,
    response: Response,
    mix: Float[np.ndarray, "3 3"] | None = None,
) -> tuple[Float[np.ndarray, "4 h w"], Bool[np.ndarray, "h w"] | None]:
    """What a look and a response make of layers, and where most of the ray's air is in shadow; of a
    grey photo with the `mix` that it shows.

    In bands of rows, so that nothing but the picture is as large as the photo, and by channels, as
    files store them.

    Returns:
        Recorded light and coverage, float32; None without shadow layers.
    """
    height, width = np.shape(layers.front)
    rows = min(height, max(1, _BAND // width))
    linear = float(response.gamma) == 1
    planes = np.empty((4, height, width), np.float32)
    shadowed = np.empty((height, width), bool) if layers.has_shadow else None
    for start in range(0, height, rows):
        # The last band reaches back over the one before: one shape, one compiled program.
        band = slice(min(start, height - rows), min(start + rows, height))
        seen, shade = _predict_band(layers.rows(band), look, response, mix, linear=linear)
        planes[:, band] = np.moveaxis(np.asarray(seen), -1, 0)
        if shadowed is not None:
            shadowed[band] = shade
    return planes, shadowed


@partial(jax.jit, static_argnames="linear")
def _predict_band(
    layers: Layers, look: Look, response: Response, mix: AnyArray | None, linear: bool
) -> tuple[AnyArray, AnyArray | None]:
    seen = composite(layers, look)
    light = seen[..., :3] if mix is None else seen[..., :3] @ mix.T
    recorded = record(light, response, linear=linear)
    lit, dark = layer_widths(layers)
    shade = None if dark is None else dark > lit
    return jnp.concatenate([recorded, seen[..., 3:]], axis=-1), shade
