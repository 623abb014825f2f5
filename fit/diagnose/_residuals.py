"""Residuals, predictions and slopes by the widths, photo by photo."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from model_jax._fields import WIDTHS
from model_jax._shapes import AnyArray

from .._compile import float64, program
from ..solve._model import Model, predict
from ..solve._parameters import Entries
from ..solve._problem import Problem
from ..solve._samples import Samples, tile_at

_GROUP = 8
"""Tiles at once: one program for photos of all sizes, and half a megabyte for each array."""


def residuals_of(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """Recorded minus predicted light of each photo's used samples; NaN where one is clipped, or a
    copy."""
    found = left_over_of(problem, vector)
    for c, residual in zip(problem.columns, found, strict=True):
        if c.clipped is not None:
            residual[c.clipped != 0] = np.nan
    return found


def left_over_of(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """The same of all used samples: a dark code's light is its bound, and of a brightest one only
    what is missing to it is left over. NaN in copies."""
    found = _differences(problem, vector)
    for c, residual in zip(problem.columns, found, strict=True):
        residual[:, c.copies] = np.nan
        if c.clipped is not None:
            residual[(c.clipped > 0) & (residual < 0)] = 0
    return found


def air_light_of(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """What the air changes in the predicted light of each photo's used samples; NaN in copies."""
    samples, model = replace(problem.samples, clipped=None), problem.model
    found = _by_photo(problem, lambda tiles: _air_light(vector, samples, model, tiles))
    for c, light in zip(problem.columns, found, strict=True):
        light[:, c.copies] = np.nan
    return found


def predictions_of(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """Predicted light of each photo's used samples."""
    found = _differences(problem, vector)
    return [c.light - difference for c, difference in zip(problem.columns, found, strict=True)]


def _differences(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """Recorded minus predicted light, or bound minus predicted light."""
    # One program serves photos with and without clipped samples.
    measured, model = replace(problem.samples, clipped=None), problem.model
    return _by_photo(problem, lambda tiles: _residuals(vector, measured, model, tiles))


def width_slopes_of(problem: Problem, vector: Entries) -> list[Float[np.ndarray, "_ 3"]]:
    """By how much each used sample changes with a width of air, whichever is most."""
    samples, model = problem.samples, problem.model
    return _by_photo(problem, lambda tiles: _width_slopes(vector, samples, model, tiles))


def _by_photo(
    problem: Problem, of_tiles: Callable[[np.ndarray], jax.Array]
) -> list[Float[np.ndarray, "_ 3"]]:
    """What is computed tile by tile, [tiles, 3, n], in the order of each photo's columns."""
    samples = problem.samples
    found = [np.empty_like(c.light) for c in problem.columns]
    starts = [0] * len(found)
    count, photo = np.asarray(samples.count), np.asarray(samples.photo)
    with float64():
        for filled, numbers in tile_groups(samples):
            values = np.asarray(of_tiles(numbers))
            for k in range(filled):
                n, which = count[numbers[k]], photo[numbers[k]]
                with np.errstate(over="ignore"):  # of a fit that diverged
                    found[which][starts[which] : starts[which] + n] = values[k, :, :n].T
                starts[which] += n
    return found


def structured_rms(
    residual: Float[np.ndarray, "n 3"], index: Int[np.ndarray, " n"], width: int
) -> float:
    """Root mean square of what hangs together in a residual: the mean product of neighbours, to
    which noise that is each pixel's own adds nothing; of those to the right or of those below, as
    which is more, for structure may be narrow across.

    Args:
        residual: NaN where it is not known.
        index: flat indices of the pixels, each once.
        width: of the picture.
    """
    order = np.argsort(index)
    place, known = index[order], residual[order].astype(np.float64)
    most = 0.0
    for step in (1, width):
        at = np.minimum(np.searchsorted(place, place + step), len(place) - 1)
        beside = place[at] == place + step
        if step == 1:
            beside &= place % width != width - 1
        products = known[beside] * known[at[beside]]
        products = products[np.isfinite(products)]
        most = max(most, float(products.mean())) if products.size else most
    return float(np.sqrt(most))


def square_sum_of(values: Float[np.ndarray, " n"]) -> tuple[int, float]:
    """Number and square sum of what is no NaN."""
    known = values[np.isfinite(values)].astype(np.float64)
    return len(known), float(known @ known)


def tile_groups(samples: Samples) -> Iterator[tuple[int, np.ndarray]]:
    """Tile numbers, a fixed number at a time; those beyond the last repeat tile 0."""
    used = int(samples.used)
    for start in range(0, used, _GROUP):
        numbers = np.arange(start, start + _GROUP)
        yield min(_GROUP, used - start), np.where(numbers < used, numbers, 0).astype(np.int32)


@program
def _residuals(vector: AnyArray, samples: Samples, model: Model, numbers: AnyArray) -> jax.Array:
    def residual(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        return tile.light - predict(vector, tile, model)

    return jax.lax.map(residual, jnp.asarray(numbers))


@program
def _air_light(vector: AnyArray, samples: Samples, model: Model, numbers: AnyArray) -> jax.Array:
    def light(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        return predict(vector, tile, model) - predict(vector, tile, model, bare=True)

    return jax.lax.map(light, jnp.asarray(numbers))


@program
def _width_slopes(vector: AnyArray, samples: Samples, model: Model, numbers: AnyArray) -> jax.Array:
    def slopes(number: jax.Array) -> jax.Array:
        tile = tile_at(samples, number)
        found = jnp.zeros_like(tile.light)
        for name in (n for n in (*WIDTHS, "begin", "end") if n in tile.fields):

            def seen(width: jax.Array, name: str = name) -> jax.Array:
                fields = tile.fields | {name: width}
                return predict(vector, replace(tile, fields=fields), model)

            width = tile.fields[name]
            unit = 1 / tile.fields["per_length"] if name not in WIDTHS else jnp.ones_like(width)
            # Where a width is unknown its tile is padding.
            unit = jnp.where(jnp.isfinite(unit), unit, 0)
            found = jnp.maximum(found, jnp.abs(jax.jvp(seen, (width,), (unit,))[1]))
        return found

    return jax.lax.map(slopes, jnp.asarray(numbers))
