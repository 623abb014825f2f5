"""One point of the frontier: a setting, what it cost, and how far off it was."""

import csv
import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from statistics import median
from typing import Any, Literal, get_type_hints

Area = Literal["render", "combine", "fit"]

ERRORS = {
    "render": ("width_p999", "picture_rms"),
    "combine": ("light",),
    "fit": ("parameters", "picture_rms"),
}
"""Errors that are drawn, by area."""

MEANINGS = {
    "width_p999": "width (99.9 %), share of the shell",
    "picture_rms": "picture (rms), codes of 8 bits",
    "light": "light or slopes, share of largest",
    "parameters": "worst parameter, typical sizes",
}

AXES = {"time": "seconds", "evaluations": "evaluations", "bytes": "bytes"}
"""What a cost may be counted in, and the field that has it."""


@dataclass(frozen=True)
class Times:
    """Seconds of repeated runs."""

    first: float
    """The warm-up, which is no part of the others: compiling, uploading."""
    runs: tuple[float, ...]

    @property
    def median(self) -> float:
        return float(median(self.runs))


@dataclass(frozen=True)
class Point:
    """A row of `frontier.csv`. What is not known, or means nothing, is None."""

    area: Area
    scene: str
    look: str
    method: str
    """Points of one method are a curve."""
    setting: str
    """All that was chosen, in words."""
    pixels: int
    seconds: float | None = None
    """Median of `repeats` runs after the first."""
    low: float | None = None
    high: float | None = None
    first: float | None = None
    """The first run, with compiling and uploading."""
    repeats: int = 0
    evaluations: int | None = None
    """Fits: passes over pixels or pseudo-pixels, as the solver counts them. Renders: draw calls."""
    bytes: int | None = None
    """Read and written at least: each input and output once a pass."""
    per_second: float | None = None
    """Pixels."""
    bandwidth: float | None = None
    """Bytes a second, as a share of a copy's."""
    width_max: float | None = None
    """Largest error of a width, share of the shell's height; the next two, of the same."""
    width_p999: float | None = None
    width_rms: float | None = None
    picture_max: float | None = None
    """Largest difference of the picture, codes of 8 bits (sRGB, white where the right picture is
    brightest)."""
    picture_rms: float | None = None
    light: float | None = None
    """Largest difference of the air's light, or of slopes, share of the largest."""
    parameters: float | None = None
    """Largest difference of a parameter from the float64 optimum over all pixels, share of its
    typical size."""
    truth: float | None = None
    """The same from what a synthetic photo was made with."""
    status: Literal["", "oracle", "failed", "diverged"] = ""
    """"oracle": what others are held against; it has an error where something better is known."""
    note: str = ""

    def error(self, name: str) -> float | None:
        """An error by its name."""
        found: float | None = getattr(self, name)
        return found

    def cost(self, axis: str) -> float | None:
        """What it cost, by an axis of `AXES`."""
        found = getattr(self, AXES[axis])
        return None if found is None else float(found)


def timed(times: Times | None) -> dict[str, Any]:
    """Fields of a point that repeated runs tell."""
    if times is None:
        return {}
    runs = times.runs
    return {
        "seconds": times.median,
        "low": min(runs),
        "high": max(runs),
        "first": times.first,
        "repeats": len(runs),
    }


def finite(point: Point) -> Point:
    """The point; if some number of it is none, without it and failed."""
    broken = {
        field.name: None
        for field in fields(point)
        if isinstance(value := getattr(point, field.name), float) and not math.isfinite(value)
    }
    if not broken:
        return point
    words = f"{', '.join(broken)} not finite"
    return replace(point, **broken, status="failed", note=words)  # type: ignore[arg-type]


def read_points(path: Path) -> list[Point]:
    """All rows of a `frontier.csv`."""
    kinds = get_type_hints(Point)
    with open(path, newline="", encoding="utf-8") as stream:
        return [
            Point(**{f.name: _read(row[f.name], kinds[f.name]) for f in fields(Point)})
            for row in csv.DictReader(stream)
        ]


def _read(text: str, kind: Any) -> Any:
    if kind is str or "Literal" in str(kind):
        return text
    if text == "":
        return None
    return int(text) if "int" in str(kind) else float(text)


def pareto(points: list[Point], error: str, axis: str = "time") -> list[Point]:
    """Points than which no other is both cheaper and nearer, the cheapest first.

    Failed ones are none.
    """
    known = [
        p
        for p in points
        if p.status in ("", "oracle") and p.error(error) is not None and p.cost(axis) is not None
    ]
    front: list[Point] = []
    for p in sorted(known, key=lambda p: (p.cost(axis), p.error(error))):
        if not front or p.error(error) < front[-1].error(error):  # type: ignore[operator]
            front.append(p)
    return front
