"""Scene files: what is read, and the one-line error for each kind of mistake."""

import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from model_jax import InputError
from render_gl import SceneFile, load_scene, scene_hash, scene_record
from render_gl._scene_file import MAX_BYTES, MAX_DOTS
from tests.scene_text import DIGITS, HEX, NASTY

GOOD = """
[camera]
position = [0.0, -20000.0, 0.0]
target = [0.0, 0.0, 0.0]
up = [0.0, 0.0, 1.0]
fov_y_deg = 45.0
width = 64
height = 48
near = 10000.0
far = 30000.0

[planet]
radius = 6371.0

[atmosphere]
height = 100.0

[sun]
direction = [1.0, 0.0, 0.0]
"""


# With every table and, but for those that exclude others, every key.
FULL = (
    GOOD.replace(
        "radius = 6371.0",
        """radius = 6371.0
relief = "height.png"
relief_unit = 8.848
relief_scale = [1.0, 2]
relief_distance = [0.01, 2.0]
albedo = 'maps/color.jpg'
triangles = 20_000""",
    ).replace("height = 100.0", 'height = 100.0\ncolor = [0.3, 0.5, 1.0]\npath = "distance"')
    + """angular_radius_deg = 0.27

[[occluder]]
center = [384400.0, 0.0, 0.0]
radius = 1737.4

[[occluder]]
center = [0.0, 384400.0, 0.0]
radius = 1737.4

[look]
brightness = 3.0
shadow = [0.1, 0.2, 0.3]
tint = [1.0, 1.1, 0.9]
background = 0.001

[photo]
path = "photo.png"
mask = "mask.png"
[photo.tone_curve]
exposure = 1.5
gamma = 2.2
"""
)


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "scene.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(folder: Path, text: str | bytes) -> str:
    """What `load_scene` says of the text, less the file's path."""
    path = write(folder, text)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert message.isprintable()
    assert len(message) < 500
    return message.removeprefix(f"{path}: ")


def test_defaults(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD))
    np.testing.assert_array_equal(file.scene.camera.forward, [0, 1, 0])
    assert (file.look.brightness, file.look.shadow) == (3.0, 0.2)
    assert file.scene.planet.albedo is None
    assert file.photo.path is None


def test_optional_tables_may_be_absent(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD[: GOOD.index("[sun]")]))
    assert file.scene.sun is None


def test_paths_are_relative_to_the_scene_file(tmp_path: Path) -> None:
    file = load_scene(write(tmp_path, GOOD + '[photo]\npath = "a/b.png"\n'))
    assert file.photo.path == str(tmp_path / "a/b.png")


def test_hash_follows_the_numbers_only(tmp_path: Path) -> None:
    first = load_scene(write(tmp_path, GOOD)).scene
    spaced = load_scene(write(tmp_path, "# note\n" + GOOD)).scene
    moved = load_scene(write(tmp_path, GOOD.replace("100.0", "100.5"))).scene
    assert scene_hash(first) == scene_hash(spaced) != scene_hash(moved)
    assert scene_record(first)["planet"]["radius"] == 6371.0


def test_an_albedo_may_be_a_colour(tmp_path: Path) -> None:
    text = GOOD.replace("radius = 6371.0", "radius = 6371.0\nalbedo = [0, 0.5, 1.0]")
    scene = load_scene(write(tmp_path, text)).scene
    assert scene.planet.albedo == (0.0, 0.5, 1.0)
    assert scene_record(scene)["planet"]["albedo"] == [0.0, 0.5, 1.0]
    plain, black = GOOD, text.replace("0.5, 1.0", "0, 0")
    hashes = {scene_hash(load_scene(write(tmp_path, t)).scene) for t in (text, plain, black)}
    assert len(hashes) == 3


