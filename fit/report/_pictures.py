"""Pictures of a report: photo and model, signed maps, the window worth enlarging, charts.

Arrays in, PNG data addresses out (`data:image/png;base64,…`); what they mean and where they stand
on the page is `_report`'s. Every function takes whatever a photo can be: one pixel, NaN, nothing
used. Photos may be large, so nothing here makes a float64 copy of a whole one, and colours are
treated one channel at a time. Nothing touches matplotlib's global state.
"""

import base64
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image

from model_jax import Linear, Srgb, ToneCurve

from .._numbers import curve_in_words
from ..photo._photo import Photo

MAX_WIDTH = 1200
"""Pixels across a picture at most: what a wide screen shows of it enlarged."""
RESIDUAL, INFLUENCE, WEIGHT = "RdBu_r", "PuOr_r", "cividis"
"""Colour maps: two signed ones, white at zero, told apart by their colours; one from 0 to 1."""
_LEVELS = 101
"""Colours of a map; odd, so that zero has its own. A palette of 101 halves the PNG."""
_HATCH = ((126, 130, 138), (142, 146, 154))
"""Two greys that no map has, for pixels of which nothing is shown."""
_CHANNELS = (("red", "#d64550"), ("green", "#2a9d5c"), ("blue", "#3f83e0"))
_CURVE = "#9a7bd0"
_INK = {"light": "#3c4657", "dark": "#aab4c3"}
_BINS = 40
"""Height bins of a profile at most; rings thinner than 40 pixels sample them at all phases."""


