"""How far apart two right renderings may be: widths under a tolerance on the geometry.

Every width grows or shrinks monotonically with each radius, so the widths of a scene whose
spheres are only known to lie between two radii lie between the widths at the extremes. That needs
no linearisation, and holds at the limb, where the derivative is infinite.
"""

from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from ._analytic import bands, ray_stretch, trace_view
from ._fields import layer_widths
from ._kinds import need, need_number
from ._layers import Layers
from ._scene import Scene
from ._view import View

Range = tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]


@dataclass(frozen=True)
class WidthRanges:
    """What displaced surfaces can make of each pixel; float64, scene length units."""

    lit: Range
    """Least and greatest lit width."""
    dark: Range
    """Least and greatest shadowed width; zero without a sun."""
    front: Float[np.ndarray, "h w"]
    """Nearest beginning of the air, eye depth relative to the planet's centre."""
    back: Float[np.ndarray, "h w"]
    """Deepest end of the air, likewise."""
    stretch: Float[np.ndarray, "h w"]
    """Ratio of widths to eye depths: 1 unless they are lengths along rays."""
    silhouette: Bool[np.ndarray, "h w"]
    """Where it depends on the displacement what the ray meets at all: air, ground, a shadow."""


def width_ranges(scene: Scene, inner: float, outer: float) -> WidthRanges:
    """Least and greatest widths when every surface may be displaced.

    Args:
        scene: the scene with exact spheres.
        inner, outer: how far inside and outside its true place, in planet radii, each surface
            (ground, shell, occluders, shadows) may lie, both ≥ 0.
    """
    need("scene", scene, Scene)
    inner, outer = float(need_number("inner", inner)), float(need_number("outer", outer))
    size = (scene.camera.height, scene.camera.width)
    radius = float(scene.planet.radius)
    lit, dark = np.empty((2, *size)), np.zeros((2, *size))
    front, back, silhouette = np.empty(size), np.empty(size), np.empty(size, bool)
    with jax.enable_x64(True):
        for band, view in bands(scene):

            def met(
                ground: float, shell: float, shadow: float, view: View = view, band: slice = band
            ) -> _Met:
                moved = _displaced(view, ground, shell, shadow)
                return _meet(moved, band.stop - band.start, scene.camera.width)

            brightest = met(-inner, outer, -inner)
            dimmest = met(outer, -inner, outer)
            least_dark, most_dark = met(outer, -inner, -inner), met(-inner, outer, outer)
            lit[0, band], lit[1, band] = dimmest.lit * radius, brightest.lit * radius
            dark[0, band], dark[1, band] = least_dark.dark * radius, most_dark.dark * radius
            front[band] = np.minimum(brightest.front, most_dark.front) * radius
            back[band] = np.maximum(brightest.back, most_dark.back) * radius
            kinds = [m.kind for m in (brightest, dimmest, least_dark, most_dark)]
            silhouette[band] = np.any([kind != kinds[0] for kind in kinds], axis=(0, 1))
    stretch = ray_stretch(scene) if scene.atmosphere.path == "distance" else np.ones(size)
    lit, dark = lit * stretch, dark * stretch
    return WidthRanges((lit[0], lit[1]), (dark[0], dark[1]), front, back, stretch, silhouette)


def shadows_in_view(scene: Scene) -> tuple[bool, ...]:
    """Whether any pixel's ray runs through air in each shadow, from exact geometry in float64.

    The planet's shadow first, then the occluders'; empty without a sun. A billionth of a planet
    radius does not count: it is rounding.
    """
    need("scene", scene, Scene)
    if scene.sun is None:
        return ()
    seen = np.zeros(1 + len(scene.occluders), bool)
    with jax.enable_x64(True):
        for band, view in bands(scene):
            rows = band.stop - band.start
            front, back, _, *ends = trace_view(view, rows, scene.camera.width)
            begin, end = (np.clip(np.reshape(e, (-1, *front.shape)), front, back) for e in ends)
            seen |= np.max(end - begin, axis=(1, 2)) > 1e-9
            if np.all(seen):
                break
    return tuple(seen.tolist())


def _displaced(view: View, ground: float, shell: float, shadow: float) -> View:
    def radii(v: View) -> list[Any]:
        bodies = [v.occluders[k].radius for k in range(len(view.occluders))]
        cones = [v.cones[k].radius for k in range(len(view.cones))]
        return [v.planet, v.shell, *bodies, *cones]

    changes = [ground, shell] + [ground] * len(view.occluders) + [shadow] * len(view.cones)
    moved = [radius + change for radius, change in zip(radii(view), changes, strict=True)]
    return eqx.tree_at(radii, view, moved)


@dataclass(frozen=True)
class _Met:
    """What rays meet, in planet radii."""

    lit: Float[np.ndarray, "h w"]
    dark: Float[np.ndarray, "h w"]
    front: Float[np.ndarray, "h w"]
    back: Float[np.ndarray, "h w"]
    kind: Bool[np.ndarray, "k h w"]
    """Whether there is air, ground, and each shadow in the air."""


def _meet(view: View, height: int, width: int) -> _Met:
    front, back, planet, *shadow = trace_view(view, height, width)
    lit, dark = layer_widths(Layers(front, back, *(shadow or (None, None))))
    kind = [front != back, planet != 0]
    if shadow:
        begin, end = (np.clip(np.reshape(e, (-1, height, width)), front, back) for e in shadow)
        kind += list(end > begin)
    return _Met(
        lit=np.asarray(lit),
        dark=np.zeros_like(lit) if dark is None else np.asarray(dark),
        front=np.asarray(front),
        back=np.asarray(back),
        kind=np.stack([np.asarray(part) for part in kind]),
    )
