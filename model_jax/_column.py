"""Columns of air whose density falls exponentially with height, and what they do to light.

With b the distance of a ray's nearest point from the planet's centre, r = √(b² + s²) at the length
s from there, and t = s/√(H (r + b)), so that r - b = H t², the column from s1 to s2 ≥ s1 ≥ 0 is

    2 √H exp(-(r1 - R)/H) ∫ exp(-(t - t1)(t + t1)) (b + H t²)/√(2b + H t²) dt,   t1 to t2

in which nothing is singular, overflows or cancels. Beyond t² = t1² + 10 there is less than 5e-5 of
it, and so Gauss–Legendre's six nodes lie where the air is.

Twins in `column.glsl`.
"""

from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Float

from ._safe import safe_sqrt
from ._shapes import AnyArray

Piece = tuple[AnyArray, AnyArray, AnyArray]

REACH = 10.0
"""t² - t1² at which the integral ends. Largest relative error over all rays and scale heights from
1e-4 to 1 radius: 6.5e-5, of it 4.5e-5 cut off here; with a reach of 7 or of 14 more than 3e-4."""

_X, _W = np.polynomial.legendre.leggauss(6)
NODES = tuple(((1 + x) / 2).item() for x in _X)
"""Where along the piece, 0 to 1."""
SHARES = tuple((w / 2).item() for w in _W)

STEEPEST = 1e-7
"""Least scale height, in distances from the planet's centre: thinner air is a film."""
DEEPEST = 60.0
"""Scale heights below the mean radius beyond which air grows no denser: its exponential exists."""
SERIES_DEPTH = 0.5
"""Optical depth up to which the mean transmittance is a series, of which 2.4e-11 is left out."""


def columns(
    air: tuple[AnyArray, AnyArray],
    dark: tuple[AnyArray, AnyArray] | None,
    altitude: AnyArray,
    impact: AnyArray,
    scale_height: AnyArray,
) -> tuple[AnyArray, AnyArray]:
    """Lit and dark column of a ray, ∫ exp(-(r - R)/H) ds; lengths in any one unit.

    Args:
        air: where on the ray it begins and ends, from the ray's nearest point; begin ≤ end.
        dark: where in it the shadow does, begin ≤ dark ≤ end; None: there is none.
        altitude: height of the nearest point above the radius R, -R to ∞.
        impact: its distance b from the planet's centre, ≥ 0; `impact - altitude` is R > 0.
        scale_height: H; below `STEEPEST` of the distance it counts as that.

    Returns:
        As the arguments broadcast. Largest relative error over all rays 6.5e-5 for H from 1e-4 to
        1 radius; in float32 that and 1e-7 R/H, which are rounded heights. Finite slopes everywhere.

    Source: substitution of the Chapman function's integral (Chapman, "The absorption and
    dissociative or ionizing effect of monochromatic radiation", 1931) that keeps it smooth.
    """
    ends = air if dark is None else (*air, *dark)
    given = jnp.broadcast_arrays(altitude, impact, scale_height, *ends)
    lit, shaded = _columns(*given)
    return lit, jnp.zeros_like(lit) if dark is None else shaded


@jax.custom_jvp
def _columns(*given: jax.Array) -> tuple[jax.Array, jax.Array]:
    return _sum_of_pieces(*given)


@partial(_columns.defjvp, symbolic_zeros=True)
def _columns_jvp(given: Any, tangents: Any) -> Any:
    """Slopes of the quadrature itself, by each argument that moves.

    They are numbers of the pixel: however many parameters push it, the nodes are visited once.
    """
    found = None
    changes = [jnp.zeros_like(given[0])] * 2
    for k, tangent in enumerate(tangents):
        if isinstance(tangent, SymbolicZero):
            continue
        along = tuple(jnp.full_like(p, float(k == i)) for i, p in enumerate(given))
        found, slopes = jax.jvp(_sum_of_pieces, given, along)
        changes = [c + slope * tangent for c, slope in zip(changes, slopes, strict=True)]
    return (_sum_of_pieces(*given) if found is None else found), tuple(changes)


