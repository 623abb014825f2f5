"""Columns of air whose density falls exponentially with height, and what they do to light.

With b the distance of a ray's nearest point from the planet's centre, r = √(b² + s²) at the length
s from there, and t = s/√(H (r + b)), so that r - b = H t², the column from s1 to s2 ≥ s1 ≥ 0 is

    2 √H exp(-(r1 - R)/H) ∫ exp(-(t - t1)(t + t1)) (b + H t²)/√(2b + H t²) dt,   t1 to t2

in which nothing is singular, overflows or cancels. Beyond t² = t1² + 10 there is less than 5e-5 of
it, and so Gauss–Legendre's six nodes lie where the air is.

Twins in `column.glsl`.
"""

import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_derivatives import SymbolicZero

from ._safe import safe_sqrt
from ._shapes import AnyArray

Piece = tuple[AnyArray, AnyArray, AnyArray, AnyArray]
Span = tuple[AnyArray, AnyArray]
"""Where something on a ray begins and ends, from the ray's nearest point."""

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
    air: Span,
    dark: Span | None,
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
    near, far, shade, _ = (jnp.stack(part) for part in zip(*pieces(air, dark), strict=True))
    given = jnp.broadcast_arrays(near, far, altitude[None], impact[None], scale_height[None])
    found = _each(*given)
    if dark is None:
        return found.sum(0), jnp.zeros_like(found[0])
    return ((1 - shade) * found).sum(0), (shade * found).sum(0)


@jax.custom_jvp
def _each(*given: jax.Array) -> jax.Array:
    """`column` of each piece, in a loop: XLA keeps its result instead of making it for each use."""
    return jax.lax.map(lambda piece: _if_any(piece)[0], given)


@partial(_each.defjvp, symbolic_zeros=True)
def _each_jvp(given: Any, tangents: Any) -> Any:
    """Slopes are numbers of the pixel: however many parameters push it, its nodes are visited once,
    and they give all of them."""
    found, slopes = jax.lax.map(_if_any, given)
    change = jnp.zeros_like(found)
    for slope, tangent in zip(slopes, tangents, strict=True):
        if not isinstance(tangent, SymbolicZero):
            change = change + slope * tangent
    return found, change


def _if_any(piece: Any) -> Any:
    """A column and its slopes; of pieces that no ray has, as of a shadow elsewhere, in no time."""
    near, far = piece[:2]
    zero = jnp.zeros_like(near)
    return jax.lax.cond(
        jnp.any(near != far), lambda: _quadrature(*piece), lambda: (zero, (zero,) * 5)
    )


def column(
    near: AnyArray, far: AnyArray, altitude: AnyArray, impact: AnyArray, scale_height: AnyArray
) -> AnyArray:
    """The same between two distances from the nearest point, on one side of it: 0 ≤ near ≤ far.

    Twin: `column` in `column.glsl`.
    """
    given = jnp.broadcast_arrays(near, far, altitude, impact, scale_height)
    return _each(*(part[None] for part in given))[0]


def _quadrature(
    near: AnyArray, far: AnyArray, altitude: AnyArray, impact: AnyArray, scale_height: AnyArray
) -> tuple[AnyArray, tuple[AnyArray, ...]]:
    """A column, and its slopes by the arguments, under the integral:

        -ρ1, ρ2, -(column)/H, ∫ρ (1 - b/r) ds/H, ∫ρ (r - R) ds/H²

    and by H what the end moves, where the integral is cut off: 5e-4 of the last, which is then as
    exact as the column. By the first four 5e-5 of ρ1 is left out likewise.
    """
    way = rise_of(near, far, altitude, impact, scale_height)
    first, height, begin, length = way.first, way.height, way.begin, way.length
    total, of_height, of_impact = (jnp.zeros_like(length) for _ in range(3))
    for node, share in zip(NODES, SHARES, strict=True):
        step = node * length
        t = begin + step
        fall = step * (t + begin)
        above = height * t * t
        piece = share * jnp.exp(-fall) / safe_sqrt(positive(2 * impact + above))
        of_impact = of_impact + piece * above
        piece = piece * (impact + above)
        total = total + piece
        of_height = of_height + piece * fall
    depth = -way.low / height
    density = jnp.exp(jnp.minimum(depth, DEEPEST))
    scale = 2 * safe_sqrt(height) * density * length
    found = scale * total
    moved = first + REACH * height
    cut = REACH * math.exp(-REACH) * density * moved
    further = way.reached * safe_sqrt(height * (moved + impact))
    cut = jnp.where(way.whole > length, cut / positive(further), 0)
    by_height = scale * (of_height - depth * total) / height + cut
    slopes = (
        -density,
        density * jnp.exp(-way.rise),
        -found / height,
        scale * of_impact / height,
        jnp.where(scale_height < way.least, 0, by_height),
    )
    return found, slopes


