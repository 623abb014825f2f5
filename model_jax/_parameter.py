"""What there is to know of each number that a fit can tell: meaning, unit, range, default.

Reports, exports and command lines read these tables without JAX, which takes seconds to import.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """What there is to know of a look parameter besides its value."""

    meaning: str
    unit: str
    lower: float
    upper: float
    default: float
    scale: float = 1.0
    """Typical size, where a start of zero says nothing about it."""


PARAMETERS: dict[str, Parameter] = {
    "brightness": Parameter(
        "light per width unit of lit air, times colour", "1/width_unit", 0.0, math.inf, 3.0
    ),
    "shadow": Parameter("light of shadowed air as a share of lit air", "1", 0.0, math.inf, 0.2),
    "tint": Parameter("factor on the air's colour, mean 1 over the channels", "1", 0.0, 3.0, 1.0),
    "background": Parameter(
        "light added to every pixel", "linear light", -math.inf, math.inf, 0.0, scale=0.01
    ),
}
"""Every parameter of `Look` by its field name, in the order reports show them."""

RESPONSE_PARAMETERS: dict[str, Parameter] = {
    "exposure": Parameter("factor on all light that reaches the camera", "1", 0.0, math.inf, 1.0),
    "gamma": Parameter("exponent left after the photo's tone curve", "1", 0.1, 10.0, 1.0),
    "black_level": Parameter(
        "recorded value without light", "recorded light", -math.inf, math.inf, 0.0, scale=0.01
    ),
}
"""Every parameter of `Response` by its field name."""
