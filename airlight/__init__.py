"""airlight under one name: all that `model_jax`, `render_gl` and `fit` offer.

    import airlight

    file = airlight.load_scene("scene.toml")
    result = airlight.fit(airlight.load_photo(file.photo), airlight.render(file.scene), file.look)

Each name is imported from its package when it is first used; JAX alone takes seconds.
"""

from importlib import metadata
from typing import Any

import fit as _fit
import model_jax as _model_jax
import render_gl as _render_gl

_OWNERS = {name: owner for owner in (_model_jax, _render_gl, _fit) for name in owner.__all__}

__all__ = ["__version__", *_OWNERS]  # noqa: PLE0604 (strings, but not yet)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return metadata.version("airlight")
    if name not in _OWNERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_OWNERS[name], name)


def __dir__() -> list[str]:
    return sorted(__all__)
