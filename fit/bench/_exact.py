"""Widths of single pixels in 80-bit numbers: what float64's own rounding is held against.

Written from the textbook's quadratics in world axes, with nothing of what `model_jax` does for
small numbers' sake: 64 bits of mantissa leave room for what cancels. Only for one planet and its
own shadow, and where NumPy has such numbers.
"""

import numpy as np
from jaxtyping import Float, Int

from model_jax import Scene

HAS_80_BITS = np.finfo(np.longdouble).eps < 1e-18


def exact_widths(
    scene: Scene, row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Lit and dark width of pixels, in the scene's length unit."""
    wide = np.longdouble
    camera = scene.camera
    position = np.asarray(camera.position, wide)
    right, up, ahead = _axes(np.asarray(camera.forward, wide), np.asarray(camera.up, wide))
    pixel = 2 * np.tan(np.deg2rad(wide(camera.fov_y_deg)) / 2) / camera.height
    x = (column.astype(wide) + wide(0.5) - wide(camera.width) / 2) * pixel
    y = (wide(camera.height) / 2 - row.astype(wide) - wide(0.5)) * pixel
    way = ahead + x[:, None] * right + y[:, None] * up
    radius = wide(scene.planet.radius)
    near, far = wide(camera.near), wide(camera.far)

    def clamp(depth: np.ndarray) -> np.ndarray:
        return np.clip(depth, near, far)

    enter, leave = _sphere(position, way, radius + wide(scene.atmosphere.height))
    ground, beyond = _sphere(position, way, radius)
    stops = (ground < beyond) & (beyond > 0)
    front, back = clamp(enter), clamp(np.where(stops, np.minimum(ground, leave), leave))
    air = (enter < leave) & (back > front)
    stretch = np.sqrt((way**2).sum(-1)) if scene.atmosphere.path == "distance" else wide(1)
    total = np.where(air, back - front, 0) * stretch
    if scene.sun is None:
        return total.astype(np.float64), np.zeros(len(total))
    dark_from, dark_to = map(clamp, _shadow(scene, position, way, radius))
    inside = np.minimum(back, dark_to) - np.maximum(front, dark_from)
    dark = np.where(air, np.maximum(inside, 0), 0) * stretch
    return (total - dark).astype(np.float64), dark.astype(np.float64)


def _axes(forward: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    ahead = forward / np.sqrt((forward**2).sum())
    right = np.cross(ahead, up)
    right = right / np.sqrt((right**2).sum())
    return right, np.cross(right, ahead), ahead


def _roots(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of a t² + 2 b t + c, a > 0: the lower first; (1, 0) where there are none."""
    discriminant = b * b - a * c
    root = np.sqrt(np.maximum(discriminant, 0))
    q = -(b + np.where(b < 0, -root, root))
    with np.errstate(divide="ignore", invalid="ignore"):
        one, two = q / a, c / q
    low, high = np.minimum(one, two), np.maximum(one, two)
    some = discriminant > 0
    return np.where(some, low, 1), np.where(some, high, 0)


def _sphere(
    position: np.ndarray, way: np.ndarray, radius: np.longdouble
) -> tuple[np.ndarray, np.ndarray]:
    return _roots(
        (way**2).sum(-1), way @ position, np.full(len(way), position @ position - radius * radius)
    )


def _shadow(
    scene: Scene, position: np.ndarray, way: np.ndarray, radius: np.longdouble
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays are in the planet's umbra: the part of its cone that lies behind its centre."""
    wide = np.longdouble
    assert scene.sun is not None
    sun = np.asarray(scene.sun.direction, wide)
    sun = sun / np.sqrt((sun**2).sum())
    angle = np.deg2rad(wide(scene.sun.angular_radius_deg))
    k = np.tan(angle)
    along, step = position @ sun, way @ sun
    beside, turn = position - along * sun, way - step[:, None] * sun
    rho = radius + k * along
    a = (turn**2).sum(-1) - (k * step) ** 2
    b = turn @ beside - k * step * rho
    c = np.full(len(way), beside @ beside - rho * rho)
    low, high = _roots(np.abs(a), np.where(a < 0, -b, b), np.where(a < 0, -c, c))
    none, huge = low > high, wide(1e30)
    # a < 0: steeper than the cone's side, the ray is inside beyond the roots, on two nappes.
    opens, toward = a < 0, step > 0
    enter = np.where(opens, np.where(toward, high, -huge), low)
    leave = np.where(opens, np.where(toward, huge, low), high)
    missed = none & ~opens
    enter, leave = np.where(missed, huge, enter), np.where(missed, -huge, leave)
    with np.errstate(divide="ignore", invalid="ignore"):
        for start, rate in ((along, step), (-rho, -k * step)):  # start + rate t ≤ 0
            edge = -start / rate
            enter = np.where(rate < 0, np.maximum(enter, edge), enter)
            leave = np.where(rate > 0, np.minimum(leave, edge), leave)
            flat = (rate == 0) & (start > 0)
            leave = np.where(flat, -huge, leave)
    return enter, leave
