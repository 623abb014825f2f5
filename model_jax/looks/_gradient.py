"""The look `gradient`: the sky painted from a table of colours by brightness and height.

Document 004, an "outer atmosphere" shader. Its gradient texture is lost: the colours of the term
`table` are ours. What it reckoned at the vertices of a shell stands here at every pixel.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._errors import InputError
from .._fields import Fields
from .._look import Look, parameter
from .._parameter import Smooth
from .._phase import cheap_cornette_shanks
from .._safe import safe_sqrt
from .._shapes import AnyArray, Scalar, Three
from ._rim import distance
from ._terms import TermedLook, class_named, terms_of

_SOURCE = "document 004"
BRIGHTNESSES, HEIGHTS = 8, 4
"""Nodes of the table along brightness, 0 to 1, and along height, 0 at the air's edge, 1 at the
horizon of the ground."""
EXPOSURE = 1.5
"""The document's fExposure."""
SMOOTH = 0.3
"""Standard deviation of the difference of neighbours in a table, as a fit knows it before."""
LIGHT_DISTANCE = 300**0.5 / 1024
"""The document's light at (10, 10, 10) inside a planet of radius 1024, in its radii."""

# Of Earth: blue day, whiter towards the horizon; a red dusk; shares of the horizon's at full light.
_DUSK = np.array([0.15, 0.45, 0.9, 1.0, 1.0, 1.0, 1.0, 1.0])
_TABLE = {
    "red": np.outer([0.3, 0.9, 1.6, 1.4, 1.2, 1.1, 1.0, 1.0], [0.25, 0.45, 0.75, 1.0]),
    "green": np.outer([0.3, 0.5, 0.8, 0.95, 1.0, 1.0, 1.0, 1.0], [0.45, 0.65, 0.85, 1.0]),
    "blue": np.outer([0.4, 0.4, 0.5, 0.7, 0.85, 0.95, 1.0, 1.0], [0.8, 0.95, 1.0, 1.0]),
    "cover": np.outer(_DUSK, [0.4, 0.7, 0.9, 1.0]),
}


def _table(channel: str) -> Any:
    default = np.round(_TABLE[channel], 3).ravel()[:-1]
    return parameter(
        f"{channel}, as a share of that at full light at the horizon: for each of {BRIGHTNESSES} "
        f"brightnesses 0 … 1 the {HEIGHTS} heights from the air's edge to the horizon, the last "
        f"of which is 1; fits know that neighbours differ by {SMOOTH:g} (standard deviation)",
        lower=0.0,
        default=tuple(map(float, default)),
        shape=len(default),
        of="begin",
        smooth=Smooth.grid(BRIGHTNESSES, HEIGHTS, SMOOTH),
    )


