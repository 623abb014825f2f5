"""The charts: log error against log cost, a curve for each method, the Pareto front drawn."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO, StringIO
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from ._point import ERRORS, MEANINGS, Point, pareto

FLOOR = 1e-16
"""Where an error of 0 is drawn: float64's rounding of numbers of order one."""

COSTS = {
    "time": "seconds, median",
    "evaluations": "passes",
    "bytes": "bytes, at least",
}

_COLORS = mpl.color_sequences["tab20"]
_MARKERS = "osD^vP*X<>hp"
_AREAS = {"render": "Render", "combine": "Combine", "fit": "Fit"}


@dataclass(frozen=True)
class Panel:
    """One chart: what is in it, and what is drawn up."""

    area: str
    title: str
    error: str
    points: tuple[Point, ...]
    lost: tuple[Point, ...] = ()
    """What failed or diverged at some cost: it stands at the upper edge."""


def panels(points: Sequence[Point], axis: str) -> list[Panel]:
    """A chart for each area, scene, look and error of which there is something to draw."""
    found = []
    for area, scene, look in dict.fromkeys(_group(p) for p in points):
        members = tuple(p for p in points if _group(p) == (area, scene, look))
        for error in ERRORS[area]:
            drawn = tuple(p for p in members if is_drawn(p, error, axis))
            lost = tuple(
                p
                for p in members
                if p.status in ("failed", "diverged") and p.cost(axis) is not None
            )
            if drawn:
                title = ", ".join(part for part in (_AREAS[area], scene, look) if part)
                found.append(Panel(area, title, error, drawn, lost))
    return found


def _group(point: Point) -> tuple[str, str, str]:
    """Looks of the combine step share a chart; renders of a scene have one look."""
    return point.area, point.scene, point.look if point.area == "fit" else ""


def is_drawn(point: Point, error: str, axis: str) -> bool:
    """Whether a point has a place."""
    return point.error(error) is not None and point.cost(axis) is not None


def draw_panel(ax: Axes, panel: Panel, axis: str, names: dict[int, str] | None = None) -> None:
    """A chart into axes.

    Args:
        names: of each point, by its `id`, for what is shown when it is pointed at.
    """
    for k, method in enumerate(dict.fromkeys(p.method for p in panel.points)):
        curve = [p for p in panel.points if p.method == method]
        style: dict[str, Any] = {
            "color": _COLORS[(2 * k) % 20 + (2 * k) // 20 % 2],
            "marker": _MARKERS[k % len(_MARKERS)],
            "markersize": 4.5,
            "linewidth": 0.9,
        }
        places = [_place(p, panel.error, axis) for p in curve]
        if panel.area == "combine":  # other looks are other work, and no curve
            style["ls"] = ""
        ax.plot(*zip(*places, strict=True), label=method, alpha=0.85, **style)
        if names is not None:
            for p, place in zip(curve, places, strict=True):
                (mark,) = ax.plot(*[[v] for v in place], **style | {"ls": ""})
                mark.set_gid(names[id(p)])
    for p in panel.lost:
        (mark,) = ax.plot([p.cost(axis) or 0.0], [0.97], "kx", transform=ax.get_xaxis_transform())
        if names is not None:
            mark.set_gid(names[id(p)])
    front = [] if panel.area == "combine" else pareto(list(panel.points), panel.error, axis)
    places = [_place(p, panel.error, axis) for p in front]
    if places:
        style = {"color": "0.15", "lw": 2.2, "alpha": 0.35, "zorder": 1}
        ax.step(*zip(*places, strict=True), where="post", **style)
    ax.set(xscale="log", yscale="log", xlabel=COSTS[axis], ylabel=MEANINGS[panel.error])
    ax.set_title(panel.title, fontsize=10, loc="left")
    ax.grid(alpha=0.25)


def _place(point: Point, error: str, axis: str) -> tuple[float, float]:
    return point.cost(axis) or 0.0, max(point.error(error) or 0.0, FLOOR)


def charts(points: Sequence[Point], axis: str) -> dict[str, bytes]:
    """One picture, as the png and the svg file: of each scene the first error's chart."""
    found = [p for p in panels(points, axis) if p.error == ERRORS[p.area][0]]
    columns = 2
    rows = max(-(-len(found) // columns), 1)
    figure = Figure(figsize=(15, 3.5 * rows), layout="constrained")
    FigureCanvasAgg(figure)
    for k, panel in enumerate(found):
        ax = figure.add_subplot(rows, columns, k + 1)
        draw_panel(ax, panel, axis)
        _legend(ax)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # found once, for both
    written = {}
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "airlight"}):
        for suffix in ("png", "svg"):
            stream = BytesIO()
            metadata = {"Date": None} if suffix == "svg" else None
            figure.savefig(stream, format=suffix, dpi=80, metadata=metadata)
            written[suffix] = stream.getvalue()
    return written


def _legend(ax: Axes) -> None:
    ax.legend(fontsize=6.5, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)


def panel_svg(panel: Panel, axis: str, number: int, rows: dict[int, int]) -> str:
    """A chart as SVG to stand in a page, whose points have ids `p`ROW`-`NUMBER.

    Args:
        number: of the chart on its page.
        rows: of each point's in the table, by its `id`.
    """
    names = {key: f"p{row}-{number}" for key, row in rows.items()}
    figure = Figure(figsize=(10, 4.6), layout="constrained")
    FigureCanvasSVG(figure)
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": f"airlight-{number}"}):
        ax = figure.add_subplot()
        draw_panel(ax, panel, axis, names)
        ax.set_title("", loc="left")
        _legend(ax)
        stream = StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    # Several charts share a page, and ids have to differ.
    own = re.compile(r'(\bid="|url\(#|xlink:href="#)(?!p\d+-\d+")')
    text = own.sub(rf"\g<1>c{number}-", text)
    return re.sub(r' (width|height)="[^"]*pt"', "", text, count=2)
