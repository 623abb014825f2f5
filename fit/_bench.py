"""How fast a fit is, beside its peers, on the machine at hand.

One synthetic photo with some 600,000 pixels of air and four degrees of freedom (brightness, shadow
weight, tint) is fitted by airlight and by others on the same numbers in the same run, so that
ratios mean something where times do not. Each row is the median of repeated runs with its spread,
without the first; what the first run costs is a row of its own, from a fresh process. Errors are
against the float64 optimum over all pixels, which SciPy finds with tolerances of 1e-15.
"""

import csv
import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

import render_gl
from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    Look,
    Planet,
    Response,
    Scene,
    Srgb,
    Sun,
    analytic_layers,
    composite,
)
from render_gl._scene_file import scene_record

from ._fit import fit
from ._loss import Loss
from ._parameters import declare, directions, to_entries
from ._pixels import Columns, choose_pixels, on_device, take_columns, to_samples
from ._result import FitResult
from ._search import Problem, search, state
from ._solve import exact_gram
from ._stream import Model

TRUTH = Look(brightness=3.0, shadow=0.2, tint=np.array([0.8, 0.9, 1.3]))
FREE = ("brightness", "shadow", "tint")
NOISE = 0.02
SEED = 20261123
REPEATS = 7
SIZE = (1280, 1024)
LARGE = (4928, 2768)
"""13.6 megapixels, a full-frame camera's."""


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    pixels: int
    """Pixels of air."""
    median: float | None
    """Seconds; None where the row is no time."""
    low: float | None
    high: float | None
    error: float | None
    """Largest relative difference of a parameter from the optimum; None where there is none."""
    note: str


