"""How much of each cause is in what is left over, against the scatter of blocks.

Each cause is a few columns beside the slopes of the fit, a linear least squares problem (a Lagrange
multiplier test: Breusch and Pagan, Rev. Econ. Stud. 47, 239, 1980).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.special import fdtrc

from ..photo._blocks import block_numbers
from ..solve._scaled import unit_diagonal
from ._autocorrelation import correlation
from ._patterns import CAUSES, Patch, pixel_average
from ._spread import LEAST_BLOCK, LENGTHS, inverse_root, stretch_of

PRIOR = 0.5
"""Amount of a cause that surprises nobody: a vignette of half the light, half a gamma, half a
pixel. Of what a test hardly sees no more is believed."""

FEWEST = 3
"""Degrees of freedom for each amount, below which nothing is tested."""

SPANNED = 1e-8
"""Share of a cause's square sum below which others make it up, to the rounding of their sums."""

WINDOW = 256
"""Pixels across the part in which correlation is measured."""


@dataclass(frozen=True)
class Amounts:
    """What was found of a cause."""

    amounts: Float[np.ndarray, " k"]
    """How much there is of each of its columns."""
    covariance: Float[np.ndarray, "k k"]
    """Covariance of these, by the scatter of blocks."""
    chance: float
    """That noise looks like this."""
    gained: float
    """Square sum of the light that goes with the cause and with nothing beside it."""
    information: float
    """Akaike's criterion, negative: the more, the likelier is the cause."""
    moved: Float[np.ndarray, "t t"]
    """Mean square of how far all light of the cause moves the identified parameters, in amounts
    that are likely by the photo and by `PRIOR`."""


