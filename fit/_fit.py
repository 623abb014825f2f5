"""`fit`: photos and layers in, look with error bars out.

choose pixels ──> samples ──> search, by descents ──> errors ──> verdict
(_pixels)         (_stream)   (_search, _solve)       (_uncertainty,  (here, _result)
                                                       _compression)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from os import PathLike
from time import perf_counter
from typing import Any, overload

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import InputError, Layers, Look, Response
from model_jax._kinds import need
from model_jax._shapes import AnyArray, is_traced

from ._bare_limb import EVIDENCE, NO_BARE_LIMB, find_air
from ._choices import (
    JpegHandling,
    LossName,
    Sampling,
    check_jpeg,
    check_loss,
    check_sampling,
    check_steps,
)
from ._compile import float64, program
from ._compression import Undone, is_coarse, undo_compression
from ._loss import Loss, weigh
from ._memory import bound_programs, give_back
from ._misfit import CAUSES, Doubts, find_doubts
from ._parameters import (
    CHANNELS,
    TINT,
    Entries,
    Parameter,
    declare,
    directions,
    followers,
    links,
    pairs,
    to_entries,
    to_look,
    to_responses,
)
from ._photo import Photo
from ._pixels import (
    Columns,
    PhotoLike,
    Pixels,
    as_picture,
    choose_pixels,
    grey_spread,
    light_at,
    on_device,
    share_widths,
    size_of,
    take_columns,
    to_samples,
)
from ._result import Errors, Estimate, FitResult, LeftOut, PhotoResult
from ._search import End, Problem, search, state
from ._solve import make_solver
from ._stream import Model, Prior
from ._traced import TracedFit, concrete, fit_traced
from ._uncertainty import (
    Spread,
    influence_maps,
    reach_95,
    residuals_of,
    rounding_bound,
    spread_of,
    width_slopes_of,
)
from ._verdict import MOST_CLIPPED, STRUCTURED_PX, VERDICTS, WELL_EXPLAINED, Verdict

MAX_STEPS = {"nelder_mead": 4096}
"""Steps a solver is given unless told; 256 for those with derivatives."""

LARGE = 2**21
"""Samples from which on memory is counted."""

BELIEVED = 0.25
"""Weight from which a sample of a robust fit counts as light to be explained: with Cauchy's loss
that of four standard deviations of the noise."""

_ROUNDING = 1e-9
"""Noise there is at least, of the brightest sample."""
_ROUNDS = 6
_SAME_NOISE = 0.01
"""Relative change of the noise estimate below which no further round is made."""


@overload
def fit(  # type: ignore[overload-overlap]  # a tracer passes for an array in JAX's types
    photo: jax.core.Tracer,
    layers: Layers,
    look: Look = ...,
    *,
    free: Iterable[str] | str | None = ...,
    response: Response = ...,
    bounds: Mapping[str, tuple[float, float]] | None = ...,
    priors: Mapping[str, tuple[float, float]] | None = ...,
    tied: Mapping[str, str] | None = ...,
    loss: str = ...,
    sampling: str = ...,
    solver: str = ...,
    max_steps: int | None = ...,
) -> TracedFit: ...


@overload
def fit(
    photo: PhotoLike | Sequence[PhotoLike],
    layers: Layers | Sequence[Layers],
    look: Look = ...,
    *,
    free: Iterable[str] | str | None = ...,
    response: Response | Sequence[Response] = ...,
    bounds: Mapping[str, tuple[float, float]] | None = ...,
    priors: Mapping[str, tuple[float, float]] | None = ...,
    tied: Mapping[str, str] | None = ...,
    loss: str = ...,
    jpeg: str = ...,
    sampling: str = ...,
    solver: str = ...,
    max_steps: int | None = ...,
) -> FitResult: ...


def fit(
    photo: Any,
    layers: Any,
    look: Any = Look(),  # noqa: B008 (a frozen record)
    *,
    free: Any = None,
    response: Any = Response(),  # noqa: B008 (a frozen record)
    bounds: Any = None,
    priors: Any = None,
    tied: Any = None,
    loss: Any = "linear",
    jpeg: Any = "keep",
    sampling: Any = "area",
    solver: Any = "lm",
    max_steps: Any = None,
) -> FitResult | TracedFit:
    """Fit the look of layers to a photo, or to several photos, by least squares in linear light.

    The model is `record(composite(layers, look), response)`, of `model_jax`, without alpha:
    `black_level + (exposure · (surface + air + background))^(1/gamma)`. Residuals are unweighted,
    all channels alike. While tint is free its mean is 1. Samples at a photo's highest or lowest
    code count as "at least this bright" and "at most".

    Args:
        photo: a loaded photo, or linear light [h, w, 3] as floats (JAX or NumPy); or a sequence of
            them. Several photos share the look, in physical units: brightness refers to the first
            layers' `width_unit`, and all layers must use one length unit.
        layers: of the photo's size, float32 or float64; one for each photo.
        look: start values; what is not free stays as it is. One number or three in `shadow` and
            `background` decides whether they are fitted as one or per channel.
        free: names to fit, such as "brightness", "tint" (all channels), "tint.r", "exposure.2".
            None means the look, and with several photos also black levels and exposures but the
            first.
        response: start values of each photo's response, or one for all.
        bounds: name → (lower, upper), narrower than the parameter's own.
        priors: name → (mean, standard deviation) known before.
        tied: name → name it shall equal, of the same kind: `{"gamma.2": "gamma.1"}`.
        loss: "linear" (least squares), "huber", "soft_l1" or "cauchy"; the robust ones doubt
            samples whose residual is large beside the median.
        jpeg: "undo" corrects values and intervals for what JPEG did to the photos, by fits to files
            that are compressed alike, for seconds; "keep" warns of it only.
        sampling: "area" if pixels show means over their squares, or parts of them, as a camera's
            and a supersampled picture's do: pixels on edges are left out, and intervals hold what
            the bend of the light does in the others. "point" if they show the light in their
            middles, as in a render without antialiasing: every pixel of air is used.
        solver: lm, dogleg, gauss_newton, bfgs, lbfgs or nelder_mead, of optimistix.
        max_steps: of the solver, for each of the few descents.

    Returns:
        A `FitResult`; that a photo cannot be fitted is its verdict, not an error. All computing is
        in float64, whatever the layers' type and JAX's setting. Under `jax.vmap`, `jit` or `grad`,
        where photo, look or response is traced: a `TracedFit`, arrays only, of one photo by plain
        least squares, in JAX's precision; it is differentiable by all three.

    Raises:
        InputError: an argument of the wrong kind (a path, a scene …), traced layers, sizes that
            differ, wrong array type or shape, unknown names, contradictory bounds, a prior without
            width, a circle of ties.
    """
    _check_kinds(photo, layers, look, response, max_steps)
    bounds = pairs("bounds", "(lower, upper)", bounds)
    priors = pairs("priors", "(mean, standard deviation)", priors)
    tied = links(tied)
    if is_traced(photo, look, response):
        return _fit_traced(
            photo, layers, look, free, response, bounds, priors, tied, loss, sampling, solver
        )
    with float64():
        bound_programs()
        photos, all_layers = _pairs(photo, layers)
        responses = _responses(response, len(photos))
        parameters = declare(look, responses, free=free, bounds=bounds, priors=priors, tied=tied)
        loss_name, handling, sampled = check_loss(loss), check_jpeg(jpeg), check_sampling(sampling)
        make_solver(solver)
        steps = MAX_STEPS.get(solver, 256) if max_steps is None else max_steps
        named = free is not None
        task = _Task(
            photos, all_layers, look, parameters, loss_name, handling, sampled, solver, steps, named
        )
        return _fit(task)


def _fit_traced(
    photo: Any,
    layers: Any,
    look: Look,
    free: Any,
    response: Any,
    bounds: Any,
    priors: Any,
    tied: Any,
    loss: str,
    sampling: str,
    solver: str,
) -> TracedFit:
    """The same for a tracer, with errors for what cannot be traced."""
    single = not isinstance(photo, Sequence) and isinstance(response, Response)
    if not single or priors or loss != "linear" or isinstance(photo, Photo):
        raise InputError(
            "fit: under jit, vmap or grad it takes one array as photo, loss='linear' and no "
            "priors; call it outside of them for more"
        )
    layers = jax.tree.map(np.asarray, layers)  # inside jit, JAX's operations on them would trace
    known = concrete(look, response)
    parameters = declare(known[0], [known[1]], free=free, bounds=bounds, tied=tied)
    make_solver(solver)
    shown = np.ones(np.shape(photo))  # any picture: which pixels may be used is the layers' affair
    used = choose_pixels(shown, layers, check_sampling(sampling)).used
    return fit_traced(photo, layers, look, response, parameters, used, solver)


@dataclass(frozen=True)
class _Task:
    """What was asked."""

    photos: tuple[PhotoLike, ...]
    layers: tuple[Layers, ...]
    look: Look
    parameters: tuple[Parameter, ...]
    loss: LossName
    jpeg: JpegHandling
    sampling: Sampling
    solver: str
    max_steps: int
    named: bool
    """The user named what is free."""

    @property
    def sizes(self) -> list[tuple[int, int]]:
        return [size_of(photo) for photo in self.photos]


def _fit(task: _Task) -> FitResult:
    """The work, once it is known what was asked."""
    times = [perf_counter()]
    seen = list(zip(task.photos, task.layers, strict=True))
    pixels = [choose_pixels(p, la, task.sampling) for p, la in seen]
    unit = float(task.layers[0].width_unit)
    columns = tuple(
        take_columns(p, la, px.used, unit) for (p, la), px in zip(seen, pixels, strict=True)
    )
    asked, left_out = _leave_out(task, columns)
    why_not = _no_data(task, pixels, columns, asked)
    if why_not:
        return _without_data(why_not, task, pixels, columns, left_out)
    problem = _problem(task, columns)
    columns = problem.columns
    times.append(perf_counter())
    problem, end = _rounds(task, problem, asked)
    if problem.count > LARGE:
        give_back()  # what compiling left behind
    times.append(perf_counter())
    result = _judge(task, problem, end, pixels, [*_pixel_remarks(pixels), *left_out])
    airless = _airless(task, pixels, columns, result)
    if all(airless):
        result = _without_data(str(airless[0]), task, pixels, columns, left_out)
    else:
        result = _warned(
            result,
            [
                f"Photo {number}: {why}. Leave it out, or check its alignment and exposure."
                for number, why in enumerate(airless, 1)
                if why
            ],
        )
    times.append(perf_counter())
    names = ("reduce", "solve", "errors")
    spans = zip(names, pairwise(times), strict=True)
    return replace(result, seconds={name: after - before for name, (before, after) in spans})


def _pixel_remarks(pixels: Sequence[Pixels]) -> list[LeftOut]:
    """What could not be taken into account of the pixels used."""
    return [
        LeftOut(f"{what}, photo {number}" if len(pixels) > 1 else what, why)
        for number, px in enumerate(pixels, 1)
        for what, why in px.remarks
    ]


def _warned(result: FitResult, warnings: Sequence[str]) -> FitResult:
    """The result with more warnings."""
    return replace(
        result,
        warnings=(*result.warnings, *warnings),
        message=" ".join([result.message, *warnings]),
    )


@dataclass(frozen=True)
class Evidence:
    """Samples and end point, for what a result computes on demand."""

    task: _Task
    problem: Problem
    end: End
    along: Float[np.ndarray, "e p"]
    told: tuple[Parameter, ...]
    spread: Spread

    def to_told(self) -> Float[np.ndarray, "t p"]:
        """Rows of the told parameters along the free directions."""
        rows = [p.of(self.along) for p in self.told]
        return np.array(rows).reshape(len(self.told), self.along.shape[1])

    def influence(self, name: str) -> list[Float[np.ndarray, "_ _ 3"]]:
        """`FitResult.influence` for all photos."""
        row = self.to_told()[[p.name for p in self.told].index(name)]
        problem = self.problem
        return influence_maps(
            problem.columns,
            self.task.sizes,
            problem.samples,
            problem.model,
            self.end.vector,
            self.along,
            row,
            self.spread.hessian,
        )

    def weights(self) -> list[Float[np.ndarray, "_ _"]]:
        """`FitResult.weights` for all photos."""
        found = []
        sizes = self.task.sizes
        residuals = _residuals(self.problem, self.end)
        for c, size, residual in zip(self.problem.columns, sizes, residuals, strict=True):
            weights = np.full(size, np.nan, np.float32)
            believed = _believed(residual, self.problem.model.loss)
            weights.reshape(-1)[c.index] = believed.min(axis=-1)
            found.append(weights)
        return found


_CHUNK = 65536


def _believed(residual: Float[np.ndarray, "n 3"], loss: Loss) -> Float[np.ndarray, "n 3"]:
    """Weight that a loss gives to samples, 0 to 1; 1 for clipped ones."""
    if loss.name == "linear":
        return np.broadcast_to(1.0, residual.shape)
    found = np.empty_like(residual)
    piece = np.zeros((_CHUNK, 3))  # of one size, so that JAX compiles once
    with float64():
        for start in range(0, len(residual), _CHUNK):
            part = np.nan_to_num(residual[start : start + _CHUNK])
            piece[: len(part)] = part
            found[start : start + _CHUNK] = np.asarray(_belief(piece, loss))[: len(part)]
    return found


@program
def _belief(residual: Float[AnyArray, "n 3"], loss: Loss) -> Float[jax.Array, "n 3"]:
    return weigh(jnp.asarray(residual), None, loss)[2]


def _check_kinds(photo: Any, layers: Any, look: Any, response: Any, max_steps: Any) -> None:
    """Slips that Python would otherwise take for something else: a path for a row of letters."""
    for one in photo if isinstance(photo, list | tuple) else (photo,):
        if isinstance(one, str | PathLike):
            raise InputError(
                f"photo: {str(one)!r} is a path, no picture; give load_photo({str(one)!r})"
            )
        if not isinstance(one, Photo | np.ndarray | jax.Array):
            raise InputError(
                f"photo: is of type {type(one).__name__}; give what load_photo returns, or linear "
                "light as an array [height, width, 3] of floats; of several photos a list of these"
            )
    for one in layers if isinstance(layers, list | tuple) else (layers,):
        need("layers", one, Layers)
    if is_traced(layers):
        raise InputError("fit: the layers are traced; make them outside of jit, vmap or grad")
    need("look", look, Look)
    for one in response if isinstance(response, list | tuple) else (response,):
        need("response", one, Response)
    check_steps("max_steps", max_steps)


def _pairs(
    photo: Any, layers: Layers | Sequence[Layers]
) -> tuple[tuple[PhotoLike, ...], tuple[Layers, ...]]:
    is_one = isinstance(photo, Photo | np.ndarray | jax.Array)
    photos: tuple[Any, ...] = (photo,) if is_one else tuple(photo)
    many = (layers,) if isinstance(layers, Layers) else tuple(layers)
    if len(photos) != len(many) or not photos:
        raise InputError(
            f"fit: got {len(photos)} photos and {len(many)} sets of layers; give one for each"
        )
    return photos, many


def _responses(response: Response | Sequence[Response], count: int) -> tuple[Response, ...]:
    if isinstance(response, Response):
        return (response,) * count
    responses = tuple(response)
    if len(responses) != count:
        raise InputError(f"fit: got {len(responses)} responses for {count} photos; give one each")
    return responses


def _problem(task: _Task, columns: tuple[Columns, ...]) -> Problem:
    """Samples on the device, with plain least squares as the model."""
    free = [p for p in task.parameters if p.role != "fixed"]
    gammas = [p for p in task.parameters if p.family == "gamma"]
    linear = not any(p in free for p in gammas) and all(p.value == 1 for p in gammas)
    samples = to_samples(columns)
    columns = share_widths(columns, samples)
    return state(columns, on_device(samples), task.parameters, Model(Loss("linear"), None, linear))


def _rounds(task: _Task, problem: Problem, asked: tuple[Parameter, ...]) -> tuple[Problem, End]:
    """The search; for all but plain least squares again and again, with the noise found before."""
    start = to_entries(task.parameters)
    has_priors = any(p.prior is not None for p in asked)
    if task.loss == "linear" and not has_priors and problem.samples.clipped is None:
        return problem, search(problem, start, asked, task.solver, task.max_steps)
    believing = replace(problem.samples, clipped=None)
    rough = state(problem.columns, believing, task.parameters, problem.model).rough()
    end = search(rough, start, asked, task.solver, task.max_steps, last=False)
    noise = 0.0
    # Cauchy has valleys of its own; Huber, which has none, shows it the right one.
    losses: list[LossName] = ["huber"] if task.loss == "cauchy" else []
    for number in range(_ROUNDS):
        if not end.finite:
            return problem, end
        found = _noise(task, problem, end, _residuals(problem, end))
        if number > 1 and abs(found - noise) <= _SAME_NOISE * noise:
            break
        noise = found
        with float64():
            priced = Loss(losses.pop() if losses else task.loss, jnp.asarray(noise))
        prior = _prior(asked, noise, len(start))
        problem = problem.with_model(Model(priced, prior, problem.model.linear))
        end = search(
            problem.rough(),
            start,
            asked,
            task.solver,
            task.max_steps,
            seeds=[end.vector],
            last=False,
        )
    return problem, search(problem, start, asked, task.solver, task.max_steps, seeds=[end.vector])


def _residuals(problem: Problem, end: End) -> list[Float[np.ndarray, "_ 3"]]:
    return residuals_of(problem.columns, problem.samples, problem.model, end.vector)


def _noise(
    task: _Task, problem: Problem, end: End, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> float:
    """Standard deviation of a measured sample; for robust losses by the median.

    1.4826 median |r| is the standard deviation of normal residuals (Hampel, J. Am. Stat. Assoc. 69,
    1974). Never quite zero: a prior and a bound need something to be measured in.
    """
    least = _ROUNDING * problem.light_max
    if task.loss == "linear":
        counted = [_square_sum(r[:, k]) for r in residuals for k in range(3)]
        known, square_sum = np.sum(counted, axis=0)
        return max(float(np.sqrt(square_sum / max(known - len(end.free), 1))), least)
    known = np.concatenate([r[np.isfinite(r)] for r in residuals])
    if not known.size:
        return least
    return max(1.4826 * float(np.median(np.abs(known))), least)


def _square_sum(values: Float[np.ndarray, " n"]) -> tuple[int, float]:
    """Number and square sum of what is no NaN."""
    known = values[np.isfinite(values)].astype(np.float64)
    return len(known), float(known @ known)


def _prior(asked: Sequence[Parameter], noise: float, size: int) -> Prior | None:
    mean, weight = np.zeros(size), np.zeros(size)
    for p in asked:
        if p.prior is not None:
            mean[p.entries[0]], weight[p.entries[0]] = p.prior.mean, (noise / p.prior.sigma) ** 2
    with float64():
        return Prior(jnp.asarray(mean), jnp.asarray(weight)) if weight.any() else None


def _leave_out(
    task: _Task, columns: Sequence[Columns]
) -> tuple[tuple[Parameter, ...], list[LeftOut]]:
    """What can be fitted at all: no weight without shadow, no tint without colour or alone."""
    asked = [p for p in task.parameters if p.role == "free"]
    left_out: list[LeftOut] = []
    count = sum(len(c.lit) for c in columns)
    has_dark = any(c.dark is not None and (c.dark > c.width_error).any() for c in columns)
    has_lit = any((c.lit > c.width_error).any() for c in columns)
    why = None
    if not any(layers.has_shadow for layers in task.layers):
        why = "the layers hold no shadow: no sun is given, or no air in view is in shadow"
    elif count and not has_dark:
        why = "no pixel used is in shadow"
    elif count and not has_lit and any(p.family == "brightness" for p in asked):
        why = "no pixel used is lit, so only brightness × shadow is told; shadow is held"
    if why and any(p.family == "shadow" for p in asked):
        asked = [p for p in asked if p.family != "shadow"]
        left_out.append(LeftOut("shadow weight", why))
    for k, channel in enumerate(CHANNELS):
        if all(c.color[k] == 0 for c in columns):
            colourless = {f"tint.{channel}", f"shadow.{channel}"}
            why = f"the air's color is 0 in channel {channel}"
            left_out += [LeftOut(p.name, why) for p in asked if p.name in colourless]
            asked = [p for p in asked if p.name not in colourless]
    tints = [p for p in asked if p.family == "tint"]
    if tints and columns and all(len(c.copies) == 2 for c in columns):
        named = [p.name for p in tints] if len(tints) < 3 else ["tint"]
        left_out += [LeftOut(name, "a grey photo does not tell colours") for name in named]
        asked = [p for p in asked if p not in tints]
        tints = []
    if tints and not directions(tints, task.parameters)[0].shape[1]:
        left_out.append(LeftOut(tints[0].name, "the mean of the tints fixes the only free one"))
        asked.remove(tints[0])
    return tuple(asked), left_out


def _no_data(
    task: _Task,
    pixels: Sequence[Pixels],
    columns: Sequence[Columns],
    asked: tuple[Parameter, ...],
) -> str | None:
    """Why there is nothing to fit, or None."""
    for number, (photo, px, c) in enumerate(zip(task.photos, pixels, columns, strict=True)):
        which = f"photo {number + 1}: " if len(columns) > 1 else ""
        if not px.count:
            counts = ", ".join(f"{count} {reason}" for reason, count in px.excluded.items())
            return f"{which}no pixel can be used ({counts})"
        measured = np.ones_like(c.light, bool) if c.clipped is None else c.clipped == 0
        if c.clipped is not None and not measured.any():
            what = "saturated" if (c.clipped > 0).any() else "black"
            return f"{which}the photo is {what} where the air is"
        if not light_at(photo, c.index).any():
            return f"{which}the photo is black where the air is"
        light = np.where(measured, c.light, np.nan)
        constant = not (np.nanmax(light, axis=0) > np.nanmin(light, axis=0)).any()
        if constant and c.clipped is None and _varies(c):
            return f"{which}the photo is the same in all pixels used, the air is not"
    need = directions(asked, task.parameters)[0].shape[1] + 1
    count = sum(px.count for px in pixels)
    if count < need:
        return f"the number of pixels that can be used is {count}, needed are {need}"
    return None


def _varies(columns: Columns) -> bool:
    """The air's width is not the same everywhere."""
    parts = [columns.lit] if columns.dark is None else [columns.lit, columns.dark]
    return any(float(np.ptp(part)) > 2 * columns.width_error for part in parts)


