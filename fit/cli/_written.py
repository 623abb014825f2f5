"""The files of one photo that a fit leaves: layers, picture, residual, influence."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

import render_gl
from model_jax import Layers, Look, Response, Scene, composite, layer_widths, limb_height, record
from model_jax._shapes import AnyArray

from .._memory import give_back
from .._of_photo import Alignment
from .._result import FitResult
from .._verdict import Verdict
from ..diagnose._evidence import Evidence
from ..photo._photo import Photo
from ..report._report import Section, photo_section
from ._outputs import remove

_BAND = 2**18
"""Pixels whose picture is computed at once: a few MB for each quantity on the way to it."""


@dataclass(frozen=True)
class PhotoView:
    """A photo and how it was seen."""

    name: str
    """The photo's path as given."""
    photo: Photo
    scene: Scene | None
    """On the photo's pixel grid; None where layers came from a file."""
    scene_path: str | None
    moved: Alignment | None = None
    """How far the photo's limb lay beside the scene's before its camera was moved; None if it was
    not."""


@dataclass(frozen=True)
class Maps:
    """What each pixel of a photo meant to the fit."""

    influence: tuple[str, Float[np.ndarray, "h w"]] | None
    """A parameter, and its derivative by each pixel's light, summed over channels."""
    weights: Float[np.ndarray, "h w"] | None
    """How much a robust loss believed each pixel."""
    blurred: Float[np.ndarray, "h w 3"] | None = None
    """What a blurred photo would have recorded, NaN in pixels that were not used."""


def write_maps(folder: Path, result: FitResult, number: int) -> Maps:
    """The influence map as a file, and what the report shows of it; none where nothing was told."""
    path = folder / f"influence{_ending(result, number)}"
    weights = result.weights(number) if result.loss != "linear" and result.evidence else None
    blurred = None
    if isinstance(result.evidence, Evidence) and result.photos[number].response.blur is not None:
        blurred = result.evidence.predictions()[number]
    name = told_first(result)
    if name is None:
        remove(path)  # an earlier fit's
        return Maps(None, weights, blurred)
    found = result.influence(name, number)
    channels = {channel: found[..., k] for k, channel in enumerate("RGB")}
    render_gl.write_channels(path, channels, {"airlight.parameter": name})
    return Maps((name, found.sum(axis=-1)), weights, blurred)


def told_first(result: FitResult) -> str | None:
    """The parameter whose influence map is shown: one that few pixels tell, for it hangs on a field
    that not all scenes have; else the first one told."""
    names, known = result.correlation_names, type(result.look).PARAMETERS
    few = [n for n in names if (p := known.get(n.partition(".")[0])) and p.of is not None]
    return next(iter([*few, *names]), None)


def write_photo(
    folder: Path, view: PhotoView, layers: Layers, result: FitResult, number: int, maps: Maps
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
    # Of blurred pixels the fit knows what lies beside them; the others are shown sharp.
    response = replace(told.response, blur=None)
    planes, shadowed = predict_photo(layers, result.look, response, told.mix)
    if maps.blurred is not None:
        known = np.isfinite(maps.blurred).all(axis=-1)
        planes[:3, known] = maps.blurred[known].T
    del layers
    give_back()
    picture = np.moveaxis(planes, 0, -1)
    render_gl.write_picture(folder / f"image{ending}", picture, view.scene, result.look)
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
    """How a photo's file names end: with its number where there are several."""
    return f"-{number + 1}.exr" if len(result.photos) > 1 else ".exr"


def predict_photo(
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
