"""Exact intersections of rays with spheres and umbra cones, stable in float32.

A ray is `m + τ·d`, `d = (x, y, 1)`, with `m` near the planet (see `_view`). Neither discriminant is
formed as `b² - ac`: a sphere's comes from the squared distance of the ray to the centre, written as
a sum of squares, and a cone's from the difference of two squares below, so that grazing rays keep
the digits that the inputs have. Intervals are `(enter, leave)`; empty when `enter > leave`.
"""

import jax.numpy as jnp

from ._safe import safe_divide, safe_sqrt
from ._shapes import AnyArray, Scalar
from ._view import ShadowCone

Interval = tuple[AnyArray, AnyArray]


def ray_sphere(
    x: AnyArray, y: AnyArray, mx: AnyArray, my: AnyArray, radius: Scalar
) -> tuple[AnyArray, Interval]:
    """Where rays meet a sphere about the origin.

    Returns:
        `(hit, (enter, leave))`: hit is True where the ray's line cuts the sphere; a line that
        misses gets a zero-length interval at its closest approach, with gradient zero in radius.

    Twin: `ray_sphere` in `rays.glsl`.
    """
    squared_distance, dd = squared_miss_distance(x, y, mx, my)
    discriminant = radius * radius - squared_distance
    closest = -(mx * x + my * y) / dd
    half = safe_sqrt(discriminant / dd)
    return discriminant > 0, (closest - half, closest + half)


def squared_miss_distance(
    x: AnyArray, y: AnyArray, mx: AnyArray, my: AnyArray
) -> tuple[AnyArray, AnyArray]:
    """Squared distance of each ray's line to the origin, and `|d|²`.

    `|m × d|² / |d|²` with `m_z = 0` is a sum of squares: nothing cancels.
    """
    dd = 1 + x * x + y * y
    return (mx * mx + my * my + (mx * y - my * x) ** 2) / dd, dd


def ray_cone(x: AnyArray, y: AnyArray, mx: AnyArray, my: AnyArray, cone: ShadowCone) -> Interval:
    """Where rays run inside a solid umbra cone (or half-infinite cylinder).

    With p = m - center, split along the axis s and across it (⟂), `A = p·s`, `B = d·s` and
    `ρ = radius + k A`, the ray is inside the double cone where `a τ² + 2 b τ + c ≤ 0`,
    `a = |d⊥|² - k²B²`, `b = p⊥·d⊥ - k B ρ`, `c = |p⊥|² - ρ²`: the quadratic of the "shafts" source
    document ("GetSphereShadowInOut") regrouped. By Lagrange's identity its discriminant is
    `b² - ac = |ρ d⊥ - k B p⊥|² - (p⊥ × d⊥)²`, a difference of two squares with no large terms.
    The slab `ρ ≥ 0`, `p·s ≤ base` picks the nappe and closes the solid with its base.

    Returns:
        `(enter, leave)`; `enter > leave` where the ray stays outside.

    Twin: `ray_cone` in `rays.glsl`.
    """
    dtype = jnp.result_type(x)
    far = jnp.asarray(jnp.finfo(dtype).max ** 0.25, dtype)  # "infinity" whose square still exists
    k, axes, center = cone.tangent, cone.axes, cone.center

    def along(axis: int) -> tuple[AnyArray, AnyArray]:
        e = axes[axis]
        p = (mx - center[0]) * e[0] + (my - center[1]) * e[1] - center[2] * e[2]
        return p, x * e[0] + y * e[1] + e[2]

    (p1, d1), (p2, d2), (A, B) = along(0), along(1), along(2)
    rho = cone.radius + k * A
    a = d1 * d1 + d2 * d2 - (k * B) ** 2
    b = p1 * d1 + p2 * d2 - k * B * rho
    c = p1 * p1 + p2 * p2 - rho * rho
    q1, q2 = rho * d1 - k * B * p1, rho * d2 - k * B * p2
    turn = p1 * d2 - p2 * d1
    size = safe_sqrt(q1 * q1 + q2 * q2)
    discriminant = (size - jnp.abs(turn)) * (size + jnp.abs(turn))

    # Stable roots: q = -(b + sign(b) √disc), τ = q/a and c/q. Where the ray runs along the cone
    # (a → 0) the first goes to infinity on the side that the sign of b tells.
    sign = jnp.where(b < 0, -1, 1).astype(dtype)
    q = -(b + sign * safe_sqrt(discriminant))
    steep = jnp.where(a < 0, sign, -sign) * far
    first = safe_divide(q, a, steep)
    second = safe_divide(c, q, 0.0)
    low, high = jnp.minimum(first, second), jnp.maximum(first, second)
    # A ray parallel to a cylinder has no roots: it is inside all the way, or not at all.
    parallel = (a == 0) & (b == 0)
    low = jnp.where(parallel, -far, low)
    high = jnp.where(parallel, jnp.where(c <= 0, far, -2 * far), high)
    # a < 0: inside before the first root and after the second, one on each nappe. The shadow's own
    # nappe lies where ρ + k B τ ≥ 0, that is after the roots when B > 0.
    opens = a < 0
    low, high = (
        jnp.where(opens, jnp.where(B > 0, high, -far), low),
        jnp.where(opens, jnp.where(B > 0, far, low), high),
    )
    missed = (discriminant <= 0) & ~parallel & ~opens
    enter, leave = jnp.where(missed, far, low), jnp.where(missed, -far, high)
    for intercept, rate in ((A - cone.base, B), (-rho, -k * B)):
        start, end = _half_line(intercept, rate, far)
        enter, leave = jnp.maximum(enter, start), jnp.minimum(leave, end)
    return enter, leave


def _half_line(intercept: AnyArray, rate: AnyArray, far: AnyArray) -> Interval:
    """The τ with `intercept + rate τ ≤ 0`; empty as (far, -far).

    Twin: `half_line` in `rays.glsl`.
    """
    edge = safe_divide(-intercept, rate, 0.0)
    # Where the quotient leaves the range, the half-line is everything or nothing, as with rate 0.
    # Told by the rate: a compiler may form `intercept` twice, rounded differently, and one that is
    # 0 here and 1e-17 there must not look like a quotient that was refused.
    flat = jnp.abs(intercept) >= jnp.finfo(jnp.result_type(far)).max ** 0.5 * jnp.abs(rate)
    outside = intercept > 0
    start = jnp.where(flat, jnp.where(outside, far, -far), jnp.where(rate < 0, edge, -far))
    end = jnp.where(flat, jnp.where(outside, -far, far), jnp.where(rate > 0, edge, far))
    return start, end
