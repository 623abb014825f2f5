"""OpenEXR files: named float32 channels and header attributes, in and out.

Layer files are written and read here, and `fit` reads HDR photos through `read_channels`. What the
channels mean is decided elsewhere.

Reading runs in a child process. The OpenEXR library is C++ on bytes from anywhere, and measured
with version 3.5.3: one flipped header byte made a 20 kB file take all of the machine's memory until
the kernel killed the process; decode errors are printed on standard output and then swallowed; its
older `InputFile` interface ends in a segmentation fault on damaged files. In a child with limits
on memory and processor time none of that reaches the caller. The price is about 0.1 s a file
(Python, NumPy and OpenEXR start) beside 0.13 s to decode seven 1280×1024 channels.
"""

import functools
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import IO

import numpy as np
import OpenEXR
from jaxtyping import Float, Num

from model_jax._errors import InputError, need_path
from model_jax._kinds import need

from ._files import PathLike, check_file, check_name, write_whole

MAGIC = b"\x76\x2f\x31\x01"
"""The first four bytes of every OpenEXR file."""
MAX_SAMPLES = 2**30
"""Most pixels × channels that are read: 4 GiB as float32; a 200-megapixel photo has 0.6e9."""
RESERVED = frozenset(
    {
        "channels",
        "chunkCount",
        "compression",
        "dataWindow",
        "displayWindow",
        "lineOrder",
        "maxSamplesPerPixel",
        "name",
        "pixelAspectRatio",
        "preview",
        "screenWindowCenter",
        "screenWindowWidth",
        "tiles",
        "type",
        "version",
        "view",
    }
)
"""Header attributes that belong to the format; `write_channels` refuses them."""


