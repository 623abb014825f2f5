"""Photos read: JPEG, PNG, TIFF and EXR by what they contain, not by their names."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float
from PIL import ExifTags, Image, ImageFile, JpegImagePlugin, UnidentifiedImageError
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from model_jax._errors import InputError, need_path
from model_jax._tone import Linear, Srgb, ToneCurve, parse_tone_curve
from render_gl._files import PathLike

from .._numbers import curve_in_words
from ._colour import Colours, of_exr, of_jpeg, of_png, of_tiff
from ._photo import REASONS, Jpeg, Photo

if TYPE_CHECKING:
    from render_gl import PhotoSettings

MAX_PIXELS = 2**28
"""Largest photo read, 268 megapixels: a small damaged or hostile file can claim any size."""


def load_photo(
    path: "PathLike | PhotoSettings", tone_curve: object = None, mask: PathLike | None = None
) -> Photo:
    """Read a photo: JPEG, PNG or TIFF of 8 or 16 bits, float TIFF, EXR.

    `path` names a file, or is a scene file's `photo` (`render_gl.load_scene(…).photo`), whose tone
    curve and mask are used where no others are given.

    `tone_curve` is a `ToneCurve` or what `parse_tone_curve` accepts; None means what the file says
    (`_colour`), else linear for EXR and float TIFF, sRGB for integer photos. `mask` names a picture
    of the photo's size: white keeps a pixel, black leaves it out (any channel ≠ 0 keeps).

    Grey becomes three equal channels, alpha is dropped (also a mask's), palettes are looked up,
    EXIF orientation is applied to photo and mask. Photos that are black, white or NaN all over are
    no errors here: what can be learned from them is the fit's verdict.

    Raises `InputError` for files that are missing, damaged, cut off, of another format, of more
    than `MAX_PIXELS` pixels, for CMYK, for an EXR without R, G, B, and for a mask of another size.
    """
    from render_gl._scene_file import PhotoSettings, SceneFile

    if isinstance(path, SceneFile):
        raise InputError("path: is a SceneFile; give its .photo")
    if isinstance(path, PhotoSettings):
        if path.path is None:
            raise InputError(
                "photo: the scene names none; write path into its [photo], or give a file's path"
            )
        curve, own = path.tone_curve, path.mask
        return load_photo(
            path.path,
            curve if tone_curve is None else tone_curve,
            own if mask is None else mask,
        )
    file = Path(need_path("path", path))
    stored, bits, lossy, jpeg, colours = _read(file)
    curve, remarks = _choose_curve(tone_curve, colours, bits)
    stored = _three_channels(file, stored)
    light: np.ndarray | None = None
    half_steps: np.ndarray | None = None
    reason = np.zeros(stored.shape[:2], dtype=np.uint8)
    if bits is None:
        stored = _decode_float(stored, curve)
        reason[~np.isfinite(stored).all(axis=-1)] = 1 + REASONS.index("not finite")
    else:
        light, half_steps = _code_tables(curve, bits)
    if mask is not None:
        reason[~_read_mask(mask, file, stored)] = 1 + REASONS.index("masked")
    return Photo(
        path=file,
        stored=stored,
        reason=reason,
        tone_curve=curve,
        bits=32 if bits is None else bits,
        light=light,
        half_steps=half_steps,
        lossy=lossy,
        jpeg=jpeg,
        remarks=remarks,
    )


def _choose_curve(
    asked: object, colours: Colours, bits: int | None
) -> tuple[ToneCurve, tuple[str, ...]]:
    """The curve that is used, and what the file says that is not."""
    usual: ToneCurve = Linear() if bits is None else Srgb()
    if asked is None:
        return colours.curve or usual, colours.remarks
    curve, said = parse_tone_curve(asked), colours.curve
    if said is None or said.describe() == curve.describe():
        return curve, colours.remarks
    told = [curve_in_words(c.describe()) for c in (said, curve)]
    override = f"The file says {told[0]} ({colours.source}), and {told[1]} is used as asked."
    return curve, (*colours.remarks, override)


def _code_tables(
    curve: ToneCurve, bits: int
) -> tuple[Float[np.ndarray, " codes"], Float[np.ndarray, " codes"]]:
    """Linear light and half a code step in it for each code, decoded in float64, kept as float32.

    A highest code whose light would be infinite has the light half a code below it.

    Half a step is half the difference of the light half a code above and below; at the first and
    the last code, where nothing is stored beyond, the step on the one side there is.
    """
    top = 2**bits - 1
    codes = np.arange(top + 1, dtype=np.float64)
    light = np.asarray(curve.decode(codes / top), dtype=np.float64)
    edges = np.asarray(curve.decode((codes[:-1] + 0.5) / top), dtype=np.float64)
    if not np.isfinite(light[-1]):
        light[-1] = edges[-1]
    half_step = np.empty_like(light)
    half_step[1:-1] = np.diff(edges) / 2
    half_step[0] = edges[0] - light[0]
    half_step[-1] = max(light[-1] - edges[-1], half_step[-2])
    return light.astype(np.float32), half_step.astype(np.float32)


def _decode_float(stored: np.ndarray, curve: ToneCurve) -> np.ndarray:
    """Linear light of float samples, channel by channel in float64; NaN and Inf pass quietly."""
    with np.errstate(over="ignore", invalid="ignore"):
        if isinstance(curve, Linear):
            return stored.astype(np.float32)
        linear = np.empty(stored.shape, dtype=np.float32)
        for k in range(stored.shape[-1]):
            channel = stored[..., k].astype(np.float64)
            decoded = np.asarray(curve.decode(channel))
            # A curve clips by comparing, which lets NaN through as a number: put it back.
            linear[..., k] = np.where(np.isfinite(channel), decoded, channel)
    return linear


def _read_mask(path: PathLike, photo: Path, stored: np.ndarray) -> np.ndarray:
    """True where the mask keeps the pixel."""
    file = Path(need_path("mask", path))
    values = _read(file, any_channels=True).samples
    if values.shape[:2] != stored.shape[:2]:
        (height, width), (photo_height, photo_width) = values.shape[:2], stored.shape[:2]
        raise InputError(
            f"{file}: the mask is {width}×{height}, {photo} is {photo_width}×{photo_height}; "
            "give a mask of the photo's size"
        )
    with np.errstate(invalid="ignore"):
        return (np.abs(values) > 0).any(axis=-1)  # NaN does not keep


def _three_channels(path: Path, stored: np.ndarray) -> np.ndarray:
    """[h, w, 3] from grey or RGB."""
    if stored.shape[-1] == 3:
        return stored
    return np.broadcast_to(stored, (*stored.shape[:2], 3))


class _Stored(NamedTuple):
    """What a file holds."""

    samples: np.ndarray
    """[h, w, 1 or 3], of an EXR mask any number."""
    bits: int | None
    """None for float."""
    lossy: bool
    jpeg: Jpeg | None = None
    colours: Colours = Colours()


def _read(path: Path, any_channels: bool = False) -> _Stored:
    from render_gl._exr import MAGIC as EXR
    from render_gl._files import JPEG, PNG, TIFF, check_file, decoding

    with open(check_file(path), "rb") as stream:
        start = stream.read(8)
    if start.startswith(EXR):
        return _read_exr(path, any_channels)
    reader: Callable[[Path], _Stored]
    if start.startswith((JPEG, PNG)):
        reader = _read_with_pillow
    elif start.startswith(TIFF):
        reader = _read_tiff
    else:
        raise InputError(f"{path}: {_name_format(path, start)}; save it as PNG, TIFF, JPEG or EXR")
    with decoding(path):
        return reader(path)


def _name_format(path: Path, start: bytes) -> str:
    """What a file that is not read is, as far as Pillow can tell."""
    if start[4:] == b"ftyp":
        return "is a HEIF or AVIF picture, which is not read"
    for extension in ("WEBP", "BMP", "GIF", "PPM", "JPEG2000", "ICO", "PSD"):
        try:
            with Image.open(path, formats=[extension]) as image:
                return f"is a {image.format} picture, which is not read"
        except (UnidentifiedImageError, KeyError):
            continue
        except Exception:  # damaged, or claims a huge size: its kind is known all the same
            return f"is a {extension} picture, which is not read"
    return "is no picture"


def _read_with_pillow(path: Path) -> _Stored:
    """JPEG and PNG. The classes are named because `Image.open` limits all photos of the process to
    a number of pixels that real ones exceed; ours is `MAX_PIXELS`."""
    if ImageFile.LOAD_TRUNCATED_IMAGES:
        raise InputError(
            f"{path}: PIL.ImageFile.LOAD_TRUNCATED_IMAGES is on, which hides cut-off photos; "
            "switch it off"
        )
    from render_gl._files import PNG
    from render_gl._tiff import check_size

    with open(path, "rb") as stream:
        is_png = stream.read(len(PNG)) == PNG
        stream.seek(24)
        depth = stream.read(1)  # of a PNG: in its first chunk, at a fixed place
    image: Image.Image
    with PngImageFile(path) if is_png else JpegImageFile(path) as image:
        check_size(path, image.size, MAX_PIXELS)
        orientation = image.getexif().get(ExifTags.Base.Orientation, 1)
        if image.mode in ("CMYK", "YCCK"):
            raise InputError(f"{path}: is {image.mode}; convert it to RGB")
        if is_png and depth == b"\x10":
            import imagecodecs  # Pillow keeps 8 of the 16 bits of colour PNGs

            codes, bits = imagecodecs.png_decode(path.read_bytes()), 16
        else:
            grey = image.mode in ("1", "L", "LA")
            codes, bits = np.asarray(image.convert("L" if grey else "RGB")), 8
        jpeg = _jpeg_of(image, orientation) if isinstance(image, JpegImageFile) else None
        colours = of_png(path.read_bytes()) if is_png else of_jpeg(image.info, image.getexif())
    return _Stored(orient(_colour_first(codes), orientation), bits, not is_png, jpeg, colours)


def _jpeg_of(image: JpegImageFile, orientation: object) -> Jpeg | None:
    """None for what Pillow could not write again: odd sampling, colours stored as RGB, tables that
    come after the first scan; and for grey ones, whose light is no one channel's of a look."""
    sampling = JpegImagePlugin.get_sampling(image)
    stored_rgb = image.info.get("adobe_transform") == 0
    # Without a marker that says so, decoders go by the components' names.
    named_rgb = [layer[0] for layer in image.layer] == [*b"RGB"] and "jfif" not in image.info
    known = all(table in image.quantization for *_, table in image.layer)
    if image.layers != 3 or sampling < 0 or stored_rgb or named_rgb or not known:
        return None
    tables = tuple(tuple(image.quantization[table]) for *_, table in image.layer)
    return Jpeg(tables, sampling, orientation if isinstance(orientation, int) else 1)


def _read_tiff(path: Path) -> _Stored:
    # Only here: the core of `fit` works without `render_gl` and OpenGL.
    from render_gl._tiff import read_page

    page = read_page(path, MAX_PIXELS)
    kind = page.samples.dtype.kind
    if kind not in "uf" or (kind == "u" and page.bits > 16):
        raise InputError(
            f"{path}: its samples are {page.samples.dtype}; save it with 8 or 16 bits or as float"
        )
    bits = None if kind == "f" else page.bits
    pixels = _colour_first(page.samples)
    if page.white_is_zero:
        pixels = (1 if bits is None else 2**bits - 1) - pixels
    pixels = orient(pixels, page.tags[274] or 1)
    return _Stored(pixels, bits, page.lossy, colours=of_tiff(page.tags))


def _read_exr(path: Path, any_channels: bool) -> _Stored:
    """R, G, B of an EXR, or Y of a grey one; for a mask all channels there are."""
    # Only here: the core of `fit` works without `render_gl` and OpenGL.
    from render_gl._exr import read_channels
    from render_gl._tiff import check_size

    channels, attributes = read_channels(path)
    names = list(channels) if any_channels else ["R", "G", "B"]
    if not any_channels and set(channels) & {*"RGBY"} == {"Y"}:
        names = ["Y"]
    if not set(names) <= set(channels):
        raise InputError(
            f"{path}: has the channels {sorted(channels)}; a photo needs R, G and B, or Y; "
            "export it with these names"
        )
    check_size(path, channels[names[0]].shape[::-1], MAX_PIXELS)
    samples = np.stack([channels[name] for name in names], axis=-1)
    return _Stored(samples, None, False, colours=of_exr(attributes))


def _colour_first(pixels: np.ndarray) -> np.ndarray:
    """[h, w, 1 or 3]: without alpha and whatever else follows the colour."""
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    return pixels[..., : 3 if pixels.shape[-1] >= 3 else 1]


def orient(pixels: np.ndarray, orientation: object) -> np.ndarray:
    """The picture as its EXIF orientation (1 to 8) says to show it; other values change nothing.

    EXIF 2.32, tag 0x0112: where row 0 and column 0 of the stored picture belong.
    """
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels
