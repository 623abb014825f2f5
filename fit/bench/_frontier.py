"""`airlight bench`: error against run time, of renders, the combine step and fits, on this machine.

    scenes, photos (_scenes) ──> points (_render_points, _combine_points, _fit_points, _whole)
        ──> frontier.csv, .json, .png, .svg, .html (_chart, _page)

Timers wait for what they time, the first run counts by itself, the median of `REPEATS` runs counts.
Errors are against float64 or better, never against the contestant itself. What fails or diverges
is a point that says so, and what was left out is listed with the reason.
"""

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from datetime import date
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import jax

from model_jax import AirlightError, find_look
from render_gl import load_scene, write_whole

from ._chart import charts
from ._combine_points import combine_points
from ._fit_points import Limits, fit_points
from ._measure import budgets, copy_bandwidth, machine
from ._page import page_html
from ._peers import PEERS, installed
from ._point import Point
from ._problems import Case
from ._render_points import Choices, render_points, smoothed
from ._scenes import (
    EVERY,
    SEED,
    SIZE,
    THIN,
    Fitted,
    Known,
    built_in,
    of_file,
    photo_fit,
    synthetic_fit,
)
from ._settings import Setting
from ._whole import whole_points

Tell = Callable[..., None]
"""Takes the name of a step, and how much of the whole is done."""

ALL_SETTINGS = (
    Setting(),
    Setting("dogleg"),
    Setting("bfgs"),
    Setting(dtype="float32"),
    Setting(reduction="moments"),
    Setting(reduction="bins"),
    Setting(every=16),
)


@dataclass(frozen=True)
class Plan:
    """What is measured, and how much of it."""

    renders: tuple[str, ...]
    """Scenes that are drawn, by the names of `built_in`."""
    render_pixels: int
    """At most; larger scenes are drawn smaller."""
    choices: Choices
    looks: tuple[str, ...]
    """Of the combine step."""
    combine_pixels: int
    """At most."""
    fits: tuple[tuple[str, str], ...]
    """Scene and look of each fit."""
    fit_pixels: int
    """Of a photo, at most."""
    settings: tuple[Setting, ...]
    peers: tuple[str, ...]
    parts: tuple[int, ...]
    """One in so many pixels is looked at."""
    scales: tuple[int, ...]
    """Width and height of a photo are divided by."""
    limits: Limits
    whole: bool
    """Also what needs processes of its own: first fits, commands from file to file, memory."""


FULL = Plan(
    renders=("paper", "march", "EPIC", "ISS", "extreme"),
    render_pixels=SIZE[0] * SIZE[1],
    choices=Choices(),
    looks=(
        "layers",
        "air",
        "air+density",
        THIN,
        f"{THIN}+sun",
        EVERY,
        "rim",
        "rim+gradient",
        "gradient",
        "gradient+table+mie+veil",
    ),
    combine_pixels=SIZE[0] * SIZE[1] // 4,
    fits=(
        ("synthetic", "layers"),
        ("synthetic", THIN),
        ("march", "layers"),
        ("march", THIN),
        ("EPIC", "layers"),
        ("EPIC", THIN),
        ("ISS", THIN),
        ("extreme", "layers"),
    ),
    fit_pixels=SIZE[0] * SIZE[1],
    settings=ALL_SETTINGS,
    peers=tuple(PEERS),
    parts=(2, 4, 16, 64, 256),
    scales=(2, 4, 8, 16),
    limits=Limits(),
    whole=True,
)

QUICK = replace(
    FULL,
    renders=("synthetic", "extreme"),
    render_pixels=81_920,
    choices=Choices(("window16", "window24", "linear"), (1280, 20480), (2, 4)),
    looks=("layers",),
    combine_pixels=81_920,
    fits=(("synthetic", "layers"),),
    fit_pixels=81_920,
    settings=(Setting(), Setting(reduction="moments"), Setting(dtype="float32")),
    peers=("SciPy trf", "optax L-BFGS", "optimistix LM"),
    parts=(4, 16, 64),
    scales=(2, 4),
    limits=Limits(longest=0.1, most=20),
    whole=False,
)

