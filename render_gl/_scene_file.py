"""Scene files: TOML in, `Scene`, `Look` and photo settings out.

    [camera]      position, forward or target, up, fov_y_deg, width, height, near, far
    [planet]      radius; relief, relief_unit, relief_scale, relief_distance, albedo, triangles
    [atmosphere]  height; color
    [sun]         direction; angular_radius_deg            (absent: no shadow volume)
    [[occluder]]  center, radius
    [look]        brightness, shadow, tint, background
    [photo]       path, tone_curve, mask

Unknown keys, wrong types and impossible values are errors that name file, key and remedy. Paths are
relative to the scene file.
"""

import difflib
import hashlib
import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Look,
    Occluder,
    Planet,
    Scene,
    Sun,
    ToneCurve,
    parse_tone_curve,
)

from ._files import PathLike, check_file

_NUMBER = "a number"
_WHOLE = "a whole number"
_TEXT = "a string"
_VECTOR = "a list of three numbers"
_PAIR = "a list of two numbers"

# Per table: key -> what its value must be; a leading "!" marks a key that must be there.
_TABLES: dict[str, dict[str, tuple[str, ...]]] = {
    "camera": {
        "position": ("!", _VECTOR),
        "forward": (_VECTOR,),
        "target": (_VECTOR,),
        "up": ("!", _VECTOR),
        "fov_y_deg": ("!", _NUMBER),
        "width": ("!", _WHOLE),
        "height": ("!", _WHOLE),
        "near": ("!", _NUMBER),
        "far": ("!", _NUMBER),
    },
    "planet": {
        "radius": ("!", _NUMBER),
        "relief": (_TEXT,),
        "relief_unit": (_NUMBER,),
        "relief_scale": (_NUMBER, _PAIR),
        "relief_distance": (_PAIR,),
        "albedo": (_TEXT,),
        "triangles": (_WHOLE,),
    },
    "atmosphere": {
        "height": ("!", _NUMBER),
        "color": (_VECTOR, "a list of four numbers"),
        "path": (_TEXT,),
    },
    "sun": {"direction": ("!", _VECTOR), "angular_radius_deg": (_NUMBER,)},
    "occluder": {"center": ("!", _VECTOR), "radius": ("!", _NUMBER)},
    "look": {
        "brightness": (_NUMBER,),
        "shadow": (_NUMBER, _VECTOR),
        "tint": (_VECTOR,),
        "background": (_NUMBER, _VECTOR),
    },
    "photo": {"path": (_TEXT,), "tone_curve": (_TEXT, "a table"), "mask": (_TEXT,)},
}
_NEEDED = ("camera", "planet", "atmosphere")


@dataclass(frozen=True)
class PhotoSettings:
    """What a scene file says of its photo; each may be absent."""

    path: str | None = None
    tone_curve: ToneCurve | None = None
    mask: str | None = None


@dataclass(frozen=True)
class SceneFile:
    """A scene file's contents."""

    path: Path
    scene: Scene
    look: Look
    photo: PhotoSettings


def load_scene(path: PathLike) -> SceneFile:
    """Read a scene file. Raises `InputError` in one line: file, key, value, remedy."""
    file = check_file(path)
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no TOML file ({error}); correct it there") from None
    try:
        return _build(file, document)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _build(file: Path, document: dict[str, Any]) -> SceneFile:
    _check_keys("", document, _TABLES)
    for name in _NEEDED:
        if name not in document:
            raise InputError(f"[{name}] is missing; add that table")
    tables: dict[str, Any] = {}
    for name, table in document.items():
        rows = table if name == "occluder" else [table]
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            form = f"[[{name}]]" if name == "occluder" else f"[{name}]"
            raise InputError(f"{name}: {table!r} must be written as a {form} table")
        for row in rows:
            _check_table(name, row)
        tables[name] = table

    def beside(name: str | None) -> str | None:
        return None if name is None else str((file.parent / name).resolve())

    scene = Scene(
        camera=_camera(tables["camera"]),
        planet=_planet(tables["planet"], beside),
        atmosphere=Atmosphere(**tables["atmosphere"]),
        sun=Sun(**tables["sun"]) if "sun" in tables else None,
        occluders=tuple(Occluder(**row) for row in tables.get("occluder", [])),
    )
    photo = tables.get("photo", {})
    curve = photo.get("tone_curve")
    return SceneFile(
        path=file,
        scene=scene,
        look=Look(**tables.get("look", {})),
        photo=PhotoSettings(
            path=beside(photo.get("path")),
            tone_curve=None if curve is None else parse_tone_curve(curve),
            mask=beside(photo.get("mask")),
        ),
    )


def _camera(table: dict[str, Any]) -> Camera:
    table = dict(table)
    if ("forward" in table) == ("target" in table):
        raise InputError("camera: give either forward or target, and one of them only")
    if "target" in table:
        target = np.asarray(table.pop("target"), dtype=float)
        table["forward"] = target - np.asarray(table["position"], dtype=float)
        if not np.any(table["forward"]):
            raise InputError(f"camera.target: {target.tolist()} is the camera's own position")
    return Camera(**table)


def _planet(table: dict[str, Any], beside: Any) -> Planet:
    table = dict(table)
    for name in ("relief", "albedo"):
        if name in table:
            table[name] = beside(table[name])
    if "relief_scale" in table:
        scale = table["relief_scale"]
        table["relief_scale"] = tuple(scale) if isinstance(scale, list) else (scale, scale)
    if "relief_distance" in table:
        table["relief_distance"] = tuple(table["relief_distance"])
    return Planet(**table)


def _check_keys(where: str, table: dict[str, Any], known: Any) -> None:
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"unknown key {where}{key}; {remedy}")


def _check_table(name: str, table: dict[str, Any]) -> None:
    known = _TABLES[name]
    _check_keys(f"{name}.", table, known)
    for key, kinds in known.items():
        if key not in table:
            if kinds[0] == "!":
                raise InputError(f"{name}.{key} is missing; add it")
            continue
        allowed = [kind for kind in kinds if kind != "!"]
        if not any(_is(table[key], kind) for kind in allowed):
            raise InputError(f"{name}.{key}: {table[key]!r} must be {' or '.join(allowed)}")


def _is(value: Any, kind: str) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    sizes = {_VECTOR: 3, _PAIR: 2, "a list of four numbers": 4}
    if kind in sizes:
        return (
            isinstance(value, list)
            and len(value) == sizes[kind]
            and all(_is(item, _NUMBER) for item in value)
        )
    return {
        _NUMBER: number,
        _WHOLE: number and isinstance(value, int),
        _TEXT: isinstance(value, str),
        "a table": isinstance(value, dict),
    }[kind]


def scene_record(scene: Scene) -> dict[str, Any]:
    """The scene as plain JSON data, with the keys of a scene file; absent tables are left out."""
    return {
        name: _plain(value) for name, value in _fields(scene).items() if value not in (None, ())
    }


def scene_hash(scene: Scene) -> str:
    """SHA-256 over `scene_record`: the same numbers give the same hash, whatever their file."""
    text = json.dumps(scene_record(scene), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _fields(record: eqx.Module) -> dict[str, Any]:
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def _plain(value: Any) -> Any:
    if isinstance(value, eqx.Module):
        return {name: _plain(item) for name, item in _fields(value).items() if item is not None}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, str | int):
        return value
    return np.asarray(value, dtype=np.float64).tolist()
