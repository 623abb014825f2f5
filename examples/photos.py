"""How much of the light around real planets each look explains: the README's table.

    python examples/photos.py                       # every photo, `layers` and the look below
    python examples/photos.py crescent --look air+density auto

Each photo's ring is fitted, every pixel of it; with `+blur`, ring and sky. Of the whole Earth and
of the limb scenes come from positions and lens (`make_photo_scenes.py`); of the others from the
disc in the picture, and what was assumed beside it stands in `ASSUMED`. The photos lie in
`../shared/data` from the project's root, or in the folder named in AIRLIGHT_DATA.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from make_photo_scenes import (
    AIR_COLOR,
    EARTH_RADIUS,
    EPIC_ARCSEC,
    EPIC_SIZE,
    ISS_PHOTO,
    SUN_RADIUS,
    data_folder,
    iss_scene,
)

from fit import FitResult, fit, load_photo
from model_jax import Atmosphere, Camera, Planet, Response, Scene, Sun, analytic_layers, find_look
from render_gl import load_scene

LOOKS = ("layers", "air+density+saturation", "auto")
SHELL = 100.0
"""Height of the shell, km: thinning air ends by itself."""
EPIC_DAYS = {
    "EPIC 2022-01-10": ("2022-01-10.txt", "epic_1b_20220110005515.jpg"),
    "EPIC 2022-06-10": ("2022-06-10.txt", "epic_1b_20220610002712.jpg"),
    "EPIC 2025-06-21": ("ed_2025-06-21_180824.json", "ed_2025-06-21_180824.jpg"),
    "EPIC 2025-07-09": ("ed_2025-07-09_022357.json", "ed_2025-07-09_022357.jpg"),
}
ASSUMED = {
    "crescent AS12-50-7364": "f 8,900 px (250 mm), sun 103° from behind the camera at -49°",
    "limb AS11-44-6692": "f 3,670 px (100 mm), sun at 128° and 77°, from the terminator",
    "Venus": "f 13,000 px, sun at 50° and 170°, from the terminator",
}
"""What photo and records do not tell. Azimuths count from the right, against the clock."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("words", nargs="*", help="photos whose name contains one of these words")
    parser.add_argument("--look", nargs="*", default=LOOKS, metavar="NAME")
    asked = parser.parse_args()
    data = data_folder()
    print("| photo |" + "".join(f" `{look}` |" for look in asked.look))
    print("|---|" + "---:|" * len(asked.look))
    for name, (path, scene) in photos(data).items():
        if not asked.words or any(word.lower() in name.lower() for word in asked.words):
            found = [fit_ring(data / path, scene(), look) for look in asked.look]
            print(f"| {name} |" + "".join(f" {cell(result)} |" for result in found), flush=True)


def photos(data: Path) -> dict[str, tuple[str, Callable[[], Scene]]]:
    """Path below the data folder and scene of each photo, by name."""
    found: dict[str, tuple[str, Callable[[], Scene]]] = {}
    for name, (positions, photo) in EPIC_DAYS.items():
        found[name] = f"epic/{photo}", lambda p=positions: epic(data / "epic" / p)  # type: ignore
    found["limb, ISS"] = ISS_PHOTO, lambda: iss(data)
    circle = {part["file"]: part.get("disc_fit_px") for part in geometry(data)}
    for name, file, focal, size, radius, sun in (
        (
            "crescent AS12-50-7364",
            "apollo/AS12-50-7364.jpg",
            8900.0,
            2000,
            EARTH_RADIUS,
            (103, -49),
        ),
        ("limb AS11-44-6692", "apollo/AS11-44-6692.jpg", 3670.0, 2000, EARTH_RADIUS, (128, 77)),
        ("Venus", "venus/venus.jpg", 13000.0, 1096, 6051.8, (50, 170)),
    ):
        found[name] = file, lambda a=(circle[file], focal, size, radius, sun): disc(*a)  # type: ignore
    return found


def fit_ring(photo: Path, scene: Scene, look: str) -> FitResult:
    """The ring of a photo, every pixel, all that the look has free; with a blur as it comes."""
    kind = find_look("layers" if look == "auto" else look.removesuffix("+blur"))
    names = [n for n in kind.PARAMETERS if n != "shadow" or scene.sun is not None]
    layers, picture = analytic_layers(scene), load_photo(photo)
    if look == "auto":  # what its terms bring is free besides
        return fit(picture, layers, "auto", where="ring", sampling="point", free=names)
    if look.endswith("+blur"):
        return fit(picture, layers, kind(), response=Response(blur=1.0), free=[*names, "blur"])
    return fit(picture, layers, kind(), where="ring", sampling="point", free=names)


