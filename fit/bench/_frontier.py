"""`airlight bench`: error against run time, of renders, the combine step and fits, on this machine.

    scenes, photos (_scenes) ──> points (_render_points, _combine_points, _fit_points, _whole)
        ──> frontier.csv, .json, .png, .svg, bench.html (_chart, _page)

Timers wait for what they time, the first run counts by itself, the median of `REPEATS` runs counts.
Errors are against float64 or better, never against the contestant itself. What fails or diverges
is a point that says so, and what was left out is listed with the reason.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import date
from functools import partial
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import Any

import jax

from model_jax import AirlightError, find_look
from render_gl import PhotoSettings, load_scene, write_whole

from ._chart import charts
from ._combine_points import GLSL, combine_points
from ._fit_points import fit_points
from ._measure import copy_bandwidth, machine
from ._page import put, put_rows, write_page
from ._peers import installed
from ._plans import FULL, Plan, steps_of
from ._point import Point, finite
from ._problems import Case
from ._render_points import render_points, smoothed
from ._scenes import (
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
from ._whole import whole_points

Tell = Callable[..., None]
"""Takes the name of a step, and how much of the whole is done."""


@dataclass(frozen=True)
class Frontier:
    """All points, and what is to be known of them."""

    points: tuple[Point, ...]
    left_out: tuple[str, ...]
    facts: dict[str, Any]
    """Machine, versions, date, seed, a copy's bytes a second."""

    def to_dict(self) -> dict[str, Any]:
        """All of it, as JSON data."""
        return self.about() | {"points": [asdict(point) for point in self.points]}

    def about(self) -> dict[str, Any]:
        """What there is to know beside the points."""
        return self.facts | {"left_out": list(self.left_out)}


def run_bench(
    folder: Path,
    plan: Plan = FULL,
    scenes: Sequence[str] = (),
    photo: str | None = None,
    axis: str = "time",
    tell: Tell = lambda step, share=None: None,
) -> Frontier:
    """Measure, and write into a folder `frontier.csv`, the points; `.json`, machine, versions, seed
    and what was left out; `.png` and `.svg`; and the page `bench.html`.

    Args:
        scenes: scene files, in place of those built in.
        photo: of the first of them, in place of the one it names.
        axis: what charts and fronts count costs in, of `_point.AXES`.

    Raises:
        InputError: a scene or photo cannot be read, or the folder not be written.
    """
    left_out: list[str] = []
    known = _known(plan, scenes, photo, left_out)
    tell = _sharing(tell, steps_of(plan, len(scenes)))
    bandwidth = copy_bandwidth()
    measured = _measured(plan, known, bool(scenes), bandwidth, left_out, tell)
    found = [finite(point) for point in measured]
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


def _known(
    plan: Plan, scenes: Sequence[str], photo: str | None, left_out: list[str]
) -> dict[str, Known]:
    """Scenes by name."""
    if scenes:
        files = [load_scene(path) for path in scenes]
        stems = [file.path.stem for file in files]
        names = stems if len(set(stems)) == len(stems) else [str(file.path) for file in files]
        known = {name: of_file(file, name) for name, file in zip(names, files, strict=True)}
        if photo is not None:
            first, own = next(iter(known)), files[0].photo
            # What a scene says of its photo it says of no other.
            same = own.path is not None and os.path.realpath(photo) == own.path
            settings = own if same else PhotoSettings(path=photo)
            known[first] = replace(known[first], photo=Path(photo), settings=settings)
        return known
    found = {}
    for name in dict.fromkeys((*plan.renders, *(scene for scene, _, _ in plan.fits))):
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
        yield from _on_devices(lambda: combine_points(case, looks, bandwidth, tell))
    for fitted in _fits(plan, known, own, left_out):
        case_of = fitted.case()
        if not case_of.pixels:
            left_out.append(f"{fitted.scene}, {fitted.look}: no pixel of the photo can be used")
            continue
        given = (case_of, _smaller(fitted, plan.scales), plan.settings, plan.peers, plan.parts)
        yield from _on_devices(partial(fit_points, *given, plan.limits, tell))
    if plan.whole and not own:
        yield from whole_points(known, left_out, tell)


def devices() -> list[jax.Device]:
    """What JAX can compute with: the processor and, where there is one, a GPU."""
    default = jax.devices()[0]
    return [*jax.devices("cpu")[:1], *([] if default.platform == "cpu" else [default])]


def _on_devices(make: Callable[[], Iterator[Point]]) -> Iterator[Point]:
    """The points of all devices; what another than the processor computed says so."""
    for device in devices():
        with jax.default_device(device):
            found = list(make())
        for point in found:
            if device.platform == "cpu":
                yield point
            elif point.method != GLSL:
                yield replace(point, method=f"{point.method}, {device.device_kind}")


def _of_shell(name: str, shell: float) -> Any:
    """A look with lengths of the scene's."""
    kind = find_look(name)
    lengths = {"scale_height": shell / 7} if "scale_height" in kind.PARAMETERS else {}
    return kind(**lengths)


def _fits(plan: Plan, known: dict[str, Known], own: bool, left_out: list[str]) -> Iterator[Fitted]:
    """Photos to fit."""
    mine = [
        (name, look, plan.fit_pixels)
        for name, scene in known.items()
        for look in dict.fromkeys((scene.look.NAME, "layers", THIN))
    ]
    for name, look, most in mine if own else plan.fits:
        if name not in known:
            continue
        scene = known[name]
        if not own and name in ("synthetic", "extreme"):
            part = 1
            while SIZE[0] * SIZE[1] // part**2 > most:
                part *= 2
            yield synthetic_fit(name, scene.scene, look, SIZE[0] // part, SIZE[1] // part)
        elif scene.photo is None:
            left_out.append(f"{name}, {look}: its photo is not here")
        else:
            yield photo_fit(scene, look, most)


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
    if len(devices()) == 1:
        more = "" if find_spec("jax_cuda12_plugin") else " (pip install 'airlight[cuda]')"
        found.append(f"GPU: JAX finds none{more}")
    found += [
        "SciPy lm, optimistix and L-BFGS know no bounds, and are told none",
        "clipped samples: left out of all fits here, for peers have no way to count a bound",
        "what a fit's optimum holds, at a bound or untold: held for peers and single settings",
        "float64 of the combine step: what float32 is held against, so without an error of its own",
    ]
    return found


def _write(folder: Path, frontier: Frontier, axis: str) -> None:
    write_whole(folder / "frontier.csv", partial(put_rows, frontier.points))
    text = json.dumps(frontier.about(), indent=2, allow_nan=False) + "\n"
    write_whole(folder / "frontier.json", partial(put, text.encode()))
    for suffix, picture in charts(frontier.points, axis).items():
        write_whole(folder / f"frontier.{suffix}", partial(put, picture))
    write_page(folder)
