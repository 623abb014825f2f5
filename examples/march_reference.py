"""The reference picture of `make demo`, by a ray march that shares nothing with our own model.

    python examples/march_reference.py [-o reference.png] [--width 720] [--height 540]

reads the scene from `reference.toml` beside this file and writes a 16-bit RGB picture in which the
limb, the lit ring, the terminator and the ring in the planet's shadow are all in view. A fit to it
says something, because the light does not come from depth layers of uniform air: numpy in float64
integrates scattering along every line of sight, through air whose density falls exponentially.

What is in it: Rayleigh and aerosol scattering, absorption by ozone, extinction on the way from the
sun and on the way to the camera, the planet's shadow with the penumbra of the sun's disc, a Lambert
ground in the transmitted sunlight, and light scattered more than once. Approximations:

- Scattering after the first is isotropic (`_glow`); of the ground, only the light of the sun's
  disc is reflected. Without the higher orders the shadowed ring would be black where only
  twilight reaches it.
- The part of the sun's disc above the horizon is that above a straight edge (the planet is more
  than 80° in radius as seen from any air), with the extinction of the disc's centre.
- No refraction, no night-time airglow, no stars, no noise. Three wavelengths stand for three
  channels and the sun is white, so colours are those of the air, not of a calibrated camera.

Radiance is per unit of the sun's irradiance outside the air, so its unit is 1/sr.

Measured on this scene at 180 x 135 pixels, as a part of the brightest value (0.07 / sr): from 96
to 192 samples nothing changes by more than 0.001 (2.4e-5 rms, 0.15 steps of an 8-bit sRGB picture),
from 48 to 96 by 0.005; tables of `_glow` twice as fine in all four sizes change 0.0013, and up to
4 % of pixels a thousand times fainter than the brightest; orders of scattering above the fourth
would add 0.008. The picture takes 35 s on one core and is the same, byte for byte, on every run.
"""

import argparse
import struct
import tomllib
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

# Air above this height, km, is too faint to see: 99.9 % of the lit ring's light is below 66.
AIR_TOP = 80.0
# Scattering by air at 680, 550 and 440 nm, per km at sea level, and scale heights in km. Bruneton &
# Neyret, "Precomputed Atmospheric Scattering", EGSR 2008; the aerosols are the default
# of the code published with it, with 0.9 of their extinction being scattering.
RAYLEIGH_SCATTERING = np.array([5.8e-3, 13.5e-3, 33.1e-3])
RAYLEIGH_SCALE_HEIGHT = 8.0
AEROSOL_SCATTERING = 4e-3
AEROSOL_EXTINCTION = AEROSOL_SCATTERING / 0.9
AEROSOL_SCALE_HEIGHT = 1.2
AEROSOL_ASYMMETRY = 0.8

# Absorption by ozone at the same wavelengths, per km at the middle of a layer whose density falls
# linearly to 0 at 15 km above and below 25 km: Hillaire, "A Scalable and Production Ready Sky and
# Atmosphere Rendering Technique", EGSR 2020.
OZONE_ABSORPTION = np.array([0.650e-3, 1.881e-3, 0.085e-3])
OZONE_HEIGHT = 25.0
OZONE_HALF_WIDTH = 15.0

GROUND_ALBEDO = 0.1
"""Mean reflectance of the ground, as in the code of Bruneton & Neyret; oceans have about 0.06."""

SCATTERING_ORDERS = 4
"""How often light may be scattered."""

EXPOSURE = 13.0
"""Stored linear value of radiance 1 sr⁻¹, which keeps the brightest pixel just below 1."""

DEFAULT_SAMPLES = 96
"""Steps along a line of sight."""

RAYS_AT_ONCE = 8192
"""So many rays of one step fit into a core's cache."""

SCENE_FILE = Path(__file__).with_name("reference.toml")


