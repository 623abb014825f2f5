"""The report of a fit: one self-contained HTML page, made from what fit.json says.

The page asks for nothing from outside: pictures are data addresses, there is no script, and a
content security policy holds it to that. Pictures come from `_pictures`, the page's text from
`templates/report.html`; here numbers become words.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from model_jax import ToneCurve
from model_jax._shapes import Depth, Mask, Rgb

from . import _pictures as pictures
from ._result import WELL_EXPLAINED

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
"""PNG bytes of each of the three large pictures; with the rest, base64 makes under 4 MB."""
DETAIL_BYTES = 140_000
"""PNG bytes of each smaller picture."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_STEPS = ("render", "reduce", "solve", "report")


def report_html(
    document: dict[str, Any],
    photo: Rgb,
    picture: Rgb,
    used: Mask,
    height: Depth | None,
    tone_curve: ToneCurve,
    command: str,
    *,
    shadowed: Mask | None = None,
) -> str:
    """The report as HTML text.

    Args:
        document: the contents of fit.json; what is missing there is missing here.
        photo: linear light; NaN and Inf may occur.
        picture: the fitted composite, linear light.
        used: pixels that took part in the fit.
        height: height above the limb of each pixel's line of sight, scene units; NaN where it is
            not known, None where it is known nowhere.
        tone_curve: the photo's; photo and picture are shown through it.
        command: what was run, verbatim.
        shadowed: pixels whose air is mostly in shadow; they get a limb profile of their own.
    """
    light, model = np.asarray(photo), np.asarray(picture)
    mask = np.asarray(used)
    shade = None if shadowed is None else np.asarray(shadowed)
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
        source=document.get("scene") or document.get("layers") or "—",
        facts=_facts(document),
        look=_look_at(light, model, mask, tone_curve),
        profile=_profile(light, model, mask, height, shade),
        parameters=[_row(name, e) for name, e in (document.get("parameters") or {}).items()],
        correlation=_correlation(document.get("correlation")),
        times=_times(document.get("seconds") or {}),
        left_out=document.get("left_out") or [],
        pixels=_pixel_rows(document.get("pixels") or {}),
        versions=document.get("versions") or {},
        command=command,
    )


def measured(value: float | None, stderr: float | None) -> str:
    """`value ± stderr` with two significant digits of the error: `3.0012 ± 0.0034`."""
    if value is None or not math.isfinite(value):
        return "—"
    if stderr is None or not math.isfinite(stderr) or stderr <= 0:
        return number(value)
    decimals = 1 - math.floor(math.log10(stderr))
    size = max(abs(value), stderr)
    if 1e-3 <= size < 1e6 and decimals <= 9:
        shown = max(decimals, 0)
        pair = round(value, decimals), round(stderr, decimals)
        return f"{pair[0]:.{shown}f} ± {pair[1]:.{shown}f}".replace("-", "−")
    exponent = math.floor(math.log10(size))
    decimals = max(0, exponent + decimals)
    if decimals > 9:
        return f"{value:.10g} ± {stderr:.1e}".replace("-", "−")
    scale = 10.0**exponent
    pair_text = f"({value / scale:.{decimals}f} ± {stderr / scale:.{decimals}f})"
    return f"{pair_text} · 10{str(exponent).translate(_SUPERSCRIPTS)}".replace("-", "−")


def number(value: float | None, digits: int = 4) -> str:
    """A number for people; `—` for none."""
    if value is None or not math.isfinite(value):
        return "—"
    text = f"{value:.{digits}g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        text = f"{mantissa} · 10{str(int(exponent)).translate(_SUPERSCRIPTS)}"
    return text.replace("-", "−")


def _facts(document: dict[str, Any]) -> list[tuple[str, str]]:
    """The few numbers under the verdict."""
    pixels = document.get("pixels") or {}
    facts = [("residual rms", number(document.get("residual_rms"), 3))]
    explained = document.get("explained")
    if explained is not None:
        # Rounded down, as in the message: nothing short of all is 100 %.
        share = math.floor(explained * 1e4) / 100
        facts.append(("variance explained", f"{share:.4g} %".replace("-", "−")))
    facts.append(("pixels used", _count(pixels.get("used", 0))))
    free = [e for e in (document.get("parameters") or {}).values() if e.get("free")]
    facts.append(("numbers fitted", str(len(free))))
    per_length = document.get("brightness_per_length")
    if per_length is not None:
        facts.append(("brightness per scene unit", number(per_length)))
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
    photo: np.ndarray, model: np.ndarray, used: np.ndarray, curve: ToneCurve
) -> dict[str, Any]:
    """Everything the picture sections need."""
    display = pictures.display_of(photo, curve)
    with np.errstate(over="ignore", invalid="ignore"):
        residual = photo.astype(np.float32) - model.astype(np.float32)
        mean = residual.mean(axis=-1)
    limit = pictures.residual_limit(mean, used)
    window = pictures.zoom_window(model, used)
    height, width = used.shape
    box = ""
    zoom: list[Panel] = []
    if window is not None:
        box = (
            f"left:{100 * window.left / width:.2f}%;top:{100 * window.top / height:.2f}%;"
            f"width:{100 * window.width / width:.2f}%;height:{100 * window.height / height:.2f}%"
        )
        part, small = window.of, DETAIL_BYTES
        zoom = [
            Panel("Photo", pictures.picture(part(photo), display, small), "photo, enlarged"),
            Panel("Model", pictures.picture(part(model), display, small), "model, enlarged"),
            Panel(
                "Photo − model",
                pictures.residual_picture(part(mean), part(used), limit, small),
                "signed residual, enlarged",
            ),
        ]
    large = PICTURE_BYTES
    main = [
        Panel("Photo", pictures.picture(photo, display, large), "photo", box),
        Panel("Model", pictures.picture(model, display, large), "fitted render", box),
        Panel(
            "Photo − model",
            pictures.residual_picture(mean, used, limit, large),
            "signed residual",
            box,
        ),
    ]
    channel_limit = pictures.residual_limit(residual, used)
    channels = [
        Panel(
            name,
            pictures.residual_picture(residual[..., k], used, channel_limit, DETAIL_BYTES, 600),
            f"signed residual, {name.lower()}",
        )
        for k, name in enumerate(("Red", "Green", "Blue"))
    ]
    return {
        "main": main,
        "zoom": zoom,
        "window": window,
        "channels": channels,
        "note": display.note,
        "limit": number(limit) if limit else None,
        "channel_limit": number(channel_limit) if channel_limit else None,
        "stops": pictures.color_stops(),
        "size": f"{width} × {height}",
        "pixelated": width < 400,
        "any_used": bool(used.any()),
    }


def _profile(
    photo: np.ndarray,
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
    stderr, free = estimate.get("stderr"), bool(estimate.get("free"))
    state = "fitted" if free and stderr is not None else "no error" if free else "held"
    return {
        "name": name,
        "value": measured(estimate.get("value"), stderr if free else None),
        "initial": number(estimate.get("initial")),
        "bounds": _bounds(estimate.get("bounds")),
        "unit": str(estimate.get("unit") or "").replace("_", " "),
        "state": state,
        "quantisation": number(estimate.get("quantisation_bound"), 2),
    }


def _bounds(bounds: Any) -> str:
    low, high = bounds or (None, None)
    if low is None and high is None:
        return "none"
    if high is None:
        return f"≥ {number(low)}"
    return f"≤ {number(high)}" if low is None else f"{number(low)} … {number(high)}"


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
            "color": k % 4,
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
