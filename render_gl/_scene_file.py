"""Scene files: TOML in, `Scene`, `Look` and photo settings out.

    [camera]      position, forward or target, up, fov_y_deg, width, height, near, far
    [planet]      radius; relief, relief_unit, relief_scale, relief_distance, albedo, water,
                  triangles
    [atmosphere]  height; color
    [sun]         direction; angular_radius_deg            (absent: no shadow volume)
    [[occluder]]  center, radius
    [look]        kind (layers unless said), and the look's parameters; background
    [photo]       path, tone_curve, mask

Unknown keys, wrong types and impossible values are errors that name file, key and remedy. Paths are
relative to the scene file. The text is UTF-8, of at most `MAX_BYTES` and `MAX_DOTS`.
"""

import codecs
import difflib
import errno
import hashlib
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np

from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    LayersLook,
    Look,
    Occluder,
    Planet,
    Scene,
    Sun,
    ToneCurve,
    find_look,
    parse_tone_curve,
)
from model_jax._errors import cut, shown
from model_jax._kinds import need
from model_jax._shapes import converter

from ._files import PathLike, check_file
from ._maps import load_gradient

MAX_BYTES = 2**16
"""Largest scene file: 40 times those of the examples, or 1,700 occluders."""
MAX_DOTS = 100
"""Most dots on a line. tomllib's time grows with the square of a dotted key's parts: 20,000 of them
took 16 s and 1.9 GB, and the worst file within both limits 0.9 s and 60 MB."""

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
        "albedo": (_TEXT, _VECTOR),
        "water": (_TEXT,),
        "triangles": (_WHOLE,),
    },
    "atmosphere": {
        "height": ("!", _NUMBER),
        "color": (_VECTOR, "a list of four numbers"),
        "path": (_TEXT,),
    },
    "sun": {"direction": ("!", _VECTOR), "angular_radius_deg": (_NUMBER,)},
    "occluder": {"center": ("!", _VECTOR), "radius": ("!", _NUMBER)},
    "look": {},  # the look's own (`_look_keys`)
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
    names_look: bool = False
    """Its [look] says of which kind."""


def load_scene(path: PathLike, look: PathLike | None = None) -> SceneFile:
    """Read a scene file.

    Args:
        look: name or Python file of a look (`find_look`), in place of the scene's. A [look] of
            another kind is left aside; one without a `kind` is of this look if all of its keys are
            parameters of it.

    Raises `InputError` in one line: file, key, value, remedy.
    """
    asked = None if look is None else find_look(look)
    file = check_file(path)
    with open(file, "rb") as stream:
        content = stream.read(MAX_BYTES + 1)
    try:
        return _build(file, _parse(content), asked)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _parse(content: bytes) -> dict[str, Any]:
    """TOML as tables. Raises `InputError` for what is no TOML or would take long to read."""
    if len(content) > MAX_BYTES:
        raise InputError(f"is longer than {MAX_BYTES:,} bytes; is it a scene file? shorten it")
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) or b"\0" in content:
        raise InputError("is no UTF-8 text but UTF-16 or binary; save it as UTF-8")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"is no UTF-8 text ({error}); save it as UTF-8") from None
    for number, line in enumerate(text.split("\n"), 1):
        if line.count(".") > MAX_DOTS:
            raise InputError(f"line {number} has more than {MAX_DOTS} dots; split or shorten it")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"is no TOML file ({cut(str(error))}); correct it there") from None
    except RecursionError:
        raise InputError("has lists or tables nested too deeply; take out the brackets") from None
    except ValueError:
        # Python reads no more than 4300 decimal digits.
        raise InputError("has a number of more than 4300 digits; shorten it") from None


def _build(file: Path, document: dict[str, Any], asked: type[Look] | None) -> SceneFile:
    _check_keys("unknown table", document, _TABLES)
    for name in _NEEDED:
        if name not in document:
            raise InputError(f"[{name}] is missing; add that table")
    tables: dict[str, Any] = {}
    for name, table in document.items():
        rows = table if name == "occluder" else [table]
        if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
            form = f"[[{name}]]" if name == "occluder" else f"[{name}]"
            raise InputError(f"{name}: {shown(table)} must be written as a {form} table")
        for row in rows:
            if name != "look":
                _check_table(name, row, _TABLES[name])
        tables[name] = table

    def beside(table: str, key: str) -> str | None:
        name = tables.get(table, {}).get(key)
        return None if name is None else _path(f"{table}.{key}", file.parent, name)

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
        look=_look(tables.get("look", {}), asked, file.parent),
        photo=PhotoSettings(
            path=beside("photo", "path"),
            tone_curve=None if curve is None else parse_tone_curve(curve),
            mask=beside("photo", "mask"),
        ),
        names_look="kind" in tables.get("look", {}),
    )


