"""Sets of a look's terms, tried on few pixels.

One program serves all sets whose other terms can be held at values with which they do nothing
(`Look.TERM_OFF`): a number of them costs a compilation each, however many terms there are.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from model_jax import InputError, Look
from model_jax.looks._registry import AUTO

from ._choices import Where
from ._compile import float64
from ._rounds import make_problem
from .diagnose._effective import QUIET
from .diagnose._remarks import leave_out
from .diagnose._residuals import residuals_of
from .photo._columns import Columns, take_columns
from .photo._pixels import choose_pixels, edges_of
from .solve._approach import approach
from .solve._parameters import Entries, FitParameter, free_directions, to_entries
from .solve._problem import Problem, one_in_grey, within_scene
from .solve._task import Task

MOST_SAMPLES = 4096
"""Samples looked at, three to a pixel: a term that tells a hundredth of what is left over gains 40
in BIC, less what its numbers cost."""
LEAST_PIXELS = 64
"""Pixels below which nothing is chosen: BIC is of many samples."""

STEPS = 80
TOLERANCE = 1e-6
"""Most steps of a descent, and the relative change of square sum and values at which it ends: of
BIC 4e-3 at `MOST_SAMPLES`."""

_SEED = 20

_TERMS = AUTO[1]

Declare = Callable[[Look], tuple[FitParameter, ...]]
"""Parameters of a look, with all that was asked of them."""

Used = list[Bool[np.ndarray, "h w"]]
"""Pixels of each photo."""


def like(kind: type[Look], start: Look) -> Look:
    """A look of a kind with another's values, as far as its ranges go."""
    known, values = kind.PARAMETERS, {}
    for name in type(start).PARAMETERS:
        value, about = getattr(start, name), known[name]
        values[name] = value if about.mean_one else np.clip(value, about.lower, about.upper)
    return kind(**values)


def usable_pixels(task: Task, where: Where) -> Used:
    """Pixels that a fit uses, but no edges, even where it has to use them: terms would explain
    these."""
    found = []
    for photo, layers in zip(task.photos, task.layers, strict=True):
        used = choose_pixels(photo, layers, task.sampling, where).used
        if task.sampling == "area":
            used = used & ~np.logical_or.reduce(list(edges_of(layers).values()))
        found.append(used)
    return found


