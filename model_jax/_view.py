"""The geometry of a view, prepared on the host in float64 so that float32 suffices afterwards.

Lengths are in planet radii; vectors are in eye axes (right, up, forward). A pixel's ray is
`m + τ·d` with `d = (x, y, 1)`: the parameter τ is eye depth relative to the planet's centre, and
`m` is the ray's point in the image-parallel plane through that centre, so `m = (mx, my, 0)`. Both
x and mx are affine in the pixel index; the constants of `mx` are taken at the integer pixel nearest
to the planet's centre, where nothing cancels, so that a camera 232 radii away loses no more digits
than a near one.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Float

from ._kinds import need
from ._safe import safe_divide
from ._scene import Camera, Scene
from ._shapes import AnyArray, Scalar, namespace


class ShadowCone(eqx.Module):
    """Umbra of a sphere: `|p⊥| ≤ radius + k (p·s)`, `p·s ≤ base`, and `radius + k (p·s) ≥ 0`.

    p counts from the axis' point that is nearest to the planet's centre, where the air is: the
    sphere itself may be a moon sixty radii away, and its lengths would swallow the air's digits.
    """

    axes: Float[AnyArray, "3 3"]
    """Rows e1, e2 ⟂ sun, and the unit direction s toward the sun, in eye axes."""
    center: Float[AnyArray, "3"]
    """The point that p counts from relative to the planet's centre, in eye axes."""
    radius: Scalar
    """Radius of the cone there; below 0 beyond the apex."""
    base: Scalar
    """Where the sphere's centre lies along s."""
    tangent: Scalar
    """k = tan of the sun's angular radius; 0 is the cylinder."""


class Aim(eqx.Module):
    """Where the rays pass a point, in the image-parallel plane through it: affine in the pixel."""

    slope: Scalar
    """Change of mx per column (and of -my per row): eye depth of the point × `pixel`."""
    anchor: Float[AnyArray, "2"]
    """Column and row index (whole numbers) at which `offset` is stated."""
    offset: Float[AnyArray, "2"]
    """mx and my at the anchor pixel's centre."""
    center: Float[AnyArray, "3"]
    """The point itself, as the camera sees it."""


class Body(eqx.Module):
    """A further sphere in view."""

    aim: Aim
    depth: Scalar
    """Eye depth of its centre relative to the planet's."""
    radius: Scalar


class View(eqx.Module):
    """Per-scene numbers of the per-pixel kernels; all leaves in one dtype after `astype`."""

    pixel: Scalar
    """Side of a pixel on the plane at eye depth 1."""
    principal: Float[AnyArray, "2"]
    """Column and row index of the optical axis."""
    aim: Aim
    """At the planet's centre."""
    near: Scalar
    """Eye depth of the near plane relative to the planet's centre."""
    far: Scalar
    planet: Scalar
    """Radius of the ground: 1, unless an error bound varies it."""
    shell: Scalar
    """Radius of the air's outer edge."""
    cones: tuple[ShadowCone, ...]
    """Shadow volumes: the planet's first."""
    occluders: tuple[Body, ...]
    radius: Scalar
    """The planet's mean radius, scene length units."""

    @property
    def depth(self) -> Scalar:
        """Eye depth of the planet's centre, scene length units."""
        return self.aim.center[2] * self.radius

    def from_pixel(self, column: int, row: int) -> "View":
        """The view whose first pixel is this one's pixel there: a window of the picture."""
        first = np.asarray([float(column), float(row)])

        def moved(aim: Aim) -> Aim:
            return replace(aim, anchor=aim.anchor - first)

        return replace(
            self,
            principal=self.principal - first,
            aim=moved(self.aim),
            occluders=tuple(replace(body, aim=moved(body.aim)) for body in self.occluders),
        )

    def astype(self, dtype: DTypeLike) -> "View":
        """All leaves as JAX arrays of one dtype."""
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), self)


def eye_center(scene: Scene) -> Float[AnyArray, "3"]:
    """The planet's centre in eye axes (right, up, eye depth), scene length units."""
    need("scene", scene, Scene)
    return -scene.camera.basis() @ scene.camera.position


