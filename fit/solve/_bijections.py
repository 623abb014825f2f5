"""Between a bounded value and the unbounded number that a solver moves.

A solver knows no bounds; it moves `u` on the whole line, and these maps take `u` to a value inside
its range. All are smooth, strictly increasing and exactly invertible, and for values far from a
bound they are close to straight lines, which keeps a linear problem nearly linear. The two with one
bound are `lower + s (u + √(u² + 4)) / 2` (slope 1 far above, a hyperbola near the bound), the one
with two is `middle + half-width · u / √(1 + u²)`. Factors of one sum use the isometric log-ratio of
Egozcue et al. ("Isometric logratio transformations for compositional data analysis", Math. Geology
35, 2003): n positive numbers of a fixed sum are n - 1 free ones.

A bound itself lies at infinity: a value on one has to be moved inside by `inside` first.
NaN goes in and comes out.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray, namespace

INSIDE = 1e-3
"""How far `inside` moves a value from its bound, in typical sizes (of a range, in widths)."""


def to_value(
    u: Float[AnyArray, " p"],
    lower: Float[AnyArray, " p"],
    upper: Float[AnyArray, " p"],
    scale: Float[AnyArray, " p"],
) -> Float[AnyArray, " p"]:
    """Values in the open ranges (lower, upper), of typical size `scale` > 0; infinite: no bound."""
    xp = namespace(u, lower, upper, scale)
    low, high = xp.isfinite(lower), xp.isfinite(upper)
    base, top = xp.where(low, lower, 0), xp.where(high, upper, 0)
    both = low & high
    part = xp.where(both, top - base, 1) * _tail(u)
    between = xp.where(u >= 0, top - part, base + part)
    value = xp.where(low, base + scale * _hyperbola(u), top - scale * _hyperbola(-u))
    return xp.where(both, between, xp.where(low | high, value, scale * u))


def from_value(
    value: Float[AnyArray, " p"],
    lower: Float[AnyArray, " p"],
    upper: Float[AnyArray, " p"],
    scale: Float[AnyArray, " p"],
) -> Float[AnyArray, " p"]:
    """The `u` of values that lie inside their ranges; NaN on a bound or outside."""
    xp = namespace(value, lower, upper, scale)
    low, high = xp.isfinite(lower), xp.isfinite(upper)
    base, top = xp.where(low, lower, 0), xp.where(high, upper, 0)
    both = low & high
    width = xp.where(both, top - base, 1)
    # u = w / √(1 - w²) of w in (-1, 1), where 1 - w² = 4 · (way to lower) · (way to upper) / width²
    below, above = (value - base) / width, (top - value) / width
    inner = (below > 0) & (above > 0)
    product = xp.where(both & inner, below, 0.5) * xp.where(both & inner, above, 0.5)
    between = xp.where(inner, (below - above) / (2 * xp.sqrt(product)), xp.nan)
    above_low = _inverse_hyperbola((value - base) / scale)
    below_high = -_inverse_hyperbola((top - value) / scale)
    return xp.where(
        both, between, xp.where(low, above_low, xp.where(high, below_high, value / scale))
    )


def inside(
    value: Float[np.ndarray, " p"],
    lower: Float[np.ndarray, " p"],
    upper: Float[np.ndarray, " p"],
    scale: Float[np.ndarray, " p"],
) -> Float[np.ndarray, " p"]:
    """The values, those on, beyond or very near a bound moved inside by `INSIDE`."""
    width = np.where(np.isfinite(upper - lower), upper - lower, np.inf)
    margin = INSIDE * np.minimum(scale, width)
    return np.minimum(np.maximum(value, lower + margin), upper - margin)


def to_shares(
    u: Float[AnyArray, " m"], basis: Float[AnyArray, "n m"], total: AnyArray | float
) -> Float[AnyArray, " n"]:
    """n positive numbers whose sum is `total`; the columns of `basis` are orthonormal and sum to 0.

    A row of zeros only (a number that is not free) gives a number of no meaning: mask it.
    """
    xp = namespace(u, basis)
    logs = basis @ u
    shares = xp.exp(logs - xp.max(logs))
    member = (basis != 0).any(axis=1)
    shares = xp.where(member, shares, 0)
    return total * shares / xp.where(member.any(), shares.sum(), 1)


def from_shares(
    shares: Float[np.ndarray, " n"], basis: Float[np.ndarray, "n m"]
) -> Float[np.ndarray, " m"]:
    """The coordinates of positive numbers; NaN for what is not positive."""
    member = (basis != 0).any(axis=1)
    positive = np.where(member, shares, 1.0) > 0
    logs = np.where(positive, np.log(np.where(positive & member, shares, 1.0)), np.nan)
    return np.asarray(basis.T @ logs)


def mean_free(members: Sequence[bool]) -> Float[np.ndarray, "n m"]:
    """Orthonormal basis of the directions that keep the sum of the members (Helmert, 1876).

    One row for each entry, zero where it is no member; one column fewer than members.
    """
    rows = np.flatnonzero(members)
    basis = np.zeros((len(members), max(len(rows) - 1, 0)))
    for k in range(1, len(rows)):
        basis[rows[:k], k - 1], basis[rows[k], k - 1] = 1.0, -float(k)
        basis[:, k - 1] /= np.sqrt(k * (k + 1.0))
    return basis


def _tail(u: AnyArray) -> AnyArray:
    """(1 - |u| / √(1 + u²)) / 2 without cancellation: the share of the range beyond a value."""
    xp = namespace(u)
    size = xp.where(u >= 0, u, -u)
    root = xp.hypot(size, 1.0)
    return 0.5 / root / (root + size)


def _hyperbola(u: AnyArray) -> AnyArray:
    """(u + √(u² + 4)) / 2 without cancellation: at -u it is one over what it is at u.

    Both branches are finite with finite slopes for every u, so that reverse mode is, too.
    """
    xp = namespace(u)
    size = xp.where(u >= 0, u, -u)
    above = (size + xp.hypot(size, 2.0)) / 2
    return xp.where(u >= 0, above, 1 / above)


def _inverse_hyperbola(v: AnyArray) -> AnyArray:
    xp = namespace(v)
    positive = v > 0
    held = xp.where(positive, v, 1)
    return xp.where(positive, held - 1 / held, xp.nan)
