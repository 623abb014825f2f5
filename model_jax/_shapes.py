"""The array vocabulary: every public signature uses these names.

`h` and `w` are rows and columns of an image, row 0 on top. In the tests jaxtyping's import hook
with beartype checks them at run time, so that a transposed image fails.

The aliases admit NumPy and JAX arrays of any float width: the host works in float64 NumPy, the
device in float32 or float64 JAX, and the same functions serve both.
"""

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

AnyArray = jax.Array | np.ndarray

Depth = Float[AnyArray, "h w"]
"""Eye depth (distance along the camera's axis) relative to a reference, in scene length units."""
Shadows = Float[AnyArray, "*volumes h w"]
"""Eye depths of one shadow volume [h, w], or of several [n, h, w]."""
Width = Float[AnyArray, "h w"]
"""Length of air along the camera's axis, in scene length units or in `width_unit`s."""
Rgb = Float[AnyArray, "h w 3"]
"""Linear light, three channels."""
Rgba = Float[AnyArray, "h w 4"]
"""Linear light, three channels, and coverage in [0, 1]."""
Mask = Bool[AnyArray, "h w"]
"""True where a pixel counts."""
Scalar = float | np.floating | Float[AnyArray, ""]
"""One number: a Python float, a NumPy scalar or a 0-d array (a tracer included)."""


def namespace(*arrays: object) -> ModuleType:
    """`jax.numpy` when any argument is a JAX array or tracer, else `numpy`.

    Lets host code keep float64 where JAX without x64 would silently round to float32.
    """
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(arrays)) else np


def is_traced(*arrays: object) -> bool:
    """Whether any argument holds a tracer: a function is being transformed by JAX."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arrays))
