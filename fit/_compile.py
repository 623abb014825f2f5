"""Programs that are called from Python, compiled for a short wait, and the settings they run with.

Compiling is most of a first fit. On a CPU, XLA's fusion emitters take a good part of it for these
programs, and what they make is no faster: without them, a first fit of 160 × 128 pixels takes a
quarter less of a core's time, 6 s instead of 8, and a robust one 14 s instead of 20.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import equinox as eqx
import jax

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
