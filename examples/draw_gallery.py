"""The README's picture of each look, and what two of them do that has to be seen.

    python examples/draw_gallery.py [-o docs]

writes `look-NAME.png`: the planet of `rim.toml` under every look; `rim-spheres.png`: the look `rim`
on two spheres and on one, and their difference; `gradient-faults.png`: the sky of document 004 from
above its shell, at it and in it, at dusk by the ground, and by its lamp instead of the sun.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from model_jax import Camera, Scene, Srgb, Sun, find_look
from render_gl import load_scene, render_image

HERE = Path(__file__).parent
SIZE = (320, 256)
DAY, DUSK = (0.8, -0.5, 0.1), (1.0, 0.12, 0.0)
"""Where the sun is in pictures of faults: high, and 7° below the horizontal, above the horizon of a
camera in the air."""
GALLERY: dict[str, dict[str, Any]] = {
    "layers": {"brightness": 4.0},
    "air+density+saturation": {"brightness": 150.0, "extinction": [60.0, 130.0, 300.0]},
    "rim+gradient+specular": {},
    "gradient+table+mie+veil": {},
}
"""Every look with the terms of its picture, and what differs from the defaults there."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=HERE.parent / "docs")
    output = parser.parse_args().output
    for name in GALLERY:
        path = output / f"look-{name.partition('+')[0]}.png"
        Image.fromarray(picture_of(name)).save(path, optimize=True)
    for name, figure in {"rim-spheres": draw_spheres, "gradient-faults": draw_faults}.items():
        figure().savefig(output / f"{name}.png", dpi=110)


def picture_of(name: str) -> np.ndarray:
    """The planet under a look of the gallery, sRGB."""
    return encoded(drawn(load_scene(HERE / "rim.toml").scene.resized(*SIZE), name, **GALLERY[name]))


def drawn(scene: Scene, name: str, **values: Any) -> np.ndarray:
    """Linear light of a scene."""
    return np.asarray(render_image(scene, find_look(name)(**values)))[..., :3]


def encoded(light: np.ndarray) -> np.ndarray:
    """8-bit sRGB."""
    return np.round(255 * np.asarray(Srgb().encode(np.clip(light, 0, 1)))).astype(np.uint8)


def draw_spheres() -> Figure:
    """The coat on the shell, on the ground, and how far they are apart in the light."""
    scene = load_scene(HERE / "rim.toml").scene.resized(*SIZE)
    thick = replace(scene, atmosphere=replace(scene.atmosphere, height=600.0))
    shown = {}
    for height, case in ((120, scene), (600, thick)):
        two, one = (drawn(case, f"rim+gradient{more}") for more in ("", "+single"))
        shown[f"two spheres, {height} km apart"] = encoded(two)
        shown[f"one sphere instead of {height} km"] = encoded(one)
        apart = np.abs(two - one)
        inside = one.max(axis=-1) > 0
        shown[f"difference: {np.median(apart[inside]):.3f} in the middle"] = encoded(apart)
    return _shown(shown, 3)


def sky_from(height: float, terms: str = "table+mie", sun: tuple[float, ...] = DAY) -> np.ndarray:
    """Linear light from a number of shell heights above document 004's ground, along the limb."""
    scene = load_scene(HERE / "gradient.toml").scene
    radius, shell = float(scene.planet.radius), float(scene.atmosphere.height)
    place = (0.0, -(radius + height * shell), 0.0)
    ahead = (0.9, 0.35 * min(height, 1.0) - 0.1, 0.0)
    camera = Camera(place, ahead, (0.0, -1.0, 0.0), 70.0, *SIZE, 1e-3 * radius, 4.0 * radius)
    return drawn(replace(scene, camera=camera, sun=Sun(sun)), f"gradient+{terms}")


def draw_faults() -> Figure:
    """What document 004 lists as known issues, as they are here."""
    shown = {f"{h:g} shell heights up": sky_from(h) for h in (1.1, 1.02, 1.0, 0.98, 0.9, 0.6)}
    shown |= {
        "dusk by the ground: a painted shell": sky_from(0.02, sun=DUSK),
        "dusk from 0.6 heights": sky_from(0.6, sun=DUSK),
        "the same by the document's lamp": sky_from(0.6, "table+mie+lamp", DUSK),
    }
    return _shown({title: encoded(light) for title, light in shown.items()}, 3)


def _shown(pictures: dict[str, np.ndarray], columns: int) -> Figure:
    rows = -(-len(pictures) // columns)
    figure = Figure((3.2 * columns, 2.8 * rows), layout="constrained")
    grid = np.ravel(figure.subplots(rows, columns))
    for axes, (title, picture) in zip(grid, pictures.items(), strict=False):
        axes.imshow(picture)
        axes.set_title(title, fontsize=9)
    for axes in grid:
        axes.set_axis_off()
    return figure


if __name__ == "__main__":
    main()
