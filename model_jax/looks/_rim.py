"""The look `rim`: the atmosphere as a coat of one colour, denser towards the planet's edge.

Document 003, "the method of visualising the planet atmosphere". Its curve of general illumination
and its gradient are pictures that are lost: `illumination` is a smooth monotone curve of ours, the
gradient's default colours likewise. Its set-up of two spheres is the look itself, the shell of air
being the outer one; that of one sphere for both is the term `single`.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np

from .._fields import Fields
from .._look import Look, parameter
from .._shapes import AnyArray, Scalar, Three
from ._terms import TermedLook, class_named, terms_of

_SOURCE = "document 003"
NODES = 9
"""Angles at which the gradient has a colour of its own: 20°, 40° … 180°."""
DARKEST = 1e-18
"""Least base of a power: at 0 its slope by the exponent would be no number."""

# Of Earth from space: white towards the terminator, red behind it, then dark.
_GRADIENT = {
    "red": (1.0, 1.05, 1.2, 1.6, 2.8, 0.4, 0.3, 0.3, 0.3),
    "green": (1.0, 1.02, 1.1, 1.2, 0.8, 0.3, 0.3, 0.3, 0.3),
    "blue": (1.0, 1.0, 1.0, 0.9, 0.3, 0.3, 0.3, 0.3, 0.3),
}


def _gradient(channel: str) -> Any:
    return parameter(
        f"{channel} light 20°, 40° … 180° from the point of full light, as a share of that there",
        lower=0.0,
        default=_GRADIENT[channel],
        shape=NODES,
        of="begin",
    )


class RimLook(TermedLook):
    """A coat that the sun lights: `over` the ground by `opacity · illumination · rim` of either."""

    brightness: Scalar = parameter(
        "light of the opaque coat in full light, times colour",
        lower=0.0,
        default=1.0,
    )
    tint: Three = parameter(
        "factor on the air's colour, mean 1 over the channels",
        lower=0.0,
        upper=3.0,
        default=(1.0, 1.0, 1.0),
        shape="rgb",
        mean_one=True,
    )
    opacity: Scalar = parameter(
        "share of what lies behind that the coat hides at the edge in full light",
        lower=0.0,
        upper=1.0,
        default=1.0,
    )
    exponent: Scalar = parameter(
        "how much denser the coat is towards the edge: p of 0.3 + 0.2 s^p + 0.5 s^(20 p)",
        lower=0.0,
        upper=20.0,
        default=5.0,
        scale=5.0,
        source=_SOURCE,
    )
    slump: Scalar = parameter(
        "how far beyond the terminator light still falls",
        unit="°",
        lower=0.0,
        upper=90.0,
        default=27.0,
        scale=27.0,
        source=_SOURCE,
    )

    NAME = "rim"
    NEEDS = ("begin", "end", "impact", "planet", "begin_sun_cos", "end_sun_cos")
    BLEND = "premultiplied"
    LIGHTS_GROUND = True
    AMPLITUDE: ClassVar[tuple[str, ...]] = ("brightness", "tint")
    # Of the light: each power's exp, 3 + 2 |x| ulp, is at most 4 of the light; x itself, a product
    # of its logarithm by p, is off by 8 ulp, which does |x| exp(x) ≤ 0.4 times as much; sums and
    # products 20, on two sides. Of 1: where light ends the illumination is a square of differences,
    # 6 ulp of a slope of 1.5, for light of ten times 1.
    ROUNDINGS = (60.0, 90.0)
    TERMS: ClassVar[dict[str, str]] = {
        "gradient": "the coat's colour changes with the angle from the point of full light",
        "specular": "water mirrors the sun (`planet.water`)",
        "single": "the coat lies on the ground itself, which is the one sphere there is",
    }
    TERM_OFF: ClassVar[dict[str, dict[str, float]]] = {
        "gradient": {"red": 1.0, "green": 1.0, "blue": 1.0},
        "specular": {"specular": 0.0},
    }

    @classmethod
    def parameters_of(cls, term: str) -> dict[str, tuple[Any, Any]]:
        if term == "gradient":
            return {name: (Any, _gradient(name)) for name in _GRADIENT}
        if term == "single":
            return {}
        specular = parameter(
            "white light that water mirrors straight from the sun",
            lower=0.0,
            default=1.0,
            of="water",
        )
        shininess = parameter(
            "exponent of Phong's reflection: how narrow the sun's image is",
            lower=1.0,
            upper=100.0,
            default=10.0,
            scale=10.0,
            of="water",
            source="Phong, Illumination for Computer Generated Pictures, 1975: 1 to 10",
        )
        return {"specular": (Scalar, specular), "shininess": (Scalar, shininess)}

    @classmethod
    def facts_of(cls, terms: Sequence[str]) -> dict[str, Any]:
        needs: tuple[str, ...] = RimLook.NEEDS
        if "single" in terms:
            needs = tuple(name for name in needs if name != "begin_sun_cos")
        if "specular" not in terms:
            return {"NEEDS": needs}
        # 12 ulp of 1 in the cosine and in its logarithm (4 by GLSL's own bound), a hundredfold.
        facts = {"AMPLITUDE": (), "ROUNDINGS": (1600.0, 90.0)}
        return facts | {"NEEDS": (*needs, "water", "sun_cos")}

    def air(self, fields: Fields) -> tuple[Any, Any]:
        terms = terms_of(self)
        here = fields.end > fields.begin
        if "single" in terms:
            at, sun_cos = fields.end, fields.end_sun_cos
            here = here & (fields.planet > 0)
        else:
            at, sun_cos = fields.begin, fields.begin_sun_cos
        dense = rim(at, fields.impact, self.exponent)
        alpha = jnp.where(here, self.opacity * illumination(sun_cos, self.slump) * dense, 0)
        color = self.brightness * (fields.color * self.tint)
        if "gradient" in terms:
            color = color * gradient(sun_cos, (self.red, self.green, self.blue))
        light = color * alpha
        if "specular" in terms:
            light = light + (1 - alpha) * self._mirrored(fields)
        passed = 1 - fields.planet * (1 - illumination(fields.end_sun_cos, self.slump))
        return jnp.concatenate([light, alpha], axis=-1), passed

    def _mirrored(self, fields: Fields) -> Any:
        """Phong's reflection of the sun by water; where the sun is low, by the sine of its height
        less, for the document's cut at the terminator would be a jump."""
        length = distance(fields.end, fields.impact)
        toward = fields.sun_cos - 2 * fields.end_sun_cos * fields.end / length
        power = jnp.exp(self.shininess * jnp.log(jnp.clip(toward, DARKEST, 1)))
        return self.specular * fields.water * jnp.maximum(fields.end_sun_cos, 0) * power


