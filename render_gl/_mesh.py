"""Meshes in planet radii: the geodesic sphere of planet and shell, and cones of shadow.

A geodesic sphere (subdivided icosahedron) spends its triangles evenly: at 196,020 of them it stays
within 3e-5 radii of the true sphere, a latitude–longitude one of that size only within 1e-4.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float, UInt32

from model_jax import Scene
from model_jax._view import ShadowCone

CONE_SEGMENTS = 1024
"""The cone's polygon is then 1 - cos(π/1024) = 4.7e-6 radii inside its circle."""
SHADOW_MARGIN = 1.01
"""The cone's mesh reaches this many shell radii from the planet's centre; beyond is no air."""


@dataclass(frozen=True)
class Mesh:
    """A closed, convex triangle mesh, counter-clockwise seen from outside."""

    vertices: Float[np.ndarray, "n 3"]
    """float64; a renderer rounds to float32."""
    triangles: UInt32[np.ndarray, "m 3"]

    @property
    def inner_radius(self) -> float:
        """Distance from the origin to the nearest face plane: how far the mesh cuts inside."""
        a, b, c = (self.vertices[self.triangles[:, corner]] for corner in range(3))
        normal = np.cross(b - a, c - a)
        return float(np.min(np.sum(a * normal, axis=1) / np.linalg.norm(normal, axis=1)))


@cache
def sphere_mesh(triangles: int) -> Mesh:
    """Unit geodesic sphere with at least `triangles` triangles (20 n² of them)."""
    n = int(np.ceil(np.sqrt(triangles / 20)))
    corners, faces = _icosahedron()
    # Barycentric grid of one face, rows of constant i; `index` numbers its (n + 1)(n + 2)/2 points.
    i, j = (axis[np.tri(n + 1, dtype=bool)[::-1]] for axis in np.mgrid[: n + 1, : n + 1])
    index = np.full((n + 1, n + 1), -1)
    index[i, j] = np.arange(len(i))
    weights = np.stack([n - i - j, i, j], axis=1) / n
    up = (i + j) < n
    down = (i + j) < n - 1
    iu, ju, idn, jdn = i[up], j[up], i[down], j[down]
    local = np.concatenate(
        [
            np.stack([index[iu, ju], index[iu + 1, ju], index[iu, ju + 1]], axis=1),
            np.stack([index[idn + 1, jdn], index[idn + 1, jdn + 1], index[idn, jdn + 1]], axis=1),
        ]
    )
    # Edge points of neighbouring faces must be the same numbers, or pixels leak through the seams:
    # welding by rounded position does that.
    points = np.concatenate([weights @ corners[face] for face in faces])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    _, first, inverse = np.unique(
        np.round(points * 2**30).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    offsets = np.arange(len(faces))[:, None, None] * len(weights)
    welded = inverse.reshape(-1)[(local[None] + offsets).reshape(-1, 3)]
    return Mesh(points[first], welded.astype(np.uint32))


def cone_mesh(
    axis: Float[np.ndarray, "3"],
    ends: tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]],
    radii: tuple[float, float],
) -> Mesh:
    """A cone between two discs perpendicular to its axis; a radius of 0 is its tip.

    Args:
        axis: unit vector from the second disc to the first.
        ends: centres of the two discs.
        radii: of the two discs, at least 0.
    """
    helper = np.eye(3)[np.argmin(np.abs(axis))]
    e1 = np.cross(helper, axis)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(axis, e1)
    angle = 2 * np.pi * np.arange(CONE_SEGMENTS) / CONE_SEGMENTS
    ring = np.cos(angle)[:, None] * e1 + np.sin(angle)[:, None] * e2
    vertices = np.concatenate(
        [radii[0] * ring + ends[0], radii[1] * ring + ends[1], np.stack(ends)]
    )
    n = CONE_SEGMENTS
    here = np.arange(n)
    there = (here + 1) % n
    base, cap = np.full(n, 2 * n), np.full(n, 2 * n + 1)
    triangles = np.concatenate(
        [
            np.stack([base, here, there], axis=1),
            np.stack([here, here + n, there], axis=1),
            np.stack([there, here + n, there + n], axis=1),
            np.stack([cap, there + n, here + n], axis=1),
        ]
    )
    return Mesh(vertices, triangles.astype(np.uint32))


def shadow_mesh(scene: Scene, cone: ShadowCone) -> tuple[Mesh, bool]:
    """What of a cone can lie in the air, and whether the camera is in it.

    In world axes and planet radii. Occluders may be sixty radii away: cones are cut where the air
    ends on either side.
    """
    assert scene.sun is not None
    basis, toward = np.asarray(scene.camera.basis()), np.asarray(scene.sun.direction)
    reach = SHADOW_MARGIN * float(1 + scene.atmosphere.height / scene.planet.radius)
    middle = np.asarray(cone.center) @ basis
    tangent, radius = float(cone.tangent), float(cone.radius)
    first, last = min(float(cone.base), reach), -reach
    if tangent > 0:
        last = max(last, -radius / tangent)
    ends = (middle + first * toward, middle + last * toward)
    mesh = cone_mesh(toward, ends, (radius + tangent * first, max(radius + tangent * last, 0)))
    offset = np.asarray(scene.camera.position) / float(scene.planet.radius) - middle
    along = float(offset @ toward)
    across = float(np.linalg.norm(offset - along * toward))
    inside = last < along < first and across < radius + tangent * along
    return mesh, inside


def _icosahedron() -> tuple[Float[np.ndarray, "12 3"], list[list[int]]]:
    golden = (1 + 5**0.5) / 2
    corners = np.array(
        [[x, y * golden, 0] for x in (-1, 1) for y in (-1, 1)]
        + [[0, x, y * golden] for x in (-1, 1) for y in (-1, 1)]
        + [[y * golden, 0, x] for x in (-1, 1) for y in (-1, 1)],
        dtype=float,
    )
    # The 20 faces are the triples of corners that are all neighbours (distance 2), wound outward.
    near = np.isclose(np.linalg.norm(corners[:, None] - corners[None], axis=2), 2.0)
    faces = [
        [a, b, c] if np.linalg.det(corners[[a, b, c]]) > 0 else [a, c, b]
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if near[a, b] and near[b, c] and near[a, c]
    ]
    return corners / np.hypot(1, golden), faces