SAMPLE = replace(
    QUICK,
    renders=("synthetic",),
    render_pixels=20_480,
    choices=Choices(("window16", "linear"), (1280, 20480), (2,)),
    looks=("layers",),
    combine_pixels=20_480,
    fits=(("synthetic", "layers"),),
    fit_pixels=20_480,
    settings=(Setting(reduction="moments"),),
    peers=("SciPy trf",),
    parts=(4, 16),
    scales=(2,),
    limits=Limits(longest=0.1, most=30),
)
"""What the tests can wait for."""


@dataclass(frozen=True)
class Frontier:
    """All points, and what is to be known of them."""

    points: tuple[Point, ...]
    left_out: tuple[str, ...]
    facts: dict[str, Any]
    """Machine, versions, date, seed, a copy's bytes a second."""

    def to_dict(self) -> dict[str, Any]:
        return {
            **self.facts,
            "left_out": list(self.left_out),
            "points": [asdict(point) for point in self.points],
        }


def run_bench(
    folder: Path,
    plan: Plan = FULL,
    scenes: Sequence[str] = (),
    photo: str | None = None,
    axis: str = "time",
    tell: Tell = lambda step, share=None: None,
) -> Frontier:
    """Measure, and write `frontier.csv`, `.json`, `.png`, `.svg` and `.html` into a folder.

    Args:
        scenes: scene files, in place of those built in.
        photo: of the first of them, in place of the one it names.
        axis: what charts and fronts count costs in, of `_point.AXES`.

    Raises:
        InputError: a scene or photo cannot be read, or the folder not be written.
    """
    left_out: list[str] = []
    known = _known(plan, scenes, photo, left_out)
    tell = _sharing(tell, _steps(plan, len(scenes)))
    bandwidth = copy_bandwidth()
    found = list(_measured(plan, known, bool(scenes), bandwidth, left_out, tell))
    left_out += _absent(plan)
    facts = {
        "date": date.today().isoformat(),
        "machine": machine(),
        "seed": SEED,
        "copy_bytes_per_second": bandwidth,
        "axis": axis,
    }
    frontier = Frontier(tuple(found), tuple(left_out), facts)
    tell("drawing charts")
    _write(folder, frontier, axis)
    return frontier


def _sharing(tell: Tell, steps: int) -> Tell:
    """Also tells how many of about so many steps are done: where curves end nobody knows before."""
    done = count()

    def counting(step: str) -> None:
        tell(step, min(next(done) / steps, 0.99))

    return counting


def _steps(plan: Plan, own: int) -> int:
    """About how many there will be."""
    choices = plan.choices
    of_scene = 2 * len(choices.formats) + len(choices.meshes) + len(choices.parts) + 2
    curve = len(budgets(min(plan.limits.most, 50)))
    curves = len(plan.settings) + len(plan.peers)
    of_fit = 2 + len(plan.parts) + len(plan.scales) + curves * curve
    scenes, fits = (own, 2 * own) if own else (len(plan.renders), len(plan.fits))
    return scenes * of_scene + 4 * len(plan.looks) + fits * of_fit + 6 * plan.whole


def _known(
    plan: Plan, scenes: Sequence[str], photo: str | None, left_out: list[str]
) -> dict[str, Known]:
    """Scenes by name."""
    if scenes:
        files = [load_scene(path) for path in scenes]
        known = {file.path.stem: of_file(file, file.path.stem) for file in files}
        if photo is not None:
            first = next(iter(known))
            settings = replace(files[0].photo, path=photo)
            known[first] = replace(known[first], photo=Path(photo), settings=settings)
        return known
    found = {}
    for name in dict.fromkeys((*plan.renders, *(scene for scene, _ in plan.fits))):
        try:
            found[name] = built_in(name)
        except AirlightError as error:
            left_out.append(f"{name}: {error}")
    return found