def run_bench(
    folder: Path, quick: bool = False, progress: Callable[[str], None] = lambda step: None
) -> dict[str, Any]:
    """Measure, and write `fit-bench.csv` and `fit-bench.json` into a folder that there is.

    Returns what the second file holds: machine, seed and rows (`Row`).

    Args:
        quick: a sixteenth of the pixels, three repeats, nothing of 13.6 megapixels.

    Raises:
        InputError: the folder cannot be written.
    """
    repeats = 3 if quick else REPEATS
    width, height = (n // (4 if quick else 1) for n in SIZE)
    layers, photo = _picture(width, height)
    used = choose_pixels(photo, layers, "point").used
    columns = take_columns(photo, layers, used, float(layers.width_unit))
    best = _scipy_fit(columns, np.array([3.0, 0.2, 0.8, 0.9]), 1e-15)
    n = len(columns.lit)
    rows: list[Row] = []

    def add(name: str, run: Callable[[], Any], found: Callable[[Any], Any], note: str = "") -> Row:
        progress(name)
        value, times = _times(run, repeats)
        parameters = found(value)
        error = None
        if parameters is not None:
            error = float(np.max(np.abs(np.asarray(parameters, np.float64) / best - 1)))
        low, high = min(times), max(times)
        rows.append(Row(name, n, float(np.median(times)), low, high, error, note))
        return rows[-1]

    start = np.array([1.0, 0.5, 1.0, 1.0])
    ours = add("airlight, from columns to parameters", lambda: _solve(columns), _of_vector)
    add("airlight fit(), from photo to errors", lambda: _fit(photo, layers), _of_result)
    add(
        "airlight, without reducing first",
        lambda: _solve(columns, all_pixels=True),
        _of_vector,
        "Levenberg–Marquardt over all tiles",
    )
    add("airlight, gamma free too", lambda: _solve(columns, ("gamma",)), lambda v: None, "bins")
    trf = add(
        "SciPy trf, analytic Jacobian",
        lambda: _scipy_fit(columns, start, 1e-8),
        lambda v: v,
    )
    dense = add("optimistix LM, dense float32", lambda: _dense(columns, start), lambda v: v)
    one_pass = _pass_rows(rows, columns, repeats, progress)
    for peer, target in ((trf, 30), (dense, 10)):
        assert ours.median is not None
        assert peer.median is not None
        ratio = peer.median / ours.median
        note = f"{ratio:.1f} times the time of airlight's first row; at least {target} wanted"
        rows[rows.index(peer)] = replace(peer, note=note)
    progress("compiling in a fresh process")
    rows.append(_compile_row(quick))
    rows.append(_other_size_row(width, height))
    if not quick:
        rows += _size_rows(repeats, progress)
        progress("13.6 megapixels, whole command")
        rows.append(_memory_row())
    return _write(folder, rows, one_pass)


def _scene(width: int, height: int) -> Scene:
    """Air in front of space fills nearly half the picture."""
    return Scene(
        camera=Camera(
            position=np.array([0, 0, 3.2]),
            forward=np.array([0, 0, -1.0]),
            up=np.array([0, 1.0, 0]),
            fov_y_deg=60,
            width=width,
            height=height,
            near=0.5,
            far=6,
        ),
        planet=Planet(radius=0.9),
        atmosphere=Atmosphere(height=0.68),
        sun=Sun(direction=np.array([1, 0.2, 0.3])),
    )


def _picture(width: int, height: int) -> tuple[Layers, Float[np.ndarray, "h w 3"]]:
    """Layers of the scene, and a noisy photo."""
    layers = jax.tree.map(np.asarray, analytic_layers(_scene(width, height), jnp.float32))
    clean = np.asarray(composite(layers, TRUTH), np.float32)[..., :3]
    noise = np.random.default_rng(SEED).normal(scale=NOISE, size=clean.shape)
    return layers, (clean + noise).astype(np.float32)


def _times(run: Callable[[], Any], repeats: int) -> tuple[Any, list[float]]:
    """The value, and the seconds of each run but the first."""
    value = run()
    times = []
    for _ in range(repeats):
        started = perf_counter()
        value = jax.block_until_ready(run())
        times.append(perf_counter() - started)
    return value, times


def _solve(
    columns: Columns, more: tuple[str, ...] = (), all_pixels: bool = False
) -> Float[np.ndarray, " e"]:
    """The search alone: from the used pixels in NumPy arrays to the best vector."""
    problem, parameters = _problem(columns, more)
    if all_pixels:
        problem = Problem(**{**vars(problem), "few": problem.samples})
    free = [p for p in parameters if p.role == "free"]
    return search(problem, to_entries(parameters), free, "lm", 256).vector


def _problem(columns: Columns, more: tuple[str, ...]) -> tuple[Problem, Any]:
    parameters = declare(Look(1.0, 0.5), [Response()], free=(*FREE, *more))
    samples = on_device(to_samples([columns]))
    model = Model(Loss("linear"), None, not more)
    return state((columns,), samples, parameters, model), parameters


def _fit(photo: np.ndarray, layers: Layers) -> FitResult:
    return fit(photo, layers, Look(1.0, 0.5), free=FREE, sampling="point")


def _of_vector(vector: np.ndarray) -> list[float]:
    return [float(vector[k]) for k in (0, 1, 4, 5)]


def _of_result(result: FitResult) -> list[float]:
    names = ("brightness", "shadow", "tint.r", "tint.g")
    return [result.parameters[name].value for name in names]


def _scipy_fit(
    columns: Columns, start: Float[np.ndarray, "4"], tolerance: float
) -> Float[np.ndarray, "4"]:
    """Trust-region reflective, as a careful user calls it: analytic Jacobian, scaled columns."""
    from scipy.optimize import least_squares  # a tenth of a second to import, and only here

    lit, light, color = columns.lit, columns.light, columns.color
    dark = columns.dark if columns.dark is not None else np.zeros_like(lit)

    def tints(x: np.ndarray) -> np.ndarray:
        return np.array([x[2], x[3], 3 - x[2] - x[3]])

    def residual(x: np.ndarray) -> np.ndarray:
        return ((x[0] * color * tints(x)) * (lit + x[1] * dark)[:, None] - light).reshape(-1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        out = np.zeros((len(lit), 3, 4))
        width, t = (lit + x[1] * dark)[:, None], tints(x)
        out[..., 0] = color * t * width
        out[..., 1] = x[0] * color * t * dark[:, None]
        for k in (0, 1):
            out[:, k, 2 + k] = x[0] * color[k] * width[:, 0]
            out[:, 2, 2 + k] = -x[0] * color[2] * width[:, 0]
        return out.reshape(-1, 4)

    lower = np.array([0.0, 0.0, 0.0, 0.0])
    found = least_squares(
        residual,
        start,
        jacobian,
        bounds=(lower, np.inf),
        method="trf",
        x_scale="jac",
        ftol=tolerance,
        xtol=tolerance,
        gtol=tolerance,
    )
    return np.asarray(found.x)


def _dense(columns: Columns, start: Float[np.ndarray, "4"]) -> Float[np.ndarray, "4"]:
    """optimistix as its documentation shows it: all residuals in one array, float32."""
    dark = columns.dark if columns.dark is not None else np.zeros_like(columns.lit)
    arrays = (columns.lit, dark, columns.light, columns.color)
    with jax.enable_x64(False):  # the command line switches it on
        return np.asarray(_dense_run(*(jnp.asarray(a, jnp.float32) for a in (*arrays, start))))


@jax.jit
def _dense_run(
    lit: jax.Array, dark: jax.Array, light: jax.Array, color: jax.Array, start: jax.Array
) -> jax.Array:
    def residual(x: jax.Array, _: Any) -> jax.Array:
        tints = jnp.stack([x[2], x[3], 3 - x[2] - x[3]])
        amplitude = x[0] * color * tints
        return amplitude[None] * (lit + x[1] * dark)[:, None] - light

    solver: Any = optx.LevenbergMarquardt(rtol=1e-5, atol=1e-5)
    return optx.least_squares(residual, solver, start, max_steps=64, throw=False).value


def _pass_rows(
    rows: list[Row], columns: Columns, repeats: int, progress: Callable[[str], None]
) -> dict[str, float]:
    """One exact pass, and the least that reading its numbers could take."""
    progress("one exact pass")
    problem, parameters = _problem(columns, ())
    free = [p for p in parameters if p.role == "free"]
    along = directions(free, parameters)[0]
    n = len(columns.lit)
    with jax.enable_x64(True):
        vector, slopes = jnp.asarray(to_entries(parameters)), jnp.asarray(along)
        _, times = _times(
            lambda: exact_gram(vector, slopes, problem.samples, problem.model), 3 * repeats
        )
    median = float(np.median(times))
    parts = (columns.lit, columns.dark, columns.light)
    read = float(sum(part.nbytes for part in parts if part is not None))
    bandwidth = _copy_bandwidth(repeats)
    floor = read / bandwidth
    note = (
        f"{read / 1e6:.1f} MB read; at a copy's {bandwidth / 1e9:.1f} GB/s {1e3 * floor:.2f} ms: "
        f"{median / floor:.1f} times the floor, at most 8 wanted"
    )
    rows.append(Row("one exact pass, 4 directions", n, median, min(times), max(times), None, note))
    return {"bytes": read, "copy_bandwidth": bandwidth, "times_floor": median / floor}


def _copy_bandwidth(repeats: int) -> float:
    """Bytes a second, read and written, of a NumPy copy too large for the caches."""
    source = np.ones(2**25)
    target = np.empty_like(source)
    _, times = _times(lambda: np.copyto(target, source), repeats)
    return float(2 * source.nbytes / np.median(times))


_UNCACHED = os.environ | {"JAX_ENABLE_COMPILATION_CACHE": "false"}
"""Of a process that is to compile its programs, whatever an earlier one has kept."""

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
from fit import _bench
layers, photo = _bench._picture(*map(int, sys.argv[1:]))
compiled.clear()
started = perf_counter()
_bench._fit(photo, layers)
first = perf_counter() - started
started = perf_counter()
_bench._fit(photo, layers)
print(json.dumps([first, perf_counter() - started, sum(compiled), len(compiled)]))
"""


def _compile_row(quick: bool) -> Row:
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


def _other_size_row(width: int, height: int) -> Row:
    """Programs compiled for a second photo of another size."""
    with _counting_compiles() as compiled:
        layers, photo = _picture(width * 7 // 8, height * 7 // 8)
        compiled.clear()
        _fit(photo, layers)
        count = len(compiled)
    return Row("second photo of another size", 0, None, None, None, None, f"{count} compilations")


@contextmanager
def _counting_compiles() -> Iterator[list[float]]:
    compiled: list[float] = []

    def listen(event: str, duration_secs: float, **_: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(duration_secs)

    jax.monitoring.register_event_duration_secs_listener(listen)
    yield compiled


def _size_rows(repeats: int, progress: Callable[[str], None]) -> list[Row]:
    """Time against pixels."""
    rows = []
    for factor in (0.5, 1, 2, 3.25):
        width, height = (int(n * factor) for n in SIZE)
        progress(f"fit(), {width}×{height}")
        layers, photo = _picture(width, height)
        result, times = _times(lambda: _fit(photo, layers), repeats)  # noqa: B023 (called at once)
        n = int(result.used.sum())
        median = float(np.median(times))
        note = f"{1e9 * median / n:.0f} ns a pixel of air"
        rows.append(Row(f"fit(), {width}×{height}", n, median, min(times), max(times), None, note))
    return rows


_WHOLE = """
import resource, sys
from fit._cli import main
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


def _scene_text(width: int, height: int) -> str:
    """The scene as a file."""
    lines = []
    for name, keys in scene_record(_scene(width, height)).items():
        lines += [f"[{name}]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())]
    return "\n".join(lines)


def _memory_row() -> Row:
    """Peak memory of the whole command on an 8-bit photo of 13.6 megapixels."""
    from PIL import Image

    width, height = LARGE
    with tempfile.TemporaryDirectory() as folder:
        layers, photo = _picture(width, height)
        codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(photo / 4)), 0, 1))
        Image.fromarray(codes.astype(np.uint8)).save(f"{folder}/photo.png", compress_level=1)
        used = int(choose_pixels(photo, layers).used.sum())
        del codes, layers, photo
        Path(f"{folder}/scene.toml").write_text(_scene_text(width, height), encoding="utf-8")
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


def _write(folder: Path, rows: list[Row], one_pass: dict[str, float]) -> dict[str, Any]:
    def write_csv(path: Path) -> None:
        with open(path, "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(Row.__dataclass_fields__))
            writer.writeheader()
            writer.writerows(asdict(row) for row in rows)

    machine = {
        "processor": platform.machine(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "jax": jax.__version__,
        "numpy": np.__version__,
        "devices": [str(device) for device in jax.devices()],
    }
    document: dict[str, Any] = {
        "machine": machine,
        "seed": SEED,
        "pass": one_pass,
        "rows": [asdict(row) for row in rows],
    }
    render_gl.write_whole(folder / "fit-bench.csv", write_csv)
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"

    def write_json(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    render_gl.write_whole(folder / "fit-bench.json", write_json)
    return document
