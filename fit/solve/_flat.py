"""What the photo cannot tell, in words: flat directions of the square sum and their names.

The singular values of the Jacobian, its columns scaled to one length, say which combinations of
parameters change nothing in the pixels used. Each such direction is named by the parameters that
take part and by what of them is told after all: their product, their ratio, their sum; the one that
is told last in order is held.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from model_jax._fields import WIDTHS

from ._parameters import Entries, FitParameter
from ._problem import Point, Problem
from ._samples import TILE
from ._scaled import unit_diagonal

TAKES_PART = 0.1
"""Share of a flat direction, in units of the scaled columns, from which a parameter is named."""

RESOLUTION = float(np.sqrt(2 * 3 * TILE * np.finfo(np.float64).eps))
"""Singular values below this share are not told from zero. Squares of the Jacobian are what is
summed, three to a pixel: alike summands round alike, all one way, so that an element of the matrix
may be off by half an eps for each summand of a tile, and its eigenvalues by a few times that."""


@dataclass(frozen=True)
class Flat:
    """A direction along which nothing changes."""

    held: tuple[FitParameter, ...]
    """What is held at its start for it."""
    why: str
    """For people, without a full stop."""


def find_flat(
    point: Point,
    gram: Float[np.ndarray, "q q"],
    moved: Sequence[tuple[FitParameter, ...]],
) -> tuple[Flat, ...]:
    """The flattest direction, if rounding explains what is left of it; none if all is told.

    Of tables all numbers at once that no pixel sees: each would cost a fit of the rest.
    """
    vector = point.vector
    curved = gram[:-1, :-1]
    unseen = [parameters for k, parameters in enumerate(moved) if not curved[k, k] > 0]
    if unseen:
        of = [parameters[0].family for parameters in unseen]
        known = point.problem.model.layout.families
        tables = [isinstance(known[family].shape, int) for family in of]
        chosen = [p for p, table in zip(unseen, tables, strict=True) if table] or unseen[:1]
        return tuple(Flat(parameters, _no_effect(point, parameters[0])) for parameters in chosen)
    if len(curved) < 2:
        return ()
    scaled, size = unit_diagonal(curved)
    values, vectors = np.linalg.eigh(scaled)
    if values[0] > _threshold(point.problem) ** 2:
        return ()
    part = vectors[:, 0]
    members = [int(j) for j in np.flatnonzero(np.abs(part) > TAKES_PART)]
    last = moved[members[-1]]
    return (Flat(last, _words(vector, part / size, members, moved)),)


def _threshold(problem: Problem) -> float:
    """Share below which a scaled singular value is rounding, of the sums or of the widths."""
    widths = [c.fields[n] for n in WIDTHS for c in problem.columns if n in c.fields]
    if not widths:
        return RESOLUTION
    square_sum = sum(float(width @ width) for width in widths)
    n = sum(len(c.index) for c in problem.columns)
    error = max(c.width_error for c in problem.columns)
    return float(RESOLUTION + 2 * error * np.sqrt(n / square_sum)) if square_sum > 0 else 1.0


def _no_effect(point: Point, parameter: FitParameter) -> str:
    layout = point.problem.model.layout
    fact = layout.kind.SEPARABLE
    factors = () if fact is None else (fact.factors, fact.weight)
    if fact and parameter.family in factors and not layout.values(point.vector)[fact.amplitude]:
        return f"{fact.amplitude} is 0, so it has no effect"
    return "it has no effect in the pixels used"


def _words(
    vector: Entries,
    step: Float[np.ndarray, " p"],
    members: Sequence[int],
    moved: Sequence[tuple[FitParameter, ...]],
) -> str:
    """The sentence for a flat direction; `step` is in parameter units."""
    names = list(dict.fromkeys(_name(moved[j]) for j in members))
    listed = " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]
    if len(members) == 2 and len(names) == 2:
        change = np.array([step[j] for j in members])
        value = np.array([float(moved[j][0].of(vector)) for j in members])
        shares = any(moved[j][0].mean_one for j in members)
        relative = change / np.where(value != 0, value, np.nan)
        if not shares and np.isclose(relative[0], -relative[1], rtol=1e-2):
            return f"the photo tells {listed} only as a product; {_remedy(names)}"
        if not shares and np.isclose(relative[0], relative[1], rtol=1e-2):
            return f"the photo tells {listed} only as a ratio; {_remedy(names)}"
        if not shares and np.isclose(change[0], -change[1], rtol=1e-2):
            return f"the photo tells {listed} only as a sum; {_remedy(names)}"
    if len(names) == 1:
        return "it has no effect in the pixels used"
    return f"in the pixels used {listed} act alike; {_remedy(names)}"


def _remedy(names: Sequence[str]) -> str:
    exposures = any(name.split(".")[0] == "exposure" for name in names)
    return "fix one" + (" or add a photo of another exposure that is known" if exposures else "")


def _name(parameters: tuple[FitParameter, ...]) -> str:
    return parameters[0].family if len(parameters) > 1 else parameters[0].name
