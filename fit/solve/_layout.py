"""Where a look's numbers stand in the vector of a fit."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from model_jax import RESPONSE_PARAMETERS, Look, Parameter
from model_jax._composite import dims


@dataclass(frozen=True)
class Layout:
    """The entries of a kind of look, in the order of its parameters; responses come after them.

    A colour, and what may be one number or a colour, has three entries; a table one for each row.
    """

    kind: type[Look]
    blurs: bool = False
    """Each photo has a blur; else none has, and there is no entry of one."""

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Entries of each parameter."""
        ends = np.cumsum([0, *(p.size for p in self.kind.PARAMETERS.values())])
        starts = zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
        return dict(zip(self.kind.PARAMETERS, (slice(a, b) for a, b in starts), strict=True))

    @cached_property
    def size(self) -> int:
        """Entries of the look."""
        return max(part.stop for part in self.slices.values())

    @cached_property
    def response(self) -> dict[str, Parameter]:
        """Parameters of each photo's response, in the order of their entries."""
        known = RESPONSE_PARAMETERS.items()
        return {name: about for name, about in known if name != "blur" or self.blurs}

    @property
    def families(self) -> dict[str, Parameter]:
        """Every parameter of look and response."""
        return self.kind.PARAMETERS | self.response

    @cached_property
    def is_linear(self) -> bool:
        """The light is a sum of the fields, each times something."""
        return set(self.kind.NEEDS) == set(self.kind.LINEAR_IN) and not self.dims

    @property
    def dims(self) -> bool:
        """What lies behind the air is dimmed by it."""
        return dims(self.kind)

    def values(self, vector: Any) -> dict[str, Any]:
        """The look's parameters in a vector, NumPy's or JAX's: numbers, colours and tables."""
        return {
            name: vector[part] if part.stop - part.start > 1 else vector[part.start]
            for name, part in self.slices.items()
        }

    def look(self, vector: Any) -> Look:
        """The look of a vector, colours wherever there may be one."""
        return self.kind(**self.values(vector))

    def responses(self, vector: Any) -> Any:
        """Rows of the photos' exposures, gammas, black levels and, if there are any, blurs."""
        return vector[self.size :].reshape(-1, len(self.response))
