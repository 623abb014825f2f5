"""`jax.jit` for programs of which only the mathematics is tested, compiled in half the time.

The options are those of `fit._compile`, which says what they leave out; JAX takes them at the
outermost `jit` only.
"""

from functools import partial

import jax

from fit._compile import SHORT_WAIT

jit = partial(jax.jit, compiler_options=SHORT_WAIT)
