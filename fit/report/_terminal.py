"""What the commands print for people: the fit and the check as tables."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from model_jax._errors import printable

from .._numbers import curve_in_words, measured, number, share
from .._verdict import WELL_EXPLAINED
from ._wording import (
    SECOND_OPINIONS,
    choice_in_words,
    clipped_note,
    close_pairs,
    interval_of,
    known_before,
    limb_in_words,
    moved_in_words,
    role_of,
    shown_parameters,
    terms_in_words,
    verdict_sentence,
)

_DISPENSABLE = ("unit", "rounding ≤", "JPEG", "start", "prior")
"""Columns that a narrow terminal goes without, in this order; the report has them all."""


def print_fit(console: Console, document: dict[str, Any], out: str | None) -> None:
    """The result of a fit from its fit.json document; `out` is the folder to point at."""
    explained = document.get("explained")
    doubtful = explained is not None and explained < WELL_EXPLAINED
    style = {"converged": "yellow" if doubtful else "green", "at_bound": "yellow"}.get(
        document["verdict"], "red"
    )
    verdict = (document["verdict"], f"bold {style}")
    console.print(Text.assemble(verdict, f"  {verdict_sentence(document)}"))
    for warning in document.get("warnings") or []:
        _say(console, f"warning: {warning}", "yellow")
    if shown_parameters(document):
        console.print(_parameters(document, console.width))
    for first, second, correlation in close_pairs(document):
        size = f"correlation {correlation:+.3f}".replace("-", "−")
        _say(console, f"{first} and {second} are hard to tell apart: {size}")
    for item in document["left_out"]:
        _say(console, f"left out: {item['what']}, because {item['why']}")
    if chosen := choice_in_words(document):
        _say(console, chosen)
    for term, why in terms_in_words(document):
        _say(console, f"  {term}: {why}")
    for line in (*_photo_lines(document), _error_line(document), _solver_line(document)):
        if line:
            _say(console, line)
    seconds = ", ".join(f"{name} {value:.2f} s" for name, value in document["seconds"].items())
    if seconds:
        _say(console, seconds, "dim")
    if out is not None:
        report = str(Path(out) / "report.html")
        console.print(printable(report), markup=False, highlight=False, soft_wrap=True)


def fit_text(document: dict[str, Any], width: int = 100) -> str:
    """The same as plain text."""
    stream = io.StringIO()
    # In a notebook rich would show what is only asked for.
    console = Console(file=stream, width=width, color_system=None, force_jupyter=False)
    print_fit(console, document, None)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def fit_html(document: dict[str, Any], width: int = 100) -> str:
    """The same as HTML for notebooks, in colours that are read on light and dark."""
    console = Console(
        file=io.StringIO(), width=width, record=True, color_system="standard", force_jupyter=False
    )
    print_fit(console, document, None)
    form = '<pre style="white-space:pre-wrap;line-height:1.35">{code}</pre>'
    return console.export_html(code_format=form, inline_styles=True)


def print_check(console: Console, summary: dict[str, Any], scene: str, folder: str) -> None:
    """Both halves of a cross-check."""
    parity, accuracy = summary["parity"], summary["accuracy"]
    _say(console, f"{printable(scene)}, {summary['depth']} depth", "bold")
    console.print(summary["depth_reason"], style="dim", markup=False, highlight=False)
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
        "bound: roundings of widths by their slopes, and those the look states; depths "
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
    title = f"{summary['source']} against exact widths (smooth sphere)"
    if accuracy["compared"] == 0:
        title += ": nothing could be compared, for no pixel off silhouettes has air"
    _verdict(console, accuracy["passed"], title)
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in ("width error, scene units", "max", "99.9 %", "median", "predicted max", "median"):
        table.add_column(name, justify="left" if name.startswith("width") else "right")
    for name in ("lit", "dark"):
        row = accuracy[name]
        keys = ("max", "p99.9", "median", "predicted_max", "predicted_median")
        table.add_row(name, *(_number(row[key]) for key in keys))
    console.print(table)
    console.print(
        f"{accuracy['compared']:,} widths compared; predicted from "
        + (
            "the roundings of float32 rays"
            if summary["source"] == "raster"
            else "tessellation, pixel grid, float32 transform"
        )
        + f" and depth format; {accuracy['outside']} widths outside. Left out are "
        f"{accuracy['silhouettes']:,} pixels on silhouettes: a ray that just meets or misses a "
        "body may be wrong by the widest chord, "
        f"{_number(accuracy['widest_chord'])}; the worst is by "
        f"{_number(accuracy['silhouette_max'])}",
        style="dim",
        highlight=False,
    )
    files = f"{printable(folder)}/glsl.exr, jax.exr, difference.exr"
    console.print(files, markup=False, highlight=False, soft_wrap=True)


def _parameters(document: dict[str, Any], width: int) -> Table:
    """A row for each parameter; without columns that nobody fills, or that there is no room for."""
    rows = shown_parameters(document)
    columns: dict[str, list[str]] = {
        "parameter": list(rows),
        "value ± stderr": [measured(row["value"], row["stderr"]) for row in rows.values()],
        "95 % interval": [_or_blank(interval_of(row)) for row in rows.values()],
        "rounding ≤": [_or_blank(number(row["quantisation_bound"], 2)) for row in rows.values()],
        "JPEG": [_or_blank(number(row.get("compression_shift"), 2)) for row in rows.values()],
        "start": [number(row["initial"]) for row in rows.values()],
        "role": [role_of(row) for row in rows.values()],
        "prior": [known_before(row["prior"]) for row in rows.values()],
        "unit": [row["unit"] for row in rows.values()],
    }
    columns = {name: texts for name, texts in columns.items() if any(texts)}
    for name in _DISPENSABLE:
        needed = sum(2 + max(map(len, [title, *texts])) for title, texts in columns.items())
        if needed - 2 > width:
            columns.pop(name, None)
    table = Table(box=None, pad_edge=False, padding=(0, 1), header_style="dim")
    for name in columns:
        right = name in ("rounding ≤", "JPEG", "start")
        table.add_column(name, justify="right" if right else "left", overflow="fold")
    for row in zip(*columns.values(), strict=True):
        table.add_row(*(Text(cell) for cell in row))
    return table


def _photo_lines(document: dict[str, Any]) -> Iterator[str]:
    """How many pixels of each photo were used and how well they are explained."""
    photos = document.get("photos") or [document]
    for index, photo in enumerate(photos):
        pixels = photo["pixels"]
        line = f"photo {index + 1}: " if len(photos) > 1 else ""
        line += f"{pixels['used']:,} of {pixels['total']:,} pixels"
        if photo["residual_rms"] is not None:
            line += f", residual rms {number(photo['residual_rms'])} in linear light"
        if len(photos) > 1 and photo["explained"] is not None:
            line += f", {share(photo['explained'])} explained"
        if "tone_curve" in photo:
            line += f", {curve_in_words(photo['tone_curve'])}"
        yield line
        if moved := moved_in_words(photo.get("moved")):
            yield moved
        if limb := limb_in_words(photo.get("alignment")):
            yield limb
        if clipped := clipped_note(pixels):
            yield clipped


def _error_line(document: dict[str, Any]) -> str:
    errors = document.get("errors")
    if not errors:
        return ""
    length = errors["correlation_px"]
    over = f"correlated over {number(length, 3)} px" if length > 1 else "independent of each other"
    return (
        f"residuals: noise {number(errors['noise'], 3)}, {over}, worth "
        f"{errors['effective_samples']:,.0f} independent samples; "
        f"{errors['blocks']:,} blocks of {errors['block_px']} px"
    )


def _solver_line(document: dict[str, Any]) -> str:
    history = document.get("history") or []
    if not history:
        return ""
    loss = document["loss"]
    robust = f", {loss} loss" if loss != "linear" else ""
    steps = "1 step" if len(history) == 2 else f"{len(history) - 1} steps"
    opinion = SECOND_OPINIONS.get(document.get("second_opinion") or "", "")
    return f"{document['solver']}, {steps}{robust}" + (f"; {opinion}" if opinion else "")


def _say(console: Console, text: str, style: str | None = None) -> None:
    """Text as it is: brackets and numbers in it mean nothing to rich."""
    console.print(text, style=style, markup=False, highlight=False)


def _or_blank(text: str) -> str:
    return "" if text == "—" else text


def _verdict(console: Console, passed: bool, text: str) -> None:
    console.print(
        "pass" if passed else "FAIL", style="bold green" if passed else "bold red", end="  "
    )
    console.print(text)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.4g}"
