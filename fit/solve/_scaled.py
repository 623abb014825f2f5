"""Linear algebra with columns of one length: units far apart cost no digits."""

import numpy as np
from jaxtyping import Float

from model_jax._shapes import AnyArray, namespace

RANK = 1e-12
"""Singular values of columns of one length below this share are rounding of sums in float64."""


def unit_diagonal(
    gram: Float[AnyArray, "p p"],
) -> tuple[Float[AnyArray, "p p"], Float[AnyArray, " p"]]:
    """A symmetric matrix with rows and columns scaled to a diagonal of 1 (or -1, where a robust
    loss bends down), and the lengths that they had; 1 for what has none."""
    xp = namespace(gram)
    size = xp.sqrt(xp.abs(xp.diagonal(gram)))
    size = xp.where((size > 0) & xp.isfinite(size), size, 1.0)
    return gram / size[None] / size[:, None], size


def least_squares(
    matrix: Float[np.ndarray, "*n rows columns"], target: Float[np.ndarray, "*n rows"]
) -> tuple[Float[np.ndarray, "*n columns"], Float[np.ndarray, "*n rows"]]:
    """The shortest solutions of linear least squares, n at once, and what they leave over."""
    size = np.linalg.norm(matrix, axis=-2)
    size = np.where(size > 0, size, 1.0)
    scaled = matrix / size[..., None, :]
    found = np.linalg.pinv(scaled, rcond=RANK) @ target[..., None]
    return found[..., 0] / size, target - (scaled @ found)[..., 0]
