"""How exact are rasterised layers? Predicted from the geometry alone, and measured.

Sources of width error of a scene whose planet is a sphere, of either source:

    raster  float32 rays: where a ray passes a body is known to `RAY_ULP` ulp, and how far along it
            the body is met to `ALONG_ULP`
    mesh    tessellation: it lies up to `1 - inner_radius` planet (shell) radii inside its sphere
            pixel grid: vertices are snapped to 1/256 pixel (8 sub-pixel bits, the OpenGL minimum is
            4 and llvmpipe and all common GPUs have 8), which moves a silhouette by that much
            transform: float32 positions, `TRANSFORM_ULP` ulp of the shell's radius
    both    depth format: `depth_error`, for each of the depths that a width is made of

But for the last and `ALONG_ULP` all displace surfaces, and `width_ranges` tells what any such
displacement can do to a width, near tangency included, where it grows as the root of the
displacement. Where a displaced surface may or may not be met at all, a silhouette, only the widest
chord bounds the error (a triangle that stands edge-on and is followed beyond its snapped edge has
any depth). That is a line of pixels, told apart from all others.

The ulp of a ray, u = ½ ulp being the rounding of one operation, ρ the shell's radius and
S = ρ |d| + 2 |offset at the anchor| the largest number that the impact vector m is made of: m is
known to 3 u S, x and y to 2 u, and m × d to 7 u S |d|. The squared miss distance
(|m|² + (m × d)²) / |d|² so to 6 u ρ S + 14 u ρ S + 12 u ρ², with a quotient of 2½ ulp (GLSL 4.60,
§4.7.1); half of it over ρ is a displacement of 16 u S, and the squared radius adds u ρ: `RAY_ULP`.
A cone's coordinates are those of m and d turned into its axes, which adds 3 u S; the difference of
squares that is its discriminant has 8 u S instead of 7: together 12 ulp. Along the ray:
-m·d / |d|² is known to 13 u S, a root and a quotient to 9 u S, the sum to u S: `ALONG_ULP`.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from model_jax import Layers, Planet, Scene, WidthRanges, layer_widths, width_ranges
from model_jax._view import view_of

from ._choices import Source
from ._depth_format import EPS, DepthFormat, depth_error
from ._mesh import sphere_mesh
from ._render import render

SNAP = np.sqrt(0.5) / 256
"""Half the diagonal of a sub-pixel, pixels."""
TRANSFORM_ULP = 8
RAY_ULP = 12
ALONG_ULP = 12
"""Roundings of a mesh's transform, of a ray's intersection, of a length along it; counted above."""


@dataclass(frozen=True)
class Prediction:
    """Bounds on the width errors of rasterised layers, in scene length units."""

    bound: Float[np.ndarray, "2 h w"]
    """Largest difference that is explained, of lit and dark width."""
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
    def compared(self) -> int:
        """Number of widths off silhouettes: those whose error the prediction really bounds."""
        return int(np.sum(np.isfinite(self.measured) & ~self.predicted.silhouette))

    @property
    def passed(self) -> bool:
        """False also when nothing could be compared."""
        return self.outside == 0 and self.compared > 0

    def summary(self) -> dict[str, Any]:
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
            "compared": self.compared,
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


def predict_accuracy(
    scene: Scene, depth_format: DepthFormat, source: Source = "raster"
) -> Prediction:
    """Bounds for the scene's smooth sphere, before anything is drawn."""
    bare = smooth(scene)
    ranges = width_ranges(bare, *displacement(bare, source))
    return _prediction(bare, depth_format, source, ranges, width_ranges(bare, 0.0, 0.0))


def measure_accuracy(
    scene: Scene, depth_format: DepthFormat, source: Source = "raster"
) -> Accuracy:
    """Draw the scene's smooth sphere and hold its widths against exact ones."""
    bare = smooth(scene)
    ranges = width_ranges(bare, *displacement(bare, source))
    exact = width_ranges(bare, 0.0, 0.0)
    measured = []
    drawn = width_pair(render(bare, depth_format, source))
    for width, (true, _) in zip(drawn, (exact.lit, exact.dark), strict=True):
        air = (width != 0) | (true != 0)
        error = np.nan_to_num(np.abs(width - true), nan=np.inf)
        measured.append(np.where(air, error, np.nan))
    return Accuracy(np.stack(measured), _prediction(bare, depth_format, source, ranges, exact))


def _prediction(
    scene: Scene,
    depth_format: DepthFormat,
    source: Source,
    ranges: WidthRanges,
    exact: WidthRanges,
) -> Prediction:
    ends = (depth_error(scene, depth_format, depth) for depth in (ranges.front, ranges.back))
    step = np.maximum(*ends) * ranges.stretch
    if source == "raster":
        along = ALONG_ULP * EPS * _ray_size(scene) * float(scene.planet.radius)
        step = step + along * ranges.stretch
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


def displacement(scene: Scene, source: Source = "raster") -> tuple[float, float]:
    """How far inside and outside its true place a rasterised surface may lie, planet radii."""
    radius = float(scene.planet.radius)
    shell = 1 + float(scene.atmosphere.height) / radius
    if source == "raster":
        rounding = RAY_ULP * EPS * _ray_size(scene)
        return rounding, rounding
    camera = max(float(np.linalg.norm(np.asarray(scene.camera.position))) / radius, 1.0)
    # Nothing in view lies farther than where a ray that grazes the ground leaves the air.
    distance = np.sqrt(camera**2 - 1) + np.sqrt(shell**2 - 1)
    footprint = float(scene.camera.pixel_size()) * distance * SNAP
    rounding = footprint + TRANSFORM_ULP * EPS * shell
    deficit = (1 - sphere_mesh(scene.planet.triangles).inner_radius) * shell
    return deficit + rounding, rounding


def _ray_size(scene: Scene) -> float:
    """The largest number that impact vectors of rays through air are made of, planet radii."""
    view, camera = view_of(scene), scene.camera
    diagonal = float(camera.pixel_size()) * np.hypot(camera.width, camera.height) / 2
    offsets = [aim.offset for aim in (view.aim, *(body.aim for body in view.occluders))]
    largest = max(float(np.linalg.norm(offset)) for offset in offsets)
    return float(view.shell) * float(np.hypot(1, diagonal)) + 2 * largest


def width_pair(layers: Layers) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Lit and dark width, scene length units."""
    unit = float(layers.width_unit)
    lit, dark = layer_widths(layers)
    lit = np.asarray(lit, dtype=np.float64) * unit
    dark = np.zeros_like(lit) if dark is None else np.asarray(dark, dtype=np.float64) * unit
    return lit, dark
