"""`fit`: photo and layers in, look with error bars out.

choose pixels ──> reduce ──> search, by descents ──> errors and verdict
(_pixels)         (_reduce)  (_search, _solve)       (here, _result)
"""

from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter

import jax
import numpy as np
from jaxtyping import Float

from model_jax import PARAMETERS, Layers, Look

from ._parameters import (
    CHANNELS,
    FreeParameter,
    LookVector,
    directions,
    named_free,
    reported,
    to_look,
    to_vector,
)
from ._photo import Photo
from ._pixels import Pixels, as_picture, choose_pixels
from ._reduce import Reduced, reduce_pixels, worst_bias
from ._result import VERDICTS, WELL_EXPLAINED, Estimate, FitResult, LeftOut, Verdict
from ._search import End, search
from ._solve import CHECK, Problem, coefficient_slopes, jacobian, make_solver


def fit(
    photo: Photo | Float[np.ndarray | jax.Array, "h w 3"],
    layers: Layers,
    look: Look = Look(),  # noqa: B008 (a frozen record)
    *,
    free: Iterable[str] | str | None = None,
    solver: str = "lm",
    max_steps: int = 256,
) -> FitResult:
    """Fit the look of layers to a photo by least squares in linear light.

    The model is `surface + brightness · color · tint · (lit + shadow · dark) + background`, that is
    `model_jax.composite` without its alpha; unweighted residuals, all channels alike. While tint is
    free its mean is 1.

    Args:
        photo: a loaded photo, or linear light [h, w, 3] as floats (JAX or NumPy).
        layers: of the same size, concrete (not traced), float32 or float64.
        look: start values; what is not free stays as it is. One number or three in `shadow` and
            `background` decides whether they are fitted as one or per channel.
        free: names of `PARAMETERS` to fit; None means all.
        solver: lm, dogleg, gauss_newton, bfgs, lbfgs or nelder_mead, of optimistix.
        max_steps: of the solver, for each of the few descents.

    Returns:
        A `FitResult`; that a photo cannot be fitted is its verdict, not an error. All computing is
        in float64, whatever the layers' type and JAX's setting.

    Raises:
        InputError: sizes differ, wrong array type or shape, unknown name in `free` or `solver`.
    """
    names = named_free(free)
    method = make_solver(solver)
    start_time = perf_counter()
    pixels = choose_pixels(photo, layers)
    reduced = reduce_pixels(photo, layers, pixels)
    reduced_time = perf_counter()
    problem = Problem(reduced, np.asarray(layers.color, dtype=np.float64)[:3])
    parameters = reported(look)
    initial = to_vector(look)
    asked, left_out = _leave_out(parameters, names, layers, problem)
    left_out = [LeftOut(*remark) for remark in pixels.remarks] + left_out
    why_not = _no_data(photo, pixels, reduced, asked)
    if why_not:
        result = _without_data(why_not, look, parameters, layers, pixels, left_out)
    else:
        end = search(problem, initial / problem.units, asked, method, max_steps)
        result = _judge(problem, end, look, parameters, free is not None, layers, pixels, left_out)
        if isinstance(photo, Photo) and photo.quantisation is not None:
            result = _with_bias(result, photo, layers, pixels, problem, end)
    seconds = {"reduce": reduced_time - start_time, "solve": perf_counter() - reduced_time}
    return replace(result, seconds=seconds)


def _leave_out(
    parameters: tuple[FreeParameter, ...],
    names: tuple[str, ...],
    layers: Layers,
    problem: Problem,
) -> tuple[tuple[FreeParameter, ...], list[LeftOut]]:
    """What can be fitted at all: no shadow weight without shadow, no tint without colour."""
    asked = [p for p in parameters if p.family in names]
    left_out: list[LeftOut] = []
    reduced = problem.reduced
    why = None
    if not layers.has_shadow:
        why = "the layers hold no shadow: no sun is given, or no air in view is in shadow"
    elif reduced.count and not reduced.has_dark:
        why = "no pixel used is in shadow"
    elif reduced.count and not reduced.has_lit and "brightness" in names:
        why = "no pixel used is lit, so only brightness × shadow is told; shadow is held"
    if why and "shadow" in names:
        asked = [p for p in asked if p.family != "shadow"]
        left_out.append(LeftOut("shadow weight", why))
    for k, channel in enumerate(CHANNELS):
        if problem.color[k] == 0:
            colourless = {f"tint.{channel}", f"shadow.{channel}"}
            why = f"the air's color is 0 in channel {channel}"
            left_out += [LeftOut(p.name, why) for p in asked if p.name in colourless]
            asked = [p for p in asked if p.name not in colourless]
    return tuple(asked), left_out


