"""How far apart two right renderings may be: widths under a tolerance on the geometry.

Every width grows or shrinks monotonically with each radius, so the widths of a scene whose
spheres are only known to lie between two radii lie between the widths at the extremes. That needs
no linearisation, and holds at the limb, where the derivative is infinite.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._analytic import bands, trace_view
from ._combine import layer_widths
from ._layers import Layers
from ._scene import Scene
from ._view import View, view_of

Range = tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]


def width_ranges(scene: Scene, inner: float, outer: float) -> tuple[Range, Range]:
    """Least and greatest lit and dark width when every surface may be displaced.

    Args:
        scene: the scene with exact spheres.
        inner, outer: how far inside and outside its true place, in planet radii, each surface
            (ground, shell, occluders, shadows) may lie, both ≥ 0.

    Returns:
        `((lit_min, lit_max), (dark_min, dark_max))`, float64 [h, w], in scene length units; dark is
        zero without a sun.
    """
    with jax.enable_x64(True):
        view = view_of(scene).astype(jnp.float64)

        def widths(ground: float, shell: float, shadow: float) -> tuple[np.ndarray, np.ndarray]:
            return _widths(_displaced(view, ground, shell, shadow), scene)

        lit_min, _ = widths(outer, -inner, outer)
        lit_max, _ = widths(-inner, outer, -inner)
        _, dark_min = widths(outer, -inner, -inner)
        _, dark_max = widths(-inner, outer, outer)
    return (lit_min, lit_max), (dark_min, dark_max)


def shadows_in_view(scene: Scene) -> tuple[bool, ...]:
    """Whether any pixel's ray runs through air in each shadow, from exact geometry in float64.

    The planet's shadow first, then the occluders'; empty without a sun. A billionth of a planet
    radius does not count: it is rounding.
    """
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


def _widths(view: View, scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    front, back, _, *shadow = trace_view(view, scene.camera.height, scene.camera.width)
    lit, dark = layer_widths(Layers(front, back, *(shadow or (None, None))))
    radius = float(scene.planet.radius)
    dark = jnp.zeros_like(lit) if dark is None else dark
    return np.asarray(lit) * radius, np.asarray(dark) * radius
