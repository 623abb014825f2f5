"""Between the command line and the terminal: one line for whatever goes wrong, and nobody else's.

Expected faults are `AirlightError`s, named where they arise. What is none is our own bug, and the
last resort here: its traceback goes to a file, with what other libraries had to say.
"""

import errno
import logging
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import typer

from model_jax._errors import AirlightError, DriverError, InputError, cut, printable

BAD_INPUT, BUG, STOPPED, UNREAD = 2, 70, 130, 141
"""Exit codes: bad input; a bug, as sysexits.h numbers it; interrupted, and nobody reads what is
printed, as shells number these signals."""

LONGEST_LINE = 600
"""Characters of a line on standard error; it is cut in its middle beyond, where names are."""

# Typer shows the whole usage for a wrong option; its exception's text alone is one line.
UsageError: Any = typer.BadParameter.__base__


@contextmanager
def guard(command: Callable[[], str]) -> Iterator[None]:
    """What happens inside ends in silence, or in one line on standard error and an exit code.

    Args:
        command: the command's name as far as it is known, for a wrong option's remedy.
    """
    with _own_terminal() as said:
        try:
            yield
            sys.stdout.flush()
        except (AirlightError, UsageError) as error:
            line = str(error)
            if isinstance(error, UsageError):
                text = error.format_message().replace("Value error, ", "").rstrip(".")
                dot = "" if text.endswith("?") else "."
                line = f"{text}{dot} See `{command()} --help`."
            _stop(line, BAD_INPUT)
        except (KeyboardInterrupt, typer.Abort):
            _stop("stopped", STOPPED)
        except BrokenPipeError:
            # Python would complain again when it flushes at the end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise SystemExit(UNREAD) from None
        except Exception as error:
            known = _machine(error)
            if known is not None:
                _stop(known, BAD_INPUT)
            name = _save(error, said)
            kind, text = type(error).__name__, " ".join(str(error).split())
            about = f"{kind}: {text}" if text else kind
            _stop(f"a bug of airlight's, not of your input ({about:.200}); report {name}", BUG)


def tell(text: str, longest: int = LONGEST_LINE) -> None:
    """One line on standard error, whatever characters and however many a user's names have."""
    print(f"airlight: {cut(printable(text), longest)}", file=sys.stderr, flush=True)


def check_devices() -> list[str]:
    """What JAX computes on.

    Raises:
        InputError: JAX refuses to be imported with a setting that one of its variables gives.
        DriverError: there is no device, as `JAX_PLATFORMS` may say.
    """
    try:
        import jax
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"JAX refuses a setting ({reason:.200}); correct or unset that variable"
        ) from None
    try:
        return [str(device) for device in jax.devices()]
    except Exception as error:  # an AssertionError, where a plug-in is missing
        reason = " ".join(str(error).split())
        asked = os.environ.get("JAX_PLATFORMS")
        raise DriverError(
            "JAX finds no device to compute on"
            + (f" ({reason:.200})" if reason else "")
            + (f"; JAX_PLATFORMS is {asked!r}: unset it, or" if asked else ";")
            + " set JAX_PLATFORMS=cpu"
        ) from None


@contextmanager
def _own_terminal() -> Iterator[IO[bytes]]:
    """Standard error is ours: what other libraries write there, from C too, goes to a file that
    ends with the process; yields it. Where somebody has replaced `sys.stderr`, it stays."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # names of files may be no text, terminals no Unicode
            stream.reconfigure(errors="backslashreplace")
    with tempfile.TemporaryFile() as said, warnings.catch_warnings():
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
        theirs = sys.stderr
        try:
            number = theirs.fileno()
        except (AttributeError, OSError, ValueError):  # captured, or closed
            yield said
            return
        kept = os.dup(number)
        ours = os.fdopen(kept, "w", encoding=theirs.encoding, errors="backslashreplace")
        theirs.flush()
        os.dup2(said.fileno(), number)
        sys.stderr = ours
        last_resort = logging.lastResort
        logging.lastResort = logging.StreamHandler(theirs)
        try:
            yield said
        finally:
            theirs.flush()
            with suppress(OSError):
                ours.flush()
            os.dup2(kept, number)
            sys.stderr = theirs
            logging.lastResort = last_resort
            with suppress(OSError):
                ours.close()


def _stop(line: str, code: int) -> None:
    with suppress(OSError):
        # A bug's line may be the only place that holds its traceback.
        tell(line, sys.maxsize if code == BUG else LONGEST_LINE)
    raise SystemExit(code) from None


def _machine(error: Exception) -> str | None:
    """What is no bug but the machine's affair, with its remedy."""
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return "the memory is full; use a smaller photo, or close other programs"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC:
        return f"the disk is full ({error.filename or 'standard output'}); free some space"
    return None


def _save(error: Exception, said: IO[bytes]) -> Path | str:
    """The traceback in a file that stays, and its name."""
    text = "".join(traceback.format_exception(error))
    try:
        said.seek(0)
        with tempfile.NamedTemporaryFile(
            "wb", prefix="airlight-", suffix=".txt", delete=False
        ) as file:
            file.write(f"{sys.argv!r}\n\n{text}\n".encode(errors="backslashreplace"))
            file.write(said.read())
        return Path(file.name)
    except OSError:  # nowhere to write: better shown than lost
        return text


def devices_found() -> dict[str, Any]:
    """What draws and what computes; why not, where there is none."""
    import render_gl

    try:
        renderer = render_gl.renderer_name()
    except AirlightError as error:
        renderer = f"none ({error})"
    try:
        found = check_devices()
    except AirlightError as error:
        found = [f"none ({error})"]
    return {"OpenGL": renderer, "JAX devices": found}


def command_line() -> str:
    """The command line as far as its subcommand, if it has one."""
    commands = ("render", "fit", "check", "export", "looks", "bench", "version")
    return " ".join(["airlight", *(word for word in sys.argv[1:2] if word in commands)])
