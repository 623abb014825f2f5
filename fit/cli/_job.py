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
from typing import Any

import jax.numpy as jnp
import numpy as np

import render_gl
from model_jax import (
    RESPONSE_PARAMETERS,
    Encoding,
    InputError,
    Layers,
    LayersLook,
    Look,
    Response,
    Scene,
    analytic_layers,
    find_look,
)
from model_jax._errors import printable
from render_gl._files import path_text

from .._align import aligned, aligned_camera, camera_lines
from .._auto import Auto, check_sharp
from .._choices import (
    AUTO,
    LayerSource,
    check_jpeg,
    check_loss,
    check_sampling,
    check_solver,
    check_steps,
    check_where,
)
from .._fit import fit
from .._judge import with_warnings
from .._memory import give_back, map_large_blocks
from .._result import FitResult
from ..diagnose._alignment import misaligned
from ..photo._photo import at_photo_size
from ..photo._read import load_photo
from ..report._fitted import SCHEMA
from ..report._report import report_html
from ..solve._declare import declare
from ..solve._layout import Layout
from ..solve._parameters import to_entries, to_look, to_responses
from ._outputs import prepare_folder, remove, versions, write_text
from ._written import PhotoView, write_maps, write_photo


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
    """How the layers' depths are coded; None: as their file says."""
    constant: float = 1.0
    """C of logarithmic depths."""
    look: str | None = None
    """A look by name or file, in place of the scenes'; or `AUTO`."""
    blurs: bool = False
    """Photos are blurred, by widths that are fitted."""
    source: LayerSource = "raster"
    """Where a scene's layers come from."""
    depth_format: str = "linear"
    align: bool = False
    """Scenes' cameras are turned and zoomed until limbs meet the photos'."""
    tone_curve: str | None = None
    """The photo's, if there is one; several have theirs in their scenes."""
    mask: str | None = None
    """The photo's, if there is one, as its tone curve."""
    free: tuple[str, ...] | None = None
    start: Mapping[str, float] = field(default_factory=dict)
    """Start values of look and response, by name; without one the first scene's look."""
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)
    loss: str = "linear"
    jpeg: str = "keep"
    sampling: str = "area"
    where: str = "all"
    solver: str = "lm"
    max_steps: int | None = None
    command: str = ""
    """The command line, for the report."""


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
    named = LayersLook.NAME if job.look == AUTO else job.look
    files = [render_gl.load_scene(path, named) for path in job.scenes]
    look, responses = start_values(job, files[0].look if files else _asked(named))
    asked: Any = Auto(look) if job.look == AUTO or _is_open(job, files) else look
    _check_names(job, look, responses)  # slips are found out before the work, not after
    if isinstance(asked, Auto):
        check_sharp(job.blurs)
    folder = prepare_folder(out)
    map_large_blocks()
    views: list[PhotoView] = []
    layers: list[Layers] = []
    seconds = {"render": 0.0}
    for number in range(len(job.photos)):
        progress(f"reading {job.photos[number]}")
        view = _view(job, number, files[number] if files else None)
        started = time.perf_counter()
        progress("drawing layers, {1}×{0}".format(*view.photo.shape))
        views.append(view)
        layers.append(_layers(job, view, look))
        seconds["render"] += time.perf_counter() - started
    give_back()  # the driver's
    progress("fitting")
    result = fit(
        [view.photo for view in views],
        layers,
        asked,
        free=job.free,
        response=responses,
        bounds=job.bounds,
        priors=job.priors,
        tied=job.tied,
        loss=job.loss,
        jpeg=job.jpeg,
        sampling=job.sampling,
        where=job.where,
        solver=job.solver,
        max_steps=job.max_steps,
    )
    seconds |= result.seconds
    result = with_warnings(result, _corrections(views, result))

    progress("writing the report")
    started = time.perf_counter()
    # An earlier fit.json would vouch for files that are now replaced one by one.
    remove(folder / "fit.json")
    document = _document(job, views, layers, result, seconds)
    maps = [write_maps(folder, result, number) for number in range(len(views))]
    result = replace(result, evidence=None)  # samples and layers, as large as the photos
    give_back()
    sections = [
        write_photo(folder, view, layers.pop(0), result, number, maps[number])
        for number, view in enumerate(views)
    ]
    page = report_html(document, sections, document["command"])
    render_gl.write_whole(folder / "report.html", lambda path: write_text(path, page))
    seconds["report"] = time.perf_counter() - started
    document["seconds"] = {name: round(value, 6) for name, value in seconds.items()}
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    render_gl.write_whole(folder / "fit.json", lambda path: write_text(path, text))
    return result, document


def _corrections(views: Sequence[PhotoView], result: FitResult) -> list[str]:
    """The cameras with which misaligned scenes would meet their photos."""
    return [
        f"{printable(view.scene_path or '')} meets {printable(view.name)} with "
        f"{camera_lines(aligned_camera(view.scene, photo.alignment))}."
        for view, photo in zip(views, result.photos, strict=True)
        if view.scene is not None and photo.alignment is not None and misaligned(photo.alignment)
    ]


def _asked(name: str | None) -> Look:
    """The look of a fit to layers, for which no scene says anything."""
    return LayersLook() if name is None else find_look(name)()


