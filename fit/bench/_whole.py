"""Whole fits: `fit()` from photo to verdict, the first of a process, the command from file to file.

What starts afresh each time runs in processes of its own, with a cache of compiled programs that is
empty, or filled by one run before.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from model_jax import InputError, Srgb
from render_gl._scene_file import scene_record

from .._fit import fit
from .._result import FitResult
from ..photo._pixels import choose_pixels
from ..solve._parameters import Entries
from ._measure import REPEATS, measure
from ._point import Point, Times, timed
from ._problems import Case
from ._scenes import SIZE, TRUTH, Fitted, Known, noisy, synthetic, synthetic_fit

LARGE = (4928, 2768)
"""13.6 megapixels, a full-frame camera's."""

FACTORS = (0.5, 1, 2)
"""Of the paper's width and height."""


def whole_points(
    known: dict[str, Known], left_out: list[str], tell: Callable[[str], None]
) -> Iterator[Point]:
    """Points of whole fits."""
    for factor in FACTORS:
        width, height = (int(n * factor) for n in SIZE)
        tell(f"fit(), {width}×{height}")
        yield in_memory(synthetic_fit("synthetic", synthetic(*SIZE), "layers", width, height))
    tell("the first fit() of a process")
    yield first_fit()
    march = known.get("march")
    if march is None or march.photo is None or march.settings is None:
        left_out.append("commands from file to file: the march's photo is not here")
    else:
        yield from _commands(march, tell)
    tell("13.6 megapixels, from file to file")
    yield large_photo()


def in_memory(fitted: Fitted) -> Point:
    """`fit()` from arrays to errors and verdict."""
    case = fitted.case()
    point = Point(
        "fit",
        fitted.scene,
        fitted.look,
        "airlight, whole fit()",
        "{1}×{0}, from arrays to verdict".format(*np.shape(fitted.layers.front)),
        case.pixels,
    )

    def run() -> FitResult:
        return fit(
            fitted.photo, fitted.layers, fitted.start, free=fitted.free, sampling=fitted.sampling
        )

    result, times = measure(run)
    point = replace(point, **timed(times), note=result.verdict)
    return replace(point, **case.judged(vector_of(result, case)))


def vector_of(result: FitResult, case: Case) -> Entries:
    """A result's numbers where the case has them."""
    vector = case.start.copy()
    for p in case.parameters:
        if p.name in result.parameters:
            vector[list(p.entries)] = result.parameters[p.name].value
    return vector


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
from fit.bench import _scenes, _whole
def run(width, height):
    fitted = _scenes.synthetic_fit(
        "synthetic", _scenes.synthetic(width, height), "layers", width, height)
    compiled.clear()
    started = perf_counter()
    _whole.fit(fitted.photo, fitted.layers, fitted.start, free=fitted.free, sampling="point")
    return perf_counter() - started, sum(compiled), len(compiled)
width, height = map(int, sys.argv[1:])
first, again = run(width, height), run(width, height)
other = run(width * 7 // 8, height * 7 // 8)
print(json.dumps([*first, *again, *other]))
"""


def first_fit(width: int = SIZE[0] // 2, height: int = SIZE[1] // 2) -> Point:
    """The first `fit()` of a process, which compiles; and what a photo of another size compiles."""
    runs, told = [], []
    for _ in range(REPEATS):
        told = json.loads(_process([_FRESH, str(width), str(height)], _uncached()))
        runs.append(told[0])
    _, compiling, count, again, _, _, _, _, other = told
    note = (
        f"XLA compiles {count} programs in {compiling:.2f} s; the second fit() takes "
        f"{again:.2f} s; a photo of another size compiles {other}"
    )
    point = Point(
        "fit",
        "synthetic",
        "layers",
        "airlight, first fit()",
        f"{width}×{height}, a new process, nothing cached",
        width * height,
    )
    times = timed(Times(runs[0], tuple(runs)))
    return replace(point, **times | {"first": None}, note=note)


_WHOLE = """
import json, resource, sys
from time import perf_counter
started = perf_counter()
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
    print()
    print(json.dumps([perf_counter() - started, peak]), flush=True)
"""


def _commands(known: Known, tell: Callable[[str], None]) -> Iterator[Point]:
    """`airlight fit` from file to fit.json, with and without compiled programs from before."""
    camera = known.scene.camera
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = folder / "scene.toml"
        scene.write_text(scene_text(known), encoding="utf-8")
        command = ["fit", str(scene), str(known.photo), "-o", str(folder / "out")]
        cache = _uncached() | {
            "JAX_ENABLE_COMPILATION_CACHE": "true",
            "JAX_COMPILATION_CACHE_DIR": str(folder / "cache"),
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        cases = (
            ("nothing cached", _uncached(), 0),
            ("programs cached by a run before", cache, 1),
        )
        for words, environment, before in cases:
            tell(f"airlight fit, {words}")
            runs = [
                json.loads(_process([_WHOLE, *command], environment))
                for _ in range(before + REPEATS)
            ]
            seconds = [run[0] for run in runs]
            point = Point(
                "fit",
                known.name,
                "layers",
                "airlight fit, from file to fit.json",
                f"{camera.width}×{camera.height}, a new process, {words}",
                camera.width * camera.height,
            )
            times = timed(Times(seconds[0], tuple(seconds[before:])))
            peak = f"peak memory {max(run[1] for run in runs) / 1e9:.2f} GB"
            yield replace(point, **times, note=peak)


def scene_text(known: Known) -> str:
    """The scene as a file whose photo and look are the command's business."""
    lines = []
    for name, keys in scene_record(known.scene).items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    lines += ["[look]", 'kind = "layers"']
    return "\n".join(lines)


def large_photo() -> Point:
    """The whole command on an 8-bit photo of 13.6 megapixels, and its peak memory."""
    from PIL import Image

    width, height = LARGE
    with tempfile.TemporaryDirectory() as folder:
        scene = synthetic(width, height)
        layers, photo = noisy(scene, TRUTH)
        codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(photo / 4)), 0, 1))
        Image.fromarray(codes.astype(np.uint8)).save(f"{folder}/photo.png", compress_level=1)
        used = int(choose_pixels(photo, layers).used.sum())
        del codes, layers, photo
        text = scene_text(Known("synthetic", scene, TRUTH))
        Path(f"{folder}/scene.toml").write_text(text, encoding="utf-8")
        command = ["fit", f"{folder}/scene.toml", f"{folder}/photo.png", "-o", folder]
        seconds, peak = json.loads(_process([_WHOLE, *command], _uncached()))
    return Point(
        "fit",
        "synthetic",
        "layers",
        "airlight fit, from file to fit.json",
        f"{width}×{height}, a new process, nothing cached",
        used,
        seconds=seconds,
        low=seconds,
        high=seconds,
        repeats=1,
        note=f"peak memory {peak / 1e9:.2f} GB, report and EXRs and all; one run, for its memory",
    )


def _uncached() -> dict[str, str]:
    """Settings of a process that is to compile its programs, whatever an earlier one has kept."""
    return os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}


def _process(arguments: list[str], environment: dict[str, str]) -> str:
    """The last line that a new Python prints."""
    done = subprocess.run(
        [sys.executable, "-c", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    if done.returncode not in (0, 1):  # 1: a fit that did not converge, which is an answer
        last = done.stderr.strip().rpartition("\n")[2]
        raise InputError(f"bench: a process of its own failed: {last}")
    return done.stdout.strip().rpartition("\n")[2]
