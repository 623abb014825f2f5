"""Do the combine shader and its JAX twin agree? The difference, and the bound it must stay below.

Both read the very same float32 depths, so only arithmetic differs. With ε = 2⁻²³ (one ulp,
relative) and e = the driver's worst error of a division in ulp:

    depth     each linearised depth may differ by e ulp. Equal inputs give equal outputs, so a
              depth that cancels exactly, as clamped shadow depths do, contributes nothing. In the
              width of the air remains e ulp(back) + e ulp(front), and of each shadow e ulp(shadow
              back) + e ulp(shadow front) passes from lit to dark. What that does to the light is
              the look's slope by its fields, to first order: a width is off by 10⁻³ at most.
    width     the division by the unit (GLSL 4.60 §4.7.1: 2.5 ulp; JAX ½), the two differences of
              depths and their sum with ½ ulp on either side, 6 ulp of a width. Each further shadow
              adds a difference and a sum to both widths, one ulp each. Lengths along rays add 8: of
              the slope 1½ on either side, which its square doubles and the root halves, the squares
              and their sum 1, the root 2½ + 2 (an inverse square root's), a product of ½ on either
              side. They do to the light what its slope says.
    places    With m where the ray passes the plane through the planet's centre and d its slope,
              float32 in the shader and float64 on the host, m is off by 2 ulp of itself and of its
              value at the anchor. The nearest point, m·d/d², is off by 10 ulp more of its product,
              and, where depths count from the eye, by 2 ulp of the centre's; a place by its depth's
              e ulp, the nearest point's error and 8 ulp of itself. The squared distance from the
              centre, (m² + (m×d)²)/d², is off by m's error, 12 ulp of its second square and 6 of
              itself; the distance by its root's share, the height likewise and by 10 ulp of itself,
              of which an exponential's 2 |x| ulp and its quotient take most. The sun's direction is
              off by half an ulp, what is along it of the nearest point by m's and that point's
              errors and 6 ulp of either, the cosine with the ray by 8 ulp of 1. A vertical's cosine
              with that direction is off by all of these of its point, over the distance from the
              centre, and 6 ulp of 1.
    look      what the look says of its own arithmetic (`ROUNDINGS`).

The specification allows e = 2.5 against JAX's ½, together 3. Drivers differ (llvmpipe has divided
by approximate reciprocals on some processors), so e is measured on the driver at hand: 65,536
quotients of the scene's own constants, by the shader's own `linearize_depth`. If all come out
correctly rounded e is 0; else it is the largest error found plus 1, and at most 3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import DriverError, Layers, Look, Scene, combine, depth_constants, linearize_depth
from model_jax._composite import air_light
from model_jax._fields import OF_VIEW, UNDER_SUN, WIDTHS, fields_of
from model_jax._intersect import squared_miss_distance
from model_jax._shapes import AnyArray
from model_jax._view import pixel_grid, pixel_slopes, ray_offsets

from ._context import on_gl
from ._depth_format import EPS, STORAGE, DepthFormat
from ._frame import Frame, assign_uniforms
from ._render import frame_layers
from ._shaders import program

if TYPE_CHECKING:
    import moderngl

WIDTH_ROUNDINGS = 6
STRETCH_ROUNDINGS = 8
SPECIFIED_DIVISION = 3.0
"""ulp, counted above."""
PROBES = 256
"""Rows and columns of quotients that are tried on the driver."""


CHANNELS = ("R", "G", "B", "A", *(f"transmittance {c}" for c in "RGB"))


@dataclass(frozen=True)
class Parity:
    """GLSL and JAX pictures of the same depths, and the verdict on their difference.

    Channels are light, alpha and, of a look that dims what lies behind, the transmittance.
    """

    glsl: Float[np.ndarray, "h w c"]
    jax: Float[np.ndarray, "h w c"]
    bound: Float[np.ndarray, "h w c"]
    """Largest difference that arithmetic explains, per pixel and channel."""
    division_ulp: float
    """What the bound takes for the error of a division of depths, ulp."""

    @property
    def difference(self) -> Float[np.ndarray, "h w c"]:
        return self.glsl.astype(np.float64) - self.jax.astype(np.float64)

    @property
    def passed(self) -> bool:
        """True when every channel of every pixel is finite and within its bound."""
        return bool(np.all(np.abs(self.difference) <= self.bound))  # NaN compares False

    def summary(self) -> dict[str, Any]:
        """The figures that `airlight check` prints, as JSON data."""
        size = np.abs(self.difference)
        rgb = np.abs(self.jax[..., :3])
        peak = float(np.max(rgb)) or 1.0
        ulp = size[..., :3] / np.spacing(np.maximum(rgb, np.finfo(np.float32).tiny))
        ulp = np.where(size[..., :3] == 0, 0.0, ulp)
        worst = np.unravel_index(int(np.argmax(_finite(size / self.bound))), size.shape)
        return {
            "passed": self.passed,
            "max": float(np.max(_finite(size))),
            "p99.9": float(np.percentile(_finite(size), 99.9)),
            "max_ulp": float(np.max(_finite(ulp))),
            "p99.9_ulp": float(np.percentile(_finite(ulp), 99.9)),
            "max_relative": float(np.max(_finite(size))) / peak,
            "p99.9_relative": float(np.percentile(_finite(size), 99.9)) / peak,
            "bound_relative": float(np.max(self.bound)) / peak,
            "image_max": peak,
            "division_ulp": self.division_ulp,
            "worst_pixel": {
                "row": int(worst[0]),
                "column": int(worst[1]),
                "channel": CHANNELS[worst[2]],
                "glsl": float(self.glsl[worst]),
                "jax": float(self.jax[worst]),
                "bound": float(self.bound[worst]),
            },
        }


def compare(
    scene: Scene, look: Look, frame: Frame, depth_format: DepthFormat, division_ulp: float
) -> Parity:
    """Recombine a frame's depths in JAX and bound the difference to what the shader made of them.

    `division_ulp`: error of a division of depths (`measure_division`); unused for linear depths.
    """
    layers = frame_layers(scene, frame, depth_format)
    division = 0.0 if STORAGE[depth_format].encoding == "linear" else division_ulp
    picture = np.asarray(combine(layers, look))
    fields = fields_of(layers, type(look).NEEDS)
    color = jnp.asarray(layers.color, jnp.float32)[:3]
    (light, alpha, passed), slopes = jax.tree.map(
        lambda part: np.asarray(part, np.float64), _slopes(look, fields, color)
    )
    of_light, of_alpha, of_passed = _field_bounds(fields, slopes, layers, division)
    own, of_one = type(look).ROUNDINGS
    tiny = np.finfo(np.float32).tiny  # drivers may flush denormals to zero
    glsl, twin = [frame.air], [picture]
    bounds = [of_light + EPS * (own * np.abs(light) + of_one) + tiny]
    # The colour's alpha is a copy; the look's own is computed.
    bounds.append(of_alpha + EPS * np.maximum(own * np.abs(alpha) + of_one, 1.0))
    if frame.transmittance is not None:
        glsl.append(frame.transmittance)
        twin.append(np.where(np.asarray(layers.has_air)[..., None], passed, 1).astype(np.float32))
        bounds.append(of_passed + EPS * (own * np.abs(passed) + of_one) + tiny)
    drawn, expected, bound = (np.concatenate(p, axis=-1) for p in (glsl, twin, bounds))
    return Parity(drawn, expected, bound, division)


Parts = tuple[np.ndarray, ...]
"""Of light [h, w, 3], alpha [h, w, 1] and transmittance [h, w, 3]."""


def _slopes(look: Look, fields: dict[str, AnyArray], color: AnyArray) -> Any:
    """What a look makes of fields (`Parts`), and its slopes by each of them, by name."""
    still = {name: jnp.zeros_like(field) for name, field in fields.items()}
    found = {
        name: _pushed(look, fields, color, still | {name: jnp.ones_like(field)})
        for name, field in fields.items()
    }
    parts, _ = next(iter(found.values()))
    return parts, {name: slopes for name, (_, slopes) in found.items()}


@eqx.filter_jit
def _pushed(
    look: Look, fields: dict[str, AnyArray], color: AnyArray, change: Mapping[str, AnyArray]
) -> tuple[Any, Any]:
    """The parts, and how they change with the fields: one program for all of these, for a look that
    goes along the ray makes a large one of each."""

    def looked(fields: dict[str, AnyArray]) -> tuple[AnyArray, ...]:
        air = air_light(look, fields, color)
        one = jnp.ones((*air.light.shape[:-1], 1), air.light.dtype)
        passed = one if air.transmittance is None else air.transmittance
        alpha = one if air.alpha is None else air.alpha
        return air.light, alpha, jnp.broadcast_to(passed, air.light.shape)

    parts, slopes = jax.jvp(looked, (fields,), (dict(change),))
    return parts, slopes


def _field_bounds(
    fields: dict[str, AnyArray], slopes: dict[str, Parts], layers: Layers, division_ulp: float
) -> Parts:
    """What errors of the fields do to light, alpha and transmittance."""
    front, back = np.asarray(layers.front), np.asarray(layers.back)
    begin, end = layers.shadow_front, layers.shadow_back
    several = np.ndim(begin) > 2 if begin is not None else False
    roundings = WIDTH_ROUNDINGS + STRETCH_ROUNDINGS * (layers.stretch is not None)
    roundings += 4 * (len(np.asarray(begin)) - 1) if several else 0
    scale = 1.0 if layers.stretch is None else np.asarray(layers.stretch, np.float64)
    scale = scale / float(layers.width_unit) * np.where(front != back, division_ulp, 0.0)
    ends = scale * (np.spacing(np.abs(front)) + np.spacing(np.abs(back)))
    edges = np.zeros(front.shape)
    if begin is not None and end is not None:
        depths = (np.asarray(begin), np.asarray(end))
        low, high = (np.clip(np.reshape(d, (-1, *front.shape)), front, back) for d in depths)
        ulps = np.spacing(np.abs(low)) + np.spacing(np.abs(high))
        edges = scale * np.sum(np.where(high != low, ulps, 0.0), axis=0)
    asked = [name for name in OF_VIEW if name in fields]
    errors = _place_errors(layers, fields, division_ulp) if asked else {}
    places = {name: np.where(front != back, errors[name], 0.0) for name in asked}
    found = []
    for k in range(3):
        nothing = np.zeros((*front.shape, 1))
        by = {name: slopes[name][k] if name in slopes else nothing for name in WIDTHS}
        sizes = {name: np.abs(np.asarray(fields[name])) for name in WIDTHS if name in fields}
        rounded = sum((np.abs(by[n]) * size[..., None] for n, size in sizes.items()), nothing)
        placed = sum((np.abs(slopes[n][k]) * off[..., None] for n, off in places.items()), nothing)
        found.append(
            placed
            + roundings * EPS * rounded
            + np.abs(by["width"] + by["lit"]) * ends[..., None]
            + np.abs(by["lit"] - by["dark"]) * edges[..., None]
        )
    return tuple(found)


def _place_errors(
    layers: Layers, fields: dict[str, AnyArray], division_ulp: float
) -> dict[str, Float[np.ndarray, "h w"]]:
    """How far the two sides' places on the ray and heights may be apart (see the module)."""
    view = layers.view
    assert view is not None  # else there were no such fields
    height, width = np.shape(layers.front)
    grid = pixel_grid(height, width, np.float64)
    x, y = (np.abs(part) for part in pixel_slopes(view, *grid))
    mx, my = ray_offsets(view.aim, *grid)
    squared, dd = squared_miss_distance(*pixel_slopes(view, *grid), mx, my)
    m, d = np.hypot(mx, my), np.hypot(x, y)
    of_m = 2 * (m + np.hypot(*np.asarray(view.aim.offset)))
    radius, slant, impact = float(view.radius), np.sqrt(dd), np.sqrt(squared)
    reference = float(layers.reference)
    center = abs(float(view.depth) - reference)
    nearest = EPS * (radius * (of_m * d + 10 * m * d) / dd + 2 * center)
    of_squared = EPS * ((2 * m * of_m + 12 * (m * d) ** 2) / dd + 6 * squared)
    at = {name: np.abs(np.asarray(field, np.float64)) for name, field in fields.items()}
    found = {}
    begin, until = layers.shadow_front, layers.shadow_back
    depths = {"begin": layers.front, "end": layers.back}
    if begin is not None and until is not None:
        depths |= {"dark_begin": begin, "dark_end": until}
    for name in depths.keys() & at.keys():
        depth = depths[name]
        inside = np.clip(np.asarray(depth), layers.front, layers.back)
        off = division_ulp * np.spacing(np.abs(inside))
        found[name] = slant * (off + nearest) + 8 * EPS * at[name]
    height = (impact - 1) * radius
    by_root = np.minimum(of_squared / np.maximum(2 * impact, 1e-30), np.sqrt(of_squared))
    found["altitude"] = radius * of_squared / (impact + 1) + 10 * EPS * np.abs(height)
    found["impact"] = radius * (by_root + EPS * impact)
    unit = float(layers.width_unit)
    found["per_length"] = 6 * EPS / unit / (1 if layers.stretch is not None else slant)
    of_point = of_m + 6 * m + (of_m * d + 16 * m * d) / slant
    found["sunward"] = EPS * radius * of_point
    found["sun_cos"] = np.full(slant.shape, 8 * EPS)
    for name, place in UNDER_SUN.items():
        # What moves a point by so much turns its vertical by so much of its distance, which no air
        # has below the ground's.
        off = division_ulp * np.spacing(np.abs(np.asarray(depths[place])))
        moved = found["sunward"] + found["impact"] + slant * (off + nearest)
        found[name] = moved / radius + (16 * float(view.shell) + 6) * EPS
    # Straight down is off by half an ulp, the cosine like that with the sun; the rest is rounded.
    found["nadir_cos"] = np.full(slant.shape, 8 * EPS)
    for name in ("radius", "eye_height", "ground_horizon", "shell_horizon", "eye_sun_cos"):
        found[name] = EPS * at.get(name, np.zeros(slant.shape))
    found["shell"] = np.full(slant.shape, 2 * EPS * radius * float(view.shell - 1))
    return found


