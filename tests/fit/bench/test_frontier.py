"""A small benchmark: its rows mean what they say, and its files say what is in the rows."""

import csv
import json
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fit._compile import float64
from fit.bench._chart import panels
from fit.bench._frontier import Frontier, run_bench
from fit.bench._measure import budgets, codes_apart, stands_still
from fit.bench._page import page_html, who_is_first
from fit.bench._peers import PEERS, installed
from fit.bench._plans import QUICK, SAMPLE
from fit.bench._point import Point, finite, pareto
from fit.bench._render_points import Choices
from fit.bench._scenes import THIN
from model_jax import InputError
from tests.command import airlight
from tests.data import REPOSITORY

RISE = 2.0
"""How far an error may rise with a setting that costs more: places of pixels change with it."""

WIDTH_FLOOR = 2e-5
"""Share of the shell: float32's widths here, above which errors have to fall. A ray's ulp moves a
surface by some 1e-6 of the shell, and a width near the limb by the root of that times its own
length, of 99.9 % of the pixels by ten times as much."""

OPTIMUM = 1e-11
"""float64's eps times a condition of 1e4, of parameters in typical sizes."""


ABOUT = {
    "date": "2026-11-29",
    "machine": {"cores": 2, "versions": {"jax": "1"}},
    "copy_bytes_per_second": 1e9,
    "seed": 1,
}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[Frontier, Path]:
    folder = tmp_path_factory.mktemp("bench")
    with float64():
        return run_bench(folder, SAMPLE), folder


def curves(frontier: Frontier, area: str) -> Iterator[tuple[str, list[Point]]]:
    points = [p for p in frontier.points if p.area == area]
    for key in dict.fromkeys((p.scene, p.look, p.method) for p in points):
        yield key[-1], [p for p in points if (p.scene, p.look, p.method) == key]


def never_rises(errors: list[float], floor: float) -> bool:
    return all(
        after <= RISE * max(before, floor)
        for k, before in enumerate(errors)
        for after in errors[k + 1 :]
    )


def test_errors_fall_as_settings_rise(bench: tuple[Frontier, Path]) -> None:
    """Formats and triangles from coarse to fine, budgets from small to large."""
    found = 0
    for method, points in curves(bench[0], "render"):
        if method in ("raster, by depth format", "mesh, by depth format", "mesh, by triangles"):
            errors = [p.width_p999 for p in points if p.width_p999 is not None]
            assert len(errors) == 2
            assert never_rises(errors, WIDTH_FLOOR), (method, errors)
            found += 1
    for method, points in curves(bench[0], "fit"):
        if re.search("steps|budget", points[0].setting):
            errors = [p.parameters for p in points if p.parameters is not None]
            assert len(errors) == len(points)
            assert never_rises(errors, OPTIMUM), (method, errors)
            found += 1
    assert found == 6


def test_finer_is_nearer(bench: tuple[Frontier, Path]) -> None:
    """What each knob is for, by more than chance."""
    by = dict(curves(bench[0], "render"))
    coarse, fine = by["mesh, by triangles"]
    assert coarse.width_p999 is not None
    assert fine.width_p999 is not None
    assert fine.width_p999 < 0.2 * coarse.width_p999  # 16 times the triangles
    low, high = by["raster, by depth format"]
    assert (low.setting, high.setting) == (
        "raster, window16, 160×128",
        "raster, linear, 160×128",
    )
    assert low.width_rms is not None
    assert high.width_rms is not None
    assert high.width_rms < 0.1 * low.width_rms
    assert high.picture_rms is not None
    (small,) = by["raster, by resolution"]
    assert small.picture_rms is not None
    assert high.picture_rms < 1e-3 * small.picture_rms


