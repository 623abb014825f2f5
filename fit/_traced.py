"""`fit` inside JAX's transformations: under `vmap`, `jit` or `grad` the photo is a tracer.

What a traced photo shows is not known while the program is made, so nothing can be decided by it:
no pixel is left out one by one, no parameter held. What comes back is arrays only, a `TracedFit`:
look, covariance and the verdict's code. Plain least squares; float64 where JAX's x64 is on.

The end point solves `gradient = 0`, and optimistix's implicit adjoint differentiates that: the
derivative of the fitted look by the photo, or by what is held fixed, costs one linear solve.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float, Int

from model_jax import FIELDS, InputError, Layers, Look, Response
from model_jax._composite import need_surface
from model_jax._fields import fields_of
from model_jax._shapes import AnyArray, is_traced

from ._verdict import Verdict
from .photo._blocks import block_numbers
from .solve._descend import Atlas, Pass, make_solver, run
from .solve._layout import Layout
from .solve._loss import Loss, weigh
from .solve._model import Model, predict, tile_slopes
from .solve._parameters import (
    FitParameter,
    chart,
    free_directions,
    settle_shares,
    shares_in,
    to_entries,
)
from .solve._samples import Samples, tile_at
from .solve._scaled import unit_diagonal
from .solve._starts import spread_starts

WEIGHTS = (0.0, 0.03, 0.1, 0.3, 1.0, 3.0)
"""Weights of a separable look that a descent starts from; the one that ends lowest counts."""

BLOCK = 16
"""Pixels across the blocks of the covariance: what a traced photo's residuals are is not known, and
most photos' are correlated over less."""

_STEPS = 64
"""Most steps of each descent."""
_NEWTON_STEPS = 8
"""Steps of the root: from where a descent ends they double the digits, and float64 has 53 bits."""


class TracedFit(eqx.Module):
    """A fit as arrays."""

    look: Look
    response: Response
    covariance: Float[jax.Array, "t t"]
    """Covariance of the parameters in `names`, by blocks: what noise does, not what may be wrong
    with the model. NaN where the verdict is not about an optimum."""
    verdict: Int[jax.Array, ""]
    """Code of a `Verdict`."""
    square_sum: Float[jax.Array, ""]
    """Σ residual² over used samples."""
    names: tuple[str, ...] = eqx.field(static=True)


def concrete(look: Look, response: Response) -> tuple[Look, Response]:
    """The same with defaults in place of tracers: what the records of parameters can be made of."""

    def known(record: Any) -> Any:
        default = type(record)()
        values = {
            name: getattr(default if is_traced(getattr(record, name)) else record, name)
            for name in (f.name for f in dataclasses.fields(record))
            if getattr(record, name) is not None
        }
        shapes = {name: np.shape(getattr(record, name)) for name in values}
        return type(record)(**{n: np.broadcast_to(v, shapes[n]) for n, v in values.items()})

    return known(look), known(response)


def fit_traced(
    photo: Float[AnyArray, "h w 3"],
    layers: Layers,
    look: Look,
    response: Response,
    parameters: Sequence[FitParameter],
    used: Any,
    solver: str,
) -> TracedFit:
    """`fit` of one photo, all of it traceable.

    Args:
        photo: linear light; samples that are not finite do not count.
        layers: concrete.
        look, response: start values, and what is not free; may be traced.
        parameters: records of both, made of concrete values.
        used: pixels that may be used, concrete.
    """
    free = [p for p in parameters if p.role == "free"]
    layout = Layout(type(look))
    directions, _ = free_directions(free, parameters)
    dtype = jax.dtypes.canonicalize_dtype(float)
    photo = jnp.asarray(photo, dtype)
    index = np.flatnonzero(used)
    samples = _samples(photo, layers, index, layout)
    for p in free:
        if p.needs is not None and p.needs not in samples.fields:
            raise InputError(f"free: {FIELDS[p.needs].absent}; leave {p.family} out of free")
    linear = all(p.value == 1 and p.role == "fixed" for p in parameters if p.family == "gamma")
    model = Model(Loss("linear"), None, layout, linear)
    start = settle_shares(to_entries(parameters), free, parameters)
    fixed = _fixed(look, response, directions, dtype)
    starts = _starts(start, free, parameters, layout)
    atlases = [_atlas(s, free, parameters, fixed, dtype) for s in starts]
    atlas, step, finite = _best(atlases, samples, model, solver)
    step = _stationary(atlas, samples, model, step)
    entries = atlas.entries(step)
    identified, names = _identified(free, parameters, directions)
    covariance, code = _covariance_and_verdict(
        entries, directions, identified, samples, model, index, photo.shape, free, finite
    )
    fitted, recorded = _records(entries, look, layout)
    return TracedFit(
        fitted, recorded, covariance, code, _square_sum(entries, samples, model), names
    )


