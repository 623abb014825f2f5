"""Documents 003 and 004 in plain NumPy, pixel by pixel with vectors, as a reader would write them
down: nothing of this is taken from the product. What is in no document and the project's own is
marked so.
"""

from dataclasses import dataclass

import numpy as np

from model_jax import Camera, Scene


@dataclass(frozen=True)
class Rays:
    """A ray for each pixel, world axes."""

    eye: np.ndarray
    """[3]"""
    direction: np.ndarray
    """Unit vectors [h, w, 3]."""

    def meet(self, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Whether rays meet a sphere about the origin, and their distances to both points."""
        half = self.direction @ self.eye
        root = half**2 - (self.eye @ self.eye - radius**2)
        hit = root > 0
        root = np.sqrt(np.where(hit, root, 0))
        near, far = -half - root, -half + root
        return hit & (far > 0), near, far

    def at(self, distance: np.ndarray) -> np.ndarray:
        return self.eye + distance[..., None] * self.direction


def rays(camera: Camera) -> Rays:
    """By the camera's definition: square pixels, the axis through the picture's middle."""
    right = np.cross(camera.forward, camera.up)
    right /= np.linalg.norm(right)
    up = np.cross(right, camera.forward)
    side = 2 * np.tan(np.radians(float(camera.fov_y_deg)) / 2) / camera.height
    x = (np.arange(camera.width) + 0.5 - camera.width / 2) * side
    y = (camera.height / 2 - np.arange(camera.height) - 0.5) * side
    direction = np.asarray(camera.forward) + x[None, :, None] * right + y[:, None, None] * up
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return Rays(np.asarray(camera.position, float), direction)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.sum(one * other, axis=-1)


# --- document 003 -------------------------------------------------------------------------------


def general_illumination(degrees: np.ndarray, slump: float) -> np.ndarray:
    """Ours: the document's graph is lost. 1 at 0°, 0 from 90° + slump on, smooth and monotone."""
    last = np.cos(np.radians(90 + slump))
    share = np.clip((np.cos(np.radians(degrees)) - last) / (1 - last), 0, 1)
    return 3 * share**2 - 2 * share**3


def perspective_factor(normal: np.ndarray, view: np.ndarray, exponent: float) -> np.ndarray:
    """`0.3 + 0.2 pow(s, p) + 0.5 pow(s, 20 p)`, s = sin(acos(dot(normal, view)))."""
    sine = np.sin(np.arccos(np.clip(dot(normal, view), -1, 1)))
    return 0.3 + 0.2 * sine**exponent + 0.5 * sine ** (exponent * 20)


def gradient_tint(degrees: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Colours at equal steps of 0 to 180°; between them, ours, linear in the cosine."""
    places = -np.cos(np.linspace(0, np.pi, len(nodes)))
    at = -np.cos(np.radians(degrees))
    return np.stack([np.interp(at, places, nodes[:, c]) for c in range(3)], axis=-1)


@dataclass(frozen=True)
class Rim:
    """Document 003's numbers."""

    brightness: float = 1.0
    opacity: float = 1.0
    exponent: float = 5.0
    slump: float = 27.0
    nodes: np.ndarray | None = None
    """Colours of the gradient [n, 3]; None: one colour."""
    specular: float = 0.0
    shininess: float = 10.0
    single: bool = False


def rim_picture(
    scene: Scene, look: Rim, albedo: np.ndarray, water: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Light [h, w, 3] and the coat's alpha [h, w] of a camera outside of the shell."""
    assert scene.sun is not None
    sun = np.asarray(scene.sun.direction)
    seen = rays(scene.camera)
    radius = float(scene.planet.radius)
    ground, to_ground, _ = seen.meet(radius)
    coat, to_coat, _ = seen.meet(radius + float(scene.atmosphere.height))
    if look.single:
        coat, to_coat = ground, to_ground
    view = -seen.direction

    normal = unit(seen.at(to_ground))
    angle = np.degrees(np.arccos(np.clip(normal @ sun, -1, 1)))
    surface = albedo * general_illumination(angle, look.slump)[..., None]
    if water is not None:
        reflected = 2 * (normal @ sun)[..., None] * normal - sun
        phong = np.maximum(dot(reflected, view), 0) ** look.shininess
        # Ours: less by the sine of the sun's height, instead of a cut at the terminator.
        glint = look.specular * water * phong * np.maximum(normal @ sun, 0)
        surface = surface + glint[..., None]
    surface = np.where(ground[..., None], surface, 0)

    normal = unit(seen.at(to_coat))
    angle = np.degrees(np.arccos(np.clip(normal @ sun, -1, 1)))
    alpha = look.opacity * general_illumination(angle, look.slump)
    alpha = np.where(coat, alpha * perspective_factor(normal, view, look.exponent), 0)
    color = look.brightness * np.asarray(scene.atmosphere.color)[:3]
    colors = color * (gradient_tint(angle, look.nodes) if look.nodes is not None else 1.0)
    # "The same blending equation as traditional transparency."
    blended = colors * alpha[..., None] + surface * (1 - alpha[..., None])
    return blended, alpha


# --- document 004 -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gradient:
    """Document 004's numbers, and what is ours."""

    falloff: float = 1.5
    """fExposure"""
    color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    """What the texture is multiplied by: ours."""
    stretch: float = 0.25
    tweak: float = 0.1
    texture: np.ndarray | None = None
    """Nodes [brightness, height, 4]; None: 1 everywhere."""
    g: float | None = None
    """Atmosphere_G; None: no glow."""
    lamp: float | None = None
    """Distance of the light from the centre, planet radii; None: as far as the sun."""
    veil: bool = False
    """Ours: before the ground height is the air's length on the ray over that at the horizon."""
    clamped: bool = True
    """What is below 0 is 0, as in a target of 8 bits."""
    near: str = "eye"
    """In the air the near point is the camera, as under "Possible Improvements"; "shell": the
    document's own, on the shell behind it."""


def sampled(texture: np.ndarray | None, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Bilinear between nodes at 0 … 1, held at the edges: one interpolation after the other."""
    if texture is None:
        return np.ones((*u.shape, 4))
    columns, rows, _ = texture.shape
    found = np.zeros((*u.shape, 4))
    for c in range(4):
        lines = [
            np.interp(u, np.linspace(0, 1, columns), texture[:, row, c]) for row in range(rows)
        ]
        place = np.clip(v, 0, 1) * (rows - 1)
        below = np.minimum(place.astype(int), rows - 2)
        part, stack = place - below, np.stack(lines)
        one, other = (np.take_along_axis(stack, b[None], 0)[0] for b in (below, below + 1))
        found[..., c] = one * (1 - part) + other * part
    return found


def gradient_picture(scene: Scene, look: Gradient) -> np.ndarray:
    """Light and alpha [h, w, 4] of the sky."""
    assert scene.sun is not None
    seen = rays(scene.camera)
    surface_radius = float(scene.planet.radius)
    atmosphere_radius = surface_radius + float(scene.atmosphere.height)
    cam_pos, ray = seen.eye, seen.direction
    cam_height = float(np.linalg.norm(cam_pos))
    light_dir = np.asarray(scene.sun.direction)

    # The vertex: where the ray leaves the shell; ours also: the ground, where that ends the ray.
    on_shell, to_near, to_far = seen.meet(atmosphere_radius)
    ground, to_ground, _ = seen.meet(surface_radius)
    far_dist = np.where(ground & look.veil, to_ground, to_far)
    position = seen.at(far_dist)
    near_dist = to_near
    if cam_height < atmosphere_radius and look.near == "eye":
        near_dist = np.zeros_like(to_near)
    near_normal = unit(seen.at(near_dist))
    normal = unit(position)

    lc = light_dir @ cam_pos / cam_height
    ln = normal @ light_dir
    lnn = near_normal @ light_dir

    altitude = cam_height - surface_radius
    horizon_dist = np.sqrt(altitude**2 + 2 * surface_radius * altitude)
    max_dot = horizon_dist / cam_height
    altitude = max(0.0, cam_height - atmosphere_radius)
    horizon_dist = np.sqrt(altitude**2 + 2 * atmosphere_radius * altitude)
    min_dot = max(look.tweak, horizon_dist / cam_height)
    min_dot2 = (cam_height - surface_radius) / (atmosphere_radius - surface_radius)
    min_dot2 -= 1 - look.tweak
    min_dot = min(min_dot, min_dot2)
    pos_dot = ray @ (-cam_pos / cam_height) - min_dot
    height = pos_dot / (max_dot - min_dot)
    if look.veil:
        at_horizon = np.sqrt(min(cam_height, atmosphere_radius) ** 2 - surface_radius**2)
        height = np.where(ground, (far_dist - np.maximum(near_dist, 0)) / at_horizon, height)

    ln = np.maximum(0, ln + look.stretch)
    lnn = np.maximum(0, lnn + look.stretch)
    brightness = np.clip(ln + lnn * lc, 0, 1)
    u = brightness * np.clip(lc + 1 + look.stretch, 0, 1)
    v = height
    height = height - np.minimum(0, min_dot2 + ln * min_dot2)
    alpha = height * brightness

    # The fragment.
    diffuse = sampled(look.texture, u, v) * look.color
    color = diffuse * alpha[..., None] * (1 + v)[..., None]
    if look.g is not None:
        diffuse2 = sampled(look.texture, np.minimum(0.5, u), np.ones_like(v)) * look.color
        g2 = look.g**2
        to_light = np.broadcast_to(light_dir, position.shape)
        if look.lamp is not None:
            to_light = look.lamp * surface_radius * light_dir - position
        cosine = dot(unit(to_light), -ray)
        phase = 1.5 * (1 - g2) / (2 + g2) * (1 + cosine**2) / (1 + g2 - 2 * look.g * cosine)
        color = color + diffuse2 * (phase * alpha)[..., None]
    out = 1 - np.exp(-look.falloff * color)
    shown = on_shell & (look.veil | ~ground)
    return np.where(shown[..., None], np.maximum(out, 0) if look.clamped else out, 0)
