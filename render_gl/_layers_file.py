"""Layer sets as EXR files: what `Layers` holds, and optionally the combined picture.

    front.Z  back.Z  shadow_front.Z  shadow_back.Z   eye depth relative to the header's reference
    shadow2_front.Z  shadow2_back.Z  …               further shadows
    surface.R/G/B  planet.A  water.Y  stretch.Y  width_error.Y  R G B A  optional

Header: airlight.reference, airlight.width_unit, airlight.color, airlight.view (JSON: how the
pixels' rays pass planet and shadows, `model_jax.Layers.view`), airlight.surface ("albedo" where it
is not lit), airlight.near, airlight.far, airlight.depth ("eye", "window", "reversed" or "log"),
airlight.scene (JSON) and airlight.scene_hash; of a picture airlight.look and airlight.blend: what
its look does with alpha (`Look.BLEND`).

Files of other renderers need `front.Z` and `back.Z` only: eye depths, or coded ones with near and
far in the header or given by the caller.
"""

import json
import re
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np
from jaxtyping import Float

from model_jax import ENCODINGS, DepthTextures, Encoding, InputError, Layers, Look, Scene
from model_jax._errors import shown
from model_jax._kinds import need, need_array, need_number
from model_jax._shapes import Rgba
from model_jax._view import Aim, Body, ShadowCone, View

from ._encoding import check_encoding
from ._exr import read_channels, write_channels
from ._files import PathLike
from ._scene_file import scene_hash, scene_record


def write_layers(
    path: PathLike,
    layers: Layers,
    scene: Scene | None = None,
    picture: Rgba | None = None,
    look: Look | None = None,
) -> None:
    """Write layers, float32, with the scene in the header; `picture` becomes R, G, B and A, and the
    header says of which look it is.

    The file appears whole or not at all; raises `InputError` when it cannot be written.
    """
    need("layers", layers, Layers)
    if scene is not None:
        need("scene", scene, Scene)
    channels = {"front.Z": np.asarray(layers.front), "back.Z": np.asarray(layers.back)}
    for end, depths in (("front", layers.shadow_front), ("back", layers.shadow_back)):
        if depths is not None:
            several = np.reshape(depths, (-1, *np.shape(layers.front)))
            channels |= {_shadow(k, end): depth for k, depth in enumerate(several)}
    if layers.surface is not None:
        channels |= {
            f"surface.{c}": np.asarray(layers.surface)[..., k] for k, c in enumerate("RGB")
        }
    if layers.planet is not None:
        channels["planet.A"] = np.asarray(layers.planet)
    if layers.water is not None:
        channels["water.Y"] = np.asarray(layers.water)
    if layers.stretch is not None:
        channels["stretch.Y"] = np.asarray(layers.stretch)
    if layers.width_error is not None:
        channels["width_error.Y"] = np.asarray(layers.width_error)
    if picture is not None:
        channels |= picture_channels(picture)
    attributes: dict[str, str | float | tuple[float, ...]] = {
        "airlight.depth": "eye",
        "airlight.reference": float(layers.reference),
        "airlight.width_unit": float(layers.width_unit),
        # EXR has no vector of four doubles.
        "airlight.color": tuple(float(c) for c in np.asarray(layers.color)[:3]),
        "airlight.alpha": float(np.asarray(layers.color)[3]),
    }
    if layers.is_albedo:
        attributes["airlight.surface"] = "albedo"
    if layers.view is not None:
        attributes["airlight.view"] = json.dumps(_plain(layers.view))
    if scene is not None:
        attributes |= scene_attributes(scene)
    write_channels(path, channels, attributes | _look_attributes(look))


def write_picture(
    path: PathLike, picture: Rgba, scene: Scene | None = None, look: Look | None = None
) -> None:
    """Write a picture, linear light [h, w, 4] or [h, w, 3], as float32 EXR; the header says of
    which look it is, and how its alpha blends."""
    if scene is not None:
        need("scene", scene, Scene)
    attributes = _look_attributes(look) | (scene_attributes(scene) if scene else {})
    write_channels(path, picture_channels(picture), attributes)


def _look_attributes(look: Look | None) -> dict[str, str | float | tuple[float, ...]]:
    if look is None:
        return {}
    need("look", look, Look)
    return {"airlight.look": look.NAME, "airlight.blend": look.BLEND}