def test_oracles_are_at_rounding(bench: tuple[Frontier, Path]) -> None:
    """float64's widths against 50 digits, and the optimum against another solver's."""
    frontier = bench[0]
    exact = [p for p in frontier.points if "analytic, float64" in p.setting]
    assert exact[0].width_max is not None
    # Near the limb a width has half the digits of what it is the root of.
    assert exact[0].width_max < np.sqrt(np.finfo(np.float64).eps)
    assert exact[0].width_rms is not None
    assert exact[0].width_rms < 1e-12
    by = dict(curves(frontier, "fit"))
    assert by["airlight"][0].parameters is not None
    assert by["airlight"][0].parameters < OPTIMUM
    ends = [by["airlight lm, float64, moments, exact steps"][-1]]
    if installed("SciPy trf"):
        ends.append(by["SciPy trf"][-1])
    for end in ends:
        assert end.parameters is not None
        assert end.parameters < OPTIMUM, end


def test_noise_is_what_parts_truth_from_optimum(bench: tuple[Frontier, Path]) -> None:
    """Of 2,300 pixels with noise of 2 %: √(2300 · 3) times better, and some standard errors."""
    (ours,) = dict(curves(bench[0], "fit"))["airlight"]
    assert ours.truth is not None
    assert 1e-6 < ours.truth < 10 * 0.02 / np.sqrt(3 * ours.pixels) * 5


def test_every_row_is_timed_and_says_what_it_is(bench: tuple[Frontier, Path]) -> None:
    for point in bench[0].points:
        assert point.status in ("", "oracle"), point
        assert point.repeats == 7
        assert point.low is not None
        assert point.high is not None
        assert point.seconds is not None
        assert 0 < point.low <= point.seconds <= point.high
        assert point.first is not None
        assert point.setting
        assert point.pixels > 0
    keys = [(p.area, p.scene, p.look, p.method, p.setting) for p in bench[0].points]
    assert len(set(keys)) == len(keys)


