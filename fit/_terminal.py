"""What the commands print for people: the fit and the check as tables."""

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from ._result import WELL_EXPLAINED


def print_fit(console: Console, document: dict[str, Any], out: str) -> None:
    """The result of a fit from its fit.json document."""
    explained = document.get("explained")
    doubtful = explained is not None and explained < WELL_EXPLAINED
    style = {"converged": "yellow" if doubtful else "green", "at_bound": "yellow"}.get(
        document["verdict"], "red"
    )
    console.print(document["verdict"], style=f"bold {style}", end="  ")
    console.print(document["message"], markup=False, highlight=False)
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("parameter", "value", "± stderr", "rounding ≤", "start", "unit"):
        table.add_column(name, justify="left" if name in ("parameter", "unit") else "right")
    for name, row in document["parameters"].items():
        stderr = _number(row["stderr"]) if row["stderr"] is not None else "held"
        bound = row.get("quantisation_bound")
        table.add_row(
            name,
            _number(row["value"]),
            stderr,
            "" if bound is None else _number(bound),
            _number(row["initial"]),
            row["unit"],
        )
    console.print(table)
    pixels = document["pixels"]
    facts = f"{pixels['used']:,} of {pixels['total']:,} pixels"
    if document["residual_rms"] is not None:
        facts += f", residual rms {_number(document['residual_rms'])} in linear light"
    console.print(f"{facts}, tone curve {document['tone_curve']}", highlight=False)
    for item in document["left_out"]:
        console.print(f"left out: {item['what']}, because {item['why']}", markup=False)
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in document["seconds"].items())
    console.print(seconds, style="dim", highlight=False)
    report = str(Path(out) / "report.html")
    console.print(report, markup=False, highlight=False, soft_wrap=True)


def print_check(
    console: Console, summary: dict[str, Any], scene: str, depth: str, folder: str
) -> None:
    """Both halves of a cross-check."""
    parity, accuracy = summary["parity"], summary["accuracy"]
    console.print(f"{scene}, {depth} depth", style="bold", markup=False, highlight=False)
    _verdict(console, parity["passed"], "GLSL against JAX on the same layers")
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("difference", "max", "99.9 %"):
        table.add_column(name, justify="left" if name == "difference" else "right")
    table.add_row("absolute", _number(parity["max"]), _number(parity["p99.9"]))
    table.add_row("in ulp of the pixel", _number(parity["max_ulp"]), _number(parity["p99.9_ulp"]))
    table.add_row(
        "relative to image max", _number(parity["max_relative"]), _number(parity["p99.9_relative"])
    )
    table.add_row("bound, relative to image max", _number(parity["bound_relative"]), "")
    console.print(table)
    division = parity["division_ulp"]
    console.print(
        "bound: 11 roundings of ½ to 2.5 ulp in the colour arithmetic; depths "
        + (
            "need no division or are divided exactly by this driver (65,536 quotients tried)"
            if division == 0
            else f"differ by up to {division:g} ulp each, as measured on this driver"
        ),
        style="dim",
        highlight=False,
    )
    worst = parity["worst_pixel"]
    console.print(
        f"worst pixel: row {worst['row']}, column {worst['column']}, {worst['channel']}: "
        f"GLSL {worst['glsl']:.9g}, JAX {worst['jax']:.9g}, bound {_number(worst['bound'])}",
        highlight=False,
    )
    _verdict(console, accuracy["passed"], "rasterised against exact widths (smooth sphere)")
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("width error, scene units", "max", "99.9 %", "median", "predicted max", "median"):
        table.add_column(name, justify="left" if name.startswith("width") else "right")
    for name in ("lit", "dark"):
        row = accuracy[name]
        keys = ("max", "p99.9", "median", "predicted_max", "predicted_median")
        table.add_row(name, *(_number(row[key]) for key in keys))
    console.print(table)
    console.print(
        "predicted from tessellation, pixel grid, float32 transform and depth format; "
        f"{accuracy['outside']} widths outside; {accuracy['edges']} pixels on a silhouette, where "
        "only the widest chord bounds the error",
        style="dim",
        highlight=False,
    )
    files = f"{folder}/glsl.exr, jax.exr, difference.exr"
    console.print(files, markup=False, highlight=False, soft_wrap=True)


def _verdict(console: Console, passed: bool, text: str) -> None:
    console.print(
        "pass" if passed else "FAIL", style="bold green" if passed else "bold red", end="  "
    )
    console.print(text)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
