"""Where looks are found: built in, installed (entry points of the group `airlight.looks`), or in a
file, while they are being written.
"""

import hashlib
import importlib.util
import os
import re
import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from .._errors import InputError, cut, need_path, shown
from .._look import Look
from ._air import AirLook
from ._check import check_look
from ._gradient import GradientLook
from ._layers import LayersLook
from ._rim import RimLook

GROUP = "airlight.looks"

BUILT_IN: dict[str, type[Look]] = {
    kind.NAME: kind for kind in (LayersLook, AirLook, RimLook, GradientLook)
}

AUTO: tuple[type[Look], type[Look]] = (LayersLook, AirLook)
"""What a fit chooses of where nobody names a look: the plain one, and that whose terms may be added
to it."""


def looks() -> dict[str, type[Look]]:
    """Every look that can be named: the built-in ones, then those of installed packages.

    Raises `InputError` for an installed look that cannot be loaded or is not one.
    """
    return BUILT_IN | {name: _installed(point) for name, point in _points().items()}


def find_look(look: str | os.PathLike[str]) -> type[Look]:
    """The look of a name, with its terms as in `air+density`, or of a Python file (.py).

    Raises `InputError` for an unknown name, and for a look with an error (`check_look`).
    """
    text = need_path("look", look)
    if text.endswith(".py"):
        return load_look(text)
    first, *terms = text.split("+")
    if first in BUILT_IN:
        return BUILT_IN[first].with_terms(terms)
    points = _points()
    if text in points:
        return _installed(points[text])
    known = ", ".join([*BUILT_IN, *points])
    raise InputError(
        f"look {shown(text)} is unknown; choose from {known}, install the package that brings it, "
        "or name its file, such as haze.py"
    )


def checked(kind: type[Look]) -> type[Look]:
    """The look, if it is what it says (`check_look`); the built-in ones were checked by tests."""
    if not is_built_in(kind):
        check_look(kind)
    return kind


def is_built_in(kind: type[Look]) -> bool:
    """Whether it is one of this package's, with terms or without."""
    first, *terms = kind.NAME.split("+")
    base = BUILT_IN.get(first)
    return base is not None and issubclass(kind, base) and base.with_terms(terms) is kind


def load_look(path: str | os.PathLike[str]) -> type[Look]:
    """The one look that a Python file defines; the file is run, once.

    Raises `InputError`, naming the file: it cannot be read or run, or defines no look or several.
    """
    text = need_path("path", path)
    file = Path(text)
    if file.suffix != ".py":
        raise InputError(f"{text}: is no Python file; name the .py file of a look")
    if not file.is_file():
        raise InputError(f"{text}: no such file; name the Python file of a look")
    real = os.path.realpath(file)
    try:
        return _load(real, tuple(map(_stamp, (file, file.with_suffix(".glsl")))))
    except InputError as error:
        raise InputError(f"{text}: {error}") from None


def _stamp(file: Path) -> int:
    return file.stat().st_mtime_ns if file.is_file() else 0


@cache
def _load(real: str, stamps: tuple[int, ...]) -> type[Look]:
    """The look of a file as it was at a time; its module is named by the path, so that two files of
    one name are two looks."""
    mark = hashlib.sha256(real.encode(errors="surrogateescape")).hexdigest()[:12]
    stem = re.sub(r"\W", "_", Path(real).stem)
    name = f"airlight_look_{stem}_{mark}"
    spec = importlib.util.spec_from_file_location(name, real)
    assert spec is not None  # what ends in .py has a loader
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # so that results that hold the look can be pickled
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"cannot be run ({_told(error)}); correct it there") from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Look) and value.__module__ == name
    ]
    if len(found) != 1:
        names = ", ".join(kind.__name__ for kind in found) or "none"
        raise InputError(f"must define one look, a subclass of Look; it defines {names}")
    check_look(found[0])
    return found[0]


def _told(error: Exception) -> str:
    """An error in one line."""
    return cut(f"{type(error).__name__}: {' '.join(str(error).split())}")


def _points() -> dict[str, EntryPoint]:
    """Entry points by the names of their looks; a built-in name stays the built-in look."""
    return {p.name: p for p in entry_points(group=GROUP) if p.name not in BUILT_IN}


@cache
def _installed(point: EntryPoint) -> type[Look]:
    """The look of an entry point, checked."""
    package = point.dist.name if point.dist is not None else "an installed package"
    where = f"look {point.name} of {package}"
    try:
        kind = point.load()
    except Exception as error:
        raise InputError(
            f"{where}: cannot be loaded ({_told(error)}); mend or uninstall it"
        ) from error
    if not (isinstance(kind, type) and issubclass(kind, Look)):
        raise InputError(f"{where}: {point.value} is no subclass of Look; mend or uninstall it")
    if point.name != kind.NAME:
        raise InputError(f"{where}: its class calls itself {kind.NAME}; give both one name")
    check_look(kind)
    return kind