def _judge(
    task: _Task,
    problem: Problem,
    end: End,
    pixels: Sequence[Pixels],
    left_out: list[LeftOut],
) -> FitResult:
    """Errors and verdict at the end point."""
    along, _ = directions(end.free, task.parameters)
    told = tuple(_told(task, end)) if end.finite else ()
    spread: Spread | None = None
    covariance = np.zeros((0, 0))
    bias: list[float | None] = [None] * len(told)
    drawn: list[float | None] = [None] * len(told)
    reach = np.zeros(len(told))
    evidence = None
    noise = np.nan
    vector, undone = end.vector, None
    doubts = Doubts((), np.zeros((len(told), len(told))))
    residuals = _residuals(problem, end)
    if end.finite:
        noise = _noise(task, problem, end, residuals)
        spread = spread_of(
            problem.columns,
            task.sizes,
            problem.samples,
            problem.model,
            end.vector,
            along,
            residuals,
            noise,
            _ROUNDING * problem.light_max,
        )
        evidence = Evidence(task, problem, end, along, told, spread)
        rows = evidence.to_told()
        covariance = rows @ spread.covariance @ rows.T
        reach = reach_95(spread.freedom(rows))
        bias, drawn = _bias(evidence, rows), _drawn(evidence, rows)
        undone = _undone(evidence, residuals, noise) if task.jpeg == "undo" else None
        if isinstance(undone, str):
            left_out = [*left_out, LeftOut("what JPEG did", undone)]
            undone = None
        if undone is not None:
            vector = end.vector + along @ undone.shift
            covariance = rows @ undone.covariance @ rows.T
            reach = reach_95(np.full(len(told), undone.freedom))
        # What compression leaves over is no other cause's.
        doubts = _doubts(evidence, rows, residuals, look_for_causes=undone is None)
    covariance = covariance + doubts.covariance
    if problem.samples.mix is not None:
        covariance = covariance + np.diag(_grey_variance(problem.columns, told, vector))
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0))
    # The told tints add up to 3; a length of zero is a parameter that nothing can move.
    lengths = np.where(stderr > 0, stderr, 1.0)
    correlation = np.clip(covariance / np.outer(lengths, lengths), -1, 1)
    np.fill_diagonal(correlation, 1.0)
    names = [p.name for p in told]
    held = {p.name for flat in end.flat for p in flat.held}
    estimates = {}
    for p in task.parameters:
        k = names.index(p.name) if p.name in names else None
        estimates[p.name] = _estimate(
            p,
            float(p.of(vector)),
            role=_role(p, names, end, held),
            stderr=None if k is None else float(stderr[k]),
            reach=None if k is None else float(reach[k] * stderr[k]),
            bias=None if k is None else bias[k],
            drawn=None if k is None else drawn[k],
            undone=None if k is None or undone is None else float(p.of(vector - end.vector)),
        )
    responses = to_responses(vector)
    photos = tuple(_photo_results(task, problem, end, responses, pixels, residuals))
    left_out = left_out + [
        LeftOut(p.name, f"{flat.why}; held at its start value")
        for flat in end.flat
        for p in flat.held
    ]
    verdict = _verdict(task, end)
    errors = None
    if spread is not None:
        errors = Errors(
            noise=noise,
            correlation_px=spread.correlation_px,
            block_px=spread.block_px,
            blocks=spread.blocks,
            effective_samples=problem.count / spread.area,
        )
    result = FitResult(
        verdict=verdict.label,
        message="",
        warnings=(),
        parameters=estimates,
        correlation_names=tuple(names),
        correlation=correlation,
        covariance=covariance,
        errors=errors,
        look=to_look(vector, task.look),
        photos=photos,
        left_out=tuple(left_out),
        misfits=doubts.misfits,
        loss=task.loss,
        solver=task.solver,
        history=end.history,
        second_opinion=end.second,
        evidence=evidence,
    )
    message = _message(verdict, result, [p.name for p in end.at_bound])
    return _warned(replace(result, message=message), _warnings(result, task, residuals))