def measure_division(scene: Scene, depth_format: DepthFormat) -> float:
    """Error in ulp to allow for this driver's division in `linearize_depth` (see the module)."""
    encoding = STORAGE[depth_format].encoding
    if encoding == "linear":
        return 0.0
    near, far = float(scene.camera.near), float(scene.camera.far)
    constants = depth_constants(near, far, encoding)
    a, b = (np.float32(number) for number in constants)
    windows = np.random.default_rng(20260101).random((PROBES, PROBES), dtype=np.float32)
    values = {
        "depth_constants": (float(a), float(b)),
        "plane_depths": (near, far),
        "clip_planes": (0.0, 1.0),
        "windows": 0,
    }
    drawn = on_gl(lambda context: _probe(context, windows, values))
    if not np.all(np.isfinite(drawn)):
        raise DriverError(
            f"the driver's linearize_depth gives numbers that are not finite for near {near:g} and "
            f"far {far:g}; bring them closer together or use linear depth"
        )
    exact = np.asarray(linearize_depth(windows, near, far, encoding))
    error = float(np.max(np.abs(drawn - exact) / np.spacing(np.abs(exact))))
    return 0.0 if error == 0 else min(error + 1.0, SPECIFIED_DIVISION)


def _probe(context: "moderngl.Context", windows: np.ndarray, values: dict[str, Any]) -> np.ndarray:
    """Depths by the shader's own `linearize_depth`."""
    source = context.texture((PROBES, PROBES), 1, windows.tobytes(), dtype="f4")
    result = context.texture((PROBES, PROBES), 1, dtype="f4")
    shader = program("screen.vert", "probe.frag")
    assign_uniforms(shader, values)
    context.framebuffer([result]).use()
    context.enable_only(0)
    source.use(0)
    context.vertex_array(shader, []).render(vertices=3)
    drawn = np.frombuffer(result.read(), dtype=np.float32).reshape(PROBES, PROBES)
    context.gc()
    return drawn


def _finite(values: np.ndarray) -> np.ndarray:
    """NaN counts as the largest number: a difference that cannot be taken is no small one."""
    return np.nan_to_num(values, nan=np.finfo(np.float64).max, posinf=np.finfo(np.float64).max)
