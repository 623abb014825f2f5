"""The report of a fit: one self-contained HTML page, made from what fit.json says.

The page asks for nothing from outside: pictures are data addresses, there is no script, and a
content security policy holds it to that. Pictures come from `_pictures`, the page's text from
`templates/report.html`, numbers become words in `_wording`. Each photo's part is made on its own
(`photo_section`), so that the arrays of one photo at a time are held.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from jinja2 import Environment, PackageLoader, StrictUndefined

from model_jax import Linear, ToneCurve
from model_jax._shapes import AnyArray, Depth, Mask, Rgb

from . import _pictures as pictures
from ._photo import Photo
from ._verdict import WELL_EXPLAINED, Verdict
from ._wording import (
    SECOND_OPINIONS,
    clipped_note,
    close_pairs,
    interval_of,
    known_before,
    measured,
    number,
    range_of,
    role_of,
    share,
    shown_parameters,
    verdict_sentence,
)

TONES = {
    "converged": ("good", "Converged"),
    "at_bound": ("warn", "At a bound"),
    "not_identifiable": ("warn", "Not identifiable"),
    "not_converged": ("bad", "Not converged"),
    "diverged": ("bad", "Diverged"),
    "no_data": ("bad", "No data"),
}
"""Banner colour and heading of each verdict."""

PICTURE_BYTES = 600_000
"""PNG bytes of each of the three large pictures, shared by the photos; with the rest, base64 makes
under 5 MB."""
DETAIL_BYTES = 140_000
"""PNG bytes of each smaller picture, shared likewise."""

Section = dict[str, Any]
"""One photo's part of the page, as the template reads it."""

