"""The array vocabulary: every public signature uses these names.

`h` and `w` are rows and columns of an image, row 0 on top. In the tests jaxtyping's import hook
with beartype checks them at run time, so that a transposed image fails.
"""

import numpy as np
from jax import Array
from jaxtyping import Bool, Float

type ArrayLike = Array | np.ndarray
