"""Numbers and roles as words: what the terminal and the report say alike.

All work on the document of `FitResult.to_dict()`, that is on what fit.json holds, so that a report
can be made again from a file.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from model_jax._parameter import RESPONSE_PARAMETERS

from .._numbers import measured, number
from .._verdict import Verdict

CLOSE = 0.9
"""Correlation from which two numbers are named as hard to tell apart: one direction in their plane
is then more than four times as uncertain as the other, √((1 + 0.9) / (1 - 0.9))."""

SEEN = 1e-4
"""Share of a value, or of its typical size, below which its error matters to nobody: a twentieth of
half a step of 8 bits at white."""

SECOND_OPINIONS = {
    "": "nothing was left to fit",
    "closed form": "no look has a smaller square sum: its least value is known in closed form",
    "same": "a second descent, by another method from another start, ended at the same place",
    "higher": "a second descent, by another method from another start, ended higher up",
    "lower": "a second descent, by another method from another start, ended lower",
}
"""What each value of `FitResult.second_opinion` means."""


def shown_parameters(document: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The parameters worth a line: not those of a response that are fixed and change nothing, and
    none where nothing was fitted."""
    if document.get("verdict") == Verdict.NO_DATA.label:
        return {}
    return {
        name: row
        for name, row in (document.get("parameters") or {}).items()
        if not _changes_nothing(name, row)
    }


def role_of(row: Mapping[str, Any]) -> str:
    """ "free", "at bound", "held", "fixed", or "= name" for a tied parameter."""
    if row.get("tied_to"):
        return f"= {row['tied_to']}"
    return str(row.get("role", "fixed")).replace("_", " ")


def limb_in_words(alignment: Mapping[str, Any] | None) -> str:
    """How far the photo's limb lies beside the scene's; empty where none was seen."""
    if not alignment:
        return ""
    return (
        f"limb {number(alignment['off'], 2)} px beside the scene's where it is seen; its edges lie "
        f"within {number(alignment['rms'], 2)} px of one limb"
    )


def moved_in_words(moved: Mapping[str, Any] | None) -> str:
    """The camera that `--align` gave a scene; empty where it kept its own."""
    if not moved:
        return ""
    forward = ", ".join(f"{value:.9f}" for value in moved["forward"])
    return (
        f"aligned: the scene's limb was {number(moved['off'], 2)} px off; with [camera] forward = "
        f"[{forward}], fov_y_deg = {moved['fov_y_deg']:.7g} it is on the photo's"
    )


def choice_in_words(document: Mapping[str, Any]) -> str:
    """By what the look's terms were chosen; empty where they were named, or nothing was fitted."""
    selection = _selection(document)
    if not selection:
        return ""
    if not selection["samples"]:
        return "no term was tried: " + selection["terms"][0]["why"]
    return (
        f"terms chosen by {selection['samples']:,} samples, worth "
        f"{number(selection['effective_samples'], 3)} independent ones; intervals hold for these "
        "terms, and not what choosing adds"
    )