_STEPS = ("render", "reduce", "solve", "errors", "report")


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
    environment = Environment(
        loader=PackageLoader("fit", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("report.html").render(
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
            "look": _look_at_photo(light, mask, tone_curve, count),
            "profile": None,
            "influence": None,
            "weights": None,
        }
    model = np.asarray(picture)
    shade = None if shadowed is None else np.asarray(shadowed)
    return {
        "name": name,
        "look": _look_at(light, model, mask, tone_curve, count),
        "profile": _profile(light, model, mask, height, shade),
        "influence": _influence(influence, mask, shade, count),
        "weights": _weights(weights, mask, count),
    }


def _facts(document: dict[str, Any]) -> list[tuple[str, str]]:
    """The few numbers under the verdict."""
    pixels = document.get("pixels") or {}
    if document.get("verdict") == Verdict.NO_DATA.label:
        return [("pixels that could be used", _count(pixels.get("used", 0)))]
    facts = [("residual rms", number(document.get("residual_rms"), 3))]
    explained = document.get("explained")
    if explained is not None:
        facts.append(("variance explained", share(explained)))
    facts.append(("pixels used", _count(pixels.get("used", 0))))
    free = [e for e in (document.get("parameters") or {}).values() if e.get("free")]
    facts.append(("numbers fitted", str(len(free))))
    per_length = document.get("brightness_per_length")
    if per_length is not None:
        facts.append(("brightness per scene unit", number(per_length)))
    if document.get("loss", "linear") != "linear":
        facts.append(("robust loss", str(document["loss"]).replace("_", "-")))
    return facts


@dataclass(frozen=True)
class Panel:
    """One picture of a row."""

    title: str
    address: str
    alt: str
    box: str = ""
    """CSS place of the enlarged part, in percent of the picture."""


def _look_at(
    photo: np.ndarray | Photo, model: np.ndarray, used: np.ndarray, curve: ToneCurve, count: int
) -> dict[str, Any]:
    """Everything the picture sections need."""
    display = pictures.display_of(photo, curve)
    large, small = PICTURE_BYTES // count, DETAIL_BYTES // count
    with np.errstate(over="ignore", invalid="ignore"):
        at_used = photo[used] - model[used]
        limit = pictures.residual_limit(at_used.mean(axis=-1))
        channel_limit = pictures.residual_limit(at_used)
        mean = np.zeros(used.shape, np.float32)
        mean[used] = at_used.mean(axis=-1)
    del at_used
    window = pictures.zoom_window(model, used)
    height, width = used.shape
    box = ""
    zoom: list[Panel] = []
    if window is not None:
        box = (
            f"left:{100 * window.left / width:.2f}%;top:{100 * window.top / height:.2f}%;"
            f"width:{100 * window.width / width:.2f}%;height:{100 * window.height / height:.2f}%"
        )
        part = window.of
        zoom = [
            Panel("Photo", pictures.picture(part(photo), display, small), "photo, enlarged"),
            Panel("Model", pictures.picture(part(model), display, small), "model, enlarged"),
            Panel(
                "Photo − model",
                pictures.signed_picture(part(mean), part(used), limit, small),
                "signed residual, enlarged",
            ),
        ]
    main = [
        Panel("Photo", pictures.picture(photo, display, large), "photo", box),
        Panel("Model", pictures.picture(model, display, large), "fitted render", box),
        Panel(
            "Photo − model",
            pictures.signed_picture(mean, used, limit, large),
            "signed residual",
            box,
        ),
    ]
    channels = []
    for k, name in enumerate(("Red", "Green", "Blue")):
        with np.errstate(over="ignore", invalid="ignore"):
            residual = photo[..., k] - model[..., k]
        shown = pictures.signed_picture(residual, used, channel_limit, small, 600)
        channels.append(Panel(name, shown, f"signed residual, {name.lower()}"))
    return {
        "main": main,
        "zoom": zoom,
        "window": window,
        "channels": channels,
        "note": display.note,
        "limit": number(limit) if limit else None,
        "channel_limit": number(channel_limit) if channel_limit else None,
        "size": f"{width} × {height}",
        "pixelated": width < 400,
        "any_used": bool(used.any()),
        "fitted": True,
    }


def _look_at_photo(
    photo: np.ndarray | Photo, used: np.ndarray, curve: ToneCurve, count: int
) -> dict[str, Any]:
    """What the picture section needs of a photo that nothing was fitted to."""
    display = pictures.display_of(photo, curve)
    shown = pictures.picture(photo, display, PICTURE_BYTES // count)
    places = pictures.signed_picture(
        np.zeros(used.shape, np.float32), used, 0.0, PICTURE_BYTES // count
    )
    height, width = used.shape
    return {
        "main": [
            Panel("Photo", shown, "photo"),
            Panel("Pixels that could be used", places, "which pixels could be used"),
        ],
        "zoom": [],
        "note": display.note,
        "limit": None,
        "size": f"{width} × {height}",
        "pixelated": width < 400,
        "any_used": False,
        "fitted": False,
    }


def _influence(
    found: tuple[str, Float[AnyArray, "h w"]] | None,
    used: np.ndarray,
    shadowed: np.ndarray | None,
    count: int,
) -> dict[str, Any] | None:
    """Picture of an influence map, and in numbers where the say lies."""
    if found is None or not used.any():
        return None
    name, value = found[0], np.asarray(found[1], np.float32)
    sizes = np.abs(value[used].astype(np.float64))
    total = float(sizes.sum())
    if not 0 < total < math.inf:
        return None
    limit = pictures.residual_limit(value[used])
    few = np.searchsorted(np.cumsum(np.sort(sizes)[::-1]), total / 2) + 1
    dark = None
    if shadowed is not None and (used & shadowed).any() and (used & ~shadowed).any():
        dark = f"{100 * float(sizes[shadowed[used]].sum()) / total:.2g} %"
    address = pictures.signed_picture(
        value, used, limit, 2 * DETAIL_BYTES // count, colors=pictures.INFLUENCE
    )
    return {
        "name": name,
        "panel": Panel("Influence of each pixel", address, f"influence map of {name}"),
        "limit": number(limit, 2),
        "few": f"{100 * few / sizes.size:.2g} %",
        "dark": dark,
    }


def _weights(
    weights: Float[AnyArray, "h w"] | None, used: np.ndarray, count: int
) -> dict[str, Any] | None:
    """Picture of a robust loss's weights."""
    if weights is None or not used.any():
        return None
    value = np.asarray(weights, np.float32)
    known = value[used & np.isfinite(value)]
    if not known.size:
        return None
    address = pictures.weight_picture(value, used, 2 * DETAIL_BYTES // count)
    return {
        "panel": Panel("Belief in each pixel", address, "weights of the robust loss"),
        "doubted": f"{100 * float((known < 0.5).mean()):.2g} %",
    }


def _profile(
    photo: np.ndarray | Photo,
    model: np.ndarray,
    used: np.ndarray,
    height: Depth | None,
    shadowed: np.ndarray | None,
) -> dict[str, Any]:
    """The three charts in both themes, or why there are none."""
    if height is None:
        why = (
            "The layers come without a camera, so the height above the limb of each pixel is "
            "unknown."
        )
        return {"why": why}
    if not used.any():
        return {"why": "No pixel was used."}
    groups = {"all": used}
    if shadowed is not None and (used & shadowed).any() and (used & ~shadowed).any():
        groups = {"lit": used & ~shadowed, "in shadow": used & shadowed}
    found = pictures.profiles(photo, model, np.asarray(height), groups)
    if not found:
        return {"why": "No used pixel has a known height and finite light."}
    light = pictures.profile_pictures(found, "light")
    dark = pictures.profile_pictures(found, "dark")
    return {
        "why": "",
        "split": len(found) > 1,
        "groups": [(group.name, _count(group.pixels)) for group in found],
        "charts": [
            {"name": name, "light": bright, "dark": dim}
            for (name, bright), (_, dim) in zip(light, dark, strict=True)
        ],
    }


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
        "blocks": _count(errors.get("blocks") or 0),
        "samples": _count(samples),
        "effective": _count(round(errors.get("effective_samples") or 0)),
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
            "count": _count(n),
            "share": f"{100 * n / total:.2f}" if total else "0",
            "kind": kind,
        }
        for name, n, kind in rows
    ]


def _count(n: int) -> str:
    """With narrow no-break spaces between thousands."""
    return f"{n:,}".replace(",", "\u202f")
