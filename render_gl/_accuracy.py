"""How exact are rasterised layers? Predicted from mesh, depth format and pixel grid, and measured.

Sources of width error of a scene whose planet is a sphere, all per surface:

    tessellation  the mesh lies up to `1 - inner_radius` planet (shell) radii inside its sphere
    pixel grid    vertices are snapped to 1/256 pixel (8 sub-pixel bits, the OpenGL minimum is 4 and
                  llvmpipe and all common GPUs have 8), which moves a silhouette by that much
    transform     float32 positions: 8 ulp of the shell's radius
    depth format  window depths are rounded to 2⁻²⁴ and computed in float32 (4 ulp of 1): at eye
                  depth z a step ε is ε z² (far - near) / (far near)

The first three displace surfaces, and `width_ranges` tells what any such displacement can do to a
width, near tangency included; the last adds to each of the two depths of a width.
"""

from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Float

from model_jax import Layers, Planet, Scene, layer_widths, width_ranges

from ._draw import DepthFormat
from ._mesh import sphere_mesh
from ._render import render

SUBPIXELS = 256
TRANSFORM_ULP = 8
WINDOW_ULP = 4
EPS = float(np.finfo(np.float32).eps)


@dataclass(frozen=True)
class Accuracy:
    """Width errors of rasterised layers against exact ones, in scene length units."""

    measured: Float[np.ndarray, "2 h w"]
    """|raster - analytic| of lit and dark width; NaN where the pixel has no air in either."""
    predicted: Float[np.ndarray, "2 h w"]
    """The bound on it."""
    outside: int
    """Number of widths whose error exceeds the prediction."""
    edges: int
    """Number of pixels on a silhouette, where only the widest chord bounds the error."""

    @property
    def passed(self) -> bool:
        return self.outside == 0

    def summary(self) -> dict[str, object]:
        """Figures for `airlight check`, scene length units, as JSON data."""
        rows: dict[str, object] = {}
        for name, measured, predicted in zip(
            ("lit", "dark"), self.measured, self.predicted, strict=True
        ):
            known = measured[np.isfinite(measured)]
            allowed = predicted[np.isfinite(measured)]
            if known.size == 0:
                known = allowed = np.zeros(1)
            rows[name] = {
                "max": float(np.max(known)),
                "p99.9": float(np.percentile(known, 99.9)),
                "median": float(np.median(known)),
                "predicted_max": float(np.max(allowed)),
                "predicted_median": float(np.median(allowed)),
            }
        counts = {"outside": self.outside, "edges": self.edges}
        return {"passed": self.passed, **counts, **rows}


def smooth(scene: Scene) -> Scene:
    """The scene without relief and texture: what exact intersection can follow."""
    planet = Planet(scene.planet.radius, triangles=scene.planet.triangles)
    return eqx.tree_at(lambda s: s.planet, scene, planet)


def measure_accuracy(scene: Scene, depth_format: DepthFormat) -> Accuracy:
    """Draw the scene's smooth sphere and hold its widths against exact ones."""
    bare = smooth(scene)
    layers = render(bare, depth_format)
    lit, dark = _widths(layers)
    inner, outer = displacement(bare)
    lit_range, dark_range = width_ranges(bare, inner, outer)
    exact_lit, exact_dark = (r[0] for r in width_ranges(bare, 0.0, 0.0))
    slack = 2 * depth_step(bare, layers, depth_format)
    measured, predicted, outside = [], [], 0
    # Where a displaced surface may or may not be met at all, its triangles stand edge-on: followed
    # beyond its snapped edge, such a plane has any depth; only the widest chord bounds it there.
    (lit_min, lit_max), (dark_min, dark_max) = lit_range, dark_range
    edge = (lit_min + dark_min == 0) & (lit_max + dark_max > 0)
    edge |= (dark_min == 0) & (dark_max > 0)
    widest = float(np.max(lit_max + dark_max))
    for width, (least, most), exact, sums in (
        (lit, lit_range, exact_lit, 2),  # the lit width is the sum of two differences
        (dark, dark_range, exact_dark, 1),
    ):
        allowance = sums * slack
        air = (width != 0) | (exact != 0)
        measured.append(np.where(air, np.abs(width - exact), np.nan))
        bound = np.where(edge, widest, np.maximum(most - exact, exact - least))
        predicted.append(bound + allowance)
        # Written so that a width that is not a number is outside.
        outside += int(np.sum(air & ~(measured[-1] <= predicted[-1])))
    return Accuracy(np.stack(measured), np.stack(predicted), outside, int(np.sum(edge)))


def displacement(scene: Scene) -> tuple[float, float]:
    """How far inside and outside its true place a rasterised surface may lie, planet radii."""
    radius = float(scene.planet.radius)
    shell = 1 + float(scene.atmosphere.height) / radius
    distance = float(np.linalg.norm(np.asarray(scene.camera.position))) / radius + shell
    footprint = float(scene.camera.pixel_size()) * distance / SUBPIXELS
    rounding = footprint + TRANSFORM_ULP * EPS * shell
    deficit = (1 - sphere_mesh(scene.planet.triangles).inner_radius) * shell
    return deficit + rounding, rounding


def depth_step(scene: Scene, layers: Layers, depth_format: DepthFormat) -> Float[np.ndarray, "h w"]:
    """Error of one depth by its format, scene length units."""
    near, far = float(scene.camera.near), float(scene.camera.far)
    back = np.asarray(layers.back, dtype=np.float64)
    if depth_format == "linear":
        return TRANSFORM_ULP * EPS * np.abs(back)
    step = (0.5 * 2.0**-24 + WINDOW_ULP * EPS / 2) * (far - near) / (far * near)
    return step * back**2 + WINDOW_ULP * EPS * back


def _widths(layers: Layers) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    unit = float(layers.width_unit)
    lit, dark = layer_widths(layers)
    lit = np.asarray(lit, dtype=np.float64) * unit
    dark = np.zeros_like(lit) if dark is None else np.asarray(dark, dtype=np.float64) * unit
    return lit, dark