def _look(table: dict[str, Any], asked: type[Look] | None, folder: Path) -> Look:
    """The look of a [look] table; of another kind than the one asked for it says nothing."""
    own = asked is not None and table.keys() <= {*asked.PARAMETERS, asked.PICTURE}
    name = table.get("kind", asked.NAME if asked is not None and own else LayersLook.NAME)
    if not isinstance(name, str):
        raise InputError(f"look.kind: {shown(name)} must be a string; name a look")
    if asked is not None and name != asked.NAME:
        return asked()
    if asked is None and name.endswith(".py"):
        # A scene is data, and data shall run no code.
        raise InputError(
            f"look.kind: {shown(name)} is a Python file; write the look's name there, and give the "
            f"file where the scene is read, as --look {name}"
        )
    kind = find_look(name) if asked is None else asked
    _check_table("look", table, _look_keys(kind))
    values = {key: value for key, value in table.items() if key not in ("kind", kind.PICTURE)}
    if kind.PICTURE in table:
        path = _path(f"look.{kind.PICTURE}", folder, table[kind.PICTURE])
        try:
            values = kind.of_picture(load_gradient(path)) | values
        except InputError as error:
            raise InputError(f"look.{kind.PICTURE}: {error}") from None
    return kind(**values)


def _look_keys(kind: type[Look]) -> dict[str, tuple[str, ...]]:
    """Keys of the [look] table of a kind, and what their values must be."""
    forms: dict[tuple[int, ...], str] = {(): _NUMBER, (3,): _VECTOR}
    picture = {kind.PICTURE: (_TEXT,)} if kind.PICTURE else {}
    return (
        {"kind": (_TEXT,)}
        | picture
        | {
            name: tuple(
                forms[shape] if shape in forms else f"a list of {shape[0]} numbers"
                for shape in about.shapes
            )
            for name, about in kind.PARAMETERS.items()
        }
    )


def _camera(table: dict[str, Any]) -> Camera:
    table = dict(table)
    if ("forward" in table) == ("target" in table):
        raise InputError("camera: give either forward or target, and one of them only")
    if "target" in table:
        target = table.pop("target")
        with np.errstate(over="ignore", invalid="ignore"):
            start, end = (
                converter(f"camera.{name}")(value)
                for name, value in (("position", table["position"]), ("target", target))
            )
            forward = end - start
        if not np.all(np.isfinite(forward)):
            raise InputError(
                f"camera.target: {shown(target)} is at no finite distance from camera.position "
                f"({shown(table['position'])}); move one of them"
            )
        if not np.any(forward):
            raise InputError(
                f"camera.target: {shown(target)} is the camera's own position; move one of them"
            )
        table["forward"] = forward
    return Camera(**table)


def _planet(table: dict[str, Any], beside: Callable[[str, str], str | None]) -> Planet:
    files = [name for name in ("relief", "albedo", "water") if isinstance(table.get(name), str)]
    table = dict(table) | {name: beside("planet", name) for name in files}
    if "relief_scale" in table:
        scale = table["relief_scale"]
        table["relief_scale"] = tuple(scale) if isinstance(scale, list) else (scale, scale)
    if "relief_distance" in table:
        table["relief_distance"] = tuple(table["relief_distance"])
    return Planet(**table)


def _path(key: str, folder: Path, name: str) -> str:
    """The path of a file beside the scene file, which need not exist."""
    if re.search(r"[\x00-\x1f\x7f-\x9f]", name):
        raise InputError(f"{key}: {shown(name)} has control characters; rename the file")
    path = folder / name
    try:
        path = path.resolve()
        path.lstat()
    except RuntimeError:
        raise InputError(f"{key}: {shown(name)} is a link that leads to itself; mend it") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            raise InputError(f"{key}: {shown(name)} is too long a path; shorten it") from None
        # Whoever reads the file says what else is wrong with it.
    return str(path)


def _check_keys(problem: str, table: dict[str, Any], known: Any) -> None:
    for key in table:
        if key not in known:
            close = difflib.get_close_matches(key, known, n=1)
            remedy = f"did you mean {close[0]}?" if close else f"known are {', '.join(known)}"
            raise InputError(f"{problem} {shown(key)}; {remedy}")


def _check_table(name: str, table: dict[str, Any], known: Mapping[str, tuple[str, ...]]) -> None:
    _check_keys(f"{name}: unknown key", table, known)
    for key, kinds in known.items():
        if key not in table:
            if kinds[0] == "!":
                raise InputError(f"{name}.{key} is missing; add it")
            continue
        allowed = [kind for kind in kinds if kind != "!"]
        if not any(_is(table[key], kind) for kind in allowed):
            raise InputError(f"{name}.{key}: {shown(table[key])} must be {' or '.join(allowed)}")


def _is(value: Any, kind: str) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    sizes = {"three": 3, "two": 2, "four": 4}
    if listed := re.fullmatch(r"a list of (\w+) numbers", kind):
        size = sizes.get(listed[1]) or int(listed[1])
        return (
            isinstance(value, list)
            and len(value) == size
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
    need("scene", scene, Scene)
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
