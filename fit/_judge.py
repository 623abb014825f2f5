"""From an end point to a result: values, errors, verdict and message."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ._estimates import (
    doubts_of,
    estimate,
    grey_variance,
    layer_errors,
    photo_results,
    rounding_bias,
    undo_jpeg,
)
from ._result import Errors, FitResult, LeftOut, PhotoResult
from ._rounds import ROUNDING, noise_of
from ._verdict import VERDICTS, Verdict
from .diagnose._evidence import Evidence, residuals_at
from .diagnose._misfit import Doubts
from .diagnose._remarks import file_remarks, percent, warnings_of
from .diagnose._spread import Spread, reach_95, spread_of
from .photo._pixels import Columns, Pixels
from .solve._parameters import (
    Entries,
    Parameter,
    directions,
    followers,
    to_entries,
    to_look,
    to_responses,
)
from .solve._problem import Problem
from .solve._search import End
from .solve._task import Task


def with_warnings(result: FitResult, warnings: Sequence[str]) -> FitResult:
    """The result with more warnings."""
    return replace(
        result,
        warnings=(*result.warnings, *warnings),
        message=" ".join([result.message, *warnings]),
    )


def judge(
    task: Task,
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
    residuals = residuals_at(problem, end)
    if end.finite:
        noise = noise_of(task, problem, end, residuals)
        spread = spread_of(
            problem.columns,
            task.sizes,
            problem.samples,
            problem.model,
            end.vector,
            along,
            residuals,
            noise,
            ROUNDING * problem.light_max,
        )
        evidence = Evidence(task, problem, end, along, told, spread)
        rows = evidence.to_told()
        covariance = rows @ spread.covariance @ rows.T
        reach = reach_95(spread.freedom(rows))
        bias, drawn = rounding_bias(evidence, rows), layer_errors(evidence, rows)
        undone = undo_jpeg(evidence, residuals, noise) if task.jpeg == "undo" else None
        if isinstance(undone, str):
            left_out = [*left_out, LeftOut("what JPEG did", undone)]
            undone = None
        if undone is not None:
            vector = end.vector + along @ undone.shift
            covariance = rows @ undone.covariance @ rows.T
            reach = reach_95(np.full(len(told), undone.freedom))
        # What compression leaves over is no other cause's.
        doubts = doubts_of(evidence, rows, residuals, look_for_causes=undone is None)
    covariance = covariance + doubts.covariance
    if problem.samples.mix is not None:
        covariance = covariance + np.diag(grey_variance(problem.columns, told, vector))
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
        estimates[p.name] = estimate(
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
    photos = tuple(photo_results(task, problem, end, responses, pixels, residuals))
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
    return with_warnings(replace(result, message=message), warnings_of(result, task, residuals))


def _verdict(task: Task, end: End) -> Verdict:
    if not end.finite:
        return Verdict.DIVERGED
    if not end.settled:
        return Verdict.NOT_CONVERGED
    if end.at_bound:
        return Verdict.AT_BOUND
    told = {p.name for p in _told(task, end)}
    lost = any(p.role == "free" and p.name not in told for p in task.parameters)
    return Verdict.NOT_IDENTIFIABLE if task.named and lost else Verdict.CONVERGED


def _told(task: Task, end: End) -> list[Parameter]:
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


def without_data(
    why: str,
    task: Task,
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
        parameters={p.name: estimate(p, p.value, role="fixed") for p in task.parameters},
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
    # Only the files' remarks: those of a fit would speak of what is not told.
    return with_warnings(result, file_remarks(task))


def _message(verdict: Verdict, result: FitResult, at_bound: Sequence[str]) -> str:
    sentence, remedy = VERDICTS[verdict]
    if at_bound:
        sentence += f" ({', '.join(at_bound)})"
    if result.explained is not None:
        share = percent(result.explained)
        sentence += f"; it explains {share} of the light's variance in the pixels used"
    if result.left_out:
        sentence += f"; left out: {', '.join(item.what for item in result.left_out)}"
    return f"{sentence}." + (f" To do: {remedy}." if remedy else "")