MISTAKES = {
    "albedo number": (
        "radius = 6371.0",
        "radius = 6371.0\nalbedo = 0.3",
        "planet.albedo: 0.3 must be a string or a list of three numbers",
    ),
    "albedo bright": (
        "radius = 6371.0",
        "radius = 6371.0\nalbedo = [0, 1.5, 0]",
        r"planet.albedo: \(0.0, 1.5, 0.0\) must be three numbers, 0 to 1",
    ),
    "unknown table": ("[sun]", "[sunn]", "did you mean sun"),
    "unknown key": ("radius = 6371.0", "radius = 6371.0\nradus = 1", "did you mean radius"),
    "wrong type": ("width = 64", 'width = "64"', "camera.width: '64' must be a whole number"),
    "fraction of a pixel": ("width = 64", "width = 64.5", "must be a whole number"),
    "missing key": ("near = 10000.0", "", "camera.near is missing"),
    "missing table": ("[atmosphere]\nheight = 100.0", "", r"\[atmosphere\] is missing"),
    "near beyond far": ("far = 30000.0", "far = 9000.0", "camera.far: 9000"),
    "near zero": ("near = 10000.0", "near = 0.0", "camera.near: 0"),
    "no direction": ("direction = [1.0, 0.0, 0.0]", "direction = [0, 0, 0]", "sun.direction"),
    "target at camera": ("target = [0.0, 0.0, 0.0]", "target = [0, -20000, 0]", "camera.target"),
    "both aims": ("up =", "forward = [0, 1, 0]\nup =", "either forward or target"),
    "up along the view": ("up = [0.0, 0.0, 1.0]", "up = [0, 1, 0]", "camera.up"),
    "inside the planet": ("[0.0, -20000.0, 0.0]", "[0.0, -2000.0, 0.0]", "inside the planet"),
    "negative shell": ("height = 100.0", "height = -1.0", "atmosphere.height: -1"),
    "infinite": ("radius = 6371.0", "radius = inf", "planet.radius"),
    "not a number": ("radius = 6371.0", "radius = nan", "planet.radius"),
    "field of view": ("fov_y_deg = 45.0", "fov_y_deg = 180", "camera.fov_y_deg"),
    "two numbers": ("up = [0.0, 0.0, 1.0]", "up = [0.0, 1.0]", "a list of three numbers"),
    "no toml": ("[camera]", "[camera", "is no TOML file"),
    "sun too big": ("[1.0, 0.0, 0.0]", "[1, 0, 0]\nangular_radius_deg = 90", "angular_radius"),
    "tone curve": ("[sun]", '[photo]\ntone_curve = "gamma"\n[sun]', "tone_curve: 'gamma'"),
    "look": ("[sun]", "[look]\nbrightness = -1.0\n[sun]", "look.brightness"),
    "no table": ("[camera]", "occluder = 3\n[camera]", "must be written as a"),
}


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_are_named_in_one_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    path = write(tmp_path, GOOD.replace(old, new, 1))
    with pytest.raises(InputError, match=message) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