def distance(along: AnyArray, impact: AnyArray) -> AnyArray:
    """From the planet's centre, of a point at a length from the ray's nearest one; 1 of none."""
    squared = impact * impact + along * along
    return jnp.sqrt(jnp.where(squared > 0, squared, 1))


def illumination(sun_cos: AnyArray, slump: Scalar | AnyArray) -> AnyArray:
    """General illumination: 1 where the sun stands in the zenith, 0 from the slump beyond the
    terminator on.

    `u² (3 - 2 u)` of the share u of the way between, in cosines: monotone, and smooth at both ends.
    The document's own curve is a picture that is lost.

    Twin: `illumination` in `rim.glsl`.
    """
    night = jnp.sin(jnp.radians(slump))
    share = jnp.clip((sun_cos + night) / (1 + night), 0, 1)
    return share * share * (3 - 2 * share)


def rim(along: AnyArray, impact: AnyArray, exponent: Scalar | AnyArray) -> AnyArray:
    """How dense the coat looks: `0.3 + 0.2 s^p + 0.5 s^(20 p)`, s the sine between ray and vertical
    at a length from the ray's nearest point.

    Document 003: s = sin(acos(n · v)). Here from s² = b² / (b² + along²), for 20 p makes hundreds
    of each rounding of what is next to 1.

    Twin: `rim` in `rim.glsl`.
    """
    length = distance(along, impact)
    flat = 2 * jnp.abs(along) < impact  # the ray is nearer to the ground's plane than to its normal
    ratio = jnp.where(flat, along / jnp.where(flat, impact, 1), 0)
    sine = jnp.where(flat, 1, jnp.maximum(impact / length, DARKEST))
    logarithm = jnp.where(flat, -0.5 * jnp.log1p(ratio * ratio), jnp.log(sine))
    steep = exponent * logarithm
    return 0.3 + 0.2 * jnp.exp(steep) + 0.5 * jnp.exp(20 * steep)


def gradient(sun_cos: AnyArray, tables: Sequence[AnyArray]) -> AnyArray:
    """Colour of the coat at a cosine of the angle from the point of full light, as a share of that
    there [..., 3].

    Between the angles of the nodes it runs linearly with the cosine, smooth at full light.

    Twin: `gradient` in `rim.glsl`.
    """
    angles = np.linspace(0, np.pi, NODES + 1)
    places = np.cos(angles)
    found = []
    for table in tables:
        values = jnp.concatenate([jnp.ones(1, table.dtype), table])
        total: AnyArray = jnp.zeros_like(sun_cos)
        for k in range(NODES + 1):
            total = total + values[k] * hat(sun_cos, places, k)
        found.append(total)
    return jnp.concatenate(found, axis=-1)


def hat(at: AnyArray, places: np.ndarray, k: int) -> AnyArray:
    """Share of node k, 1 at its place and 0 at its neighbours'; places fall."""
    share = jnp.ones_like(at)
    if k > 0:
        share = jnp.minimum(share, (places[k - 1] - at) / (places[k - 1] - places[k]))
    if k + 1 < len(places):
        share = jnp.minimum(share, (at - places[k + 1]) / (places[k] - places[k + 1]))
    return jnp.maximum(share, 0)


def __getattr__(name: str) -> type[Look]:
    """The class of a set of terms by its name, as unpickling asks for it."""
    return class_named(RimLook, name)