def _grey_variance(
    columns: Sequence[Columns], told: Sequence[Parameter], vector: Entries
) -> Float[np.ndarray, " t"]:
    """What is not known of how photos were made grey, as variance of the told parameters.

    It is a factor on a grey photo's light: brightness, or the exposure beside a photo in colour.
    """
    grey = [c.mix is not None for c in columns]
    found = np.zeros(len(told))
    for k, p in enumerate(told):
        number = int(p.name.partition(".")[2] or 1) - 1 if p.family == "exposure" else 0
        unsure = grey[number] != grey[0] if p.family == "exposure" else grey[0]
        if unsure and p.family in ("brightness", "exposure"):
            color = columns[number].color * vector[TINT]
            found[k] = (grey_spread(color) * float(p.of(vector))) ** 2
    return found


def _verdict(task: _Task, end: End) -> Verdict:
    if not end.finite:
        return Verdict.DIVERGED
    if not end.settled:
        return Verdict.NOT_CONVERGED
    if end.at_bound:
        return Verdict.AT_BOUND
    told = {p.name for p in _told(task, end)}
    lost = any(p.role == "free" and p.name not in told for p in task.parameters)
    return Verdict.NOT_IDENTIFIABLE if task.named and lost else Verdict.CONVERGED


def _told(task: _Task, end: End) -> list[Parameter]:
    """Free parameters and what is tied to them; a lone free tint is fixed by the mean."""
    members = [q for p in end.free for q in followers(p, task.parameters)]
    tints = sum(p.family == "tint" for p in members)
    names = {p.name for p in members if p.family != "tint" or tints > 1}
    return [p for p in task.parameters if p.name in names]


