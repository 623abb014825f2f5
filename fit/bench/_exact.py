"""Widths of single pixels in numbers of 50 digits: what float64's own rounding is held against.

Written from the textbook's quadratics in world axes, with nothing of what `model_jax` does for
small numbers' sake: 50 digits leave room for what cancels. Only for one planet and its own shadow.
"""

from typing import Any

import mpmath
import numpy as np
from jaxtyping import Float, Int

from model_jax import Scene

DIGITS = 50
"""Of which a camera a million radii away from a shell of a millionth takes 24."""

_HUGE = mpmath.mpf("1e40")
"""Farther than any far plane."""

Numbers = np.ndarray
"""Of `mpmath.mpf`."""


def exact_widths(
    scene: Scene, row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Lit and dark width of pixels, in the scene's length unit, rounded to float64 at the end."""
    with mpmath.workdps(DIGITS):
        lit, dark = _widths(scene, row, column)
    return lit.astype(np.float64), dark.astype(np.float64)


def wide(values: Any) -> Numbers:
    """Doubles as they are, without rounding."""
    doubles = np.asarray(values, np.float64)
    return np.asarray(np.frompyfunc(lambda x: mpmath.mpf(float(x)), 1, 1)(doubles), object)


def _widths(
    scene: Scene, row: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]
) -> tuple[Numbers, Numbers]:
    camera = scene.camera
    position = wide(camera.position)
    right, up, ahead = _axes(wide(camera.forward), wide(camera.up))
    pixel = 2 * mpmath.tan(_radians(camera.fov_y_deg) / 2) / camera.height
    half = mpmath.mpf(0.5)
    x = (wide(column) + half - half * camera.width) * pixel
    y = (half * camera.height - wide(row) - half) * pixel
    way = ahead + x[:, None] * right + y[:, None] * up
    radius, shell = wide(scene.planet.radius)[()], wide(scene.atmosphere.height)[()]
    near, far = wide(camera.near)[()], wide(camera.far)[()]

    def clamp(depth: Numbers) -> Numbers:
        return np.minimum(np.maximum(depth, near), far)

    enter, leave = _sphere(position, way, radius + shell)
    ground, beyond = _sphere(position, way, radius)
    stops = (ground < beyond) & (beyond > 0)
    front, back = clamp(enter), clamp(np.where(stops, np.minimum(ground, leave), leave))
    air = (enter < leave) & (back > front)
    stretch = _root((way**2).sum(-1)) if scene.atmosphere.path == "distance" else 1
    total = np.where(air, back - front, 0) * stretch
    if scene.sun is None:
        return total, 0 * total
    dark_from, dark_to = map(clamp, _shadow(scene, position, way, radius))
    inside = np.minimum(back, dark_to) - np.maximum(front, dark_from)
    dark = np.where(air, np.maximum(inside, 0), 0) * stretch
    return total - dark, dark


def _radians(degrees: Any) -> mpmath.mpf:
    return wide(degrees)[()] * mpmath.pi / 180


def _root(values: Any) -> Any:
    return np.frompyfunc(mpmath.sqrt, 1, 1)(values)


def _ratio(above: Numbers, below: Numbers) -> Numbers:
    """Where below is 0: far away."""
    none = below == 0
    sign = np.where(above < 0, -1, 1)
    return np.where(none, sign * _HUGE, above / np.where(none, mpmath.mpf(1), below))


def _axes(forward: Numbers, up: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    ahead = forward / _root((forward**2).sum())
    right = np.cross(ahead, up)
    right = right / _root((right**2).sum())
    return right, np.cross(right, ahead), ahead


def _roots(a: Numbers, b: Numbers, c: Numbers) -> tuple[Numbers, Numbers]:
    """Of a t² + 2 b t + c, a ≥ 0: the lower first; (1, 0) where there are none."""
    discriminant = b * b - a * c
    root = _root(np.maximum(discriminant, 0))
    q = -(b + np.where(b < 0, -root, root))
    one, two = _ratio(q, a), _ratio(c, q)
    some = discriminant > 0
    low = np.where(some, np.minimum(one, two), 1)
    high = np.where(some, np.maximum(one, two), 0)
    always = (a == 0) & (b == 0) & (c < 0)  # a ray along a cylinder, inside
    return np.where(always, -_HUGE, low), np.where(always, _HUGE, high)


def _sphere(position: Numbers, way: Numbers, radius: mpmath.mpf) -> tuple[Numbers, Numbers]:
    c = np.full(len(way), position @ position - radius * radius)
    return _roots((way**2).sum(-1), way @ position, c)


def _shadow(
    scene: Scene, position: Numbers, way: Numbers, radius: mpmath.mpf
) -> tuple[Numbers, Numbers]:
    """Where rays are in the planet's umbra: the part of its cone that lies behind its centre."""
    assert scene.sun is not None
    sun = wide(scene.sun.direction)
    sun = sun / _root((sun**2).sum())
    k = mpmath.tan(_radians(scene.sun.angular_radius_deg))
    along, step = position @ sun, way @ sun
    beside, turn = position - along * sun, way - step[:, None] * sun
    rho = radius + k * along
    a = (turn**2).sum(-1) - (k * step) ** 2
    b = turn @ beside - k * step * rho
    c = np.full(len(way), beside @ beside - rho * rho)
    opens, toward = a < 0, step > 0
    low, high = _roots(abs(a), np.where(opens, -b, b), np.where(opens, -c, c))
    missed = (low > high) & ~opens
    # a < 0: steeper than the cone's side, the ray is inside beyond the roots, on two nappes.
    enter = np.where(opens, np.where(toward, high, -_HUGE), low)
    leave = np.where(opens, np.where(toward, _HUGE, low), high)
    enter, leave = np.where(missed, _HUGE, enter), np.where(missed, -_HUGE, leave)
    for start, rate in ((along, step), (-rho, -k * step)):  # start + rate t ≤ 0
        edge = -_ratio(np.full(len(way), start), rate)
        enter = np.where(rate < 0, np.maximum(enter, edge), enter)
        leave = np.where(rate > 0, np.minimum(leave, edge), leave)
        flat = (rate == 0) & (start > 0)
        leave = np.where(flat, -_HUGE, leave)
    return enter, leave