def test_files_hold_what_was_measured(bench: tuple[Frontier, Path]) -> None:
    frontier, folder = bench
    with open(folder / "frontier.csv", newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == [field.name for field in fields(Point)]
    assert [row["setting"] for row in rows] == [p.setting for p in frontier.points]
    written = json.loads((folder / "frontier.json").read_text())
    assert written == json.loads(json.dumps(frontier.about()))
    assert written["machine"]["versions"]["jax"]
    assert written["left_out"]
    assert (folder / "frontier.png").read_bytes()[:4] == b"\x89PNG"
    assert "<svg" in (folder / "frontier.svg").read_text()


def test_the_page_stands_alone_and_leads_to_every_point(bench: tuple[Frontier, Path]) -> None:
    frontier, folder = bench
    page = (folder / "bench.html").read_text()
    outside = re.findall(r"""(?:src|href)=["'](?!#)[^"']*""", page)
    assert not [link for link in outside if not link.startswith('href="#')], outside
    assert "wanted" not in page
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(set(ids)) == len(ids)
    marks = {int(name.split("-")[0][1:]) for name in ids if re.fullmatch(r"p\d+-\d+", name)}
    drawn = {
        k
        for k, p in enumerate(frontier.points)
        if any(e is not None for e in (p.width_p999, p.picture_rms, p.light, p.parameters))
    }
    assert marks == drawn
    assert {f"row{k}" for k in range(len(frontier.points))} <= set(ids)


def test_a_cost_may_be_counted_otherwise(bench: tuple[Frontier, Path]) -> None:
    for axis in ("evaluations", "bytes"):
        found = panels(bench[0].points, axis)
        assert any(panel.area == "fit" for panel in found)


def test_what_diverged_is_a_mark_of_its_own() -> None:
    lost = Point("fit", "s", "l", "m", "x", 1, seconds=1.0, status="diverged", note="not finite")
    found = replace(lost, seconds=2.0, parameters=0.1, status="", note="")
    (panel,) = panels([lost, found], "time")
    assert panel.points == (found,)
    assert panel.lost == (lost,)
    page = page_html({"left_out": [], **ABOUT}, [lost, found])
    assert 'id="p0-0"' in page
    assert '<span class="status">diverged</span> not finite' in page


def test_a_front_is_what_nothing_beats() -> None:
    blank = Point("fit", "s", "l", "m", "x", 1)
    places = [(1.0, 1.0), (2.0, 2.0), (2.0, 0.5), (3.0, 0.5), (4.0, 0.1), (0.5, None)]
    points = [replace(blank, seconds=t, parameters=e, setting=f"{t} {e}") for t, e in places]
    failed = replace(blank, seconds=0.1, parameters=0.01, status="diverged")
    found = pareto([failed, *reversed(points)], "parameters")
    assert [p.setting for p in found] == ["1.0 1.0", "2.0 0.5", "4.0 0.1"]


def test_no_number_is_a_failure_by_name() -> None:
    point = Point("fit", "s", "l", "m", "x", 1, seconds=1.0, parameters=float("nan"))
    found = finite(point)
    assert (found.status, found.parameters, found.seconds) == ("failed", None, 1.0)
    assert found.note == "parameters not finite"
    assert finite(replace(point, parameters=1.0)) == replace(point, parameters=1.0)


def test_who_is_first_is_the_quickest_there() -> None:
    ours = Point("fit", "s", "l", "airlight", "x", 1, seconds=2.0, parameters=1e-5)
    peer = replace(ours, method="SciPy trf", seconds=1.0, parameters=1e-3)
    found = who_is_first([ours, peer])
    assert [row["level"] for row in found] == ["0.01", "0.0001"]
    assert [row["peer_wins"] for row in found] == [True, False]
    assert found[1]["rival"] == "none gets there"


def test_budgets_grow_until_errors_stand_still() -> None:
    grown = budgets(100)
    assert grown[0] == 1
    assert grown[-1] == 100
    assert all(b <= max(a + 1, 1.5 * a + 0.5) for a, b in pairwise(grown))
    assert not stands_still([2.0, 2.0, 2.0, 0.1])
    assert stands_still([0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    assert not stands_still([1.0, 1.0, 0.95, 0.9, 0.85, 0.8])
    assert stands_still([1.0, 0.0])


def test_codes_are_of_eight_bits_and_white_is_the_brightest() -> None:
    right = np.array([[0.0, 0.5, 2.0]])
    assert codes_apart(right, right) == (0.0, 0.0)
    most, rms = codes_apart(np.array([[0.0, 0.5, 0.0]]), right)
    assert most == pytest.approx(255)
    assert rms == pytest.approx(255 / np.sqrt(3))


def test_a_peer_that_is_not_there_is_left_out() -> None:
    assert set(QUICK.peers) <= set(PEERS)
    assert not installed("nosuchpackage LM")
    assert installed("SciPy lm")


def test_a_scene_and_photo_of_ones_own(tmp_path: Path) -> None:
    """Drawn, combined and fitted in place of those built in; the photo's aspect has to fit."""
    scene = tmp_path / "mine.toml"
    text = (REPOSITORY / "examples" / "reference.toml").read_text()
    text = text.replace("width = 720", "width = 96").replace("height = 540", "height = 72")
    scene.write_text(text.replace('path = "reference.png"', 'path = "nowhere.png"'))
    photo = tmp_path / "photo.png"
    with Image.open(REPOSITORY / "examples" / "reference.png") as picture:
        picture.resize((96, 72)).save(photo)
    plan = replace(
        SAMPLE,
        choices=Choices(("linear",), (), ()),
        looks=("layers",),
        settings=(),
        peers=(),
        parts=(),
        scales=(),
    )
    with float64():
        found = run_bench(tmp_path, plan, [str(scene)], str(photo), "bytes")
        assert {(p.area, p.scene) for p in found.points} == {
            ("render", "mine"),
            ("combine", "mine"),
            ("fit", "mine"),
        }
        assert {p.look for p in found.points if p.area == "fit"} == {"layers", THIN}
        assert all(p.parameters is not None for p in found.points if p.area == "fit")
        Image.new("RGB", (50, 50)).save(photo)
        with pytest.raises(InputError, match="have another shape"):
            run_bench(tmp_path, plan, [str(scene)], str(photo))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--photo", "x.png"], "needs the --scene"),
        (["--scene", "nowhere.toml"], "nowhere.toml"),
        (["--axis", "money"], "money"),
    ],
)
def test_slips_are_told(
    words: list[str], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert airlight("bench", "-o", str(tmp_path / "out"), *words) == 2
    assert says in capsys.readouterr().err