def _role(p: Parameter, told: Sequence[str], end: End, held: set[str]) -> str:
    if p.role == "tied":
        return "tied"
    if p.name in told:
        return "free"
    if any(p.name == q.name for q in end.at_bound):
        return "at_bound"
    return "held" if p.role == "free" or p.name in held else "fixed"


def _bias(evidence: Evidence, rows: Float[np.ndarray, "t p"]) -> list[float | None]:
    """Each told parameter's bound on the bias by the photos' rounding to codes."""
    half_steps = _half_steps(evidence.task.photos, evidence.problem.columns)
    return _shifted(evidence, rows, half_steps)


def _doubts(
    evidence: Evidence,
    rows: Float[np.ndarray, "t p"],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    look_for_causes: bool,
) -> Doubts:
    """What may be wrong with the told values beside noise."""
    problem = evidence.problem
    return find_doubts(
        problem.columns,
        evidence.task.layers,
        problem.model,
        evidence.end.vector,
        evidence.along,
        rows,
        evidence.spread.hessian,
        residuals,
        [_believed(r, problem.model.loss) > BELIEVED for r in residuals],
        _half_steps(evidence.task.photos, problem.columns),
        evidence.task.sampling,
        look_for_causes,
    )


def _half_steps(
    photos: Sequence[PhotoLike], columns: Sequence[Columns]
) -> list[Float[np.ndarray, "_ 3"] | None]:
    """Half a code step of each used sample."""
    found: list[np.ndarray | None] = []
    for photo, c in zip(photos, columns, strict=True):
        steps = None
        if isinstance(photo, Photo) and photo.codes is not None and photo.half_steps is not None:
            steps = photo.half_steps[photo.codes.reshape(-1, 3)[c.index]]
        found.append(steps)
    return found


