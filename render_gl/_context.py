"""The headless OpenGL context: one per process, opened when first needed, in a thread of its own.

EGL needs no display; Mesa's llvmpipe serves where there is no GPU. `moderngl` is imported here and
in the drawing modules only, so that reading scenes and layer files works without OpenGL.

OpenGL speaks to the context that is current in the calling thread, and there may be others: a
window's, another library's, one in each of a program's threads. So ours is current in one thread
that does nothing else, for good: no caller's context is ever touched, none of theirs can take our
place, and calls from several threads take turns.
"""

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from model_jax import DriverError, InputError

if TYPE_CHECKING:
    import moderngl

T = TypeVar("T")

MINIMUM_VERSION = 330
"""OpenGL 3.3 core: float colour attachments, texelFetch, depth clamp."""


class _Here(threading.local):
    is_gl = False
    """Whether this is the context's thread."""


_here = _Here()
_processes: list[int] = []
"""The one that started the context's thread, once there is one."""


def _start() -> None:
    _processes.append(os.getpid())
    _here.is_gl = True


_thread = ThreadPoolExecutor(1, "airlight-opengl", initializer=_start)


def on_gl(work: "Callable[[moderngl.Context], T]") -> T:
    """What `work` returns, given the context, in the thread in which that is current.

    Work may call this again. JAX's settings are of threads: in this one they are the process's.

    Raises `DriverError` with the command that installs a software driver when no context can be
    opened, in a process that was forked from one that had a context, and when the interpreter is
    ending; what `work` raises passes through.
    """
    if _here.is_gl:
        return work(_context())
    if _processes and os.getpid() not in _processes:
        raise DriverError(
            f"process {_processes[0]} opened OpenGL before this one was forked from it, and no "
            "driver survives that; start processes with multiprocessing's method 'spawn'"
        )
    try:
        future = _thread.submit(lambda: work(_context()))
    except RuntimeError as error:
        raise DriverError(f"OpenGL: {error}; draw before the program ends") from None
    return future.result()


def renderer_name() -> str:
    """Renderer and version as the driver states them; `DriverError` as `on_gl`."""
    info = on_gl(lambda context: context.info)
    return f"{info['GL_RENDERER']}, OpenGL {info['GL_VERSION']}"


@cache
def _context() -> "moderngl.Context":
    """The process's context, made current in this thread."""
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
        # `moderngl.get_context` is to go on telling the caller's.
        store: Any = vars(moderngl)["_store"]
        default = store.default_context
        try:
            context = moderngl.create_context(standalone=True, require=MINIMUM_VERSION, **settings)
        finally:
            store.default_context = default
    except Exception as error:  # glcontext raises bare Exception
        raise DriverError(
            f"no OpenGL {MINIMUM_VERSION / 100:.1f} driver could be opened through EGL ({error}); "
            "install one, on Debian and Ubuntu: "
            "sudo apt-get install libegl1 libgl1 libegl-mesa0 libgl1-mesa-dri; "
            "or use --source analytic, which needs none"
        ) from error
    context.gc_mode = "context_gc"
    return context


def check_texture_size(context: "moderngl.Context", what: str, width: int, height: int) -> None:
    """Raises `InputError` for what the driver has no texture for."""
    limit = int(context.info["GL_MAX_TEXTURE_SIZE"])
    if max(width, height) > limit:
        raise InputError(
            f"{what}: {width}×{height} pixels exceed this driver's limit of {limit}; "
            "make it smaller"
        )
