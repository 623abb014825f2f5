"""From an end point to a result: values, errors, verdict and message."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from model_jax import RESPONSE_PARAMETERS, Look

from ._estimates import (
    doubts_of,
    estimate,
    grey_variance,
    layer_errors,
    rounding_bias,
)
from ._of_photo import Alignment, PhotoResult
from ._result import Errors, Estimate, FitResult, LeftOut, Misfit
from ._rounds import ROUNDING, noise_of
from ._verdict import VERDICTS, Verdict
from .diagnose._compression import Debiased
from .diagnose._evidence import Evidence
from .diagnose._remarks import file_remarks, percent, warnings_of
from .diagnose._remedy import is_misfit, remedy_of
from .diagnose._spread import reach_95, spread_of
from .photo._columns import Columns
from .photo._pixels import Pixels
from .solve._flat import find_flat
from .solve._parameters import (
    Entries,
    FitParameter,
    at_least,
    followers,
    free_directions,
    to_entries,
    to_look,
    to_responses,
)
from .solve._polish import gauss_newton
from .solve._problem import Point, Problem
from .solve._search import End
from .solve._task import Task

NEAR = 3.0
"""Standard errors beyond its bound up to which the best value may be by noise alone."""


def with_warnings(result: FitResult, warnings: Sequence[str]) -> FitResult:
    """The result with more warnings."""
    return replace(
        result,
        warnings=(*result.warnings, *warnings),
        message=" ".join([result.message, *warnings]),
    )


def evidence_of(
    task: Task, problem: Problem, end: End, residuals: Sequence[Float[np.ndarray, "_ 3"]]
) -> Evidence | None:
    """What the end point rests on; None where there is none."""
    if not end.finite:
        return None
    point = Point(problem, end.vector, free_directions(end.free, task.parameters)[0])
    noise = noise_of(task, problem, end, residuals)
    rounding = ROUNDING * problem.light_max
    spread = spread_of(point, task.sizes, residuals, noise, rounding)
    ended = [p for p in end.at_bound if not p.mean_one]
    if ended:
        directions, moved = free_directions((*end.free, *ended), task.parameters)
        beside = replace(point, directions=directions)
        gram = beside.gram()
        near = gram[:-1, -1] @ gauss_newton(gram) <= NEAR**2 * noise**2 * spread.area
        if near and not find_flat(beside, gram, moved):
            # Noise alone may have brought them there: the others bear what they may be.
            wider = spread_of(beside, task.sizes, residuals, noise, rounding).covariance
            kept = [k for k, members in enumerate(moved) if not set(members) & set(ended)]
            spread = replace(spread, covariance=wider[np.ix_(kept, kept)])
    return Evidence(task, end, point, tuple(_identified(task, end)), spread, noise)


def judge(
    task: Task,
    end: End,
    evidence: Evidence | None,
    photos: Sequence[PhotoResult],
    residuals: Sequence[Float[np.ndarray, "_ 3"]],
    debiased: Debiased | str | None,
    left_out: Sequence[LeftOut],
    untold: bool = False,
) -> FitResult:
    """Values, errors and verdict.

    Args:
        untold: it cannot be told whether there is air.
        residuals: at the end point, by `residuals_of`.
        debiased: the look before JPEG, or why it is not known; None where nobody asked.
        left_out: what was left out so far.
    """
    worth = _Worth(end.vector)
    if evidence is not None:
        worth = _worth(evidence, residuals, debiased if isinstance(debiased, Debiased) else None)
    names = [p.name for p in worth.identified]
    more = [LeftOut("what JPEG did", debiased)] if isinstance(debiased, str) else []
    held = [
        LeftOut(p.name, f"{flat.why}; held at its start value")
        for flat in end.flat
        for p in flat.held
    ]
    verdict = _verdict(task, end, photos, untold)
    responses = to_responses(worth.vector, task.layout)
    result = FitResult(
        verdict=verdict.label,
        message="",
        warnings=(),
        parameters=_estimates(task, end, worth),
        correlation_names=tuple(names),
        correlation=worth.correlation,
        covariance=worth.covariance,
        errors=None if evidence is None else _errors(evidence),
        look=to_look(worth.vector, task.look),
        photos=tuple(
            replace(photo, response=response)
            for photo, response in zip(photos, responses, strict=True)
        ),
        left_out=(*left_out, *more, *held),
        misfits=worth.misfits,
        loss=task.loss,
        solver=task.solver,
        history=end.history,
        second_opinion=end.second,
        selection=task.selection,
        evidence=evidence,
    )
    stuck = [p.name for p in end.at_bound if not at_least(p, end.vector)]
    message = _message(verdict, result, stuck, type(task.look))
    return with_warnings(replace(result, message=message), warnings_of(result, task, residuals))


@dataclass(frozen=True)
class _Worth:
    """What an end point is worth, in the order of the identified parameters."""

    vector: Entries
    """The end, or what it was before compression."""
    identified: tuple[FitParameter, ...] = ()
    covariance: Float[np.ndarray, "t t"] = field(default_factory=lambda: np.zeros((0, 0)))
    reach: Float[np.ndarray, " t"] = field(default_factory=lambda: np.zeros(0))
    """Standard errors to either side of an interval."""
    bias: Sequence[float | None] = ()
    drawn: Sequence[float | None] = ()
    debiased: bool = False
    misfits: tuple[Misfit, ...] = ()

    @property
    def stderr(self) -> Float[np.ndarray, " t"]:
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0)))

    @property
    def correlation(self) -> Float[np.ndarray, "t t"]:
        # Factors of mean one are dependent; a length of zero is a parameter that nothing can move.
        lengths = np.where(self.stderr > 0, self.stderr, 1.0)
        found = np.clip(self.covariance / np.outer(lengths, lengths), -1, 1)
        np.fill_diagonal(found, 1.0)
        return np.asarray(found)


def _worth(
    evidence: Evidence, residuals: Sequence[Float[np.ndarray, "_ 3"]], debiased: Debiased | None
) -> _Worth:
    """Errors of what is identified, widened by what is doubtful beside noise."""
    point, identified, rows = evidence.point, evidence.identified, evidence.rows
    vector, along_free = point.vector, evidence.spread.covariance
    freedom = evidence.spread.freedom(rows)
    if debiased is not None:
        vector, along_free = point.moved(debiased.shift).vector, debiased.covariance
        freedom = np.full(len(identified), debiased.freedom)
    # What compression leaves over is no other cause's.
    doubts = doubts_of(evidence, residuals, look_for_causes=debiased is None)
    covariance = rows @ along_free @ rows.T + doubts.covariance
    if point.problem.samples.mix is not None:
        covariance = covariance + np.diag(grey_variance(point.problem, identified, vector))
    return _Worth(
        vector=vector,
        identified=identified,
        covariance=covariance,
        reach=reach_95(freedom),
        bias=rounding_bias(evidence),
        drawn=layer_errors(evidence),
        debiased=debiased is not None,
        misfits=doubts.misfits,
    )


def _errors(evidence: Evidence) -> Errors:
    spread = evidence.spread
    return Errors(
        noise=evidence.noise,
        correlation_px=spread.correlation_px,
        block_px=spread.block_px,
        blocks=spread.blocks,
        effective_samples=evidence.problem.count / spread.area,
    )


def _estimates(task: Task, end: End, worth: _Worth) -> dict[str, Estimate]:
    """Every parameter by its name, identified or not."""
    names = [p.name for p in worth.identified]
    held = {p.name for flat in end.flat for p in flat.held}
    stderr = worth.stderr
    found = {}
    for p in task.parameters:
        value, role = float(p.of(worth.vector)), _role(p, names, end, held)
        if p.name not in names:
            found[p.name] = estimate(p, value, role=role)
            continue
        k = names.index(p.name)
        found[p.name] = estimate(
            p,
            value,
            role=role,
            stderr=float(stderr[k]),
            reach=float(worth.reach[k] * stderr[k]),
            bias=worth.bias[k],
            drawn=worth.drawn[k],
            debiased=float(p.of(worth.vector - end.vector)) if worth.debiased else None,
        )
    return found


def _verdict(task: Task, end: End, photos: Sequence[PhotoResult], untold: bool = False) -> Verdict:
    if not end.finite:
        return Verdict.DIVERGED
    if not end.settled:
        return Verdict.NOT_CONVERGED
    stuck = any(not at_least(p, end.vector) for p in end.at_bound)
    if any(_is_narrowed(p, task) for p in end.at_bound):
        return Verdict.AT_BOUND  # whatever else: somebody said how far it may go
    known = {p.name for p in (*_identified(task, end), *end.at_bound)}
    lost = any(p.role == "free" and p.name not in known for p in task.parameters)
    if untold or (task.named and lost and not stuck):
        return Verdict.NOT_IDENTIFIABLE
    if any(is_misfit(photo) for photo in photos):
        return Verdict.MISFIT
    return Verdict.AT_BOUND if stuck else Verdict.CONVERGED


def _is_narrowed(p: FitParameter, task: Task) -> bool:
    """Its range is narrower than its own: bounds were asked for."""
    about = (type(task.look).PARAMETERS | RESPONSE_PARAMETERS)[p.family]
    return (p.lower, p.upper) != (about.lower, about.upper)


def _identified(task: Task, end: End) -> list[FitParameter]:
    """Free parameters and what is tied to them; a lone free factor is fixed by the mean of one."""
    members = [q for p in end.free for q in followers(p, task.parameters)]
    factors = sum(p.mean_one for p in members)
    names = {p.name for p in members if not p.mean_one or factors > 1}
    return [p for p in task.parameters if p.name in names]


def _role(p: FitParameter, identified: Sequence[str], end: End, held: set[str]) -> str:
    if p.role == "tied":
        return "tied"
    if p.name in identified:
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
    alignments: Sequence[Alignment | None] | None = None,
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
            structure=None,
            response=response,
            width_unit=float(layers.width_unit),
            alignment=alignment,
        )
        for px, c, layers, response, alignment in zip(
            pixels,
            columns,
            task.layers,
            to_responses(start, task.layout),
            alignments or [None] * len(pixels),
            strict=True,
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


def _message(verdict: Verdict, result: FitResult, at_bound: Sequence[str], kind: type[Look]) -> str:
    sentence, remedy = VERDICTS[verdict]
    if verdict is Verdict.MISFIT:
        remedy = remedy_of(result, kind)
    if at_bound:
        sentence += f" ({', '.join(at_bound)})"
    if result.explained is not None:
        share = percent(result.explained)
        sentence += f"; it explains {share} of the light's variance in the pixels used"
    if verdict is Verdict.MISFIT:
        sentence += (
            f", and what is left over and hangs together is {percent(result.structure or 0.0)} of "
            "the air's light; intervals hold for this look only, not for the air"
        )
    if result.left_out:
        sentence += f"; left out: {', '.join(item.what for item in result.left_out)}"
    return f"{sentence}." + (f" To do: {remedy}." if remedy else "")
