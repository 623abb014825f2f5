"""Photos: each format to linear light, the pixels left out and why, and unusable files."""

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image, ImageFile, ImageOps

from fit.photo import _read
from fit.photo._photo import REASONS
from fit.photo._read import load_photo
from model_jax._errors import InputError
from model_jax._tone import Exposure, Linear, Srgb, ToneCurve
from render_gl._exr import write_channels
from tests.data import FOLDER
from tests.fit.photo.files import png


def data_file(name: str) -> Path:
    if not FOLDER.is_dir():
        pytest.skip("../shared/data is absent")
    return FOLDER / name


def codes_of(dtype: str, channels: int, height: int = 5, width: int = 6) -> np.ndarray:
    """Codes over the whole range, the highest left out."""
    top = np.iinfo(dtype).max
    rng = np.random.default_rng(7)
    return rng.integers(0, top, (height, width, channels), dtype=dtype)


def srgb_to_linear(codes: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1, written out anew."""
    v = codes / np.iinfo(codes.dtype).max
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


class TestFormats:
    @pytest.mark.parametrize("channels", [1, 2, 3, 4])
    @pytest.mark.parametrize("dtype", ["uint8", "uint16"])
    def test_png(self, tmp_path: Path, dtype: str, channels: int) -> None:
        codes = codes_of(dtype, channels)
        (tmp_path / "a.png").write_bytes(png(codes))
        photo = load_photo(tmp_path / "a.png")
        colour = codes[..., :3] if channels > 2 else codes[..., :1]
        expected = np.broadcast_to(srgb_to_linear(colour), (5, 6, 3))
        # float32 rounding of the table; a lost low byte would be off by up to 1e-2
        np.testing.assert_allclose(photo.linear, expected, rtol=2e-7)
        assert photo.bits == 8 * codes.dtype.itemsize
        assert photo.valid.all()
        assert isinstance(photo.tone_curve, Srgb)

    @pytest.mark.parametrize("compression", [None, "lzw", "deflate"])
    @pytest.mark.parametrize("channels", [1, 3, 4])
    @pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
    def test_tiff(self, tmp_path: Path, dtype: str, channels: int, compression: str | None) -> None:
        codes = codes_of("uint16" if dtype == "float32" else dtype, channels).astype(dtype)
        stored = codes[..., 0] if channels == 1 else codes
        tifffile.imwrite(
            tmp_path / "a.tif",
            stored,
            photometric="minisblack" if channels == 1 else "rgb",
            extrasamples=["unassalpha"] if channels == 4 else None,
            compression=compression,
        )
        photo = load_photo(tmp_path / "a.tif")
        colour = codes[..., : min(channels, 3)]
        linear = colour if dtype == "float32" else srgb_to_linear(colour)
        np.testing.assert_allclose(photo.linear, np.broadcast_to(linear, (5, 6, 3)), rtol=2e-7)
        assert photo.bits == {"uint8": 8, "uint16": 16, "float32": 32}[dtype]
        assert (photo.quantisation is None) == (dtype == "float32")

    def test_planar_and_inverted_tiff(self, tmp_path: Path) -> None:
        codes = codes_of("uint8", 3)
        planes = np.moveaxis(codes, -1, 0)
        tifffile.imwrite(tmp_path / "p.tif", planes, photometric="rgb", planarconfig="separate")
        np.testing.assert_allclose(
            load_photo(tmp_path / "p.tif").linear, srgb_to_linear(codes), rtol=2e-7
        )
        tifffile.imwrite(tmp_path / "w.tif", 255 - codes[..., 0], photometric="miniswhite")
        np.testing.assert_allclose(
            load_photo(tmp_path / "w.tif").linear[..., 1], srgb_to_linear(codes[..., 0]), rtol=2e-7
        )

    def test_exr_and_its_missing_channels(self, tmp_path: Path) -> None:
        planes = {name: np.full((2, 3), k, np.float32) for k, name in enumerate("RGB")}
        write_channels(tmp_path / "a.exr", planes, {})
        photo = load_photo(tmp_path / "a.exr")
        np.testing.assert_array_equal(photo.linear, np.stack(list(planes.values()), axis=-1))
        assert isinstance(photo.tone_curve, Linear)
        assert (photo.bits, photo.quantisation) == (32, None)
        write_channels(tmp_path / "b.exr", {"Z": planes["R"], "G": planes["G"]}, {})
        with pytest.raises(InputError, match=r"channels \['G', 'Z'\]; a photo needs R, G and B"):
            load_photo(tmp_path / "b.exr")
        write_channels(tmp_path / "grey.exr", {"Y": planes["G"]}, {})
        grey = load_photo(tmp_path / "grey.exr").linear
        np.testing.assert_array_equal(grey, np.repeat(planes["G"][..., None], 3, axis=-1))

    def test_content_decides_not_the_extension(self, tmp_path: Path) -> None:
        codes = codes_of("uint8", 3)
        (tmp_path / "a.exr").write_bytes(png(codes))
        np.testing.assert_allclose(
            load_photo(tmp_path / "a.exr").linear, srgb_to_linear(codes), rtol=2e-7
        )

    def test_palette_and_one_pixel(self, tmp_path: Path) -> None:
        image = Image.new("P", (1, 1), 1)
        image.putpalette([0, 0, 0, 10, 20, 30])
        image.save(tmp_path / "a.png")
        photo = load_photo(tmp_path / "a.png")
        expected = srgb_to_linear(np.array([[[10, 20, 30]]], dtype=np.uint8))
        np.testing.assert_allclose(photo.linear, expected, rtol=2e-7)

    @pytest.mark.parametrize("orientation", range(1, 9))
    @pytest.mark.parametrize("suffix", ["png", "jpg", "tif"])
    def test_orientation(self, tmp_path: Path, orientation: int, suffix: str) -> None:
        image = Image.fromarray(codes_of("uint8", 3, 8, 16))
        exif = Image.Exif()
        exif[0x0112] = orientation
        path = tmp_path / f"a.{suffix}"
        image.save(path, exif=exif)
        with Image.open(path) as stored:
            expected = srgb_to_linear(np.asarray(ImageOps.exif_transpose(stored)))
        np.testing.assert_allclose(load_photo(path).linear, expected, rtol=2e-7)

    def test_float_photo_with_a_curve(self, tmp_path: Path) -> None:
        light = np.array([[0.0, 0.3, 2.0]])
        curve = Exposure(exposure=1.5, gamma=2.2)
        plane = np.append(np.asarray(curve.encode(light)), [[1.0, np.nan]], axis=1)
        write_channels(tmp_path / "a.exr", dict.fromkeys("RGB", plane), {})
        photo = load_photo(tmp_path / "a.exr", tone_curve={"exposure": 1.5, "gamma": 2.2})
        # the stored 0.97 in float32, 1 - code**gamma = 0.05 of it: 2^-24 · 2.2 / 0.05 / 3
        np.testing.assert_allclose(photo.linear[:, :3, 0], light, rtol=2e-6)
        assert photo.excluded == {"masked": 0, "not finite": 2}
        assert (photo.codes, photo.half_steps) == (None, None)


class TestCounts:
    def test_each_pixel_counts_once_in_order(self, tmp_path: Path) -> None:
        plane = np.full((2, 3), 0.5)
        plane[0, 0] = np.nan
        plane[1, 2] = np.inf  # not finite, but masked
        write_channels(tmp_path / "a.exr", dict.fromkeys("RGB", plane), {})
        mask = np.full((2, 3, 1), 255, dtype=np.uint8)
        mask[1, 2] = 0
        mask[0, 2] = 1  # not white, not black: keeps
        (tmp_path / "m.png").write_bytes(png(mask))
        photo = load_photo(tmp_path / "a.exr", mask=tmp_path / "m.png")
        assert photo.excluded == {"masked": 1, "not finite": 1}
        masked, broken = (1 + REASONS.index(name) for name in ("masked", "not finite"))
        np.testing.assert_array_equal(photo.reason, [[broken, 0, 0], [0, 0, masked]])
        np.testing.assert_array_equal(photo.valid, photo.reason == 0)

    @pytest.mark.parametrize("code", [0, 255], ids=["black", "white"])
    def test_one_colour_all_over_is_no_error(self, tmp_path: Path, code: int) -> None:
        """A sample at either end tells a bound, so no pixel is left out for it."""
        (tmp_path / "a.png").write_bytes(png(np.full((3, 4, 3), code, dtype=np.uint8)))
        photo = load_photo(tmp_path / "a.png")
        assert photo.excluded == {"masked": 0, "not finite": 0}
        assert photo.codes is not None
        assert (photo.codes == code).all()

    def test_nan_and_inf_are_counted_and_kept(self, tmp_path: Path) -> None:
        plane = np.array([[np.nan, np.inf, 1.0]])
        write_channels(tmp_path / "a.exr", {"R": plane, "G": np.ones_like(plane), "B": plane}, {})
        photo = load_photo(tmp_path / "a.exr")
        assert photo.excluded == {"masked": 0, "not finite": 2}
        np.testing.assert_array_equal(photo.linear[..., 0], plane)

    def test_an_exr_mask_of_any_channel(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(png(codes_of("uint8", 3, 1, 4)))
        write_channels(tmp_path / "m.exr", {"Y": np.array([[0, 0.5, np.nan, 1]])}, {})
        photo = load_photo(tmp_path / "a.png", mask=tmp_path / "m.exr")
        np.testing.assert_array_equal(photo.valid, [[False, True, False, True]])

    def test_a_mask_of_another_size(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(png(codes_of("uint8", 3, 4, 3)))
        (tmp_path / "m.png").write_bytes(png(codes_of("uint8", 1, 3, 4)))
        with pytest.raises(InputError, match=r"m\.png: the mask is 4×3, .*a\.png is 3×4"):
            load_photo(tmp_path / "a.png", mask=tmp_path / "m.png")


class TestQuantisation:
    @pytest.mark.parametrize("dtype", ["uint8", "uint16"])
    def test_linear_curve_has_equal_steps(self, tmp_path: Path, dtype: str) -> None:
        codes = codes_of(dtype, 3)
        codes[0, 0] = [0, 1, np.iinfo(dtype).max]
        (tmp_path / "a.png").write_bytes(png(codes))
        photo = load_photo(tmp_path / "a.png", tone_curve="linear")
        half = 0.5 / np.iinfo(dtype).max
        # the difference of two numbers near 1 in float64, as float32
        assert photo.quantisation is not None
        np.testing.assert_allclose(photo.quantisation, half, rtol=2e-7)

    def test_srgb_step_is_the_difference_of_the_edges(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(png(np.array([[[0, 5, 200]]], dtype=np.uint8)))
        photo = load_photo(tmp_path / "a.png")
        assert photo.quantisation is not None
        high, low = (((200 + s + 0.055 * 255) / 1.055 / 255) ** 2.4 for s in (0.5, -0.5))
        expected = [0.5 / 255 / 12.92, 0.5 / 255 / 12.92, (high - low) / 2]
        np.testing.assert_allclose(photo.quantisation[0, 0], expected, rtol=1e-6)

    @pytest.mark.parametrize("dtype", ["uint8", "uint16"])
    def test_no_infinite_number_under_the_exposure_curve(self, tmp_path: Path, dtype: str) -> None:
        top = np.iinfo(dtype).max
        (tmp_path / "a.png").write_bytes(png(np.array([[[0, top - 1, top]]], dtype=dtype)))
        photo = load_photo(tmp_path / "a.png", tone_curve=Exposure(exposure=2.0, gamma=1.0))
        assert photo.valid.all()
        assert np.isfinite(photo.linear).all()
        assert photo.quantisation is not None
        assert np.isfinite(photo.quantisation).all()
        expected = -np.log(np.array([1.0, 1 / top, 0.5 / top])) / 2
        np.testing.assert_allclose(photo.linear[0, 0], expected, rtol=1e-6)


class TestLimits:
    """What a clipped sample tells: the light half a code inside the ends."""

    @pytest.mark.parametrize("dtype", ["uint8", "uint16"])
    @pytest.mark.parametrize(
        ("curve", "decode"),
        [
            pytest.param(Linear(), lambda v: v, id="linear"),
            pytest.param(
                Srgb(),
                lambda v: v / 12.92 if v < 0.04 else ((v + 0.055) / 1.055) ** 2.4,
                id="srgb",
            ),
            pytest.param(Exposure(2.0, 2.2), lambda v: -np.log1p(-(v**2.2)) / 2, id="exposure"),
        ],
    )
    def test_values(
        self, tmp_path: Path, dtype: str, curve: ToneCurve, decode: Callable[[float], float]
    ) -> None:
        top = np.iinfo(dtype).max
        (tmp_path / "a.png").write_bytes(png(np.array([[[0, 1, top]]], dtype=dtype)))
        photo = load_photo(tmp_path / "a.png", tone_curve=curve)
        assert photo.top == top
        # -log(1 - v) near v = 1 takes an eps of v 2^16 times.
        expected = [decode(0.5 / top), decode(1 - 0.5 / top)]
        np.testing.assert_allclose(photo.limits, expected, rtol=1e-10)
        black, white = photo.limits
        assert photo.linear[0, 0, 0] < black < photo.linear[0, 0, 1]
        assert white <= photo.linear[0, 0, 2] * (1 + 2e-7)  # float32


class TestUnusable:
    @pytest.mark.parametrize(
        ("content", "fragment"),
        [
            pytest.param(b"", "is empty", id="empty"),
            pytest.param(b"not a picture", "is no picture; save", id="text"),
            pytest.param(b"\0\0\0\x18ftypheic", "HEIF", id="heic"),
            pytest.param(b"\xff\xd8\xff\xe0\0\x10JFIF", "damaged or cut off", id="jpeg-start"),
            pytest.param(b"\x89PNG\r\n\x1a\n", "damaged or cut off", id="png-start"),
            pytest.param(b"II*\0\x08\0\0\0\0\0", "has 0×0 pixels", id="tiff-start"),
            pytest.param(b"\x76\x2f\x31\x01", "damaged or cut off", id="exr-start"),
        ],
    )
    def test_content(self, tmp_path: Path, content: bytes, fragment: str) -> None:
        path = tmp_path / "photo.jpg"
        path.write_bytes(content)
        with pytest.raises(InputError, match=fragment) as error:
            load_photo(path)
        assert str(path) in str(error.value)
        assert "\n" not in str(error.value)

    @pytest.mark.parametrize("suffix", ["webp", "gif", "bmp"])
    def test_other_formats_are_named(self, tmp_path: Path, suffix: str) -> None:
        image = Image.new("RGB", (3, 2))
        image.save(tmp_path / "a.jpg", format=suffix)
        with pytest.raises(InputError, match=f"is a {suffix.upper()} picture"):
            load_photo(tmp_path / "a.jpg")

    def test_missing_file_and_folder(self, tmp_path: Path) -> None:
        for path, told in (
            (tmp_path / "none.png", "no such file; check the path"),
            (tmp_path, "is a folder; name a file in it"),
            (f"{tmp_path}/a\0b", "not a usable path"),
        ):
            with pytest.raises(InputError, match=told):
                load_photo(path)

    @pytest.mark.parametrize("fraction", [0.3, 0.7, 0.99])
    @pytest.mark.parametrize("kind", ["jpg", "png8", "png16", "tif"])
    def test_cut_off(self, tmp_path: Path, kind: str, fraction: float) -> None:
        buffer = io.BytesIO()
        codes = codes_of("uint16" if kind == "png16" else "uint8", 3, 60, 60)
        if kind == "jpg":
            Image.fromarray(codes).save(buffer, "JPEG")
        elif kind == "tif":
            tifffile.imwrite(buffer, codes, photometric="rgb", rowsperstrip=7)
        else:
            buffer.write(png(codes))
        whole = buffer.getvalue()
        (tmp_path / "a").write_bytes(whole[: int(len(whole) * fraction)])
        with pytest.raises(InputError, match="cut off") as error:
            load_photo(tmp_path / "a")
        assert "\n" not in str(error.value)

    def test_cmyk(self, tmp_path: Path) -> None:
        Image.new("CMYK", (4, 4)).save(tmp_path / "a.jpg")
        with pytest.raises(InputError, match="is CMYK; convert it to RGB"):
            load_photo(tmp_path / "a.jpg")

    @pytest.mark.parametrize("kind", ["png", "tif", "exr"])
    def test_more_pixels_than_are_read(
        self, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(_read, "MAX_PIXELS", 29)
        path = tmp_path / f"a.{kind}"
        codes = codes_of("uint8", 3)
        if kind == "exr":
            write_channels(path, dict.fromkeys("RGB", codes[..., 0]), {})
        else:
            Image.fromarray(codes).save(path)
        with pytest.raises(InputError, match="6×5 pixels are more than the 29"):
            load_photo(path)

    def test_a_hostile_size_costs_no_memory(self, tmp_path: Path) -> None:
        honest = png(np.zeros((1, 1, 3), dtype=np.uint8))
        header = b"IHDR" + struct.pack(">II", 10**6, 10**6) + honest[24:29]
        forged = honest[:12] + header + struct.pack(">I", zlib.crc32(header)) + honest[33:]
        (tmp_path / "a.png").write_bytes(forged)
        with pytest.raises(InputError, match="1000000×1000000 pixels are more"):
            load_photo(tmp_path / "a.png")

    def test_pillow_told_to_accept_cut_off_files(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(ImageFile, "LOAD_TRUNCATED_IMAGES", True)
        (tmp_path / "a.png").write_bytes(png(codes_of("uint8", 3)))
        with pytest.raises(InputError, match="LOAD_TRUNCATED_IMAGES"):
            load_photo(tmp_path / "a.png")

    def test_a_thumbnail_first(self, tmp_path: Path) -> None:
        tifffile.imwrite(tmp_path / "a.nef", codes_of("uint8", 3), photometric="rgb", subfiletype=1)
        with pytest.raises(InputError, match="thumbnail first"):
            load_photo(tmp_path / "a.nef")

    def test_unknown_tone_curve(self, tmp_path: Path) -> None:
        (tmp_path / "a.png").write_bytes(png(codes_of("uint8", 3)))
        with pytest.raises(InputError, match="tone_curve"):
            load_photo(tmp_path / "a.png", tone_curve="filmic")


@pytest.mark.parametrize(
    ("name", "shape", "clipped"),
    [
        pytest.param("epic/epic_1b_20220110005515.jpg", (1080, 1080), 147, id="epic"),
        pytest.param("iss/iss_d4_56mm.jpg", (2768, 4928), 2, id="iss"),
    ],
)
def test_real_photos(name: str, shape: tuple[int, int], clipped: int) -> None:
    path = data_file(name)
    photo = load_photo(path)
    with Image.open(path) as image:
        codes = np.asarray(image)
    assert photo.codes is not None
    np.testing.assert_array_equal(photo.codes, codes)
    assert clipped == int((photo.codes == photo.top).any(axis=-1).sum())
    assert photo.linear.shape == (*shape, 3)
    assert photo.excluded == {"masked": 0, "not finite": 0}
    np.testing.assert_allclose(
        photo.linear[::97, ::89], srgb_to_linear(codes[::97, ::89]), rtol=2e-7
    )


def test_real_exr_with_nan_and_inf() -> None:
    photo = load_photo(data_file("openexr_good/BrightRingsNanInf.exr"))
    assert photo.excluded == {"masked": 0, "not finite": 12}
    assert int((~np.isfinite(photo.linear)).sum()) == 18


def test_jpegs_are_known_by_what_they_hold(tmp_path: Path) -> None:
    codes = np.zeros((16, 16, 3), np.uint8)
    for name, lossy in (("a.jpg", True), ("a.png", False), ("a.tif", False)):
        Image.fromarray(codes).save(tmp_path / name)
        photo = load_photo(tmp_path / name)
        assert photo.lossy is lossy
        assert (photo.jpeg is not None) is lossy
    Image.fromarray(codes).save(tmp_path / "b.tif", compression="jpeg")
    assert load_photo(tmp_path / "b.tif").lossy
    assert load_photo(tmp_path / "b.tif").jpeg is None
    # Colours stored as they are, which Pillow writes, but not of RGB pictures by itself.
    Image.fromarray(codes).save(tmp_path / "rgb.jpg", keep_rgb=True)
    assert load_photo(tmp_path / "rgb.jpg").lossy
    assert load_photo(tmp_path / "rgb.jpg").jpeg is None
