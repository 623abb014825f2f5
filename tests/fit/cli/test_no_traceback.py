"""Whatever stands on the command line, in the files it names and in their names: exit code 0 or 1,
or one printable line and exit code 2. A traceback, or exit code 70, is a fault of airlight's."""

import contextlib
import io
import json
import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

import render_gl
from fit.cli._cli import main
from tests.scene_text import NASTY as NASTY_TOML
from tests.scene_text import resized

SCENE = (
    resized(24, 16)
    + """brightness = 3.0
shadow = 0.2
tint = [1.0, 1.1, 0.9]
background = 0.001

[photo]
path = "photo.png"
"""
)

FIT = ("fit", "scene.toml", "photo.png", "-o", "out", "--source", "analytic")
FROM_LAYERS = ("fit", "--layers", "layers.exr", "photo.png", "-o", "out")
RENDER = ("render", "scene.toml", "-o", "new.png", "--source", "analytic")
CHECK = ("check", "scene.toml", "-o", "checked", "--depth", "linear")
EXPORT = ("export", "fit.json", "--to", "glsl")


def airlight(*words: str) -> tuple[int, str]:
    """Run the command in this process; returns its exit code and what it says on standard error."""
    said = io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["airlight", *words]),
        contextlib.redirect_stderr(said),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0), said.getvalue()
    return 0, said.getvalue()


def check(*words: str) -> str:
    """Hold one command against the promise; returns what it said."""
    code, said = airlight(*words)
    assert code in (0, 1, 2), said
    if code == 2:
        assert said.count("\n") == 1
    for line in said.splitlines(keepends=True):
        assert line.startswith("airlight: ")
        assert line.endswith("\n")
        assert line[:-1].isprintable(), ascii(line)
        assert len(line) < 1000
    return said


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one small file of each kind that the command line reads."""
    folder = tmp_path_factory.mktemp("files")
    with contextlib.chdir(folder):
        Path("scene.toml").write_text(SCENE)
        assert airlight(*RENDER) == (0, "")
        os.rename("new.png", "photo.png")
        words = ("render", "scene.toml", "-o", "layers.exr", "--source", "analytic")
        assert airlight(*words) == (0, "")
        channels, _ = render_gl.read_channels("layers.exr")
        render_gl.write_channels("photo.exr", {name: channels[name] for name in "RGB"}, {})
        photo = Image.open("photo.png")
        photo.save("photo.jpg")
        photo.save("photo.tif")
        photo.convert("L").save("mask.png")
        assert airlight(*FIT) == (0, "")
        shutil.move("out/fit.json", "fit.json")
        shutil.rmtree("out")
        Path("folder").mkdir()
    return folder


@contextlib.contextmanager
def copied(files: Path) -> Iterator[Path]:
    """Inside a fresh copy of the folder, as commands overwrite what they are told to."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "here"
        shutil.copytree(files, folder)
        os.mkfifo(folder / "fifo")
        with contextlib.chdir(folder):
            yield folder


# Not hypothesis's own database: it would grow with each run. What it finds is derandomised.
def examples(number: int) -> settings:
    return settings(
        derandomize=True,
        deadline=None,
        database=None,
        max_examples=number,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )


# --- 1. words -----------------------------------------------------------------------------------