def _drawn(evidence: Evidence, rows: Float[np.ndarray, "t p"]) -> list[float | None]:
    """How far the layers' own errors can shift each told parameter."""
    problem = evidence.problem
    if all(c.drawn_error is None for c in problem.columns):
        return [None] * len(rows)
    slopes = width_slopes_of(problem.columns, problem.samples, problem.model, evidence.end.vector)
    steps = [
        None if c.drawn_error is None else slope * c.drawn_error[:, None]
        for c, slope in zip(problem.columns, slopes, strict=True)
    ]
    return _shifted(evidence, rows, steps)


def _shifted(
    evidence: Evidence, rows: Float[np.ndarray, "t p"], steps: Sequence[np.ndarray | None]
) -> list[float | None]:
    """How far each told parameter moves if all samples are off by so much, all conspiring."""
    problem = evidence.problem
    if not len(rows) or all(step is None for step in steps):
        return [None] * len(rows)
    bound = rounding_bound(
        problem.columns,
        steps,
        problem.samples,
        problem.model,
        evidence.end.vector,
        evidence.along,
        rows,
        evidence.spread.hessian,
    )
    return [float(b) for b in bound]


def _undone(
    evidence: Evidence, residuals: Sequence[Float[np.ndarray, "_ 3"]], noise: float
) -> Undone | str:
    """The look before JPEG, or why it is not known."""
    task, problem, end = evidence.task, evidence.problem, evidence.end
    lossy = [p for p in task.photos if isinstance(p, Photo) and p.lossy]
    if not lossy:
        return "no photo is a JPEG"
    if any(p.jpeg is None for p in lossy) or problem.samples.mix is not None:
        return "a grey JPEG, or one of an uncommon kind, cannot be compressed again alike"
    if any(is_coarse(p.jpeg) for p in lossy if p.jpeg is not None):
        return "the file is compressed so much that it does not show its noise"
    if not end.settled or not evidence.along.shape[1]:
        return "nothing was told that it could be taken off"
    clipped = 3 * sum(len(c.lit) for c in problem.columns) - problem.count
    if clipped > MOST_CLIPPED * problem.count:
        return f"more than {MOST_CLIPPED:.0%} of the samples are clipped"
    return undo_compression(
        task.photos,
        task.layers,
        problem,
        end.vector,
        evidence.along,
        end.free,
        evidence.spread.covariance,
        residuals,
        evidence.spread.area,
        noise,
        evidence.spread.correlation_px > STRUCTURED_PX,
    )


