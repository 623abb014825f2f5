"""What picture files say about their colours is used, or named."""

import re
import struct
import zlib
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageCms

import render_gl
from fit import fit, load_photo
from fit.photo._colour import Colours, of_icc, of_jpeg, of_png
from model_jax import LayersLook, Linear, Power, Sampled, Srgb, analytic_layers

CODES = np.arange(256, dtype=np.uint8).reshape(16, 16)
STORED = CODES / 255
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)
BT709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(path: Path, *chunks: tuple[bytes, bytes]) -> Path:
    """An 8-bit grey ramp as RGB, with chunks after the header."""
    stream = BytesIO()
    Image.fromarray(np.repeat(CODES[..., None], 3, axis=-1)).save(stream, "PNG")
    whole = stream.getvalue()
    path.write_bytes(whole[:33] + b"".join(chunk(*one) for one in chunks) + whole[33:])
    return path


def gama(exponent: float) -> tuple[bytes, bytes]:
    return b"gAMA", struct.pack(">I", round(exponent * 1e5))


def chrm(numbers: tuple[float, ...]) -> tuple[bytes, bytes]:
    return b"cHRM", struct.pack(">8I", *(round(n * 1e5) for n in (*numbers[6:], *numbers[:6])))


def icc(curve: bytes, colorants: tuple[float, ...] | None = None, grey: bool = False) -> bytes:
    """A profile with one tone curve, and sRGB's colorants unless told."""
    rgb = colorants or (0.4361, 0.2225, 0.0139, 0.3851, 0.7169, 0.0971, 0.1431, 0.0606, 0.7141)
    tags = {b"desc": b"desc\0\0\0\0" + struct.pack(">I", 8) + b"Our own\0"}
    if grey:
        tags[b"kTRC"] = curve
    else:
        tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve)
        for k, name in enumerate((b"rXYZ", b"gXYZ", b"bXYZ")):
            numbers = (round(n * 65536) for n in rgb[3 * k : 3 * k + 3])
            tags[name] = b"XYZ \0\0\0\0" + struct.pack(">3i", *numbers)
    start = 132 + 12 * len(tags)
    table = body = b""
    for name, data in tags.items():
        table += struct.pack(">4sII", name, start + len(body), len(data))
        body += data
    head = bytearray(128)
    head[12:20] = b"mntrGRAY" if grey else b"mntrRGB "
    head[36:40] = b"acsp"
    return bytes(head) + struct.pack(">I", len(tags)) + table + body


def curv(*numbers: int) -> bytes:
    return b"curv\0\0\0\0" + struct.pack(f">I{len(numbers)}H", len(numbers), *numbers)


def para(form: int, *numbers: float) -> bytes:
    fixed = (round(n * 65536) for n in numbers)
    return b"para\0\0\0\0" + struct.pack(f">HH{len(numbers)}i", form, 0, *fixed)


SRGB_PARA = para(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)
ICC_SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
ADOBE = (0.6097, 0.3111, 0.0195, 0.2053, 0.6257, 0.0609, 0.1492, 0.0632, 0.7446)


