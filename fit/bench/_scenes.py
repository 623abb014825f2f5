"""What is measured: scenes, photos and looks, built in or of the user's own; what is left out."""

import sysconfig
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    LayersLook,
    Look,
    Planet,
    Scene,
    Sun,
    analytic_layers,
    composite,
    find_look,
)
from render_gl import SceneFile, load_scene

from .._choices import Sampling, Where
from .._compile import float64
from ..photo._photo import Photo, at_photo_size
from ..photo._read import load_photo
from ._problems import Case, make_case

NOISE = 0.02
"""Of the brightest light, five of 256 codes: some noise of a photo. Time does not depend on it."""
SEED = 20261123

SIZE = (1280, 1024)
"""The paper's picture."""

TRUTH = LayersLook(brightness=3.0, shadow=0.2, tint=np.array([0.8, 0.9, 1.3]))
FREE = ("brightness", "shadow", "tint")

THIN = "air+density+saturation"
"""The look that most photos of Earth ask for."""

EVERY = "air+density+top+saturation+sun+upwelling+phase+ground"
"""All that the look has, but for scale heights by channel."""

_EXAMPLES = {
    "paper": "paper.toml",
    "march": "reference.toml",
    "EPIC": "epic.toml",
    "ISS": "iss.toml",
}
"""Scenes of the repository and their files; the last two are of photos that it does not ship."""


@dataclass(frozen=True)
class Known:
    """A scene that can be drawn, and perhaps its photo."""

    name: str
    scene: Scene
    look: Look
    photo: Path | None = None
    settings: Any = None
    """The scene file's own words on its photo."""


def built_in(name: str) -> Known:
    """A scene by its name.

    Raises:
        InputError: its file is not here.
    """
    if name == "synthetic":
        return Known(name, synthetic(*SIZE), TRUTH)
    if name == "extreme":
        return Known(name, extreme(), LayersLook())
    path = _example(_EXAMPLES[name])
    return of_file(load_scene(path), name)


def of_file(file: SceneFile, name: str) -> Known:
    """A scene of a file, with its photo if that is there."""
    own = file.photo.path
    photo = Path(own) if own is not None and Path(own).is_file() else None
    return Known(name, file.scene, file.look, photo, file.photo)


def _example(name: str) -> Path:
    """Beside the packages in a checkout, or where a wheel puts examples."""
    folders = (
        Path(__file__).parents[2] / "examples",
        Path(sysconfig.get_path("data")) / "share" / "airlight" / "examples",
    )
    for folder in folders:
        if (folder / name).is_file():
            return folder / name
    raise InputError(f"examples/{name} is not installed")


def synthetic(width: int, height: int) -> Scene:
    """Air in front of space fills nearly half the picture."""
    return Scene(
        camera=Camera(
            position=np.array([0, 0, 3.2]),
            forward=np.array([0, 0, -1.0]),
            up=np.array([0, 1.0, 0]),
            fov_y_deg=60,
            width=width,
            height=height,
            near=0.5,
            far=6,
        ),
        planet=Planet(radius=0.9, triangles=20_480),
        atmosphere=Atmosphere(height=0.68),
        sun=Sun(direction=np.array([1, 0.2, 0.3])),
    )


def extreme() -> Scene:
    """Air of half a hundredth of the radius, from sixty radii; far/near of a million; a low sun."""
    return Scene(
        camera=Camera(
            position=np.array([0, 0, 60.0]),
            forward=np.array([0, 0, -1.0]),
            up=np.array([0, 1.0, 0]),
            fov_y_deg=2.0,
            width=SIZE[0],
            height=SIZE[1],
            near=1e-4,
            far=100.0,
        ),
        planet=Planet(radius=1.0, triangles=196_000),
        atmosphere=Atmosphere(height=0.005),
        sun=Sun(direction=np.array([1, 0.1, -0.3])),
    )


