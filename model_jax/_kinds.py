"""What public functions were given: a slip is named, with what to give instead.

Python would take a path for a row of letters, and tell of a scene file that it has no `camera`.
"""

import os
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._errors import InputError, shown
from ._shapes import AnyArray, Scalar, converter

_LOADERS = {
    "Scene": "render_gl.load_scene({path}).scene",
    "Layers": "render_gl.read_layers({path})",
}
"""What makes such a thing of the path of a file."""

_SOURCES = {
    "Scene": "a Scene, such as render_gl.load_scene(path).scene",
    "Layers": "Layers, from analytic_layers, render_gl.render or render_gl.read_layers",
}
"""What to give, where its name does not tell where it comes from."""


def need(name: str, value: object, kind: type) -> None:
    """Raise `InputError` unless `value`, the argument `name`, is of a kind."""
    if isinstance(value, kind):
        return
    given, part = type(value).__name__, kind.__name__.lower()
    if kind.__name__ in _LOADERS and isinstance(value, str | os.PathLike):
        path = shown(os.fspath(value))
        raise InputError(
            f"{name}: {path} is a path; give {_LOADERS[kind.__name__].format(path=path)}"
        )
    if (given, kind.__name__) == ("Scene", "Layers"):
        raise InputError(
            f"{name}: is a Scene; give analytic_layers(scene) or render_gl.render(scene)"
        )
    if isinstance(getattr(value, part, None), kind):
        raise InputError(f"{name}: is a {given}; give its .{part}")
    article = "an" if kind.__name__[0] in "AEIOU" else "a"
    source = _SOURCES.get(kind.__name__, f"{article} {kind.__name__}")
    raise InputError(f"{name}: is of type {given}; give {source}")


def need_number(name: str, value: object) -> Scalar | AnyArray:
    """The value, unless it is no single number: then `InputError`."""
    if isinstance(value, jax.Array):
        found: Scalar | AnyArray = value
    else:
        found = converter(name)(value)
    if np.shape(found) != ():
        raise InputError(f"{name}: {shown(value)} must be one number")
    return found


def need_array(name: str, value: object, form: str) -> None:
    """Raise `InputError` for what is no array of numbers, NumPy's, JAX's or a tracer.

    Args:
        form: its shape, for the message.
    """
    if not isinstance(value, np.ndarray | np.generic | jax.Array | jax.ShapeDtypeStruct):
        raise InputError(f"{name}: is of type {type(value).__name__}; give an array {form}")
    if not (jnp.issubdtype(value.dtype, np.number) or value.dtype == np.bool_):
        raise InputError(f"{name}: holds {value.dtype}; give an array {form} of numbers")


def as_array(name: str, value: object) -> AnyArray:
    """Numbers as an array, arrays as they are; `InputError` for what is no number."""
    found: Any = value
    if not isinstance(value, np.ndarray | np.generic | jax.Array):
        found = converter(name)(value)
    need_array(name, found, "of any shape")
    return found


def as_jax(name: str, value: object) -> jax.Array:
    """Numbers as a JAX array, of the dtype of arrays; `InputError` for what is no number."""
    return jnp.asarray(as_array(name, value))


def need_float(name: str, value: Any) -> None:
    """Raise `InputError` for a dtype other than float32 and float64."""
    try:
        found = None if value is None else np.dtype(value)  # NumPy takes None for float64
    except (TypeError, ValueError, SyntaxError):
        found = None
    if found not in (np.float32, np.float64):
        raise InputError(f"{name}: {shown(value)} must be float32 or float64")
