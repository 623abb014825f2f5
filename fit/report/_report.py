"""The report of a fit: one self-contained HTML page, made from what fit.json says.

The page asks for nothing from outside: pictures are data addresses, there is no script, and a
content security policy holds it to that. Pictures come from `_pictures`, the page's text from
`templates/report.html`, numbers become words in `_wording`. Each photo's part is made on its own
(`photo_section`), so that the arrays of one photo at a time are held.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from model_jax import Linear, ToneCurve
from model_jax._shapes import AnyArray, Depth, Mask, Rgb

from .._numbers import measured, number, share
from .._verdict import WELL_EXPLAINED, Verdict
from ..photo._photo import Photo
from . import _pictures as pictures
from ._panels import (
    fit_pictures,
    grouped,
    influence_picture,
    photo_pictures,
    profile_charts,
    weights_picture,
)
from ._wording import (
    SECOND_OPINIONS,
    choice_in_words,
    clipped_note,
    close_pairs,
    interval_of,
    known_before,
    range_of,
    role_of,
    shown_parameters,
    terms_in_words,
    verdict_sentence,
)

TONES = {
    "converged": ("good", "Converged"),
    "at_bound": ("warn", "At a bound"),
    "not_identifiable": ("warn", "Not identifiable"),
    "not_converged": ("bad", "Not converged"),
    "diverged": ("bad", "Diverged"),
    "no_data": ("bad", "No data"),
    "misfit": ("bad", "The look does not match"),
}
"""Banner colour and heading of each verdict."""

Section = dict[str, Any]
"""One photo's part of the page, as the template reads it."""

_STEPS = ("render", "choose", "reduce", "solve", "errors", "report")


def page_template(package: str, name: str) -> Template:
    """A page of a package's folder `templates`; what is filled in is escaped, what is missing an
    error."""
    environment = Environment(
        loader=PackageLoader(package),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name)


def report_html(document: dict[str, Any], sections: Sequence[Section], command: str) -> str:
    """The report as HTML text.

    Args:
        document: the contents of fit.json; what is missing there is missing here.
        sections: by `photo_section`, one for each photo.
        command: what was run, verbatim.
    """
    verdict = str(document.get("verdict"))
    tone, heading = TONES.get(verdict, ("warn", verdict))
    explained = document.get("explained")
    if tone == "good" and explained is not None and explained < WELL_EXPLAINED:
        tone = "warn"  # the numbers are the best ones, of a look that does not fit
    return page_template("fit.report", "report.html").render(
        document=document,
        tone=tone,
        heading=heading,
        sentence=verdict_sentence(document),
        warnings=document.get("warnings") or [],
        source=document.get("scene") or document.get("layers") or "—",
        facts=_facts(document),
        sections=sections,
        stops=pictures.color_stops(pictures.RESIDUAL),
        influence_stops=pictures.color_stops(pictures.INFLUENCE),
        weight_stops=pictures.color_stops(pictures.WEIGHT),
        fitted=verdict != Verdict.NO_DATA.label,
        parameters=[_row(name, e) for name, e in shown_parameters(document).items()],
        compressed=any(
            e.get("compression_shift") is not None for e in shown_parameters(document).values()
        ),
        told=_told(document),
        choice=choice_in_words(document),
        terms=terms_in_words(document),
        errors=_errors(document),
        correlation=_correlation(document.get("correlation")),
        pairs=[(a, b, f"{c:+.3f}".replace("-", "−")) for a, b, c in close_pairs(document)],
        descent=_descent(document),
        times=_times(document.get("seconds") or {}),
        left_out=document.get("left_out") or [],
        pixels=_pixel_rows(document.get("pixels") or {}),
        clipped=clipped_note(document.get("pixels") or {}),
        versions=document.get("versions") or {},
        command=command,
    )


