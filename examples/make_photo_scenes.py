"""Scene files for two real photos, computed from what is known of their cameras.

    python examples/make_photo_scenes.py            # rewrites epic.toml and iss.toml beside it

Provides `epic_scene` and `iss_scene` (the text of the two files), and the check that they are
right: `limb_points` and `limb_isophote` find the limb in a photo, `limb_residuals` and `limb_rms`
compare it with the limb of the scene's sphere. Needs numpy and Pillow only. The photos lie in
`../shared/data` from the project's root, or in the folder named in AIRLIGHT_DATA.

Pixels: (x, y) from the top left corner, pixel centres at half-integers. Lengths: km.
"""

import json
import os
import sys
import tomllib
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).resolve().parent
EPIC_PHOTO = "epic/epic_1b_20220110005515.jpg"
EPIC_POSITIONS = "epic/2022-01-10.txt"
ISS_PHOTO = "iss/iss_d4_56mm.jpg"

EARTH_RADIUS = 6371.0
"""Mean radius, km. Seen from latitude -29° the ellipsoid's outline is 7 km beyond it at the sides
and 9 km within it at top and bottom: +0.5 and -0.6 px for EPIC."""
SUN_RADIUS = 695_700.0
"""Nominal solar radius, km (IAU 2015 resolution B3)."""
SHELL_HEIGHT = 60.0
"""Thickness of the shell, km, in both scenes, so that what is fitted to them can be compared. The
ISS photo's blue rises above its 8-bit noise at about 50 km, and EPIC's ring (2-4 px of 14.9 km)
ends at 45-60 km, its blur included; above that there is nothing to fit."""
AIR_COLOR = (0.333, 0.515, 1.0)
"""Linear rgb of thin air: Rayleigh's λ⁻⁴ at 612, 549 and 465 nm, the sRGB primaries, blue = 1."""

EPIC_ARCSEC = 2.076
"""Angle of a pixel at the image centre, arc seconds (geometry.json)."""
EPIC_SIZE = 1080

ISS_SIZE = (4928, 2768)
"""Columns, rows: the D4's own 16:9 format, so the principal point is the image centre."""
ISS_FOCAL_PX = 56.0 * 136.888885
"""EXIF focal length, mm, times pixels per mm of the sensor (EXIF too): 7665.8 px."""
ISS_PITCH_DEG = 27.00
"""Optical axis below the local horizontal (geometry.json)."""
ISS_ROLL_DEG = 2.08
"""Camera turned clockwise, as its photographer sees it: the limb is lower on the left."""
ISS_BLUE_LEVEL = 0.07
"""Linear blue that marks the "blue edge": half of the faintest plateau below it (0.13)."""
ISS_BLUE_EDGE = 24.0
"""Height of that isophote above the ground, km, ±3: derived, not measured. The ground's own limb
cannot be seen, for grazing air is opaque. Vertical Rayleigh depth 0.20 (460 nm) of an 8.4 km column
gives depth 12 ρ(z)/ρ(0) along a tangent at height z. The level is 0.25 to 0.5 of the plateau, and
with light = 1 - exp(-depth) that is depth 0.3 to 0.7: at 27 to 21 km in the standard atmosphere.
The first clouds, 12 to 25 km below the edge, agree; the photo's tone curve is the doubt."""

LIMB_HEIGHTS = {Path(EPIC_PHOTO).name: 0.0, Path(ISS_PHOTO).name: ISS_BLUE_EDGE}
"""Height, km, of the edge that is measured in each photo above the scene's planet."""
THRESHOLD_PX = 1.0
"""Largest rms distance between scene and photo. A right scene must be allowed, for EPIC, 0.4 px
rms of oblateness and half a pixel of doubt where a 2 px blur has its edge: 0.65 in quadrature.
Small enough that a camera 2 px off fails (1.3 px at least, in any direction)."""


def main() -> int:
    """Write both scene files and print how well they sit on the photos; 1 if one does not."""
    data = data_folder()
    failed = False
    for name, text, photo in (
        ("epic.toml", epic_scene(data), data / EPIC_PHOTO),
        ("iss.toml", iss_scene(data), data / ISS_PHOTO),
    ):
        path = HERE / name
        path.write_text(text, encoding="utf-8")
        _, residuals = limb_residuals(path, photo)
        rms = float(np.sqrt(np.mean(residuals**2)))
        shifted = limb_rms(path, photo, shift_px=(0.0, 2.0)), limb_rms(path, photo, (0.0, -2.0))
        print(
            f"{name}: rms {rms:.2f} px, mean {residuals.mean():+.2f} px over {residuals.size} limb "
            f"points; moved 2 px down {shifted[0]:.2f}, up {shifted[1]:.2f} "
            f"(threshold {THRESHOLD_PX:g})"
        )
        failed |= rms > THRESHOLD_PX
    return int(failed)