def iccp(profile: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"any\0\0" + zlib.compress(profile)


def bt709(stored: np.ndarray) -> np.ndarray:
    """Inverted by search, from the standard's own direction."""
    light = np.linspace(0, 1, 200_001)
    coded = np.where(light < 0.018, 4.5 * light, 1.099 * light**0.45 - 0.099)
    return np.interp(stored, coded, light)


LIGHT = {
    "linear": STORED,
    "srgb": np.asarray(Srgb().decode(STORED)),
    "2.2": STORED**2.2,
    "1.8": STORED**1.8,
    "709": bt709(STORED),
}


@pytest.mark.parametrize(
    ("chunks", "light"),
    [
        ([], "srgb"),
        ([gama(1.0)], "linear"),
        ([gama(1 / 2.2)], "2.2"),
        ([gama(1 / 1.8), chrm(BT709)], "1.8"),
        ([(b"sRGB", b"\0"), gama(1.0)], "srgb"),
        ([(b"cICP", bytes([1, 8, 0, 1])), (b"sRGB", b"\0"), gama(0.5)], "linear"),
        ([(b"cICP", bytes([1, 13, 0, 1]))], "srgb"),
        ([(b"cICP", bytes([1, 4, 0, 1]))], "2.2"),
        ([(b"cICP", bytes([1, 1, 0, 1]))], "709"),
        ([iccp(ICC_SRGB), gama(1.0)], "srgb"),
        ([iccp(icc(SRGB_PARA))], "srgb"),
        ([iccp(icc(curv()))], "linear"),
        ([iccp(icc(curv(round(1.8 * 256))))], "1.8"),
        ([iccp(icc(para(0, 1.8)))], "1.8"),
        ([iccp(icc(curv(*np.round(LIGHT["709"].ravel() * 65535).astype(int))))], "709"),
    ],
)
def test_png(chunks: list[tuple[bytes, bytes]], light: str, tmp_path: Path) -> None:
    """Curves are told to 5 digits, in 1/256 or by tables of 16 bits."""
    photo = load_photo(png(tmp_path / "a.png", *chunks))
    np.testing.assert_allclose(photo.linear[..., 1], LIGHT[light], atol=1e-3)
    assert photo.remarks == ()


@pytest.mark.parametrize(
    ("chunks", "told"),
    [
        ([gama(1.0), chrm(P3)], r"not sRGB's but at \(0.68, 0.32\), \(0.265, 0.69\) and .*cHRM"),
        ([(b"cICP", bytes([9, 8, 0, 1]))], "not sRGB's but BT.2020's, by its cICP chunk: the fit"),
        ([(b"cICP", bytes([1, 8, 0, 0]))], r"Its cICP chunk is not used \(.*full range 0"),
        ([(b"cICP", bytes([1, 99, 0, 1]))], r"is not used \(transfer 99 of H.273"),
        ([(b"cICP", b"\1")], "Its cICP chunk is not used"),
        ([(b"gAMA", b"\0\0\0\0")], "Its gAMA chunk is not used"),
        ([(b"iCCP", b"x\0\0rubbish")], "Its ICC profile is not used"),
        ([iccp(b"rubbish")], r"Its ICC profile is not used \(it is damaged\)"),
        ([iccp(icc(curv(563), ADOBE))], "not sRGB's but those of Our own, by its ICC profile"),
        ([iccp(icc(curv(9, 5, 1)))], "is not used .*must grow"),
        ([iccp(icc(para(0, -1.0)))], "is not used .*above 0"),
        ([iccp(icc(curv(), grey=True).replace(b"GRAY", b"CMYK"))], "CMYK colours by a table"),
    ],
)
def test_what_is_not_used_is_told(
    chunks: list[tuple[bytes, bytes]], told: str, tmp_path: Path
) -> None:
    [remark] = load_photo(png(tmp_path / "a.png", *chunks)).remarks
    assert re.search(told, remark), remark
    assert remark.endswith(".")
    assert "\n" not in remark


def test_jpeg(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    grey = Image.fromarray(np.full((16, 16, 3), 128, np.uint8))

    def light(**more: Any) -> tuple[float, tuple[str, ...]]:
        grey.save(path, quality=95, **more)
        photo = load_photo(path)
        return float(photo.linear[8, 8, 1]), photo.remarks

    usual = float(Srgb().decode(np.array([128 / 255]))[0])
    assert light() == (pytest.approx(usual), ())
    assert light(icc_profile=ICC_SRGB) == (pytest.approx(usual), ())
    assert light(icc_profile=icc(curv(round(1.8 * 256)))) == (
        pytest.approx((128 / 255) ** 1.8, abs=1e-3), (),
    )  # fmt: skip
    exif = Image.Exif()
    exif[0x8769] = {0xA500: 1.8}
    assert light(exif=exif) == (pytest.approx((128 / 255) ** 1.8), ())
    exif = Image.Exif()
    exif[0x8769] = {0xA001: 65535, 0xA005: {1: "R03"}}
    found, remarks = light(exif=exif)
    assert found == pytest.approx((128 / 255) ** (563 / 256))
    assert "not sRGB's but Adobe RGB" in remarks[0]


def test_a_jpeg_that_says_nothing_read_by_an_older_pillow() -> None:
    """Before version 13 it raised KeyError for the directory that is not there."""

    class Silent:
        def get_ifd(self, tag: int) -> dict[int, object]:
            return {0x8769: {}}[tag]

    assert of_jpeg({}, Silent()) == Colours()


def test_grey_jpeg(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    Image.fromarray(np.full((16, 16), 128, np.uint8)).save(
        path, quality=95, icc_profile=icc(curv(), grey=True)
    )
    assert load_photo(path).linear[8, 8, 1] == pytest.approx(128 / 255)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_tiff(kind: type, tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    top = 1 if kind is np.float32 else np.iinfo(kind).max
    pixels: np.ndarray = np.repeat((STORED[..., None] * top).astype(kind), 3, axis=-1)
    tifffile.imwrite(path, pixels, photometric="rgb", iccprofile=icc(para(0, 1.8)))
    photo = load_photo(path)
    np.testing.assert_allclose(photo.linear[..., 1], LIGHT["1.8"], atol=1e-4)
    primaries = [n for x in P3[:6] for n in (round(x * 1000), 1000)]
    tifffile.imwrite(path, pixels, photometric="rgb", extratags=[(319, 5, 6, primaries, True)])
    [remark] = load_photo(path).remarks
    assert "not sRGB's but at (0.68, 0.32)" in remark


def test_exr(tmp_path: Path) -> None:
    import OpenEXR

    pixels = {name: np.ones((4, 4), np.float32) for name in "RGB"}
    for numbers, remarks in ((BT709, 0), (P3, 1)):
        header = {"chromaticities": tuple(numbers)}
        OpenEXR.File(header, pixels).write(str(tmp_path / "a.exr"))
        assert len(load_photo(tmp_path / "a.exr").remarks) == remarks


def test_a_tone_curve_that_is_asked_for_overrides_and_says_so(tmp_path: Path) -> None:
    path = png(tmp_path / "a.png", gama(1.0))
    photo = load_photo(path, "srgb")
    np.testing.assert_allclose(photo.linear[..., 0], LIGHT["srgb"], atol=1e-6)
    assert photo.remarks == (
        "The file says tone curve linear (its gAMA chunk), and tone curve srgb is used as asked.",
    )
    assert load_photo(path, "linear").remarks == ()
    assert load_photo(png(tmp_path / "b.png"), "linear").remarks == ()


def test_mutilated_profiles_never_raise(rng: np.random.Generator) -> None:
    whole = icc(SRGB_PARA)

    def cut(some: bytearray) -> bytes:
        return bytes(some[: rng.integers(len(whole) // 2, len(whole) + 1)])

    for _ in range(500):
        some = bytearray(whole)
        for place in rng.integers(0, len(some), 4):
            some[place] = rng.integers(256)
        of_icc(partial(cut, some))
    bomb = b"x\0\0" + zlib.compress(bytes(2**26))
    assert of_png(b"\x89PNG\r\n\x1a\n" + chunk(b"iCCP", bomb)).remarks


def test_curves_by_their_names() -> None:
    assert isinstance(of_icc(lambda: icc(SRGB_PARA)).curve, Srgb)
    assert isinstance(of_icc(lambda: icc(curv())).curve, Linear)
    assert isinstance(of_icc(lambda: icc(para(0, 2.2))).curve, Power)
    assert isinstance(of_icc(lambda: icc(para(1, 2.2, 1.0, 0.0))).curve, Sampled)
    found = of_icc(lambda: icc(para(0, 2.2)))
    assert found.source == "its ICC profile 'Our own'"


@pytest.mark.parametrize(
    ("transfer", "light", "signal"),
    [
        # ITU-R BT.2408, table 1, in shares of 10,000 cd/m²: 18 % grey, reference white and others.
        (16, 0.0026, 0.38),
        (16, 0.0203, 0.58),
        (16, 0.0100, 0.51),
        (16, 0.1000, 0.75),
        (16, 1.0, 1.0),
        # Table 5 of ITU-R BT.2100: its two branches meet at 1/12; reference white of BT.2408.
        (18, 1 / 12, 0.50),
        (18, 0.265, 0.75),
        (18, 1.0, 1.0),
    ],
)
def test_curves_of_television(transfer: int, light: float, signal: float, tmp_path: Path) -> None:
    """Tables give the signal in per cent."""
    photo = load_photo(png(tmp_path / "a.png", (b"cICP", bytes([1, transfer, 0, 1]))))
    assert photo.tone_curve.encode(np.array([light]))[0] == pytest.approx(signal, abs=0.005)
    assert photo.remarks == ()


@pytest.mark.parametrize("name", ["linear_gama.png", "linear_cicp.png", "srgb16.png"])
def test_pngs_that_say_how_light_is_coded(name: str, data_dir: Path) -> None:
    """The first two were read as sRGB. Truth: brightness 2, shadow weight 0.3."""
    cases = data_dir / "cases"
    layers = analytic_layers(render_gl.load_scene(cases / "small.toml").scene)
    result = fit(load_photo(cases / name), layers, LayersLook(tint=(1.0, 1.0, 1.0)))
    assert result.verdict == "converged"
    for parameter, truth in (("brightness", 2.0), ("shadow", 0.3)):
        interval = result.parameters[parameter].interval
        assert interval is not None
        low, high = interval
        assert low <= truth <= high, (parameter, low, high)


def test_a_remark_is_a_warning_of_the_fit(tmp_path: Path) -> None:
    from tests.fit.looks import TRUTH, picture, scene

    layers = analytic_layers(scene())
    light = np.clip(picture(layers, TRUTH) / 4, 0, 1)
    Image.fromarray(np.round(255 * light).astype(np.uint8)).save(tmp_path / "a.png")
    whole = (tmp_path / "a.png").read_bytes()
    said = b"".join(chunk(*one) for one in (gama(1.0), chrm(P3)))
    (tmp_path / "a.png").write_bytes(whole[:33] + said + whole[33:])
    result = fit(load_photo(tmp_path / "a.png"), layers, sampling="point")
    assert any("not sRGB's" in warning for warning in result.warnings)
