"""Column of exponential air between a point and the sun.

Above a point at the distance r from the planet's centre, towards which the sun's direction leads by
m = r·sin(elevation), a length v higher lies √(m² + 2 r v + v²) - m along the sun's ray. With
v² ≈ v·v̄ under the root, v̄ the mean height at which that counts, the column up to the top is

    √(a H) (ρ E(m/√(a H)) - ρ_top E(√(m²/(a H) + (top - h)/H))),   a = 2 r + v̄,

E(t) = ∫ exp(t² - y²) dy from t to ∞. Where the sun is below the horizontal, it is twice the column
above the sun's ray's lowest point less that in the other direction. Nothing overflows or cancels;
where air is uniform v̄ is its whole height, and the chord exact.

Twins in `sunlight.glsl`.
"""

import jax
import jax.numpy as jnp

from ._column import STEEPEST, over
from ._safe import safe_sqrt
from ._shapes import AnyArray

TAIL_RATE = 0.46
TAIL_FACTORS = (0.23, 0.22967748, 0.21231912, 0.11357556, 0.21139873, -0.11074118)
"""E(t) = Σ c_k w^(k+1) with w = 1/(1 + rate·t): least squares, reweighted until the largest
relative error is least, 2.1e-5; c_0 gives 1/(2 t) at large t."""

LOW_SUN = 1.5
HIGH_SUN = 2.0
"""v̄ in scale heights where the sun is at the horizon, and in the zenith, in endless air: the first
terms beyond √(π r H/2) and H in the columns that are known there (x e^x K₁(x), and 1)."""

SUNK = 30.0
"""Scale heights below the mean radius beyond which no ray meets denser air: nothing is left of the
sun's, and squares of its exponential exist in float32."""

ON_GROUND = 0.5
"""Share of the shell's height below which a ray ends on the ground, if it passes its nearest point:
before that nothing else ends it, and behind it shells of a mesh are lower than they should be."""


def sun_column(
    sunward: AnyArray,
    distance: AnyArray,
    height: AnyArray,
    density: AnyArray,
    top: AnyArray,
    scale_height: AnyArray,
) -> AnyArray:
    """Column of air, ∫ exp(-h/H) dl, between points and the sun; lengths in any one unit.

    Args:
        sunward: m, how far the point lies towards the sun from the planet's centre, |m| ≤ distance.
        distance: r, from the planet's centre.
        height: h = r - R.
        density: exp(-h/H).
        top: height at which the air ends; a point above it counts as there.
        scale_height: H.

    Largest error of what passes, exp(-extinction · column): 1e-3 where H ≤ R/20, 0.5 % where H ≤ R.

    Twin: `sun_column` in `sunlight.glsl`.
    """
    at_top = jnp.exp(-top / scale_height)
    above = _outward(jnp.abs(sunward), distance, height, density, at_top, top, scale_height)

    def below() -> AnyArray:
        lowest = safe_sqrt((distance - sunward) * (distance + sunward))
        low = height - sunward * over(sunward, distance + lowest)
        least = jnp.exp(jnp.minimum(-low / scale_height, SUNK))
        through = _outward(0 * sunward, lowest, low, least, at_top, top, scale_height)
        return jnp.where(sunward < 0, jnp.maximum(2 * through - above, 0), above)

    return jax.lax.cond(jnp.any(sunward < 0), below, lambda: above)


def sun_column_at(
    sunward: AnyArray,
    distance: AnyArray,
    height: AnyArray,
    top: AnyArray,
    scale_height: AnyArray,
) -> AnyArray:
    """The same of points whose density is not known; scale heights may be 0.

    Twin: `sun_column_at` in `sunlight.glsl`.
    """
    least = jnp.maximum(scale_height, 2 * STEEPEST * distance)
    density = jnp.exp(jnp.minimum(-height / least, SUNK))
    return sun_column(sunward, distance, height, density, top, least)


def _outward(
    sunward: AnyArray,
    distance: AnyArray,
    height: AnyArray,
    density: AnyArray,
    at_top: AnyArray,
    top: AnyArray,
    scale_height: AnyArray,
) -> AnyArray:
    """The column of a way that only rises, sunward ≥ 0.

    Twin: `outward` in `sunlight.glsl`.
    """
    steep = over(sunward * sunward, 2 * distance * scale_height)
    mean = LOW_SUN + (HIGH_SUN - LOW_SUN) * steep / (1 + steep)
    room = jnp.maximum(top - height, 0) / scale_height
    # (1 + x/8)^-8 in place of exp(-x), which it is near where that matters.
    left = 1 / (1 + room / (8 * mean))
    for _ in range(3):
        left = left * left
    width = 2 * distance + mean * scale_height * (1 - left)
    size = safe_sqrt(width * scale_height)
    begin = over(sunward, size)
    end = safe_sqrt(begin * begin + room)
    return size * jnp.maximum(density * scaled_tail(begin) - at_top * scaled_tail(end), 0)


def scaled_tail(t: AnyArray) -> AnyArray:
    """E(t) = ∫ exp(t² - y²) dy from t to ∞ = √π/2 · exp(t²) erfc(t), for t ≥ 0.

    Twin: `scaled_tail` in `sunlight.glsl`.
    """
    w = 1 / (1 + TAIL_RATE * t)
    found: AnyArray = jnp.full_like(t, TAIL_FACTORS[-1])
    for factor in TAIL_FACTORS[-2::-1]:
        found = factor + w * found
    return w * found
