"""Programs that are called from Python, compiled for a short wait, and the settings they run with.

Compiling is most of a first fit. On a CPU, XLA's fusion emitters take a good part of it for these
programs, and what they make is no faster: without them, a first fit of 160 × 128 pixels takes a
quarter less of a core's time, 6 s instead of 8, and a robust one 14 s instead of 20.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax
import platformdirs

_KEPT = {
    "jax_persistent_cache_min_compile_time_secs": 0,
    "jax_compilation_cache_max_size": 2**28,
}
"""All programs, for it is many small ones that take the time; a first fit's are 0.4 MB. JAX removes
those not used for longest."""

SHORT_WAIT = {"xla_cpu_use_fusion_emitters": False}

P = ParamSpec("P")
R = TypeVar("R")


@contextmanager
def float64() -> Iterator[None]:
    """JAX with our settings, whatever the caller's: 64-bit numbers, and none that are for finding
    bugs in the caller's own program. A descent that goes astray ends in NaN, which is its answer
    and no bug, and without `jit` a fit would take hours."""
    with ExitStack() as settings:
        for setting in (
            jax.enable_x64(True),
            jax.debug_nans(False),
            jax.debug_infs(False),
            jax.disable_jit(False),
            jax.numpy_dtype_promotion("standard"),
        ):
            settings.enter_context(setting)
        yield


def keep_programs() -> None:
    """From here on compiled programs are kept for the next process, in the user's cache folder.

    JAX's own variables go first: `JAX_ENABLE_COMPILATION_CACHE=false` turns it off, and
    `JAX_COMPILATION_CACHE_DIR` names a folder that JAX then fills by its own rules. A folder that
    cannot be written to is no error; then programs are compiled each time.
    """
    configuration: Any = jax.config  # its type does not list its settings
    asked = configuration.jax_enable_compilation_cache
    if not asked or configuration.jax_compilation_cache_dir is not None:
        return
    try:
        folder = platformdirs.user_cache_path("airlight", appauthor=False) / "xla"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # the latter of a user without a home
        return
    if os.access(folder, os.W_OK):
        jax.config.update("jax_compilation_cache_dir", str(folder))
        for name, value in _KEPT.items():
            if name.upper() not in os.environ:
                jax.config.update(name, value)


def program(function: Callable[P, R]) -> Callable[P, R]:
    """`equinox.filter_jit` with our compiler options, which JAX takes at the outermost level only:
    not to be called while JAX traces."""
    # Asked when first called: importing must not start a device.
    jit: Any = eqx.filter_jit  # its type leaves out what it passes on to `jax.jit`
    compiled = cache(lambda: jit(function, compiler_options=_options()))

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        found: R = compiled()(*args, **kwargs)
        return found

    return call


@cache
def _options() -> dict[str, bool]:
    """What this version of XLA knows."""
    try:
        jax.jit(lambda: 0, compiler_options=SHORT_WAIT).lower().compile()
    except jax.errors.JaxRuntimeError:
        return {}
    return SHORT_WAIT