def data_folder() -> Path:
    """The reference data: $AIRLIGHT_DATA, else `../shared/data` beside the project."""
    folder = Path(os.environ.get("AIRLIGHT_DATA") or HERE.parents[1] / "shared" / "data")
    if not (folder / EPIC_POSITIONS).is_file():
        raise FileNotFoundError(
            f"{folder / EPIC_POSITIONS} is missing; put the reference data in ../shared/data, "
            "or name its folder in AIRLIGHT_DATA"
        )
    return folder


# --- the scenes ----------------------------------------------------------------------------------


def epic_scene(data: Path) -> str:
    """Text of `epic.toml`: everything from the positions in the metadata, nothing from the photo.

    `data` is the reference data folder. Axes are J2000, so the planet is a plain sphere without
    texture: its rotation angle at that minute is not in the metadata's terms.
    """
    positions = json.loads((data / EPIC_POSITIONS).read_text(encoding="utf-8"))
    camera, sun = (
        np.array([positions[f"{body}_j2000_position"][axis] for axis in "xyz"])
        for body in ("dscovr", "sun")
    )
    distance, sun_distance = np.linalg.norm(camera), np.linalg.norm(sun)
    direction = sun / sun_distance
    phase = np.degrees(np.arccos(direction @ camera / distance))
    half_height = EPIC_SIZE / 2 * np.tan(np.radians(EPIC_ARCSEC / 3600))
    return f"""\
# Earth from DSCOVR, EPIC, {positions["date"]} UTC. Written by make_photo_scenes.py; do not edit.
# Photo: NASA EPIC Team. Lengths in km, J2000 axes, spacecraft and sun as its metadata give them;
# nothing here was shifted to suit the photo. The pixel's angle (2.076") is the one number that
# came from photos of this camera, so the disc's size confirms it only within a pixel or so.
# Phase {phase:.2f}°. At {distance / EARTH_RADIUS:.0f} radii a pixel is 14.9 km, the shell 4 px.

[camera]
position = {_list(camera, 6)}
forward = {_list(-camera / distance, 12)}
up = [0.0, 0.0, 1.0] # J2000 north
fov_y_deg = {np.degrees(2 * np.arctan(half_height)):.10f} # 1080 px of 2.076" at the centre
width = {EPIC_SIZE}
height = {EPIC_SIZE}
near = {distance - 1.05 * EARTH_RADIUS:.1f} # 1.05 radii before and behind the centre
far = {distance + 1.05 * EARTH_RADIUS:.1f}

[planet]
radius = {EARTH_RADIUS} # mean; the ellipsoid's outline is 0.5 px beyond it to 0.6 px within

[atmosphere]
height = {SHELL_HEIGHT}
color = {_list(AIR_COLOR, 3)} # linear; λ⁻⁴

[sun]
direction = {_list(direction, 12)}
angular_radius_deg = {np.degrees(np.arcsin(SUN_RADIUS / sun_distance)):.5f} # at its true distance

[look]
brightness = 3.0
shadow = 0.2

[photo]
path = "../../shared/data/{EPIC_PHOTO}"
tone_curve = "srgb"
"""


