"""Fits to measure: their pixels, and the optimum that all are held against.

The optimum is none of the contestants' own: from where airlight ends, Gauss–Newton steps by QR of
all residuals' float64 slopes go on until they do nothing, which keeps twice the digits that sums
of products do.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float

from model_jax import Layers, Look, Response

from .._choices import Sampling, Where
from .._compile import float64
from ..photo._columns import Columns, PhotoLike, take_columns
from ..photo._pixels import choose_pixels
from ..solve._declare import declare
from ..solve._layout import Layout
from ..solve._loss import Loss
from ..solve._model import Model
from ..solve._parameters import Entries, FitParameter, free_directions, is_outside, to_entries
from ..solve._problem import Problem, within_scene
from ..solve._samples import Samples, on_device, to_samples
from ..solve._search import search
from ._measure import codes_apart
from ._residuals import Residuals

MAX_STEPS = 256
"""Steps a descent is given at most."""

_POLISHES = 8
"""Steps by QR at most: each has twice the digits of the one before, until they are rounding."""


@dataclass(frozen=True)
class Case:
    """A photo and a look, as the pixels that all contestants get."""

    scene: str
    name: str
    """Of the look."""
    look: Look
    """Its start values."""
    columns: Columns
    parameters: tuple[FitParameter, ...]
    model: Model
    truth: Entries | None = None
    """What a synthetic photo was made with."""

    @property
    def free(self) -> list[FitParameter]:
        return [p for p in self.parameters if p.role == "free"]

    @cached_property
    def start(self) -> Entries:
        return to_entries(self.parameters)

    @cached_property
    def directions(self) -> Float[np.ndarray, "e p"]:
        return free_directions(self.free, self.parameters)[0]

    @property
    def pixels(self) -> int:
        return len(self.columns.index)

    def samples(self) -> Samples:
        return to_samples([self.columns])

    def problem(self) -> Problem:
        return Problem((self.columns,), on_device(self.samples()), self.parameters, self.model)

    @cached_property
    def residuals(self) -> Residuals:
        """For those who want them as one array."""
        return Residuals(self.samples(), self.model, self.start, self.directions, self.free)

    @property
    def best(self) -> Entries:
        """The float64 optimum over all pixels."""
        return self._optimum[0]

    @cached_property
    def told(self) -> "Case":
        """The case with what the optimum holds held there: at a bound, or not told by the pixels.

        So that solvers which know of neither look for the same place; how it is found out is the
        affair of airlight's own search.
        """
        names = {p.name for p in self._optimum[1]}
        return replace(
            self,
            parameters=tuple(
                replace(p, role="fixed", value=float(p.of(self.best)))
                if p.role == "free" and p.name not in names
                else p
                for p in self.parameters
            ),
        )

    @cached_property
    def _optimum(self) -> tuple[Entries, tuple[FitParameter, ...]]:
        """And what is free there."""
        with float64():
            end = search(self.problem(), self.start, self.free, "lm", MAX_STEPS)
            vector = end.vector
            # What ended at a bound or is not told stays where it is, for all.
            directions = free_directions(end.free, self.parameters)[0]
            for _ in range(_POLISHES):
                residual, slopes = self.residuals.at(vector, directions)
                scale = np.linalg.norm(slopes, axis=0)
                scale = np.where(scale > 0, scale, 1.0)
                step = np.linalg.lstsq(slopes / scale, residual, rcond=None)[0] / scale
                moved = vector - directions @ step
                if not np.isfinite(moved).all() or is_outside(moved, end.free):
                    break
                vector = moved
                if self.worst(vector, vector + directions @ step) < 1e-14:
                    break
        return vector, end.free

    def worst(self, vector: Entries, other: Entries) -> float:
        """The largest difference of a free parameter, in typical sizes."""
        found = [abs(float(p.of(vector)) - float(p.of(other))) / p.scale for p in self.free]
        return max(found, default=0.0)

    def judged(self, vector: Entries) -> dict[str, Any]:
        """Fields of a point that say how far off a vector is."""
        if not np.isfinite(vector).all():
            return {"status": "diverged", "note": "parameters are not finite"}
        found: dict[str, Any] = {"parameters": self.worst(vector, self.best)}
        if self.truth is not None:
            found["truth"] = self.worst(vector, self.truth)
        most, rms = codes_apart(self.residuals.light(vector), self._right)
        if not np.isfinite(rms):
            return {"status": "diverged", "note": "the picture is not finite"}
        return found | {"picture_max": most, "picture_rms": rms}

    @cached_property
    def _right(self) -> np.ndarray:
        return self.residuals.light(self.best)


def make_case(
    scene: str,
    name: str,
    photo: PhotoLike,
    layers: Layers,
    look: Look,
    *,
    truth: Look | None = None,
    sampling: Sampling = "area",
    where: Where = "all",
    free: tuple[str, ...] | None = None,
) -> Case:
    """A case of the unclipped pixels of a photo, as `fit` would choose and see them."""
    kind = type(look)
    used = choose_pixels(photo, layers, sampling, where).used
    columns = take_columns(photo, layers, used, float(layers.width_unit), kind)
    if columns.clipped is not None:
        measured = np.all(np.asarray(columns.clipped) == 0, axis=1)
        columns = replace(columns.part(np.asarray(measured)), clipped=None)
    parameters = within_scene(declare(look, [Response()], free=free), [columns])
    square = 1 / 12 if sampling == "area" else 0.0
    model = Model(Loss("linear"), None, Layout(kind), True, square)
    known = None if truth is None else to_entries(declare(truth, [Response()], free=free))
    return Case(scene, name, look, columns, tuple(parameters), model, known)


def narrowed(columns: Columns) -> Columns:
    """In float32."""
    return replace(
        columns,
        fields={name: field.astype(np.float32) for name, field in columns.fields.items()},
        light=columns.light.astype(np.float32),
        surface=None if columns.surface is None else columns.surface.astype(np.float32),
        color=columns.color.astype(np.float32),
    )
