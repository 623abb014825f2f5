"""The pictures of the README that show how near looks come to air.

    python examples/draw_looks.py [looks] [limb] [along] [-o docs]

writes `looks.png`: the marched reference picture beside the fits of looks to its ring; `limb.png`:
how light fades with height in a photo from the ISS, and in the fits of two looks; `along.png`: how
it changes along the limb, from below the sun into the night, in photos of whole planets and in two
fits. Photos lie in `../shared/data` from the project's root, or in the folder named in
AIRLIGHT_DATA.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from make_photo_scenes import ISS_PHOTO, data_folder
from matplotlib.figure import Figure
from photos import LOOKS, fit_ring, iss, photos

from fit import FitResult, fit, load_photo
from model_jax import Scene, Srgb, analytic_layers, composite, find_look, limb_height
from render_gl import load_scene

HERE = Path(__file__).parent
CROP = (slice(90, 450), slice(180, 540))
"""Rows and columns of the reference picture around the terminator."""
STEP = 0.3
"""Height of a bin, km: one pixel of the ISS photo."""
CHANNELS = (("red", "#d64550"), ("green", "#2a9d5c"), ("blue", "#3f83e0"))
SATURATED = "air+density+saturation"
STYLES = {"photo": "-", "layers": ":", SATURATED: "--"}
SUNLIT = {SATURATED: ":", f"{SATURATED}+sun+upwelling": "--"}
"""Looks along the limb, and their lines."""
WHOLE = ("EPIC 2022-01-10", "EPIC 2025-07-09", "crescent AS12-50-7364")
SECTOR = 10
"""Degrees of the limb over which light is averaged."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(DRAWN))
    parser.add_argument("-o", "--output", type=Path, default=HERE.parent / "docs")
    asked = parser.parse_args()
    for name in asked.names or DRAWN:
        DRAWN[name]().savefig(asked.output / f"{name}.png", dpi=120)


def draw_limb() -> Figure:
    """Light over height of the ISS photo and two fits."""
    data = data_folder()
    scene = iss(data)
    found = {look: fit_ring(data / ISS_PHOTO, scene, look) for look in LOOKS}
    return draw_profiles(limb_profiles(data / ISS_PHOTO, scene, found))


def draw_pictures() -> Figure:
    """The reference and what each look makes of it, enlarged at the terminator."""
    photo = HERE / "reference.png"
    scene = load_scene(photo.with_suffix(".toml")).scene
    layers = analytic_layers(scene)
    linear = load_photo(photo).linear
    shown = {"marched air of 8 km": linear}
    for name in ("layers", SATURATED, f"{SATURATED}+sun"):
        found = fit(load_photo(photo), layers, find_look(name)())
        ring = found.used[..., None]
        light = np.asarray(composite(layers, found.look))[..., :3]
        title = f"{name.replace(SATURATED + '+', '… +')}: {found.explained:.0%} explained"
        shown[title] = np.where(ring, light, linear)
    figure = Figure((9.6, 2.8), layout="constrained")
    for axes, (title, light) in zip(figure.subplots(1, 4), shown.items(), strict=True):
        axes.imshow(np.asarray(Srgb().encode(np.clip(light, 0, 1)))[CROP])
        axes.set_title(title, fontsize=8)
        axes.set_axis_off()
    return figure


@dataclass(frozen=True)
class Profiles:
    """Mean light at each height above the limb."""

    height: np.ndarray
    """Middles of bins, km `[n]`."""
    light: dict[str, np.ndarray]
    """Of the photo and of each look, linear `[n, 3]`."""

    @property
    def blue_edge(self) -> float:
        """Height where the photo's blue light falls most steeply, km."""
        return float(self.height[np.argmin(np.gradient(self.light["photo"][:, 2]))])

    def residual(self, look: str, above: float) -> float:
        """Root mean square difference from the photo above a height, all channels."""
        seen = self.height >= above
        return float(np.sqrt(np.mean((self.light[look] - self.light["photo"])[seen] ** 2)))


