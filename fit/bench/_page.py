"""`bench.html`: charts, who was first, every point, and what is stable; nothing from outside.

`airlight bench` and `airlight stress` both write it, of what either has left in the folder.
"""

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from render_gl import write_whole

from .._numbers import number
from ..report._report import page_template
from ._chart import panel_svg, panels
from ._point import MEANINGS, Point, read_points

LEVELS = (1e-2, 1e-4, 1e-6, 1e-9, 1e-12)
"""Errors of parameters that somebody may want."""

OURS = "airlight"
"""What our methods' names begin with."""


PAGE = "bench.html"


@dataclass(frozen=True)
class Table:
    """A table of words, as `stress.json` has it."""

    title: str
    about: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    marked: tuple[int, ...] = ()
    """Rows to look at."""

    @classmethod
    def of(cls, data: dict[str, Any]) -> "Table":
        """Of JSON data."""
        rows = tuple(tuple(row) for row in data["rows"])
        return cls(
            data["title"], data["about"], tuple(data["columns"]), rows, tuple(data["marked"])
        )


def write_page(folder: Path) -> None:
    """Write the page of a folder's `frontier.csv` and `stress.json`, if it has them.

    A file that another version wrote, or that is none of ours, is left out; the page says so.
    """
    left_out: list[str] = []
    facts, points = _known(_frontier_in, folder / "frontier.json", left_out) or ({}, [])
    stress, tables = _known(_stress_in, folder / "stress.json", left_out) or ({}, [])
    page = page_html(facts, points, stress, tables, left_out)
    write_whole(folder / PAGE, partial(put, page.encode()))


def put(content: bytes, path: Path) -> None:
    """Write a file."""
    path.write_bytes(content)


def put_rows(rows: Sequence[Any], path: Path) -> None:
    """Write records as CSV, their fields as columns."""
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(asdict(rows[0])) if rows else [])
        writer.writeheader()
        writer.writerows(asdict(row) for row in rows)


T = TypeVar("T")


def _known(read: Callable[[Path], T], path: Path, left_out: list[str]) -> T | None:
    """What a file tells; None where it is not there, or is none of ours."""
    if not path.exists():
        return None
    try:
        return read(path)
    except (OSError, ValueError, KeyError, TypeError) as error:
        left_out.append(f"{path.name}: cannot be read ({type(error).__name__}: {error})")
        return None


def _frontier_in(path: Path) -> tuple[dict[str, Any], list[Point]]:
    facts = _facts_in(path, ("axis", "left_out", "copy_bytes_per_second"))
    return facts, read_points(path.with_suffix(".csv"))


def _stress_in(path: Path) -> tuple[dict[str, Any], list[Table]]:
    facts = _facts_in(path, ("tables",))
    return facts, [Table.of(table) for table in facts["tables"]]


def _facts_in(path: Path, names: Sequence[str]) -> dict[str, Any]:
    """Raises `KeyError` where one of the names is missing."""
    facts: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    missing = {"date", "seed", *names} - set(facts) or {"versions"} - set(facts["machine"])
    if missing:
        raise KeyError(*missing)
    return facts


def page_html(
    facts: dict[str, Any],
    points: Sequence[Point],
    stress: dict[str, Any] | None = None,
    tables: Sequence[Table] = (),
    left_out: Sequence[str] = (),
) -> str:
    """The page as text.

    Args:
        facts: `Frontier.about`; empty where there is no frontier.
        stress: date and machine of the tables.
        left_out: more than the facts say.
    """
    rows = {id(point): k for k, point in enumerate(points)}
    axis = facts.get("axis", "time")
    charts = [
        {
            "area": panel.area,
            "title": panel.title,
            "error": MEANINGS[panel.error],
            "svg": panel_svg(panel, axis, k, rows),
        }
        for k, panel in enumerate(panels(points, axis))
    ]
    return page_template("fit.bench", PAGE).render(
        facts=facts,
        charts=charts,
        first=who_is_first(points),
        rows=[_row(point) for point in points],
        stress=stress or {},
        tables=tables,
        left_out=[*facts.get("left_out", ()), *left_out],
    )


def who_is_first(points: Sequence[Point]) -> list[dict[str, Any]]:
    """For each fit and each error that was reached, the quickest way there, and airlight's."""
    found = []
    fits = [p for p in points if p.area == "fit" and p.parameters is not None and not p.status]
    for scene, look in dict.fromkeys((p.scene, p.look) for p in fits):
        members = [
            p
            for p in fits
            if (p.scene, p.look) == (scene, look) and not p.method.startswith(f"{OURS}, whole")
        ]
        for level in LEVELS:
            best = _quickest([p for p in members if p.parameters <= level])  # type: ignore[operator]
            if best is None:
                continue
            own = [p for p in members if p.method.startswith(OURS)]
            ours = _quickest([p for p in own if p.parameters <= level])  # type: ignore[operator]
            rivals = [p for p in members if not p.method.startswith(OURS)]
            rival = _quickest([p for p in rivals if p.parameters <= level])  # type: ignore[operator]
            found.append(
                {
                    "fit": f"{scene}, {look}",
                    "level": number(level),
                    "ours": _called(ours),
                    "rival": _called(rival),
                    "peer_wins": not best.method.startswith(OURS),
                }
            )
    return found


def _quickest(points: list[Point]) -> Point | None:
    timed = [p for p in points if p.seconds is not None]
    return min(timed, key=lambda p: p.seconds or 0.0, default=None)


def _called(point: Point | None) -> str:
    if point is None:
        return "none gets there"
    return f"{milliseconds(point.seconds)}: {point.method}, {point.setting}"


def milliseconds(seconds: float | None) -> str:
    """A time for people."""
    if seconds is None:
        return ""
    return f"{1e3 * seconds:.3g} ms" if seconds < 1 else f"{seconds:.3g} s"


def _row(point: Point) -> dict[str, Any]:
    """A point as words."""
    errors = [
        (name, getattr(point, name))
        for name in (
            "width_max",
            "width_p999",
            "width_rms",
            "picture_max",
            "picture_rms",
            "light",
            "parameters",
            "truth",
        )
    ]
    told = [f"{name} {number(value, 2)}" for name, value in errors if value is not None]
    spread = (
        ""
        if point.low is None or point.high is None
        else f"{milliseconds(point.low)} … {milliseconds(point.high)}"
    )
    return {
        "area": point.area,
        "where": ", ".join(part for part in (point.scene, point.look) if part),
        "method": point.method,
        "setting": point.setting,
        "pixels": f"{point.pixels:,}",
        "time": milliseconds(point.seconds),
        "spread": spread,
        "first": milliseconds(point.first),
        "evaluations": "" if point.evaluations is None else f"{point.evaluations:,}",
        "bytes": "" if point.bytes is None else f"{point.bytes / 1e6:.3g} MB",
        "rate": "" if point.per_second is None else f"{point.per_second / 1e6:.3g} M/s",
        "bandwidth": "" if point.bandwidth is None else f"{100 * point.bandwidth:.2g} %",
        "errors": ", ".join(told),
        "status": point.status,
        "note": point.note,
    }
