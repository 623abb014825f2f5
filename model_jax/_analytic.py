"""Layers from exact intersection: no meshes, no depth buffer, differentiable in the scene.

The oracle of the rasteriser (for a sphere without relief) and the layer source where there is no
OpenGL. Host part in float64 (`_view`), per-pixel part in float32 or float64 JAX (`_intersect`).
"""

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Float

from ._errors import InputError
from ._intersect import ray_cone, ray_sphere, squared_miss_distance
from ._layers import Layers
from ._scene import Scene
from ._shapes import AnyArray, Scalar
from ._view import Aim, View, eye_center, pixel_slopes, ray_offsets, view_of

BAND = 2**18
"""Pixels looked at at once where all are asked: some MB for each float64 quantity."""


def analytic_layers(scene: Scene, dtype: DTypeLike = jnp.float32) -> Layers:
    """Layers of a scene whose planet is a smooth sphere; relief and albedo are not drawn.

    Pure, and usable under `jit`, `vmap` and `grad` with respect to every number of the scene.
    Called with plain numbers it prepares the view in float64 whatever the dtype; inside a trace the
    preparation has the precision of the traced numbers, so far-away cameras want x64 there.

    Args:
        scene: what is looked at; lengths in any one unit.
        dtype: float32 or float64 of the layers; float64 needs `jax_enable_x64`.

    Returns:
        Eye depths relative to the planet's centre, [h, w] each, clamped to [near, far]; shadow
        layers only when the scene has a sun, [n, h, w] with occluders: the planet's, then theirs.
        Rays follow DESIGN "ray–sphere, ray–cone".

    Raises:
        InputError: float64 asked for while JAX has it switched off.
    """
    if jax.dtypes.canonicalize_dtype(dtype) != jnp.dtype(dtype):
        raise InputError(
            "analytic_layers: dtype float64 while JAX has 64-bit numbers switched off; "
            'call jax.config.update("jax_enable_x64", True) first'
        )
    camera, radius = scene.camera, scene.planet.radius
    depths = trace_view(view_of(scene).astype(dtype), camera.height, camera.width)
    scale = jnp.asarray(radius, dtype)
    front, back, planet, *shadow = depths
    return Layers(
        front=front * scale,
        back=back * scale,
        shadow_front=shadow[0] * scale if shadow else None,
        shadow_back=shadow[1] * scale if shadow else None,
        planet=planet,
        color=scene.atmosphere.color,
        reference=eye_center(scene)[2],
        width_unit=camera.far - camera.near,
        stretch=_traced_stretch(scene, dtype) if scene.atmosphere.path == "distance" else None,
    )


def ray_stretch(scene: Scene) -> Float[np.ndarray, "h w"]:
    """Length along each pixel's ray for a unit of eye depth, `|(x, y, 1)|`; float64."""
    with jax.enable_x64(True):
        return np.asarray(_traced_stretch(scene, jnp.float64))


def _traced_stretch(scene: Scene, dtype: DTypeLike) -> Float[jax.Array, "h w"]:
    x, y = pixel_slopes(view_of(scene).astype(dtype), scene.camera.height, scene.camera.width)
    return jnp.sqrt(1 + x * x + y * y)


@partial(jax.jit, static_argnums=(1, 2))
def trace_view(view: View, height: int, width: int) -> tuple[AnyArray, ...]:
    """Front, back, planet mask and, with a sun, shadow front and back, in planet radii."""
    x, y = pixel_slopes(view, height, width)
    mx, my = ray_offsets(view.aim, height, width)

    def clamp(depth: AnyArray) -> AnyArray:
        return jnp.clip(depth, view.near, view.far)

    in_shell, (front, back) = ray_sphere(x, y, mx, my, view.shell)
    cut, (ground, _) = ray_sphere(x, y, mx, my, view.planet)
    # The planet ends the ray wherever it is in front of the camera: the clip planes limit depths
    # (they are clamped, as by the rasteriser), not what is there.
    hit = cut & _ahead(x, y, view.aim)
    back = jnp.where(hit, ground, back)
    for body in view.occluders:
        met, (enter, _) = ray_sphere(x, y, *ray_offsets(body.aim, height, width), body.radius)
        met &= _ahead(x, y, body.aim)
        back = jnp.where(met, jnp.minimum(back, enter + body.depth), back)
        hit |= met
    front, back = clamp(front), clamp(back)
    air = in_shell & (back > front)
    empty = jnp.broadcast_to(view.far, air.shape)
    front, back = jnp.where(air, front, empty), jnp.where(air, back, empty)
    planet = hit.astype(front.dtype)
    if not view.cones:
        return front, back, planet
    shadows = []
    for cone in view.cones:
        enter, leave = (clamp(depth) for depth in ray_cone(x, y, mx, my, cone))
        dark = leave > enter
        shadows.append((jnp.where(dark, enter, empty), jnp.where(dark, leave, empty)))
    if len(shadows) == 1:
        return front, back, planet, *shadows[0]
    starts, ends = zip(*shadows, strict=True)
    return front, back, planet, jnp.stack(starts), jnp.stack(ends)


def _ahead(x: AnyArray, y: AnyArray, aim: Aim) -> AnyArray:
    """Whether a sphere that the ray's line cuts lies before the camera, which is outside of it.

    Both ends are then on one side, that of the centre. Depths would not tell for a camera on the
    ground: which side of it they are on is a matter of rounding.
    """
    return x * aim.center[0] + y * aim.center[1] + aim.center[2] > 0


def bands(scene: Scene) -> Iterator[tuple[slice, View]]:
    """Rows of the picture from the top and the float64 view of each: what is asked of all pixels
    then takes no more memory than the answer. The last band reaches back over the one before it,
    so that all have one shape and share one compiled program."""
    camera = scene.camera
    rows = min(camera.height, max(1, BAND // camera.width))
    view = view_of(scene).astype(jnp.float64)
    for start in range(0, camera.height, rows):
        first = min(start, camera.height - rows)
        yield slice(first, first + rows), view.from_pixel(0, first)


def limb_height(scene: Scene, dtype: DTypeLike = np.float64) -> Float[np.ndarray, "h w"]:
    """Height above the ground at which each pixel's line of sight passes the planet's centre.

    Computed in float64 whatever the dtype, scene length units; negative where the line meets the
    planet. The abscissa of a limb profile.
    """
    camera, radius = scene.camera, float(scene.planet.radius)
    height = np.empty((camera.height, camera.width), dtype)
    with jax.enable_x64(True):
        for band, view in bands(scene):
            height[band] = _limb_height(view, radius, band.stop - band.start, camera.width)
    return height


@partial(jax.jit, static_argnames=("height", "width"))
def _limb_height(view: View, radius: Scalar, height: int, width: int) -> Float[jax.Array, "h w"]:
    x, y = pixel_slopes(view, height, width)
    mx, my = ray_offsets(view.aim, height, width)
    squared, _ = squared_miss_distance(x, y, mx, my)
    return (jnp.sqrt(squared) - 1.0) * radius
