"""`fit`: photos and layers in, look with error bars out.

choose pixels ──> samples ──> search, in rounds ──> errors, doubts, verdict
(photo)           (solve)     (_rounds, solve)      (_judge, _estimates, diagnose)
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from os import PathLike
from time import perf_counter
from typing import Any, Literal, overload

import jax
import numpy as np
from jaxtyping import Float

from model_jax import InputError, Layers, LayersLook, Look, Response
from model_jax._blur import MOST_BLUR
from model_jax._errors import shown
from model_jax._fields import only_needed
from model_jax._kinds import need
from model_jax._shapes import is_traced
from model_jax.looks._registry import checked

from ._auto import Auto, check_sharp, choose_terms
from ._choices import AUTO, Where, check_jpeg, check_loss, check_sampling, check_steps, check_where
from ._compile import float64
from ._estimates import debias_jpeg, photo_results
from ._judge import evidence_of, judge, with_warnings, without_data
from ._memory import bound_programs, give_back
from ._result import FitResult
from ._rounds import make_problem, search_in_rounds
from ._traced import TracedFit, concrete, fit_traced
from .diagnose._airless import ask_for_air
from .diagnose._alignment import alignment_of
from .diagnose._remarks import leave_out, pixel_remarks, why_no_data
from .diagnose._residuals import residuals_of
from .photo._columns import Columns, PhotoLike, planet_light, take_columns
from .photo._photo import Photo
from .photo._pixels import choose_pixels
from .solve._declare import declare, links, pairs
from .solve._descend import make_solver
from .solve._parameters import FitParameter, to_entries
from .solve._problem import one_in_grey, within_scene
from .solve._task import Task

MAX_STEPS = 256
"""Steps a solver is given unless told."""

WIDER = 3
"""How often a blur may turn out wider than what was kept away from the planet's light."""
LEAST_BLUR = 0.5
"""A blur, px, that has to be expected of any photo."""
MARGIN = 1.25
"""How much wider than a blur that is expected it may be."""

MANY_SAMPLES = 2**21
"""Samples from which on memory is counted."""


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
    where: str = ...,
    solver: str = ...,
    max_steps: int | None = ...,
) -> TracedFit: ...


@overload
def fit(
    photo: PhotoLike | Sequence[PhotoLike],
    layers: Layers | Sequence[Layers],
    look: Look | Literal["auto"] = ...,
    *,
    free: Iterable[str] | str | None = ...,
    response: Response | Sequence[Response] = ...,
    bounds: Mapping[str, tuple[float, float]] | None = ...,
    priors: Mapping[str, tuple[float, float]] | None = ...,
    tied: Mapping[str, str] | None = ...,
    loss: str = ...,
    jpeg: str = ...,
    sampling: str = ...,
    where: str = ...,
    solver: str = ...,
    max_steps: int | None = ...,
) -> FitResult: ...