class Rise(NamedTuple):
    """How a piece rises from its nearest point, t as in the module."""

    first: AnyArray
    """Distance from the centre at its near end."""
    low: AnyArray
    """Height there."""
    height: AnyArray
    """Scale height, at least `least`."""
    least: AnyArray
    begin: AnyArray
    """t at the near end."""
    rise: AnyArray
    """t² - t1² at the far end."""
    whole: AnyArray
    """t2 - t1 there."""
    length: AnyArray
    """The same as far as it counts."""
    reached: AnyArray
    """t where it ends, if it reaches as far as it counts."""


def rise_of(
    near: AnyArray, far: AnyArray, altitude: AnyArray, impact: AnyArray, scale_height: AnyArray
) -> Rise:
    """The way of a piece, as of `column`.

    Twin: `rise_of` in `column.glsl`.
    """
    first, last = safe_sqrt(impact * impact + near * near), safe_sqrt(impact**2 + far * far)
    least = STEEPEST * (first + impact)
    height = jnp.maximum(scale_height, least)
    # Of a ray through the centre both are 0 at near = 0, and so is t.
    begin = over(near, safe_sqrt(height * (first + impact)))
    end = over(far, safe_sqrt(height * (last + impact)))
    # end - begin, from the lengths themselves: of a short piece far out its digits would be gone.
    rise = (far - near) * over(far + near, first + last) / height
    whole = over(rise, begin + end)
    reached = safe_sqrt(begin * begin + REACH)
    length = jnp.minimum(whole, REACH / (reached + begin))
    # Height above R, without squares of large numbers that cancel.
    low = altitude + near * over(near, first + impact)
    return Rise(first, low, height, least, begin, rise, whole, length, reached)


def place_at(along: AnyArray, altitude: AnyArray, impact: AnyArray) -> tuple[AnyArray, AnyArray]:
    """Height, and distance from the planet's centre, at a length from a ray's nearest point.

    Twin: `place_at` in `column.glsl`.
    """
    distance = safe_sqrt(impact * impact + along * along)
    return altitude + along * over(along, distance + impact), distance


def over(numerator: AnyArray, denominator: AnyArray) -> AnyArray:
    """The quotient, and 0 where both are next to nothing; slopes of any order are numbers."""
    least = jnp.finfo(denominator.dtype).tiny ** 0.5
    there = denominator > least
    return jnp.where(there, numerator / jnp.where(there, denominator, 1), 0)


def positive(x: AnyArray) -> AnyArray:
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
        (near, far, dark, before) of each: distances from the nearest point, 1 where it is dark, and
        where it lies before that point, else 0.

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
    before = [(a + b < 0).astype(zero.dtype) for a, b in itertools.pairwise(cuts)]
    return [
        (jnp.minimum(a, b), jnp.maximum(a, b), in_shadow, early)
        for a, b, in_shadow, early in zip(ends[:-1], ends[1:], darks, before, strict=True)
    ]


def below(
    top: AnyArray, air: Span, dark: Span | None, altitude: AnyArray, impact: AnyArray
) -> tuple[Span, Span | None]:
    """What of air and shadow lies below a height.

    Half the chord in a shell of that height is √((R + top)² - b²), 0 where the ray passes above; as
    a product, so that a thin shell far away keeps its digits.
    """
    reach = safe_sqrt((top - altitude) * (2 * impact - altitude + top))
    begin, end = (jnp.clip(part, -reach, reach) for part in air)
    if dark is None:
        return (begin, end), None
    return (begin, end), (jnp.clip(dark[0], begin, end), jnp.clip(dark[1], begin, end))
