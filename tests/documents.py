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