def read_channels(
    path: PathLike,
) -> tuple[dict[str, Float[np.ndarray, "h w"]], dict[str, object]]:
    """Every channel of a single-part EXR file, and its header attributes.

    Channels are float32 arrays under their full names (`"front.Z"`, `"R"`), whatever the file
    stores (half, float, or unsigned integers, which float32 rounds above 2^24). NaN and Inf are
    returned as they are.

    The arrays cover the *display* window, which is the picture. Pixels that the data window does
    not cover hold no measurement, hence NaN; pixels outside the display window are dropped.

    Attributes come as str, int, float, and tuples of these; enumerations by name; a matrix as the
    tuple of its rows, joined. Kinds that have no such form (previews, film keycodes) are left out.

    Raises `InputError` for files that are missing, damaged or cut off, for deep pixels, subsampled
    channels and several parts, and for more than `MAX_SAMPLES` samples. Changed samples are noticed
    where the compression has a checksum: in ZIP, unless a block was stored raw because it did not
    shrink (noise), but not in PIZ, DWA or B44.
    """
    file = check_file(path)
    check_name(os.path.abspath(file))
    with open(file, "rb") as stream:
        start = stream.read(len(MAGIC))
    if start != MAGIC:
        raise InputError(f"{path}: is no OpenEXR file; name an EXR")
    # `sys.path` is handed on so that the child finds the very NumPy and OpenEXR in use here; one
    # BLAS thread keeps NumPy's share of the address space small.
    surroundings = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "OPENBLAS_NUM_THREADS": "1",
    }
    with subprocess.Popen(
        [sys.executable, "-P", "-c", _child_program(), os.path.abspath(file), str(MAX_SAMPLES)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=surroundings,
    ) as child:
        assert child.stdout is not None  # stdout=PIPE
        try:
            return _receive(path, child.stdout)
        finally:
            child.kill()


def write_channels(
    path: PathLike,
    channels: Mapping[str, Num[np.ndarray, "h w"]],
    attributes: Mapping[str, object],
) -> None:
    """Write channels of one shape as float32, ZIP-compressed; the file appears whole or not at all.

    A float attribute is stored as EXR `double` and comes back exactly; so do the numbers of a
    tuple, which must have 2, 3, 9 or 16 of them (EXR's double vectors and matrices). An int must
    fit 32 bits. The same input gives the same bytes.

    Raises `InputError` for channels or attributes that EXR cannot hold, and for a file that cannot
    be written.
    """
    need_path("path", path)
    check_name(os.path.abspath(path))
    need("channels", channels, Mapping)
    need("attributes", attributes, Mapping)
    header = {name: _attribute(path, name, value) for name, value in attributes.items()}
    header |= {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    shapes = {np.shape(pixels) for pixels in channels.values()}
    if len(shapes) != 1 or any(len(shape) != 2 or 0 in shape for shape in shapes):
        raise InputError(
            f"{path}: channels of shapes {sorted(shapes)} cannot be written; "
            "give at least one, all of one shape (height, width) with at least one pixel"
        )
    for name in channels:
        _check_name(path, "channel", name)
    # A dict of our own, made anew: the constructor replaces the arrays in the dict it gets.
    pixels = {name: np.ascontiguousarray(a, dtype=np.float32) for name, a in channels.items()}

    def write(temporary: Path) -> None:
        if OpenEXR.global_thread_count() == 0:
            OpenEXR.set_global_thread_count(os.cpu_count() or 1)
        try:
            OpenEXR.File(header, pixels).write(str(temporary))
        except (RuntimeError, ValueError, TypeError) as error:
            reason = str(error).replace(str(temporary), str(path)).splitlines()[0]
            raise InputError(
                f"{path}: OpenEXR could not write it ({reason}); "
                "check the space left, and the attributes' names and values"
            ) from error

    write_whole(path, write)


def _attribute(path: PathLike, name: str, value: object) -> object:
    """What makes the OpenEXR binding store `value` without rounding."""
    _check_name(path, "attribute", name)
    if name in RESERVED:
        raise InputError(f"{path}: attribute {name!r} belongs to the EXR format; rename it")
    if isinstance(value, str):
        return value
    if isinstance(value, int | np.integer):
        if -(2**31) <= value < 2**31:
            return int(value)
        raise InputError(f"{path}: attribute {name} = {value} exceeds 32 bits; store a float")
    if isinstance(value, float | np.floating):
        return np.array([value], dtype=np.float64)  # a bare float would become EXR `float`
    if isinstance(value, tuple) and len(value) in (2, 3, 9, 16):
        numbers = np.array(value, dtype=np.float64)
        return numbers if len(value) < 9 else numbers.reshape({9: (3, 3), 16: (4, 4)}[len(value)])
    raise InputError(
        f"{path}: attribute {name} = {value!r} has no EXR form; "
        "use a str, an int, a float or a tuple of 2, 3, 9 or 16 floats"
    )


def _check_name(path: PathLike, kind: str, name: str) -> None:
    if not 0 < len(name.encode()) < 256 or "\0" in name:  # EXR's limit for long names
        raise InputError(f"{path}: {kind} name {name!r} must have 1 to 255 bytes and no NUL")


def _receive(
    path: PathLike, stream: IO[bytes]
) -> tuple[dict[str, Float[np.ndarray, "h w"]], dict[str, object]]:
    """What the child sends: one line of JSON, then the channels' float32 samples in order."""
    damaged = InputError(f"{path}: OpenEXR gave up on it: the file is damaged; write it again")
    line = stream.readline()
    if not line.endswith(b"\n"):
        raise damaged
    answer = json.loads(line)
    if "error" in answer:
        raise InputError(f"{path}: {answer['error']}")
    channels = {}
    for name in answer["channels"]:
        pixels = np.empty(answer["shape"], dtype=np.float32)
        if stream.readinto(pixels.data) != pixels.nbytes:  # type: ignore[attr-defined]
            raise damaged
        channels[name] = pixels
    return channels, {name: _tuples(value) for name, value in answer["attributes"].items()}


def _tuples(value: object) -> object:
    """JSON has lists where Python had tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


@functools.cache
def _child_program() -> str:
    """The functions below as a program of their own.

    The child gets their source instead of importing this module, because the packages that
    airlight imports (JAX above all) take a second to load and the child needs NumPy and OpenEXR.
    """
    functions = (_Refused, _decode, _prepare, _windows, _limit, _plain)
    imports = "import json, os, sys\nimport numpy as np\nimport OpenEXR\n"
    call = "\n_decode(sys.argv[1], int(sys.argv[2]))\n"
    return imports + "\n".join(inspect.getsource(part) for part in functions) + call


class _Refused(Exception):
    """Child: the file is intact but not of a kind that is read; says why and what to do."""


def _decode(path: str, max_samples: int) -> None:
    """Child: read `path` and send it to standard output in the form that `_receive` reads."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the library prints must not mix with the data
    answer: dict[str, object]
    try:
        name = "its header"
        _limit(0)
        opened = OpenEXR.File(path, separate_channels=True, header_only=True, num_threads=0)
        names, attributes, inner, outer = _prepare(opened, os.path.getsize(path), max_samples)
        name = "its pixels"
        decoded = OpenEXR.File(path, separate_channels=True, num_threads=0)
        channels = decoded.channels() if decoded.parts else {}
        y, x, rows, columns = inner
        height, width = outer
        for key in names:
            pixels = channels[key].pixels if key in channels else None
            if pixels is None or pixels.shape != (rows, columns):
                raise ValueError(f"channel {key!r} has no pixels")
    except _Refused as error:
        answer = {"error": str(error)}
    except MemoryError:
        answer = {"error": f"{name} ask for more memory than its size explains; write it again"}
    except Exception as error:
        kind = type(error).__name__
        answer = {"error": f"{name} cannot be read ({kind}): damaged or cut off; write it again"}
    else:
        answer = {"shape": [height, width], "channels": names, "attributes": attributes}
    out.write(json.dumps(answer).encode() + b"\n")
    if "error" not in answer:
        top, left = max(y, 0), max(x, 0)
        bottom, right = min(y + rows, height), min(x + columns, width)
        for key in names:
            picture = np.full((height, width), np.nan, dtype=np.float32)
            picture[top:bottom, left:right] = channels[key].pixels[
                top - y : bottom - y, left - x : right - x
            ]
            out.write(picture.data)
    out.flush()
    os._exit(0)  # no destructors: nothing of a damaged file is touched again


def _prepare(
    opened: OpenEXR.File, size: int, max_samples: int
) -> tuple[list[str], dict[str, object], tuple[int, int, int, int], tuple[int, int]]:
    """Child: channel names, attributes and windows from the header, once it is acceptable.

    Raises `_Refused` with what is wrong and the remedy. Then sets the limits that
    decoding as many samples needs.
    """
    if len(opened.parts) != 1:
        parts = [part.name() for part in opened.parts]
        raise _Refused(f"has {len(parts)} parts ({parts}); save one part as a file")
    header = opened.header()
    channels = {channel.name: channel for channel in header["channels"]}
    if "deep" in str(header["type"]):
        raise _Refused("has deep pixels; flatten it to one sample a pixel")
    if not channels:
        raise _Refused("has no channels; save it with pixels")
    for name, channel in channels.items():
        if (channel.xSampling, channel.ySampling) != (1, 1):
            raise _Refused(
                f"channel {name!r} is subsampled by {channel.xSampling}×{channel.ySampling}; "
                "save it at full resolution (RGB instead of luminance and chroma)"
            )
    inner, outer = _windows(header)
    samples = max(inner[2] * inner[3], outer[0] * outer[1]) * len(channels)
    if samples > max_samples:
        raise _Refused(
            f"has {samples} samples, more than the {max_samples} that are read; save it smaller"
        )
    # Deflate expands by 1032 at most, PXR24 drops a quarter of the bytes before it, run lengths and
    # PIZ stay below; DWA and HTJ2K have no such bound (26,000 measured on a black picture).
    method = str(header["compression"])
    bounded = any(f".{n}_" in method for n in ("NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24"))
    if bounded and 2 * inner[2] * inner[3] * len(channels) > 2048 * size:
        raise _Refused(
            f"claims {inner[3]}×{inner[2]} pixels, which cannot be in {size} bytes; "
            "it is damaged or cut off: write it again"
        )
    _limit(samples)
    attributes = {name: _plain(value) for name, value in header.items() if name != "channels"}
    known = {name: value for name, value in attributes.items() if value is not None}
    return sorted(channels), known, inner, outer


def _windows(header: dict[str, object]) -> tuple[tuple[int, int, int, int], tuple[int, int]]:
    """Child: (top, left, height, width) of the data in the display window, and that one's size."""
    (x0, y0), (x1, y1) = np.array(header["dataWindow"], dtype=object)
    (left, top), (right, bottom) = np.array(header["displayWindow"], dtype=object)
    inner = (int(y0) - int(top), int(x0) - int(left), int(y1) - int(y0) + 1, int(x1) - int(x0) + 1)
    outer = (int(bottom) - int(top) + 1, int(right) - int(left) + 1)
    rows = min(inner[0] + inner[2], outer[0]) - max(inner[0], 0)
    columns = min(inner[1] + inner[3], outer[1]) - max(inner[1], 0)
    if min(*inner[2:], *outer, rows, columns) < 1:
        raise _Refused(
            f"has no pixels inside its display window (data at {inner[1]}, {inner[0]}, "
            f"{inner[3]}×{inner[2]}, display {outer[1]}×{outer[0]}); write it again"
        )
    return inner, outer


def _limit(samples: int) -> None:
    """Child: allow the address space and processor time that so many samples need.

    1 GiB serves Python, NumPy and OpenEXR (0.1 GiB measured). A sample takes at most 4 bytes in the
    file's channels, 4 in the picture sent, 8 in the library's scratch. The slowest method (DWA)
    decodes more than 20 MB/s of float32; 5 MB/s and 20 s are the allowance.
    """
    try:
        import resource

        for kind, value in (
            (resource.RLIMIT_AS, 2**30 + 16 * samples),
            (resource.RLIMIT_CPU, 20 + samples // 1_250_000),
        ):
            hard = resource.getrlimit(kind)[1]
            bound = value if hard == resource.RLIM_INFINITY else min(value, hard)
            resource.setrlimit(kind, (bound, hard))
    except (ImportError, ValueError, OSError):
        return  # a system without such limits: the checks of the header still bound the sizes


def _plain(value: object) -> object:
    """Child: an attribute as str, number, or list of these; None for kinds without such a form."""
    if isinstance(value, str | int | float):
        return value
    if isinstance(value, np.ndarray | np.generic):
        numbers = np.ravel(value).tolist()
        return numbers[0] if len(numbers) == 1 else numbers
    if isinstance(value, list | tuple):
        plain = [_plain(item) for item in value]
        return None if None in plain else plain
    name = getattr(value, "name", None)
    return name if isinstance(name, str) else None
