"""What a command leaves: a folder that can be written to, text files, and versions beside numbers.

Without JAX, so that a bad folder is found out before anything is computed.
"""

from importlib import metadata
from pathlib import Path

from model_jax._errors import InputError
from render_gl._files import check_name, write_whole

DISTRIBUTIONS = ("airlight", "jax", "optimistix", "numpy", "moderngl", "OpenEXR")


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    return {name: metadata.version(name) for name in DISTRIBUTIONS}


def check_folder(out: str) -> Path:
    """The folder's path, unless it is empty, no text or the name of a file: then `InputError`."""
    if not out:
        raise InputError("-o: is empty; name a folder, or . for this one")
    check_name(out)
    folder = Path(out)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{out}: cannot be made a folder (File exists); choose another with -o")
    return folder


def prepare_folder(out: str) -> Path:
    """The folder, made if need be; an unwritable one is found out before the work, not after."""
    folder = check_folder(out)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be made a folder ({error.strerror}); choose another with -o"
        ) from None
    probe = folder / ".airlight-probe"
    write_whole(probe, lambda path: write_text(path, ""))
    probe.unlink()
    return folder


def remove(path: Path) -> None:
    """An earlier fit's file, if there is one. Raises `InputError` for a folder of that name."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be replaced ({error.strerror}); remove it or choose another folder"
        ) from None


def write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