def _photo_results(
    task: _Task,
    problem: Problem,
    end: End,
    responses: Sequence[Response],
    pixels: Sequence[Pixels],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
) -> list[PhotoResult]:
    found = []
    for c, px, layers, residual, response in zip(
        problem.columns, pixels, task.layers, residuals, responses, strict=True
    ):
        sums = [_square_sum(channel) for channel in residual.T]
        count, square_sum = sum(n for n, _ in sums), sum(square for _, square in sums)
        found.append(
            PhotoResult(
                used=px.used,
                excluded=px.excluded,
                clipped=0 if c.clipped is None else int((c.clipped != 0).sum()),
                mix=c.mix,
                residual_rms=float(np.sqrt(square_sum / max(count, 1))),
                explained=_explained(c.light, residual, problem.model.loss) if end.finite else None,
                response=response,
                width_unit=float(layers.width_unit),
            )
        )
    return found


def _explained(
    light: Float[np.ndarray, "n 3"], residual: Float[np.ndarray, "n 3"], loss: Loss
) -> float | None:
    """Share of the light's variance, of measured samples that a robust loss does not dismiss."""
    believed = _believed(residual, loss) > BELIEVED
    left, total = 0.0, 0.0
    for k in range(3):
        known = believed[:, k] & np.isfinite(residual[:, k])
        here = light[known, k].astype(np.float64)
        total += _square_sum(here - here.mean() if len(here) else here)[1]
        left += _square_sum(residual[known, k])[1]
    return 1 - left / total if total > 0 else None