class GradientLook(TermedLook):
    """A sky by the sun's height and the way to the horizon: `1 - exp(-falloff · color · (1 + h))`,
    before the ground nothing."""

    falloff: Scalar = parameter(
        "how fast colour saturates: the document's exposure",
        lower=0.0,
        default=EXPOSURE,
        source=_SOURCE,
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
        "the colour's alpha, which saturates as light does and hides what lies behind",
        lower=0.0,
        default=1.0,
    )
    stretch: Scalar = parameter(
        "how far the sky is pushed into the night, in cosines",
        lower=0.0,
        upper=1.0,
        default=0.25,
        scale=0.25,
        source=_SOURCE,
    )
    tweak: Scalar = parameter(
        "where the sky's upper edge stands for a camera at the air's edge, a cosine",
        lower=0.0,
        upper=1.0,
        default=0.1,
        scale=0.1,
        source=_SOURCE,
    )

    NAME = "gradient"
    NEEDS = (
        *("begin", "end", "altitude", "impact", "planet", "begin_sun_cos", "end_sun_cos"),
        *("shell", "nadir_cos", "radius", "eye_height", "ground_horizon", "shell_horizon"),
        "eye_sun_cos",
    )
    BLEND = "premultiplied"
    # Of the light: a sum, a product, the exponential's own. Of 1: brightness is a sum off by 6 ulp,
    # and as much more by where it stands in a table of 7 steps, each of which may be one colour;
    # height is off by 4 ulp over half the ground horizon's cosine, 0.05 of the thinnest shells; the
    # exponential makes at most 0.37 of what its argument, three times as large, is off by.
    ROUNDINGS = (12.0, 300.0)
    TERMS: ClassVar[dict[str, str]] = {
        "table": "colour and alpha change with brightness and height",
        "mie": "haze glows around the sun",
        "lamp": "that sun is near, and shines from where it is",
        "veil": "air lies before the ground too, by its length on the ray",
    }
    TERM_NEEDS: ClassVar[dict[str, tuple[str, ...]]] = {"lamp": ("mie",)}
    TERM_OFF: ClassVar[dict[str, dict[str, float]]] = {
        "table": dict.fromkeys(_TABLE, 1.0),
    }

    @classmethod
    def parameters_of(cls, term: str) -> dict[str, tuple[Any, Any]]:
        if term == "table":
            return {name: (Any, _table(name)) for name in _TABLE}
        if term == "mie":
            asymmetry = parameter(
                "how much haze sends light on as it came, below 0, or back: the document's g",
                lower=-1.0,
                upper=1.0,
                default=-0.95,
                of="sun_cos",
                source=_SOURCE,
            )
            return {"asymmetry": (Scalar, asymmetry)}
        if term == "lamp":
            light_distance = parameter(
                "of the light from the planet's centre",
                unit="planet radii",
                lower=0.0,
                default=LIGHT_DISTANCE,
                of="sun_cos",
                source=_SOURCE,
            )
            return {"light_distance": (Scalar, light_distance)}
        return {}

    @classmethod
    def of_picture(cls, picture: Float[np.ndarray, "h w 4"]) -> dict[str, Any]:
        """The table of a gradient texture as document 004 has it, for air of colour [1, 1, 1]:
        columns from night to full light, rows from the air's edge down to the horizon.

        What is stored counts as light, without a tone curve. Of a picture twice as fine as the
        table or more it is the nearest one by least squares, else what is between its pixels.
        """
        by_brightness = _nearest(np.swapaxes(np.asarray(picture, np.float64), 0, 1), BRIGHTNESSES)
        by_height = _nearest(np.swapaxes(by_brightness, 0, 1), HEIGHTS)
        nodes = np.maximum(np.swapaxes(by_height, 0, 1), 0)
        last = nodes[-1, -1]
        if not (last > 0).all():
            raise InputError(
                "the picture's last pixel, full light at the horizon, has channels of 0, "
                f"{np.round(last, 3).tolist()}; the table is of shares of them: make it brighter"
            )
        shares = (nodes / last).reshape(-1, 4)[:-1].T
        strength = float(last[:3].mean())
        return {
            "falloff": EXPOSURE * strength,
            "tint": last[:3] / strength,
            "opacity": float(last[3]) / strength,
        } | dict(zip(_TABLE, shares, strict=True))

    @classmethod
    def facts_of(cls, terms: Sequence[str]) -> dict[str, Any]:
        facts: dict[str, Any] = {"PICTURE": "texture"} if "table" in terms else {}
        return facts | ({"NEEDS": (*GradientLook.NEEDS, "sun_cos")} if "mie" in terms else {})

    def air(self, fields: Fields) -> tuple[Any, Any]:
        terms = terms_of(self)
        height, raised, brightness, at = sky(fields, self.stretch, self.tweak)
        here = fields.end > fields.begin
        if "veil" not in terms:
            here = here & (fields.planet == 0)
        amount = jnp.where(here, jnp.maximum(raised, 0) * brightness, 0)
        color, glow = self._colors(fields.color, at, height, terms)
        color = color * (1 + height)
        if "mie" in terms:
            turned = self._turned(fields, terms)
            color = color + glow * cheap_cornette_shanks(turned, -self.asymmetry)
        return -jnp.expm1(-self.falloff * amount * color), None

    def _colors(
        self, air: AnyArray, at: AnyArray, height: AnyArray, terms: Sequence[str]
    ) -> tuple[Any, Any]:
        """Colour and alpha of the table, and those of the glow, [..., 4] each."""
        flat = jnp.concatenate([air * self.tint, self.opacity], axis=-1)
        if "table" not in terms:
            return flat, flat
        tables = (self.red, self.green, self.blue, self.cover)
        glow = table_at(jnp.minimum(at, 0.5), jnp.ones_like(at), tables)
        return flat * table_at(at, height, tables), flat * glow

    def _turned(self, fields: Fields, terms: Sequence[str]) -> AnyArray:
        """Cosine of the angle by which light is turned towards the camera."""
        if "lamp" not in terms:
            return fields.sun_cos
        place = distance(fields.end, fields.impact)
        far = self.light_distance * fields.radius
        between = far * far + place * place - 2 * far * place * fields.end_sun_cos
        turned = (far * fields.sun_cos - fields.end) / jnp.sqrt(jnp.where(between > 0, between, 1))
        return jnp.clip(turned, -1, 1)