def photo_section(
    name: str,
    photo: Rgb | Photo,
    picture: Rgb | None,
    used: Mask,
    height: Depth | None,
    tone_curve: ToneCurve | None = None,
    *,
    shadowed: Mask | None = None,
    influence: tuple[str, Float[AnyArray, "h w"]] | None = None,
    weights: Float[AnyArray, "h w"] | None = None,
    count: int = 1,
) -> Section:
    """One photo's pictures, profile and influence map.

    Args:
        name: the photo's path.
        photo: linear light; NaN and Inf may occur.
        picture: what the fitted look makes of it, linear light; None where nothing was fitted.
        used: pixels that took part in the fit.
        height: height above the limb of each pixel's line of sight, scene units; NaN where it is
            not known, None where it is known nowhere.
        tone_curve: photo and picture are shown through it; None: a `Photo`'s own.
        shadowed: pixels whose air is mostly in shadow; they get a limb profile of their own.
        influence: a parameter, and its derivative by each pixel's light, summed over channels.
        weights: how much a robust loss believed each pixel; None where the loss is not robust.
        count: number of photos on the page, which share its size.
    """
    light = photo if isinstance(photo, Photo) else np.asarray(photo)
    if tone_curve is None:
        tone_curve = photo.tone_curve if isinstance(photo, Photo) else Linear()
    mask = np.asarray(used)
    if picture is None:
        return {
            "name": name,
            "look": photo_pictures(light, mask, tone_curve, count),
            "profile": None,
            "influence": None,
            "weights": None,
        }
    model = np.asarray(picture)
    shade = None if shadowed is None else np.asarray(shadowed)
    return {
        "name": name,
        "look": fit_pictures(light, model, mask, tone_curve, count),
        "profile": profile_charts(light, model, mask, height, shade),
        "influence": influence_picture(influence, mask, shade, count),
        "weights": weights_picture(weights, mask, count),
    }


def _facts(document: dict[str, Any]) -> list[tuple[str, str]]:
    """The few numbers under the verdict."""
    pixels = document.get("pixels") or {}
    limbs = [limb for photo in document.get("photos") or [] if (limb := photo.get("alignment"))]
    off = max((limb["off"] for limb in limbs), default=0.0)
    beside = [("limb beside the scene's", f"{number(off, 2)} px")] if limbs else []
    moved = [was["off"] for photo in document.get("photos") or [] if (was := photo.get("moved"))]
    if moved:
        beside.append(("before it was aligned", f"{number(max(moved), 2)} px"))
    if document.get("verdict") == Verdict.NO_DATA.label:
        return [("pixels that could be used", grouped(pixels.get("used", 0))), *beside]
    facts = [("residual rms", number(document.get("residual_rms"), 3))]
    explained = document.get("explained")
    if explained is not None:
        facts.append(("variance explained", share(explained)))
    facts.append(("pixels used", grouped(pixels.get("used", 0))))
    free = [e for e in (document.get("parameters") or {}).values() if e.get("free")]
    facts.append(("numbers fitted", str(len(free))))
    for name, per_length in (document.get("per_length") or {}).items():
        facts.append((f"{name} per scene unit", number(per_length)))
    if document.get("loss", "linear") != "linear":
        facts.append(("robust loss", str(document["loss"]).replace("_", "-")))
    return [*facts, *beside]


def _row(name: str, estimate: dict[str, Any]) -> dict[str, Any]:
    """A row of the parameter table."""
    role = role_of(estimate)
    stderr = estimate.get("stderr")
    kind = "fitted" if role == "free" else "no" if role in ("at bound", "held") else ""
    return {
        "name": name,
        "value": measured(estimate.get("value"), stderr),
        "interval": interval_of(estimate),
        "initial": number(estimate.get("initial")),
        "prior": known_before(estimate.get("prior")) or "—",
        "bounds": range_of(estimate.get("bounds")),
        "unit": str(estimate.get("unit") or "").replace("_", " "),
        "meaning": str(estimate.get("meaning") or ""),
        "role": "fitted" if role == "free" else "not told" if role == "held" else role,
        "kind": kind,
        "quantisation": number(estimate.get("quantisation_bound"), 2),
        "compression": number(estimate.get("compression_shift"), 2),
    }