def _sum_of_pieces(
    altitude: jax.Array, impact: jax.Array, scale_height: jax.Array, *ends: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Piece by piece in a loop, whose result XLA keeps instead of making it anew for each use."""
    parts = pieces(ends[:2], ends[2:] or None)

    def add(total: tuple[jax.Array, jax.Array], piece: Any) -> Any:
        near, far, in_shadow = piece
        here = column(near, far, altitude, impact, scale_height)
        return (total[0] + (1 - in_shadow) * here, total[1] + in_shadow * here), None

    zero = jnp.zeros_like(altitude)
    stacked = tuple(jnp.stack(part) for part in zip(*parts, strict=True))
    return jax.lax.scan(add, (zero, zero), stacked)[0]


def column(
    near: AnyArray, far: AnyArray, altitude: AnyArray, impact: AnyArray, scale_height: AnyArray
) -> AnyArray:
    """The same between two distances from the nearest point, on one side of it: 0 ≤ near ≤ far.

    Twin: `column` in `column.glsl`.
    """
    first, last = safe_sqrt(impact * impact + near * near), safe_sqrt(impact**2 + far * far)
    height = jnp.maximum(scale_height, STEEPEST * (first + impact))
    # Of a ray through the centre both are 0 at near = 0, and so is t.
    begin = near / safe_sqrt(_positive(height * (first + impact)))
    end = far / safe_sqrt(_positive(height * (last + impact)))
    # end - begin, from the lengths themselves: of a short piece far out its digits would be gone.
    rise = (far - near) * ((far + near) / _positive(first + last)) / height
    length = rise / _positive(begin + end)
    length = jnp.minimum(length, REACH / (safe_sqrt(begin * begin + REACH) + begin))
    total = jnp.zeros_like(length)
    for node, share in zip(NODES, SHARES, strict=True):
        step = node * length
        t = begin + step
        rise = height * t * t
        total = total + share * jnp.exp(-step * (t + begin)) * (impact + rise) / safe_sqrt(
            _positive(2 * impact + rise)
        )
    # Height above R, without squares of large numbers that cancel.
    low = altitude + near * (near / _positive(first + impact))
    density = jnp.exp(jnp.minimum(-low / height, DEEPEST))
    return 2 * safe_sqrt(height) * density * length * total


def _positive(x: AnyArray) -> AnyArray:
    """What divides: 0 / 0 is 0 here, for the numerator is what makes it 0."""
    return jnp.maximum(x, jnp.finfo(x.dtype).tiny ** 0.5)


def mean_transmittance(depth: AnyArray) -> AnyArray:
    """(1 - exp(-τ))/τ for τ ≥ 0: of light that all of a column sends, what leaves it; 1 at τ = 0.

    The series below, so that neither it nor its slope cancels.

    Twin: `mean_transmittance` in `column.glsl`.
    """
    thin = depth < SERIES_DEPTH
    small = jnp.where(thin, depth, 0)
    series = jnp.ones_like(depth)
    for k in range(10, 1, -1):
        series = 1 - small / k * series
    thick = jnp.where(thin, 1, depth)
    return jnp.where(thin, series, (1 - jnp.exp(-thick)) / thick)


def pieces(air: Sequence[AnyArray], dark: Sequence[AnyArray] | None) -> list[Piece]:
    """A ray's air as pieces, each on one side of its nearest point and wholly lit or dark.

    Arguments as of `columns`.

    Returns:
        (near, far, dark) of each: distances from the nearest point, and 1 where it is dark, else 0.

    Twin: `pieces` in `column.glsl`.
    """
    begin, end = air
    middle = jnp.clip(0.0, begin, end)
    zero = jnp.zeros_like(middle)
    if dark is None:
        cuts, darks = [begin, middle, end], [zero, zero]
    else:
        first, last = dark
        between = jnp.clip(middle, first, last)
        cuts = [begin, jnp.minimum(first, middle), between, jnp.maximum(last, middle), end]
        # The nearest point lies before the shadow, or behind it: then that piece is lit.
        inner = [(middle > first).astype(zero.dtype), (middle < last).astype(zero.dtype)]
        darks = [zero, *inner, zero]
    ends = [jnp.abs(cut) for cut in cuts]
    return [
        (jnp.minimum(a, b), jnp.maximum(a, b), in_shadow)
        for a, b, in_shadow in zip(ends[:-1], ends[1:], darks, strict=True)
    ]


def lengths_to(top: AnyArray, altitude: AnyArray, impact: AnyArray) -> Float[AnyArray, "..."]:
    """Half the chord of a ray in a shell of a height: √((R + top)² - b²), 0 where it passes above.

    As a product, so that a thin shell far away keeps its digits.
    """
    return safe_sqrt((top - altitude) * (2 * impact - altitude + top))
