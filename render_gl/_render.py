"""Rendering as functions: scene → layers, scene and look → picture."""

from dataclasses import replace

import numpy as np

from model_jax import (
    DepthTextures,
    Layers,
    LayersLook,
    Look,
    Scene,
    eye_center,
    ray_stretch,
    view_of,
)
from model_jax._composite import Air, compose, ground_of
from model_jax._shapes import Rgba

from ._choices import Source
from ._depth_format import STORAGE, DepthFormat, choose_format
from ._draw import draw
from ._frame import Frame
from ._mesh_error import mesh_width_error


def render(
    scene: Scene,
    depth_format: str = "auto",
    source: Source = "raster",
    look: Look | None = None,
) -> Layers:
    """Depth layers of a scene by the paper's five passes.

    Args:
        scene: what is looked at.
        depth_format: how depths are stored; "auto" takes the cheapest format that is exact to a
            thousandth of the shell's height (`choose_format` tells which and why).
        source: "raster" finds depths on each pixel's own ray, exact to float32; "mesh" takes those
            of the meshes, as the paper does.
        look: what the layers are for: shadows are drawn only if it needs them; None: in any case.

    Returns:
        float32 layers [h, w] with the planet's mask, and `surface` when the planet has an albedo:
        its light or, for a look that lights the ground itself, the albedo; `water` when the planet
        has a mask of it and the look asks; no shadow layers when no air in view is in shadow;
        `width_error` where a mesh is in them, that is of ground with relief and of "mesh".

    Raises:
        DriverError: no usable OpenGL. InputError: what cannot be drawn, by name.
    """
    stored = choose_format(scene, depth_format).depth_format
    frame = draw(scene, LayersLook() if look is None else look, stored, source)
    return _layers(scene, frame, stored, source)


def render_image(
    scene: Scene, look: Look, depth_format: str = "auto", source: Source = "raster"
) -> Rgba:
    """The picture by OpenGL: surface + air + background, linear light [h, w, 4] float32.

    The air is the combine shader's own output; adding the rest is the frame buffer's part. Alpha is
    1 in front of the planet, the air's where there is air, else 0. Raises as `render`.
    """
    frame = draw(scene, look, choose_format(scene, depth_format).depth_format, source)
    return _picture(look, frame)


def render_layers_and_image(
    scene: Scene, look: Look, depth_format: str = "auto", source: Source = "raster"
) -> tuple[Layers, Rgba]:
    """What `render` and `render_image` return, of one drawing. Raises as `render`."""
    stored = choose_format(scene, depth_format).depth_format
    frame = draw(scene, look, stored, source)
    return _layers(scene, frame, stored, source), _picture(look, frame)


def _layers(scene: Scene, frame: Frame, depth_format: DepthFormat, source: Source) -> Layers:
    """A frame's layers, with what the meshes in them may be off by."""
    layers = frame_layers(scene, frame, depth_format)
    error = mesh_width_error(scene, source)
    return layers if error is None else replace(layers, width_error=error)


def _picture(look: Look, frame: Frame) -> Rgba:
    """Surface, air and background together, as the frame buffer adds them."""
    alpha = frame.air[..., 3:]
    air = Air(frame.air[..., :3], alpha, frame.transmittance)
    background, ground = np.asarray(look.background, np.float32), ground_of(look, frame.surface)
    rgb = np.asarray(compose(air, frame.surface, background, look.BLEND, ground))
    alpha = np.maximum(alpha, frame.planet[..., None])
    return np.concatenate([rgb, alpha], axis=-1)


def frame_layers(scene: Scene, frame: Frame, depth_format: DepthFormat) -> Layers:
    """The layers whose depths a frame's combine shader read."""
    camera = scene.camera
    # One shadow is [h, w], several are [n, h, w].
    begin, end = frame.shadows[:, 0], frame.shadows[:, 1]
    one, some = len(frame.shadows) == 1, len(frame.shadows) > 0
    textures = DepthTextures(
        front=frame.front,
        back=frame.back,
        shadow_front=(begin[0] if one else begin) if some else None,
        shadow_back=(end[0] if one else end) if some else None,
        near=camera.near,
        far=camera.far,
        encoding=STORAGE[depth_format].encoding,
        reference=eye_center(scene)[2],
    )
    return replace(
        textures.linearize(),
        surface=frame.surface,
        is_albedo=frame.is_albedo,
        planet=frame.planet,
        water=frame.water,
        color=scene.atmosphere.color,
        view=view_of(scene),
        stretch=ray_stretch(scene).astype(np.float32)
        if scene.atmosphere.path == "distance"
        else None,
    )