def _is_open(job: Job, files: Sequence[render_gl.SceneFile]) -> bool:
    """Nobody named a look, so that its terms are chosen; not with a blur, with which none are."""
    return job.look is None and not job.blurs and not any(file.names_look for file in files[:1])


def start_values(job: Job, look: Look) -> tuple[Look, tuple[Response, ...]]:
    """Look and responses to start from: the given look, with what the job says.

    Raises:
        InputError: an unknown name, or a value that the look or a response cannot have.
    """
    default: Any = RESPONSE_PARAMETERS["blur"].default
    response = Response(blur=default) if job.blurs else Response()
    parameters = declare(look, [response] * len(job.photos))
    vector = to_entries(parameters)
    for name, value in job.start.items():
        members = [p for p in parameters if name in (p.name, p.family)]
        if not members:
            known = dict.fromkeys([*(p.family for p in parameters), *(p.name for p in parameters)])
            raise InputError(f"start: {name!r} is no parameter; choose from {list(known)}")
        for p in members:
            vector[list(p.entries)] = value
    return to_look(vector, look), to_responses(vector, Layout(type(look), job.blurs))


def _check_names(job: Job, look: Look, responses: Sequence[Response]) -> None:
    """What `fit` would refuse, before anything is read or drawn."""
    declare(look, responses, free=job.free, bounds=job.bounds, priors=job.priors, tied=job.tied)
    check_loss(job.loss)
    check_jpeg(job.jpeg)
    check_sampling(job.sampling)
    check_where(job.where)
    check_solver(job.solver)
    check_steps("max-steps", job.max_steps)


def make_layers(scene: Scene, source: LayerSource, depth_format: str, look: Look) -> Layers:
    """Layers for a look, from the rasteriser or from exact intersection (which draws no relief and
    no texture)."""
    if source == "analytic":
        return analytic_layers(scene, jnp.float32, look)
    return render_gl.render(scene, depth_format, source, look)


def _view(job: Job, number: int, file: render_gl.SceneFile | None) -> PhotoView:
    """The photo; a scene's [photo] table speaks of the scene's own photo, of no other."""
    name = job.photos[number]
    own = file is not None and os.path.realpath(name) == file.photo.path
    photo = load_photo(
        replace(file.photo, path=name) if file is not None and own else name,
        job.tone_curve,
        job.mask,
    )
    if file is None:
        if job.align:
            raise InputError("align: turns a scene's camera; layers of a file have none")
        return PhotoView(path_text(name), photo, None, None)
    height, width = photo.shape
    scene = at_photo_size(file.scene, width, height, name)
    view = PhotoView(path_text(name), photo, scene, path_text(job.scenes[number]))
    return _laid_on_photo(job, view) if job.align else view


def _laid_on_photo(job: Job, view: PhotoView) -> PhotoView:
    """The view with the camera in which limbs meet."""
    assert view.scene is not None
    draw = partial(make_layers, source=job.source, depth_format=job.depth_format, look=LayersLook())
    try:
        scene, before = aligned(view.photo, view.scene, draw)
    except InputError as error:
        raise InputError(f"{view.name}: {error}") from None
    return replace(view, scene=scene, moved=before)


def _layers(job: Job, view: PhotoView, look: Look) -> Layers:
    """Drawn, or read."""
    if view.scene is not None:
        return make_layers(view.scene, job.source, job.depth_format, look)
    assert job.layers is not None
    return render_gl.read_layers(job.layers, job.near, job.far, job.encoding, job.constant)


def _document(
    job: Job,
    views: Sequence[PhotoView],
    layers: Sequence[Layers],
    result: FitResult,
    seconds: dict[str, float],
) -> dict[str, Any]:
    """The contents of fit.json; what it says of a photo at the top is of the first."""
    drawn = bool(job.scenes) and job.source != "analytic"
    made = result.to_dict()
    about = [_about(view, seen) for view, seen in zip(views, layers, strict=True)]
    photos = [facts | told for facts, told in zip(about, made["photos"], strict=True)]
    return {
        "schema": SCHEMA,
        **about[0],
        "layers": None if job.layers is None else path_text(job.layers),
        "source": job.source if job.scenes else "file",
        **made,
        "photos": photos,
        "seconds": seconds,
        "versions": versions() | ({"OpenGL": render_gl.renderer_name()} if drawn else {}),
        "command": path_text(job.command),
    }


def _about(view: PhotoView, layers: Layers) -> dict[str, Any]:
    """A photo, and what its layers are of: with the look all that its light is made from."""
    scene = view.scene
    return {
        "scene": view.scene_path,
        "scene_hash": None if view.scene is None else render_gl.scene_hash(view.scene),
        "moved": _moved(view),
        "photo": view.name,
        "tone_curve": view.photo.tone_curve.describe(),
        "color": [float(part) for part in np.asarray(layers.color)],
        "planet_radius": None if scene is None else float(scene.planet.radius),
        "atmosphere_height": None if scene is None else float(scene.atmosphere.height),
        "atmosphere_path": "depth" if layers.stretch is None else "distance",
    }


def _moved(view: PhotoView) -> dict[str, Any] | None:
    """How far the scene was off its photo, and the camera that it was given; None if its own."""
    if view.scene is None or view.moved is None:
        return None
    camera = view.scene.camera
    return view.moved.to_dict() | {
        "forward": [float(value) for value in np.asarray(camera.forward)],
        "fov_y_deg": float(camera.fov_y_deg),
    }