NUMBERS = [
    *("nan", "inf", "-inf", "1e400", "-1e308", "1e308", "5e-324", "10" * 200, "0x10", "٣", "²"),
    *("0", "-0.0", "-1", "1", "2", "0.3", "1_0", "10" * 20, "1" * 5000),
]
NAMES = [
    *("brightness", "shadow", "tint", "tint.r", "background", "background.b", "exposure", "gamma"),
    *("black_level", "gamma.1", "exposure.2", "", "haze", "a" * 5000, "\x1b[31m", "\udcff"),
]
TEXTS = [
    *("", " ", "-", "--", "=", ":", ",", "\n", "\t", "\x1b[31m", "\udcff", "\u202e", "\x7f"),
    "é",
    *(
        "a" * 5000,
        "\x1b" * 900,
        "\udcff" * 900,
        "linear,",
        "1,2,3",
        "-1,-1",
        "1,1",
        "1,nan",
        "srgb",
    ),
    *("linear", "1x1", "0x0", "3X2", "65537x1", "99999999999999999999x1", "²x²", "٣x٣", "8x8x8"),
    *("%s", "{}", "{0}", "[red]x[/red]", "[/]", "huber", "love", "mesh", "raster", "analytic"),
]
PATHS = [
    *("scene.toml", "photo.png", "photo.exr", "photo.jpg", "layers.exr", "mask.png", "fit.json"),
    *(
        "nowhere.png",
        "nowhere/x.png",
        "folder",
        "folder/",
        ".",
        "/",
        "photo.png/x.png",
        "/dev/null",
    ),
    *("/dev/zero", "/dev/full", "/proc/self/mem", "/proc/x", "~", "new.exr", "new.png", "new.EXR"),
]
OPTIONS = {
    "render": "--out -o --source --depth --size --json",
    "fit": "--out -o --layers --near --far --encoding --constant --source --depth --tone-curve "
    "--mask --free --start --bounds --prior --tie --loss --jpeg --sampling --where --solver "
    "--max-steps --json --no-json",
    "check": "--out -o --depth --source --json",
    "export": "--to --out -o",
    "version": "--json",
    "bench": "--quick",
}
KNOWN = {
    "--source": ["raster", "mesh", "analytic"],
    "--depth": ["auto", *render_gl.DEPTH_FORMATS],
    "--encoding": ["linear", "window", "reversed", "log"],
    "--sampling": ["area", "point"],
    "--where": ["all", "ring", "planet"],
    "--jpeg": ["keep"],
    "--to": ["glsl", "glsl-uniform", "json", "toml", "csv"],
    "--loss": ["linear"],
    "--solver": ["lm"],
}
BASES = [RENDER, FIT, FROM_LAYERS, CHECK, EXPORT, ("version",), ("bench",), ("paint",), ()]


@st.composite
def value(draw: st.DrawFn, option: str) -> str:
    """A value that the option may have, or anything."""
    kind = draw(st.integers(0, 3))
    if kind == 0:
        return draw(st.sampled_from([*TEXTS, *NUMBERS, *PATHS]))
    if option in KNOWN:
        return draw(st.sampled_from(KNOWN[option]))
    if option in ("--near", "--far", "--constant", "--max-steps"):
        return draw(st.sampled_from(NUMBERS))
    number, name = st.sampled_from(NUMBERS), st.sampled_from(NAMES)
    if option == "--size":
        return f"{draw(number)}x{draw(number)}"
    if option == "--tone-curve":
        return f"{draw(number)},{draw(number)}"
    if option == "--free":
        return ",".join(draw(st.lists(name, max_size=3)))
    if option == "--start":
        return f"{draw(name)}={draw(number)}"
    if option in ("--bounds", "--prior"):
        return f"{draw(name)}={draw(number)}:{draw(number)}"
    if option == "--tie":
        return f"{draw(name)}={draw(name)}"
    return draw(st.sampled_from(PATHS))


@st.composite
def command_lines(draw: st.DrawFn) -> list[str]:
    """A command that works, after some accidents."""
    words = list(draw(st.sampled_from([*BASES, FIT, FIT, FROM_LAYERS])))
    options = OPTIONS.get(words[0] if words else "", "--help --version").split()
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(min(1, len(words)), len(words)))
        kind = draw(st.sampled_from(["option", "option", "option", "word", "drop", "double"]))
        option = draw(st.sampled_from(options))
        if kind == "option":
            given_value = draw(value(option))
            if draw(st.booleans()):
                words += [option, given_value]
            else:
                words.insert(place, f"{option}={given_value}")
        elif kind == "word":
            words.insert(place, draw(st.sampled_from([*TEXTS, *PATHS, *NUMBERS, option])))
        elif kind == "drop" and words:
            del words[min(place, len(words) - 1)]
        elif words:
            words.insert(place, words[min(place, len(words) - 1)])
    return words