def _interval(p: Parameter, value: float, reach: float) -> tuple[float, float]:
    """What is within reach of a value and allowed: no truth lies beyond a bound, so the interval
    that ends there covers as often."""
    return (
        min(max(value - reach, p.lower), value),
        max(min(value + reach, p.upper), value),
    )


def _estimate(
    p: Parameter,
    value: float,
    *,
    role: str,
    stderr: float | None = None,
    reach: float | None = None,
    bias: float | None = None,
    drawn: float | None = None,
    undone: float | None = None,
) -> Estimate:
    return Estimate(
        value=value,
        stderr=stderr,
        interval=None if reach is None else _interval(p, value, reach),
        initial=p.value,
        role=role,
        unit=p.unit,
        bounds=(p.lower, p.upper),
        scale=p.scale,
        prior=None if p.prior is None else (p.prior.mean, p.prior.sigma),
        tied_to=p.tied_to,
        quantisation_bound=bias,
        layer_error=drawn,
        compression_shift=undone,
        meaning=p.meaning,
    )


def _airless(
    task: _Task, pixels: Sequence[Pixels], columns: Sequence[Columns], result: FitResult
) -> list[str | None]:
    """Why each photo shows no air, or None.

    Asked only where the look leaves more of the light unexplained than `NO_BARE_LIMB`: the question
    costs up to seconds. A share that holds the planet's surface tells less, and so does the ring
    beside it: `WELL_EXPLAINED` is enough there. Edges tell a bare limb from air best and count
    here; where a look explains so much of them and of the rest, it does of all.
    """
    found: list[str | None] = [None] * len(task.photos)
    if not any(_shows_planet(layers) for layers in task.layers):
        return found
    unit = float(task.layers[0].width_unit)
    beside = [
        take_columns(photo, layers, px.edges, unit)
        for photo, layers, px in zip(task.photos, task.layers, pixels, strict=True)
    ]
    shares = zip(result.photos, _shares(beside, result), strict=True)
    for number, (one, of_edges) in enumerate(shares):
        photo, layers = task.photos[number], task.layers[number]
        enough = NO_BARE_LIMB if layers.surface is None else WELL_EXPLAINED
        explained = all(
            share is not None and share >= enough for share in (one.explained, *of_edges)
        )
        if explained or not _shows_planet(layers):
            continue
        widths = []
        for of in ("lit", "dark"):
            if getattr(columns[number], of) is None:
                continue
            full = np.zeros(np.shape(layers.front), np.float32)
            for part in (columns[number], beside[number]):
                full.reshape(-1)[part.index] = getattr(part, of)
            widths.append(full)
        used = pixels[number].used | pixels[number].edges
        if task.loss != "linear":
            used &= ~(result.weights(number) <= BELIEVED)
        evidence = find_air(
            photo if isinstance(photo, Photo) else as_picture(photo),
            np.asarray(layers.planet) != 0,
            used,
            widths,
        )
        if not evidence.has_air:
            found[number] = (
                "no atmosphere shows: the planet's bare limb, blurred by "
                f"{evidence.bare.blur_px:.1f} px, explains the light beyond it as well "
                f"(the shell's ΔBIC is {evidence.delta_bic:.0f}, needed are more than "
                f"{EVIDENCE:.0f})"
            )
    return found


def _shows_planet(layers: Layers) -> bool:
    """The layers know a planet, whose limb can be held against air."""
    return layers.planet is not None and bool(np.any(layers.planet))


def _shares(columns: Sequence[Columns], result: FitResult) -> list[list[float | None]]:
    """What a fit explains of the light of other pixels; nothing is said of none."""
    evidence = result.evidence
    if evidence is None or not any(len(c.index) for c in columns):
        return [[] for _ in columns]
    model = evidence.problem.model
    samples = on_device(to_samples(columns))
    left = residuals_of(columns, samples, model, evidence.end.vector)
    return [
        [_explained(c.light, residual, model.loss)] if len(c.index) else []
        for c, residual in zip(columns, left, strict=True)
    ]


def _without_data(
    why: str,
    task: _Task,
    pixels: Sequence[Pixels],
    columns: Sequence[Columns],
    left_out: list[LeftOut],
) -> FitResult:
    """The start look, with the reason that nothing was fitted."""
    sentence, remedy = VERDICTS[Verdict.NO_DATA]
    start: Entries = to_entries(task.parameters)
    photos = [
        PhotoResult(
            used=px.used,
            excluded=px.excluded,
            clipped=0 if c.clipped is None else int((c.clipped != 0).sum()),
            mix=c.mix,
            residual_rms=float("nan"),
            explained=None,
            response=response,
            width_unit=float(layers.width_unit),
        )
        for px, c, layers, response in zip(
            pixels, columns, task.layers, to_responses(start), strict=True
        )
    ]
    result = FitResult(
        verdict=Verdict.NO_DATA.label,
        message=f"{sentence}: {why}. To do: {remedy}.",
        warnings=(),
        parameters={p.name: _estimate(p, p.value, role="fixed") for p in task.parameters},
        correlation_names=(),
        correlation=np.zeros((0, 0)),
        covariance=np.zeros((0, 0)),
        errors=None,
        look=task.look,
        photos=tuple(photos),
        left_out=tuple(left_out),
        misfits=(),
        loss=task.loss,
        solver=task.solver,
        history=(),
        second_opinion="",
    )
    return _warned(result, _file_remarks(task))  # those of a fit would speak of what is not told


