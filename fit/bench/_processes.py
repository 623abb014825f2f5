"""Rows that need a process of their own: the first fit's wait, and peak memory."""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from model_jax import InputError, Srgb

from ..photo._pixels import choose_pixels
from ._case import LARGE, SIZE, Row, make_picture, scene_text

_UNCACHED = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}
"""Settings of a process that is to compile its programs, whatever an earlier one has kept."""

_FRESH = """
import json, sys
from time import perf_counter
import jax
import scipy.linalg  # JAX does at its first decomposition; loading modules is no compiling
compiled = []
def listen(name, seconds, **_):
    if name.endswith("backend_compile_duration"):
        compiled.append(seconds)
jax.monitoring.register_event_duration_secs_listener(listen)
from fit.bench import _case, _race
layers, photo = _case.make_picture(*map(int, sys.argv[1:]))
compiled.clear()
started = perf_counter()
_race._fit(photo, layers)
first = perf_counter() - started
started = perf_counter()
_race._fit(photo, layers)
print(json.dumps([first, perf_counter() - started, sum(compiled), len(compiled)]))
"""


def compile_row(quick: bool) -> Row:
    """What the first fit of a process costs on top."""
    width, height = (n // (4 if quick else 1) for n in SIZE)
    done = subprocess.run(
        [sys.executable, "-c", _FRESH, str(width), str(height)],
        capture_output=True,
        text=True,
        check=True,
        env=_UNCACHED,
    )
    first, second, compiling, count = json.loads(done.stdout.splitlines()[-1])
    note = (
        f"first fit() {first:.2f} s, then {second:.2f} s; XLA {compiling:.2f} s in {count} parts; "
        "below 5 s wanted"
    )
    return Row("compiling, first fit() only", 0, first - second, None, None, None, note)


_WHOLE = """
import resource, sys
from fit.cli._cli import main
try:
    main()
finally:
    try:  # what getrusage calls the peak counts the process that this one was forked from
        lines = open("/proc/self/status").read().splitlines()
        peak = next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))
    except OSError:
        scale = 1 if sys.platform == "darwin" else 1024
        peak = scale * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(peak, end="", flush=True)
"""


def memory_row() -> Row:
    """Peak memory of the whole command on an 8-bit photo of 13.6 megapixels."""
    from PIL import Image

    width, height = LARGE
    with tempfile.TemporaryDirectory() as folder:
        layers, photo = make_picture(width, height)
        codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(photo / 4)), 0, 1))
        Image.fromarray(codes.astype(np.uint8)).save(f"{folder}/photo.png", compress_level=1)
        used = int(choose_pixels(photo, layers).used.sum())
        del codes, layers, photo
        Path(f"{folder}/scene.toml").write_text(scene_text(width, height), encoding="utf-8")
        command = ["fit", f"{folder}/scene.toml", f"{folder}/photo.png", "-o", folder]
        started = perf_counter()
        done = subprocess.run(
            [sys.executable, "-c", _WHOLE, *command],
            capture_output=True,
            text=True,
            check=False,
            env=_UNCACHED,
        )
        seconds = perf_counter() - started
        if done.returncode != 0:
            last = done.stderr.strip().rpartition("\n")[2]
            raise InputError(f"bench: airlight {' '.join(command)} failed: {last}")
    peak = float(done.stdout.rpartition("\n")[2])
    note = f"peak memory {peak / 1e9:.2f} GB, drawing and report and all; below 1.5 GB wanted"
    return Row("airlight fit, 13.6-megapixel photo", used, seconds, None, None, None, note)