def read_layers(
    path: PathLike,
    near: float | None = None,
    far: float | None = None,
    encoding: Encoding | None = None,
    constant: float = 1.0,
) -> Layers:
    """Layers from an EXR file, this project's or another renderer's.

    Args:
        near, far: clip planes, which coded depths need; of a file without them in its header.
            `far` may be `math.inf` for window and reversed depths: widths then are in scene length
            units, not in units of far − near.
        encoding: how depths are coded (`model_jax.Encoding`); None: as the header's
            `airlight.depth` says, else window depths where a clip plane is given, else eye depths.
        constant: C of logarithmic depths (`model_jax.linearize_depth`), 1 in three.js.

    Raises `InputError` for unreadable files, missing channels, impossible clip planes, and depths
    that are a sphere's, as the air's are, in another encoding and not in this one.
    """
    for name, plane in (("near", near), ("far", far)):
        if plane is not None:
            need_number(name, plane)
    channels, header = read_channels(path)
    for name in ("front.Z", "back.Z"):
        if name not in channels:
            raise InputError(
                f"{path}: has no channel {name} (it has {', '.join(sorted(channels))}); "
                "a layer file needs front.Z and back.Z"
            )
    begin, end = _shadows(path, channels)
    coding = _encoding(path, header, encoding, near is not None or far is not None)
    planes = (0.0, 1.0)  # unused by eye depths
    if coding != "linear":
        planes = _clip_planes(path, header, coding, near, far)
        _check_windows(path, channels)
    if not 0 < need_number("constant", constant) < np.inf:
        raise InputError(
            f"{path}: the constant of logarithmic depths is {shown(constant)}; give one > 0"
        )
    textures = DepthTextures(
        front=channels["front.Z"],
        back=channels["back.Z"],
        shadow_front=begin,
        shadow_back=end,
        near=planes[0],
        far=planes[1],
        encoding=coding,
        reference=_number(path, header, "airlight.reference", 0.0),
        constant=constant,
    )
    linear = textures.linearize()
    swapped = np.sum(linear.front > linear.back)
    if swapped > np.sum(linear.front < linear.back):
        raise InputError(
            f"{path}: front.Z lies behind back.Z in {int(swapped):,} pixels; swap the two "
            "channels, or "
            + ("the sign of the depths" if coding == "linear" else "say how depths are coded")
        )
    check_encoding(path, textures)
    rgb = [f"surface.{c}" for c in "RGB"]
    surface = np.stack([channels[c] for c in rgb], axis=-1) if set(rgb) <= set(channels) else None
    unit = _number(path, header, "airlight.width_unit", 1.0)
    if unit <= 0:
        raise InputError(f"{path}: airlight.width_unit is {unit!r}; it must be above 0")
    return replace(
        linear,
        surface=surface,
        is_albedo=surface is not None and header.get("airlight.surface") == "albedo",
        planet=channels.get("planet.A"),
        water=channels.get("water.Y"),
        color=_color(path, header),
        width_unit=linear.width_unit if coding != "linear" else unit,
        stretch=channels.get("stretch.Y"),
        width_error=channels.get("width_error.Y"),
        view=_view(path, header),
    )


def _plain(part: Any) -> Any:
    """A view as plain JSON data: every digit of its numbers."""
    if isinstance(part, View | Aim | Body | ShadowCone):
        return {f.name: _plain(getattr(part, f.name)) for f in fields(part)}
    return [_plain(p) for p in part] if isinstance(part, tuple) else np.asarray(part).tolist()


_SHAPES = {"principal": (2,), "anchor": (2,), "offset": (2,), "center": (3,), "axes": (3, 3)}
"""Shapes of what is no single number in a view."""
_PARTS: dict[str, type] = {"aim": Aim, "cones": ShadowCone, "occluders": Body}
"""What is made of further numbers, one or several of them."""


def _read_view(kind: type, record: dict[str, Any]) -> Any:
    """What `_plain` wrote; `ValueError`, `TypeError` or `KeyError` for anything else."""
    found: dict[str, Any] = {}
    for name in (f.name for f in fields(kind)):
        value = record[name]
        if name in _PARTS:
            several = isinstance(value, list)
            parts = tuple(_read_view(_PARTS[name], p) for p in (value if several else [value]))
            found[name] = parts if several else parts[0]
            continue
        number = np.array(value, float)[()]
        if np.shape(number) != _SHAPES.get(name, ()) or not np.isfinite(number).all():
            raise ValueError(name)
        found[name] = number
    return kind(**found)


def _view(path: PathLike, header: dict[str, object]) -> View | None:
    """How rays pass the planet, of a file that says so."""
    text = header.get("airlight.view")
    if text is None:
        return None
    try:
        return cast(View, _read_view(View, json.loads(str(text))))
    except (ValueError, TypeError, KeyError):
        raise InputError(
            f"{path}: airlight.view is {shown(text)}, which is not what airlight writes; write the "
            "file anew, or remove the attribute"
        ) from None