def _told(document: dict[str, Any]) -> list[tuple[str, str]]:
    """What the photo tells and what not: a heading and the names under it."""
    rows = shown_parameters(document)
    words = (
        ("free", "Told"),
        ("at bound", "At a bound: what fits best lies beyond"),
        ("held", "Not told: the start value stands"),
        ("fixed", "Not asked about"),
    )
    if document.get("verdict") == Verdict.NO_DATA.label:
        return []
    found = [
        (text, [name for name, row in rows.items() if role_of(row) == role]) for role, text in words
    ]
    ties = [f"{name} {role_of(row)}" for name, row in rows.items() if row.get("tied_to")]
    return [(text, ", ".join(names)) for text, names in [*found, ("Tied", ties)] if names]


def _errors(document: dict[str, Any]) -> dict[str, Any] | None:
    """What the standard errors rest on, in words."""
    errors = document.get("errors")
    if not errors:
        return None
    pixels = document.get("pixels") or {}
    samples = 3 * pixels.get("used", 0) - (pixels.get("clipped_samples") or 0)
    length = errors.get("correlation_px") or 1
    return {
        "noise": number(errors.get("noise"), 3),
        "length": f"{number(length, 3)} px",
        "correlated": length > 1,
        "block": f"{errors.get('block_px')} px",
        "blocks": grouped(errors.get("blocks") or 0),
        "samples": grouped(samples),
        "effective": grouped(round(errors.get("effective_samples") or 0)),
    }


def _descent(document: dict[str, Any]) -> dict[str, Any]:
    """The curve of the square sum, and what the checks at its end said."""
    history = [h for h in document.get("history") or [] if h is not None and h > 0]
    second = document.get("second_opinion")
    words = SECOND_OPINIONS.get(second, "") if second is not None and history else ""
    return {
        "solver": document.get("solver") or "—",
        "steps": max(0, len(history) - 1),
        "light": pictures.history_picture(history, "light") if len(history) > 1 else None,
        "dark": pictures.history_picture(history, "dark") if len(history) > 1 else None,
        "check": f"{words[0].upper()}{words[1:]}." if words else "",
    }


def _correlation(correlation: dict[str, Any] | None) -> dict[str, Any] | None:
    """Names, and rows of cells: text, colour strength in percent, sign. None: nothing to show."""
    if not correlation or len(correlation.get("names") or ()) < 2:
        return None
    rows = [
        [
            {
                "text": "—" if c is None else f"{c:+.2f}".replace("-", "−") if i != j else "1",
                "strength": 0 if c is None or i == j else round(85 * min(1.0, abs(c))),
                "sign": "positive" if (c or 0) >= 0 else "negative",
                "same": i == j,
            }
            for j, c in enumerate(row)
        ]
        for i, row in enumerate(correlation["matrix"])
    ]
    return {
        "names": correlation["names"],
        "rows": list(zip(correlation["names"], rows, strict=True)),
    }


def _times(seconds: dict[str, float | None]) -> dict[str, Any] | None:
    """Parts of the bar; None without times."""
    known = {name: float(value) for name, value in seconds.items() if value is not None}
    total = sum(known.values())
    if total <= 0:
        return None
    names = [n for n in _STEPS if n in known] + [n for n in known if n not in _STEPS]
    parts = [
        {
            "name": name,
            "share": round(100 * known[name] / total, 2),
            "percent": f"{100 * known[name] / total:.0f} %",
            "text": _duration(known[name]),
            "color": k % 5,
        }
        for k, name in enumerate(names)
    ]
    return {"parts": parts, "total": _duration(total), "has_report": "report" in known}


def _duration(seconds: float) -> str:
    return f"{1000 * seconds:.3g} ms" if seconds < 0.9995 else f"{seconds:.3g} s"


def _pixel_rows(pixels: dict[str, Any]) -> list[dict[str, Any]]:
    """Used, each reason of exclusion, total."""
    total = pixels.get("total", 0)
    rows = [("used", pixels.get("used", 0), "used")]
    rows += [(reason, n, "out") for reason, n in (pixels.get("excluded") or {}).items() if n]
    rows.append(("total", total, "total"))
    return [
        {
            "name": name,
            "count": grouped(n),
            "share": f"{100 * n / total:.2f}" if total else "0",
            "kind": kind,
        }
        for name, n, kind in rows
    ]
