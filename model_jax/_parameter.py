"""What there is to know of a number that a fit can tell: meaning, unit, range, default.

Reports, exports and command lines read these records without JAX, which takes seconds to import.
"""

import math
from dataclasses import dataclass
from typing import Literal

Shape = Literal["number", "rgb", "either"] | int
"""One number; three; one or three, as given; or a table of so many."""


PER_UNIT = "1/width_unit"
"""Unit of what is per unit of width: in another scene it is another number."""

LENGTH = "length"
"""Unit of what is in the scene's own."""


@dataclass(frozen=True)
class Smooth:
    """What is known of a table before any photo: numbers of neighbours differ by little."""

    neighbours: tuple[tuple[int, int], ...]
    """Pairs of places in the table. One place past its end stands for the number 1, where a table
    is of shares of what is not in it."""
    sigma: float
    """Standard deviation of their differences."""

    @classmethod
    def grid(cls, rows: int, columns: int, sigma: float) -> "Smooth":
        """Of a table of rows × columns, row by row: all that are side by side, or above each
        other."""
        places = [(r, c) for r in range(rows) for c in range(columns)]
        beside = [(r * columns + c, r * columns + c + 1) for r, c in places if c + 1 < columns]
        above = [(r * columns + c, (r + 1) * columns + c) for r, c in places if r + 1 < rows]
        return cls((*beside, *above), sigma)


@dataclass(frozen=True)
class Parameter:
    """What there is to know of a parameter besides its value."""

    meaning: str
    unit: str
    """As in reports; `PER_UNIT` of what hangs on the clip planes, which widths refer to."""
    lower: float
    upper: float
    """Closed range of allowed values; infinite where there is no bound."""
    default: float | tuple[float, ...]
    scale: float = 1.0
    """Typical size, where a start of zero says nothing about it."""
    shape: Shape = "number"
    mean_one: bool = False
    """Three factors on another parameter: a fit keeps their mean at 1, so that the two are told
    apart."""
    of: str | None = None
    """The field of `model_jax.FIELDS` without which it has no effect."""
    source: str = ""
    """Where the default comes from: a document, a table, a measurement."""
    least: float = -math.inf
    """A fit goes no lower, unless it starts there or its bounds ask for it: of what may be below in
    a picture somebody makes, and means something else where a photo seems to want it."""
    smooth: Smooth | None = None
    """A prior that a fit has of a table, unless it is given another, or traced by JAX."""

    @property
    def size(self) -> int:
        """Numbers that it is made of, at most."""
        return self.shape if isinstance(self.shape, int) else 1 if self.shape == "number" else 3

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes that a value may have."""
        if isinstance(self.shape, int):
            return [(self.shape,)]
        known: dict[str, list[tuple[int, ...]]]
        known = {"number": [()], "rgb": [(3,)], "either": [(), (3,)]}
        return known[self.shape]


RESPONSE_PARAMETERS: dict[str, Parameter] = {
    "exposure": Parameter("factor on all light that reaches the camera", "1", 0.0, math.inf, 1.0),
    "gamma": Parameter("exponent left after the photo's tone curve", "1", 0.1, 10.0, 1.0),
    "black_level": Parameter(
        "recorded value without light",
        "recorded light",
        -math.inf,
        math.inf,
        0.0,
        scale=0.01,
        least=0.0,
    ),
    "blur": Parameter(
        "standard deviation of the Gaussian that light is spread by",
        "px",
        0.0,
        3.0,
        1.0,
        source="a lens that is as sharp as its pixels",
    ),
}
"""Every parameter of `Response` by its field name."""
