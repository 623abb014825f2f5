"""Which terms of a look photos support: `look="auto"`.

    few pixels ──> all terms of the cheapest program ──> noise is left? ──no──> of the next, dearer
                                                              │ yes
                            leave out, one by one, the term that costs nothing ──> BIC of the rest

The sets of terms are tried in `_trial`; only the winner is compiled and fitted to all pixels.
Whether a term is worth its parameters is asked at the number of independent samples: light left
over hangs together from pixel to pixel, and so many pixels would make any term look certain.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from model_jax import InputError, Layers, Look
from model_jax.looks._registry import AUTO

from ._choices import Where
from ._selection import Selection, TermChoice
from ._trial import (
    LEAST_PIXELS,
    Declare,
    End,
    Trial,
    Used,
    count_of,
    few_of,
    like,
    usable_pixels,
)
from .diagnose._effective import scattered_samples
from .photo._columns import Columns
from .solve._task import Task

FAINT = 2e-2
"""Light, as a share of all, that is not worth a term: a step of 8 bits at middle grey, and what
JPEG makes of colours by an edge."""

DOUBT = 4.0
"""Standard deviations from which a sample is doubted, as Cauchy's loss does (`_evidence`)."""
NEAR = 0.1
"""Most room below the highest code, as a share of its light: where a look matches badly, what is
left over is no noise."""

DEAR = "nothing is left over that hangs together from pixel to pixel"
VAIN = "it explains no more"
"""Why a term is left out that was not compared."""

_PLAIN, _TERMS = AUTO


@dataclass(frozen=True)
class Auto:
    """Choose the look's terms."""

    start: Look = field(default_factory=_PLAIN)
    """Start values of what all sets of terms have."""


def check_sharp(blurs: bool) -> None:
    """Raise `InputError` for photos with a blur."""
    if blurs:
        raise InputError(
            "fit: look='auto' chooses no terms of blurred photos; name them, such as "
            "air+density+saturation, or leave out the blur"
        )


def choose_terms(task: Task, where: Where, declared: Declare) -> Task:
    """The task for the look whose terms the photos support, with the start's values.

    Args:
        task: as asked, of the look without terms. It stays where there is nothing to choose by.
    """
    usable = usable_pixels(task, where)
    used = few_of(usable)
    if count_of(used) < LEAST_PIXELS:
        return replace(task, selection=_untried(f"fewer than {LEAST_PIXELS} pixels have no edge"))
    trial = Trial(task, used, declared)
    first = trial.program(trial.stages[0]).best()
    believed = _believed(first)
    if believed is not None:
        if count_of(believed) < LEAST_PIXELS:
            why = f"fewer than {LEAST_PIXELS} pixels are neither white nor doubted"
            return replace(task, selection=_untried(why))
        trial = Trial(task, believed, declared)
        first = trial.program(trial.stages[0]).best()
    if not first.light > 0 or not np.isfinite(first.square_sum):
        return replace(task, selection=_untried("all air is black, or brighter than can be told"))
    best, selection = _choose(trial, first, usable)
    if not best.terms:
        return replace(task, selection=selection)
    look = like(_TERMS.with_terms(best.terms), task.look)
    parameters = declared(look)
    return replace(
        task, look=look, parameters=parameters, selection=selection, seed=best.placed(parameters)
    )


def _untried(why: str) -> Selection:
    """What is said where there is nothing to choose by."""
    terms = tuple(TermChoice(t, False, None, (), _TERMS.TERMS[t], why) for t in _TERMS.CHOICES)
    return Selection(terms, 0, 0.0)


def _believed(first: End) -> Used | None:
    """The pixels, without those that may be clipped, and of a robust loss without those it doubts;
    None if these are all.

    By what all terms make of them: of light chosen by what was measured noise would look like air
    that saturates. Samples at the lowest code count as measured.
    """
    trial = first.program.trial
    robust = trial.task.loss != "linear"
    found, changed = [], False
    for used, columns, clipped, left in zip(
        trial.used, first.program.problem.columns, trial.clipped, first.left_over, strict=True
    ):
        known = np.abs(left[np.isfinite(left)])  # a grey photo's copies are not
        noise = 1.4826 * float(np.median(known)) if known.size else 0.0
        doubted = np.zeros(len(left), bool)
        if (clipped > 0).any():
            limit = float(columns.light[clipped > 0].min())
            near = columns.light - left > limit - min(DOUBT * noise, NEAR * limit)
            doubted |= (near | (clipped > 0)).any(axis=1)
        if robust:
            doubted |= (np.abs(left) > DOUBT * noise).any(axis=1)
        rest = used.copy()
        rest.reshape(-1)[columns.index[doubted]] = False
        changed |= bool(doubted.any())
        found.append(rest)
    return found if changed else None