@examples(25)
@given(words=command_lines())
def test_any_words(files: Path, words: list[str]) -> None:
    if words[:1] == ["bench"] and "-o" in words:
        return  # it would run for minutes
    with copied(files):
        check(*words)


# --- 2. scenes ----------------------------------------------------------------------------------

SMALL = [
    "1",
    "2",
    "1e-3",
    "1e-30",
    "1e30",
    "1e38",
    "1e39",
    "1e300",
    "6371.0",
    "20000.0",
    "29999.99",
]
VECTORS = ["[1e-30, 0, 0]", "[0, 0, 1e30]", "[0, -6371.0, 0]", "[0, -6371.0000001, 0]", "[0, 0, 1]"]
# Sizes that take minutes are no faults.
VALUES = [*NASTY_TOML, *SMALL, *VECTORS]


@st.composite
def scenes(draw: st.DrawFn) -> str:
    """The scene with some values that a scene file can have, and some that it cannot."""
    lines = SCENE.splitlines()
    places = [number for number, line in enumerate(lines) if " = " in line]
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(places))
        key = lines[place].split(" = ")[0]
        lines[place] = f"{key} = {draw(st.sampled_from(VALUES))}"
    return "\n".join(lines)


@examples(25)
@given(text=scenes(), words=st.sampled_from([RENDER, FIT, CHECK, FIT[:-2], RENDER[:-2]]))
def test_any_scene(files: Path, text: str, words: tuple[str, ...]) -> None:
    with copied(files):
        Path("scene.toml").write_text(text, errors="replace")
        check(*words)


# --- 3. files -----------------------------------------------------------------------------------


@st.composite
def spoilt(draw: st.DrawFn) -> tuple[str, int, int, bytes]:
    """A file's name, and where and how many of its bytes become others (as shares of its size)."""
    name = draw(st.sampled_from(["photo.png", "photo.jpg", "photo.tif", "photo.exr", "mask.png"]))
    place = draw(st.integers(0, 999))
    length = draw(st.sampled_from([0, 1, 1, 2, 4, 999]))
    return name, place, length, draw(st.binary(max_size=4))


def spoil(path: Path, place: int, length: int, content: bytes) -> None:
    data = path.read_bytes()
    start = place * len(data) // 1000
    end = len(data) if length == 999 else start + length
    path.write_bytes(data[:start] + content + data[end:])


@examples(5)
@given(how=spoilt())
def test_any_photo(files: Path, how: tuple[str, int, int, bytes]) -> None:
    name, place, length, content = how
    with copied(files) as folder:
        spoil(folder / name, place, length, content)
        words = ("photo.png", "--mask", name) if name == "mask.png" else (name,)
        check("fit", "scene.toml", *words, "-o", "out", "--source", "analytic")


@examples(5)
@given(how=spoilt())
def test_any_layers(files: Path, how: tuple[str, int, int, bytes]) -> None:
    with copied(files) as folder:
        spoil(folder / "layers.exr", *how[1:])
        check(*FROM_LAYERS)


JSON_VALUES = [
    *("NaN", "Infinity", "-Infinity", "1e400", "1" * 5000, "1" + "0" * 400, "-1", "0", "1e300"),
    *("null", "true", '""', '"x"', '"\\u001b[31m"', '"\\ud800"', '"' + "x" * 5000 + '"', "[]"),
    *("{}", "[" * 5000 + "]" * 5000, '{"value": 1}', '{"value": "1"}', "[{}]", "[1]", "3", ""),
    '{"value": ' + "[" * 900 + "]" * 900 + "}",
    '"' + "\\u001b" * 900 + '"',
]