def fit(
    photo: Any,
    layers: Any,
    look: Any = LayersLook(),  # noqa: B008 (a frozen record)
    *,
    free: Any = None,
    response: Any = Response(),  # noqa: B008 (a frozen record)
    bounds: Any = None,
    priors: Any = None,
    tied: Any = None,
    loss: Any = "linear",
    jpeg: Any = "keep",
    sampling: Any = "area",
    where: Any = "all",
    solver: Any = "lm",
    max_steps: Any = None,
) -> FitResult | TracedFit:
    """Fit the look of layers to a photo, or to several photos, by least squares in linear light.

    The model is `record(composite(layers, look), response)`, of `model_jax`, without alpha:
    `black_level + (exposure · (surface + air + background))^(1/gamma)`. With a blur it is that of a
    line across the limb, beyond which lies the planet's own light as the photo shows it inside.
    Residuals are unweighted, all channels alike. Free factors of mean one keep that mean. Samples
    at a photo's highest or lowest code count as "at least this bright" and "at most".

    Args:
        photo: a loaded photo, or linear light [h, w, 3] as floats (JAX or NumPy); or a sequence of
            them. Several photos share the look, in physical units: what is per width unit refers to
            the first layers' `width_unit`, and all layers must use one length unit.
        layers: of the photo's size, float32 or float64; one for each photo.
        look: of any kind (`looks`), with start values; what is not free stays as it is. Where a
            parameter may be one number or a colour, its form decides how it is fitted. "auto":
            `layers`, or `air` with the terms that the photos support (`FitResult.selection`).
        free: names to fit: a parameter, one channel of a colour as NAME.r, "exposure.2" …
            None means the look, blurs if there are any, and with several photos also black levels
            and exposures but the first. With "auto" the terms' own parameters are free besides.
        response: start values of each photo's response, or one for all.
        bounds: name → (lower, upper), narrower than the parameter's own. Background and black level
            end at 0 where they would end below, unless they start there or have bounds.
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
        where: "ring" uses air in front of space only, "sky" that and the sky beside it, which tells
            background and blur, "planet" air in front of the planet only, whose light the layers'
            surface tells; "all" uses ring and planet, with a blur ring and sky.
        solver: lm, dogleg or bfgs, of optimistix. A look that is not separable is brought near by
            SciPy's trust region within the bounds first; where that ends, lm has nothing to do.
        max_steps: of the solver, for each descent.

    Returns:
        A `FitResult`; that a photo cannot be fitted is its verdict, not an error. All computing is
        in float64, whatever the layers' type and JAX's setting. Under `jax.vmap`, `jit` or `grad`,
        where photo, look or response is traced: a `TracedFit`, arrays only, of one photo by plain
        least squares, in JAX's precision; it is differentiable by all three, says nothing of
        misfit, and its levels may end below 0.

    Raises:
        InputError: an argument of the wrong kind (a path, a scene …), "auto" with a blur or under
            `jit`, names that only a term has with "auto", traced layers, sizes that
            differ, wrong array type or shape, unknown names, contradictory bounds, a prior without
            width, a circle of ties, ring or planet of layers without a planet mask.
    """
    _check_kinds(photo, layers, look, response, max_steps)
    bounds = pairs("bounds", "(lower, upper)", bounds)
    priors = pairs("priors", "(mean, standard deviation)", priors)
    tied = links(tied)
    if is_traced(photo, look, response):
        return _fit_traced(
            photo, layers, look, free, response, bounds, priors, tied, loss, sampling, where, solver
        )
    with float64():
        bound_programs()
        photos, all_layers = _pairs(photo, layers)
        responses = _responses(response, len(photos))
        auto = _auto_of(look)
        start = look if auto is None else auto.start

        once = isinstance(free, Iterable) and not isinstance(free, str)
        asked = tuple(free) if once else free

        def declared(look: Look) -> tuple[FitParameter, ...]:
            own = [name for name in type(look).PARAMETERS if name not in type(start).PARAMETERS]
            named = (asked,) if isinstance(asked, str) else asked
            names = named if named is None or not own else [*named, *own]
            return declare(look, responses, free=names, bounds=bounds, priors=priors, tied=tied)

        parameters = declared(start)
        loss_name, handling, sampled = check_loss(loss), check_jpeg(jpeg), check_sampling(sampling)
        make_solver(solver)
        steps = MAX_STEPS if max_steps is None else max_steps
        named = free is not None
        task = Task(
            photos,
            all_layers,
            all_layers,
            start,
            parameters,
            loss_name,
            handling,
            sampled,
            solver,
            steps,
            named,
        )
        pixels = check_where(where)
        if auto is None:
            return _fit(_only_needed(task), pixels)
        started = perf_counter()
        check_sharp(task.blurs)
        task = choose_terms(task, pixels, declared)
        seconds = {"choose": perf_counter() - started}
        result = _fit(_only_needed(task), pixels)
        return replace(result, seconds=seconds | result.seconds)


def _only_needed(task: Task) -> Task:
    """The task without layers that its look does not ask for."""
    needs = type(task.look).NEEDS
    return replace(task, layers=tuple(only_needed(one, needs) for one in task.layers))


