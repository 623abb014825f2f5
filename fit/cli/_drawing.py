"""Pictures of `airlight render`: size, combine, file."""

from typing import TYPE_CHECKING, Any

from model_jax._errors import InputError

from .._choices import LayerSource

if TYPE_CHECKING:
    from model_jax import Layers, Look, Scene


def draw_scene(
    scene: "Scene", look: "Look", source: LayerSource, depth_format: str
) -> "tuple[Layers, Any]":
    """Layers, and the picture by their source's own combine: JAX's for analytic, else the shader's.

    Drawn once.
    """
    import render_gl
    from model_jax import composite

    from ._job import make_layers

    if source == "analytic":
        layers = make_layers(scene, source, depth_format, look)
        return layers, composite(layers, look)
    return render_gl.render_layers_and_image(scene, look, depth_format, source)


NOTHING_IN_VIEW = (
    "nothing is in view, neither planet nor air; check camera.position and camera.forward or target"
)


def in_view(layers: "Layers") -> bool:
    """Some pixel shows the planet, or air."""
    import numpy as np

    return bool(np.any(layers.has_air) or (layers.planet is not None and np.any(layers.planet)))


def parse_size(text: str) -> tuple[int, int]:
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise InputError(f"--size {text}: must be WIDTHxHEIGHT in pixels, such as 640x480")
    return int(width), int(height)


def write_png(out: str, picture: Any) -> None:
    import numpy as np
    from PIL import Image

    from model_jax import Srgb
    from render_gl import write_whole

    stored = np.clip(Srgb().encode(np.asarray(picture, np.float64)[..., :3]), 0.0, 1.0)
    image = Image.fromarray(np.round(stored * 255).astype(np.uint8))
    write_whole(out, lambda path: image.save(path, format="PNG"))
