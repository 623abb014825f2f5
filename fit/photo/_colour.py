"""What picture files say of their colours: how light was coded, and in which red, green and blue.

The tone curve is used. Light stays in the file's own primaries, for the fit compares channel by
channel; where these are not sRGB's, a remark says so, as it does of whatever cannot be used.

Sources: PNG (third edition) §4.3 for which chunk counts, ITU-T H.273 for the codes in cICP,
ICC.1:2022 §10 for curves, EXIF 2.32 and DCF 2.0 for JPEG, the OpenEXR file layout for EXR.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from model_jax._errors import cut
from model_jax._tone import Linear, Power, Sampled, Srgb, ToneCurve

SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
"""Chromaticities x, y of red, green, blue and white: ITU-R BT.709-6, table 1."""
_SRGB_D50 = (0.4361, 0.2225, 0.0139, 0.3851, 0.7169, 0.0971, 0.1431, 0.0606, 0.7141)
"""The same as XYZ of red, green and blue, adapted to D50 as in ICC profiles."""
_ALIKE = 0.01
"""Chromaticities are written with two digits and more; the next primaries differ by 0.05."""
_SAME_CURVE = 1e-3
"""Difference of light in [0, 1] up to which two curves are one: a quarter of an 8-bit code. Tables
of sRGB's curve differ by 2e-4."""
_NODES = 4096
"""Points of a curve that is kept as a table: sixteen for each of 256 codes."""


@dataclass(frozen=True)
class Colours:
    """What a file says."""

    curve: ToneCurve | None = None
    """None: it does not say."""
    source: str = ""
    """What says so, as in "its gAMA chunk"."""
    remarks: tuple[str, ...] = ()
    """What it says and is not used, in sentences."""


def of_png(data: bytes) -> Colours:
    """The first of cICP, iCCP, sRGB, gAMA with cHRM that there is."""
    chunks: dict[bytes, bytes] = {}
    start = 8
    while start + 8 <= len(data):
        size, name = struct.unpack(">I4s", data[start : start + 8])
        if name == b"IDAT":
            break
        chunks.setdefault(name, data[start + 8 : start + 8 + size])
        start += 12 + size
    if b"cICP" in chunks:
        return _said("its cICP chunk", lambda: _of_cicp(*struct.unpack(">4B", chunks[b"cICP"])))
    if b"iCCP" in chunks:
        import zlib

        packed = chunks[b"iCCP"].partition(b"\0")[2][1:]
        # A profile is some kB; a few bytes may claim to be GB.
        return of_icc(lambda: zlib.decompressobj().decompress(packed, 2**24))
    if b"sRGB" in chunks:
        return Colours(Srgb(), "its sRGB chunk")
    found = Colours()
    if b"gAMA" in chunks:

        def of_gama() -> Colours:
            (number,) = struct.unpack(">I", chunks[b"gAMA"])
            gamma = 1e5 / number
            return Colours(Linear() if gamma == 1 else Power(gamma))

        found = _said("its gAMA chunk", of_gama)
    if b"cHRM" in chunks:

        def of_chrm() -> Colours:
            white, *rest = np.reshape(struct.unpack(">8I", chunks[b"cHRM"]), (4, 2)) / 1e5
            return Colours(remarks=_primaries(np.ravel([*rest, white]), SRGB, "cHRM chunk"))

        found = replace(found, remarks=found.remarks + _said("its cHRM chunk", of_chrm).remarks)
    return found


def of_icc(read: Callable[[], bytes]) -> Colours:
    """Colours by an ICC profile: the tone curve of its three channels, or of grey."""
    return _said("its ICC profile", lambda: _of_profile(read()))


def of_jpeg(info: Mapping[Any, Any], exif: Any) -> Colours:
    """An ICC profile, else EXIF's gamma or colour space.

    Args:
        info, exif: of a Pillow image.
    """
    if "icc_profile" in info:
        return of_icc(lambda: info["icc_profile"])
    details = exif.get_ifd(0x8769)
    if 0xA500 in details:
        return _said("its EXIF gamma", lambda: Colours(Power(float(details[0xA500]))))
    try:
        rule = exif.get_ifd(0xA005).get(1)
    except KeyError:  # Pillow before 13, where there is none
        rule = None
    if rule == "R03":
        # DCF 2.0 §3.4: Adobe RGB (1998), whose curve is a power of 563/256.
        told = _not_srgb("EXIF colour space", "Adobe RGB")
        return Colours(Power(563 / 256), "its EXIF colour space", (told,))
    return Colours(Srgb(), "its EXIF colour space") if details.get(0xA001) == 1 else Colours()