def _file_remarks(task: _Task) -> list[str]:
    """What the photos' files say that was not followed."""
    several = len(task.photos) > 1
    return [
        f"Photo {number}: {remark}" if several else remark
        for number, photo in enumerate(task.photos, 1)
        for remark in (photo.remarks if isinstance(photo, Photo) else ())
    ]


def _warnings(
    result: FitResult, task: _Task, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> list[str]:
    found = []
    explained, errors = result.explained, result.errors
    told = [result.parameters[name] for name in result.correlation_names]
    undone = bool(told) and all(e.compression_shift is not None for e in told)
    if explained is not None and explained < WELL_EXPLAINED:
        found.append(
            "Look at what is left over: where it has structure, this look cannot follow the photo."
        )
    found += _misfit_warnings(result)
    found += _file_remarks(task)
    structured = errors is not None and errors.correlation_px > STRUCTURED_PX
    seen = undone or result.misfits or (explained or 0) >= 1 - 1e-6
    if errors is not None and structured and not seen:
        remedy = ""
        if task.loss == "linear" and _sticks_out(residuals):
            remedy = (
                ", and a part of the pixels sticks out: mask what shows something else than air, "
                "or use a robust loss"
            )
        elif (explained or 0) >= WELL_EXPLAINED:  # else that was said above
            remedy = ": look at where it lies in the residual picture"
        found.append(
            f"What is left over hangs together over {errors.correlation_px:.0f} pixels, which is "
            f"no noise{remedy}."
        )
    if any(photo.mix is not None for photo in result.photos):
        found.append(
            "The photo is grey: copies of a channel count once, and the look is compared by its "
            "luminance (ITU-R BT.709). What other weights would change is in brightness's interval."
        )
    negative = [n for n, e in result.parameters.items() if e.stderr and e.value + 3 * e.stderr < 0]
    if any(name.startswith("background") for name in negative):
        found.append("The background came out negative: the model takes light away.")
    if levels := [name for name in negative if name.startswith("black_level")]:
        found.append(
            f"Negative by more than three standard errors: {', '.join(levels)}. The model takes "
            "light away there: check the photo's tone curve, or hold its black level."
        )
    beside = [f"{n} is {e.one_sided}" for n, e in result.parameters.items() if e.one_sided]
    if beside:
        found.append(
            f"Within its own error of a bound, so told on one side only: {', '.join(beside)}."
        )
    drawn = {
        name: (e.layer_error, max(e.interval[1] - e.value, e.value - e.interval[0]))
        for name, e in result.parameters.items()
        if e.layer_error is not None and e.interval is not None
    }
    coarse = {name: shift for name, (shift, reach) in drawn.items() if shift > reach}
    if coarse:
        shifts = ", ".join(f"{name} {shift:.2g}" for name, shift in coarse.items())
        found.append(
            f"The layers hold a mesh, whose error can shift values by more than their intervals "
            f"say ({shifts}): use more planet.triangles, no relief, or --source raster."
        )
    lossy = any(isinstance(p, Photo) and p.lossy for p in task.photos)
    if lossy and told and not undone:
        asked = task.jpeg == "undo"
        found.append(
            "The photo's compression rounds colours block by block, which the intervals know only "
            "in part: fit the picture before it was compressed, if there is one"
            + ("." if asked else ", or let its JPEG be undone (--jpeg undo).")
        )
    return found


def _sticks_out(residuals: Sequence[Float[np.ndarray, "_ 3"]]) -> bool:
    """The root mean square is over one and a half times what the median tells of normal residuals:
    some stick out that a mask or a robust loss can take away. Of a wave it is 0.67 times."""
    some = np.concatenate([r[:: max(1, len(r) // _CHUNK)] for r in residuals])  # evenly chosen
    sizes = np.abs(some[np.isfinite(some)].astype(np.float64))
    return bool(np.sqrt(np.mean(sizes**2)) > 1.5 * 1.4826 * np.median(sizes))


def _misfit_warnings(result: FitResult) -> list[str]:
    """One sentence for each photo in which a cause shows."""
    found = []
    for number in range(len(result.photos)):
        causes = [misfit for misfit in result.misfits if misfit.photo == number]
        if not causes:
            continue
        which = f" of photo {number + 1}" if len(result.photos) > 1 else ""
        also = ", ".join(misfit.cause for misfit in causes[1:])
        like = " or ".join(CAUSES[name][0] for name in (causes[0].cause, *causes[0].rivals))
        found.append(
            f"The light left over{which} is not noise alone: {_percent(causes[0].share)} of it "
            f"goes with {like}"
            + (f"; less plainly with: {also}" if also else "")
            + ". Intervals are widened by what that may have moved."
        )
    return found


def _message(verdict: Verdict, result: FitResult, at_bound: Sequence[str]) -> str:
    sentence, remedy = VERDICTS[verdict]
    if at_bound:
        sentence += f" ({', '.join(at_bound)})"
    if result.explained is not None:
        share = _percent(result.explained)
        sentence += f"; it explains {share} of the light's variance in the pixels used"
    if result.left_out:
        sentence += f"; left out: {', '.join(item.what for item in result.left_out)}"
    return f"{sentence}." + (f" To do: {remedy}." if remedy else "")


def _percent(share: float) -> str:
    """With as many nines as it takes, and never rounded up to 100 %."""
    return f"{np.floor(share * 1e4) / 1e2:.4g} %" if share > 0 else "none"