def _samples(photo: AnyArray, layers: Layers, index: np.ndarray, layout: Layout) -> Samples:
    """All pixels as one tile; the weight says which samples count."""
    dtype = photo.dtype
    need_surface(layers, layout.kind)
    fields = fields_of(layers, layout.kind.NEEDS)
    light = jnp.asarray(photo).reshape(-1, 3)[index]
    good = jnp.isfinite(light).all(axis=-1)
    surface = None
    if layers.surface is not None:
        surface = jnp.asarray(layers.surface, dtype).reshape(-1, 3)[index].T[None]
    return Samples(
        fields={n: jnp.asarray(f, dtype).reshape(-1)[index][None] for n, f in fields.items()},
        light=jnp.where(good[:, None], light, 0).T[None],
        surface=surface,
        clipped=None,
        one=None,
        weight=good.astype(dtype)[None],
        count=jnp.array([index.size], np.int32),
        photo=jnp.zeros(1, np.int32),
        used=jnp.array(1, np.int32),
        color=jnp.asarray(layers.color, dtype)[None, :3],
    )


def _fixed(look: Look, response: Response, directions: np.ndarray, dtype: Any) -> jax.Array:
    """The vector of what is held, traced; 0 where something moves."""
    values = [(getattr(look, name), p.size) for name, p in type(look).PARAMETERS.items()]
    values += [(getattr(response, name), 1) for name in Layout(type(look)).response]
    parts = [jnp.broadcast_to(jnp.asarray(value, dtype), (size,)) for value, size in values]
    return jnp.where(directions.any(axis=1), 0, jnp.concatenate(parts))


def _starts(
    start: np.ndarray,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    layout: Layout,
) -> list[np.ndarray]:
    """The given start and some beside it, of any look as many."""
    fact = layout.kind.SEPARABLE
    if fact is None:
        return spread_starts(start, free, parameters)[: 1 + len(WEIGHTS)]
    entries = [e for p in free if p.family == fact.weight for e in p.entries]
    found = [start]
    for weight in WEIGHTS if entries else ():
        vector = start.copy()
        vector[entries] = weight
        found.append(vector)
    return found


def _atlas(
    start: np.ndarray,
    free: Sequence[FitParameter],
    parameters: Sequence[FitParameter],
    fixed: jax.Array,
    dtype: Any,
) -> Atlas:
    made = chart(start, free, parameters)
    p = len(made.start)
    moves = np.count_nonzero(made.matrix, axis=1) > 0
    moves[shares_in(parameters)] |= (made.basis != 0).any(axis=1)
    return Atlas(
        base=jnp.where(moves, 0, fixed),
        matrix=jnp.asarray(made.matrix, dtype),
        lower=jnp.asarray(made.lower, dtype),
        upper=jnp.asarray(made.upper, dtype),
        scale=jnp.asarray(made.scale, dtype),
        basis=jnp.asarray(made.basis, dtype),
        total=jnp.asarray(made.total, dtype),
        start=jnp.asarray(made.start, dtype),
        whiten=jnp.eye(p, dtype=dtype),
        shares=made.shares,
    )


