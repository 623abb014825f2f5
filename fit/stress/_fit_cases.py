"""Fits that are stiff or at an end of what can be asked, by name."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import islice
from math import isinf
from typing import Any

import numpy as np
from jaxtyping import Float

from model_jax import Layers, LayersLook, Look, Response, Scene, find_look, layer_widths

from .._compile import float64
from .._fit import fit
from ._fit_row import FitRow, intervals_off
from ._made import (
    NOISE,
    RADIUS,
    SEED,
    Made,
    Tell,
    changed,
    coded,
    layers_of,
    light_of,
    noisy,
    row_of,
    view,
)

AIR = find_look("air+density+saturation")
SHELL = 0.3
"""Of most scenes, planet radii."""
DISC = view((0.0, -3.0, 0.4), fov=55.0, shell=SHELL)
"""A planet and all its air, lit from the right."""

TRUTH = LayersLook(brightness=3.0, shadow=0.2, tint=np.array([0.8, 0.9, 1.3]), background=0.01)
START = LayersLook(brightness=1.0, shadow=0.5)
THIN = AIR(
    scale_height=0.1 * SHELL * RADIUS,
    extinction=np.array([6.0, 9.0, 14.0]),
    brightness=5.0,
    shadow=0.3,
    tint=np.array([0.8, 0.9, 1.3]),
    background=0.03,
)
THIN_START = AIR(scale_height=SHELL * RADIUS / 6)
FAR_OFF = 1e3
"""Typical sizes that stand for an end at infinity."""


def fit_rows(tell: Tell, every: int = 1) -> Iterator[FitRow]:
    """Every case, or one of so many, fitted and judged."""
    for made in islice(made_cases(), 0, None, every):
        tell(f"fit: {made.case}, {made.start.NAME}")
        yield row_of(made)
    if every == 1:
        tell("fit: photo in float32")
        yield same_in_float32()


def made_cases() -> Iterator[Made]:
    """The cases, one by one: photos are made when they are asked for."""
    yield from _few_dark()
    yield from _without_range()
    yield from _noises()
    yield from _starts(START, TRUTH)
    yield from _starts(THIN_START, THIN)
    yield from _flat()
    yield from _scale_heights()
    yield from _amounts()
    yield from _places()


def simple(case: str, truth: Look, scene: Scene = DISC, noise: float = NOISE, **more: Any) -> Made:
    """A noisy photo of a look in a scene, fitted from the usual start."""
    layers = _disc(type(truth)) if scene is DISC else layers_of(scene, truth)
    photo = noisy(light_of(layers, truth), noise)
    return Made(case, photo, layers, more.pop("start", _start(truth, scene)), truth, **more)


@cache
def _disc(kind: type[Look]) -> Layers:
    """Layers of most cases."""
    return layers_of(DISC, kind())


def _start(truth: Look, scene: Scene) -> Look:
    if isinstance(truth, LayersLook):
        return START
    return type(truth)(scale_height=float(scene.atmosphere.height) / 6)


def _few_dark() -> Iterator[Made]:
    """Shadow in few pixels, in all alike, in none."""
    layers = _disc(LayersLook)
    photo = noisy(light_of(layers, TRUTH))
    _, dark = _widths(layers)
    seen = np.flatnonzero((dark > 0) & (np.asarray(layers.planet) == 0))
    for case, some in (
        ("shadow in 10 pixels", seen[:: len(seen) // 10][:10]),
        ("shadow in 1 pixel", seen[len(seen) // 2 :][:1]),
        ("shadow in 3 pixels side by side", seen[len(seen) // 2 :][:3]),
    ):
        few = photo.copy()
        few.reshape(-1, 3)[np.setdiff1d(np.flatnonzero(dark > 0), some)] = np.nan
        yield Made(case, few, layers, START, TRUTH)
    width = np.random.default_rng(SEED).uniform(0.05, 0.3, np.shape(layers.front))
    alike = Layers(np.zeros_like(width), width, 0.6 * width, width)
    photo = noisy(light_of(alike, TRUTH))
    yield Made("widths proportional", photo, alike, START, TRUTH)
    for truth in (TRUTH, THIN):
        yield simple("no shadow", truth, view((0.0, -3.0, 0.4), sun=None, fov=55.0, shell=SHELL))


def _widths(layers: Layers) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    with float64():
        lit, dark = layer_widths(layers)
    return np.asarray(lit), np.zeros_like(lit) if dark is None else np.asarray(dark)


def _without_range() -> Iterator[Made]:
    """White or black all over, as codes and as light; and nearly so."""
    for truth, start in ((TRUTH, START), (THIN, THIN_START)):
        layers = _disc(type(truth))
        shape = (*np.shape(layers.front), 3)
        for name, level in (("white", 255), ("black", 0)):
            codes = np.full(shape, level, np.uint8)
            yield Made(f"all {name}, codes", coded(codes), layers, start, truth)
            yield Made(f"all {name}, light", codes / 255.0, layers, start, truth)
        clean = light_of(layers, truth)
        ring = np.asarray(layers.has_air) & (np.asarray(layers.planet) == 0)
        for case, measured in (("most of it white, codes", 0.1), ("one pixel not white", 1e-3)):
            # As bright as it takes to clip all but that share of the samples in the air.
            factor = 1 / float(np.quantile(clean[ring], measured))
            numbers = {n: factor * getattr(truth, n) for n in ("brightness", "background")}
            codes = np.round(255 * np.clip(noisy(factor * clean, 2e-3), 0, 1)).astype(np.uint8)
            yield Made(case, coded(codes), layers, start, changed(truth, **numbers))


def _flat() -> Iterator[Made]:
    """A tone curve where light is nearly equal, and one that is flat itself."""
    width = np.random.default_rng(SEED).uniform(0.1999, 0.2001, (48, 64))
    even = Layers(np.zeros_like(width), width)
    free = ("brightness", "tint", "gamma")
    truth, response = changed(TRUTH, background=0.0), Response(gamma=1.2)
    photo = noisy(light_of(even, truth, response), 1e-4)
    yield Made(
        "gamma, light nearly equal", photo, even, START, truth, {"free": free}, response=response
    )
    layers = _disc(LayersLook)
    response = Response(exposure=1e3, gamma=10.0)
    photo = noisy(light_of(layers, TRUTH, response), 1e-3)
    near = Response(exposure=1e3, gamma=9.0)
    both = {"response": near, "free": ("brightness", "shadow", "tint", "gamma")}
    for name, settings in (("gamma", both), ("look", {"response": response})):
        case = f"flat tone curve, {name} free"
        yield Made(case, photo, layers, START, TRUTH, settings, response=response)


def _scale_heights() -> Iterator[Made]:
    """Of next to nothing, and of far more than there is air."""
    shell = SHELL * RADIUS
    pixel = 3 * RADIUS * float(DISC.camera.pixel_size())
    for name, height in (
        ("a thousandth of a pixel", 1e-3 * pixel),
        ("a tenth of a pixel", 0.1 * pixel),
        ("ten shells", 10 * shell),
        ("a thousand shells", 1e3 * shell),
    ):
        yield simple(f"scale height of {name}", changed(THIN, scale_height=height))


def _amounts() -> Iterator[Made]:
    """Hardly any air, far too much, and light of any size."""
    for name, factor in (("a thousand times denser", 1e3), ("optical depth of 1e-6", 1e-6)):
        yield simple(name, changed(THIN, extinction=factor * THIN.extinction))
    for factor in (1e-6, 1e6):
        for truth in (TRUTH, THIN):
            scaled = {n: factor * getattr(truth, n) for n in ("brightness", "background")}
            yield simple(f"light × {factor:g}", changed(truth, **scaled))


def _noises() -> Iterator[Made]:
    """None, as much as there is light, and outliers."""
    for truth in (TRUTH, THIN):
        yield simple("no noise", truth, noise=0.0)
        yield simple("noise as large as the light", truth, noise=1.0)
    layers = _disc(LayersLook)
    photo = noisy(light_of(layers, TRUTH))
    rng = np.random.default_rng(SEED)
    out = rng.random(photo.shape[:2]) < 0.2
    photo[out] += rng.uniform(0.5, 2.0, (int(out.sum()), 1)) * photo.max()
    for loss in ("huber", "soft_l1", "cauchy"):
        case = f"one pixel of five sticks out, {loss}"
        yield Made(case, photo, layers, START, TRUTH, {"loss": loss})


def _places() -> Iterator[Made]:
    """Where a camera can hardly be, and pictures of one row and of one pixel."""
    touch = (0.0, -1 / 1.5, float(np.sqrt(1 - 1.5**-2)))  # of a tangent from 1.5 radii
    scenes = {
        "a row of pixels": view((0.0, -3.0, 0.4), fov=2.0, shell=SHELL, size=(96, 1)),
        "one pixel": view((0.0, -3.0, 0.0), (0.0, 0.0, 1.04), fov=1.0, shell=SHELL, size=(1, 1)),
        "a million radii away": view((1e6, 0.0, 0.0), fov=1.7e-4, shell=SHELL),
        "in the air": view((0.0, -1.1, 0.0), (1.0, -1.0, 0.3), fov=70.0, shell=SHELL),
        "on the ground": view((0.0, -1.0, 0.0), (1.0, -1.2, 0.3), fov=70.0, shell=SHELL),
        "a shell of 1e-6": view((0.0, -1.5, 0.0), touch, fov=3e-4, shell=1e-6),
    }
    for case, scene in scenes.items():
        shell = float(scene.atmosphere.height)
        layers = layers_of(scene, THIN)
        lit, dark = _widths(layers)
        longest = max(float((lit + dark).max()), 1e-30)
        bright = {"brightness": 1 / longest, "background": 0.01}
        yield simple(case, changed(TRUTH, **bright), scene)
        dim = {"extinction": np.array([0.5, 1.0, 2.0]) / longest, "scale_height": shell / 4}
        yield simple(case, changed(THIN, **bright, **dim), scene)


def _starts(start: Look, truth: Look) -> Iterator[Made]:
    """From either end of each parameter's range; of a factor of mean one, one channel there."""
    layers = _disc(type(truth))
    photo = noisy(light_of(layers, truth))
    for name, about in type(start).PARAMETERS.items():
        for end, bound in (("least", about.lower), ("most", about.upper)):
            value = float(np.sign(bound) * FAR_OFF * about.scale) if isinf(bound) else bound
            given: Any = value
            if about.mean_one:
                given = np.array([value, (3 - value) / 2, (3 - value) / 2])
            elif np.ndim(getattr(start, name)):
                given = np.full(3, value)
            yield Made(
                f"{name} starts at its {end}, {value:g}",
                photo,
                layers,
                changed(start, **{name: given}),
                truth,
                untraced="a start among many",
            )


def same_in_float32() -> FitRow:
    """A photo in float32 tells what it does in float64: a thousandth of an interval is the most
    that its rounding may move a value."""
    made = simple("photo in float32", THIN)
    narrow = replace(made, photo=np.asarray(made.photo, np.float32))
    row = row_of(narrow)
    ends = [fit(m.photo, m.layers, m.start, sampling="point") for m in (made, narrow)]
    wide, small = (end.parameters for end in ends)
    off = max(intervals_off(e, small[n].value) for n, e in wide.items() if e.interval is not None)
    if ends[0].verdict == ends[1].verdict and off < 1e-3:
        return row
    return replace(row, kept=False).noted(f"{off:.2g} intervals beside the fit in float64")
