"""Layers from exact intersection: no meshes, no depth buffer, differentiable in the scene.

The oracle of the rasteriser (for a sphere without relief) and the layer source where there is no
OpenGL. Host part in float64 (`_view`), per-pixel part in float32 or float64 JAX (`_intersect`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Float

from ._errors import InputError
from ._fields import uses_shadow
from ._intersect import ray_cone, ray_sphere, squared_miss_distance
from ._kinds import need, need_float
from ._layers import Layers
from ._look import Look
from ._scene import Scene
from ._shapes import AnyArray, is_traced, namespace
from ._view import Aim, View, eye_center, pixel_grid, pixel_slopes, ray_offsets, view_of

BAND = 2**18
"""Pixels looked at at once where all are asked: some MB for each float64 quantity."""

PIECE = 2**16
"""Pixels traced at once, whatever the picture's size: one compiled program serves all sizes."""


def analytic_layers(
    scene: Scene, dtype: DTypeLike = jnp.float32, look: Look | None = None
) -> Layers:
    """Layers of a scene whose planet is a smooth sphere; relief and textures are not drawn.

    Pure, and usable under `jit`, `vmap` and `grad` with respect to every number of the scene.
    Called with plain numbers it prepares the view in float64 whatever the dtype; inside a trace the
    preparation has the precision of the traced numbers, so far-away cameras want x64 there.

    Args:
        scene: what is looked at; lengths in any one unit.
        dtype: float32 or float64 of the layers; float64 needs `jax_enable_x64`.
        look: what the layers are for: shadows are found only if it needs them; None: in any case.

    Returns:
        Eye depths relative to the planet's centre, [h, w] each, clamped to [near, far]; shadow
        layers only when the scene has a sun, [n, h, w] with occluders: the planet's, then theirs;
        `surface` only when the planet's albedo is a colour: Lambert's light, albedo × the cosine of
        the sun's angle to the normal; without a sun, and for a look that lights the ground itself,
        the albedo.
        Rays follow DESIGN "ray–sphere, ray–cone".

    Raises:
        InputError: float64 asked for while JAX has it switched off.
    """
    need("scene", scene, Scene)
    need_float("dtype", dtype)
    if jax.dtypes.canonicalize_dtype(dtype) != jnp.dtype(dtype):
        raise InputError(
            "analytic_layers: dtype float64 while JAX has 64-bit numbers switched off; "
            'call jax.config.update("jax_enable_x64", True) first'
        )
    camera, radius = scene.camera, scene.planet.radius
    view, albedo = view_of(scene).astype(dtype), scene.planet.albedo
    if look is not None:
        need("look", look, Look)
    shaded = look is None or uses_shadow(look.NEEDS)
    seen = view if shaded else replace(view, cones=())
    front, back, planet, *shadow = trace_view(seen, camera.height, camera.width)
    surface, unlit = None, look is not None and look.LIGHTS_GROUND
    if isinstance(albedo, tuple):
        light = partial(_light, np.asarray(albedo, dtype), unlit)
        (surface,) = _of_all_pixels(light, view, camera.height, camera.width)
    scale = namespace(front).asarray(radius, front.dtype)
    return Layers(
        front=jnp.asarray(front * scale),
        back=jnp.asarray(back * scale),
        shadow_front=jnp.asarray(shadow[0] * scale) if shadow else None,
        shadow_back=jnp.asarray(shadow[1] * scale) if shadow else None,
        surface=None if surface is None else jnp.moveaxis(jnp.asarray(surface), 0, -1),
        is_albedo=surface is not None and unlit,
        planet=jnp.asarray(planet),
        color=scene.atmosphere.color,
        reference=eye_center(scene)[2],
        width_unit=camera.far - camera.near,
        view=view_of(scene),
        stretch=jnp.asarray(_stretch(scene, dtype))
        if scene.atmosphere.path == "distance"
        else None,
    )


def ray_stretch(scene: Scene) -> Float[np.ndarray, "h w"]:
    """Length along each pixel's ray for a unit of eye depth, `|(x, y, 1)|`; float64."""
    need("scene", scene, Scene)
    return np.asarray(_stretch(scene, np.float64))


def _stretch(scene: Scene, dtype: DTypeLike) -> Float[AnyArray, "h w"]:
    view, camera = view_of(scene), scene.camera
    xp = namespace(view)
    view = jax.tree.map(lambda leaf: xp.asarray(leaf, dtype), view)
    x, y = pixel_slopes(view, *pixel_grid(camera.height, camera.width, dtype))
    return xp.sqrt(1 + x * x + y * y)


def trace_view(view: View, height: int, width: int) -> tuple[AnyArray, ...]:
    """Front, back, planet mask and, with a sun, shadow front and back, in planet radii.

    NumPy arrays [h, w], shadows of several bodies [n, h, w]; traced ones of a traced view.
    """
    return _of_all_pixels(trace, view, height, width)