def _choose(trial: Trial, first: End, usable: Used) -> tuple[End, Selection]:
    """From the richest set that has something to explain, backwards.

    Args:
        first: the best of all terms of the cheapest program.
        usable: pixels of which those of the trial are some.
    """
    dear, vain = set[str](), set[str]()
    best = first
    for k, stage in enumerate(trial.stages):
        program = trial.program(stage)
        found = program.best([best]) if k else best
        if found.square_sum > best.square_sum:
            vain = set(found.terms - best.terms)
        else:
            best, vain = found, set()
        count, independent = scattered_samples(best.places, best.left_over)
        if independent and not trial.neighbours_agree(best, usable):
            dear = {t for later in trial.stages[k + 1 :] for t in trial.program(later).terms}
            dear -= program.terms
            break
    columns = best.program.problem.columns
    uncredited = FAINT**2 * best.light
    if trial.task.sampling == "area":
        uncredited += sum(map(_bent, trial.task.layers, columns))
    compared = [t for t in _TERMS.CHOICES if t not in trial.absent and t not in dear]
    each = 2 * np.log(max(len(compared), 1))
    tiny = float(np.finfo(np.float64).tiny)

    def gain(small: End, large: End) -> float:
        """BIC of the smaller set less that of the larger, as Chen and Chen, Biometrika 95, 759,
        2008, have it (γ = 1 for single terms): of many terms one looks worth it by chance."""
        least = max(small.square_sum - uncredited, large.square_sum)
        odds = count * np.log((least + tiny) / (large.square_sum + tiny))
        more = large.parameters - small.parameters
        return float(odds - np.log(count) * more - each * len(large.terms - small.terms))

    told: dict[str, float] = {}
    gone: dict[str, frozenset[str]] = {}
    while True:
        ordered = [term for term in _TERMS.CHOICES if term in best.terms]
        groups = {term: _with(trial, best, term) for term in ordered}
        alone = {term: group for term, group in groups.items() if len(group) == 1}
        # What others hang on is dearer to try, and only once none of them can go alone.
        for tried in (alone, {t: group for t, group in groups.items() if t not in alone}):
            without = {term: _without(trial, best, group) for term, group in tried.items()}
            gains = {term: gain(end, best) for term, end in without.items()}
            told |= gains
            worst = min(gains, key=lambda term: gains[term], default="")
            if worst and not gains[worst] > 0:  # a NaN speaks for nothing
                break
        else:
            break
        best = without[worst]
        told |= dict.fromkeys(groups[worst], gains[worst])
        gone |= dict.fromkeys(groups[worst], groups[worst])
    samples = sum((3 - len(c.copies)) * len(c.index) for c in best.program.problem.columns)
    untold = dict.fromkeys(dear, DEAR) | dict.fromkeys(vain, VAIN)
    return best, Selection(_rows(trial, best, told, gone, untold), samples, count)


def _with(trial: Trial, best: End, term: str) -> frozenset[str]:
    """A term, and what goes with it: what needs it, and what cannot be held and has its parameters,
    with all that needs that."""
    gone, new = frozenset[str](), frozenset([term])
    while new:
        gone |= new
        new = frozenset(
            other
            for other in best.terms - gone
            if gone & set(_TERMS.TERM_NEEDS.get(other, ()))
            or (
                other in trial.hard
                and any(set(trial.own(other)) & set(trial.own(one)) for one in gone)
            )
        )
    return gone


def _without(trial: Trial, best: End, gone: frozenset[str]) -> End:
    """The best without some of its terms."""
    program = trial.program(best.program.hard - gone)
    return program.fit(best.terms - gone, [best], spread=program is not best.program)


def _rows(
    trial: Trial,
    best: End,
    told: dict[str, float],
    gone: dict[str, frozenset[str]],
    untold: dict[str, str],
) -> tuple[TermChoice, ...]:
    """What is said of each term.

    Args:
        told: BIC for it.
        gone: what was left out together with it.
        untold: why it was not compared.
    """
    rows = []
    for term in _TERMS.CHOICES:
        taken = term in best.terms
        group = _with(trial, best, term) if taken else gone.get(term, frozenset())
        others = [other for other in _TERMS.CHOICES if other in group and other != term]
        why = trial.absent.get(term) or untold.get(term, "")
        if others and not why:
            why = f"together with {' and '.join(others)}"
        own = tuple(trial.own(term))
        rows.append(TermChoice(term, taken, told.get(term), own, _TERMS.TERMS[term], why))
    return tuple(rows)


def _bent(layers: Layers, columns: Columns) -> float:
    """Square sum of what means over pixels' squares may differ by from light in their middles.

    A mean over a square of side 1 differs by a 24th of the second differences; of the light those
    of the air's width are told, which hang on no look. Where a neighbour is not known there are
    none.
    """
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    row, column = np.divmod(columns.index, front.shape[1])

    def width(down: int, right: int) -> Float[np.ndarray, " n"]:
        y, x = row + down, column + right
        inside = (y >= 0) & (y < front.shape[0]) & (x >= 0) & (x < front.shape[1])
        at = np.where(inside, y, row), np.where(inside, x, column)
        with np.errstate(invalid="ignore"):
            found = back[at].astype(np.float64) - front[at]
        return found if layers.stretch is None else found * np.asarray(layers.stretch)[at]

    here = width(0, 0)
    bend = np.zeros(len(here))
    for step in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = width(*step)
        bend += np.where(np.isfinite(beside), beside - here, 0) / 24
    gain = columns.light.T @ here / max(float(here @ here), np.finfo(np.float64).tiny)
    return float((gain**2).sum() * (bend @ bend))