def _auto_of(look: Any) -> Auto | None:
    """What is asked of the choice of terms; None where a look is given."""
    if isinstance(look, str):
        if look == AUTO:
            return Auto()
        raise InputError(
            f"look: {shown(look)} is a name; give 'auto', or find_look({shown(look)})()"
        )
    return look if isinstance(look, Auto) else None


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
    where: str,
    solver: str,
) -> TracedFit:
    """The same for a tracer, with errors for what cannot be traced."""
    single = not isinstance(photo, Sequence) and isinstance(response, Response)
    blurs = single and response.blur is not None
    if not single or priors or loss != "linear" or isinstance(photo, Photo) or blurs:
        raise InputError(
            "fit: under jit, vmap or grad it takes one array as photo, loss='linear', no priors "
            "and no blur; call it outside of them for more"
        )
    layers = only_needed(layers, look.NEEDS)
    layers = jax.tree.map(np.asarray, layers)  # inside jit, JAX's operations on them would trace
    known = concrete(look, response)
    parameters = declare(known[0], [known[1]], free=free, bounds=bounds, tied=tied)
    make_solver(solver)
    shown = np.ones(np.shape(photo))  # any picture: which pixels may be used is the layers' affair
    used = choose_pixels(shown, layers, check_sampling(sampling), check_where(where)).used
    return fit_traced(photo, layers, look, response, parameters, used, solver)


def _fit(task: Task, where: Where) -> FitResult:
    """The work, once it is known what was asked."""
    times = [perf_counter()]
    seen = list(zip(task.photos, task.layers, strict=True))
    pixels = [choose_pixels(p, la, task.sampling, where, blurs=task.blurs) for p, la in seen]
    unit = float(task.layers[0].width_unit)
    kind = type(task.look)

    def take(blurs: Float[np.ndarray, " photos"]) -> tuple[Columns, ...]:
        return tuple(
            take_columns(p, la, px.used, unit, kind, planet_light(p, la, blur) if blur else None)
            for (p, la), px, blur in zip(seen, pixels, blurs, strict=True)
        )

    widths = expected_blurs(task)
    columns = take(widths)
    parameters = within_scene(task.parameters, columns)
    task = replace(task, parameters=one_in_grey(parameters, columns, kind.GROUND))
    asked, left_out = leave_out(task, columns)
    why_not = why_no_data(task, pixels, columns, asked)
    if why_not:
        return without_data(why_not, task, pixels, columns, left_out)
    problem = make_problem(task, columns)
    columns = problem.columns
    times.append(perf_counter())
    seeds = None if task.seed is None else [task.seed]
    problem, end = search_in_rounds(task, problem, asked, seeds)
    for _ in range(WIDER if task.blurs and end.finite else 0):
        found = task.layout.responses(end.vector)[:, -1]
        if (found <= widths).all():
            break
        widths = np.minimum(np.maximum(widths, MARGIN * found), MOST_BLUR)
        problem = make_problem(task, take(widths))
        columns = problem.columns
        problem, end = search_in_rounds(task, problem, asked, [end.vector])
    if problem.count > MANY_SAMPLES:
        give_back()  # what compiling left behind
    times.append(perf_counter())
    residuals = residuals_of(problem, end.vector)
    evidence = evidence_of(task, problem, end, residuals)
    aligned = [alignment_of(p, la) for p, la in seen]
    photos = photo_results(task, problem, end, pixels, residuals, aligned)
    air = ask_for_air(task, pixels, columns, evidence, photos)
    if all(air.none):
        result = without_data(str(air.none[0]), task, pixels, columns, left_out, aligned)
    else:
        # Last, for it takes seconds, and nothing else asks what JPEG did.
        debiased = debias_jpeg(evidence, residuals) if evidence and task.jpeg == "undo" else None
        left_out = [*pixel_remarks(pixels), *left_out, *air.left_out()]
        result = judge(task, end, evidence, photos, residuals, debiased, left_out, air.is_open)
        result = with_warnings(result, air.warnings())
    times.append(perf_counter())
    names = ("reduce", "solve", "errors")
    spans = zip(names, pairwise(times), strict=True)
    return replace(result, seconds={name: after - before for name, (before, after) in spans})


def expected_blurs(task: Task) -> Float[np.ndarray, " photos"]:
    """The widest blur of each photo that is to be expected, px; 0 where there is none."""
    found = np.zeros(len(task.photos))
    if task.blurs:
        start = task.layout.responses(to_entries(task.parameters))[:, -1]
        found = np.minimum(MARGIN * np.maximum(start, LEAST_BLUR), MOST_BLUR)
    return found


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
    if _auto_of(look) is None:
        need("look", look, Look)
        checked(type(look))
    elif is_traced(photo, response):
        raise InputError("fit: look='auto' chooses outside of jit, vmap and grad; give a look")
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