def cell(result: FitResult) -> str:
    """Explained share, verdict, the scale height if there is one, and the terms if chosen."""
    explained = "–" if result.explained is None else f"{result.explained:.1%}"
    height = result.parameters.get("scale_height")
    if height is not None:
        explained += f", {height.value:.1f} km"
    blur = result.parameters.get("blur")
    if blur is not None:
        explained += f", {blur.value:.2f} px"
    if result.selection is not None:
        explained += f", {' '.join(result.selection.taken) or 'no term'}"
    return f"{explained}, {result.verdict}"


def epic(positions: Path) -> Scene:
    """The whole Earth from DSCOVR: spacecraft and sun as its metadata give them."""
    known = json.loads(positions.read_text(encoding="utf-8"))
    camera, sun = (
        np.array([known[f"{body}_j2000_position"][axis] for axis in "xyz"])
        for body in ("dscovr", "sun")
    )
    distance, sun_distance = np.linalg.norm(camera), np.linalg.norm(sun)
    half = EPIC_SIZE / 2 * np.tan(np.radians(EPIC_ARCSEC / 3600))
    return Scene(
        Camera(
            position=camera,
            forward=-camera,
            up=np.array([0.0, 0.0, 1.0]),
            fov_y_deg=float(np.degrees(2 * np.arctan(half))),
            width=EPIC_SIZE,
            height=EPIC_SIZE,
            near=float(distance - 1.05 * EARTH_RADIUS),
            far=float(distance + 1.05 * EARTH_RADIUS),
        ),
        Planet(EARTH_RADIUS),
        Atmosphere(SHELL, color=np.array(AIR_COLOR)),
        Sun(sun, float(np.degrees(np.arcsin(SUN_RADIUS / sun_distance)))),
    )


def iss(data: Path) -> Scene:
    """The limb from the station, with the shell of `iss.toml`: 60 km."""
    path = Path(__file__).with_name("iss.toml")
    if path.read_text(encoding="utf-8") != iss_scene(data):
        raise SystemExit("iss.toml: is not what make_photo_scenes.py writes; run that first")
    return load_scene(path).scene


def disc(
    circle: tuple[float, ...], focal: float, size: int, radius: float, sun: tuple[float, float]
) -> Scene:
    """A planet whose outline is a circle in a square picture, x and y of pixels' middles.

    Args:
        circle: x, y and radius, px, the first pixel's middle at 0.
        focal: focal length, px.
        size: pixels across.
        radius: the planet's, km.
        sun: degrees from the direction of the camera, and azimuth in the picture.
    """
    angle = np.linspace(0, 2 * np.pi, 720)
    x, y = circle[0] + circle[2] * np.cos(angle), circle[1] + circle[2] * np.sin(angle)
    seen = (x > 0) & (x < size - 1) & (y > 0) & (y < size - 1)
    # The rays through a sphere's outline lie on a cone: axis · ray = cos(half its angle). What is
    # seen of the circle tells it; off the axis the whole outline is an ellipse.
    rays = np.stack([x + 0.5 - size / 2, size / 2 - y - 0.5, np.full_like(x, focal)], axis=-1)[seen]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    axis = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
    aim = axis / np.linalg.norm(axis)
    center = radius / np.sin(np.arccos(1 / np.linalg.norm(axis))) * aim
    phase, azimuth = np.radians(sun)
    toward = -aim
    # In the picture's axes, turned so that the angle from the camera is what was said.
    right = np.cross([0.0, 1.0, 0.0], -toward)
    right /= np.linalg.norm(right)
    up = np.cross(-toward, right)
    across_sky = np.cos(azimuth) * right + np.sin(azimuth) * up
    to_sun = np.cos(phase) * toward + np.sin(phase) * across_sky
    flip = np.array([1.0, 1.0, -1.0])  # x right, y up, and the camera looks along -z
    depth = center[2]
    return Scene(
        Camera(
            position=-center * flip,
            forward=np.array([0.0, 0.0, -1.0]),
            up=np.array([0.0, 1.0, 0.0]),
            fov_y_deg=float(np.degrees(2 * np.arctan(size / 2 / focal))),
            width=size,
            height=size,
            near=float(depth - 1.1 * radius),
            far=float(depth + 1.1 * radius),
        ),
        Planet(radius),
        Atmosphere(SHELL, color=np.array(AIR_COLOR)),
        Sun(to_sun * flip, 0.27),
    )


def geometry(data: Path) -> list[dict]:
    """Discs of the photos."""
    return json.loads((data / "geometry.json").read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