def main() -> None:
    """Read the scene, march, write the picture."""
    scene = tomllib.loads(SCENE_FILE.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("-o", "--output", type=Path, default=SCENE_FILE.with_suffix(".png"))
    parser.add_argument("--width", type=int, default=scene["camera"]["width"])
    parser.add_argument("--height", type=int, default=scene["camera"]["height"])
    parser.add_argument("--samples", type=int, default=DEFAULT_SAMPLES, help="steps along a ray")
    parser.add_argument("--exposure", type=float, default=EXPOSURE, help="times linear radiance")
    options = parser.parse_args()
    radiance = march(scene, options.width, options.height, options.samples)
    options.output.write_bytes(png(srgb_codes(options.exposure * radiance)))


def march(scene: Mapping, width: int, height: int, samples: int = DEFAULT_SAMPLES) -> np.ndarray:
    """Linear radiance `[height, width, 3]`, float64, 1/sr, row 0 on top; background 0.

    `scene` is a parsed scene file: `camera` (position, forward or target, up, fov_y_deg), the
    radius of the `planet` and the `sun`. The shell of `atmosphere` is no input: real air thins out
    with height, and a uniform shell is the model that gets fitted to the picture.
    The picture is seen at `width` by `height` pixels with the scene's vertical field of view.
    """
    radius = float(scene["planet"]["radius"])
    top = radius + AIR_TOP
    sun = _unit(scene["sun"]["direction"])
    sunlight = partial(
        _sunlight,
        depths=_sun_depths(radius, top, 4 * samples),
        radius=radius,
        top=top,
        sun_radius=np.deg2rad(scene["sun"]["angular_radius_deg"]),
    )
    trace = partial(_trace, sun=sun, sunlight=sunlight, radius=radius, top=top)
    glow = None
    for _ in range(SCATTERING_ORDERS - 1):
        glow = _glow(partial(trace, glow=glow, samples=(samples + 1) // 2), sun, radius, top)

    position = np.asarray(scene["camera"]["position"], dtype=np.float64)
    rays = _rays(scene["camera"], width, height).reshape(-1, 3)
    picture = np.zeros_like(rays)
    for start in range(0, len(rays), RAYS_AT_ONCE):
        chunk = slice(start, start + RAYS_AT_ONCE)
        picture[chunk] = trace(position, rays[chunk], glow=glow, samples=samples)
    return picture.reshape(height, width, 3)


def _rays(camera: Mapping, width: int, height: int) -> np.ndarray:
    """Unit directions through the pixel centres, `[height, width, 3]`, row 0 on top."""
    if "target" in camera:
        forward = _unit(np.subtract(camera["target"], camera["position"]))
    else:
        forward = _unit(camera["forward"])
    right = _unit(np.cross(forward, camera["up"]))
    up = np.cross(right, forward)
    half = np.tan(np.deg2rad(camera["fov_y_deg"]) / 2)
    x = (2 * (np.arange(width) + 0.5) / width - 1) * half * width / height
    y = (1 - 2 * (np.arange(height) + 0.5) / height) * half
    return _unit(forward + x[None, :, None] * right + y[:, None, None] * up)


def _trace(
    position: np.ndarray,
    direction: np.ndarray,
    *,
    sun: np.ndarray,
    sunlight: Callable[[np.ndarray, np.ndarray], np.ndarray],
    glow: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
    radius: float,
    top: float,
    samples: int,
) -> np.ndarray:
    """Radiance `[n, 3]` that arrives at `position` (`[n, 3]` or `[3]`) against unit `direction`.

    `sunlight` and `glow` take the distance r from the planet's centre and the cosine mu of the
    sun's zenith angle, and give the sun's irradiance and that of the light scattered before,
    summed over all directions.
    """
    along = np.sum(position * direction, axis=-1)  # of the ray's start, from its nearest point
    nearest2 = np.sum((position - along[:, None] * direction) ** 2, axis=-1)
    half = np.sqrt(np.maximum(top**2 - nearest2, 0))
    hits = (nearest2 < radius**2) & (along < 0)
    start = np.maximum(along, -half)
    ground = np.maximum(-np.sqrt(np.maximum(radius**2 - nearest2, 0)), along)
    end = np.maximum(np.where(hits, ground, half), start)

    height_at_start = np.sum(position * sun, axis=-1)  # toward the sun
    cosine = direction @ sun
    rayleigh_phase = 3 / (16 * np.pi) * (1 + cosine**2)
    aerosol_phase = _cornette_shanks(cosine)

    def sun_cosine(x: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (height_at_start + (x - along) * cosine) / r

    radiance = np.zeros((len(direction), 3))
    transmitted = np.ones_like(radiance)
    for x, step in _steps(start, end, samples):
        r = np.sqrt(nearest2 + x**2)
        mu = sun_cosine(x, r)
        rayleigh, aerosol, extinction = _air(r - radius)
        source = sunlight(r, mu) * (
            rayleigh * rayleigh_phase[:, None] + aerosol * aerosol_phase[:, None]
        )
        if glow is not None:
            source += glow(r, mu) * (rayleigh + aerosol) / (4 * np.pi)
        lost = -np.expm1(-extinction * step[:, None])
        radiance += transmitted * source * (lost / extinction)
        transmitted *= 1 - lost
    mu = sun_cosine(end, np.full_like(end, radius))
    falling = np.maximum(mu, 0)[:, None] * sunlight(np.full_like(end, radius), mu)
    return radiance + hits[:, None] * transmitted * falling * (GROUND_ALBEDO / np.pi)


def _steps(
    start: np.ndarray, end: np.ndarray, samples: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Middle and length of each step from `start` to `end`, both measured from the ray's lowest
    point as if nothing stopped it. Steps grow linearly with the distance from the lowest air that
    is really met, where density varies fastest."""
    lowest = np.clip(0, start, end)
    first, last = -np.sqrt(lowest - start), np.sqrt(end - lowest)

    def edge(k: int) -> np.ndarray:
        root = first + (last - first) * (k / samples)
        return lowest + root * np.abs(root)

    before = edge(0)
    for k in range(1, samples + 1):
        after = edge(k)
        yield (before + after) / 2, after - before
        before = after


def _air(height: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At `height` `[n]` km: scattering by molecules `[n, 3]` and by aerosols `[n, 1]`, and the
    extinction `[n, 3]` by these and by ozone; all per km."""
    height = np.maximum(height, 0)[:, None]
    molecules = RAYLEIGH_SCATTERING * np.exp(-height / RAYLEIGH_SCALE_HEIGHT)
    aerosol = np.exp(-height / AEROSOL_SCALE_HEIGHT)
    ozone = np.maximum(1 - np.abs(height - OZONE_HEIGHT) / OZONE_HALF_WIDTH, 0)
    extinction = molecules + AEROSOL_EXTINCTION * aerosol + OZONE_ABSORPTION * ozone
    return molecules, AEROSOL_SCATTERING * aerosol, extinction


def _cornette_shanks(cosine: np.ndarray) -> np.ndarray:
    """Phase function of aerosols, 1/sr (Cornette & Shanks 1992, as in Bruneton & Neyret)."""
    g = AEROSOL_ASYMMETRY
    numerator = 3 / (8 * np.pi) * (1 - g**2) * (1 + cosine**2)
    return numerator / ((2 + g**2) * (1 + g**2 - 2 * g * cosine) ** 1.5)


def _sunlight(
    r: np.ndarray,
    mu: np.ndarray,
    *,
    depths: np.ndarray,
    radius: float,
    top: float,
    sun_radius: float,
) -> np.ndarray:
    """Irradiance `[n, 3]` square to the sun, 1 outside the air, at distance `r` from the planet's
    centre where the cosine of the sun's zenith angle is `mu`."""
    horizon = np.sqrt(np.maximum(r**2 - radius**2, 0))  # distance to it
    lowest_mu = -horizon / r
    elevation = np.arcsin(np.clip(mu, -1, 1)) - np.arcsin(lowest_mu)
    u = np.clip(elevation / max(sun_radius, 1e-9), -1, 1)
    visible = 0.5 + (np.arcsin(u) + u * np.sqrt(1 - u * u)) / np.pi  # of a disc, above an edge

    mu = np.maximum(mu, lowest_mu)
    longest = np.sqrt(top**2 - radius**2)
    to_top = -r * mu + np.sqrt(np.maximum((r * mu) ** 2 + top**2 - r**2, 0))
    span = horizon + longest - (top - r)
    depth = _bilinear(depths, horizon / longest, (to_top - (top - r)) / np.maximum(span, 1e-9))
    return visible[:, None] * np.exp(-depth)


def _sun_depths(radius: float, top: float, samples: int) -> np.ndarray:
    """Optical depth to the top of the air `[64, 256, 3]` for rays that miss the ground.

    Axes, both 0 to 1: distance to the horizon over its largest value, and where the length of the
    ray lies between its shortest and longest for that height (Bruneton 2017, who thereby keeps the
    horizon, where the depth changes fastest, at the edge of the table).
    """
    longest = np.sqrt(top**2 - radius**2)
    horizon, share = (
        axis.ravel()
        for axis in np.meshgrid(np.linspace(0, longest, 64), np.linspace(0, 1, 256), indexing="ij")
    )
    r = np.sqrt(radius**2 + horizon**2)
    to_top = top - r + share * (horizon + longest - (top - r))
    end = (longest**2 - horizon**2 + to_top**2) / (2 * np.maximum(to_top, 1e-9))
    end = np.where(to_top > 1e-9, end, top)  # of length 0 at the top, straight up
    nearest2 = np.maximum(top**2 - end**2, 0)
    depth = np.zeros((len(r), 3))
    for x, step in _steps(end - to_top, end, samples):
        depth += _air(np.sqrt(nearest2 + x**2) - radius)[2] * step[:, None]
    return depth.reshape(64, 256, 3)


def _glow(
    trace: Callable[[np.ndarray, np.ndarray], np.ndarray],
    sun: np.ndarray,
    radius: float,
    top: float,
    heights: int = 20,
    angles: int = 97,
    zeniths: int = 10,
    azimuths: int = 8,
) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The light that arrives from all sides in the air, as a function of r and mu that returns
    irradiance summed over the sphere of directions, `[n, 3]`.

    The light is the same all around the line planet-sun, so a table over height and the cosine of
    the sun's zenith angle holds all of it, dense near the ground and near the terminator. Each
    entry is an integral of `trace` over directions: Gauss's rule in the zenith's cosine above and
    below the horizon (`zeniths` each) and the middle rule over the half circle of azimuths.
    """
    node = np.linspace(-1, 1, angles)
    mu = (node * np.abs(node))[:, None]
    side = _unit(np.cross(sun, np.eye(3)[np.argmin(np.abs(sun))]))
    zenith = mu * sun + np.sqrt(1 - mu**2) * side
    toward_sun = np.sqrt(1 - mu**2) * sun - mu * side
    azimuth = np.pi * (np.arange(azimuths) + 0.5) / azimuths
    across = np.cos(azimuth)[:, None] * toward_sun[:, None] + np.sin(azimuth)[:, None] * np.cross(
        sun, side
    )
    gauss, weight = np.polynomial.legendre.leggauss(zeniths)
    table = np.zeros((heights, angles, 3))
    for i, u in enumerate(np.linspace(0, 1, heights)):
        r = radius + u**2 * (top - radius)
        horizon = -np.sqrt(max(1 - (radius / r) ** 2, 0))
        down, above = (1 + horizon) / 2, (1 - horizon) / 2
        cosine = np.concatenate([horizon - down + down * gauss, horizon + above + above * gauss])
        share = np.concatenate([down * weight, above * weight]) * 2 * np.pi / azimuths
        for z, solid_angle in zip(cosine, share, strict=True):
            direction = z * zenith[:, None] + np.sqrt(1 - z**2) * across
            start = np.repeat(r * zenith, azimuths, axis=0)
            light = trace(start, direction.reshape(-1, 3))
            table[i] += solid_angle * np.sum(light.reshape(angles, azimuths, 3), axis=1)

    def look_up(r: np.ndarray, mu: np.ndarray) -> np.ndarray:
        height = np.clip((r - radius) / (top - radius), 0, 1)
        mu = np.clip(mu, -1, 1)
        return _bilinear(table, np.sqrt(height), (1 + np.sign(mu) * np.sqrt(np.abs(mu))) / 2)

    return look_up


def _bilinear(table: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """`table[u, v]` `[n, 3]` for u and v in [0, 1] `[n]`; 0 is the first entry and 1 the last."""
    rows, columns, channels = table.shape
    u = np.clip(u, 0, 1) * (rows - 1)
    v = np.clip(v, 0, 1) * (columns - 1)
    i = np.minimum(u.astype(np.int64), rows - 2)
    j = np.minimum(v.astype(np.int64), columns - 2)
    fu, fv = (u - i)[:, None], (v - j)[:, None]
    flat = table.reshape(-1, channels)
    at = i * columns + j
    near = flat[at] * (1 - fv) + flat[at + 1] * fv
    return near * (1 - fu) + (flat[at + columns] * (1 - fv) + flat[at + columns + 1] * fv) * fu


def _unit(vector: np.ndarray) -> np.ndarray:
    vector = np.asarray(vector, dtype=np.float64)
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def srgb_codes(linear: np.ndarray) -> np.ndarray:
    """16-bit sRGB codes (IEC 61966-2-1) of linear values, clipped to 0…1."""
    linear = np.clip(linear, 0, 1)
    bent = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    stored = np.where(linear <= 0.0031308, 12.92 * linear, bent)
    return np.round(65535 * stored).astype(np.uint16)


def png(codes: np.ndarray) -> bytes:
    """A 16-bit RGB PNG of `codes` `[h, w, 3]` (uint16), each row stored as what the average of
    its left and upper neighbours misses (filter 3: smallest for smooth pictures)."""
    height, width, _ = codes.shape
    rows = codes.astype(">u2").view(np.uint8).reshape(height, 6 * width).astype(np.int64)
    left = np.pad(rows, ((0, 0), (6, 0)))[:, : 6 * width]
    above = np.pad(rows, ((1, 0), (0, 0)))[:height]
    filtered = np.empty((height, 1 + 6 * width), dtype=np.uint8)
    filtered[:, 0] = 3
    filtered[:, 1:] = (rows - (left + above) // 2) % 256

    def chunk(kind: bytes, data: bytes) -> bytes:
        check = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)

    header = chunk(b"IHDR", struct.pack(">2I5B", width, height, 16, 2, 0, 0, 0))
    data = chunk(b"IDAT", zlib.compress(filtered.tobytes(), 9))
    return b"\x89PNG\r\n\x1a\n" + header + data + chunk(b"IEND", b"")


if __name__ == "__main__":
    main()
