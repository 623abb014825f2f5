from fit import *  # noqa: F403
from model_jax import *  # noqa: F403
from render_gl import *  # noqa: F403

__version__: str