def iss_scene(data: Path) -> str:
    """Text of `iss.toml`: EXIF focal length, pitch and roll; the altitude puts the limb in place.

    `data` is the reference data folder. See the comment in the file for what the altitude means.
    """
    pitch, roll = np.radians(ISS_PITCH_DEG), np.radians(ISS_ROLL_DEG)
    forward = np.array([np.cos(pitch), 0.0, -np.sin(pitch)])
    level_right = np.array([0.0, -1.0, 0.0])
    level_up = np.cross(level_right, forward)
    up = level_right * np.sin(roll) + level_up * np.cos(roll)
    columns, rows = ISS_SIZE
    camera = {
        "forward": forward,
        "up": up,
        "fov_y_deg": np.degrees(2 * np.arctan(rows / 2 / ISS_FOCAL_PX)),
        "width": columns,
        "height": rows,
    }
    points = limb_isophote(_linear(data / ISS_PHOTO)[..., 2], ISS_BLUE_LEVEL)
    altitude = round(_altitude(points, camera), 2)
    camera["position"] = np.array([0.0, 0.0, EARTH_RADIUS + altitude])
    near, far = _clip_planes(camera, EARTH_RADIUS + SHELL_HEIGHT)
    return f"""\
# Earth's limb from the ISS, Nikon D4, 2020-11-20. Written by make_photo_scenes.py; do not edit.
# Photo: NASA Johnson Space Center. Lengths in km; the camera stands on the z axis.
#
# The radius is the ground's. Its limb is hidden by air; what the photo shows is the blue edge
# (linear blue {ISS_BLUE_LEVEL:g}), which by Rayleigh optical depth is {ISS_BLUE_EDGE:g} ± 3 km up.
#
# The altitude is not the station's (about 420 km, not known for that minute): it is the one number
# solved for, so that focal length (EXIF), pitch and roll as given put the blue edge where it is.
# At 420 km the limb's curvature asks for f = 51.2 mm and pitch 25.9° instead of 56 mm and 27.0°,
# and fits as well (0.57 px; lens distortion unknown): the photo cannot tell. Heights above the
# limb are up to 1% smaller then. 420 km with 56 mm does not fit at any pitch (3.8 px).
#
# No [sun]: its direction is unknown and no terminator is in the frame, so no shadow volume.

[camera]
position = {_list(camera["position"], 2)}
forward = {_list(forward, 12)} # {ISS_PITCH_DEG:.2f}° below the horizontal
up = {_list(up, 12)} # rolled {ISS_ROLL_DEG:.2f}° clockwise
fov_y_deg = {camera["fov_y_deg"]:.10f} # EXIF 56 mm, 7.305 µm: f = {ISS_FOCAL_PX:.1f} px
width = {columns}
height = {rows}
near = {near:.1f} # 5% clear of the shell's nearest and farthest depth in the frame
far = {far:.1f}

[planet]
radius = {EARTH_RADIUS}

[atmosphere]
height = {SHELL_HEIGHT}
color = {_list(AIR_COLOR, 3)} # linear; λ⁻⁴

[look]
brightness = 3.0
shadow = 0.2

[photo]
path = "../../shared/data/{ISS_PHOTO}"
tone_curve = "srgb"
"""


def _list(numbers: object, digits: int) -> str:
    return "[" + ", ".join(repr(round(float(number), digits) + 0.0) for number in numbers) + "]"


def _altitude(points: np.ndarray, camera: dict) -> float:
    """Height of the camera, km, at which the mean distance of the blue edge from `points` is 0.

    Secant steps from 420 km; the mean distance is close to linear in height (2.7 px per km).
    """

    def offset(height: float) -> float:
        placed = {**camera, "position": np.array([0.0, 0.0, EARTH_RADIUS + height])}
        return float(np.mean(_distance(points, placed, EARTH_RADIUS + ISS_BLUE_EDGE)))

    before, here = 420.0, 480.0
    value, here_value = offset(before), offset(here)
    for _ in range(30):
        if abs(here_value) < 1e-6:
            return here
        step = here_value * (here - before) / (here_value - value)
        before, value = here, here_value
        here -= step
        here_value = offset(here)
    raise RuntimeError(f"no altitude puts the blue edge on the photo; last try {here:g} km")


def _clip_planes(camera: dict, shell: float) -> tuple[float, float]:
    """Eye depths that bracket, with 5% to spare, a sphere's part in the frame; km.

    `shell` is the sphere's radius. Rays that miss it count nothing.
    """
    x, y = np.meshgrid(np.linspace(0, camera["width"], 101), np.linspace(0, camera["height"], 401))
    rays = _rays(np.stack([x.ravel(), y.ravel()], axis=-1), camera)
    along = rays @ camera["position"] / np.sum(rays**2, axis=-1)
    miss = np.sum(np.cross(rays, camera["position"]) ** 2, axis=-1) / np.sum(rays**2, axis=-1)
    half = np.sqrt(np.maximum(shell**2 - miss, 0) / np.sum(rays**2, axis=-1))[miss < shell**2]
    middle = -along[miss < shell**2]
    # The planet hides the far side of most rays; the farthest exit seen is that of a limb ray.
    tangent = miss[miss < shell**2] >= EARTH_RADIUS**2
    return 0.95 * float((middle - half).min()), 1.05 * float((middle + half)[tangent].max())