# text of the full scene -> its replacement, what the message says
UNUSUAL = {
    "deep list": ("width = 64", "width = " + "[" * 5000, "nested too deeply"),
    "deep tables": ("width = 64", "width = " + "{a=" * 5000, "nested too deeply"),
    "deep dotted": (
        "width = 64",
        "width = " + f"[{{{'.'.join('a' * 90)} = [\n" * 50 + "1" + "]}]" * 50,
        "camera.width: [{'a': {'a':",
    ),
    "digits width": (
        "width = 64",
        f"width = {DIGITS}",
        "camera.width: a number",
    ),
    "digits scalar": (
        "near = 10000.0",
        f"near = {DIGITS}",
        "camera.near: a number of about",
    ),
    "digits vector": ("up = [0.0", f"up = [{DIGITS}", "camera.up: [a number"),
    "digits target": ("target = [0.0", f"target = [{DIGITS}", "camera.target: [a number"),
    "digits scale": ("[1.0, 2]", DIGITS, "planet.relief_scale: (a number"),
    "digits distance": ("[0.01, 2.0]", f"[0, {DIGITS}]", "planet.relief_distance: (0, a number"),
    "digits triangles": ("20_000", DIGITS, "planet.triangles: a number"),
    "digits color": ("[0.3, 0.5", f"[{DIGITS}, 0.5", "atmosphere.color: [a number"),
    "digits look": ("tint = [1.0", f"tint = [{DIGITS}", "look.tint: [a number"),
    "digits curve": ("gamma = 2.2", f"gamma = {DIGITS}", "tone_curve.gamma: a number"),
    "hexadecimal": ("width = 64", f"width = {HEX}", "camera.width: a number"),
    "hexadecimal list": (
        "width = 64",
        f"width = [{HEX}]",
        "camera.width: [a number",
    ),
    "hexadecimal look": ("brightness = 3.0", f"brightness = {HEX}", "look.brightness: a number"),
    "4301 digits": ("width = 64", f"width = {'1' * 4301}", "more than 4300 digits"),
    "1e400": ("near = 10000.0", "near = 1e400", "camera.near: inf must be finite"),
    "1e400 target": ("target = [0.0", "target = [1e400", "camera.target: [inf, 0.0, 0.0]"),
    "nan position": ("[0.0, -20000.0", "[nan, -20000.0", "camera.position ([nan, -20000.0, 0"),
    "opposite ends": (
        "[0.0, -20000.0, 0.0]\ntarget = [0.0",
        "[-1e308, 0, 0]\ntarget = [1e308",
        "camera.target: [1e+308, 0.0, 0.0] is at no finite distance",
    ),
    "nan tint": ("tint = [1.0", "tint = [nan", "look.tint: [nan, 1.1, 0.9] must be finite"),
    "nul relief": ("height.png", "\\u0000", r"planet.relief: '\x00' has control characters"),
    "nul albedo": ("'maps/color.jpg'", '"\\u0000"', "planet.albedo: "),
    "nul photo": ("photo.png", "a\\u0000", r"photo.path: 'a\x00' has control characters"),
    "newline mask": ("mask.png", "a\\nb", r"photo.mask: 'a\nb' has control characters"),
    "long name": ("photo.png", "x" * 300, "is too long a path; shorten it"),
    "long path": ("photo.png", "x/" * 5000, "is too long a path; shorten it"),
    "surrogate": ("photo.png", "\\ud800", "is no TOML file"),
    "long value": ("width = 64", f'width = "{"x" * 9999}"', "camera.width: 'xxx"),
    "long key": ("width = 64", f"{'x' * 9999} = 1", "camera: unknown key 'xxx"),
    "long table": ("[look]", f"[{'x' * 9999}]", "unknown table 'xxx"),
    "long inline key": (
        "width = 64",
        f"width = {{{'x' * 9999} = 1, {'x' * 9999} = 2}}",
        "is no TOML file (Duplicate inline table key 'xxx",
    ),
    "key of two lines": ("width = 64", r'"a\nb" = 1', r"camera: unknown key 'a\nb'"),
    "escape in a key": ("[look]", r'["\u001b[31m"]', r"unknown table '\x1b[31m'"),
    "escape in a string": ("width = 64", r'width = "\u001b"', r"camera.width: '\x1b' must"),
    "direction override": ("width = 64", 'width = "\u202e"', r"camera.width: '\u202e' must"),
    "many values": (
        "width = 64",
        f"width = [{'1, ' * 9999}]",
        "camera.width: [1, 1, 1, 1, 1, 1, ...] must",
    ),
    "nested curve": ("gamma = 2.2", "gamma = {a = {b = 1}}", "tone_curve.gamma: {'a': {'b': 1}}"),
    "yes": ("near = 10000.0", "near = true", "camera.near: True must be a number"),
    "yes in a list": ("up = [0.0", "up = [false", "camera.up: [False, 0.0, 1.0] must be"),
    "date": ("near = 10000.0", "near = 1979-05-27", "camera.near: datetime.date(1979, 5, 27)"),
    "empty list": ("up = [0.0, 0.0, 1.0]", "up = []", "camera.up: [] must be a list of three"),
}


@pytest.mark.parametrize(("old", "new", "message"), UNUSUAL.values(), ids=UNUSUAL.keys())
def test_unusual_values_are_named_in_one_short_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in FULL
    assert message in refusal(tmp_path, FULL.replace(old, new, 1))


