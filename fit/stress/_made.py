"""Photos that are made with a known look, and their fits."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    Look,
    Planet,
    Response,
    Scene,
    Sun,
    analytic_layers,
    composite,
    record,
)
from model_jax._tone import Linear

from .._compile import float64
from .._fit import fit
from .._result import FitResult
from .._verdict import Verdict
from ..photo._photo import Photo
from ..photo._read import _code_tables
from ..solve._declare import declare
from ._fit_row import FitRow, judge_fit, without_result

RADIUS = 6371.0
"""Of the planet: lengths are Earth's in kilometres, which the looks' defaults are in."""

SIZE = (64, 48)
"""Width and height of most pictures, so that their programs are compiled once."""

NOISE = 0.01
"""Of most photos, of their brightest light."""

SEED = 20261129

Three = tuple[float, float, float] | Float[np.ndarray, "3"]

Tell = Callable[[str], None]
"""Says in a line how far the work is."""


@dataclass(frozen=True)
class Made:
    """A photo, what it was made with, and how it is fitted."""

    case: str
    """In words."""
    photo: Float[np.ndarray, "h w 3"] | Photo
    layers: Layers
    start: Look
    truth: Look
    settings: Mapping[str, Any] = field(default_factory=dict)
    """Of `fit`, besides photo, layers, look and sampling."""
    response: Response = field(default_factory=Response)
    """What the photo was made with."""
    untraced: str = ""
    """Why it is not fitted in float32; empty: it is."""

    @property
    def known(self) -> dict[str, float]:
        """What the photo was made with, by the names of results."""
        return {p.name: float(p.value) for p in declare(self.truth, [self.response])}

    @property
    def asked(self) -> list[str]:
        """Names of what is to be fitted."""
        free = self.settings.get("free")
        found = declare(self.start, [self.settings.get("response", Response())], free=free)
        return [p.name for p in found if p.role == "free"]


def view(
    place: Three,
    target: Three = (0.0, 0.0, 0.0),
    sun: Three | None = (1.0, 0.3, 0.2),
    *,
    fov: float,
    shell: float,
    size: tuple[int, int] = SIZE,
    albedo: tuple[float, float, float] | None = None,
) -> Scene:
    """A scene; place, target and the shell's thickness in planet radii, the field of view in
    degrees. Clip planes lie just outside of the air, or right before a camera in it."""
    at, aim = np.array(place), np.array(target)
    forward = aim - at
    turned = abs(forward[2]) > 0.9 * np.linalg.norm(forward)
    distance = float(np.linalg.norm(at))
    near = max(distance - 1.5 - shell, 1e-3 * max(distance - 1, 1e-3 * shell))
    return Scene(
        camera=Camera(
            position=at * RADIUS,
            forward=forward / np.linalg.norm(forward),
            up=(0.0, 1.0, 0.0) if turned else (0.0, 0.0, 1.0),
            fov_y_deg=fov,
            width=size[0],
            height=size[1],
            near=near * RADIUS,
            far=(distance + 1.5 + shell) * RADIUS,
        ),
        planet=Planet(radius=RADIUS, albedo=albedo),
        atmosphere=Atmosphere(height=shell * RADIUS),
        sun=None if sun is None else Sun(direction=sun),
    )


def changed(look: Look, **numbers: Any) -> Look:
    """The look with other numbers, of a kind that is only known when it runs."""
    given: Any = look
    other: Look = replace(given, **numbers)
    return other


def layers_of(scene: Scene, look: Look) -> Layers:
    """In float64, as NumPy's arrays."""
    with float64():
        return jax.tree.map(np.asarray, analytic_layers(scene, np.float64, look))


def light_of(
    layers: Layers,
    look: Look,
    response: Response = Response(),  # noqa: B008 (a frozen record)
) -> Float[np.ndarray, "h w 3"]:
    """What a photo without noise shows, float64."""
    with float64():
        light = np.asarray(composite(layers, look), np.float64)[..., :3]
        return np.asarray(record(light, response), np.float64)