def _best(
    atlases: list[Atlas], samples: Samples, model: Model, solver: str
) -> tuple[Atlas, jax.Array, jax.Array]:
    """The descent that ends lowest: its atlas, its step, and whether it is finite."""
    dtype = samples.like.dtype
    tolerance = 64 * float(jnp.finfo(dtype).eps)
    size = jnp.sqrt((samples.light**2).sum())
    size = jnp.where(size > 0, size, 1)
    stacked = jax.tree.map(lambda *parts: jnp.stack(parts), *atlases)

    def descend(atlas: Atlas) -> tuple[jax.Array, jax.Array]:
        pass_ = Pass(atlas, samples, model, size)
        step, _, _ = run(make_solver(solver, tolerance), pass_, _STEPS)
        cost = pass_(step)[-1, -1]
        good = jnp.isfinite(step).all() & jnp.isfinite(cost)
        return step, jnp.where(good, cost, jnp.inf)

    steps, costs = jax.vmap(descend)(jax.lax.stop_gradient(stacked))
    best = jnp.argmin(costs)
    atlas = jax.tree.map(lambda part: part[best], stacked)
    return atlas, jnp.nan_to_num(steps[best]), jnp.isfinite(costs[best])


def _stationary(atlas: Atlas, samples: Samples, model: Model, step: jax.Array) -> jax.Array:
    """The end point as a root, which is what makes it differentiable."""

    def gradient(step: jax.Array, arguments: Any) -> jax.Array:
        atlas, samples, model = arguments

        def half(step: jax.Array) -> jax.Array:
            return _square_sum(atlas.entries(step), samples, model) / 2

        return jax.grad(half)(step)

    eps = float(jnp.finfo(step.dtype).eps)
    step = jax.lax.stop_gradient(step)
    solution: Any = optx.root_find(
        gradient,
        optx.Newton(rtol=64 * eps, atol=64 * eps),
        step,
        (atlas, samples, model),
        max_steps=_NEWTON_STEPS,
        throw=False,
    )
    # Where nothing is told Newton's equations have no solution; the descent's end stands then.
    # Its steps at rounding level may be too many for optimistix to call it a success.
    before, after = (_square_sum(atlas.entries(s), samples, model) for s in (step, solution.value))
    rounding = (64 * eps) ** 2 * (samples.light**2).sum()
    identified = jnp.isfinite(solution.value).all() & (after <= before * (1 + 1e-3) + rounding)
    return jnp.where(identified, solution.value, step)


def _square_sum(entries: jax.Array, samples: Samples, model: Model) -> jax.Array:
    tile = tile_at(samples, jnp.array(0))
    cost, _, _ = weigh(predict(entries, tile, model) - tile.light, None, model.loss)
    return (cost * tile.weight[None]).sum()