def _no_data(
    photo: Photo | np.ndarray | jax.Array,
    pixels: Pixels,
    reduced: Reduced,
    asked: tuple[FreeParameter, ...],
) -> str | None:
    """Why there is nothing to fit, or None."""
    if not pixels.count:
        counts = ", ".join(f"{count} {reason}" for reason, count in pixels.excluded.items())
        return f"no pixel can be used ({counts})"
    need = directions(asked)[0].shape[1] + 1
    if pixels.count < need:
        return f"the number of pixels that can be used is {pixels.count}, needed are {need}"
    if not as_picture(photo)[pixels.used].any() or reduced.light == 0:
        return "the photo is black where the air is"
    if reduced.constant:
        return "the photo is the same in all pixels used, the air is not"
    return None


def _judge(
    problem: Problem,
    end: End,
    look: Look,
    parameters: tuple[FreeParameter, ...],
    named: bool,
    layers: Layers,
    pixels: Pixels,
    left_out: list[LeftOut],
) -> FitResult:
    """Errors and verdict at the end point."""
    reduced, units = problem.reduced, problem.units
    along, _ = directions(end.free)
    slopes = jacobian(problem, end.vector, along)
    square_sum = problem.square_sum(end.vector) if end.finite else np.nan
    freedom = 3 * reduced.count - along.shape[1]
    variance = max(square_sum, 0.0) / freedom if end.finite else np.nan
    # Gauss–Newton's promise of how far the square sum would still fall: the gradient, scaled.
    q, r = np.linalg.qr(slopes)
    promise = float(((q.T @ problem.residual(end.vector).reshape(-1)) ** 2).sum())
    verdict = Verdict.CONVERGED
    if not end.finite:
        verdict = Verdict.DIVERGED
    elif not promise <= CHECK * variance + problem.rounding():
        verdict = Verdict.NOT_CONVERGED
    elif end.at_bound:
        verdict = Verdict.AT_BOUND
    elif end.untold and (named or any(p.family == "brightness" for p, _ in end.untold)):
        verdict = Verdict.NOT_IDENTIFIABLE

    vector, initial = end.vector * units, to_vector(look)
    told = _told(end)
    to_told = np.array([p.of(along) * units[p.entries[0]] for p in told])
    to_told = to_told.reshape(len(told), along.shape[1])
    spread = to_told @ np.linalg.inv(r) if told else to_told
    covariance = variance * (spread @ spread.T)
    stderr = np.sqrt(np.diag(covariance))
    lengths = np.linalg.norm(spread, axis=1)
    correlation = np.clip(spread @ spread.T / np.outer(lengths, lengths), -1, 1)
    estimates = {
        p.name: _estimate(
            p,
            vector,
            initial,
            free=p in told or p in end.at_bound,
            stderr=float(stderr[told.index(p)]) if p in told and end.finite else None,
        )
        for p in parameters
    }
    total = reduced.variation
    explained = 1 - square_sum / total if total > 0 and end.finite else None
    left_out = left_out + [LeftOut(p.name, why) for p, why in end.untold]
    sinks = any(
        e.stderr is not None and e.value + 3 * e.stderr < 0
        for name, e in estimates.items()
        if name.startswith("background")
    )
    return FitResult(
        verdict=verdict.label,
        message=_message(verdict, explained, end, left_out, sinks),
        parameters=estimates,
        correlation_names=tuple(p.name for p in told),
        correlation=correlation,
        covariance=covariance,
        residual_rms=float(np.sqrt(max(square_sum, 0.0) / (3 * reduced.count))) * reduced.light,
        explained=explained,
        used=pixels.used,
        excluded=pixels.excluded,
        left_out=tuple(left_out),
        look=to_look(vector, look) if end.finite else look,
        width_unit=float(layers.width_unit),
    )