@st.composite
def fit_documents(draw: st.DrawFn, text: str) -> bytes:
    """A fit.json after some accidents: values replaced, keys renamed, bytes changed."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(lines) - 1))
        key, colon, rest = lines[place].partition(": ")
        kind = draw(st.sampled_from(["value", "value", "value", "key", "delete", "bytes"]))
        if kind == "value" and colon and rest[:1] not in "{[":
            comma = "," if rest.endswith(",") else ""
            lines[place] = f"{key}: {draw(st.sampled_from(JSON_VALUES))}{comma}"
        elif kind == "key" and colon:
            lines[place] = f"{draw(st.sampled_from(JSON_VALUES))}: {rest}"
        elif kind == "delete":
            del lines[place]
        elif kind == "bytes":
            column = draw(st.integers(0, len(lines[place])))
            lines[place] = lines[place][:column] + draw(st.text(max_size=3)) + lines[place][column:]
    return "\n".join(lines).encode(errors="surrogatepass")


@examples(100)
@given(data=st.data(), to=st.sampled_from(KNOWN["--to"]))
def test_any_fit_json(files: Path, data: st.DataObject, to: str) -> None:
    document = json.loads((files / "fit.json").read_text())
    # A part at a time, or nearly all accidents would be to what export does not read.
    keys = ("schema", "verdict", "scene", "photo", "layers", "parameters", "explained", "photos")
    kept = {key: document[key] for key in (*keys, "width_unit") if key in document}
    content = data.draw(fit_documents(json.dumps(kept, indent=1)))
    with copied(files):
        Path("fit.json").write_bytes(content)
        check("export", "fit.json", "--to", to)


# --- 4. names -----------------------------------------------------------------------------------

file_names = st.one_of(
    st.text(st.characters(exclude_characters="\0/"), min_size=1, max_size=8),
    st.text(st.sampled_from("a-.\n\r\t\x1b\x7f\u202e\udcff\udc80é[]{}%~ \\'\"\u2028"), max_size=6),
    st.sampled_from(
        ["a" * 252, "a" * 300, "é" * 200, "a/" * 3000, "\x1b" * 200, "-", "--", "..", "x/"]
    ),
)


@examples(25)
@given(
    name=file_names,
    place=st.sampled_from(
        ["scene", "photo", "mask", "layers", "out", "render", "json", "exported"]
    ),
    there=st.booleans(),
)
def test_any_file_name(files: Path, name: str, place: str, there: bool) -> None:
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return  # no operating system hands such a word over
    with copied(files):
        source = {"scene": "scene.toml", "mask": "mask.png", "layers": "layers.exr"}
        kept = {**source, "photo": "photo.png", "json": "fit.json"}.get(place)
        if there and kept:
            with contextlib.suppress(OSError):
                shutil.copyfile(kept, name)
        options = ("--source", "analytic")
        check(
            *{
                "scene": ("fit", name, "photo.png", "-o", "out", *options),
                "photo": ("fit", "scene.toml", name, "-o", "out", *options),
                "mask": (*FIT, "--mask", name),
                "layers": ("fit", "--layers", name, "photo.png", "-o", "out"),
                "out": ("fit", "scene.toml", "nowhere.png", "-o", name, *options),
                "render": ("render", "scene.toml", "-o", f"{name}.png", *options),
                "json": ("export", name, "--to", "toml"),
                "exported": (*EXPORT, "-o", name),
            }[place]
        )


# --- what was found -----------------------------------------------------------------------------

LONG = "x" * 5000
LINES: dict[str, tuple[tuple[str, ...], str]] = {
    "long option": ((*FIT, "--bounds", LONG), "xxx: must be NAME=LOW:HIGH"),
    "long switch": (("check", "scene.toml", f"--json={LONG}"), "See `airlight check --help`."),
    "escape in an option": (
        (*FIT, "--prior", "\x1b[31m=1:1"),
        r"--prior \x1b[31m=1:1: '\x1b[31m' is no",
    ),
    "escape in a form": ((*FIT, "--prior", "\x1b[31m"), r"--prior \x1b[31m: must be NAME"),
    "bytes in an option": ((*FIT, "--prior", "\udcff"), r"--prior \udcff: must be NAME"),
    "escape in a name": (("render", "scene.toml", "-o", "\x1b[31m"), r"\x1b[31m: is neither .exr"),
    "no text in a name": (("export", "\udcff", "--to", "csv"), r"\udcff: no such file"),
    "prior of no width": ((*FIT, "--prior", "brightness=3:1e-200"), "1e-200, too small"),
    "steps beyond memory": (
        (*FIT, "--max-steps", str(2**31)),
        "a whole number, 1 to 1,000,000",
    ),
    "steps beyond JAX": ((*FIT, "--max-steps", str(10**30)), "a whole number, 1 to 1,000,000"),
    "break in a name": (("export", "a\nb", "--to", "csv"), "a b: no such file"),
}


@pytest.mark.parametrize(("words", "told"), LINES.values(), ids=LINES.keys())
def test_lines_are_short_and_printable(files: Path, words: tuple[str, ...], told: str) -> None:
    with copied(files):
        said = check(*words)
        assert told in said


def test_a_warning_is_short_and_printable(files: Path) -> None:
    document = json.loads((files / "fit.json").read_text()) | {"warnings": ["\x1b[31m" + LONG]}
    with copied(files):
        Path("\x1b[31m").write_text(json.dumps(document))
        said = check("export", "\x1b[31m", "--to", "csv")
    assert r"airlight: warning: \x1b[31mxxx" in said


def test_names_on_standard_output_are_printable(
    files: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with copied(files):
        for words in (
            ("render", "scene.toml", "-o", "\x1b[31m.png", "--source", "analytic"),
            (*FIT, "-o", "\x1b[31m"),
            (*CHECK, "-o", "\x1b[31m"),
        ):
            with mock.patch.object(sys, "argv", ["airlight", *words]):
                main()
            printed = capsys.readouterr().out
            assert "\x1b" not in printed
            assert r"\x1b[31m" in printed


def test_folders_where_files_belong(files: Path) -> None:
    with copied(files):
        Path("out/fit.json").mkdir(parents=True)
        assert "out/fit.json: cannot be replaced" in check(*FIT)


def test_a_photo_that_links_to_itself(files: Path) -> None:
    with copied(files):
        os.symlink("loop.png", "loop.png")
        told = check("fit", "scene.toml", "loop.png", "-o", "out")
        assert "not a usable path (Too many levels" in told


@pytest.mark.parametrize("words", [["fifo"], ["photo.png", "--mask", "fifo"]])
def test_a_pipe_is_not_waited_for(words: list[str], files: Path) -> None:
    with copied(files):
        told = check("fit", "scene.toml", *words, "-o", "out")
        assert "fifo: is a pipe or a device; name a regular file" in told


def test_a_folder_that_is_gone(files: Path) -> None:
    with copied(files) as folder:
        Path("gone").mkdir()
        os.chdir("gone")
        os.rmdir(folder / "gone")
        told = check("render", str(folder / "scene.toml"), "-o", "a.png", "--source", "analytic")
        assert "'a.png': not a usable path (" in told
        os.chdir(folder)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("airlight.color", (math.nan, 1.0, 1.0)),
        ("airlight.width_unit", 0.0),
        ("airlight.width_unit", -1.0),
    ],
    ids=["no color", "no unit", "negative unit"],
)
def test_attributes_of_layers(files: Path, name: str, wrong: object) -> None:
    with copied(files):
        channels, header = render_gl.read_channels("layers.exr")
        kept = {key: value for key, value in header.items() if key in ("airlight.depth",)}
        render_gl.write_channels("layers.exr", channels, kept | {name: wrong})
        assert f"{name} is" in check(*FROM_LAYERS)
