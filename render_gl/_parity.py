"""Do the combine shader and its JAX twin agree? The difference, and the bound it must stay below.

Both read the very same float32 depths, so only arithmetic differs. With ε = 2⁻²³ (one ulp,
relative) and e = the driver's worst error of a division in ulp:

    depth     each linearised depth may differ by e ulp. Equal inputs give equal outputs, so a
              depth that cancels exactly, as clamped shadow depths do, contributes nothing. In rgb
              remains brightness·color/unit · (e ulp(back) + e ulp(front)), and where there is
              shadow, |1 - shadow| · (e ulp(shadow back) + e ulp(shadow front)).
    rounding  division by the unit (GLSL 4.60 §4.7.1: 2.5 ulp; JAX ½), and ½ ulp on either side
              for each of the two sums, the products by shadow, tint, colour and brightness and
              the two differences of depths: 3 + 8·1 = 11 ulp of rgb's own size. Each further
              shadow adds a difference and a sum to both widths, one ulp each. Lengths along rays
              add 8: of the slope 1½ on either side, which its square doubles and the root halves,
              the squares and their sum 1, the root 2½ + 2 (an inverse square root's), a product
              of ½ on either side.

The specification allows e = 2.5 against JAX's ½, together 3. Drivers differ (llvmpipe has divided
by approximate reciprocals on some processors), so e is measured on the driver at hand: 65,536
quotients of the scene's own constants, by the shader's own `linearize_depth`. If all come out
correctly rounded e is 0; else it is the largest error found plus 1, and at most 3.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from model_jax import DriverError, Look, Scene, combine, depth_constants, linearize_depth

from ._context import on_gl
from ._depth_format import EPS, STORAGE, DepthFormat
from ._frame import Frame, assign_uniforms
from ._render import frame_layers
from ._shaders import program

if TYPE_CHECKING:
    import moderngl

ROUNDINGS = 11
STRETCH_ROUNDINGS = 8
SPECIFIED_DIVISION = 3.0
"""ulp, counted above."""
PROBES = 256
"""Rows and columns of quotients that are tried on the driver."""


@dataclass(frozen=True)
class Parity:
    """GLSL and JAX pictures of the same depths, and the verdict on their difference."""

    glsl: Float[np.ndarray, "h w 4"]
    jax: Float[np.ndarray, "h w 4"]
    bound: Float[np.ndarray, "h w 4"]
    """Largest difference that arithmetic explains, per pixel and channel."""
    division_ulp: float
    """What the bound takes for the error of a division of depths, ulp."""

    @property
    def difference(self) -> Float[np.ndarray, "h w 4"]:
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
                "channel": "RGBA"[worst[2]],
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
    picture = np.asarray(combine(layers, look))
    color = np.asarray(layers.color)[:3] * np.asarray(look.tint)
    shadow = np.broadcast_to(look.shadow, 3)
    weight = float(look.brightness) * color / float(layers.width_unit)
    # |lit| + shadow |dark| bounds every intermediate of the colour arithmetic.
    further = max(len(frame.shadows) - 1, 0)
    roundings = ROUNDINGS + 4 * further + STRETCH_ROUNDINGS * (layers.stretch is not None)
    bound = roundings * EPS * np.abs(picture[..., :3].astype(np.float64))
    linear = STORAGE[depth_format].encoding == "linear"
    if not linear and division_ulp > 0:
        front, back = np.asarray(layers.front), np.asarray(layers.back)
        ulps = (np.spacing(np.abs(front)) + np.spacing(np.abs(back))).astype(np.float64)
        spread = ulps[..., None] * np.ones(3)
        if layers.shadow_front is not None and layers.shadow_back is not None:
            ends = (np.asarray(layers.shadow_front), np.asarray(layers.shadow_back))
            low, high = (np.clip(np.reshape(e, (-1, *front.shape)), front, back) for e in ends)
            edge = np.where(high != low, np.spacing(np.abs(low)) + np.spacing(np.abs(high)), 0.0)
            spread = spread + np.abs(1 - shadow) * np.sum(edge, axis=0)[..., None]
        bound = (
            bound + division_ulp * weight * np.where(front != back, 1.0, 0.0)[..., None] * spread
        )
    tiny = np.finfo(np.float32).tiny  # drivers may flush denormals to zero
    alpha = np.full((*bound.shape[:2], 1), EPS)
    return Parity(
        glsl=frame.air,
        jax=picture,
        bound=np.concatenate([bound + tiny, alpha], axis=-1),
        division_ulp=0.0 if linear else division_ulp,
    )


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