def _told(end: End) -> list[FreeParameter]:
    """The free parameters in report order; a single free tint is fixed by the mean of 1."""
    tints = sum(p.family == "tint" for p in end.free)
    return [p for p in end.free if p.family != "tint" or tints > 1]


def _with_bias(
    result: FitResult,
    photo: Photo,
    layers: Layers,
    pixels: Pixels,
    problem: Problem,
    end: End,
) -> FitResult:
    """The result with each estimate's bound on the bias by the photo's rounding to codes."""
    told = _told(end)
    if not told or not end.finite:
        return result
    along, _ = directions(end.free)
    units = problem.units
    to_told = np.array([p.of(along) * units[p.entries[0]] for p in told])
    _, r = np.linalg.qr(jacobian(problem, end.vector, along))
    inverse = np.linalg.inv(r)
    slopes = coefficient_slopes(end.vector, problem.color) @ along
    response = slopes @ (inverse @ inverse.T @ to_told.T)
    bounds = worst_bias(photo, layers, pixels, problem.reduced, response)
    parameters = dict(result.parameters)
    for p, bound in zip(told, bounds, strict=True):
        parameters[p.name] = replace(parameters[p.name], quantisation_bound=float(bound))
    return replace(result, parameters=parameters)


def _estimate(
    parameter: FreeParameter,
    vector: LookVector,
    initial: LookVector,
    free: bool,
    stderr: float | None,
) -> Estimate:
    return Estimate(
        value=float(parameter.of(vector)),
        stderr=stderr,
        initial=float(parameter.of(initial)),
        free=free,
        unit=PARAMETERS[parameter.family].unit,
        bounds=parameter.bounds,
        quantisation_bound=None,
    )


def _without_data(
    why: str,
    look: Look,
    parameters: tuple[FreeParameter, ...],
    layers: Layers,
    pixels: Pixels,
    left_out: list[LeftOut],
) -> FitResult:
    """The start look, with the reason that nothing was fitted."""
    initial = to_vector(look)
    sentence, remedy = VERDICTS[Verdict.NO_DATA]
    return FitResult(
        verdict=Verdict.NO_DATA.label,
        message=f"{sentence}: {why}. To do: {remedy}.",
        parameters={p.name: _estimate(p, initial, initial, False, None) for p in parameters},
        correlation_names=(),
        correlation=np.zeros((0, 0)),
        covariance=np.zeros((0, 0)),
        residual_rms=float("nan"),
        explained=None,
        used=pixels.used,
        excluded=pixels.excluded,
        left_out=tuple(left_out),
        look=look,
        width_unit=float(layers.width_unit),
    )


def _message(
    verdict: Verdict, explained: float | None, end: End, left_out: list[LeftOut], sinks: bool
) -> str:
    sentence, remedy = VERDICTS[verdict]
    if end.at_bound:
        sentence += f" ({', '.join(p.name for p in end.at_bound)})"
    if explained is not None:
        share = _percent(explained)
        sentence += f"; it explains {share} of the light's variance in the pixels used"
    if left_out:
        sentence += f"; left out: {', '.join(item.what for item in left_out)}"
    errors = "Standard errors take the pixels' residuals as independent."
    if explained is not None and explained < WELL_EXPLAINED:
        errors += (
            " Look at what is left over: where it has structure, this look cannot follow the photo "
            "and the true errors are larger."
        )
    if sinks:
        errors += " The background came out negative: the model takes light away."
    return f"{sentence}. " + (f"To do: {remedy}. " if remedy else "") + errors


def _percent(share: float) -> str:
    """With as many nines as it takes, and never rounded up to 100 %."""
    return f"{np.floor(share * 1e4) / 1e2:.4g} %" if share > 0 else "none"
