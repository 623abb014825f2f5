"""The words that options of `model_jax` take; without JAX, for command lines to know them."""

from typing import Literal, get_args

Encoding = Literal["window", "reversed", "linear", "log"]
"""What a depth texture's numbers are: window depth in [0, 1] with the near plane at 0, "reversed"
with the near plane at 1, eye depth, or the logarithmic depth of large worlds."""
ENCODINGS: tuple[Encoding, ...] = get_args(Encoding)
