"""What a search works on: samples, parameters and model, and few pseudo-pixels for them."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._compile import float64
from ..photo._pixels import Columns
from ._descend import exact_gram
from ._model import Model
from ._parameters import Entries, Parameter
from ._reduce import THIN, bins, moments, thinned
from ._samples import Samples


@dataclass(frozen=True)
class Problem:
    """Samples and what may be done with them."""

    columns: tuple[Columns, ...]
    samples: Samples
    """All of `columns`, on the device."""
    few: Samples
    """What stands for all until the exact steps: as few pseudo-pixels as serve."""
    parameters: tuple[Parameter, ...]
    model: Model
    count: int
    """Measured samples, three to a pixel; without clipped ones and copies."""
    light_max: float
    """Largest |light|."""

    @property
    def plain(self) -> bool:
        """Least squares of measured samples."""
        return self.model.loss.name == "linear" and self.samples.clipped is None

    @property
    def rounding(self) -> float:
        """Square sum that float64 makes of nothing: an eps of the brightest for each sample."""
        return self.count * (np.finfo(np.float64).eps * self.light_max) ** 2

    def with_model(self, model: Model) -> "Problem":
        """The same samples, another loss."""
        return replace(self, model=model, few=_few(self.columns, self.samples, model))

    def rough(self) -> "Problem":
        """The few in place of all: for answers that are asked again."""
        return replace(self, samples=self.few)

    def gram(self, vector: Entries, along: Float[np.ndarray, "e p"]) -> Float[np.ndarray, "q q"]:
        """The exact pass over all samples."""
        with float64():
            return np.asarray(
                exact_gram(jnp.asarray(vector), jnp.asarray(along), self.samples, self.model)
            )

    def square_sum(self, vector: Entries) -> float:
        """Cost of a vector over all samples."""
        return float(self.gram(vector, np.zeros((len(vector), 0)))[-1, -1])


def state(
    columns: tuple[Columns, ...],
    samples: Samples,
    parameters: tuple[Parameter, ...],
    model: Model,
) -> Problem:
    """The problem of some columns, which `samples` holds on the device."""
    clipped = sum(int((c.clipped != 0).sum()) for c in columns if c.clipped is not None)
    measured = sum((3 - len(c.copies)) * len(c.lit) for c in columns)
    return Problem(
        columns=columns,
        samples=samples,
        few=_few(columns, samples, model),
        parameters=parameters,
        model=model,
        count=measured - clipped,
        light_max=max(_largest(c.light) for c in columns),
    )


def _largest(values: np.ndarray) -> float:
    """Largest absolute value; 0 of none."""
    return max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))


def _few(columns: tuple[Columns, ...], samples: Samples, model: Model) -> Samples:
    with float64():
        if model.loss.name == "linear" and samples.clipped is None and model.linear:
            return moments(samples)
        if model.loss.name == "linear" and samples.surface is None:
            if samples.clipped is None:
                columns = tuple(replace(c, clipped=None) for c in columns)
            return bins(columns)
        if sum(len(c.lit) for c in columns) > 2 * THIN:
            return thinned(columns)
        return samples
