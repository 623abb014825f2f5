"""Files on disk: a file appears whole or not at all, and an unreadable one is named.

The layer files, reports and shader constants that airlight writes all go through `write_whole`,
so that a full disk or an interrupted run never leaves half a file under the final name.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISDIR, S_ISREG

from model_jax._errors import InputError, need_path

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""How files begin; BigTIFF among the last."""

PathLike = str | os.PathLike[str]
"""A path as callers may give it."""


def write_whole(path: PathLike, write: Callable[[Path], None]) -> None:
    """Let `write` make a file under a temporary name beside `path`, then rename it to `path`.

    `write` gets a path in a new folder beside the target (same file system, same file name and
    suffix) and must create that file. The bytes reach the disk before the rename does. Whatever
    goes wrong, an existing file at `path` stays as it was and nothing temporary is left behind.
    A symbolic link is followed: the file that it points to is replaced.

    Raises `InputError` naming the folder when it is missing or not writable, and naming the file
    when `path` is no regular file or the disk refuses the bytes. What else `write` raises passes
    through.
    """
    need_path("path", path)
    if not os.fspath(path):
        raise InputError("the name of the file to write is empty; name one")
    try:
        target = Path(path).resolve()
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: exists and is no regular file; choose another file name")
        folder = target.parent
        if not folder.is_dir():
            raise InputError(f"{folder}: no such folder to write {target.name} to; create it first")
    except (OSError, ValueError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{os.fspath(path)!r}: not a usable path ({error}); choose another"
        ) from error
    try:
        temporary_folder = tempfile.TemporaryDirectory(dir=folder, prefix=".airlight-")
    except OSError as error:
        raise InputError(
            f"{folder}: cannot write {target.name} there ({error.strerror}); "
            "choose another folder or change its permissions"
        ) from error
    with temporary_folder as name:
        temporary = Path(name) / target.name
        try:
            write(temporary)
            _flush(temporary)
            os.replace(temporary, target)
            _flush(folder)
        except OSError as error:
            raise InputError(
                f"{path}: could not be written ({error.strerror or error}); "
                "free some space or choose another folder"
            ) from error


def check_file(path: PathLike) -> Path:
    """`path` as a `Path`, once it is known to be a regular, readable file that is not empty.

    Raises `InputError` for a missing file, a folder, a pipe or device, a file without read
    permission and an empty file.
    """
    need_path("path", path)
    try:
        status = os.stat(path)
        if S_ISDIR(status.st_mode):
            raise InputError(f"{path}: is a folder; name a file in it")
        if not S_ISREG(status.st_mode):
            raise InputError(f"{path}: is a pipe or a device; name a regular file")
        with open(path, "rb"):
            pass
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; check the path") from error
    except PermissionError as error:
        raise InputError(f"{path}: no permission to read it; change its permissions") from error
    except (OSError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{os.fspath(path)!r}: not a usable path ({reason}); check it") from error
    if status.st_size == 0:
        raise InputError(f"{path}: is empty (0 bytes); write it again")
    return Path(path)


def path_text(path: PathLike) -> str:
    """A path as messages and documents hold it: bytes that are no text are written as \\xff."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """What decoders raise on damaged files, which none of them documents, as `InputError`."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(
            f"{path}: damaged or cut off ({reason}); copy or export it again"
        ) from error


def check_name(path: PathLike) -> None:
    """Raise `InputError` for a path that is no text, which the OpenEXR library cannot open."""
    need_path("path", path)
    try:
        os.fspath(path).encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(
            f"{path_text(path)}: is no UTF-8 text, as EXR files need; rename it"
        ) from None


def _flush(path: Path) -> None:
    """Push a file, or a folder's list of names, to the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
