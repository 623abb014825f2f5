"""How exact are rasterised layers? Predicted from the geometry alone, and measured.

Sources of width error of a scene whose planet is a sphere:

    tessellation  the mesh lies up to `1 - inner_radius` planet (shell) radii inside its sphere
    pixel grid    vertices are snapped to 1/256 pixel (8 sub-pixel bits, the OpenGL minimum is 4 and
                  llvmpipe and all common GPUs have 8), which moves a silhouette by that much
    transform     float32 positions: 8 ulp of the shell's radius
    depth format  `depth_error`, for each of the depths that a width is made of

The first three displace surfaces, and `width_ranges` tells what any such displacement can do to a
width, near tangency included. Where a displaced surface may or may not be met at all, a silhouette,
its triangles stand edge-on: followed beyond its snapped edge, such a plane has any depth, and only
the widest chord bounds the error. That is a line of pixels, told apart from all others.
"""

from dataclasses import dataclass

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from model_jax import Layers, Planet, Scene, WidthRanges, layer_widths, width_ranges

from ._depth_format import EPS, DepthFormat, depth_error
from ._mesh import sphere_mesh
from ._render import render

SNAP = np.sqrt(0.5) / 256
"""Half the diagonal of a sub-pixel, pixels."""
TRANSFORM_ULP = 8


@dataclass(frozen=True)
class Prediction:
    """Bounds on the width errors of rasterised layers, in scene length units."""

    bound: Float[np.ndarray, "2 h w"]
    """Of lit and dark width."""
    silhouette: Bool[np.ndarray, "h w"]
    """Where only the widest chord bounds the error."""
    chord: float
    """The widest way through air in view."""

    @property
    def error(self) -> float:
        """The largest bound off silhouettes, and no more than the widest chord."""
        inside = self.bound[:, ~self.silhouette]
        return min(float(np.max(inside, initial=0.0)), self.chord)


@dataclass(frozen=True)
class Accuracy:
    """Width errors of rasterised layers against exact ones, in scene length units."""

    measured: Float[np.ndarray, "2 h w"]
    """|raster - analytic| of lit and dark width; NaN where the pixel has no air in either, infinite
    where the rasterised one is no number."""
    predicted: Prediction

    @property
    def outside(self) -> int:
        """Number of widths whose error exceeds its bound."""
        return int(np.sum(self.measured > self.predicted.bound))

    @property
    def largest(self) -> float:
        """The largest error off silhouettes."""
        inside = self.measured[:, ~self.predicted.silhouette]
        return float(np.max(inside[np.isfinite(inside)], initial=0.0))

    @property
    def passed(self) -> bool:
        return self.outside == 0

    def summary(self) -> dict[str, object]:
        """Figures for `airlight check`, scene length units, as JSON data."""
        rows: dict[str, object] = {}
        inside = ~self.predicted.silhouette
        for k, name in enumerate(("lit", "dark")):
            known = np.isfinite(self.measured[k]) & inside
            errors, bounds = self.measured[k][known], self.predicted.bound[k][known]
            if errors.size == 0:
                errors = bounds = np.zeros(1)
            rows[name] = {
                "max": float(np.max(errors)),
                "p99.9": float(np.percentile(errors, 99.9)),
                "median": float(np.median(errors)),
                "predicted_max": float(np.max(bounds)),
                "predicted_median": float(np.median(bounds)),
            }
        edge = self.measured[:, self.predicted.silhouette]
        return {
            "passed": self.passed,
            "outside": self.outside,
            "largest": self.largest,
            "predicted": self.predicted.error,
            "silhouettes": int(np.sum(self.predicted.silhouette)),
            "silhouette_max": float(np.max(edge[np.isfinite(edge)], initial=0.0)),
            "widest_chord": self.predicted.chord,
            **rows,
        }


def smooth(scene: Scene) -> Scene:
    """The scene without relief and texture: what exact intersection can follow."""
    planet = Planet(scene.planet.radius, triangles=scene.planet.triangles)
    return eqx.tree_at(lambda s: s.planet, scene, planet)


def predict_accuracy(scene: Scene, depth_format: DepthFormat) -> Prediction:
    """Bounds for the scene's smooth sphere, before anything is drawn."""
    bare = smooth(scene)
    ranges, exact = width_ranges(bare, *displacement(bare)), width_ranges(bare, 0.0, 0.0)
    return _prediction(bare, depth_format, ranges, exact)


def measure_accuracy(scene: Scene, depth_format: DepthFormat) -> Accuracy:
    """Draw the scene's smooth sphere and hold its widths against exact ones."""
    bare = smooth(scene)
    ranges, exact = width_ranges(bare, *displacement(bare)), width_ranges(bare, 0.0, 0.0)
    measured = []
    for width, (true, _) in zip(
        _widths(render(bare, depth_format)), (exact.lit, exact.dark), strict=True
    ):
        air = (width != 0) | (true != 0)
        error = np.nan_to_num(np.abs(width - true), nan=np.inf)
        measured.append(np.where(air, error, np.nan))
    return Accuracy(np.stack(measured), _prediction(bare, depth_format, ranges, exact))


def _prediction(
    scene: Scene, depth_format: DepthFormat, ranges: WidthRanges, exact: WidthRanges
) -> Prediction:
    step = depth_error(scene, depth_format, ranges.back) * ranges.stretch
    chord = float(np.max(ranges.lit[1] + ranges.dark[1], initial=0.0))
    air = ranges.lit[1] + ranges.dark[1] > 0
    bounds = []
    for (least, most), (true, _), depths in (
        (ranges.lit, exact.lit, 4),  # the lit width is the sum of two differences
        (ranges.dark, exact.dark, 2),
    ):
        moved = np.maximum(most - true, true - least)
        bound = np.where(ranges.silhouette, chord, moved) + depths * step
        bounds.append(np.where(air, bound, 0.0))
    return Prediction(np.stack(bounds), ranges.silhouette, chord)


def displacement(scene: Scene) -> tuple[float, float]:
    """How far inside and outside its true place a rasterised surface may lie, planet radii."""
    radius = float(scene.planet.radius)
    shell = 1 + float(scene.atmosphere.height) / radius
    camera = max(float(np.linalg.norm(np.asarray(scene.camera.position))) / radius, 1.0)
    # Nothing in view lies farther than where a ray that grazes the ground leaves the air.
    distance = np.sqrt(camera**2 - 1) + np.sqrt(shell**2 - 1)
    footprint = float(scene.camera.pixel_size()) * distance * SNAP
    rounding = footprint + TRANSFORM_ULP * EPS * shell
    deficit = (1 - sphere_mesh(scene.planet.triangles).inner_radius) * shell
    return deficit + rounding, rounding


def _widths(layers: Layers) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    unit = float(layers.width_unit)
    lit, dark = layer_widths(layers)
    lit = np.asarray(lit, dtype=np.float64) * unit
    dark = np.zeros_like(lit) if dark is None else np.asarray(dark, dtype=np.float64) * unit
    return lit, dark
