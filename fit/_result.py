"""What a fit returns: verdict, values with errors, what was left out, and how it looks as JSON.

Nothing here computes: what is made on demand (`influence`, `weights`) is the evidence's.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from model_jax import InputError, Look, Response
from model_jax._look import look_record
from model_jax._parameter import PER_UNIT

from ._numbers import measured, number
from ._of_photo import PhotoResult
from ._selection import Selection


@dataclass(frozen=True)
class Estimate:
    """One parameter after the fit."""

    value: float
    stderr: float | None
    """One standard deviation; None where the photo did not tell the value."""
    interval: tuple[float, float] | None
    """95 %: covers the truth in 19 of 20 photos of the same thing. Student's t with the degrees of
    freedom of the blocks behind the standard error, and nothing beyond a bound; None with
    `stderr`."""
    initial: float
    """What the start had."""
    role: str
    """"free", "at_bound" (fitted, ended there), "held" (the photo does not tell it), "fixed", or
    "tied"."""
    unit: str
    bounds: tuple[float, float]
    scale: float
    """Typical size, where the start does not tell it."""
    prior: tuple[float, float] | None
    """Mean and standard deviation known before the photo."""
    tied_to: str | None
    quantisation_bound: float | None
    """Most that the photo's rounding to codes can shift the value (first order, worst case); None
    for float photos and for what was not fitted."""
    layer_error: float | None
    """How far errors of the layers' meshes can shift the value (first order, all to one side); None
    where the layers are exact, and for what was not fitted."""
    compression_shift: float | None
    """What was added to the best fit's value for what JPEG did to the photo; None without JPEG, and
    for what was not fitted."""
    meaning: str

    @property
    def free(self) -> bool:
        """It was fitted, or ended at a bound."""
        return self.role in ("free", "at_bound")

    @property
    def one_sided(self) -> str:
        """In words what is told of a value within its own error of a bound: "at most 0.16"; else
        empty."""
        if self.stderr is None or self.interval is None:
            return ""
        if self.value - self.stderr <= self.bounds[0]:
            return f"at most {number(self.interval[1], 3)}"
        if self.value + self.stderr >= self.bounds[1]:
            return f"at least {number(self.interval[0], 3)}"
        return ""


@dataclass(frozen=True)
class LeftOut:
    """Something the fit did not use or tell, and the reason."""

    what: str
    why: str


@dataclass(frozen=True)
class Misfit:
    """Something other than noise that shows in the light left over."""

    photo: int
    cause: str
    """"tone", "air", "vignette", "stray", "edges" or "colour"."""
    rivals: tuple[str, ...]
    """Other causes that explain it as well, by the odds of noise."""
    share: float
    """Share of the variance left over that goes with it."""
    chance: float
    """That noise looks like it."""


@dataclass(frozen=True)
class Errors:
    """What the standard errors rest on."""

    noise: float
    """Standard deviation of a sample's residual, linear light."""
    correlation_px: float
    """Pixels over which residuals are correlated; 1 where neighbours are independent."""
    block_px: int
    """Side of the blocks within which any correlation is allowed for."""
    blocks: int
    effective_samples: float
    """Samples that tell as much if they were independent."""


class OnDemand(ABC):
    """What is computed from samples and end point when it is asked for (`diagnose._evidence`)."""

    @abstractmethod
    def influence(self, name: str) -> list[Float[np.ndarray, "_ _ 3"]]:
        """`FitResult.influence` for all photos."""

    @abstractmethod
    def weights(self) -> list[Float[np.ndarray, "_ _"]]:
        """`FitResult.weights` for all photos."""


