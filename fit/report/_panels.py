"""The report's pictures of one photo, as its template reads them."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from model_jax import ToneCurve
from model_jax._shapes import AnyArray, Depth

from .._numbers import number
from ..photo._photo import Photo
from . import _pictures as pictures

PICTURE_BYTES = 600_000
"""PNG bytes of each of the three large pictures, shared by the photos; with the rest, base64 makes
under 5 MB."""
DETAIL_BYTES = 140_000
"""PNG bytes of each smaller picture, shared likewise."""


@dataclass(frozen=True)
class Panel:
    """One picture of a row."""

    title: str
    address: str
    alt: str
    box: str = ""
    """CSS place of the enlarged part, in percent of the picture."""


def fit_pictures(
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


def photo_pictures(
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


def influence_picture(
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


def weights_picture(
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


def profile_charts(
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
        "groups": [(group.name, grouped(group.pixels)) for group in found],
        "charts": [
            {"name": name, "light": bright, "dark": dim}
            for (name, bright), (_, dim) in zip(light, dark, strict=True)
        ],
    }


def grouped(n: int) -> str:
    """With narrow no-break spaces between thousands."""
    return f"{n:,}".replace(",", "\u202f")