def _measured(
    plan: Plan,
    known: dict[str, Known],
    own: bool,
    bandwidth: float,
    left_out: list[str],
    tell: Tell,
) -> Iterator[Point]:
    """All points, area by area."""
    renders = tuple(known) if own else tuple(name for name in plan.renders if name in known)
    for name in renders:
        scene = known[name]
        drawn = smoothed(name, scene.scene, scene.look, plan.render_pixels)
        before, after = scene.scene.camera, drawn.scene.camera
        if before.width != after.width:
            left_out.append(
                f"{name}: drawn with {after.width}×{after.height} of "
                f"{before.width}×{before.height} pixels"
            )
        if scene.scene.planet.relief is not None or isinstance(scene.scene.planet.albedo, str):
            left_out.append(
                f"{name}: drawn without relief and textures, which exact intersection cannot follow"
            )
        yield from render_points(drawn, plan.choices, tell)
    if renders:
        first = known[renders[0]]
        case = smoothed(first.name, first.scene, first.look, plan.combine_pixels)
        shell = float(case.scene.atmosphere.height)
        looks = {name: _of_shell(name, shell) for name in plan.looks}
        yield from combine_points(case, looks, bandwidth, tell)
    for fitted in _fits(plan, known, own, left_out):
        case_of = fitted.case()
        if not case_of.pixels:
            left_out.append(f"{fitted.scene}, {fitted.look}: no pixel of the photo can be used")
            continue
        yield from fit_points(
            case_of,
            _smaller(fitted, plan.scales),
            plan.settings,
            plan.peers,
            plan.parts,
            plan.limits,
            tell,
        )
    if plan.whole and not own:
        yield from whole_points(known, left_out, tell)


def _of_shell(name: str, shell: float) -> Any:
    """A look with lengths of the scene's."""
    kind = find_look(name)
    lengths = {"scale_height": shell / 7} if "scale_height" in kind.PARAMETERS else {}
    return kind(**lengths)


def _fits(plan: Plan, known: dict[str, Known], own: bool, left_out: list[str]) -> Iterator[Fitted]:
    """Photos to fit."""
    asked = [(name, look) for name in known for look in ("layers", THIN)] if own else plan.fits
    part = 1
    while SIZE[0] * SIZE[1] // part**2 > plan.fit_pixels:
        part *= 2
    for name, look in asked:
        if name not in known:
            continue
        scene = known[name]
        if not own and name in ("synthetic", "extreme"):
            yield synthetic_fit(name, scene.scene, look, SIZE[0] // part, SIZE[1] // part)
        elif scene.photo is None:
            left_out.append(f"{name}, {look}: its photo is not here")
        else:
            yield photo_fit(scene, look, plan.fit_pixels)


def _smaller(fitted: Fitted, scales: Sequence[int]) -> dict[int, Case]:
    found = {}
    for part in scales:
        case = fitted.smaller(part)
        if case is not None and case.pixels > 10 * len(case.free):
            found[part] = case
    return found


def _absent(plan: Plan) -> list[str]:
    """Peers and devices that are not here."""
    found = [
        f"{peer}: not installed (pip install 'airlight[peers]')"
        for peer in plan.peers
        if not installed(peer)
    ]
    if all(device.platform == "cpu" for device in jax.devices()):
        more = "" if find_spec("jax_cuda12_plugin") else " (pip install 'airlight[cuda]')"
        found.append(f"GPU: JAX finds none{more}")
    found += [
        "SciPy lm, optimistix and L-BFGS know no bounds, and are told none",
        "clipped samples: left out of all fits here, for peers have no way to count a bound",
        "float64 of the combine step: what float32 is held against, so without an error of its own",
    ]
    return found


def _write(folder: Path, frontier: Frontier, axis: str) -> None:
    def write_csv(path: Path) -> None:
        with open(path, "w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, [field.name for field in fields(Point)])
            writer.writeheader()
            writer.writerows(asdict(point) for point in frontier.points)

    write_whole(folder / "frontier.csv", write_csv)
    text = json.dumps(frontier.to_dict(), indent=2, allow_nan=False) + "\n"
    write_whole(folder / "frontier.json", lambda path: _put(path, text))
    for suffix, picture in charts(frontier.points, axis).items():
        write_whole(folder / f"frontier.{suffix}", partial(_put_bytes, picture))
    page = page_html(frontier.to_dict(), frontier.points, axis)
    write_whole(folder / "frontier.html", lambda path: _put(path, page))


def _put_bytes(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def _put(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
