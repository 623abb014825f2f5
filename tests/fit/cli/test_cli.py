"""The command line, as a user meets it: what it writes, prints, and says of bad input."""

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import render_gl
from fit.cli import _job
from fit.diagnose._alignment import OFF_PX
from fit.solve import _polish
from model_jax import DriverError, LayersLook
from tests.command import airlight
from tests.scene_text import SCENE

FILES = {"fit.json", "report.html", "image.exr", "residual.exr", "layers.exr", "influence.exr"}
"""What a fit of one photo leaves."""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """scene.toml and photo.png, a render of it."""
    folder = tmp_path_factory.mktemp("drawn")
    (folder / "scene.toml").write_text(SCENE)
    assert airlight("render", folder / "scene.toml", "-o", folder / "photo.png") == 0
    return folder


@pytest.fixture
def here(drawn: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to work in, with a scene and its photo."""
    shutil.copytree(drawn, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_render_writes_layers_and_picture_in_one_file(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[tuple[Any, ...]] = []
    original = render_gl._render.draw

    def draw(*given: Any) -> Any:
        drawn.append(given)
        return original(*given)

    monkeypatch.setattr(render_gl._render, "draw", draw)
    assert airlight("render", "scene.toml", "-o", "out.exr", "--size", "81x61") == 0
    assert len(drawn) == 1, "one drawing has both"
    channels, header = render_gl.read_channels("out.exr")
    assert {"front.Z", "back.Z", "shadow_front.Z", "shadow_back.Z", *"RGBA"} <= set(channels)
    assert channels["R"].shape == (61, 81)
    assert header["airlight.near"] == 12000.0
    assert len(str(header["airlight.scene_hash"])) == 64


@pytest.mark.parametrize("source", ["raster", "mesh", "analytic"])
def test_fit_recovers_the_rendered_look_and_writes_everything(
    here: Path, source: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out", "--source", source) == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert document["schema"] == 3
    assert document["verdict"] == "converged"
    for name, truth in (("brightness", 3.0), ("shadow", 0.2)):
        found = document["parameters"][name]
        # The photo is 8-bit; analytic layers differ from the rasterised ones at the limb.
        slack = 3 * found["stderr"] + found["quantisation_bound"]
        assert abs(found["value"] - truth) <= max(slack, 0.01 * truth)
    keys = {"schema", "scene", "photo", "verdict", "message", "parameters", "correlation"}
    keys |= {"residual_rms", "pixels", "left_out", "seconds", "versions"}
    assert keys <= set(document)
    assert set(document["seconds"]) == {"render", "reduce", "solve", "errors", "report"}
    assert {path.name for path in Path("out").iterdir()} == FILES
    residual, _ = render_gl.read_channels("out/residual.exr")
    used = residual["used.Y"] == 1
    rms = np.sqrt(np.mean([residual[c][used].astype(float) ** 2 for c in "RGB"]))
    assert rms == pytest.approx(document["residual_rms"], rel=1e-3)
    assert "converged" in capsys.readouterr().out


def test_fit_from_somebodys_layers(here: Path) -> None:
    assert airlight("render", "scene.toml", "-o", "layers.exr", "--depth", "linear") == 0
    assert airlight("fit", "--layers", "layers.exr", "photo.png", "-o", "out", "--json") == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert document["parameters"]["shadow"]["value"] == pytest.approx(0.2, abs=0.002)


DISC = """
[camera]
position = [0, 0, 200]
forward = [-0.005, 0.005, -1]
up = [0, 1, 0]
fov_y_deg = 1.0
width = 200
height = 200
near = 198
far = 202
[planet]
radius = 1
[atmosphere]
height = 0.1
"""


def test_align_moves_the_camera_until_limbs_meet(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The scene's planet is 57 px large and its middle at 157 px, the photo's are 60 and 154 px."""
    y, x = np.mgrid[:200, :200]
    away = np.hypot(x - 154, y - 154)[..., None] / 60
    chord = np.sqrt(np.maximum(1.1**2 - away**2, 0))
    light = np.where(away < 1, [0.6, 0.4, 0.3], chord * [0.2, 0.4, 0.8])
    Image.fromarray(np.rint(255 * light).astype(np.uint8)).save("p.png")
    Path("disc.toml").write_text(DISC)
    fitted = ("fit", "disc.toml", "p.png", "-o", "out", "--look", "layers", "--accept-misfit")
    airlight(*fitted)
    told = json.loads(Path("out/fit.json").read_text())
    assert told["moved"] is None
    assert any("misaligned" in text for text in told["warnings"])
    capsys.readouterr()
    airlight(*fitted, "--align")
    told = json.loads(Path("out/fit.json").read_text())
    assert told["photos"][0]["alignment"]["off"] < 0.1
    assert not any("misaligned" in text for text in told["warnings"])
    moved = told["photos"][0]["moved"]
    assert moved["off"] > OFF_PX
    assert moved["scale"] == pytest.approx(60 / 57.3, abs=0.01)
    # The camera that it names is the one that was used.
    text = DISC.replace("[-0.005, 0.005, -1]", str(moved["forward"]))
    Path("disc.toml").write_text(text.replace("1.0\n", f"{moved['fov_y_deg']}\n", 1))
    assert "aligned: the scene's limb was" in " ".join(capsys.readouterr().out.split())
    airlight(*fitted)
    again = json.loads(Path("out/fit.json").read_text())
    assert again["scene_hash"] == told["scene_hash"]
    assert again["parameters"] == told["parameters"]


def test_several_photos_share_a_look(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The second is darker by half, on a scene with other clip planes, seen from elsewhere."""
    far = SCENE.replace("far = 30000.0", "far = 36000.0").replace(
        "0.0, -20000.0", "9000.0, -18000.0"
    )
    Path("second.toml").write_text(far)
    for scene, photo, exposure, level in (
        ("scene.toml", "first.exr", 1.0, 0.01),
        ("second.toml", "second.exr", 0.5 * 24000 / 18000, 0.02),
    ):
        # Brightness over another width unit: the same air, in the second photo at half exposure.
        assert airlight("render", scene, "-o", photo, "--depth", "linear") == 0
        channels, _ = render_gl.read_channels(photo)
        pixels = {name: exposure * channels[name] + level for name in "RGB"}
        render_gl.write_channels(photo, pixels, {})
    options = ("--free", "brightness,shadow,black_level,exposure.2", "--start", "exposure.2=0.7")
    words = ("scene.toml", "first.exr", "second.toml", "second.exr", "-o", "out", *options)
    assert airlight("fit", *words) == 0
    document = json.loads(Path("out/fit.json").read_text())
    values = {name: row["value"] for name, row in document["parameters"].items()}
    truth = {"brightness": 3.0, "shadow": 0.2, "exposure.2": 0.5}
    truth |= {"black_level.1": 0.01, "black_level.2": 0.02}
    for name, value in truth.items():
        assert values[name] == pytest.approx(value, rel=1e-4), name
    assert document["parameters"]["exposure.2"]["initial"] == 0.7
    assert [photo["photo"] for photo in document["photos"]] == ["first.exr", "second.exr"]
    kinds = ("image", "residual", "layers", "influence")
    expected = {f"{kind}-{number}.exr" for kind in kinds for number in (1, 2)}
    assert {path.name for path in Path("out").iterdir()} == expected | {"fit.json", "report.html"}
    for number in (1, 2):
        residual, _ = render_gl.read_channels(f"out/residual-{number}.exr")
        # Rounding of float32 light, at most 1, in the photo and in the picture.
        assert max(np.abs(residual[c]).max() for c in "RGB") < 1e-5
    printed = capsys.readouterr().out
    assert "photo 2: " in printed


def test_options_reach_the_fit(here: Path) -> None:
    words: tuple[str, ...]
    words = ("--free", "brightness,shadow", "--start", "tint.r=1.1", "--start", "tint.b=0.9")
    words += ("--bounds", "shadow=0.1:", "--prior", "brightness=3:0.5", "--loss", "huber")
    words += ("--solver", "dogleg", "--max-steps", "99")
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out", *words) == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert (document["loss"], document["solver"]) == ("huber", "dogleg")
    rows = document["parameters"]
    assert [name for name, row in rows.items() if row["role"] == "free"] == ["brightness", "shadow"]
    assert rows["shadow"]["bounds"] == [0.1, None]
    assert rows["brightness"]["prior"] == [3.0, 0.5]
    assert (rows["tint.r"]["value"], rows["tint.b"]["value"]) == (1.1, 0.9)
    assert "Belief in each pixel" in Path("out/report.html").read_text()


def test_pixels_in_front_of_a_planet_of_one_colour_are_chosen(here: Path) -> None:
    colored = SCENE.replace("radius = 6371.0", "radius = 6371.0\nalbedo = [0.1, 0.2, 0.3]")
    Path("scene.toml").write_text(colored)
    assert airlight("render", "scene.toml", "-o", "photo.exr", "--depth", "linear") == 0
    used = {}
    for where in ("all", "ring", "planet"):
        words = ("scene.toml", "photo.exr", "-o", where, "--where", where, "--sampling", "point")
        assert airlight("fit", *words) == 0
        document = json.loads(Path(where, "fit.json").read_text())
        # Light of float32; columns that are alike make 300 of its rounding.
        assert document["parameters"]["brightness"]["value"] == pytest.approx(3.0, rel=1e-4)
        used[where] = document["pixels"]["used"]
    assert used["ring"] > 0 < used["planet"]
    assert used["ring"] + used["planet"] == used["all"]


def test_influence_is_the_derivative_of_the_shadow_weight(here: Path) -> None:
    """Its sum against light of which the model is made: one unit of brightness moves no weight."""
    assert airlight("render", "scene.toml", "-o", "photo.exr", "--depth", "linear") == 0
    asked = ("--sampling", "point", "--bounds", "background=-1:1")
    assert airlight("fit", "scene.toml", "photo.exr", "-o", "out", *asked) == 0
    influence, header = render_gl.read_channels("out/influence.exr")
    assert header["airlight.parameter"] == "shadow"
    image, _ = render_gl.read_channels("out/image.exr")
    residual, _ = render_gl.read_channels("out/residual.exr")
    assert all((influence[c][residual["used.Y"] == 0] == 0).all() for c in "RGB")
    along = sum((influence[c].astype(float) * image[c]).sum() for c in "RGB")
    size = sum((np.abs(influence[c].astype(float)) * image[c]).sum() for c in "RGB")
    # All light times a factor is brightness (and background) times it; float32 rounds each pixel.
    assert abs(along) < 1e-5 * size
    # And against a fit of the photo with a little more light in the pixels that say most. The map
    # is the slope where it was made; light of 1 % bends it by as much.
    before = json.loads(Path("out/fit.json").read_text())["parameters"]
    channels, _ = render_gl.read_channels("photo.exr")
    moved = {c: channels[c].astype(np.float32) for c in "RGB"}
    rows, columns = np.unravel_index(np.argsort(influence["G"], axis=None)[-200:], (120, 160))
    more = 0.01 * moved["G"].max()
    moved["G"][rows, columns] += more
    render_gl.write_channels("moved.exr", moved, {})
    assert airlight("fit", "scene.toml", "moved.exr", "-o", "again", *asked) == 0
    after = json.loads(Path("again/fit.json").read_text())["parameters"]
    told = more * influence["G"][rows, columns].astype(float).sum()
    changes = {name: after[name]["value"] - before[name]["value"] for name in before}
    assert changes["shadow"] == pytest.approx(told, rel=0.03)
    # A map of a tint would tell another story of the same pixels.
    assert abs(changes["tint.g"] - told) > 0.5 * abs(told)


def test_json_is_one_document_on_standard_output(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out", "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "converged"
    assert airlight("check", "scene.toml", "--json") == 0
    assert json.loads(capsys.readouterr().out)["passed"] is True
    assert airlight("version", "--devices", "--json") == 0
    assert "JAX devices" in json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("depth", render_gl.DEPTH_FORMATS)
def test_check_prints_and_writes_three_pictures(
    here: Path, capsys: pytest.CaptureFixture[str], depth: str
) -> None:
    assert airlight("check", "scene.toml", "--depth", depth) == 0
    printed = capsys.readouterr().out
    for word in ("pass", "in ulp", "relative to image max", "bound", "worst pixel"):
        assert word in printed
    found = {path.name for path in Path("scene-check").iterdir()}
    assert found == {"glsl.exr", "jax.exr", "difference.exr"}


def test_check_of_nothing_is_no_pass(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A camera that looks away sees no air: nothing was compared, and the check says so."""
    away = SCENE.replace("target = [0.0, 0.0, 0.0]", "target = [0.0, -40000.0, 6000.0]")
    Path("away.toml").write_text(away)
    assert airlight("check", "away.toml") == 1
    printed = " ".join(capsys.readouterr().out.split())
    assert "nothing could be compared" in printed


@pytest.mark.parametrize("source", ["raster", pytest.param("mesh", marks=pytest.mark.full)])
@pytest.mark.parametrize(
    "name",
    [
        "sz_333x217",
        "near_plane_bound",
        *(pytest.param(name, marks=pytest.mark.full) for name in ("sz_640x480", "reference_1024")),
    ],
)
def test_check_passes_where_it_failed(name: str, source: str, here: Path, data_dir: Path) -> None:
    """A shadow's back without its front at three sizes; 1 ulp at the near plane."""
    scene = str(data_dir / "cases" / f"{name}.toml")
    assert airlight("check", scene, "--source", source, "-o", "checked") == 0


def test_check_fails_with_exit_code_1(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from render_gl import _parity

    monkeypatch.setattr(_parity, "WIDTH_ROUNDINGS", 0)
    monkeypatch.setattr(LayersLook, "ROUNDINGS", (1e-9, 0.0))
    assert airlight("check", "scene.toml", "--depth", "linear") == 1


def test_other_photo_sizes_of_the_same_shape_are_drawn_at_the_photos_size(here: Path) -> None:
    assert airlight("render", "scene.toml", "-o", "small.png", "--size", "80x60") == 0
    assert airlight("fit", "scene.toml", "small.png", "-o", "out") == 0
    assert json.loads(Path("out/fit.json").read_text())["pixels"]["total"] == 80 * 60


def test_sun_behind_the_camera_leaves_the_shadow_out_and_does_not_spoil_the_verdict(
    here: Path,
) -> None:
    text = SCENE.replace("[1.0, -0.3, 0.2]", "[0.0, -20000.0, 6000.0]")
    Path("front.toml").write_text(text)
    assert airlight("render", "front.toml", "-o", "front.png") == 0
    assert airlight("fit", "front.toml", "front.png", "-o", "out") == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert [item["what"] for item in document["left_out"]] == ["shadow"]
    assert document["parameters"]["shadow"]["stderr"] is None
    channels, _ = render_gl.read_channels("out/layers.exr")
    assert "shadow_front.Z" not in channels


def test_a_linear_exr_is_linear_whatever_the_scenes_own_photo_is(here: Path) -> None:
    Path("own.toml").write_text(SCENE + '[photo]\npath = "photo.png"\ntone_curve = "srgb"\n')
    assert airlight("render", "own.toml", "-o", "linear.exr", "--depth", "linear") == 0
    assert airlight("fit", "own.toml", "linear.exr", "-o", "out") == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert document["tone_curve"] == "linear"
    assert document["parameters"]["brightness"]["value"] == pytest.approx(3.0, rel=1e-4)
    assert document["parameters"]["shadow"]["value"] == pytest.approx(0.2, rel=1e-4)


@pytest.mark.full  # a kind of fit of its own; `test_photo` reads such a file, `test_grey` fits one
def test_a_grey_exr_is_a_photo(here: Path) -> None:
    airlight("render", "scene.toml", "-o", "photo.exr")
    channels, _ = render_gl.read_channels("photo.exr")
    render_gl.write_channels("grey.exr", {"Y": channels["G"]}, {})
    assert airlight("fit", "scene.toml", "grey.exr", "-o", "out") == 0


def test_swapped_layers_are_named(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert airlight("render", "scene.toml", "-o", "layers.exr") == 0
    channels, _ = render_gl.read_channels("layers.exr")
    swapped = {"front.Z": channels["back.Z"], "back.Z": channels["front.Z"]}
    render_gl.write_channels("swapped.exr", swapped, {})
    line = refused(capsys, "fit", "--layers", "swapped.exr", "photo.png", "-o", "out")
    assert "front.Z lies behind back.Z" in line


# --- bad input: one line, a remedy, exit code 2, nothing lost ----------------------------------


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The one line on standard error of a refused command."""
    capsys.readouterr()
    assert airlight(*words) == 2
    printed = capsys.readouterr()
    lines = [line for line in printed.err.splitlines() if line.strip()]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("airlight: ")
    assert "Traceback" not in printed.err
    return lines[0]


def spoil_text(path: Path) -> str:
    path.with_name("text.jpg").write_text("this is no picture\n" * 20)
    return "text.jpg"


def spoil_truncated(suffix: str) -> Callable[[Path], str]:
    def make(path: Path) -> str:
        name = f"cut.{suffix}"
        if suffix == "exr":
            airlight("render", "scene.toml", "-o", name)
        else:
            Image.open(path).save(name)
        data = Path(name).read_bytes()
        Path(name).write_bytes(data[: len(data) // 2])
        return name

    return make


def spoil_channels(path: Path) -> str:
    render_gl.write_channels("depth.exr", {"Z": np.ones((120, 160))}, {})
    return "depth.exr"


def spoil_shape(path: Path) -> str:
    Image.open(path).crop((0, 0, 100, 100)).save("square.png")
    return "square.png"


PHOTOS: dict[str, Callable[[Path], str]] = {
    "missing": lambda path: "nowhere.png",
    "folder": lambda path: ".",
    "text named jpg": spoil_text,
    "truncated jpeg": spoil_truncated("jpg"),
    "truncated png": spoil_truncated("png"),
    "truncated exr": spoil_truncated("exr"),
    "exr without colour": spoil_channels,
    "other aspect ratio": spoil_shape,
}


@pytest.mark.parametrize("spoil", PHOTOS.values(), ids=PHOTOS.keys())
def test_bad_photos_are_refused(
    here: Path, capsys: pytest.CaptureFixture[str], spoil: Callable[[Path], str]
) -> None:
    name = spoil(here / "photo.png")
    line = refused(capsys, "fit", "scene.toml", name, "-o", "out")
    assert name in line
    assert not list(Path("out").glob("*"))


def test_earlier_results_survive_a_refused_fit(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out") == 0
    before = {path.name: path.read_bytes() for path in Path("out").iterdir()}
    refused(capsys, "fit", "scene.toml", "nowhere.png", "-o", "out")
    assert {path.name: path.read_bytes() for path in Path("out").iterdir()} == before


COMMANDS = {
    "no scene": ("render", "nowhere.toml", "-o", "a.exr"),
    "unknown suffix": ("render", "scene.toml", "-o", "a.tga"),
    "bad size": ("render", "scene.toml", "-o", "a.exr", "--size", "12"),
    "huge size": ("render", "scene.toml", "-o", "a.exr", "--size", "30000x30000"),
    "zero size": ("render", "scene.toml", "-o", "a.exr", "--size", "0x9"),
    "one path": ("fit", "photo.png", "-o", "out"),
    "near without layers": ("fit", "scene.toml", "photo.png", "-o", "out", "--near", "3"),
    "no folder": ("render", "scene.toml", "-o", "none/a.exr"),
    "out is a file": ("fit", "scene.toml", "photo.png", "-o", "photo.png"),
    "unknown parameter": ("fit", "scene.toml", "photo.png", "-o", "out", "--free", "glow"),
    "unknown solver": ("fit", "scene.toml", "photo.png", "-o", "out", "--solver", "magic"),
    "source with layers": (
        *("fit", "--layers", "l.exr", "photo.png", "-o", "out"),
        *("--source", "analytic"),
    ),
    "align with layers": ("fit", "--layers", "l.exr", "photo.png", "-o", "out", "--align"),
    "no limb to align": ("fit", "scene.toml", "photo.png", "-o", "out", "--align"),
    "three paths": ("fit", "scene.toml", "photo.png", "scene.toml", "-o", "out"),
    "unknown curve": ("fit", "scene.toml", "photo.png", "-o", "out", "--tone-curve", "log"),
    "layers without channels": ("fit", "--layers", "photo.png", "photo.png", "-o", "out"),
}


ONE = ("scene.toml", "photo.png")
SLIPS = {
    "NaN start": (*ONE, "--start", "brightness=nan"),
    "infinite start": (*ONE, "--start", "shadow=inf"),
    "start outside the range": (*ONE, "--start", "brightness=-1"),
    "start of nothing": (*ONE, "--start", "haze=1"),
    "start without a value": (*ONE, "--start", "shadow"),
    "start given twice": (*ONE, "--start", "shadow=0.1", "--start", "shadow=0.2"),
    "contradictory bounds": (*ONE, "--bounds", "shadow=1:0"),
    "bounds outside the range": (*ONE, "--bounds", "brightness=:-1"),
    "bounds without a range": (*ONE, "--bounds", "shadow=1"),
    "bounds of NaN": (*ONE, "--bounds", "shadow=nan:1"),
    "prior without width": (*ONE, "--prior", "gamma=1:0"),
    "prior without a width": (*ONE, "--prior", "gamma=1"),
    "tied to nothing": (*ONE, "--tie", "gamma="),
    "tied to another kind": (*ONE, "--tie", "gamma=exposure"),
    "tied in a circle": (
        *(*ONE, *ONE, "--tie", "gamma.1=gamma.2"),
        *("--tie", "gamma.2=gamma.1"),
    ),
    "unknown loss": (*ONE, "--loss", "love"),
    "no step": (*ONE, "--max-steps", "0"),
    "nothing free": (*ONE, "--free", ""),
    "a mask for two photos": (*ONE, *ONE, "--mask", "photo.png"),
    "a curve for two photos": (*ONE, *ONE, "--tone-curve", "linear"),
}


@pytest.mark.parametrize("words", SLIPS.values(), ids=SLIPS.keys())
def test_slips_are_found_out_before_any_work(
    here: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
) -> None:
    def work(*args: object, **options: object) -> None:
        raise AssertionError("work was begun")

    monkeypatch.setattr(_job, "load_photo", work)
    refused(capsys, "fit", *words, "-o", "out")
    assert not Path("out").exists()


@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS.keys())
def test_bad_commands_are_refused_in_one_line(
    here: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    refused(capsys, *words)


def test_unwritable_folder(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Root may write anywhere, so the folder is one in which nobody can: /proc."""
    line = refused(capsys, "fit", "scene.toml", "photo.png", "-o", "/proc/airlight")
    assert "/proc/airlight" in line


def test_no_driver(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(scene: object, look: object, depth_format: object, source: object) -> None:
        raise DriverError("no OpenGL driver; install one, or use --source analytic")

    monkeypatch.setattr(render_gl._render, "draw", fail)
    assert "--source analytic" in refused(capsys, "render", "scene.toml", "-o", "a.exr")
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out", "--source", "analytic") == 0


PICTURES = {
    "all black": (np.zeros((120, 160, 3), np.uint8), "no_data"),
    "all white": (np.full((120, 160, 3), 255, np.uint8), "no_data"),
}


@pytest.mark.parametrize(("pixels", "verdict"), PICTURES.values(), ids=PICTURES.keys())
def test_photos_that_tell_nothing_get_a_verdict(
    here: Path, pixels: np.ndarray, verdict: str
) -> None:
    Image.fromarray(pixels).save("flat.png")
    assert airlight("fit", "scene.toml", "flat.png", "-o", "out") == 1
    document = json.loads(Path("out/fit.json").read_text())
    assert document["verdict"] == verdict
    assert Path("out/report.html").stat().st_size > 0


ENDS = {
    "at_bound": ("--bounds", "shadow=0.3:"),
    "not_identifiable": ("--free", "brightness,exposure"),
    "diverged": ("--bounds", "brightness=1e200:"),
    "not_converged": ("--max-steps", "1"),
}


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        # One that is no failure and one that is; the others take the same way.
        pytest.param(v, w, id=v, marks=() if v in ("at_bound", "diverged") else pytest.mark.full)
        for v, w in ENDS.items()
    ],
)
def test_verdicts_have_exit_codes(
    here: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    verdict: str,
    words: tuple[str, ...],
) -> None:
    """0 with a line of warning at a bound, else 1; the results are written all the same."""
    if verdict == "not_converged":  # the exact steps at the end save every descent that is known
        monkeypatch.setattr(_polish, "_FINISHES", 0)
        monkeypatch.setattr(_polish, "_FINISH_STEPS", 0)
    capsys.readouterr()
    code = airlight("fit", "scene.toml", "photo.png", "-o", "out", *words)
    printed = capsys.readouterr()
    document = json.loads(Path("out/fit.json").read_text())
    assert document["verdict"] == verdict
    assert verdict in printed.out
    assert Path("out/report.html").stat().st_size > 0
    if verdict == "at_bound":
        assert code == 0
        assert printed.err == "airlight: warning: the best fit lies at a bound\n"
        assert document["parameters"]["shadow"]["value"] == 0.3
    else:
        assert (code, printed.err) == (1, "")


def test_one_pixel_photo(here: Path) -> None:
    Path("one.toml").write_text(SCENE.replace("160", "1").replace("120\n", "1\n"))
    Image.fromarray(np.full((1, 1, 3), 99, np.uint8)).save("one.png")
    assert airlight("fit", "one.toml", "one.png", "-o", "out") == 1
    assert json.loads(Path("out/fit.json").read_text())["verdict"] == "no_data"


def test_mask_that_excludes_everything(here: Path) -> None:
    Image.fromarray(np.zeros((120, 160), np.uint8)).save("mask.png")
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out", "--mask", "mask.png") == 1
    document = json.loads(Path("out/fit.json").read_text())
    assert document["verdict"] == "no_data"
    assert document["pixels"]["used"] == 0


def test_pixels_that_are_not_numbers_are_left_out(here: Path) -> None:
    airlight("render", "scene.toml", "-o", "photo.exr")
    channels, _ = render_gl.read_channels("photo.exr")
    picture = {name: channels[name].copy() for name in "RGB"}
    picture["R"][30:50] = np.nan
    picture["G"][60:65] = np.inf
    render_gl.write_channels("holes.exr", picture, {})
    assert airlight("fit", "scene.toml", "holes.exr", "-o", "out") == 0
    document = json.loads(Path("out/fit.json").read_text())
    assert document["pixels"]["excluded"]["not finite"] > 0
    assert document["parameters"]["brightness"]["value"] == pytest.approx(3.0, rel=1e-3)


def test_console_script_is_installed() -> None:
    command = shutil.which("airlight", path=str(Path(sys.executable).parent))
    assert command is not None
    done = subprocess.run(
        [command, "version", "--devices"], capture_output=True, text=True, check=True
    )
    assert "OpenGL" in done.stdout


@pytest.mark.parametrize(
    "words", [("fit", "--frobnicate"), ("fit", "a", "b"), ("paint",), ("check",)]
)
def test_usage_errors_are_one_line_that_points_at_the_help(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    assert "--help" in refused(capsys, *words)


def test_without_arguments_the_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert airlight() == 0
    assert "Commands" in capsys.readouterr().out


def test_the_command_line_leaves_jax_as_it_was(here: Path) -> None:
    import jax

    configuration: Any = jax.config  # its type does not list its settings
    assert airlight("fit", "scene.toml", "photo.png", "-o", "out") == 0
    assert not configuration.jax_enable_x64


def test_a_camera_that_looks_away_is_told(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A black picture came without a word."""
    text = Path("scene.toml").read_text()
    turned = re.sub(r"target = .*", "forward = [0.0, -1.0, 0.2]", text)
    assert turned != text
    Path("away.toml").write_text(turned)
    for source in ("raster", "analytic"):
        assert airlight("render", "away.toml", "-o", "a.exr", "--source", source) == 0
        said = capsys.readouterr()
        assert said.err.startswith("airlight: warning: nothing is in view"), said.err
    assert airlight("render", "scene.toml", "-o", "a.exr", "--json") == 0
    assert json.loads(capsys.readouterr().out)["warnings"] == []
