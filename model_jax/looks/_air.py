"""The look `air`: air that may thin out with height, end lower than the shell, and dim itself.

Its terms are named with it, `air+density+saturation` (`_terms`).
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp

from .._column import Span, below, columns, mean_transmittance, place_at
from .._errors import InputError
from .._fields import OF_SUN, PLACES, Fields
from .._look import Look, Separable, parameter
from .._parameter import LENGTH, PER_UNIT, Shape
from .._phase import henyey_greenstein, rayleigh
from .._shapes import Scalar, Three
from .._sun_column import ON_GROUND, sun_column_at
from .._sunlight import sunlight_met
from ._terms import TermedLook, class_named, terms_of


def _scale_height(shape: Shape) -> Any:
    return parameter(
        "height in which the air thins out to 1/e",
        unit=LENGTH,
        lower=0.0,
        default=8.0 if shape == "number" else (8.0, 8.0, 8.0),
        scale=8.0,
        shape=shape,
        source="Earth's in km: U.S. Standard Atmosphere, 1976, 8.4 km at sea level",
    )


def _shadow(of: str) -> Any:
    return parameter(
        "light of shadowed air as a share of lit air",
        lower=0.0,
        upper=1.0,
        default=0.2,
        of=of,
        shape="either",
        source="the paper's pixel shader",
    )


def _parameters(term: str) -> dict[str, tuple[Any, Any]]:
    """Annotation and field of each parameter that a term brings."""
    if term == "density":
        return {"scale_height": (Scalar, _scale_height("number"))}
    if term == "density-rgb":
        return {"scale_height": (Three, _scale_height("rgb"))}
    if term == "top":
        about = parameter(
            "height at which the air ends, if below the shell's",
            unit=LENGTH,
            lower=0.0,
            default=100.0,
            scale=100.0,
        )
        return {"top": (Scalar, about)}
    if term == "phase":
        aerosol = parameter(
            "share of the scattered light that haze scatters, not molecules",
            lower=0.0,
            upper=1.0,
            default=0.2,
            of="sun_cos",
        )
        asymmetry = parameter(
            "mean cosine of the angle by which haze turns light",
            lower=-0.95,
            upper=0.95,
            default=0.76,
            of="sun_cos",
            source="Bruneton & Neyret, Precomputed Atmospheric Scattering, 2008",
        )
        return {"aerosol": (Scalar, aerosol), "asymmetry": (Scalar, asymmetry)}
    if term == "ground":
        about = parameter(
            "factor on the light of the ground: its albedo where the scene gives 1",
            lower=0.0,
            default=(1.0, 1.0, 1.0),
            shape="rgb",
            of="planet",
        )
        return {"ground": (Three, about)}
    if term == "upwelling":
        about = parameter(
            "light that comes from below under the sun in the zenith, as a share of sunlight",
            lower=0.0,
            upper=10.0,
            default=0.2,
            shape="either",
            of="sunward",
        )
        return {"upwelling": (Scalar | Three, about)}
    about = parameter(
        "optical depth of a width unit of air, each channel",
        unit=PER_UNIT,
        lower=0.0,
        default=(1.0, 1.0, 1.0),
        shape="rgb",
    )
    return {"extinction": (Three, about)}


class AirLook(TermedLook):
    """Air as on a planet: `brightness · color · tint · (lit + shadow · dark)`, and its terms."""

    brightness: Scalar = parameter(
        "light per width unit of lit air (at the ground, if it thins out), times colour",
        unit=PER_UNIT,
        lower=0.0,
        default=3.0,
        source="the paper's pixel shader",
    )
    shadow: Scalar | Three = _shadow("dark")
    tint: Three = parameter(
        "factor on the air's colour, mean 1 over the channels",
        lower=0.0,
        upper=3.0,
        default=(1.0, 1.0, 1.0),
        shape="rgb",
        mean_one=True,
    )

    NAME = "air"
    NEEDS = ("lit", "dark")
    LINEAR_IN: ClassVar[tuple[str, ...]] = ("lit", "dark")
    ROUNDINGS = (5.0, 0.0)
    SEPARABLE: ClassVar[Separable | None] = Separable("brightness", "tint", "shadow", "lit", "dark")
    AMPLITUDE = ("brightness", "tint")

    TERMS: ClassVar[dict[str, str]] = {
        "density": "air thins out exponentially with height",
        "density-rgb": "the same, each channel with its own scale height",
        "top": "air ends below the shell's height",
        "saturation": "air dims its own light and what lies behind it",
        "sun": "sunlight is dimmed on its way to air and ground, more the lower the sun",
        "upwelling": "ground and clouds below throw light up into the air where the sun is up",
        "phase": "light is scattered more into some directions than into others",
        "ground": "ground behind the air is brighter or darker than the scene says",
    }
    TERM_NEEDS: ClassVar[dict[str, tuple[str, ...]]] = {
        "sun": ("density",),
        "upwelling": ("density", "sun"),
    }

    TERM_OFF: ClassVar[dict[str, dict[str, float]]] = {
        "top": {"top": 1e30},
        "saturation": {"extinction": 0.0},
        "upwelling": {"upwelling": 0.0},
        "phase": {"aerosol": 1.0, "asymmetry": 0.0},  # haze that scatters alike in all directions
        "ground": {"ground": 1.0},
    }
    # Not density-rgb: a second form of density, which takes three times as long.
    CHOICES = ("density", "saturation", "top", "phase", "ground", "sun", "upwelling")

    @classmethod
    def parameters_of(cls, term: str) -> dict[str, tuple[Any, Any]]:
        return _parameters(term)

    @classmethod
    def check_terms(cls, terms: Sequence[str]) -> None:
        if {"density", "density-rgb"} <= set(terms):
            raise InputError(f"look {cls.NAME}: density and density-rgb are one term; name one")
        super().check_terms(["density" if name == "density-rgb" else name for name in terms])

    @classmethod
    def facts_of(cls, terms: Sequence[str]) -> dict[str, Any]:
        places = any(term not in ("saturation", "phase", "ground") for term in terms)
        needs = PLACES if places else AirLook.NEEDS
        if "sun" in terms:
            needs = (*needs, *OF_SUN, "shell")
        elif "phase" in terms:
            needs = (*needs, "sun_cos")
        if "ground" in terms:
            needs = (*needs, "planet")
        # Of a depth τ on the sun's way exp(-τ) is off by τ times what the column is, some 40 ulp on
        # both sides; at τ = 30 next to nothing is left to compare.
        roundings = (1200.0, 28.0) if "sun" in terms else (80.0, 28.0) if places else (16.0, 8.0)
        return {
            "NEEDS": needs,
            "GROUND": "ground" if "ground" in terms else "",
            "LINEAR_IN": (),
            "SEPARABLE": None,
            "ROUNDINGS": roundings,
            "fields": {"shadow": (Scalar | Three, _shadow("dark_end"))} if places else {},
        }

    def air(self, fields: Fields) -> tuple[Any, Any]:
        terms = terms_of(self)
        if "sun" in terms:
            whole, lit, dark, upward = self._sunlit(fields, terms)
        else:
            lit, dark = self._widths(fields, terms)
            whole, upward = lit + dark, 0.0
        if "phase" in terms:
            haze = henyey_greenstein(fields.sun_cos, self.asymmetry)
            lit = lit * ((1 - self.aerosol) * rayleigh(fields.sun_cos) + self.aerosol * haze)
        sent = lit + self.shadow * dark
        if "upwelling" in terms:
            sent = sent + self.upwelling * upward
        light = self.brightness * (fields.color * self.tint * sent)
        passed = self._reaching(fields, terms) if "sun" in terms else None
        if "saturation" in terms:
            depth = self.extinction * jnp.maximum(whole, 0)
            light = light * mean_transmittance(depth)
            passed = jnp.exp(-depth) if passed is None else passed * jnp.exp(-depth)
        return light, passed

    def _widths(self, fields: Fields, terms: list[str]) -> tuple[Any, Any]:
        """Lit and dark width, weighted by the density where it is not 1."""
        thins = any(name.startswith("density") for name in terms)
        if not thins and "top" not in terms:
            return fields.lit, fields.dark
        (begin, end), dark = self._places(fields)
        if "top" in terms:
            (begin, end), dark = below(self.top, (begin, end), dark, fields.altitude, fields.impact)
        lit: Any
        shaded: Any
        if thins:
            given = (begin, end), dark, fields.altitude, fields.impact, self.scale_height
            lit, shaded = columns(*given)
        else:
            shaded = 0.0 if dark is None else dark[1] - dark[0]
            lit = end - begin if dark is None else (end - dark[1]) + (dark[0] - begin)
        return lit * fields.per_length, shaded * fields.per_length

    def _sunlit(self, fields: Fields, terms: list[str]) -> tuple[Any, Any, Any, Any]:
        """Width, weighted by the density; and what of it sunlight reaches, what is dark, and what
        ground below lights, each weighted by how much of its light gets out, too."""
        air, dark = self._places(fields)
        met = sunlight_met(
            air,
            dark,
            fields.altitude,
            fields.impact,
            self.scale_height,
            fields.sunward,
            fields.sun_cos,
            fields.shell,
            self.extinction * fields.per_length,
            dims="saturation" in terms,
            upward="upwelling" in terms,
            top=self.top if "top" in terms else None,
        )
        whole = met.column * fields.per_length
        return whole, whole * met.sunlit, whole * met.shaded, whole * met.upward

    def _reaching(self, fields: Fields, terms: list[str]) -> Any:
        """Share of the sun's light that reaches the ground; of rays that leave the air 1, for what
        lies behind them has a light of its own."""
        height, distance = place_at(fields.end, fields.altitude, fields.impact)
        sunward = fields.sunward + fields.end * fields.sun_cos
        column = sun_column_at(
            jnp.clip(sunward, -distance, distance),
            distance,
            height,
            jnp.minimum(self.top, fields.shell) if "top" in terms else fields.shell,
            self.scale_height,
        )
        passed = jnp.exp(-self.extinction * fields.per_length * column)
        return jnp.where((fields.end < 0) | (height < ON_GROUND * fields.shell), passed, 1)

    def _places(self, fields: Fields) -> tuple[Span, Span | None]:
        """Where on the ray the shell's air begins and ends, and the shadow in it, if there is
        one."""
        none = isinstance(fields.dark_end, float)
        dark = None if none else (fields.dark_begin, fields.dark_end)
        return (fields.begin, fields.end), dark


def __getattr__(name: str) -> type[Look]:
    """The class of a set of terms by its name, as unpickling asks for it."""
    return class_named(AirLook, name)