def terms_in_words(document: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Each term that was chosen among, and why it was taken or left out."""
    rows = document.get("parameters") or {}
    found = []
    selection = _selection(document)
    for term in (selection.get("terms") or ()) if selection.get("samples") else ():
        bic = term["delta_bic"]
        odds = "" if bic is None else f"ΔBIC {number(bic, 3)}"
        why = ", ".join(part for part in (odds, term["why"]) if part)
        if not term["taken"]:
            found.append((term["term"], f"left out: {why}"))
            continue
        values = [
            f"{name} {measured(row['value'], row.get('stderr'))}"
            for name, row in rows.items()
            if name.partition(".")[0] in term["parameters"]
        ]
        told = f" ({', '.join(values)})" if values else ""
        found.append((term["term"], f"{term['meaning']}{told}: {why}"))
    return found


def _selection(document: Mapping[str, Any]) -> Mapping[str, Any]:
    told = document.get("verdict") != Verdict.NO_DATA.label
    return (document.get("selection") or {}) if told else {}


def verdict_sentence(document: Mapping[str, Any]) -> str:
    """The message without the warnings, which are listed on their own."""
    warnings = " ".join(document.get("warnings") or ())
    return str(document.get("message") or "").removesuffix(warnings).strip()


def close_pairs(document: Mapping[str, Any]) -> list[tuple[str, str, float]]:
    """Pairs of parameters whose correlation is at least `CLOSE`, the closest first; none whose
    errors do not matter, as those of rounding after a perfect fit."""
    correlation = document.get("correlation")
    if not correlation:
        return []
    rows = document.get("parameters") or {}
    tied = {name for name, row in rows.items() if row.get("tied_to")}  # close by being asked to
    names, matrix = correlation["names"], correlation["matrix"]
    pairs = [
        (names[i], names[j], matrix[i][j])
        for i in range(len(names))
        for j in range(i)
        if matrix[i][j] is not None and abs(matrix[i][j]) >= CLOSE
        if all(names[k] not in tied and _matters(rows.get(names[k]) or {}) for k in (i, j))
    ]
    return [(b, a, c) for a, b, c in sorted(pairs, key=lambda pair: -abs(pair[2]))]


def _matters(row: Mapping[str, Any]) -> bool:
    """An error that somebody could see in a picture, or that is not known to be smaller."""
    error, value = row.get("stderr"), row.get("value")
    if error is None or value is None:
        return True
    return bool(error > SEEN * max(abs(value), row.get("scale") or 0.0))


def span(limits: Sequence[float | None] | None) -> str:
    """`3.0012 … 3.0145`: an interval, to two significant digits of half its width; `—` for none."""
    if not limits or any(limit is None or not math.isfinite(limit) for limit in limits):
        return "—"
    low, high = (float(limit) for limit in limits if limit is not None)
    if not low < high:
        return number(low)
    decimals = 1 - math.floor(math.log10((high - low) / 2))
    if 1e-3 <= max(abs(low), abs(high)) < 1e6 and decimals <= 9:
        shown = max(decimals, 0)
        texts = [f"{round(limit, decimals):.{shown}f}" for limit in (low, high)]
        return f"{texts[0]} … {texts[1]}".replace("-", "−")
    digits = 1 + decimals + math.floor(math.log10(max(abs(low), abs(high))))
    return f"{number(low, digits)} … {number(high, digits)}"


def interval_of(row: Mapping[str, Any]) -> str:
    """A parameter's interval; `≤ 0.16` where it ends at a bound, for nothing is known that side."""
    limits, bounds = row.get("interval"), row.get("bounds") or (None, None)
    if limits and None not in limits:
        low, high = (limit == bound for limit, bound in zip(limits, bounds, strict=True))
        if low != high:
            return f"≤ {number(limits[1], 3)}" if low else f"≥ {number(limits[0], 3)}"
    return span(limits)


def known_before(prior: Sequence[float | None] | None) -> str:
    """A prior as `mean ± sigma`; empty without one."""
    return "" if not prior else f"{number(prior[0])} ± {number(prior[1], 2)}"


def range_of(bounds: Sequence[float | None] | None) -> str:
    """Bounds in words; an open end is None."""
    low, high = bounds or (None, None)
    if low is None and high is None:
        return "none"
    if high is None:
        return f"≥ {number(low)}"
    return f"≤ {number(high)}" if low is None else f"{number(low)} … {number(high)}"


def clipped_note(pixels: Mapping[str, Any]) -> str:
    """How many samples tell a bound only; empty where none does."""
    clipped = pixels.get("clipped_samples") or 0
    return f"{clipped:,} samples clipped: at least this bright, or at most" if clipped else ""


def _changes_nothing(name: str, row: Mapping[str, Any]) -> bool:
    about = RESPONSE_PARAMETERS.get(name.partition(".")[0])
    return about is not None and row.get("role") == "fixed" and row.get("value") == about.default
