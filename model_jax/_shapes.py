"""The array vocabulary: every public signature uses these names.

`h` and `w` are rows and columns of an image, row 0 on top. In the tests jaxtyping's import hook
with beartype checks them at run time, so that a transposed image fails.

The aliases admit NumPy and JAX arrays of any float width: the host works in float64 NumPy, the
device in float32 or float64 JAX, and the same functions serve both.
"""

from collections.abc import Callable
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ._errors import InputError, shown

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

if TYPE_CHECKING:
    # A field holds an array, and its constructor takes any numbers in a row: Python's types have no
    # word for a field whose converter takes more than it gives (PEP 681).
    Three = Any
    Four = Any
else:
    Three = Float[AnyArray, "3"]
    Four = Float[AnyArray, "4"]


def namespace(*arrays: object) -> ModuleType:
    """`jax.numpy` when any argument is a JAX array or tracer, else `numpy`.

    Lets host code keep float64 where JAX without x64 would silently round to float32.
    """
    return jnp if any(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(arrays)) else np


def converter(name: str) -> Callable[[object], Scalar | AnyArray]:
    """What turns the value of the record's field `name` into float64 on the host; JAX arrays and
    tracers stay what they are.

    It raises `InputError` naming the field for what is no number or list of numbers, and for whole
    numbers beyond the range of floats.
    """

    def convert(value: object) -> Scalar | AnyArray:
        if isinstance(value, jax.Array):
            return value
        try:
            array = np.asarray(value)
            # NumPy would read "3" as 3 and None as nan.
            if array.dtype.kind in "USTMmc" or any(
                item is None or isinstance(item, str | bytes)
                for item in (array.flat if array.dtype.kind == "O" else ())
            ):
                raise TypeError
            return array.astype(np.float64)[()]
        except OverflowError:
            problem = "is beyond the range of numbers, ±1.8e308"
        except (TypeError, ValueError):
            problem = "is not a number or a list of numbers"
        raise InputError(f"{name}: {shown(value)} {problem}; give a finite number")

    return convert


def is_traced(*arrays: object) -> bool:
    """Whether any argument holds a tracer: a function is being transformed by JAX."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(arrays))
