"""What a search works on: samples, parameters and model; and a point in it, with its ways on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax._parameter import LENGTH, PER_UNIT

from .._compile import float64
from ..photo._columns import Columns
from ._descend import exact_gram
from ._model import Model
from ._parameters import Entries, FitParameter
from ._reduce import MOST_BINNED, bins, moments, thin_of, thinned
from ._samples import Samples, on_device, to_samples

SHALLOWEST = 1 / 300
"""A length that may be of air, as a share of its height: of a shell of 100 km, a third."""

DEPTHS = (0.1, 100.0)
"""Optical depths that may be, on the longest way through uniform air; where it thins out, ways are
shorter."""


UNIFORM = 1000.0
"""Heights of air that a length may be at most where nothing else bounds it: air that thins out by a
thousandth on its way up is uniform to a quarter of that, less than a step of 8 bits."""


LINE = 0.02
"""Pixels in which air thins out at least where a photo is blurred: light of less is a line, of
which only the sum is told."""


def likely_ranges(columns: Sequence[Columns]) -> dict[str, tuple[float, float]]:
    """By unit, what is likely of lengths and of what is per width, by the air's size."""
    height = width = 0.0
    for c in columns:
        if {"begin", "end", "altitude", "per_length"} <= c.fields.keys():
            through = c.fields["end"] - c.fields["begin"]
            height = max(height, float(c.fields["altitude"][through > 0].max(initial=0.0)))
            width = max(width, float((through * c.fields["per_length"]).max(initial=0.0)))
        elif "lit" in c.fields:
            through = c.fields["lit"] + c.fields.get("dark", 0.0)
            width = max(width, float(through.max(initial=0.0)))
    likely = {LENGTH: (SHALLOWEST * height, height)} if height > 0 else {}
    depths = {PER_UNIT: (DEPTHS[0] / width, DEPTHS[1] / width)} if width > 0 else {}
    return likely | depths


def within_scene(
    parameters: Sequence[FitParameter], columns: Sequence[Columns]
) -> tuple[FitParameter, ...]:
    """The parameters; free lengths without bounds get those of the scene, or they would run off
    where the air is uniform or, in a blurred photo, a line of light."""
    ranges = likely_ranges(columns)
    if LENGTH not in ranges:
        return tuple(parameters)
    most, least = UNIFORM * ranges[LENGTH][1], _shortest(columns)

    def within(p: FitParameter) -> FitParameter:
        if p.unit != LENGTH or p.role == "fixed" or not least < p.value < most:
            return p
        lower = least if p.lower == 0 else p.lower
        return replace(p, lower=lower, upper=most if math.isinf(p.upper) else p.upper)

    return tuple(within(p) for p in parameters)


def one_in_grey(
    parameters: Sequence[FitParameter], columns: Sequence[Columns], family: str
) -> tuple[FitParameter, ...]:
    """The parameters; where all photos are grey the free channels of a family are one number, if
    they start as one."""
    members = [p for p in parameters if p.family == family and p.role == "free"]
    grey = bool(columns) and all(len(c.copies) == 2 for c in columns)
    alike = len({(p.value, p.lower, p.upper, p.prior) for p in members}) == 1
    if not grey or not alike:
        return tuple(parameters)
    first, others = members[0], members[1:]
    return tuple(
        replace(p, role="tied", tied_to=first.name) if p in others else p for p in parameters
    )


def _shortest(columns: Sequence[Columns]) -> float:
    """The least length that blurred photos tell from 0; 0 of sharp ones."""
    found = 0.0
    for c in columns:
        if c.stencil is not None and "altitude" in c.stencil.fields and c.stencil.heights.any():
            height, px = c.stencil.fields["altitude"].max(), c.stencil.heights.max()
            found = max(found, LINE * float(height / px))
    return found


@dataclass(frozen=True)
class Problem:
    """Samples and what may be done with them."""

    columns: tuple[Columns, ...]
    samples: Samples
    """All of `columns`, on the device; or the reduced ones that stand for them."""
    parameters: tuple[FitParameter, ...]
    model: Model
    is_rough: bool = False
    """`samples` are what descents are made on: the reduced ones already, or all."""

    @cached_property
    def reduced(self) -> Samples:
        """What stands for all until the exact steps: as few pseudo-pixels as serve."""
        columns, samples, plain = self.columns, self.samples, self.model.loss.name == "linear"
        if self.is_rough:
            return samples
        with float64():
            if plain and samples.clipped is None and self.model.linear:
                return moments(samples)
            if samples.clipped is None:  # all are believed as measured, those at an end, too
                columns = tuple(replace(c, clipped=None) for c in columns)
            pairs = samples.surface is None and samples.stencil is None
            if plain and pairs and len(samples.fields) <= MOST_BINNED:
                return bins(columns)
            if sum(len(c.index) for c in columns) > 2 * thin_of(columns):
                return thinned(columns)
            return samples

    @cached_property
    def count(self) -> int:
        """Measured samples, three to a pixel; without clipped ones and copies."""
        clipped = sum(int((c.clipped != 0).sum()) for c in self.columns if c.clipped is not None)
        return sum((3 - len(c.copies)) * len(c.index) for c in self.columns) - clipped

    @cached_property
    def light_max(self) -> float:
        """Largest |light|."""
        return max(_largest(c.light) for c in self.columns)

    @cached_property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """What is likely of lengths and of what is per width, as far as the air's size tells."""
        return likely_ranges(self.columns)

    @property
    def plain(self) -> bool:
        """Least squares of measured samples."""
        return self.model.loss.name == "linear" and self.samples.clipped is None

    @property
    def rounding(self) -> float:
        """Square sum that float64 makes of nothing: an eps of the brightest for each sample."""
        return self.count * (np.finfo(np.float64).eps * self.light_max) ** 2

    def rough(self) -> "Problem":
        """The reduced samples in place of all: for answers that are asked again."""
        return replace(self, samples=self.reduced, is_rough=True)

    def whole(self) -> "Problem":
        """All samples in place of the reduced ones: for what these lead away from."""
        return replace(self, is_rough=True)

    def beside(self, columns: Sequence[Columns]) -> "Problem":
        """The same look and model seen by other pixels."""
        return replace(self, columns=tuple(columns), samples=on_device(to_samples(columns)))

    def gram(
        self, vector: Entries, directions: Float[np.ndarray, "e p"]
    ) -> Float[np.ndarray, "q q"]:
        """The exact pass over all samples."""
        with float64():
            return np.asarray(
                exact_gram(jnp.asarray(vector), jnp.asarray(directions), self.samples, self.model)
            )

    def square_sum(self, vector: Entries) -> float:
        """Cost of a vector over all samples."""
        return float(self.gram(vector, np.zeros((len(vector), 0)))[-1, -1])


@dataclass(frozen=True)
class Point:
    """A vector in a problem, and the directions that lead on from it."""

    problem: Problem
    vector: Entries
    directions: Float[np.ndarray, "e p"]
    """One column for each degree of freedom (`free_directions`)."""

    def moved(self, step: Float[np.ndarray, " p"]) -> "Point":
        """The point a step along the directions away."""
        return replace(self, vector=self.vector + self.directions @ step)

    def gram(self) -> Float[np.ndarray, "q q"]:
        """The exact pass here."""
        return self.problem.gram(self.vector, self.directions)


def _largest(values: np.ndarray) -> float:
    """Largest absolute value; 0 of none."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
