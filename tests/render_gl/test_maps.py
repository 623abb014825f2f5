"""Maps keep their values or are refused in one line that names the file."""

import io
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from model_jax import Atmosphere, Camera, InputError, Planet, Scene, Srgb
from render_gl._exr import write_channels
from render_gl._maps import load_albedo, load_relief, relief_heights
from render_gl._mesh import sphere_mesh
from render_gl._mesh_error import facet_error

CODES = np.array([[0, 1, 3000], [200, 771, 65535]], np.uint16)
"""Not the same in both halves: 3000 is 0x0bb8."""
BYTES = np.array([[0, 1, 3], [200, 77, 255]], np.uint8)
METRES = np.array([[0, 1, 3000], [200, 771, 8848]])
COLOUR = np.stack([CODES, CODES, CODES // 2], axis=-1)


def refused(path: Path, load: Callable[[str], object] = load_relief) -> str:
    """What the refusal says after the path: one line of what is wrong and what to do."""
    with pytest.raises(InputError) as caught:
        load(str(path))
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")


def png(path: Path, samples: np.ndarray) -> None:
    path.write_bytes(imagecodecs.png_encode(samples))


def tiff(path: Path, samples: np.ndarray, **options: Any) -> None:
    tifffile.imwrite(path, samples, metadata=None, **options)


def save(path: Path, samples: np.ndarray, version: tuple[int, int] = (1, 0)) -> None:
    with open(path, "wb") as stream:
        np.lib.format.write_array(stream, samples, version)


def pillow(path: Path, samples: np.ndarray, mode: str, form: str = "PNG") -> None:
    """By Pillow, in a mode that grey converts to."""
    Image.fromarray(samples).convert(mode).save(path, form)


def stacked(samples: np.ndarray, *more: np.ndarray) -> np.ndarray:
    """RGB of equal channels, and more channels."""
    return np.stack([samples] * 3 + [*more], axis=-1)


GREY: dict[str, tuple[Callable[[Path], object], np.ndarray | float]] = {
    "PNG of 8 bits": (lambda path: png(path, BYTES), BYTES / 255),
    "PNG of 16 bits": (lambda path: png(path, CODES), CODES / 65535),
    "PNG of 16 bits with alpha": (
        lambda path: png(path, np.stack([CODES, CODES[::-1]], axis=-1)),
        CODES / 65535,
    ),
    "RGB PNG of 16 bits": (lambda path: png(path, stacked(CODES)), CODES / 65535),
    "RGBA PNG of 16 bits": (lambda path: png(path, stacked(CODES, CODES[::-1])), CODES / 65535),
    "RGB PNG of 8 bits": (lambda path: png(path, stacked(BYTES)), BYTES / 255),
    "palette": (lambda path: pillow(path, BYTES, "P"), BYTES / 255),
    "PNG of 1 bit": (lambda path: pillow(path, BYTES, "1"), BYTES > 127),
    "JPEG": (lambda path: pillow(path, np.full((8, 8), 77, np.uint8), "RGB", "JPEG"), 77 / 255),
    "TIFF of 8 bits": (lambda path: tiff(path, BYTES), BYTES / 255),
    "TIFF of 16 bits": (lambda path: tiff(path, CODES), CODES / 65535),
    "TIFF of 16 bits, big-endian": (lambda path: tiff(path, CODES, byteorder=">"), CODES / 65535),
    "TIFF of 1 bit": (lambda path: pillow(path, BYTES, "1", "TIFF"), BYTES > 127),
    "TIFF, white is 0": (
        lambda path: tiff(path, CODES, photometric="miniswhite"),
        1 - CODES / 65535,
    ),
    "RGB TIFF of 16 bits": (
        lambda path: tiff(path, stacked(CODES), photometric="rgb"),
        CODES / 65535,
    ),
    "RGB TIFF of 16 bits in planes": (
        lambda path: tiff(
            path, stacked(CODES).transpose(2, 0, 1), photometric="rgb", planarconfig="separate"
        ),
        CODES / 65535,
    ),
    "RGBA TIFF": (
        lambda path: tiff(path, stacked(BYTES, BYTES), photometric="rgb", extrasamples=[2]),
        BYTES / 255,
    ),
    "TIFF of two pages": (
        lambda path: [tifffile.imwrite(path, page, append=True) for page in (CODES, CODES // 2)],
        CODES / 65535,
    ),
    **{
        f"TIFF of {kind}": (partial(tiff, samples=METRES.astype(kind)), METRES)
        for kind in ("float16", "float32", "float64", "int16", "int32", "uint32")
    },
    "RGB TIFF of float32": (
        lambda path: tiff(path, stacked(METRES).astype("float32"), photometric="rgb"),
        METRES,
    ),
    "EXR of one channel": (
        lambda path: write_channels(path, {"Y": METRES}, {}),
        METRES,
    ),
    "EXR of equal R, G, B": (
        lambda path: write_channels(path, dict.fromkeys("RGBA", METRES), {}),
        METRES,
    ),
    ".npy": (lambda path: save(path, METRES), METRES),
    ".npy of 8 bits": (lambda path: save(path, BYTES), BYTES),
    ".npy, big-endian, by columns": (
        lambda path: save(path, np.asfortranarray(METRES.astype(">f8"))),
        METRES,
    ),
    ".npy of version 2": (lambda path: save(path, METRES, (2, 0)), METRES),
    ".npy of version 3": (lambda path: save(path, METRES, (3, 0)), METRES),
    "below 0": (lambda path: tiff(path, -METRES.astype("int16")), np.zeros(METRES.shape)),
}


@pytest.mark.parametrize("name", GREY)
def test_heights_are_kept(name: str, tmp_path: Path) -> None:
    """Under a name that says nothing of the format."""
    write, expected = GREY[name]
    path = tmp_path / "map"
    write(path)
    heights = load_relief(str(path))
    assert heights.dtype == np.float32
    assert heights.ndim == 2
    np.testing.assert_array_max_ulp(
        heights, np.broadcast_to(np.float32(expected), heights.shape), maxulp=1
    )
    # Black and white are exact.
    assert np.all(heights[np.broadcast_to(expected, heights.shape) == 1] == 1)


def npy_header(text: str) -> bytes:
    """An .npy file of version 1 with this header and 8 bytes of data."""
    return b"\x93NUMPY\1\0" + len(text).to_bytes(2, "little") + text.encode() + bytes(8)


def npy_of(shape: str, kind: str = "<f8") -> bytes:
    return npy_header(f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}\n")


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("arr_0.npy", npy_of("(1, 1)"))
    return stream.getvalue()


def cut(path: Path, samples: np.ndarray, **options: Any) -> None:
    tiff(path, samples, **options)
    path.write_bytes(path.read_bytes()[:-2])


def lengthened(path: Path, samples: np.ndarray) -> None:
    """A TIFF that claims twice the rows, of strips that are not there."""
    tiff(path, samples, compression="deflate", rowsperstrip=1)
    with tifffile.TiffFile(path, mode="r+") as file:
        page = file.pages[0]
        assert isinstance(page, tifffile.TiffPage)
        page.tags["ImageLength"].overwrite(2 * len(samples))


NO_RELIEF: dict[str, tuple[Callable[[Path], object], str]] = {
    "RGB PNG": (
        lambda path: png(path, COLOUR),
        "is a colour picture, [1, 1, 0] at row 0, column 1; save heights as grey",
    ),
    "RGB TIFF": (lambda path: tiff(path, COLOUR, photometric="rgb"), "is a colour picture"),
    "palette TIFF": (lambda path: pillow(path, BYTES, "P", "TIFF"), "is a PALETTE TIFF"),
    "colour EXR": (
        lambda path: write_channels(path, {"R": METRES, "G": METRES, "B": -METRES}, {}),
        "is a colour picture",
    ),
    "layered EXR": (
        lambda path: write_channels(path, {"Y": METRES, "front.Z": METRES}, {}),
        "has the channels ['Y', 'front.Z']; save heights as the only one",
    ),
    "CMYK JPEG": (
        lambda path: pillow(path, stacked(BYTES), "CMYK", "JPEG"),
        "is CMYK; convert it to RGB",
    ),
    "CMYK TIFF": (
        lambda path: pillow(path, stacked(BYTES), "CMYK", "TIFF"),
        "is a SEPARATED TIFF; convert it to grey or RGB",
    ),
    "TIFF of five bands": (
        lambda path: tiff(
            path, np.zeros((8, 8, 5), "uint8"), photometric="minisblack", planarconfig="contig"
        ),
        "has 5 samples a pixel",
    ),
    "TIFF of a volume": (
        lambda path: tiff(
            path, np.zeros((2, 16, 16), "uint8"), photometric="minisblack", volumetric=True
        ),
        "has axes ZYX; save one flat picture",
    ),
    "TIFF of complex": (lambda path: tiff(path, METRES.astype("complex64")), "samples are complex"),
    "thumbnail": (lambda path: tiff(path, BYTES, subfiletype=1), "holds a thumbnail first"),
    "cut TIFF": (lambda path: cut(path, CODES), "cut off after"),
    "TIFF without its last rows": (lambda path: lengthened(path, CODES), "page are missing"),
    "TIFF with NaN": (
        lambda path: tiff(path, np.array([[0, 1, np.nan], [np.inf, 2, 3]], np.float32)),
        "2 of its heights are not finite, the first, nan, at row 0, column 2; fill them in",
    ),
    "beyond float32": (
        lambda path: save(path, np.array([[1e300]])),
        "1 of its heights are not finite, the first, 1e+300, at row 0, column 0",
    ),
    "7 TiB": (
        lambda path: path.write_bytes(npy_of("(1000000, 1000000)")),
        "1000000×1000000 pixels are more than the 268435456 that are read; scale it down",
    ),
    "1 GiB": (
        lambda path: path.write_bytes(npy_of("(10000, 10000)")),
        "claims shape (10000, 10000) of float64, which cannot be in",
    ),
    "huge PNG": (
        lambda path: path.write_bytes(
            b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + b"\x7f\xff\xff\xff" * 2 + bytes(20)
        ),
        "2147483647×2147483647 pixels are more than",
    ),
    "0×0": (lambda path: save(path, np.zeros((0, 0))), "has 0×0 pixels; export it again"),
    "negative shape": (lambda path: path.write_bytes(npy_of("(-1, 4)")), "has 4×-1 pixels"),
    "one axis": (
        lambda path: save(path, np.zeros(3)),
        "has shape (3,) of float64; a height map is numbers [h, w]",
    ),
    "channels": (lambda path: save(path, np.zeros((2, 2, 3))), "has shape (2, 2, 3)"),
    "complex": (lambda path: save(path, np.zeros((2, 2), complex)), "of complex128"),
    "bool": (lambda path: save(path, np.zeros((2, 2), bool)), "of bool"),
    "text": (lambda path: save(path, np.full((2, 2), "a")), "of <U1"),
    "objects": (
        lambda path: save(path, np.full((2, 2), None)),
        "of object",
    ),
    "dates": (lambda path: save(path, np.zeros((2, 2), "M8[s]")), "of datetime64[s]"),
    "cut .npy": (
        lambda path: path.write_bytes(npy_of("(1, 2)")),
        "claims shape (1, 2) of float64, which cannot be in",
    ),
    "cut header": (lambda path: path.write_bytes(npy_of("(1, 1)")[:30]), "damaged or cut off ("),
    "only the magic": (lambda path: path.write_bytes(b"\x93NUMPY"), "damaged or cut off ("),
    **{
        f"header {text[:9]!r}": (
            partial(Path.write_bytes, data=npy_header(text)),
            "damaged or cut off (",
        )
        for text in (
            "{",
            "garbage",
            "1 + ",
            "{[]: 1}",
            "(" * 9000,
            "-" * 9000 + "1",
            "\0",
            "[1, 2]",
        )
    },
    "zip": (
        lambda path: path.write_bytes(zipped()),
        "is no PNG, JPEG, TIFF, EXR or .npy file; save it as one of these",
    ),
    "bitmap": (lambda path: pillow(path, BYTES, "L", "BMP"), "is no PNG, JPEG, TIFF, EXR"),
    "cut PNG": (
        lambda path: path.write_bytes(imagecodecs.png_encode(CODES)[:-20]),
        "damaged or cut off (",
    ),
    "cut JPEG": (
        lambda path: path.write_bytes(imagecodecs.jpeg8_encode(np.zeros((64, 64), "uint8"))[:-20]),
        "damaged or cut off (",
    ),
}


@pytest.mark.parametrize("name", NO_RELIEF)
def test_what_is_no_relief_is_refused(name: str, tmp_path: Path) -> None:
    write, expected = NO_RELIEF[name]
    path = tmp_path / "map.npy"
    write(path)
    assert expected in refused(path)


def test_heights_of_the_planets_size_are_refused(tmp_path: Path) -> None:
    """In metres on a planet in kilometres; whoever asks for the heights."""
    path = tmp_path / "map.tif"
    tiff(path, METRES.astype("float32"))
    with pytest.raises(InputError) as caught:
        relief_heights(Planet(6371.0, relief=str(path)))
    assert str(caught.value) == (
        f"{path}: its largest height, 8848 at row 1, column 2, is 8848 with "
        "planet.relief_unit = 1, as large as planet.radius = 6371; "
        "set planet.relief_unit to the length of the map's unit"
    )
    scene = Scene(
        Camera((3e4, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), 30.0, 8, 8, 1.0, 1e5),
        Planet(6371.0, relief=str(path)),
        Atmosphere(100.0),
    )
    with pytest.raises(InputError, match="its largest height"):
        facet_error(sphere_mesh(20), scene)
    heights = relief_heights(Planet(6371.0, relief=str(path), relief_unit=1e-3))
    np.testing.assert_allclose(heights, METRES / 6371e3, rtol=1e-6)
    assert heights.dtype == np.float32


ALBEDO: dict[str, tuple[Callable[[Path], object], np.ndarray]] = {
    "RGB PNG of 8 bits": (lambda path: png(path, COLOUR.astype("uint8")), COLOUR % 256 / 255),
    "RGB PNG of 16 bits": (lambda path: png(path, COLOUR), COLOUR / 65535),
    "grey PNG of 16 bits": (lambda path: png(path, CODES), stacked(CODES) / 65535),
    "RGB TIFF of 16 bits": (lambda path: tiff(path, COLOUR, photometric="rgb"), COLOUR / 65535),
    "palette with transparency": (
        lambda path: (
            Image.fromarray(BYTES).convert("P").save(path, "PNG", transparency=bytes(range(200)))
        ),
        stacked(BYTES) / 255,
    ),
}


@pytest.mark.parametrize("name", ALBEDO)
def test_albedo_keeps_what_float16_holds(name: str, tmp_path: Path) -> None:
    write, expected = ALBEDO[name]
    path = tmp_path / "map"
    write(path)
    albedo = load_albedo(str(path))
    assert albedo.dtype == np.float16
    reference = np.float16(Srgb().decode(expected))
    np.testing.assert_array_max_ulp(albedo, reference, maxulp=1)


@pytest.mark.parametrize(
    ("write", "expected"),
    [
        (lambda path: pillow(path, stacked(BYTES), "CMYK", "JPEG"), "is CMYK; convert it to RGB"),
        (
            lambda path: tiff(path, np.zeros((4, 4, 3), "float32"), photometric="rgb"),
            "holds float32 numbers, which are no sRGB codes; save the albedo as a PNG of 8 or 16",
        ),
        (lambda path: tiff(path, METRES.astype("int32")), "holds int32 numbers"),
        (lambda path: save(path, METRES), "holds int64 numbers"),
    ],
    ids=["CMYK", "float", "int32", ".npy"],
)
def test_what_is_no_albedo_is_refused(
    write: Callable[[Path], object], expected: str, tmp_path: Path
) -> None:
    write(tmp_path / "map")
    assert expected in refused(tmp_path / "map", load_albedo)


@pytest.mark.parametrize("form", ["PNG", "JPEG", "TIFF"])
def test_sizes_that_pillow_warns_of_are_read(
    form: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its limit is lowered instead of a map of 10^8 pixels made; warnings are errors here."""
    pillow(tmp_path / "map", np.full((20, 20), 77, np.uint8), "L", form)
    for limit in (300, 100):  # a warning, and an error
        monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", limit)
        load_relief.cache_clear()
        assert load_relief(str(tmp_path / "map")).shape == (20, 20)
        load_albedo.cache_clear()
        assert load_albedo(str(tmp_path / "map")).shape == (20, 20, 3)


@pytest.mark.parametrize("form", ["PNG", "TIFF", "deflated TIFF", "JPEG", "npy"])
def test_damage_never_ends_in_a_traceback(
    form: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Bytes changed at random, most of them where headers are, and files cut at random."""
    path = tmp_path / "map"
    samples = np.arange(48, dtype=np.uint16).reshape(6, 8) * 1300
    if form == "npy":
        save(path, samples)
    elif form == "PNG":
        png(path, samples)
    elif form == "JPEG":
        pillow(path, (samples // 256).astype(np.uint8), "RGB", "JPEG")
    else:
        tiff(path, samples, compression="deflate" if form == "deflated TIFF" else None)
    intact = path.read_bytes()
    outcomes = set()
    for number in range(200):
        data = bytearray(intact)
        for _ in range(rng.integers(1, 4)):
            end = len(data) if rng.random() < 0.5 else min(len(data), 140)
            data[rng.integers(end)] = rng.integers(256)
        if number % 10 == 0:
            del data[rng.integers(1, len(data)) :]
        path.write_bytes(data)
        load_relief.cache_clear()
        try:
            heights = load_relief(str(path))
        except InputError as error:
            outcomes.add("refused" if "\n" not in str(error) else str(error))
        else:
            assert heights.dtype == np.float32
            assert heights.ndim == 2
            assert np.isfinite(heights).all()
            outcomes.add("read")
    assert "refused" in outcomes
    assert outcomes <= {"refused", "read"}