@dataclass(frozen=True)
class FitResult:
    """A fitted look and what the photos say about it; printed, it is its report.

    A pickle holds all of it but the photos' samples: `influence` and `weights` need those.
    """

    verdict: str
    """A `Verdict`'s label."""
    message: str
    """Verdict, how much of the light is explained, what to do; for people."""
    warnings: tuple[str, ...]
    """What makes the numbers less certain than they look; part of the message."""
    parameters: dict[str, Estimate]
    """By name: the look's (NAME.r … where it is a colour), then exposure …"""
    correlation_names: tuple[str, ...]
    """The parameters that have a standard error: rows and columns of the two matrices."""
    correlation: Float[np.ndarray, "p p"]
    """Its rank is one less than its size when factors of mean one are free."""
    covariance: Float[np.ndarray, "p p"]
    """Block sandwich (`diagnose._spread`): residuals may be correlated and of any size. Of JPEGs
    the scatter of fits to pictures that were compressed alike (`diagnose._compression`)."""
    errors: Errors | None
    """What the covariance rests on; None without data."""
    look: Look
    """The fitted look, with one number or three as in the start look."""
    photos: tuple[PhotoResult, ...]
    left_out: tuple[LeftOut, ...]
    misfits: tuple[Misfit, ...]
    """What shows in the light left over, the plainest first."""
    loss: str
    solver: str
    history: tuple[float, ...]
    """Square sum after each step of the solver, start first; on its reduced samples if any."""
    second_opinion: str
    """What the end was held against: "closed form" where the least square sum is known and not
    lower; else how a second descent by another method ended: "same", "higher" or "lower"; "" where
    nothing was left to fit."""
    selection: Selection | None = None
    """How the look's terms were chosen, if they were (`look="auto"`). Intervals hold for a look
    that was named; what choosing adds is not in them."""
    seconds: dict[str, float] = field(default_factory=dict)
    """"choose": of the look's terms, if asked for; "reduce": reading pixels; "solve": descents and
    checks; "errors": covariance and bounds."""
    evidence: OnDemand | None = field(default=None, repr=False, compare=False)
    """Samples and end point, for what is computed on demand; None without data."""

    @property
    def used(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels of the first photo were used."""
        return self.photos[0].used

    @property
    def excluded(self) -> dict[str, int]:
        """Why pixels of the first photo were not used, and how many."""
        return self.photos[0].excluded

    @property
    def response(self) -> Response:
        """The first photo's."""
        return self.photos[0].response

    @property
    def width_unit(self) -> float:
        """Scene length that what is per width unit refers to: the first photo's far - near."""
        return self.photos[0].width_unit

    @property
    def pixels(self) -> dict[str, Any]:
        """Counts of all photos together, as `PhotoResult.pixels`."""
        parts = [photo.pixels for photo in self.photos]
        reasons = dict.fromkeys(reason for part in parts for reason in part["excluded"])
        return {
            "used": sum(part["used"] for part in parts),
            "total": sum(part["total"] for part in parts),
            "excluded": {r: sum(part["excluded"].get(r, 0) for part in parts) for r in reasons},
            "clipped_samples": sum(part["clipped_samples"] for part in parts),
        }

    @property
    def residual_rms(self) -> float:
        """Over all photos' measured samples, linear light; NaN without data."""
        counts = [p.measured for p in self.photos]
        squares = sum(n * p.residual_rms**2 for n, p in zip(counts, self.photos, strict=True) if n)
        return math.sqrt(squares / sum(counts)) if sum(counts) else math.nan

    @property
    def structure(self) -> float | None:
        """As `PhotoResult.structure`, of the photo where it is most."""
        found = [p.structure for p in self.photos if p.structure is not None]
        return max(found) if found else None

    @property
    def explained(self) -> float | None:
        """Share of the variance explained, of the photo where it is least; None without data."""
        shares = [p.explained for p in self.photos if p.explained is not None]
        return min(shares) if shares else None

    @property
    def per_length(self) -> dict[str, float]:
        """What is per width unit, per scene length unit instead: that may be moved to a scene with
        other clip planes."""
        return {
            name: e.value / self.width_unit
            for name, e in self.parameters.items()
            if e.unit == PER_UNIT
        }

    def __str__(self) -> str:
        return self.report()

    def __repr__(self) -> str:
        rows = self.parameters.items()
        told = [f"{name} {measured(e.value, e.stderr)}" for name, e in rows if e.stderr]
        return f"<FitResult {self.verdict}{': ' if told else ''}{', '.join(told)}>"

    def _repr_html_(self) -> str:
        """The report in a notebook."""
        from .report._terminal import fit_html

        return fit_html(self.to_dict())

    def __getstate__(self) -> dict[str, Any]:
        """What is pickled or copied: all but the photos' samples, which are as large as they."""
        return vars(self) | {"evidence": None}

    def influence(self, name: str, photo: int = 0) -> Float[np.ndarray, "h w 3"]:
        """Derivative of a fitted parameter by each recorded sample of a photo.

        By the implicit function theorem at the end point; 0 where a pixel was not used. In
        parameter units per unit of linear light.

        Raises:
            InputError: a parameter without a standard error, a photo that there is not, or a
                result that comes out of a pickle or is a copy.
        """
        evidence = self._evidence("influence")
        if name not in self.correlation_names:
            raise InputError(
                f"influence: {name!r} was not told by the fit; choose from "
                f"{list(self.correlation_names)}"
            )
        if not 0 <= photo < len(self.photos):
            raise InputError(f"influence: photo {photo} is not one of {len(self.photos)}")
        assert evidence is not None  # names were told
        return evidence.influence(name)[photo]

    def weights(self, photo: int = 0) -> Float[np.ndarray, "h w"]:
        """How much a robust loss believed each pixel, 0 to 1; NaN where none was used.

        Raises:
            InputError: the result comes out of a pickle or is a copy.
        """
        if (evidence := self._evidence("weights")) is None:
            return np.full(self.photos[photo].used.shape, np.nan, np.float32)
        return evidence.weights()[photo]

    def _evidence(self, what: str) -> OnDemand | None:
        """Raises `InputError` where something was told and its samples are gone."""
        if self.evidence is None and self.correlation_names:
            raise InputError(
                f"{what}: needs the samples of the photo, which no pickle and no copy of a result "
                "holds; fit again"
            )
        return self.evidence

    def report(self) -> str:
        """The fit as plain text, as the command line prints it."""
        from .report._terminal import fit_text

        return fit_text(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The fit's part of `fit.json`, strict JSON: infinite and NaN become None."""
        return {
            "verdict": self.verdict,
            "message": self.message,
            "warnings": list(self.warnings),
            "selection": None if self.selection is None else _selection_dict(self.selection),
            "parameters": {name: _estimate_dict(e) for name, e in self.parameters.items()},
            "look": look_record(self.look),
            "per_length": {name: _number(value) for name, value in self.per_length.items()},
            "width_unit": _number(self.width_unit),
            "correlation": {
                "names": list(self.correlation_names),
                "matrix": [[_number(c) for c in row] for row in self.correlation],
            },
            "errors": None
            if self.errors is None
            else {
                name: value if isinstance(value, int) else _number(value)
                for name, value in vars(self.errors).items()
            },
            "residual_rms": _number(self.residual_rms),
            "explained": _number(self.explained),
            "structure": _number(self.structure),
            "pixels": self.pixels,
            "photos": [
                {"pixels": p.pixels}
                | {n: _number(getattr(p, n)) for n in _OF_PHOTO}
                | {"alignment": None if p.alignment is None else p.alignment.to_dict()}
                for p in self.photos
            ],
            "left_out": [vars(item) for item in self.left_out],
            "misfits": [
                {"photo": m.photo + 1, "cause": m.cause, "rivals": list(m.rivals)}
                | {"share": _number(m.share)}
                for m in self.misfits
            ],
            "solver": self.solver,
            "loss": self.loss,
            "history": [_number(value) for value in self.history],
            "second_opinion": self.second_opinion,
            "seconds": {name: _number(value) for name, value in self.seconds.items()},
        }


_OF_PHOTO = ("residual_rms", "explained", "structure", "width_unit")


def _estimate_dict(e: Estimate) -> dict[str, Any]:
    return {
        "value": _number(e.value),
        "stderr": _number(e.stderr),
        "interval": None if e.interval is None else [_number(limit) for limit in e.interval],
        "initial": _number(e.initial),
        "free": e.free,
        "role": e.role,
        "unit": e.unit,
        "bounds": [_number(limit) for limit in e.bounds],
        "scale": _number(e.scale),
        "prior": None if e.prior is None else [_number(number) for number in e.prior],
        "tied_to": e.tied_to,
        "quantisation_bound": _number(e.quantisation_bound),
        "layer_error": _number(e.layer_error),
        "compression_shift": _number(e.compression_shift),
        "meaning": e.meaning,
    }


def _selection_dict(selection: Selection) -> dict[str, Any]:
    return {
        "terms": [
            vars(term) | {"parameters": list(term.parameters), "delta_bic": _number(term.delta_bic)}
            for term in selection.terms
        ],
        "samples": selection.samples,
        "effective_samples": _number(selection.effective_samples),
    }


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
