"""A disc's edge, blurred by a Gaussian: how much of the disc's light is seen beside it.

Beside an edge any law of reflection changes with the root of the depth d below it, for the cosine
of a sphere's slope does; so a disc's light there is a + b √d, and blurred it is a Φ + b F, with
Gauss's integral Φ and a parabolic cylinder function F.
"""

from functools import cache

import numpy as np
from jaxtyping import Float
from scipy.special import gamma, ndtr, pbdv

from ._limb import Limb

BLUR_PX = (0.25, 4.0)
"""Standard deviations of the camera's blur: below a quarter of a pixel the pixel itself is wider;
above 4 px the disc would show no detail."""
SHARP_PX = 1.3
"""Blur up to which a limb is resolved."""
MAX_SHIFT_PX = 3.0
"""How far the edge may lie from where it was taken for: two pixels of the scene, one of its own
relief or of where the sun still reaches it."""
HALO_PX = 8.0
MAX_HALO = 0.1
"""Halo of lens and film: a share of the light, spread much farther than the blur. More than a tenth
next to the disc would be a fault of the camera."""
RISE = (-1.0, 2.0)
"""How much of the disc's slope by the root of the depth goes on to its edge: 1, were it known
without noise and from light without blur."""

BLUR, SHIFT, HALO, SLOPE = 0, slice(1, 6), 6, 7
PARAMETERS = 8
"""Of an edge: log of the blur, outward, right, down and two of the doubled angle, halo, rise."""


def within(p: Float[np.ndarray, "8"]) -> Float[np.ndarray, "8"]:
    """The nearest allowed edge."""
    found = p.copy()
    found[BLUR] = np.clip(p[BLUR], *np.log(BLUR_PX))
    out, right, down, wide, slanted = p[SHIFT]
    farthest = abs(out) + np.hypot(right, down) + np.hypot(wide, slanted)
    found[SHIFT] *= min(1.0, MAX_SHIFT_PX / max(farthest, 1e-30))
    found[HALO] = np.clip(p[HALO], 0, MAX_HALO)
    found[SLOPE] = np.clip(p[SLOPE], *RISE)
    return found


def disc_light(limb: Limb, p: Float[np.ndarray, "8"]) -> Float[np.ndarray, "n 3"]:
    """What arrives of the disc beyond its edge."""
    return _combined(limb, p, *_profile(limb, p)[:2])


def disc_slopes(
    limb: Limb, p: Float[np.ndarray, "8"]
) -> tuple[Float[np.ndarray, "n 3"], list[Float[np.ndarray, "n 8"]]]:
    """`disc_light` and its derivative by p, channel by channel."""
    share, rise, near, sharp, wide = _profile(limb, p)
    of_share = _share_slopes(p, near, sharp, wide)
    of_rise = _rise_slopes(limb, p, near, rise)
    found = []
    for k in range(3):
        disc, slope = limb.disc[:, k, None], limb.slope[:, k]
        # By the blur, outward and the halo; any way the edge moves, it moves outward somewhere.
        by = disc * of_share + p[SLOPE] * slope[:, None] * of_rise
        full = np.empty((len(near), PARAMETERS), order="F")
        full[:, BLUR], full[:, HALO] = by[:, 0], by[:, 2]
        full[:, SHIFT] = by[:, 1, None] * limb.turn
        full[:, SLOPE] = slope * rise
        found.append(full)
    return _combined(limb, p, share, rise), found


def _combined(
    limb: Limb,
    p: Float[np.ndarray, "8"],
    share: Float[np.ndarray, " n"],
    rise: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    return limb.disc * share[:, None] + limb.slope * (p[SLOPE] * rise)[:, None]


def _profile(limb: Limb, p: Float[np.ndarray, "8"]) -> tuple[Float[np.ndarray, " n"], ...]:
    """What a disc of even light and the root of the depth make of the light beyond an edge.

    Returns:
        The share of even light that arrives; the root, less what it is where `disc` was taken,
        blurred; the distance beyond the edge in units of the blur; the shares without halo, and of
        the halo alone.
    """
    beyond = limb.distance - limb.turn @ p[SHIFT]
    near = beyond * np.exp(-p[BLUR])
    sharp, wide = ndtr(-near), ndtr(beyond * (-1 / HALO_PX))
    rise = np.exp(0.5 * p[BLUR]) * _blurred_root(near) - limb.root * sharp
    return (1 - p[HALO]) * sharp + p[HALO] * wide, (1 - p[HALO]) * rise, near, sharp, wide


def _share_slopes(
    p: Float[np.ndarray, "8"],
    near: Float[np.ndarray, " n"],
    sharp: Float[np.ndarray, " n"],
    wide: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """Derivative of the share by the blur, by the edge's shift outward, and by the halo."""
    dense = (1 - p[HALO]) * _normal(near)
    thin = p[HALO] * _normal(near * (np.exp(p[BLUR]) / HALO_PX))
    outward = dense * np.exp(-p[BLUR]) + thin / HALO_PX
    return np.stack([dense * near, outward, wide - sharp]).T


def _rise_slopes(
    limb: Limb,
    p: Float[np.ndarray, "8"],
    near: Float[np.ndarray, " n"],
    rise: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 3"]:
    """The same of the rise."""
    blur, light = np.exp(p[BLUR]), 1 - p[HALO]
    slope, dense = _blurred_root_slope(near), limb.root * _normal(near)
    by_blur = np.sqrt(blur) * (0.5 * _blurred_root(near) - slope * near) - dense * near
    outward = -slope / np.sqrt(blur) - dense / blur
    return np.stack([light * by_blur, light * outward, rise * (-1 / light)]).T


def _normal(t: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi))


_FAR = 12.0
"""Standard deviations from the edge beyond which the root is that of a sharp edge, or nothing."""


def _blurred_root(t: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """F(t) = ∫₀^∞ √s φ(s + t) ds; t is the distance beyond the edge in units of the blur.

    F = Γ(3/2) / √(2π) · exp(-t²/4) · D_{-3/2}(t) (DLMF 12.5.1).
    """
    root = _looked_up(_table()[0], t)
    deep = t < -_FAR
    root[deep] = np.sqrt(-t[deep])
    return root


def _blurred_root_slope(t: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """F′(t)."""
    slope = _looked_up(_table()[1], t)
    deep = t < -_FAR
    slope[deep] = -0.5 / np.sqrt(-t[deep])
    return slope


_PER_UNIT = 100


def _looked_up(
    values: Float[np.ndarray, " m"], t: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Linear between even steps, which need no search as `np.interp` makes one."""
    place = np.clip((t + _FAR) * _PER_UNIT, 0, len(values) - 1)
    below = np.minimum(place.astype(np.int32), len(values) - 2)
    low = values.take(below)
    return np.asarray(low + (place - below) * (values.take(below + 1) - low))


@cache
def _table() -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """F and F′ in steps of a hundredth: interpolated to a hundred-thousandth; nothing at the
    end."""
    t = np.linspace(-_FAR, _FAR, round(2 * _FAR * _PER_UNIT) + 1)
    damped = np.exp(-(t**2) / 4) / np.sqrt(2 * np.pi)
    damped[-1] = 0.0
    value = gamma(1.5) * damped * pbdv(-1.5, t)[0]
    return value, -0.5 * gamma(0.5) * damped * pbdv(-0.5, t)[0]