def view_of(scene: Scene) -> View:
    """The view of a scene: float64 for a scene of plain numbers, traced for a traced one."""
    need("scene", scene, Scene)
    camera, radius = scene.camera, scene.planet.radius
    center = eye_center(scene) / radius
    depth = center[2]
    return View(
        pixel=camera.pixel_size(),
        principal=(np.asarray([camera.width, camera.height]) - 1) / 2,
        aim=_aim(camera, center),
        near=camera.near / radius - depth,
        far=camera.far / radius - depth,
        planet=1.0,
        shell=1.0 + scene.atmosphere.height / radius,
        cones=_cones(scene),
        occluders=_bodies(scene),
        radius=radius,
    )


def _aim(camera: Camera, center: Float[AnyArray, "3"]) -> Aim:
    """How the rays pass a point that is given in eye axes, in float64 on the host."""
    xp = namespace(center, camera.fov_y_deg)
    slope = center[2] * camera.pixel_size()
    size = xp.asarray([camera.width, camera.height])
    # Where the point projects to, kept near the picture; one beside or behind the camera anchors
    # at the picture's centre, for then nothing is far away and cancels.
    flip = xp.asarray([1.0, -1.0])
    middle = (size - 1) / 2.0
    projected = middle + flip * safe_divide(center[:2], xp.stack([slope, slope]), 0.0)
    anchor = xp.round(xp.clip(projected, -4 * size, 5 * size))
    return Aim(slope, anchor, flip * slope * (anchor - middle) - center[:2], center)


def pixel_grid(height: int, width: int, dtype: DTypeLike) -> tuple[AnyArray, AnyArray]:
    """Column and row index of all pixels, [1, w] and [h, 1], on the host."""
    return np.arange(width, dtype=dtype)[None, :], np.arange(height, dtype=dtype)[:, None]


def pixel_slopes(view: View, column: AnyArray, row: AnyArray) -> tuple[AnyArray, AnyArray]:
    """x and y of the rays `(x, y, 1)` through the centres of pixels.

    Twin: `ray_direction` in `rays.glsl`.
    """
    return view.pixel * (column - view.principal[0]), view.pixel * (view.principal[1] - row)


def ray_offsets(aim: Aim, column: AnyArray, row: AnyArray) -> tuple[AnyArray, AnyArray]:
    """mx and my of the rays through the centres of pixels.

    Twin: `ray_offset` in `rays.glsl`.
    """
    mx = aim.slope * (column - aim.anchor[0]) + aim.offset[0]
    my = aim.slope * (aim.anchor[1] - row) + aim.offset[1]
    return mx, my


def _cones(scene: Scene) -> tuple[ShadowCone, ...]:
    if scene.sun is None:
        return ()
    basis, radius = scene.camera.basis(), scene.planet.radius
    toward = basis @ scene.sun.direction
    xp = namespace(toward, scene.sun.angular_radius_deg)
    tangent = xp.tan(xp.deg2rad(scene.sun.angular_radius_deg))
    axes = _complete_basis(toward)

    def cone(center: AnyArray, size: Scalar) -> ShadowCone:
        base = center @ toward
        return ShadowCone(axes, center - base * toward, size - tangent * base, base, tangent)

    further = [cone(basis @ body.center / radius, body.radius / radius) for body in scene.occluders]
    return (cone(xp.zeros(3), xp.ones(())), *further)


def _bodies(scene: Scene) -> tuple[Body, ...]:
    basis, radius = scene.camera.basis(), scene.planet.radius
    bodies = []
    for body in scene.occluders:
        center = basis @ (body.center - scene.camera.position) / radius
        depth = basis[2] @ body.center / radius
        bodies.append(Body(_aim(scene.camera, center), depth, body.radius / radius))
    return tuple(bodies)


def _complete_basis(toward: Float[AnyArray, "3"]) -> Float[AnyArray, "3 3"]:
    """Two unit vectors perpendicular to `toward`, and `toward` itself, as rows."""
    xp = namespace(toward)
    # The axis least aligned with `toward`: the cross product is then at least 0.8 long.
    helper = xp.eye(3)[xp.argmin(xp.abs(toward))]
    first = xp.cross(helper, toward)
    first = first / xp.sqrt(xp.sum(first * first))
    return xp.stack([first, xp.cross(toward, first), toward])
