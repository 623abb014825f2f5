"""From a scene to a frame: checks, and the drawing on OpenGL's thread (passes: `_raster`)."""

from typing import TYPE_CHECKING

import jax
import numpy as np

from model_jax import DriverError, InputError, Look, Scene
from model_jax._errors import shown
from model_jax._kinds import need
from model_jax._shapes import is_traced

from ._choices import SOURCES, DepthFormat, Source
from ._context import check_texture_size, on_gl
from ._depth_format import STORAGE
from ._frame import Frame
from ._raster import Passes

if TYPE_CHECKING:
    import moderngl


def draw(scene: Scene, look: Look, depth_format: DepthFormat, source: Source = "raster") -> Frame:
    """Draw a scene.

    Raises `DriverError` when there is no driver or it fails, `InputError` for a picture, texture or
    number of shadows beyond the driver's limit, unreadable maps, an unknown source, and what is
    traced.
    """
    need("scene", scene, Scene)
    need("look", look, Look)
    if source not in SOURCES:
        raise InputError(f"source {shown(source)} is unknown; use one of {', '.join(SOURCES)}")
    if is_traced(scene, look):
        raise InputError(
            "render: the scene or look is traced, and OpenGL draws numbers only; draw outside of "
            "jit, vmap and grad, or use analytic_layers"
        )
    # Host numbers: what JAX's would be rounded to is a setting of the calling thread.
    scene, look = jax.tree.map(np.asarray, (scene, look))
    return on_gl(lambda context: _draw(context, scene, look, depth_format, source))


def time_combine(scene: Scene, look: Look, depth_format: DepthFormat, repeats: int) -> list[float]:
    """Seconds of repeated combine passes; raises as `draw`. The first compiles its shaders."""
    scene, look = jax.tree.map(np.asarray, (scene, look))

    def run(context: "moderngl.Context") -> list[float]:
        try:
            passes = Passes(context, scene, look, STORAGE[depth_format], "raster")
            return passes.combine_again(repeats)
        finally:
            context.gc()

    return on_gl(run)


def _draw(
    context: "moderngl.Context",
    scene: Scene,
    look: Look,
    depth_format: DepthFormat,
    source: Source,
) -> Frame:
    check_texture_size(context, "camera", scene.camera.width, scene.camera.height)
    try:
        frame = Passes(context, scene, look, STORAGE[depth_format], source).run()
    finally:
        context.gc()  # so that a thousand renders need no more memory than one
    if (error := context.error) != "GL_NO_ERROR":
        raise DriverError(f"OpenGL reports {error} after drawing; the driver may be out of memory")
    return frame