TEXTS: dict[str, tuple[str | bytes, str]] = {
    "table for occluders": (
        "occluder = {}\n" + GOOD,
        "occluder: {} must be written as a [[occluder]]",
    ),
    "list for a table": (
        "sun = []\n" + GOOD[: GOOD.index("[sun]")],
        "sun: [] must be written as a [sun] table",
    ),
    "nothing": ("", "is empty"),
    "blank": (" \n", "[camera] is missing"),
    "mark only": (b"\xef\xbb\xbf", "[camera] is missing"),
    "utf-16": (FULL.encode("utf-16"), "save it as UTF-8"),
    "utf-16 without mark": (FULL.encode("utf-16-be"), "save it as UTF-8"),
    "nul": (FULL + "\0", "save it as UTF-8"),
    "latin-1": ("# é".encode("latin-1"), "is no UTF-8 text"),
    "too long": ("#" * (MAX_BYTES + 1), "is longer than 65,536 bytes"),
    "key of many parts": (".".join("a" * 20_000) + " = 1", "line 1 has more than 100 dots"),
    "header of many parts": (
        "\n[" + ".".join("a" * 999) + "]",
        "line 2 has more than 100 dots",
    ),
}


@pytest.mark.parametrize(("text", "message"), TEXTS.values(), ids=TEXTS.keys())
def test_other_texts(tmp_path: Path, text: str | bytes, message: str) -> None:
    assert message in refusal(tmp_path, text)


@pytest.mark.parametrize(
    "text",
    [
        FULL,
        FULL.replace("\n", "\r\n"),
        "\ufeff" + FULL,
        FULL.replace("photo.png", "Foto\u202fä.png"),
        FULL.replace('"photo.png"', '"""' + "v1.0.txt\\\n" * 15 + '"""') + "# ...\n" * 5000,
        FULL + "[[occluder]]\ncenter = [9e9, 0, 0]\nradius = 1\n" * 1000,
        FULL.replace("[1.0, 0.0, 0.0]", "[1e200, 0.0, 0.0]"),
    ],
    ids=["full", "crlf", "mark", "name", "dots", "occluders", "long direction"],
)
def test_what_is_unusual_but_right_is_read(tmp_path: Path, text: str) -> None:
    file = load_scene(write(tmp_path, text))
    assert file.scene.sun is not None
    np.testing.assert_array_equal(file.scene.sun.direction, [1, 0, 0])


def test_the_longest_readable_file_takes_no_long_time(tmp_path: Path) -> None:
    """Keys as deep as can be, below a header as deep as can be; 0.9 s when this was written."""
    header, key = (".".join("a" * n) for n in (MAX_DOTS, MAX_DOTS - 1))
    text = f"[{header}]\n"
    for number in range(MAX_BYTES):
        line = f"{number}.{key} = 1\n"
        if len(text) + len(line) > MAX_BYTES:
            break
        text += line
    start = time.process_time()
    assert "unknown table 'a'" in refusal(tmp_path, text)
    assert time.process_time() - start < 10


@st.composite
def broken(draw: st.DrawFn) -> bytes:
    """The full scene after some accidents."""
    lines = FULL.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        first, second = (draw(st.integers(0, len(lines) - 1)) for _ in range(2))
        kind = draw(
            st.sampled_from(["delete", "double", "swap", "value", "value", "insert", "cut"])
        )
        line = lines[first]
        place = draw(st.integers(0, len(line)))
        if kind == "delete":
            lines[first] = ""
        elif kind == "double":
            lines.insert(second, line)
        elif kind == "swap":
            lines[first], lines[second] = lines[second], line
        elif kind == "value":
            lines[first] = f"{line.split(' = ')[0]} = {draw(st.sampled_from(NASTY))}"
        elif kind == "insert":
            lines[first] = line[:place] + draw(st.text(max_size=5)) + line[place:]
        else:
            lines[first] = line[:place] + line[place + draw(st.integers(1, 5)) :]
    content = "\n".join(lines).encode()
    if draw(st.integers(0, 3)) == 0:
        place = draw(st.integers(0, len(content)))
        content = content[:place] + draw(st.binary(max_size=3)) + content[place:]
    return content


@settings(derandomize=True, deadline=None, max_examples=150)
@given(content=broken())
def test_any_text_is_read_or_refused_in_one_line(content: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder), content)
        try:
            assert isinstance(load_scene(path), SceneFile)
        except InputError as error:
            message = str(error)
            assert message.isprintable()
            assert len(message) < 500


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        load_scene(tmp_path / "none.toml")


@pytest.mark.parametrize("name", ["paper", "reference", "epic", "iss"])
def test_examples_are_read(name: str) -> None:
    assert load_scene(f"examples/{name}.toml").scene.planet.radius > 0