def picture_channels(picture: Rgba) -> dict[str, np.ndarray]:
    """R, G, B (and A) channels of a picture."""
    need_array("picture", picture, "[h, w, 3] or [h, w, 4]")
    if picture.ndim != 3 or picture.shape[-1] not in (3, 4):
        raise InputError(f"picture: has shape {picture.shape}; give [h, w, 3] or [h, w, 4]")
    pixels = np.asarray(picture)
    return {name: pixels[..., k] for k, name in enumerate("RGBA"[: pixels.shape[-1]])}


def scene_attributes(scene: Scene) -> dict[str, str | float]:
    """Header attributes that tell which scene a file shows."""
    return {
        "airlight.near": float(scene.camera.near),
        "airlight.far": float(scene.camera.far),
        "airlight.scene": json.dumps(scene_record(scene)),
        "airlight.scene_hash": scene_hash(scene),
    }


def _shadow(number: int, end: str) -> str:
    """Channel of a shadow's front or back; the first is the paper's and has no number."""
    return f"shadow{number + 1 if number else ''}_{end}.Z"


def _shadows(
    path: PathLike, channels: dict[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray] | tuple[None, None]:
    """Fronts and backs of all shadows of a file: [h, w] of one, [n, h, w] of several."""
    found: list[tuple[np.ndarray, np.ndarray]] = []
    names = {name for name in channels if re.fullmatch(r"shadow\d*_(front|back)\.Z", name)}
    while names:
        pair = [_shadow(len(found), end) for end in ("front", "back")]
        if not set(pair) <= names:
            raise InputError(
                f"{path}: has {', '.join(sorted(names))} but not both of {' and '.join(pair)}; "
                "shadows are numbered shadow, shadow2, shadow3 …, each with front and back"
            )
        found.append((channels[pair[0]], channels[pair[1]]))
        names -= set(pair)
    if len(found) > 1:
        fronts, backs = zip(*found, strict=True)
        return np.stack(fronts), np.stack(backs)
    return found[0] if found else (None, None)


def _encoding(
    path: PathLike, header: dict[str, object], asked: Encoding | None, has_planes: bool
) -> Encoding:
    """The caller's encoding, else the header's, else by whether there are clip planes."""
    said = header.get("airlight.depth", "window" if has_planes else "eye")
    found = asked if asked is not None else "linear" if said == "eye" else said
    for known in ENCODINGS:
        if found == known:
            return known
    raise InputError(
        f"{path}: depths coded as {found!r} are not read; use one of {', '.join(ENCODINGS)}"
    )


def _clip_planes(
    path: PathLike,
    header: dict[str, object],
    encoding: Encoding,
    near: float | None,
    far: float | None,
) -> tuple[float, float]:
    """The caller's clip planes, else the header's."""
    found = [
        header.get(f"airlight.{name}") if given is None else given
        for name, given in (("near", near), ("far", far))
    ]
    numbers = [float(n) for n in found if isinstance(n, int | float)]
    if len(numbers) != 2 or not 0 < numbers[0] < numbers[1]:
        raise InputError(
            f"{path}: {encoding} depths need clip planes 0 < near < far, not near {found[0]} and "
            f"far {found[1]}; give --near and --far"
        )
    if np.isinf(numbers[1]) and encoding == "log":
        raise InputError(f"{path}: log depths have no infinite far plane; give its depth as --far")
    return numbers[0], numbers[1]


def _check_windows(path: PathLike, channels: dict[str, np.ndarray]) -> None:
    for name in ("front.Z", "back.Z"):
        values = channels[name]
        if np.any((values < 0) | (values > 1)):
            raise InputError(
                f"{path}: {name} runs from {np.nanmin(values):g} to {np.nanmax(values):g}, which "
                "are no coded depths (0 to 1); leave --near and --far away, or give --encoding "
                "linear, if they are eye depths"
            )


def _color(path: PathLike, header: dict[str, object]) -> Float[np.ndarray, "4"]:
    """Colour and alpha of the air."""
    color = header.get("airlight.color", (1.0, 1.0, 1.0))
    if not (isinstance(color, tuple) and len(color) == 3 and np.all(np.isfinite(color))):
        raise InputError(f"{path}: airlight.color is {color!r}; it must be three finite numbers")
    return np.array([*color, _number(path, header, "airlight.alpha", 1.0)])


def _number(path: PathLike, header: dict[str, object], name: str, default: float) -> float:
    value = header.get(name, default)
    if not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{path}: {name} is {value!r}; it must be a finite number")
    return float(value)
