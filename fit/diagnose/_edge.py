"""A disc's edge, blurred by a Gaussian: how much of the disc's light is seen beside it.

Beside an edge any law of reflection changes with the root of the depth d below it, for the cosine
of a sphere's slope does; so a disc's light there is a + b √d, and blurred it is a Φ + b F, with
Gauss's integral Φ and a parabolic cylinder function F.
"""

from functools import cache

import numpy as np
from jaxtyping import Bool, Float
from scipy.special import gamma, ndtr, pbdv

from ._limb import Limb

BLUR_PX = (0.25, 4.0)
"""Standard deviations of the camera's blur: below a quarter of a pixel the pixel itself is wider;
above 4 px the disc would show no detail."""
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

Part = slice | Bool[np.ndarray, " _"]


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


def disc_light(
    limb: Limb, p: Float[np.ndarray, "8"], part: Part = slice(None)
) -> Float[np.ndarray, "n 3"]:
    """What arrives of the disc beyond its edge."""
    share, rise = _share(limb, p, part)[0], _rise(limb, p, part)[0]
    return limb.disc[part] * share[:, None] + p[SLOPE] * limb.slope[part] * rise[:, None]


def disc_slopes(
    limb: Limb, p: Float[np.ndarray, "8"], part: Part = slice(None)
) -> list[Float[np.ndarray, "n 8"]]:
    """Derivative of `disc_light` by p, channel by channel."""
    _, of_share = _share(limb, p, part)
    rise, of_rise = _rise(limb, p, part)
    found = []
    for k in range(3):
        slope = limb.slope[part][:, k]
        by = limb.disc[part][:, k, None] * of_share + p[SLOPE] * slope[:, None] * of_rise
        by[:, SLOPE] = slope * rise
        found.append(by)
    return found


def _share(
    limb: Limb, p: Float[np.ndarray, "8"], part: Part
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 8"]]:
    """Share of a disc of even light that arrives, and its derivative."""
    turn = limb.turn[part]
    beyond = limb.distance[part] - turn @ p[SHIFT]
    near, far = beyond * np.exp(-p[BLUR]), beyond / HALO_PX
    sharp, wide = ndtr(-near), ndtr(-far)
    dense, thin = (1 - p[HALO]) * _normal(near), p[HALO] * _normal(far)
    by = np.zeros((len(beyond), PARAMETERS))
    by[:, BLUR] = dense * near
    by[:, SHIFT] = (dense * np.exp(-p[BLUR]) + thin / HALO_PX)[:, None] * turn
    by[:, HALO] = wide - sharp
    return (1 - p[HALO]) * sharp + p[HALO] * wide, by


def _rise(
    limb: Limb, p: Float[np.ndarray, "8"], part: Part
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 8"]]:
    """Root of the depth less what it is where `disc` was taken, blurred; and its derivative."""
    turn, taken = limb.turn[part], limb.root[part]
    blur = np.exp(p[BLUR])
    near = (limb.distance[part] - turn @ p[SHIFT]) / blur
    root, slope = _blurred_root(near)
    dense = _normal(near)
    found = np.sqrt(blur) * root - taken * ndtr(-near)
    by = np.zeros((len(near), PARAMETERS))
    by[:, BLUR] = np.sqrt(blur) * (0.5 * root - slope * near) - taken * dense * near
    by[:, SHIFT] = (-slope / np.sqrt(blur) - taken * dense / blur)[:, None] * turn
    by *= 1 - p[HALO]
    by[:, HALO] = -found
    return (1 - p[HALO]) * found, by


def _normal(t: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    return np.asarray(np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi))


_FAR = 12.0
"""Standard deviations from the edge beyond which the root is that of a sharp edge, or nothing."""


def _blurred_root(
    t: Float[np.ndarray, " n"],
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """F(t) = ∫₀^∞ √s φ(s + t) ds and F′(t); t is the distance beyond the edge in units of the blur.

    F = Γ(3/2) / √(2π) · exp(-t²/4) · D_{-3/2}(t) (DLMF 12.5.1).
    """
    known, value, slope = _table()
    inside = np.maximum(-t, _FAR)
    root = np.where(t < -_FAR, np.sqrt(inside), np.interp(t, known, value, right=0.0))
    return root, np.where(t < -_FAR, -0.5 / np.sqrt(inside), np.interp(t, known, slope, right=0.0))


@cache
def _table() -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
    """F and F′ in steps of a hundredth: interpolated to a hundred-thousandth."""
    t = np.linspace(-_FAR, _FAR, 2401)
    damped = np.exp(-(t**2) / 4) / np.sqrt(2 * np.pi)
    value = gamma(1.5) * damped * pbdv(-1.5, t)[0]
    return t, value, -0.5 * gamma(0.5) * damped * pbdv(-0.5, t)[0]