# --- the check -----------------------------------------------------------------------------------


def limb_rms(
    scene_path: Path | str, photo_path: Path | str, shift_px: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Rms distance, pixels, between a photo's limb and that of the scene's sphere.

    `shift_px` turns the camera so that the scene's planet moves that far (right, down) in the
    picture: the negative check. A limb that runs through the whole frame does not feel a shift
    along itself.
    """
    _, residuals = limb_residuals(scene_path, photo_path, shift_px)
    return float(np.sqrt(np.mean(residuals**2)))


def limb_residuals(
    scene_path: Path | str, photo_path: Path | str, shift_px: tuple[float, float] = (0.0, 0.0)
) -> tuple[np.ndarray, np.ndarray]:
    """Limb points of a photo [n, 2] and their distances [n] beyond the scene's limb, pixels.

    A disc that lies in the frame is measured by `limb_points` on its sunlit half, a limb that
    crosses the frame by `limb_isophote`. Raises ValueError when sizes differ, or for a disc without
    `[sun]`.
    """
    scene = tomllib.loads(Path(scene_path).read_text(encoding="utf-8"))
    camera = _turned(scene["camera"], shift_px)
    image = _linear(Path(photo_path))
    if image.shape[:2] != (camera["height"], camera["width"]):
        raise ValueError(
            f"{photo_path}: {image.shape[1]}×{image.shape[0]} pixels, but {scene_path} says "
            f"{camera['width']}×{camera['height']}; resize neither, check [photo] path"
        )
    radius = scene["planet"]["radius"] + LIMB_HEIGHTS.get(Path(photo_path).name, 0.0)
    centre, disc = _disc(camera, radius)
    inside = np.all(centre > 0) and np.all(centre < [camera["width"], camera["height"]])
    if not inside:
        points = limb_isophote(image[..., 2], ISS_BLUE_LEVEL)
    elif "sun" not in scene:
        raise ValueError(f"{scene_path}: add [sun], it says which half of the disc to measure")
    else:
        toward = _basis(camera) @ np.asarray(scene["sun"]["direction"])
        luminance = image @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        points = limb_points(luminance, centre, disc, float(np.arctan2(toward[1], toward[0])))
    return points, _distance(points, camera, radius)


def limb_points(
    image: np.ndarray, centre: np.ndarray, radius: float, sun_azimuth: float
) -> np.ndarray:
    """Limb of a disc, sub-pixel, on its sunlit half: [361, 2] points (x, y) in pixels.

    `image` [h, w] is linear luminance, `centre` (x, y) and `radius` say where the limb is within
    20 px, `sun_azimuth` is the sun's direction in the picture, radians counter-clockwise from the
    right.

    The limb is where a radial profile, followed inward, passes half the luminance found 6 to 15 px
    inside. In linear light a symmetric blur leaves a step's half level where the step is,
    whatever its width (2 px here), so this is the outer edge of planet, clouds and the lowest
    opaque air as one body; in sRGB code values it would lie 0.7 px farther out. Fainter
    levels measure the ring and the blur's tail (10%: 1.4 px out). On the other half, light fades
    before the limb does and any level is pulled inward, toward the sun.
    """
    azimuth = sun_azimuth + np.radians(np.linspace(-90.0, 90.0, 361))
    step = 0.25
    radii = radius + np.arange(-35.0, 20.0, step)
    x = centre[0] + radii * np.cos(azimuth)[:, None]
    y = centre[1] - radii * np.sin(azimuth)[:, None]
    profiles = _bilinear(image, x, y)
    band = (radii > radius - 15) & (radii < radius - 6)
    level = profiles[:, band].mean(axis=1) / 2
    above = profiles > level[:, None]
    last = above.shape[1] - 1 - np.argmax(above[:, ::-1], axis=1)
    if np.any(last == above.shape[1] - 1) or not np.all(above.any(axis=1)):
        raise ValueError("no limb within 20 px of the disc; check centre and radius")
    row = np.arange(azimuth.size)
    upper, lower = profiles[row, last], profiles[row, last + 1]
    found = radii[last] + step * (upper - level) / (upper - lower)
    return np.stack(
        [centre[0] + found * np.cos(azimuth), centre[1] - found * np.sin(azimuth)], axis=-1
    )


def limb_isophote(blue: np.ndarray, level: float) -> np.ndarray:
    """Upper limb that crosses the frame: [n, 2] points (x, y), pixels, one every 16 columns.

    `blue` [h, w] is linear blue, the channel that thin air scatters most. Each point is where the
    median of 24 columns (against hot pixels and stars), smoothed by 2 px, first exceeds `level`
    from the top. A fixed level, not half of a maximum: below the edge clouds and haze change the
    maximum twofold along the limb, the thin air above is even.
    """
    kernel = np.exp(-0.5 * (np.arange(-6, 7) / 2.0) ** 2)
    kernel /= kernel.sum()
    points = []
    for column in range(16, blue.shape[1] - 15, 16):
        profile = np.convolve(np.median(blue[:, column - 12 : column + 12], axis=1), kernel, "same")
        row = int(np.argmax(profile > level))
        if row == 0:
            raise ValueError(f"column {column}: blue never rises to {level:g} below the top row")
        part = (level - profile[row - 1]) / (profile[row] - profile[row - 1])
        points.append((float(column), row - 1 + part + 0.5))
    return np.array(points)


def _linear(path: Path) -> np.ndarray:
    """Linear rgb [h, w, 3], float32, of an 8-bit sRGB picture."""
    code = np.arange(256) / 255.0
    table = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    with Image.open(path) as picture:
        return table.astype(np.float32)[np.asarray(picture.convert("RGB"))]


def _bilinear(image: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Values at pixel positions inside the picture, pixel centres at half-integers."""
    column, row = np.floor(x - 0.5).astype(int), np.floor(y - 0.5).astype(int)
    right, down = x - 0.5 - column, y - 0.5 - row
    top = image[row, column] * (1 - right) + image[row, column + 1] * right
    bottom = image[row + 1, column] * (1 - right) + image[row + 1, column + 1] * right
    return top * (1 - down) + bottom * down


def _basis(camera: dict) -> np.ndarray:
    """Rows right, up, forward, as `model_jax.Camera.basis`."""
    forward = np.asarray(camera["forward"]) / np.linalg.norm(camera["forward"])
    right = np.cross(forward, camera["up"])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def _pixel(camera: dict) -> float:
    """Side of a pixel on the plane at eye depth 1."""
    return 2 * np.tan(np.radians(camera["fov_y_deg"]) / 2) / camera["height"]


def _turned(camera: dict, shift_px: tuple[float, float]) -> dict:
    """The camera turned so that what is at its centre moves (right, down) by that many pixels."""
    right, up, forward = _basis(camera)
    aim = forward + _pixel(camera) * (-shift_px[0] * right + shift_px[1] * up)
    return {**camera, "position": np.asarray(camera["position"]), "forward": aim, "up": up}


def _rays(points: np.ndarray, camera: dict) -> np.ndarray:
    """World directions [n, 3], of unit eye depth, of pixel positions [n, 2]."""
    x = _pixel(camera) * (points[:, 0] - camera["width"] / 2)
    y = _pixel(camera) * (camera["height"] / 2 - points[:, 1])
    return np.stack([x, y, np.ones_like(x)], axis=-1) @ _basis(camera)


def _disc(camera: dict, radius: float) -> tuple[np.ndarray, float]:
    """Where the sphere's centre projects to (x, y), and its disc's radius if seen on the axis."""
    right, up, depth = -_basis(camera) @ camera["position"]
    scale = 1 / _pixel(camera)
    middle = np.array([camera["width"] / 2, camera["height"] / 2])
    sine = radius / np.linalg.norm(camera["position"])
    return middle + scale * np.array([right, -up]) / depth, scale * np.tan(np.arcsin(sine))


def _distance(points: np.ndarray, camera: dict, radius: float) -> np.ndarray:
    """Distances [n], pixels, of points [n, 2] beyond the limb of a sphere at the origin.

    The limb is the cone of half-angle asin(R / D) about the centre's direction. The angle of a
    pixel's ray beyond it, over that angle's change per pixel, is the distance in the picture.
    """
    toward = -camera["position"]
    limb = np.arcsin(radius / np.linalg.norm(toward))

    def angle(moved: np.ndarray) -> np.ndarray:
        rays = _rays(moved, camera)
        return np.arctan2(np.linalg.norm(np.cross(rays, toward), axis=-1), rays @ toward)

    half = 0.5
    slope = np.hypot(
        *(angle(points + half * axis) - angle(points - half * axis) for axis in np.eye(2))
    )
    return (angle(points) - limb) / slope


if __name__ == "__main__":
    sys.exit(main())
