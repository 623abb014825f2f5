"""What a look costs: one exact pass over the pixels, by the terms that it has."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from model_jax import Layers, Look, Response, find_look

from .._compile import program
from ..photo._columns import planet_light, take_columns
from ..photo._pixels import choose_pixels
from ..solve._declare import declare
from ..solve._descend import exact_gram
from ..solve._gram import pixel_gram
from ..solve._layout import Layout
from ..solve._loss import Loss
from ..solve._model import Model
from ..solve._parameters import free_directions, to_entries
from ..solve._samples import on_device, to_samples
from ._case import Row

UNIFORM = "a pass of layers, pixel by pixel"
"""What others are compared with: the uniform look, without the sums that spare it its pixels."""

_HEIGHT = 0.07
"""Scale height, a tenth of the shell's of the case."""


def look_rows(
    layers: Layers,
    photo: np.ndarray,
    times: Callable[[Callable[[], Any]], tuple[Any, list[float]]],
    progress: Callable[[str], None],
) -> list[Row]:
    """A pass of each look with all its parameters, whose note says what a pixel of it takes.

    Args:
        times: runs a function, and says the seconds of each run.
    """
    thin = find_look("air+density")(scale_height=_HEIGHT)
    dim = find_look("air+density+saturation")(scale_height=_HEIGHT)
    sunlit = find_look("air+density+saturation+sun")(scale_height=_HEIGHT)
    terms = [name for name in find_look("air").TERMS if name != "density-rgb"]
    every = find_look("+".join(("air", *terms)))(scale_height=_HEIGHT, top=10 * _HEIGHT)
    by_pixel = program(pixel_gram)
    cases: list[tuple[str, Look, float | None, Any]] = [
        ("a pass of layers, by sums", find_look("layers")(), None, exact_gram),
        (UNIFORM, find_look("layers")(), None, by_pixel),
        ("a pass of air+density", thin, None, by_pixel),
        ("a pass of air+density+saturation", dim, None, by_pixel),
        ("a pass of air+density+saturation+blur", dim, 1.0, by_pixel),
        ("a pass of air+density+saturation+sun", sunlit, None, by_pixel),
        ("a pass of air with every term", every, None, by_pixel),
    ]
    rows, uniform = [], None
    for name, look, blur, run in cases:
        progress(name)
        used = choose_pixels(photo, layers, "point", blurs=blur is not None).used
        inside = None if blur is None else planet_light(photo, layers, blur)
        unit = float(layers.width_unit)
        columns = take_columns(photo, layers, used, unit, type(look), inside)
        samples = on_device(to_samples([columns]))
        parameters = declare(look, [Response(blur=blur)])
        directions = free_directions([p for p in parameters if p.role == "free"], parameters)[0]
        model = Model(Loss("linear"), None, Layout(type(look), blur is not None), True)
        with jax.enable_x64(True):
            given = jnp.asarray(to_entries(parameters)), jnp.asarray(directions), samples, model
            _, seconds = times(lambda: run(*given))  # noqa: B023 (called at once)
        n, median = len(columns.index), float(np.median(seconds))
        each = median / n
        uniform = each if name == UNIFORM else uniform
        note = f"{directions.shape[1]} directions, {1e9 * each:.0f} ns a pixel"
        if uniform is not None and name != UNIFORM:
            note += f": {each / uniform:.1f} times the uniform look pixel by pixel"
        rows.append(Row(name, n, median, min(seconds), max(seconds), None, note))
    return rows
