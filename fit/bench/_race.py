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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import render_gl
from model_jax import Layers, LayersLook

from .._fit import fit
from .._result import FitResult
from ..photo._columns import Columns, take_columns
from ..photo._pixels import choose_pixels
from ..solve._descend import exact_gram
from ..solve._parameters import free_directions, to_entries
from ..solve._search import search
from ._case import FREE, NOISE_SEED, SIZE, Row, case_problem, make_picture
from ._passes import look_rows
from ._peers import dense_fit, scipy_fit
from ._processes import compile_row, memory_row

REPEATS = 7
"""Runs of each row, of which the median counts: odd, and more than a hiccup or two."""


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
    layers, photo = make_picture(width, height)
    used = choose_pixels(photo, layers, "point").used
    columns = take_columns(photo, layers, used, float(layers.width_unit))
    best = scipy_fit(columns, np.array([3.0, 0.2, 0.8, 0.9]), 1e-15)
    n = len(columns.index)
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
        lambda: scipy_fit(columns, start, 1e-8),
        lambda v: v,
    )
    dense = add("optimistix LM, dense float32", lambda: dense_fit(columns, start), lambda v: v)
    one_pass = _pass_rows(rows, columns, repeats, progress)
    for peer, target in ((trf, 30), (dense, 10)):
        assert ours.median is not None
        assert peer.median is not None
        ratio = peer.median / ours.median
        note = f"{ratio:.1f} times the time of airlight's first row; at least {target} wanted"
        rows[rows.index(peer)] = replace(peer, note=note)
    rows += look_rows(layers, photo, lambda run: _times(run, repeats), progress)
    progress("compiling in a fresh process")
    rows.append(compile_row(quick))
    rows.append(_other_size_row(width, height))
    if not quick:
        rows += _size_rows(repeats, progress)
        progress("13.6 megapixels, whole command")
        rows.append(memory_row())
    return _write(folder, rows, one_pass)


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
    problem, parameters = case_problem(columns, more)
    if all_pixels:
        problem = replace(problem, is_rough=True)
    free = [p for p in parameters if p.role == "free"]
    return search(problem, to_entries(parameters), free, "lm", 256).vector


def _fit(photo: np.ndarray, layers: Layers) -> FitResult:
    return fit(photo, layers, LayersLook(1.0, 0.5), free=FREE, sampling="point")


def _of_vector(vector: np.ndarray) -> list[float]:
    return [float(vector[k]) for k in (0, 1, 4, 5)]


def _of_result(result: FitResult) -> list[float]:
    names = ("brightness", "shadow", "tint.r", "tint.g")
    return [result.parameters[name].value for name in names]


def _pass_rows(
    rows: list[Row], columns: Columns, repeats: int, progress: Callable[[str], None]
) -> dict[str, float]:
    """One exact pass, and the least that reading its numbers could take."""
    progress("one exact pass")
    problem, parameters = case_problem(columns, ())
    free = [p for p in parameters if p.role == "free"]
    directions = free_directions(free, parameters)[0]
    n = len(columns.index)
    with jax.enable_x64(True):
        vector, slopes = jnp.asarray(to_entries(parameters)), jnp.asarray(directions)
        _, times = _times(
            lambda: exact_gram(vector, slopes, problem.samples, problem.model), 3 * repeats
        )
    median = float(np.median(times))
    parts = (*columns.fields.values(), columns.light)
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


def _other_size_row(width: int, height: int) -> Row:
    """Programs compiled for a second photo of another size."""
    with _counting_compiles() as compiled:
        layers, photo = make_picture(width * 7 // 8, height * 7 // 8)
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
        layers, photo = make_picture(width, height)
        result, times = _times(lambda: _fit(photo, layers), repeats)  # noqa: B023 (called at once)
        n = int(result.used.sum())
        median = float(np.median(times))
        note = f"{1e9 * median / n:.0f} ns a pixel of air"
        rows.append(Row(f"fit(), {width}×{height}", n, median, min(times), max(times), None, note))
    return rows


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
        "seed": NOISE_SEED,
        "pass": one_pass,
        "rows": [asdict(row) for row in rows],
    }
    render_gl.write_whole(folder / "fit-bench.csv", write_csv)
    text = json.dumps(document, indent=2, allow_nan=False) + "\n"

    def write_json(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    render_gl.write_whole(folder / "fit-bench.json", write_json)
    return document