def _covariance_and_verdict(
    entries: jax.Array,
    directions: np.ndarray,
    identified: np.ndarray,
    samples: Samples,
    model: Model,
    index: np.ndarray,
    shape: tuple[int, ...],
    free: Sequence[FitParameter],
    finite: jax.Array,
) -> tuple[jax.Array, jax.Array]:
    """Covariance and verdict code."""
    dtype = entries.dtype
    tile = tile_at(samples, jnp.array(0))
    predicted, slopes = tile_slopes(entries, jnp.asarray(directions, dtype), tile, model)
    residual = (predicted - tile.light) * tile.weight[None]
    slopes = slopes * tile.weight[None, None]
    scores = jnp.einsum("icn,cn->ni", slopes, residual)
    curved = jnp.einsum("icn,jcn->ij", slopes, slopes)
    gradient, square_sum = scores.sum(axis=0), (residual**2).sum()
    p = directions.shape[1]
    count = 3 * tile.weight.sum()
    unit, size = unit_diagonal(curved)
    near = jnp.stack([_near_bound(entries, q) for q in free])
    eps = float(jnp.finfo(dtype).eps)
    brightest = jnp.abs(tile.light).max()
    # Along what stands at a bound and would go beyond, nothing is promised and nothing is told. A
    # gradient of residuals that are rounding, each to some eps of the brightest, goes nowhere.
    nowhere = 8 * eps * brightest * jnp.sqrt(count * jnp.diagonal(curved))
    stuck = jnp.zeros(p, bool)
    for k, q in enumerate(free):
        if not q.mean_one:
            moves = jnp.asarray(directions[q.entries[0]] != 0)
            stuck |= moves & (near[k] != 0) & (near[k] * gradient > nowhere)
    either = stuck[None] | stuck[:, None]
    scaled = jnp.where(either, jnp.eye(p, dtype=dtype), unit)
    gradient = jnp.where(stuck, 0, gradient)
    values, vectors = jnp.linalg.eigh(scaled)
    floor = 64 * p * eps
    is_flat = (values[0] <= floor) | ~(jnp.diagonal(curved) > 0).all()
    inverse_values = jnp.where(values > floor, 1 / jnp.maximum(values, floor), 0)
    inverse = (vectors * inverse_values[None]) @ vectors.T / size[None] / size[:, None]
    promise = gradient @ inverse @ gradient
    variance = square_sum / jnp.maximum(count - p, 1)
    blocks = block_numbers(index, (shape[0], shape[1]), BLOCK)
    number = int(blocks.max(initial=0)) + 1
    sums = jax.ops.segment_sum(scores, jnp.asarray(blocks), number)
    middle = sums.T @ sums * (number / max(number - p, 1))
    spread = identified @ inverse
    rounding = count * (eps * brightest) ** 2
    code = jnp.where((near != 0).any(), Verdict.AT_BOUND, Verdict.CONVERGED)
    code = jnp.where(is_flat, Verdict.NOT_IDENTIFIABLE, code)
    # The gradient itself is only known to rounding: p sums over all samples.
    settled = promise <= 1e-3 * variance + 64 * p * rounding
    code = jnp.where(settled, code, Verdict.NOT_CONVERGED)
    code = jnp.where(finite & jnp.isfinite(entries).all(), code, Verdict.DIVERGED)
    code = jnp.where((count > 3 * p) & (brightest > 0), code, Verdict.NO_DATA)
    covariance = spread @ middle @ spread.T
    unidentified = jnp.asarray(identified != 0) @ stuck
    covariance = jnp.where(unidentified[None] | unidentified[:, None], jnp.nan, covariance)
    good = (code == Verdict.CONVERGED) | (code == Verdict.AT_BOUND)
    return jnp.where(good, covariance, jnp.nan), code


def _near_bound(entries: jax.Array, p: FitParameter) -> jax.Array:
    """1 at the lower bound of a parameter, -1 at its upper one, 0 between."""
    value, room = entries[p.entries[0]], 1e-3 * p.scale
    return jnp.where(value - p.lower <= room, 1, jnp.where(p.upper - value <= room, -1, 0))


def _identified(
    free: Sequence[FitParameter], parameters: Sequence[FitParameter], directions: np.ndarray
) -> tuple[np.ndarray, tuple[str, ...]]:
    """Rows of what moves along the directions, and its names."""
    moved = [p for p in parameters if p.role != "fixed" and np.any(p.of(directions))]
    rows = np.array([p.of(directions) for p in moved]).reshape(len(moved), directions.shape[1])
    return rows, tuple(p.name for p in moved)


def _records(entries: jax.Array, like: Look, layout: Layout) -> tuple[Look, Response]:
    def part(value: jax.Array, old: Any) -> jax.Array:
        return value if np.shape(old) or not np.ndim(value) else value[0]

    values = {n: part(v, getattr(like, n)) for n, v in layout.values(entries).items()}
    return layout.kind(**values), Response(*layout.responses(entries)[0])
