"""What the combine step costs: look, GLSL or JAX, precision, with and without slopes."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from model_jax import AirlightError, Layers, Look, Response, combine
from render_gl import DepthFormat
from render_gl._draw import draw, time_combine
from render_gl._render import frame_layers

from .._compile import float64, program
from ..photo._columns import take_columns
from ..photo._pixels import choose_pixels
from ..solve._declare import declare
from ..solve._gram import gram, pixel_gram
from ..solve._layout import Layout
from ..solve._loss import Loss
from ..solve._model import Model
from ..solve._parameters import free_directions, to_entries
from ..solve._samples import on_device, to_samples
from ._measure import REPEATS, measure
from ._point import Point, Times, timed
from ._render_points import Drawn, layers_bytes

FORMAT: DepthFormat = "linear"
GLSL = "GLSL"


def combine_points(
    case: Drawn, looks: dict[str, Look], bandwidth: float, tell: Callable[[str], None]
) -> Iterator[Point]:
    """Points of one scene's layers, for each look by its name."""
    for name, look in looks.items():
        seen = Drawn(case.name, case.scene, look)
        for make in (_glsl, _jax, _slopes, _passes):
            tell(f"combine, {name}")
            for point in make(seen, name):
                yield _with_rates(point, bandwidth)


def _with_rates(point: Point, bandwidth: float) -> Point:
    if point.seconds is None:
        return point
    rate = None if point.bytes is None else point.bytes / point.seconds / bandwidth
    return replace(point, per_second=point.pixels / point.seconds, bandwidth=rate)


def _point(case: Drawn, name: str, method: str, setting: str) -> Point:
    camera = case.scene.camera
    return Point("combine", case.name, name, method, setting, camera.width * camera.height)


def _glsl(case: Drawn, name: str) -> Iterator[Point]:
    """The combine pass alone, held against JAX in float64 on the depths that the shader read."""
    point = _point(case, name, GLSL, f"combine pass, {FORMAT} depths")
    try:
        first, *runs = time_combine(case.scene, case.look, FORMAT, REPEATS + 1)
        frame = draw(case.scene, case.look, FORMAT)
    except AirlightError as error:
        yield replace(point, status="failed", note=str(error))
        return
    with float64():
        layers = frame_layers(case.scene, frame, FORMAT)
        right = np.asarray(_air(*_cast((layers, case.look), "float64")))
    depths = frame.front.nbytes + frame.back.nbytes + frame.shadows.nbytes
    size = 2 * depths + frame.air.nbytes
    point = replace(point, **timed(Times(first, tuple(runs))), bytes=size)
    yield _against(point, frame.air, right, "float32")


def _cast(tree: Any, dtype: str) -> Any:
    """Arrays of floats as JAX's, of one precision."""

    def cast(leaf: Any) -> Any:
        return jnp.asarray(leaf, dtype) if eqx.is_inexact_array_like(leaf) else leaf

    return jax.tree.map(cast, tree)


def _air(layers: Layers, look: Look) -> jax.Array:
    return jnp.asarray(combine(layers, look))


def _jax(case: Drawn, name: str) -> Iterator[Point]:
    """`combine` compiled, on the exact layers; what rounds them to float32 is in its error."""
    with float64():
        run = eqx.filter_jit(_air)
        right = np.asarray(run(*_cast((case.exact, case.look), "float64")))
        for dtype in ("float32", "float64"):
            given = _cast((case.exact, case.look), dtype)
            fresh = eqx.filter_jit(partial(_air))  # its own, to be compiled anew
            found, times = measure(lambda: fresh(*given))  # noqa: B023 (called at once)
            size = layers_bytes(given[0]) + found.nbytes
            point = _point(case, name, f"JAX {dtype}", "combine, compiled")
            point = replace(point, **timed(times), bytes=size)
            yield _against(point, np.asarray(found), right, dtype)


def _slopes(case: Drawn, name: str) -> Iterator[Point]:
    """Reverse slopes of a square sum by every number of the look."""

    def loss(look: Look, layers: Layers, photo: jax.Array) -> jax.Array:
        return ((_air(layers, look) - photo) ** 2).mean()

    with float64():
        photo = np.asarray(_air(*_cast((case.exact, case.look), "float64"))) * 1.1
        right: np.ndarray | None = None
        for dtype in ("float64", "float32"):
            look, layers, light = _cast((case.look, case.exact, photo), dtype)
            run = eqx.filter_jit(eqx.filter_value_and_grad(loss))
            (_, slopes), times = measure(lambda: run(look, layers, light))  # noqa: B023
            parts = jax.tree.leaves(eqx.filter(slopes, eqx.is_array))
            found = np.concatenate([np.ravel(np.asarray(part, np.float64)) for part in parts])
            right = found if right is None else right
            size = layers_bytes(layers) + light.nbytes
            point = _point(case, name, f"JAX {dtype}, with slopes", "value_and_grad, compiled")
            point = replace(point, **timed(times), bytes=size)
            yield _against(point, found, right, dtype)


def _against(point: Point, found: np.ndarray, right: np.ndarray, dtype: str) -> Point:
    """Float32 against float64, which is not held against itself."""
    if dtype == "float64":
        return replace(point, status="oracle")
    scale = float(np.max(np.abs(right))) or 1.0
    error = float(np.max(np.abs(found - right))) / scale
    if not np.isfinite(error):
        return replace(point, status="failed", note="some numbers are not finite")
    return replace(point, light=error)


def _passes(case: Drawn, name: str) -> Iterator[Point]:
    """A fit's exact pass: residuals, slopes and their products, of the pixels with air."""
    kind = type(case.look)
    with float64():
        photo = np.asarray(_air(*_cast((case.exact, case.look), "float64")), np.float32)[..., :3]
        used = choose_pixels(photo, case.exact, "point").used
        columns = take_columns(photo, case.exact, used, float(case.exact.width_unit), kind)
        samples = on_device(to_samples([columns]))
        parameters = declare(case.look, [Response()])
        free = [p for p in parameters if p.role == "free"]
        vector = jnp.asarray(to_entries(parameters))
        directions = jnp.asarray(free_directions(free, parameters)[0])
        model = Model(Loss("linear"), None, Layout(kind), True)
        sums = [("sums", program(gram))] if model.linear else []
        n = len(columns.index)
        size = sum(field.nbytes for field in columns.fields.values()) + columns.light.nbytes
        for way, run in (("pixel by pixel", program(pixel_gram)), *sums):
            _, times = measure(lambda: run(vector, directions, samples, model))  # noqa: B023
            setting = f"{way}, {directions.shape[1]} directions"
            point = replace(_point(case, name, f"a fit's pass, {way}", setting), pixels=n)
            yield replace(point, **timed(times), bytes=size, evaluations=1)