def of_tiff(tags: Mapping[int, Any]) -> Colours:
    """An ICC profile, else chromaticities and transfer function.

    Args:
        tags: values by number.
    """
    if tags.get(34675) is not None:
        return of_icc(lambda: bytes(tags[34675]))
    remarks: tuple[str, ...] = ()
    if tags.get(319) is not None:

        def of_primaries() -> Colours:
            rgb = np.reshape(np.asarray(tags[319], float), (-1, 2))
            numbers = rgb[:, 0] / rgb[:, 1]
            return Colours(remarks=_primaries(numbers, SRGB[:6], "PrimaryChromaticities"))

        remarks += _said("its PrimaryChromaticities", of_primaries).remarks
    if tags.get(301) is not None:
        remarks += ("Its TransferFunction is not used; give the tone curve, if it is not sRGB's.",)
    return Colours(remarks=remarks)


def of_exr(attributes: Mapping[str, object]) -> Colours:
    """Chromaticities; light is linear in EXR files."""
    if "chromaticities" not in attributes:
        return Colours()
    said = attributes["chromaticities"]
    return _said(
        "its chromaticities",
        lambda: Colours(
            remarks=_primaries(np.ravel(np.asarray(said, float)), SRGB, "chromaticities")
        ),
    )


def _said(source: str, read: Callable[[], Colours]) -> Colours:
    """What was read, or that it cannot be."""
    try:
        found = read()
    except Exception as error:  # of bytes from anywhere: struct, zlib, NumPy, our own
        reason = cut(" ".join(str(error).split()) or type(error).__name__)
        return Colours(remarks=(f"{source[:1].upper()}{source[1:]} is not used ({reason}).",))
    return replace(found, source=found.source or source)


def _primaries(
    found: Float[np.ndarray, " n"], srgb: Sequence[float], source: str
) -> tuple[str, ...]:
    if np.shape(found) != np.shape(srgb) or not np.all(np.isfinite(found)):
        raise ValueError("its numbers are no chromaticities")
    if np.max(np.abs(found - srgb)) <= _ALIKE:
        return ()
    red, green, blue = ("({:.3g}, {:.3g})".format(*found[k : k + 2]) for k in (0, 2, 4))
    return (_not_srgb(source, f"at {red}, {green} and {blue}"),)


def _not_srgb(source: str, which: str) -> str:
    return (
        f"Its red, green and blue are not sRGB's but {which}, by its {source}: the fit takes them "
        "as they are, and what that does to colours is in the look."
    )


def _of_cicp(primaries: int, transfer: int, matrix: int, full_range: int) -> Colours:
    """ITU-T H.273, tables 2 and 3."""
    remarks: tuple[str, ...] = ()
    if matrix != 0 or full_range != 1:
        raise ValueError(f"matrix {matrix}, full range {full_range}: RGB of full range is read")
    if primaries != 1:
        named = {9: "BT.2020's", 11: "DCI-P3's", 12: "Display P3's"}
        remarks = (_not_srgb("cICP chunk", named.get(primaries, f"number {primaries} of H.273")),)
    if transfer in (4, 5):
        return Colours(Power(2.2 if transfer == 4 else 2.8), remarks=remarks)
    if transfer == 8:
        return Colours(Linear(), remarks=remarks)
    if transfer == 13:
        return Colours(Srgb(), remarks=remarks)
    if transfer in _TRANSFERS:
        name, decode = _TRANSFERS[transfer]
        light = decode(np.linspace(0, 1, 2**16))
        return Colours(_sampled(name, light), remarks=remarks)
    raise ValueError(f"transfer {transfer} of H.273 is not known here")