def limb_profiles(photo: Path, scene: Scene, found: Mapping[str, FitResult]) -> Profiles:
    """Means over the pixels used, in bins of `STEP`; bins of half a row of pixels at least."""
    height = limb_height(scene)
    seen = next(iter(found.values())).used & (height > 0)
    number = (height[seen] / STEP).astype(int)
    count = np.bincount(number)
    full = count > scene.camera.width / 2
    layers = analytic_layers(scene)
    pictures = {"photo": load_photo(photo).linear}
    pictures |= {
        name: np.asarray(composite(layers, result.look))[..., :3] for name, result in found.items()
    }
    sums = {
        name: np.stack([np.bincount(number, picture[seen, c]) for c in range(3)], axis=-1)
        for name, picture in pictures.items()
    }
    light = {name: part[full] / count[full, None] for name, part in sums.items()}
    return Profiles((np.flatnonzero(full) + 0.5) * STEP, light)


def draw_profiles(profiles: Profiles) -> Figure:
    figure = Figure((6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, style in STYLES.items():
        for channel, (color, ink) in enumerate(CHANNELS):
            label = name if color == "blue" else None
            light = profiles.light[name][:, channel]
            axes.plot(profiles.height, light, style, color=ink, linewidth=1.2, label=label)
    axes.set(xlabel="height above the limb, km", ylabel="light, linear", xlim=(0, 60))
    axes.legend(frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def azimuths(scene: Scene) -> np.ndarray:
    """Angle of each pixel around the planet's centre, from the sun's side, degrees."""
    assert scene.sun is not None
    camera, basis = scene.camera, np.asarray(scene.camera.basis())
    sun = (basis @ np.asarray(scene.sun.direction))[:2]
    center = -basis @ np.asarray(camera.position)
    right, up = center[:2] / center[2] / float(camera.pixel_size())
    x = np.arange(camera.width) + 0.5 - camera.width / 2 - right
    y = camera.height / 2 - np.arange(camera.height)[:, None] - 0.5 - up
    across, along = x * sun[1] - y * sun[0], x * sun[0] + y * sun[1]
    return np.degrees(np.abs(np.arctan2(across, along)))


def draw_along() -> Figure:
    """Mean light of each sector of a ring, both sides of the sun together, as codes of sRGB."""
    data = data_folder()
    known = photos(data)
    figure = Figure((9.6, 3.2), layout="constrained")
    for axes, name in zip(figure.subplots(1, len(WHOLE)), WHOLE, strict=True):
        path, scene = known[name][0], known[name][1]()
        layers, linear = analytic_layers(scene), load_photo(data / path).linear
        drawn = {"photo": (linear, "-")}
        for look, style in SUNLIT.items():
            found = fit_ring(data / path, scene, look)
            light = np.asarray(composite(layers, found.look))[..., :3]
            drawn[f"{look.replace(SATURATED + '+', '… +')}: {found.explained:.0%}"] = light, style
            used = found.used
        number = (azimuths(scene)[used] / SECTOR).astype(int)
        count = np.bincount(number)
        middle = (np.flatnonzero(count) + 0.5) * SECTOR
        for label, (light, style) in drawn.items():
            for channel, (color, ink) in enumerate(CHANNELS):
                mean = np.bincount(number, light[used, channel])[count > 0] / count[count > 0]
                codes = 255 * np.asarray(Srgb().encode(np.clip(mean, 0, 1)))
                label_once = label if color == "blue" else None
                axes.plot(middle, codes, style, color=ink, linewidth=1.2, label=label_once)
        axes.set(title=name, xlabel="angle from the sun's side, degrees", ylim=(0, None))
        axes.title.set_fontsize(9)
        axes.legend(frameon=False, fontsize=7)
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_xlim(0, 180)
    return figure


DRAWN = {"looks": draw_pictures, "limb": draw_limb, "along": draw_along}


if __name__ == "__main__":
    main()
