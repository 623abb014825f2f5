"""Errors that a user can act on.

Every error that airlight raises on purpose is one line: what was wrong, its value, what to do.
The command line turns them into that line and exit code 2; anything else is a bug, whose
traceback it saves.
"""

import math
import os
import reprlib
import sys
from typing import Any

LONGEST = 80
"""Characters of a user's value or text that a message quotes; it is cut in its middle beyond."""


class AirlightError(Exception):
    """Base of all errors raised on purpose."""


class InputError(AirlightError, ValueError):
    """Bad input: a value, a file or a combination that cannot be used."""


class DriverError(AirlightError, RuntimeError):
    """The machine has no usable OpenGL driver, or the driver cannot do what was asked."""


def shown(value: object) -> str:
    """A value as messages quote it: its `repr`, on one line and at most `LONGEST` characters.

    Never fails, whatever the value's size and depth: `repr` itself refuses whole numbers of more
    than 4300 digits and ends in a RecursionError for deep lists.
    """
    numpy: Any = sys.modules.get("numpy")  # not imported for a message
    if numpy and isinstance(value, numpy.ndarray | numpy.generic) and value.size <= 16:
        value = value.tolist()
    return cut(" ".join(_REPR.repr(value).splitlines()))


def cut(text: str, longest: int = LONGEST) -> str:
    """Text of at most `longest` characters, its start and its end."""
    half = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:half]}...{text[-half:]}"


def printable(text: str) -> str:
    """Text on one line that does nothing to a terminal: an escape character is written as \\x1b.

    Names of files may hold any character, and bytes that are no text.
    """
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))


def need_path(name: str, value: object) -> str:
    """The path as text; `InputError` for what is none."""
    if isinstance(value, str | os.PathLike) and isinstance(path := os.fspath(value), str):
        return path
    raise InputError(f"{name}: is of type {type(value).__name__}; give the path of a file")


class _Repr(reprlib.Repr):
    def repr_int(self, x: int, level: int) -> str:
        digits = int(x.bit_length() * math.log10(2))
        return f"a number of about {digits:,} digits" if digits > LONGEST else repr(x)


_REPR = _Repr()
_REPR.maxstring = _REPR.maxother = LONGEST
