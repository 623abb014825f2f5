"""Timers that wait for what they time, budgets that grow, and the machine that it was."""

import os
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from time import perf_counter
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from model_jax import DriverError, Srgb
from render_gl import renderer_name

from ._point import Times

T = TypeVar("T")

REPEATS = 7
"""Runs of a point, of which the median counts: odd, and more than a hiccup or two."""

GROWTH = 1.5
"""Of a budget from one point of a curve to the next."""

BETTER = 0.95
STILL = 5
"""An error stands still when after so many more budgets, eight times the first, it is not below
this share of what it was: a damped solver may try some steps before it takes one."""

_PACKAGES = (
    "airlight",
    "jax",
    "numpy",
    "scipy",
    "optimistix",
    "moderngl",
    "mpmath",
    "optax",
    "lmfit",
)


def measure(run: Callable[[], T], repeats: int = REPEATS) -> tuple[T, Times]:
    """What a function returns, and its seconds: each run ends when its numbers are there."""
    started = perf_counter()
    value = jax.block_until_ready(run())
    first = perf_counter() - started
    runs = []
    for _ in range(repeats):
        started = perf_counter()
        value = jax.block_until_ready(run())
        runs.append(perf_counter() - started)
    return value, Times(first, tuple(runs))


def budgets(most: int) -> list[int]:
    """1, 2, 3, 5, 8 …: each half as much again as the last, rounded up."""
    found = [1]
    while found[-1] < most:
        found.append(min(max(found[-1] + 1, round(GROWTH * found[-1])), most))
    return found


def stands_still(errors: list[float]) -> bool:
    """Whether the last budgets, `STILL` of them, did not help, or nothing is left to help."""
    if errors and errors[-1] == 0:
        return True
    return len(errors) > STILL and min(errors[-STILL:]) >= BETTER * min(errors[:-STILL])


def copy_bandwidth(repeats: int = REPEATS) -> float:
    """Bytes a second, read and written, of a copy too large for caches, where JAX computes."""
    source = jnp.ones(2**25, jnp.float32)
    copy = jax.jit(lambda x: x + 1)
    _, times = measure(lambda: copy(source), repeats)
    return 2 * source.nbytes / times.median


def machine() -> dict[str, Any]:
    """What the figures are of."""
    try:
        renderer = renderer_name()
    except DriverError:
        renderer = "none"
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "devices": [str(device.device_kind) for device in jax.devices()],
        "OpenGL": renderer,
        "versions": {name: _version(name) for name in _PACKAGES if _version(name)},
    }


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as stream:
            for line in stream:
                if line.startswith("model name"):
                    return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def codes_apart(picture: np.ndarray, right: np.ndarray) -> tuple[float, float]:
    """Largest and root mean square difference of two pictures, in codes of 8 bits.

    Linear light [..., 3]; white is the right picture's brightest number.
    """
    white = float(np.max(right, initial=0.0)) or 1.0

    def codes(light: np.ndarray) -> np.ndarray:
        """Not rounded, so that small differences are told."""
        return 255 * np.asarray(Srgb().encode(np.clip(light.astype(np.float64) / white, 0, 1)))

    apart = np.abs(codes(picture) - codes(right))
    return float(np.max(apart, initial=0.0)), float(np.sqrt(np.mean(apart**2)))
