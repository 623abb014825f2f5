"""Errors that a user can act on.

Every error that airlight raises on purpose is one line: what was wrong, its value, what to do.
The command line turns them into that line and exit code 2; anything else is a bug and keeps its
traceback.
"""


class AirlightError(Exception):
    """Base of all errors raised on purpose."""


class InputError(AirlightError, ValueError):
    """Bad input: a value, a file or a combination that cannot be used."""


class DriverError(AirlightError, RuntimeError):
    """The machine has no usable OpenGL driver, or the driver cannot do what was asked."""