def noisy(
    light: Float[np.ndarray, "h w 3"], noise: float = NOISE, seed: int = SEED
) -> Float[np.ndarray, "h w 3"]:
    """With normal noise, as a share of the brightest light."""
    rng = np.random.default_rng(seed)
    return light + rng.normal(scale=noise * np.abs(light).max(), size=light.shape)


def coded(codes: UInt8[np.ndarray, "h w 3"]) -> Photo:
    """A photo of 8-bit codes that are linear light, as if it had been read from a file."""
    light, half_steps = _code_tables(Linear(), 8)
    return Photo(
        path=Path("made.png"),
        stored=codes,
        reason=np.zeros(codes.shape[:2], np.uint8),
        tone_curve=Linear(),
        bits=8,
        light=light,
        half_steps=half_steps,
    )


def row_of(made: Made) -> FitRow:
    """Fit it, and in float32, too, where that can be; judge it.

    Intervals are for what is held as it is held, and a fit holds what the photo does not tell. So
    where that is not at its true value, and another value is outside of its interval, the fit is
    made again with it there, and that is judged.
    """
    name, untrue = type(made.start).NAME, list[str]()
    try:
        result = fitted(made)
        row = judged(made, result)
        if row.intervals is not None and row.intervals > 1:
            held = [n for n in made.asked if result.parameters[n].role == "held"]
            untrue = [n for n in held if result.parameters[n].value != made.known[n]]
        if untrue:
            made = replace(made, start=with_numbers(made.start, made.known, untrue))
            result = fitted(made)
            row = judged(made, result).noted(f"held, so given as known: {', '.join(untrue)}")
    except Exception as error:  # whatever it is, it is what the row is about
        return without_result(made.case, name, error)
    if made.untraced:
        return row.noted(f"not traced: {made.untraced}")
    value, why = float32_off(made, result)
    return replace(row, float32=value).noted(why)


def judged(made: Made, result: FitResult) -> FitRow:
    """Whether the fit keeps what is promised."""
    name, known = type(made.start).NAME, made.known
    return judge_fit(made.case, name, result, known, asked=made.asked, layers=made.layers)


def fitted(made: Made) -> FitResult:
    """The fit, in float64."""
    return fit(made.photo, made.layers, made.start, sampling="point", **made.settings)


def with_numbers(look: Look, known: Mapping[str, float], names: Collection[str]) -> Look:
    """The look with some of its numbers as they are known to be, by the names of results."""
    for name in names:
        family, _, ending = name.partition(".")
        if family not in type(look).PARAMETERS:
            continue
        value: Any = known[name]
        if ending:
            value = np.array(getattr(look, family), np.float64)
            value["rgb".index(ending) if ending in "rgb" else int(ending) - 1] = known[name]
        look = changed(look, **{family: value})
    return look


def float32_off(made: Made, result: FitResult) -> tuple[float | None, str]:
    """How far the traced fit in float32 ends from the fit, in typical sizes; else None, and why."""
    told = {n: e for n, e in result.parameters.items() if e.interval is not None}
    if not told:
        return None, "float32: nothing is told"
    if isinstance(made.photo, Photo):
        return None, "float32: takes arrays only"
    try:
        with jax.enable_x64(False):
            photo = jnp.asarray(made.photo, jnp.float32)
            traced = jax.jit(
                lambda seen: fit(seen, made.layers, made.start, sampling="point", **made.settings)
            )(photo)
    except InputError as error:
        return None, f"float32: {error}"
    code = int(traced.verdict)
    if code not in (Verdict.CONVERGED, Verdict.AT_BOUND):
        return None, f"float32: {Verdict(code).label}"
    values = traced_values(traced.look) | traced_values(traced.response)
    return max(abs(values[name] - e.value) / e.scale for name, e in told.items()), ""


def traced_values(found: Look | Response) -> dict[str, float]:
    """Numbers of a traced look or response by the names of results."""
    values: dict[str, float] = {}
    for name in vars(found):
        value = getattr(found, name)
        if value is None:
            continue
        numbers = np.asarray(value, np.float64)
        if numbers.ndim == 0:
            values[name] = float(numbers)
        else:
            endings = "rgb" if numbers.size == 3 else range(1, numbers.size + 1)
            values |= {f"{name}.{e}": float(v) for e, v in zip(endings, numbers, strict=True)}
    return values