def sky(fields: Fields, stretch: Any, tweak: Any) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """Height in the sky, 0 at the air's edge, 1 at the ground's horizon, below 0 high above a
    camera in the air; the same as it is raised there; brightness; and its place in the table.

    Document 004: heights are cosines of the angle with straight down. Outside of the air the two
    edges' are roots next to 1, so their differences are taken as (squares' differences) / sums.
    In the air the ray's near point is the camera itself: nothing is to be intersected. Ours are:
    before the ground, height is the air's length on the ray over that at the horizon; `tweak` is at
    most half of the ground horizon's cosine at the air's edge: that of a shell thinner than 0.5 %
    of the radius would else be passed, for a division by 0.

    Twin: `sky` in `gradient.glsl`.
    """
    shell, radius, eye_height = fields.shell, fields.radius, fields.eye_height
    whole, rim = fields.ground_horizon, fields.shell_horizon
    outside = rim > 0
    far = jnp.where(radius > 0, radius + eye_height, 1)
    thick = jnp.where(shell > 0, shell, 1)

    def above(squares: AnyArray, cosine: AnyArray) -> AnyArray:
        """How far a cosine is above the air's edge, whose squares differ by so much."""
        together = jnp.where(outside, far * far * (cosine + rim), 1)
        return jnp.where(outside, squares / together, cosine)

    edge = above((shell - fields.altitude) * (radius + shell + fields.impact), fields.nadir_cos)
    horizon = above(shell * (2 * radius + shell), whole)
    reach = safe_sqrt(shell * (2 * radius + shell))
    tweak = jnp.minimum(tweak, 0.5 * reach / (jnp.where(radius > 0, radius, 1) + shell))
    deep = eye_height / thick - (1 - tweak)
    shift = jnp.minimum(jnp.maximum(tweak - rim, 0), deep - rim)
    span = horizon - shift
    height = (edge - shift) / jnp.where(span > 0, span, 1)
    reach = jnp.where(outside, reach, far * whole)
    begin = jnp.where(outside, fields.begin, -far * fields.nadir_cos)
    veil = (fields.end - begin) / jnp.where(reach > 0, reach, 1)
    height = jnp.clip(jnp.where(fields.planet > 0, veil, height), -1, 1)

    above_eye = fields.eye_sun_cos
    near = jnp.where(outside, fields.begin_sun_cos, above_eye)
    sun = jnp.maximum(fields.end_sun_cos + stretch, 0)
    brightness = jnp.clip(sun + jnp.maximum(near + stretch, 0) * above_eye, 0, 1)
    at = brightness * jnp.clip(above_eye + 1 + stretch, 0, 1)
    raised = height - jnp.minimum(deep + sun * deep, 0)
    return height, raised, brightness, at


def table_at(at: AnyArray, height: AnyArray, tables: Sequence[AnyArray]) -> AnyArray:
    """Colours and alpha of the table [..., c], linear between its nodes, the last of which is 1;
    held at its edges.

    Twin: `table_at` in `gradient.glsl`.
    """
    ones = [jnp.concatenate([table, jnp.ones(1, table.dtype)]) for table in tables]
    nodes = jnp.stack(ones, axis=-1).reshape(BRIGHTNESSES, HEIGHTS * len(tables))
    # The default precision of some devices has ten bits.
    columns = jnp.matmul(_shares(at, BRIGHTNESSES), nodes, precision=jax.lax.Precision.HIGHEST)
    columns = columns.reshape(*columns.shape[:-1], HEIGHTS, len(tables))
    return jnp.sum(columns * _shares(height, HEIGHTS)[..., None], axis=-2)


def _shares(at: AnyArray, count: int) -> AnyArray:
    """Share of each of so many nodes between 0 and 1; places have one channel, at the end."""
    nodes = jnp.arange(count, dtype=at.dtype).reshape((1,) * (at.ndim - 1) + (count,))
    return jnp.maximum(1 - jnp.abs(jnp.clip(at, 0, 1) * (count - 1) - nodes), 0)


def _nearest(lines: Float[np.ndarray, "n *rest"], count: int) -> Float[np.ndarray, "m *rest"]:
    """So many nodes from 0 to 1 along the first axis, of pixels whose middles are known."""
    middles = (np.arange(len(lines)) + 0.5) / len(lines)
    flat = lines.reshape(len(lines), -1)
    if len(lines) < 2 * count:
        places = np.linspace(0, 1, count)
        nodes = np.stack([np.interp(places, middles, line) for line in flat.T], axis=-1)
    else:
        share = np.maximum(1 - np.abs(middles[:, None] * (count - 1) - np.arange(count)), 0)
        nodes = np.linalg.lstsq(share, flat, rcond=None)[0]
    return nodes.reshape(count, *lines.shape[1:])


def __getattr__(name: str) -> type[Look]:
    """The class of a set of terms by its name, as unpickling asks for it."""
    return class_named(GradientLook, name)