def _bt709(stored: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """ITU-R BT.709-6 §1.2, solved for light."""
    return np.where(stored < 0.081, stored / 4.5, ((stored + 0.099) / 1.099) ** (1 / 0.45))


def _pq(stored: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """ITU-R BT.2100-2, table 4: light over 10,000 cd/m²."""
    m1, m2, c1, c2, c3 = 2610 / 16384, 2523 / 32, 3424 / 4096, 2413 / 128, 2392 / 128
    root = stored ** (1 / m2)
    return (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1)


def _hlg(stored: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """ITU-R BT.2100-2, table 5: light of the scene."""
    a, b = 0.17883277, 0.28466892
    c = 0.5 - a * np.log(4 * a)
    return np.where(stored <= 0.5, stored**2 / 3, (np.exp((stored - c) / a) + b) / 12)


_TRANSFERS: dict[int, tuple[str, Callable[[np.ndarray], np.ndarray]]] = {
    **dict.fromkeys((1, 6, 14, 15), ("BT.709", _bt709)),
    16: ("PQ", _pq),
    18: ("HLG", _hlg),
}


def _of_profile(profile: bytes) -> Colours:
    """ICC.1:2022: header §7.2, tag table §7.3."""
    space = profile[16:20]
    if len(profile) < 132 or profile[36:40] != b"acsp":
        raise ValueError("it is damaged")
    (count,) = struct.unpack(">I", profile[128:132])
    entries = struct.iter_unpack(">4sII", profile[132 : 132 + 12 * min(count, 1000)])
    tags = {name: profile[start : start + size] for name, start, size in entries}
    name = _description(tags.get(b"desc", b""))
    source = f"its ICC profile {name!r}" if name else "its ICC profile"
    names = [b"kTRC"] if space == b"GRAY" else [b"rTRC", b"gTRC", b"bTRC"]
    if space not in (b"GRAY", b"RGB ") or not set(names) <= set(tags):
        kind = space.decode("latin-1").strip()
        raise ValueError(f"it describes {kind} colours by a table; give the tone curve")
    curves = [_curve(tags[name]) for name in names]
    stored = np.linspace(0, 1, _NODES)
    light = [np.asarray(curve.decode(stored)) for curve in curves]
    if any(np.max(np.abs(other - light[0])) > _SAME_CURVE for other in light):
        raise ValueError("its channels have different tone curves; give the tone curve")
    remarks: tuple[str, ...] = ()
    colorants = [tags.get(name, b"") for name in (b"rXYZ", b"gXYZ", b"bXYZ")]
    if space == b"RGB " and all(len(tag) >= 20 for tag in colorants):
        xyz = np.ravel([struct.unpack(">3i", tag[8:20]) for tag in colorants]) / 65536
        if np.max(np.abs(xyz - _SRGB_D50)) > _ALIKE:
            remarks = (_not_srgb("ICC profile", f"those of {name or 'the profile'}"),)
    for known in (Linear(), Srgb()):
        if np.max(np.abs(np.asarray(known.decode(stored)) - light[0])) <= _SAME_CURVE:
            return Colours(known, source, remarks)
    return Colours(curves[0], source, remarks)


def _curve(tag: bytes) -> ToneCurve:
    """ICC.1:2022 §10.6 (curveType) and §10.18 (parametricCurveType)."""
    kind = tag[:4]
    if kind == b"curv":
        (count,) = struct.unpack(">I", tag[8:12])
        numbers = np.frombuffer(tag[12 : 12 + 2 * count], ">u2").astype(np.float64)
        if count == 0:
            return Linear()
        if count == 1:
            return Power(numbers[0] / 256)
        if len(numbers) != count:
            raise ValueError("it is damaged")
        return _sampled("ICC", numbers / 65535)
    if kind != b"para":
        raise ValueError(f"its curves are of the kind {kind!r}")
    (form,) = struct.unpack(">H", tag[8:10])
    size = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}[form]
    g, a, b, c, d, e, f = np.pad(
        np.array(struct.unpack(f">{size}i", tag[12 : 12 + 4 * size])) / 65536, (0, 7 - size)
    )
    if form == 0:
        return Power(g)
    x = np.linspace(0, 1, 2**16)
    powered = np.maximum(a * x + b, 0) ** g
    if form in (1, 2):
        light = np.where(x >= -b / a, powered + c, c)
    else:
        light = np.where(x >= d, powered + e, c * x + f)
    return _sampled("ICC", np.clip(light, 0, 1))


def _sampled(name: str, light: Float[np.ndarray, " n"]) -> Sampled:
    """Standards round where their two pieces meet, so that light may fall there by 1e-5."""
    grown = np.maximum.accumulate(light)
    return Sampled(name, grown if np.max(grown - light) <= _SAME_CURVE else light)


def _description(tag: bytes) -> str:
    """The profile's name, of either version; empty where it has none that is text."""
    text = ""
    if tag[:4] == b"desc" and len(tag) >= 12:
        (size,) = struct.unpack(">I", tag[8:12])
        text = tag[12 : 12 + min(size, 200)].decode("latin-1")
    elif tag[:4] == b"mluc" and len(tag) >= 28:
        size, start = struct.unpack(">II", tag[20:28])
        text = tag[start : start + min(size, 400)].decode("utf-16-be", "ignore")
    return "".join(letter for letter in text if letter.isprintable()).strip()
