"""What a fit returns: verdict, values with errors, what was left out, and how it looks as JSON.

A verdict is an integer code, so that it survives arrays; its sentence and its remedy live on the
host (`VERDICTS`).
"""

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from model_jax import Look


class Verdict(IntEnum):
    """How a fit ended."""

    CONVERGED = 0
    AT_BOUND = 1
    NOT_IDENTIFIABLE = 2
    NOT_CONVERGED = 3
    DIVERGED = 4
    NO_DATA = 5

    @property
    def label(self) -> str:
        """As in `FitResult.verdict` and `fit.json`: `converged`, `at_bound` …"""
        return self.name.lower()


VERDICTS: dict[Verdict, tuple[str, str]] = {
    Verdict.CONVERGED: ("The fit converged", ""),
    Verdict.AT_BOUND: (
        "The best fit lies at a bound",
        "check the alignment of photo and layers, the tone curve and the background",
    ),
    Verdict.NOT_IDENTIFIABLE: (
        "The photo cannot tell all that was asked",
        "hold what is named in left_out, or use a photo that shows it",
    ),
    Verdict.NOT_CONVERGED: (
        "The solver stopped before the best fit",
        "use solver 'lm' or allow more steps",
    ),
    Verdict.DIVERGED: (
        "The solver ran off to infinity",
        "use solver 'lm' and check the photo's values",
    ),
    Verdict.NO_DATA: (
        "There is nothing to fit",
        "check the mask, the alignment of photo and layers, and the exposure",
    ),
}
"""Sentence and remedy of each verdict, without full stops."""


WELL_EXPLAINED = 0.9
"""Below this share of the variance the message points at the residual picture: a tenth of the light
left over is visible to the eye in it."""


@dataclass(frozen=True)
class Estimate:
    """One number of a look after the fit."""

    value: float
    stderr: float | None
    """One standard deviation; None where the photo did not tell the value."""
    initial: float
    """What the start look had."""
    free: bool
    """It was fitted (or ended at a bound); False: held at its initial value."""
    unit: str
    bounds: tuple[float, float]
    quantisation_bound: float | None
    """Most that the photo's rounding to codes can shift the value (first order, worst case); None
    for float photos and for what was not fitted."""


@dataclass(frozen=True)
class LeftOut:
    """Something the fit did not use or tell, and the reason."""

    what: str
    why: str


@dataclass(frozen=True)
class FitResult:
    """A fitted look and what the photo says about it."""

    verdict: str
    """A `Verdict`'s label."""
    message: str
    """Verdict, how much of the light is explained, what to do; for people."""
    parameters: dict[str, Estimate]
    """By name: brightness, shadow, tint.r … (per channel where the look is), background."""
    correlation_names: tuple[str, ...]
    """The parameters that have a standard error: rows and columns of the two matrices."""
    correlation: Float[np.ndarray, "p p"]
    """Of rank one less than its size when the three tints are free: their mean is 1."""
    covariance: Float[np.ndarray, "p p"]
    """σ² (JᵀJ)⁻¹, σ² = square sum / (3 n - degrees of freedom). This takes the residuals of pixels
    and channels as independent and alike; where they are not (a model that does not fit, JPEG
    blocks) true errors are larger."""
    residual_rms: float
    """Over used pixels and channels, linear light; NaN without data."""
    explained: float | None
    """Share of the light's variance over the used pixels that the model explains; None when there
    is no variance."""
    used: Bool[np.ndarray, "h w"]
    """Which pixels were used."""
    excluded: dict[str, int]
    """Reason → pixels, each pixel once."""
    left_out: tuple[LeftOut, ...]
    look: Look
    """The fitted look, with one number or three as in the start look."""
    width_unit: float
    """Scene length that brightness refers to (far - near)."""
    seconds: dict[str, float] = field(default_factory=dict)
    """"reduce": reading pixels; "solve": descent and diagnosis."""

    @property
    def pixels(self) -> dict[str, Any]:
        """`{"used", "total", "excluded"}`; used and excluded add up to total."""
        return {
            "used": int(self.used.sum()),
            "total": int(self.used.size),
            "excluded": dict(self.excluded),
        }

    @property
    def brightness_per_length(self) -> float:
        """Brightness per scene length unit: what may be moved to a scene with other clip planes."""
        return self.parameters["brightness"].value / self.width_unit

    def to_dict(self) -> dict[str, Any]:
        """The fit's part of `fit.json` (issue 2), strict JSON: infinite and NaN become None."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "parameters": {
                name: {
                    "value": _number(e.value),
                    "stderr": _number(e.stderr),
                    "initial": _number(e.initial),
                    "free": e.free,
                    "unit": e.unit,
                    "bounds": [_number(limit) for limit in e.bounds],
                    "quantisation_bound": _number(e.quantisation_bound),
                }
                for name, e in self.parameters.items()
            },
            "brightness_per_length": _number(self.brightness_per_length),
            "correlation": {
                "names": list(self.correlation_names),
                "matrix": [[_number(c) for c in row] for row in self.correlation],
            },
            "residual_rms": _number(self.residual_rms),
            "explained": _number(self.explained),
            "pixels": self.pixels,
            "left_out": [{"what": item.what, "why": item.why} for item in self.left_out],
            "seconds": {name: _number(value) for name, value in self.seconds.items()},
        }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
