"""`jax.jit` for programs of which only the mathematics is tested, compiled in half the time.

The options are those of `fit._compile`, which says what they leave out; JAX takes them at the
outermost `jit` only.
"""

from functools import partial

import jax

QUICK = {"xla_cpu_use_fusion_emitters": False}
jit = partial(jax.jit, compiler_options=QUICK)