def few_of(usable: Used) -> Used:
    """As many of them as are looked at."""
    rng = np.random.default_rng(_SEED)
    share = min(1.0, MOST_SAMPLES // 3 / max(count_of(usable), 1))
    found = []
    for used in usable:
        index = np.flatnonzero(used)
        few = np.zeros(used.shape, bool)
        few.reshape(-1)[rng.permutation(index)[: int(share * len(index))]] = True
        found.append(few)
    return found


def count_of(used: Used) -> int:
    """Pixels of all photos."""
    return sum(int(one.sum()) for one in used)


@dataclass(frozen=True)
class End:
    """The best of a set of terms."""

    program: "Program"
    terms: frozenset[str]
    vector: Entries
    square_sum: float
    parameters: int

    def placed(self, parameters: Sequence[FitParameter]) -> Entries:
        """Its numbers where others have the same names, else their start values."""
        known = {p.name: float(p.of(self.vector)) for p in self.program.problem.parameters}
        vector = to_entries(parameters)
        for p in parameters:
            if p.role != "fixed" and p.name in known:
                vector[list(p.entries)] = known[p.name]
        return vector

    @property
    def light(self) -> float:
        """Square sum of the photos' light."""
        columns = self.program.problem.columns
        return sum(float((np.asarray(c.light, np.float64) ** 2).sum()) for c in columns)

    @property
    def left_over(self) -> list[Float[np.ndarray, "_ 3"]]:
        """Residuals of each photo's pixels."""
        return residuals_of(self.program.problem, self.vector)

    @property
    def places(self) -> list[Int[np.ndarray, "2 _"]]:
        """Row and column of each."""
        sizes = self.program.trial.task.sizes
        columns = self.program.problem.columns
        return [
            np.stack(np.divmod(c.index, size[1])) for c, size in zip(columns, sizes, strict=True)
        ]


class Program:
    """A look with all terms that go with some which cannot be held, and its samples."""

    def __init__(self, trial: "Trial", hard: tuple[str, ...]) -> None:
        soft = [
            term
            for term in trial.soft
            if set(_TERMS.TERM_NEEDS.get(term, ())) <= set(hard) and term not in trial.absent
        ]
        self.hard = frozenset(hard)
        self.kind = _TERMS.with_terms([*hard, *soft])
        owned = {family for term in hard for family in trial.own(term)}
        # What shares its parameters with a term that cannot be held is there with it.
        self.bound = frozenset(t for t in soft if owned & set(trial.own(t)))
        self.soft = frozenset(soft) - self.bound
        self.trial = trial
        task, columns = trial.task_of(self.kind)
        self.problem: Problem = make_problem(task, columns).whole()
        self.asked: tuple[FitParameter, ...] = leave_out(task, columns)[0]

    @property
    def terms(self) -> frozenset[str]:
        return self.hard | self.bound | self.soft

    def fit(self, terms: frozenset[str], starts: Sequence[End] = (), spread: bool = True) -> End:
        """The best with some of the terms, from given ends and from starts that are spread."""
        problem = self.problem
        held = to_entries(problem.parameters)
        off = {
            family: value
            for term in self.soft - terms
            for family, value in _TERMS.TERM_OFF[term].items()
        }
        for p in problem.parameters:
            if p.family in off:
                held[list(p.entries)] = off[p.family]
        free = [p for p in self.asked if p.family not in off]
        if not free:
            return End(self, terms, held, problem.square_sum(held), 0)
        near = [self._moved(end, held, free) for end in starts]
        with float64():
            found = approach(
                problem,
                held,
                free,
                STEPS,
                None if spread else near,
                more=near if spread else (),
                tolerance=TOLERANCE,
                most=free_directions(self.asked, problem.parameters)[0].shape[1],
            )
        square_sum = found.history[-1] if found.finite and found.history else np.inf
        count = free_directions(free, problem.parameters)[0].shape[1]
        return End(self, terms, found.entries, float(square_sum), count)

    def best(self, starts: Sequence[End] = ()) -> End:
        """The best with all terms; from that without what can be held, too."""
        return self.fit(self.terms, [*starts, self.fit(self.hard | self.bound, starts)])

    def _moved(self, end: End, held: Entries, free: Sequence[FitParameter]) -> Entries:
        """Another set's end as a start, by the names of what is free here."""
        known = {p.name: float(p.of(end.vector)) for p in end.program.problem.parameters}
        off = _TERMS.TERM_OFF
        gone = {f for t in end.program.soft - end.terms for f in off[t]}
        start = held.copy()
        for p in self.problem.parameters:
            free_here = any(q.name == (p.tied_to or p.name) for q in free)
            if free_here and p.name in known and p.family not in gone:
                start[list(p.entries)] = known[p.name]
        return start


def _within_prior(p: FitParameter) -> FitParameter:
    """A parameter within three standard deviations of what was known before."""
    if p.prior is None:
        return p
    reach = 3 * p.prior.sigma
    low, high = max(p.lower, p.prior.mean - reach), min(p.upper, p.prior.mean + reach)
    return replace(p, lower=low, upper=high) if low < high else p


class Trial:
    """Few pixels, and the programs that were tried on them."""

    def __init__(self, task: Task, used: Used, declared: Declare) -> None:
        self.task, self.used, self.declared = task, used, declared
        self.soft = [term for term in _TERMS.CHOICES if term in _TERMS.TERM_OFF]
        self.hard = [term for term in _TERMS.CHOICES if term not in _TERMS.TERM_OFF]
        self.absent: dict[str, str] = {}
        """Why layers and pixels cannot tell a term."""
        self._programs: dict[frozenset[str], Program] = {}
        for term in _TERMS.CHOICES:
            if why := self._why_absent(term):
                self.absent[term] = why

    def own(self, term: str) -> list[str]:
        """Families of the parameters that a term brings."""
        needed = _TERMS.TERM_NEEDS.get(term, ())
        before = _TERMS.with_terms(needed).PARAMETERS
        return [f for f in _TERMS.with_terms([*needed, term]).PARAMETERS if f not in before]

    @cached_property
    def clipped(self) -> list[Int8[np.ndarray, "_ 3"]]:
        """Of each photo's samples 1: at least this bright, -1: at most, 0: measured."""
        return [
            np.zeros(c.light.shape, np.int8) if c.clipped is None else c.clipped
            for c in self._columns(type(self.task.look), self.used)
        ]

    def task_of(self, kind: type[Look]) -> tuple[Task, tuple[Columns, ...]]:
        """The task for a kind of look on the few pixels. Raises `InputError` naming a field that
        the layers cannot give."""
        task, look = self.task, like(kind, self.task.look)
        columns = tuple(replace(c, clipped=None) for c in self._columns(kind, self.used))
        parameters = within_scene(tuple(map(_within_prior, self.declared(look))), columns)
        parameters = one_in_grey(parameters, columns, kind.GROUND)
        return replace(task, look=look, parameters=parameters, loss="linear"), columns

    def _columns(self, kind: type[Look], used: Used) -> list[Columns]:
        unit = float(self.task.layers[0].width_unit)
        return [
            take_columns(photo, layers, one, unit, kind)
            for photo, layers, one in zip(self.task.photos, self.task.layers, used, strict=True)
        ]

    def neighbours_agree(self, best: "End", usable: Used) -> bool:
        """Whether what is left over of pixels and of those to the right of them is alike by more
        than chance, or `QUIET`: scattered pixels are too far apart to tell."""
        beside = [
            np.pad(one[:, :-1], ((0, 0), (1, 0))) & most
            for one, most in zip(self.used, usable, strict=True)
        ]
        program = best.program
        columns = [replace(c, clipped=None) for c in self._columns(program.kind, beside)]
        residuals = residuals_of(program.problem.beside(columns), best.vector)
        products, squares, count = 0.0, 0.0, 0
        here = zip(program.problem.columns, best.left_over, strict=True)
        for (c, left), d, right in zip(here, columns, residuals, strict=True):
            order = np.argsort(c.index)
            at = order[np.searchsorted(c.index[order], d.index - 1)]
            pair = np.nan_to_num(left[at]), np.nan_to_num(right)
            products += float((pair[0] * pair[1]).sum())
            squares += float((pair[0] ** 2 + pair[1] ** 2).sum()) / 2
            count += pair[0].size
        return bool(products > max(QUIET, 3 / np.sqrt(max(count, 1))) * squares)

    @cached_property
    def stages(self) -> list[frozenset[str]]:
        """Terms that cannot be held, cheapest programs first."""
        hard = [term for term in self.hard if term not in self.absent]
        return [frozenset(hard[: k + 1]) for k in range(len(hard))] or [frozenset()]

    def program(self, hard: frozenset[str]) -> Program:
        if hard not in self._programs:
            self._programs[hard] = Program(self, tuple(t for t in self.hard if t in hard))
        return self._programs[hard]

    def _why_absent(self, term: str) -> str:
        """Why a term cannot be told; empty where it can."""
        needed = _TERMS.TERM_NEEDS.get(term, ())
        for other in needed:
            if other in self.absent:
                return self.absent[other]
        try:
            task, columns = self.task_of(_TERMS.with_terms([*needed, term]))
        except InputError as error:
            if not str(error).startswith("layers: "):
                raise
            return "the " + str(error).split(",")[0].replace("layers: ", "layers ", 1)
        asked, left_out = leave_out(task, columns)
        if any(p.family in self.own(term) for p in asked):
            return ""
        return next((item.why for item in left_out if item.what in self.own(term)), "it is held")