@dataclass(frozen=True)
class Sums:
    """Products of slopes, causes and what is left over, summed over blocks.

    Every question is one of least squares in few columns, and these answer all of them.
    """

    products: Float[np.ndarray, "blocks k k"]
    count: int
    identified: Float[np.ndarray, "t p"]
    """Rows of the identified parameters."""
    slopes_of: Float[np.ndarray, "t p"]
    """Makes slopes along the free directions of influences."""
    curved: Float[np.ndarray, "p p"]
    """Half the second derivative of the square sum, of so many pixels."""
    slopes: slice
    causes: dict[str, slice]
    average: slice
    """The column of `pixel_average`; what is left over comes after it, the last."""

    @staticmethod
    def of(
        patch: Patch,
        slopes: Float[np.ndarray, "t 3 m"],
        left: Float[np.ndarray, "m 3"],
        identified: Float[np.ndarray, "t p"],
        slopes_of: Float[np.ndarray, "t p"],
        curved: Float[np.ndarray, "p p"],
        add_own: bool,
    ) -> "Sums | None":
        """The sums over measured samples; None if there is none.

        Blocks are larger than what is left over without all causes hangs together. `curved` is
        without these samples' own products where they are to be added.
        """
        known = np.isfinite(left)
        if not known.any():
            return None
        columns = [slope.T for slope in slopes]
        causes = {}
        for name, (_, pattern) in CAUSES.items():
            parts = pattern(patch)
            causes[name] = slice(len(columns), len(columns) + len(parts))
            columns += parts
        columns += [pixel_average(patch), left]
        rows = np.stack([column[known] for column in columns], axis=1)
        numbers = block_numbers(patch.columns.index, patch.size, LEAST_BLOCK)
        products = _summed(rows, np.broadcast_to(numbers[:, None], known.shape)[known])
        count = len(columns)
        rest = np.full(left.shape, np.nan)
        rest[known] = rows[:, -1] - rows[:, :-2] @ _solved(
            products.sum(axis=0), np.arange(count - 2)
        )
        length, _, _ = correlation([patch.columns], [patch.size], [rest], WINDOW)
        units = int(np.ceil(LENGTHS * length / LEAST_BLOCK)) if length > 1 else 1
        if units > 1:
            # Blocks of 8 pixels side by side make up one of several times 8.
            larger = block_numbers(patch.columns.index, patch.size, LEAST_BLOCK * units)
            _, first = np.unique(numbers, return_index=True)
            whole = np.zeros((int(larger.max()) + 1, count, count))
            np.add.at(whole, larger[first[: len(products)]], products)
            products = whole
        slope = slice(0, len(slopes))
        if add_own:
            curved = curved + slopes_of.T @ products.sum(axis=0)[slope, slope] @ slopes_of
        average = slice(count - 2, count - 1)
        return Sums(products, len(rows), identified, slopes_of, curved, slope, causes, average)

    @cached_property
    def total(self) -> Float[np.ndarray, "k k"]:
        """Over all blocks."""
        return np.asarray(self.products.sum(axis=0))

    @property
    def left(self) -> float:
        """Square sum of what is left over."""
        return float(self.total[-1, -1])

    def shift_of(self, part: slice) -> Float[np.ndarray, "t q"]:
        """By which one unit of columns moves the identified parameters, were all pixels like
        these."""
        pulled = self.slopes_of.T @ self.total[self.slopes, part]
        root = inverse_root(self.curved)
        return np.asarray(self.identified @ root @ (root.T @ pulled))

    def without_average(self, share: float) -> "Sums":
        """The same with so much of the mean over pixels' squares taken from what is left over."""
        change = np.eye(len(self.total))
        change[self.average, -1] = -share
        return replace(self, products=change.T @ self.products @ change)

    def amounts(self, part: slice, beside: Sequence[slice]) -> Amounts | None:
        """How much of a cause's columns is in what is left over, others beside it.

        None where the others span the columns, or blocks are too few to tell.
        """
        size = len(self.total)
        others = np.concatenate([np.arange(size)[one] for one in beside])
        own = np.zeros((size, part.stop - part.start))
        own[part] = np.eye(own.shape[1])
        own[others] = -_solved(self.total, others, part)
        kept = _independent(own.T @ self.total @ own, np.diag(self.total)[part])
        q = kept.shape[1]
        if not q:
            return None
        white = own @ kept
        amounts = white.T @ self.total[:, -1]
        rest = -white @ amounts
        rest[-1] = 1.0
        rest[others] -= _solved(self.total, others)
        squares = np.einsum("ki,gkl,lj->gij", white, self.products, white, optimize=True)
        scores = np.einsum("ki,gkl,l->gi", white, self.products, rest, optimize=True)
        scores = np.einsum("gij,gj->gi", stretch_of(squares), scores)
        share = np.trace(squares, axis1=1, axis2=2) / q
        freedom = 1 / float(share @ share)  # of equal blocks their number
        if freedom < FEWEST * q:
            return None
        middle = scores.T @ scores
        if not np.linalg.cond(middle) < 1 / SPANNED:
            return None  # nothing scatters: what is left over is rounding
        ratio = float(amounts @ np.linalg.solve(middle, amounts)) / q
        ratio *= (freedom - q + 1) / freedom
        # What the photo says of the amounts and what is said before, multiplied.
        identified = np.linalg.inv(middle)
        likely = np.linalg.inv(identified + kept.T @ kept / PRIOR**2)
        mean = likely @ identified @ amounts
        moved = self.shift_of(part) @ kept
        return Amounts(
            amounts=kept @ amounts,
            covariance=kept @ middle @ kept.T,
            chance=float(fdtrc(q, freedom - q + 1, ratio)),
            gained=float(amounts @ amounts),
            information=float(amounts @ amounts) * q / float(np.trace(middle)) - 2 * q,
            moved=moved @ np.outer(mean, mean) @ moved.T,
        )


def _independent(
    products: Float[np.ndarray, "k k"], squares: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k q"]:
    """Combinations of columns that others do not span, which make their products the unit matrix.

    Args:
        products: of the columns without what others span.
        squares: of the columns themselves.
    """
    size = np.sqrt(np.where(squares > 0, squares, np.inf))
    values, vectors = np.linalg.eigh(products / size / size[:, None])
    own = values > SPANNED
    return np.asarray(vectors[:, own] / np.sqrt(values[own]) / size[:, None])


def _solved(
    products: Float[np.ndarray, "k k"], of: Int[np.ndarray, " n"], part: slice | None = None
) -> np.ndarray:
    """Least squares of columns `of` for a part of the others, or for what is left over.

    By the normal equations, of columns of one length; identified tints are dependent.
    """
    target = products[of, -1] if part is None else products[of, part]
    scaled, size = unit_diagonal(products[np.ix_(of, of)])
    found = np.linalg.pinv(scaled, rcond=SPANNED**1.5, hermitian=True) @ (target.T / size).T
    return np.asarray((found.T / size).T)


def _summed(
    rows: Float[np.ndarray, "n k"], numbers: Int[np.ndarray, " n"]
) -> Float[np.ndarray, "blocks k k"]:
    """Products of columns over the rows of each number, which come in order."""
    starts = np.flatnonzero(np.diff(numbers, prepend=-1))
    found = np.zeros((int(numbers[-1]) + 1, rows.shape[1], rows.shape[1]))
    for start, part in zip(starts, np.split(rows, starts[1:]), strict=True):
        found[numbers[start]] = part.T @ part
    return found
