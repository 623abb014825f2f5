"""Tone curves: linear light ↔ the value a picture file stores.

A curve is a small record with `encode` (linear → stored, both nominally in [0, 1]) and `decode`
(stored → linear), on NumPy or JAX arrays. `encode` has finite gradients everywhere, black
included. `parse_tone_curve` reads the form scene files use.
"""

from abc import abstractmethod

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ._errors import InputError, shown
from ._kinds import as_array, need_array
from ._safe import safe_power
from ._shapes import AnyArray, Scalar, namespace


class ToneCurve(eqx.Module):
    """What maps linear light to stored values and back."""

    def encode(self, linear: AnyArray) -> AnyArray:
        """Stored value for linear light. Raises `InputError` for what is no number."""
        return self._encode(as_array("linear", linear))

    def decode(self, stored: AnyArray) -> AnyArray:
        """Linear light for a stored value. Raises `InputError` for what is no number."""
        return self._decode(as_array("stored", stored))

    @abstractmethod
    def _encode(self, linear: AnyArray) -> AnyArray: ...

    @abstractmethod
    def _decode(self, stored: AnyArray) -> AnyArray: ...

    @abstractmethod
    def describe(self) -> str | dict[str, float]:
        """The form that `parse_tone_curve` reads."""


class Linear(ToneCurve):
    """Stored values are linear light."""

    def _encode(self, linear: AnyArray) -> AnyArray:
        return linear

    def _decode(self, stored: AnyArray) -> AnyArray:
        return stored

    def describe(self) -> str:
        return "linear"


class Srgb(ToneCurve):
    """The sRGB transfer function of IEC 61966-2-1, odd-symmetric below black."""

    def _encode(self, linear: AnyArray) -> AnyArray:
        xp = namespace(linear)
        size = xp.abs(linear)
        curved = 1.055 * safe_power(size, 1 / 2.4) - 0.055
        return xp.where(size <= 0.0031308, 12.92 * linear, xp.sign(linear) * curved)

    def _decode(self, stored: AnyArray) -> AnyArray:
        xp = namespace(stored)
        size = xp.abs(stored)
        curved = safe_power((size + 0.055) / 1.055, 2.4)
        return xp.where(size <= 0.04045, stored / 12.92, xp.sign(stored) * curved)

    def describe(self) -> str:
        return "srgb"


class Exposure(ToneCurve):
    """`stored = (1 - exp(-exposure · linear)) ** (1 / gamma)`, both parameters > 0.

    The film-like curve of two of the source documents. `decode` of 1 is infinite: nothing finite
    is that bright, and the photo reader has excluded it as saturated.
    """

    exposure: Scalar
    gamma: Scalar = 1.0

    def __check_init__(self) -> None:
        _check_positive("exposure", self.exposure)
        _check_positive("gamma", self.gamma)

    def _encode(self, linear: AnyArray) -> AnyArray:
        xp = namespace(linear, self.exposure)
        return safe_power(-xp.expm1(-self.exposure * linear), 1 / self.gamma)

    def _decode(self, stored: AnyArray) -> AnyArray:
        xp = namespace(stored, self.exposure)
        covered = safe_power(stored, self.gamma)
        below = covered < 1
        finite = -xp.log1p(-xp.where(below, covered, 0)) / self.exposure
        return xp.where(below, finite, xp.inf)

    def describe(self) -> dict[str, float]:
        return {"exposure": float(self.exposure), "gamma": float(self.gamma)}


class Power(ToneCurve):
    """`stored = linear ** (1 / gamma)`, gamma > 0, odd-symmetric below black."""

    gamma: Scalar

    def __check_init__(self) -> None:
        _check_positive("gamma", self.gamma)

    def _encode(self, linear: AnyArray) -> AnyArray:
        xp = namespace(linear, self.gamma)
        return xp.sign(linear) * safe_power(xp.abs(linear), 1 / self.gamma)

    def _decode(self, stored: AnyArray) -> AnyArray:
        xp = namespace(stored, self.gamma)
        return xp.sign(stored) * safe_power(xp.abs(stored), self.gamma)

    def describe(self) -> dict[str, float]:
        return {"gamma": float(self.gamma)}


class Sampled(ToneCurve):
    """A curve by the light of equally spaced stored values from 0 to 1, straight between them."""

    name: str = eqx.field(static=True)
    """What `describe` gives: such a curve cannot be written in a scene file."""
    light: Float[np.ndarray, " n"]

    def __check_init__(self) -> None:
        if not isinstance(self.name, str):
            raise InputError(f"tone curve: its name is {shown(self.name)}; give text")
        need_array(f"tone curve {self.name}", self.light, "[n]")
        if np.ndim(self.light) != 1 or len(self.light) < 2 or not np.all(np.isfinite(self.light)):
            raise InputError(f"tone curve {self.name}: give two finite numbers or more")
        if np.any(np.diff(self.light) < 0) or self.light[0] == self.light[-1]:
            raise InputError(f"tone curve {self.name}: its light must grow with what is stored")

    def _encode(self, linear: AnyArray) -> AnyArray:
        return namespace(linear).interp(linear, self.light, np.linspace(0, 1, len(self.light)))

    def _decode(self, stored: AnyArray) -> AnyArray:
        return namespace(stored).interp(stored, np.linspace(0, 1, len(self.light)), self.light)

    def describe(self) -> str:
        return self.name


def parse_tone_curve(value: object) -> ToneCurve:
    """A curve from "linear", "srgb" or a table: `{gamma = 2.2}` is a `Power`, and
    `{exposure = 1.5, gamma = 2.2}` an `Exposure`.

    Raises `InputError` naming the value for anything else.
    """
    if isinstance(value, ToneCurve):
        return value
    if value == "linear":
        return Linear()
    if value == "srgb":
        return Srgb()
    if isinstance(value, dict) and value and set(value) <= {"exposure", "gamma"}:
        numbers = {name: _positive(name, number) for name, number in value.items()}
        return Exposure(**numbers) if "exposure" in numbers else Power(**numbers)
    raise InputError(
        f"tone_curve: {shown(value)} is none of the known curves; "
        'use "linear", "srgb", { gamma = 2.2 } or { exposure = 1.0, gamma = 2.2 }'
    )


def _check_positive(name: str, value: object) -> None:
    """Raise `InputError` for what is no number above 0; JAX's are taken as they are."""
    if not isinstance(value, jax.Array):
        _positive(name, value.item() if isinstance(value, np.generic | np.ndarray) else value)


def _positive(name: str, number: object) -> float:
    if isinstance(number, bool) or not isinstance(number, int | float) or not 0 < number < 1e30:
        raise InputError(f"tone_curve.{name}: {shown(number)} must be a finite number above 0")
    return float(number)
