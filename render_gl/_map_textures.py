"""The planet's maps as textures."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from model_jax import Scene

from ._context import check_texture_size
from ._maps import load_albedo, load_water, relief_heights

if TYPE_CHECKING:
    import moderngl


def upload_maps(
    context: "moderngl.Context", scene: Scene, *, water: bool = False
) -> dict[str, Any]:
    """Textures of relief and albedo, and of water if asked for, by the names of their samplers; a
    colour needs none."""
    maps = {}
    if scene.planet.relief is not None:
        heights = relief_heights(scene.planet)
        rows, columns = heights.shape
        check_texture_size(context, scene.planet.relief, columns, rows)
        relief = context.texture((columns, rows), 1, heights.tobytes(), dtype="f4")
        relief.repeat_y = False
        maps["relief"] = relief
    if isinstance(scene.planet.albedo, str):
        maps["albedo"] = _smooth(context, scene.planet.albedo, load_albedo(scene.planet.albedo))
    if water and scene.planet.water is not None:
        mask = load_water(scene.planet.water)[..., None]
        maps["water"] = _smooth(context, scene.planet.water, mask)
    return maps


def _smooth(context: "moderngl.Context", path: str, pixels: Float[np.ndarray, "h w c"]) -> Any:
    """A texture of half floats that is averaged where it is seen small."""
    import moderngl

    rows, columns, channels = pixels.shape
    check_texture_size(context, path, columns, rows)
    texture = context.texture((columns, rows), channels, pixels.tobytes(), dtype="f2", alignment=1)
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    texture.repeat_y = False
    return texture