def _of_all_pixels(
    kernel: Callable[[View, AnyArray, AnyArray], Sequence[AnyArray]],
    view: View,
    height: int,
    width: int,
) -> tuple[AnyArray, ...]:
    """What a kernel of column and row says of each pixel, [..., h, w]: piece by piece as NumPy
    arrays, or traced of a traced view."""
    dtype = np.dtype(getattr(view.pixel, "dtype", np.float64))
    if is_traced(view):
        return tuple(kernel(view, *pixel_grid(height, width, dtype)))
    pixels = height * width
    found: list[np.ndarray] = []
    for start in range(0, pixels, PIECE):
        # Beyond the last pixel the piece goes on through rows that do not exist.
        row, column = np.divmod(np.arange(start, start + PIECE), width)
        parts = [np.asarray(p) for p in kernel(view, column.astype(dtype), row.astype(dtype))]
        if not found:
            found = [np.empty((*part.shape[:-1], pixels), dtype) for part in parts]
        end = min(start + PIECE, pixels)
        for whole, part in zip(found, parts, strict=True):
            whole[..., start:end] = part[..., : end - start]
    return tuple(whole.reshape(*whole.shape[:-1], height, width) for whole in found)


@jax.jit
def trace(view: View, column: AnyArray, row: AnyArray) -> tuple[AnyArray, ...]:
    """`trace_view` of any pixels, whose indices broadcast."""
    x, y = pixel_slopes(view, column, row)
    mx, my = ray_offsets(view.aim, column, row)

    def clamp(depth: AnyArray) -> AnyArray:
        return jnp.clip(depth, view.near, view.far)

    in_shell, (front, back) = ray_sphere(x, y, mx, my, view.shell)
    cut, (ground, _) = ray_sphere(x, y, mx, my, view.planet)
    # The planet ends the ray wherever it is in front of the camera: the clip planes limit depths
    # (they are clamped, as by the rasteriser), not what is there.
    hit = cut & is_ahead(x, y, view.aim)
    back = jnp.where(hit, ground, back)
    for body in view.occluders:
        met, (enter, _) = ray_sphere(x, y, *ray_offsets(body.aim, column, row), body.radius)
        met &= is_ahead(x, y, body.aim)
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


@partial(jax.jit, static_argnums=1)
def _light(
    albedo: Float[AnyArray, "3"], unlit: bool, view: View, column: AnyArray, row: AnyArray
) -> tuple[AnyArray]:
    """Light of a planet of one colour, or the colour itself, [3, ...] of any pixels; 0 where none
    is seen.

    What `planet.frag` makes of a texture, the sun's direction being the shadow's axis.
    """
    x, y = pixel_slopes(view, column, row)
    mx, my = ray_offsets(view.aim, column, row)
    cut, (ground, _) = ray_sphere(x, y, mx, my, view.planet)
    seen = cut & is_ahead(x, y, view.aim)
    for body in view.occluders:
        met, (enter, _) = ray_sphere(x, y, *ray_offsets(body.aim, column, row), body.radius)
        seen &= ~(met & is_ahead(x, y, body.aim) & (enter + body.depth < ground))
    at = mx + ground * x, my + ground * y, ground
    # Not 0, if the ground is not seen too: at least the planet's radius.
    length = jnp.sqrt(at[0] * at[0] + at[1] * at[1] + at[2] * at[2])

    def along(axis: AnyArray, start: AnyArray) -> AnyArray:
        p = [part / length - begin for part, begin in zip(at, start, strict=True)]
        return p[0] * axis[0] + p[1] * axis[1] + p[2] * axis[2]

    cosine = jnp.ones_like(length)
    if unlit:
        return (jnp.stack([part * jnp.where(seen, cosine, 0) for part in albedo]),)
    if view.cones:
        cosine = jnp.maximum(along(view.cones[0].axes[2], jnp.zeros(3, length.dtype)), 0)
    for cone in view.cones[1:]:
        first, second, toward = (along(axis, cone.center) for axis in cone.axes)
        across = jnp.hypot(first, second)
        dark = (toward < cone.base) & (across < cone.radius + cone.tangent * toward)
        cosine = jnp.where(dark, 0, cosine)
    light = jnp.where(seen, cosine, 0)
    return (jnp.stack([part * light for part in albedo]),)


def is_ahead(x: AnyArray, y: AnyArray, aim: Aim) -> AnyArray:
    """Whether a sphere that the ray's line cuts lies before the camera, which is outside of it.

    Both ends are then on one side, that of the centre. Depths would not tell for a camera on the
    ground: which side of it they are on is a matter of rounding.

    Twin: `is_ahead` in `rays.glsl`.
    """
    return x * aim.center[0] + y * aim.center[1] + aim.center[2] > 0


def bands(scene: Scene) -> Iterator[tuple[slice, View]]:
    """Rows of the picture from the top and the float64 view of each: what is asked of all pixels
    then takes no more memory than the answer."""
    camera = scene.camera
    rows = min(camera.height, max(1, BAND // camera.width))
    view = view_of(scene)
    for start in range(0, camera.height, rows):
        yield slice(start, min(start + rows, camera.height)), view.from_pixel(0, start)


def limb_height(scene: Scene, dtype: DTypeLike = np.float64) -> Float[np.ndarray, "h w"]:
    """Height above the ground at which each pixel's line of sight passes the planet's centre.

    Computed in float64 whatever the dtype, scene length units; negative where the line meets the
    planet. The abscissa of a limb profile.
    """
    need("scene", scene, Scene)
    need_float("dtype", dtype)
    camera, radius = scene.camera, float(scene.planet.radius)
    height = np.empty((camera.height, camera.width), dtype)
    for band, view in bands(scene):
        grid = pixel_grid(band.stop - band.start, camera.width, np.float64)
        x, y = pixel_slopes(view, *grid)
        squared, _ = squared_miss_distance(x, y, *ray_offsets(view.aim, *grid))
        height[band] = (np.sqrt(squared) - 1.0) * radius
    return height