def noisy(
    scene: Scene, look: Look, noise: float = NOISE
) -> tuple[Layers, Float[np.ndarray, "h w 3"]]:
    """Layers of a scene, and a noisy photo of a look on them, in the middle of pixels."""
    layers = jax.tree.map(np.asarray, analytic_layers(scene, jnp.float32, look))
    clean = np.asarray(composite(layers, look), np.float32)[..., :3]
    grain = np.random.default_rng(SEED).normal(scale=noise * clean.max(), size=clean.shape)
    return layers, (clean + grain).astype(np.float32)


@dataclass(frozen=True)
class Fitted:
    """A photo and its scene, which smaller ones can be made of."""

    scene: str
    look: str
    start: Look
    photo: Float[np.ndarray, "h w 3"] | Photo
    view: Scene
    layers: Layers
    truth: Look | None
    sampling: Sampling
    where: Where
    free: tuple[str, ...] | None

    def case(self) -> Case:
        """All pixels."""
        return self._case(self.photo, self.layers)

    def smaller(self, part: int) -> Case | None:
        """Of the photo with its width and height divided; None where they cannot be."""
        camera = self.view.camera
        if camera.width % part or camera.height % part:
            return None
        rows, columns = camera.height // part, camera.width // part
        small = _shrunk(self.photo, part)
        scene = self.view.resized(columns, rows)
        layers = jax.tree.map(np.asarray, analytic_layers(scene, jnp.float32, self.start))
        return self._case(small, layers)

    def _case(self, photo: Any, layers: Layers) -> Case:
        with float64():
            return make_case(
                self.scene,
                self.look,
                photo,
                layers,
                self.start,
                truth=self.truth,
                sampling=self.sampling,
                where=self.where,
                free=self.free,
            )


def synthetic_fit(name: str, scene: Scene, look: str, width: int, height: int) -> Fitted:
    """A photo made by a look of ours, whose numbers are known."""
    view = scene.resized(width, height)
    shell = float(scene.atmosphere.height)
    kind = find_look(look)
    truth: Look
    start: Look
    free: tuple[str, ...] | None = None
    if kind is LayersLook:
        truth, start, free = TRUTH, LayersLook(1.0, 0.5), FREE
    else:
        truth = kind(brightness=6.0, scale_height=shell / 7)
        start = kind(scale_height=shell / 3.5)
    layers, photo = noisy(view, truth)
    return Fitted(name, look, start, photo, view, layers, truth, "point", "all", free)


def photo_fit(known: Known, look: str, most_pixels: int) -> Fitted:
    """A scene's own photo, as `airlight fit` reads it, or a smaller one where it is too large.

    The ring in front of space is fitted: what is behind is dark there, whatever the ground.
    """
    photo: Any = load_photo(known.settings)
    view = known.scene
    height, width = photo.shape
    view = at_photo_size(view, width, height, str(known.photo))
    part = 1
    while (width // part) * (height // part) > most_pixels or width % part or height % part:
        part += 1
        if part > min(width, height):
            part = 1
            break
    if part > 1:
        photo = _shrunk(photo, part)
        height, width = photo.shape[:2]
    view = view.resized(width, height)
    start = known.look
    if look != start.NAME:
        shell = float(view.atmosphere.height)
        start = LayersLook() if look == LayersLook.NAME else find_look(look)(scale_height=shell / 6)
    layers = jax.tree.map(np.asarray, analytic_layers(view, jnp.float32, start))
    return Fitted(known.name, look, start, photo, view, layers, None, "area", "ring", None)


def _shrunk(photo: Any, part: int) -> Float[np.ndarray, "h w 3"]:
    """Means over squares of pixels, linear light; the photo's sides are whole numbers of them."""
    light = np.asarray(photo.linear if isinstance(photo, Photo) else photo, np.float32)
    height, width, _ = light.shape
    cells = light.reshape(height // part, part, width // part, part, 3)
    return cells.mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
