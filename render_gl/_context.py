"""The headless OpenGL context: one per process, opened when first needed.

EGL needs no display; Mesa's llvmpipe serves where there is no GPU. `moderngl` is imported here and
in the drawing modules only, so that reading scenes and layer files works without OpenGL.
"""

import os
from functools import cache
from typing import TYPE_CHECKING, Any

from model_jax import DriverError

if TYPE_CHECKING:
    import moderngl

MINIMUM_VERSION = 330
"""OpenGL 3.3 core: float colour attachments, texelFetch, depth clamp."""


@cache
def gl_context() -> "moderngl.Context":
    """The process's context.

    Raises `DriverError` with the command that installs a software driver when none can be opened.
    """
    # Mesa's shader cache writes into the home folder, which a build machine may not have.
    os.environ.setdefault("MESA_SHADER_CACHE_DISABLE", "true")
    try:
        import moderngl

        # moderngl's stub types these settings as dicts; they are strings.
        settings: dict[str, Any] = {
            "backend": "egl",
            "libgl": "libGL.so.1",
            "libegl": "libEGL.so.1",
        }
        context = moderngl.create_context(standalone=True, require=MINIMUM_VERSION, **settings)
    except Exception as error:  # glcontext raises bare Exception
        raise DriverError(
            f"no OpenGL {MINIMUM_VERSION / 100:.1f} driver could be opened through EGL ({error}); "
            "install one, on Debian and Ubuntu: "
            "sudo apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri; "
            "or use --source analytic, which needs none"
        ) from error
    context.gc_mode = "context_gc"
    return context


def renderer_name() -> str:
    """Renderer and version as the driver states them; `DriverError` as `gl_context`."""
    info = gl_context().info
    return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"
