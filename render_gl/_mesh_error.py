"""What a mesh in the layers does to their widths: ground with relief, or the paper's own passes.

A facet lies below the sphere that it stands for, and cuts the map's heights between its corners.
What matters to a fit, which sums over many pixels, is by how much on average. Seen at an angle a
surface that is e too low or too high moves a ray's end by e over the cosine, near tangency by a
root of it.
"""

import numpy as np
from jaxtyping import Float

from model_jax import Scene
from model_jax._analytic import is_ahead
from model_jax._intersect import squared_miss_distance
from model_jax._view import pixel_grid, pixel_slopes, ray_offsets, view_of

from ._choices import Source
from ._maps import relief_heights
from ._mesh import Mesh, sphere_mesh
from ._uniforms import relief_scale


def mesh_width_error(scene: Scene, source: Source) -> Float[np.ndarray, "h w"] | None:
    """How far each pixel's width of air may be off by meshes, scene length units, float32.

    To first order and for the mean over facets, so no bound. None where no mesh is in the layers.
    """
    has_relief = scene.planet.relief is not None
    if source == "raster" and not has_relief:
        return None
    mesh = sphere_mesh(scene.planet.triangles)
    ground = facet_error(mesh, scene)
    view, camera = view_of(scene), scene.camera
    shell = float(view.shell)
    grid = pixel_grid(camera.height, camera.width, np.float64)
    x, y = pixel_slopes(view, *grid)
    squared, dd = squared_miss_distance(x, y, *ray_offsets(view.aim, *grid))

    def moved(radius: float, error: float) -> Float[np.ndarray, "h w"]:
        """By how much the end of a ray moves; 0 where it passes by."""
        inside = radius * radius - squared
        ends = [np.sqrt(np.maximum(inside + more, 0)) for more in (2 * radius * error, 0)]
        return np.asarray(np.where(inside > 0, (ends[0] - ends[1]) / np.sqrt(dd), 0.0))

    met = (squared < 1) & is_ahead(x, y, view.aim)
    error = np.where(met, moved(1.0, ground), 0.0)
    if source == "mesh":
        outer = moved(shell, shell * facet_error(mesh, None))
        # Before the ground a ray loses at the shell what it wins at the ground, but for facets'
        # differences, which are as large.
        error = np.where(met, np.maximum(error, outer), 2 * outer)
    if scene.atmosphere.path == "distance":
        error = error * np.sqrt(dd)
    return np.asarray(error * float(scene.planet.radius), np.float32)


def facet_error(mesh: Mesh, scene: Scene | None) -> float:
    """How far facets' centres lie from the surface on average, planet radii: of the scene's ground,
    or of the bare unit sphere."""
    corners = mesh.vertices[mesh.triangles]
    middle = corners.mean(axis=1)
    if scene is None or scene.planet.relief is None:
        return float(np.mean(1 - np.linalg.norm(middle, axis=1)))
    scale = relief_scale(scene)
    heights = relief_heights(scene.planet)
    ground = 1 + scale * heights_at(heights, mesh.vertices)
    drawn = np.linalg.norm((corners * ground[mesh.triangles][..., None]).mean(axis=1), axis=1)
    true = 1 + scale * heights_at(heights, middle / np.linalg.norm(middle, axis=1, keepdims=True))
    return float(np.mean(np.abs(true - drawn)))


def heights_at(
    heights: Float[np.ndarray, "h w"], direction: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Heights between a map's points, as OpenGL's linear filter has them (`sphere_map.glsl`)."""
    rows, columns = heights.shape
    longitude = np.arctan2(direction[:, 1], direction[:, 0])
    latitude = np.arcsin(np.clip(direction[:, 2], -1, 1))
    x = (longitude / (2 * np.pi) + 0.5) * columns - 0.5
    y = np.clip((0.5 - latitude / np.pi) * rows - 0.5, 0, rows - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = x - left, y - top
    below = np.minimum(top + 1, rows - 1)
    left, right = left % columns, (left + 1) % columns
    upper = (1 - across) * heights[top, left] + across * heights[top, right]
    lower = (1 - across) * heights[below, left] + across * heights[below, right]
    return np.asarray((1 - down) * upper + down * lower)
