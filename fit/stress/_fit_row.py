"""What is promised of every fit, whatever photo it gets; and whether it was kept."""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np

from model_jax import AirlightError, Layers, composite

from .._compile import float64
from .._result import Estimate, FitResult

MOST_INTERVALS = 5.0
"""Half-lengths of its 95 % interval that a value of a converged fit may be off by: of normal errors
this is 9.8 standard errors, of Student's t with four degrees of freedom 13.9."""

WITHOUT_NUMBERS = ("not_converged", "diverged", "no_data", "misfit")
"""Verdicts that say by themselves that numbers may be missing."""

REFUSED = "refused"


@dataclass(frozen=True)
class FitRow:
    """A row of stress_fits.csv."""

    case: str
    """In words."""
    look: str
    """Its name."""
    pixels: int
    """Used."""
    verdict: str
    """The fit's label, "refused" where it raised an `AirlightError`, "error" for any other."""
    worst: str
    """Whose error is most beside its interval; empty where nothing has one."""
    intervals: float | None
    """Its error in half-lengths of its 95 % interval, on the side where the truth is."""
    error: float | None
    """Largest distance from the truth in typical sizes, of what has an interval."""
    float32: float | None
    """The same of a traced fit in float32, from the fit's own values; None where it has none."""
    untold: str
    """What has no interval, and by what that is said: "opacity (held)"."""
    kept: bool
    """The promise."""
    note: str
    """How it was broken; why there is no float32."""

    def noted(self, text: str) -> "FitRow":
        """With one more remark."""
        return replace(self, note="; ".join(part for part in (self.note, text) if part))


def judge_fit(
    case: str,
    look_name: str,
    result: FitResult,
    truth: Mapping[str, float],
    *,
    asked: Collection[str] | None = None,
    layers: Layers | None = None,
) -> FitRow:
    """Whether a fit keeps what is promised.

    A fit that calls itself converged is off by at most `MOST_INTERVALS`; what was asked for and
    has no interval is named; the result is strict JSON; values and picture are finite.

    Args:
        truth: what the photo was made with, by the names of the result.
        asked: names that were to be fitted; None: all that are not fixed.
        layers: of the photo, to draw the fitted look; None: it is not drawn.
    """
    parameters = result.parameters
    told = {n: e for n, e in parameters.items() if e.interval is not None and n in truth}
    off = {name: intervals_off(e, truth[name]) for name, e in told.items()}
    worst = max(off, key=off.__getitem__, default="")
    errors = [abs(e.value - truth[name]) / e.scale for name, e in told.items()]
    if asked is None:
        asked = [name for name, e in parameters.items() if e.role != "fixed"]
    named = {n: _named(n, parameters[n], result) for n in asked if parameters[n].interval is None}
    broken = []
    if result.verdict == "converged" and off and not off[worst] <= MOST_INTERVALS:
        value, right = told[worst].value, truth[worst]
        broken.append(f"{worst} is {value:.6g} where {right:.6g} is true")
    broken += [f"{name} has no interval and is not named" for name, why in named.items() if not why]
    broken += _not_finite(result, layers)
    return FitRow(
        case=case,
        look=look_name,
        pixels=int(result.pixels["used"]),
        verdict=result.verdict,
        worst=worst,
        intervals=off[worst] if off else None,
        error=max(errors) if errors else None,
        float32=None,
        untold=", ".join(f"{name} ({why or 'not named'})" for name, why in named.items()),
        kept=not broken,
        note="; ".join(broken),
    )


def without_result(case: str, look_name: str, error: Exception) -> FitRow:
    """The row of a fit that raised: a refusal keeps the promise, any other error breaks it."""
    refused = isinstance(error, AirlightError)
    text = str(error) if refused else f"{type(error).__name__}: {error}"
    return FitRow(
        case=case,
        look=look_name,
        pixels=0,
        verdict=REFUSED if refused else "error",
        worst="",
        intervals=None,
        error=None,
        float32=None,
        untold="",
        kept=refused,
        note=" ".join(text.split()),
    )


def intervals_off(estimate: Estimate, truth: float) -> float:
    """Distance from the truth in half-lengths of the interval, on the truth's side."""
    assert estimate.interval is not None
    distance = abs(estimate.value - truth)
    half = abs(estimate.interval[truth > estimate.value] - estimate.value)
    if half > 0:
        return float(distance / half)
    return 0.0 if distance == 0 else inf


def _named(name: str, estimate: Estimate, result: FitResult) -> str:
    """By what it is said that a parameter was not told; empty where nothing says so."""
    if estimate.role in ("held", "at_bound"):
        return estimate.role
    family = name.split(".")[0]
    if any(item.what in (name, family) for item in result.left_out):
        return "left out"
    if estimate.role == "tied" and estimate.tied_to is not None:
        return f"tied to {estimate.tied_to}"
    return result.verdict if result.verdict in WITHOUT_NUMBERS else ""


def _not_finite(result: FitResult, layers: Layers | None) -> list[str]:
    """In words, where a result holds what is no number."""
    broken = [
        f"{name} is {estimate.value}"
        for name, estimate in result.parameters.items()
        if not isfinite(estimate.value)
    ]
    try:
        json.dumps(result.to_dict(), allow_nan=False)
    except (TypeError, ValueError) as error:
        broken.append(f"no strict JSON: {error}")
    if layers is not None:
        with float64():
            light = np.asarray(composite(layers, result.look))
        if not np.isfinite(light).all():
            broken.append("the picture of the fitted look is not finite")
    return broken