@dataclass(frozen=True)
class Display:
    """How linear light is shown; the same for photo and model."""

    curve: ToneCurve
    scale: float
    """Factor on linear light before the curve."""
    note: str
    """In words."""

    def codes(self, linear: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
        """8-bit codes of one channel; NaN is black, light above the range white."""
        shown = np.clip(np.asarray(self.curve.encode(_in_range(linear) * self.scale)), 0.0, 1.0)
        return np.round(np.nan_to_num(shown) * 255).astype(np.uint8)


def display_of(photo: Float[np.ndarray, "h w 3"] | Photo, curve: ToneCurve) -> Display:
    """The photo's own tone curve; linear photos are shown through sRGB, which screens expect, and
    scaled when their light goes beyond 1 or stays below 0.1."""
    if not isinstance(curve, Linear):
        name = "tone curve sRGB" if isinstance(curve, Srgb) else curve_in_words(curve.describe())
        return Display(curve, 1.0, name)
    # Every so many pixels tell as much: a million of them.
    some = photo[:: max(1, photo.shape[0] // 1000), :: max(1, photo.shape[1] // 1000)]
    finite = some[np.isfinite(some)]
    # A few glints may clip; the highest of the other 99.9 % becomes white.
    top = float(np.percentile(finite, 99.9)) if finite.size else 1.0
    if top <= 0 or 0.1 <= top <= 1:
        return Display(Srgb(), 1.0, "linear light, shown through sRGB")
    scale = float(f"{1 / top:.2g}")
    return Display(Srgb(), scale, f"linear light × {scale:g}, shown through sRGB")


def picture(linear: Float[np.ndarray, "h w 3"] | Photo, display: Display, budget: int) -> str:
    """A picture as PNG, averaged over areas of linear light to at most `MAX_WIDTH` and `budget`
    bytes."""

    def draw(width: int, height: int) -> Image.Image:
        planes = [
            display.codes(_shrink(_in_range(linear[..., k]), width, height)) for k in range(3)
        ]
        return Image.fromarray(np.stack(planes, axis=-1))

    return _within(draw, linear.shape[1], linear.shape[0], MAX_WIDTH, budget)


def residual_limit(residual: Float[np.ndarray, "n *c"]) -> float:
    """End of the colour scale: 99 % of the numbers lie within ± it, rounded up to two digits; 0
    when there is nothing to show."""
    sizes = np.abs(residual)
    sizes = sizes[np.isfinite(sizes)]
    limit = float(np.percentile(sizes, 99)) if sizes.size else 0.0
    if limit <= 0:
        return 0.0
    step = 10.0 ** (math.floor(math.log10(limit)) - 1)
    return float(f"{math.ceil(limit / step) * step:.2g}")


def signed_picture(
    value: Float[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    limit: float,
    budget: int,
    max_width: int = MAX_WIDTH,
    colors: str = RESIDUAL,
) -> str:
    """A signed map, from -limit to limit, white at 0; pixels that were not used are hatched.

    A shrunk pixel shows the mean of the used ones in it, so that a thin ring stays visible.
    """
    span = limit if limit > 0 else 1.0
    return _map(value, used, (-span, span), budget, max_width, colors)


def weight_picture(
    weight: Float[np.ndarray, "h w"], used: Bool[np.ndarray, "h w"], budget: int
) -> str:
    """A map from 0 (dark) to 1 (bright), as `signed_picture` otherwise."""
    return _map(weight, used, (0.0, 1.0), budget, MAX_WIDTH, WEIGHT)


def color_stops(colors: str = RESIDUAL) -> str:
    """A map's colours as stops of a CSS gradient, from its lowest to its highest."""
    picked = _palette(colors)[:: (_LEVELS - 1) // 10]
    return ", ".join("#" + bytes(color).hex() for color in picked.tolist())


@dataclass(frozen=True)
class Window:
    """A part of a picture, in pixels."""

    top: int
    left: int
    height: int
    width: int

    def of(self, image: np.ndarray | Photo) -> np.ndarray:
        return image[self.top : self.top + self.height, self.left : self.left + self.width]


def zoom_window(model: Float[np.ndarray, "h w 3"], used: Bool[np.ndarray, "h w"]) -> Window | None:
    """The part worth showing pixel by pixel: where the model varies most over used pixels.

    That is where bright and dark air meet (the terminator on the limb, else the brightest limb).
    The window is twelve times as high as the used area is thick, within 36 to 180 pixels; None
    when the picture is hardly larger than that, or nothing was used.
    """
    height, width = used.shape
    if not used.any():
        return None
    # A strip of thickness t has two edge pixels for every t.
    inner = used.copy()
    inner[1:] &= used[:-1]
    inner[:-1] &= used[1:]
    inner[:, 1:] &= used[:, :-1]
    inner[:, :-1] &= used[:, 1:]
    thickness = 2 * used.sum() / max(1, used.sum() - inner.sum())
    rows = round(min(max(12 * thickness, 36), 180))
    columns = rows * 4 // 3
    if rows > 0.6 * height or columns > 0.6 * width:
        return None
    # Sums over blocks of the window's sixth, then over all windows of 6×6 blocks.
    block = rows // 6
    light = model.mean(axis=-1, dtype=np.float32)
    light[~used] = 0
    np.nan_to_num(light, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
    count, first = _window_sums(used, block, 6, 8), _window_sums(light, block, 6, 8)
    second = _window_sums(np.square(light, out=light), block, 6, 8)
    spread = second - first**2 / np.maximum(count, 1)
    top, left = np.unravel_index(int(np.argmax(spread)), spread.shape)
    return Window(
        min(int(top) * block, height - rows), min(int(left) * block, width - columns), rows, columns
    )


@dataclass(frozen=True)
class Profile:
    """Mean light against height over one group of pixels, bins without pixels left out."""

    name: str
    height: Float[np.ndarray, " n"]
    photo: Float[np.ndarray, "n 3"]
    spread: Float[np.ndarray, "n 3"]
    """Standard deviation of the photo within the bin."""
    model: Float[np.ndarray, "n 3"]
    pixels: int


def profiles(
    photo: Float[np.ndarray, "h w 3"] | Photo,
    model: Float[np.ndarray, "h w 3"],
    height: Float[np.ndarray, "h w"],
    groups: dict[str, Bool[np.ndarray, "h w"]],
) -> list[Profile]:
    """Profiles of the groups that have pixels of known height and finite light."""
    found = []
    for name, group in groups.items():
        chosen = group & np.isfinite(height)
        seen, made, tall = photo[chosen], model[chosen], height[chosen]
        finite = np.isfinite(seen).all(axis=-1) & np.isfinite(made).all(axis=-1)
        if not finite.all():  # copies of a large photo's light are spared
            seen, made, tall = seen[finite], made[finite], tall[finite]
        if len(tall):
            found.append(_profile(name, seen, made, tall))
    return found


def profile_pictures(found: list[Profile], theme: str) -> list[tuple[str, str]]:
    """One chart a channel, (name, PNG address): photo as dots with its spread, model as line."""
    return [(name, _profile_chart(found, k, theme)) for k, (name, _) in enumerate(_CHANNELS)]


def history_picture(history: Sequence[float], theme: str) -> str:
    """Square sum after each step, on a logarithmic axis."""
    ink = _INK[theme]
    figure = Figure(figsize=(6.2, 2.9), dpi=180, layout="constrained")
    figure.patch.set_alpha(0)
    axes = figure.subplots()
    axes.plot(range(len(history)), history, "o-", color=_CURVE, markersize=4, linewidth=1.6)
    axes.set_yscale("log")
    # A start that was the end already is a flat line, not its rounding enlarged.
    if max(history) < 2 * min(history):
        axes.set_ylim(min(history) / 2, max(history) * 2)
    axes.set_xlabel("step", fontsize=9, color=ink)
    axes.set_ylabel("square sum", fontsize=9, color=ink)
    _style(axes, ink)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.tick_params(which="minor", colors=ink, labelsize=8.5, length=2)
    return _figure_png(figure)


def _profile(
    name: str,
    photo: Float[np.ndarray, "n 3"],
    model: Float[np.ndarray, "n 3"],
    height: Float[np.ndarray, " n"],
) -> Profile:
    low, high = float(height.min()), float(height.max())
    bins = int(np.clip(math.sqrt(height.size) / 2, 1, _BINS))
    place = np.zeros(height.size, dtype=np.intp)
    if high > low:
        place = np.minimum(((height - low) / (high - low) * bins).astype(np.intp), bins - 1)
    count = np.bincount(place, minlength=bins)
    kept = count > 0

    def mean(values: np.ndarray) -> np.ndarray:
        sums = np.bincount(place, values.astype(np.float64), minlength=bins)
        return sums[kept] / count[kept]

    photo_mean = np.stack([mean(photo[:, k]) for k in range(3)], axis=-1)
    all_means = np.zeros((bins, 3))
    all_means[kept] = photo_mean
    spread = np.sqrt(
        np.stack([mean((photo[:, k] - all_means[place, k]) ** 2) for k in range(3)], axis=-1)
    )
    model_mean = np.stack([mean(model[:, k]) for k in range(3)], axis=-1)
    return Profile(name, mean(height), photo_mean, spread, model_mean, int(height.size))


def _profile_chart(found: list[Profile], channel: int, theme: str) -> str:
    ink, (_, color) = _INK[theme], _CHANNELS[channel]
    figure = Figure(figsize=(4.4, 4.1), dpi=180, layout="constrained")
    figure.patch.set_alpha(0)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    styles = [("-", color, "full"), ("--", color, "none")]
    for group, (line, fill, marker) in zip(found, styles, strict=False):
        suffix = "" if len(found) == 1 else f", {group.name}"
        x, y, e = group.height, group.photo[:, channel], group.spread[:, channel]
        upper.fill_between(x, y - e, y + e, color=fill, alpha=0.16, linewidth=0)
        upper.plot(x, y, "o", color=fill, fillstyle=marker, markersize=4, label=f"photo{suffix}")
        upper.plot(
            x, group.model[:, channel], line, color=ink, linewidth=1.6, label=f"model{suffix}"
        )
        lower.plot(
            x, y - group.model[:, channel], f"o{line}", color=fill, fillstyle=marker,
            markersize=3, linewidth=0.9,
        )  # fmt: skip
    lower.axhline(0, color=ink, linewidth=0.9, alpha=0.6)
    lower.set_xlabel("height above the limb, scene units", fontsize=9, color=ink)
    upper.set_ylabel("linear light", fontsize=9, color=ink)
    lower.set_ylabel("photo − model", fontsize=9, color=ink)
    if any(group.height.min() < 0 for group in found):
        upper.axvline(0, color=ink, linewidth=0.8, alpha=0.5)
    upper.legend(frameon=False, fontsize=9, labelcolor=ink)
    for axes in (upper, lower):
        _style(axes, ink)
    return _figure_png(figure)


def _style(axes: Axes, ink: str) -> None:
    axes.set_facecolor("none")
    axes.grid(True, color=ink, alpha=0.16, linewidth=0.7)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(ink)
    axes.spines[["left", "bottom"]].set_alpha(0.5)
    axes.tick_params(colors=ink, labelsize=8.5, length=3)
    if axes.get_yscale() == "linear":
        axes.locator_params(axis="y", nbins=5 if axes.get_ylabel() == "linear light" else 3)


def _figure_png(figure: Figure) -> str:
    stream = io.BytesIO()
    FigureCanvasAgg(figure).print_png(stream)
    image = Image.open(io.BytesIO(stream.getvalue()))
    # Few colours: a palette with alpha is a third of the size.
    return _address(image.quantize(128, method=Image.Quantize.FASTOCTREE))


def _map(
    value: Float[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    span: tuple[float, float],
    budget: int,
    max_width: int,
    colors: str,
) -> str:
    """A picture in a palette of colours, hatched where nothing was used."""
    told = used & np.isfinite(value)
    shown = np.where(told, value, np.float32(0))
    low, high = span

    def draw(width: int, height: int) -> Image.Image:
        share = _shrink(told, width, height)
        mean = _shrink(shown, width, height) / np.where(share > 0, share, 1.0)
        level = np.clip((mean - low) / (high - low), 0, 1) * (_LEVELS - 1)
        rows, columns = np.indices(share.shape)
        stripe = (rows + columns) // max(2, width // 150) % 2
        index = np.where(share > 1e-6, np.round(level), _LEVELS + stripe).astype(np.uint8)
        image = Image.fromarray(index)
        image.putpalette([*_palette(colors).ravel().tolist(), *_HATCH[0], *_HATCH[1]])
        return image

    return _within(draw, value.shape[1], value.shape[0], max_width, budget)


def _in_range(light: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Light without NaN and Inf: 1e6 is white through every curve, and safe from overflow."""
    known = np.nan_to_num(light, nan=0.0, posinf=1e6, neginf=0.0)
    return np.clip(known, 0.0, 1e6, out=known)


def _palette(colors: str) -> UInt8[np.ndarray, "levels 3"]:
    rgb = colormaps[colors](np.linspace(0, 1, _LEVELS))[:, :3]
    return np.round(rgb * 255).astype(np.uint8)


def _shrink(
    plane: Float[np.ndarray, "h w"] | Bool[np.ndarray, "h w"], width: int, height: int
) -> Float[np.ndarray, "h2 w2"]:
    """Area means; the plane itself, as floats, when it has that size."""
    plane = np.ascontiguousarray(plane, dtype=np.float32)
    if plane.shape == (height, width):
        return plane
    return np.asarray(Image.fromarray(plane).resize((width, height), Image.Resampling.BOX))


def _within(
    draw: Callable[[int, int], Image.Image], width: int, height: int, max_width: int, budget: int
) -> str:
    """The largest drawing of at most `max_width` pixels across and about `budget` bytes of PNG."""
    # Tall pictures count by area, as the page's budget does.
    factor = min(1.0, max_width / width, max_width / math.sqrt(width * height) * 1.2)
    while True:
        size = max(1, round(width * factor)), max(1, round(height * factor))
        stream = io.BytesIO()
        draw(*size).save(stream, "PNG", optimize=True)
        if stream.tell() <= budget or size == (1, 1):
            return _encoded(stream.getvalue())
        # A PNG's size goes with its area; 0.95 so that one more round nearly always suffices.
        factor *= 0.95 * math.sqrt(budget / stream.tell())


def _window_sums(
    values: Float[np.ndarray, "h w"] | Bool[np.ndarray, "h w"], block: int, rows: int, columns: int
) -> Float[np.ndarray, "a b"]:
    """Sums over all windows of rows × columns blocks that begin at a block."""
    height, width = (side // block * block for side in values.shape)
    blocks = values[:height, :width].reshape(height // block, block, width // block, block)
    total = np.zeros((height // block + 1, width // block + 1))
    sums = blocks.sum(axis=(1, 3), dtype=np.float64)
    total[1:, 1:] = sums.cumsum(axis=0).cumsum(axis=1)
    below, right = total[rows:], total[:-rows]
    return below[:, columns:] - below[:, :-columns] - right[:, columns:] + right[:, :-columns]


def _address(image: Image.Image) -> str:
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=True)
    return _encoded(stream.getvalue())


def _encoded(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
