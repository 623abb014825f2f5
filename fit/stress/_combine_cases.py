"""Looks at the ends of their ranges, and tone curves at black and white, with all slopes."""

from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from model_jax import (
    Exposure,
    Look,
    Power,
    Response,
    Scene,
    Srgb,
    analytic_layers,
    find_look,
    record,
)
from model_jax._composite import air_light, compose
from model_jax._fields import fields_of
from model_jax._parameter import LENGTH, Parameter

from ..bench._scenes import EVERY, THIN, synthetic
from ._number_row import EPS, Cause, Probe, Program, cast

LOOKS = (
    "layers",
    "air",
    "air+density",
    "air+density-rgb+saturation",
    THIN,
    EVERY,
    "rim",
    "rim+gradient+specular",
    "gradient",
    "gradient+table+mie+veil",
)

PIXELS = 6
FAR = 1e12
"""What stands for an infinite end of a range; of a length, a million shells."""

NIGHT = 1e-30
"""Light far below any camera's."""

THINNEST = "heights have steps that are no small share of such a scale height"
DENORMAL = "exposure times light is below 1e-38, which float32 takes for black"


def combine_probes(names: tuple[str, ...] = LOOKS) -> Iterator[Probe]:
    """Each look as it is, and with each of its numbers at either end."""
    scene = synthetic(40, 32)
    for kind in [find_look(name) for name in names]:  # a wrong name is found out first
        yield from _of_look(kind, scene)


def _of_look(kind: type[Look], scene: Scene) -> Iterator[Probe]:
    name = kind.NAME
    shell = float(scene.atmosphere.height)
    look = kind(**{n: _full(p, shell / 7) for n, p in _lengths(kind).items()})
    fields = _fields(scene, look)
    color = np.asarray(scene.atmosphere.color, np.float64)[:3]
    numbers, rest = eqx.partition(cast(look, jnp.float64), eqx.is_inexact_array)

    def light(given: Any) -> jax.Array:
        numbers, fields, color = given
        whole: Look = eqx.combine(numbers, rest)
        air = air_light(whole, fields, color)
        dims = air.transmittance is not None or air.alpha is not None
        white = jnp.ones_like(air.light) if dims else None
        return jnp.asarray(compose(air, white, 0.0, whole.BLEND))

    program = Program(light, cast((numbers, fields, color), jnp.float64))
    yield Probe("combine", f"{name}: as it starts", program, (numbers, fields, color))
    for parameter, about in kind.PARAMETERS.items():
        if parameter == "background":
            continue
        for value in _ends(about, shell):
            full = jnp.full_like(getattr(numbers, parameter), value)
            given = eqx.tree_at(attrgetter(parameter), numbers, full)
            words = f"{name}: {parameter} {value:g}"
            cause = (
                Cause(THINNEST, EPS["float32"] * shell / value) if about.unit == LENGTH else None
            )
            yield Probe("combine", words, program, (given, fields, color), cause=cause)


def _lengths(kind: type[Look]) -> dict[str, Parameter]:
    return {n: p for n, p in kind.PARAMETERS.items() if p.unit == LENGTH}


def _full(about: Parameter, value: float) -> Any:
    return (value,) * 3 if about.shape == "rgb" else value


def _ends(about: Parameter, shell: float) -> tuple[float, ...]:
    """Lower and upper end of its range; and nearly nothing, of what may be any size."""
    if about.unit == LENGTH:
        return 1e-6 * shell, 1e6 * shell
    if about.lower == 0 and np.isinf(about.upper):
        return 0.0, 1 / FAR, FAR
    low = about.lower if np.isfinite(about.lower) else -FAR
    return low, about.upper if np.isfinite(about.upper) else FAR


def _fields(scene: Scene, look: Look) -> dict[str, np.ndarray]:
    """Of some pixels with air, the limb's thinnest and the longest ray among them."""
    layers = analytic_layers(scene, jnp.float64, look)
    width = np.asarray(layers.back - layers.front).ravel()
    order = np.argsort(width)
    order = order[width[order] > 0]
    chosen = order[np.linspace(0, len(order) - 1, PIXELS).astype(int)]
    found = fields_of(layers, type(look).NEEDS)
    shape = np.shape(layers.front)
    return {n: np.broadcast_to(np.asarray(f), shape).ravel()[chosen] for n, f in found.items()}


def record_probes() -> Iterator[Probe]:
    """Exposures that saturate all or nothing, and curves at black."""
    light = np.array([NIGHT, 1e-12, 1e-6, 3.1e-3, 0.04, 0.5, 1.0, 1e3])
    black = np.zeros(3)
    curves: dict[str, tuple[Callable[..., Any], Any]] = {
        "sRGB": (lambda given: Srgb().encode(given[0]), ()),
    }
    for exposure in (1e-12, 1.0, 1e12):
        for gamma in (1.0, 2.2):
            curves[f"1 - exp(-{exposure:g} · light), gamma {gamma:g}"] = (
                _exposed,
                (np.array(exposure), np.array(gamma)),
            )
    for gamma in (0.1, 2.2, 10.0):
        curves[f"light^(1/{gamma:g})"] = (_powered, (np.array(gamma),))
        curves[f"record, gamma {gamma:g}"] = (
            _recorded,
            (np.array(1.0), np.array(gamma), np.array(0.01)),
        )
    for exposure in (1e-12, 1e12):
        curves[f"record, exposure {exposure:g}"] = (
            _recorded,
            (np.array(exposure), np.array(2.2), np.array(0.0)),
        )
    for name, (curve, numbers) in curves.items():
        for where, values in (("from night to white", light), ("black", black)):
            given = cast((values, *numbers), jnp.float64)
            cause = Cause(DENORMAL, 1.0) if "1e-12" in name else None
            case = f"{name}: {where}"
            yield Probe("record", case, Program(curve, given), given, cause=cause)


def _exposed(given: Any) -> jax.Array:
    light, exposure, gamma = given
    return jnp.asarray(Exposure(exposure, gamma).encode(light))


def _powered(given: Any) -> jax.Array:
    light, gamma = given
    return jnp.asarray(Power(gamma).encode(light))


def _recorded(given: Any) -> jax.Array:
    light, exposure, gamma, level = given
    return jnp.asarray(record(light, Response(exposure, gamma, level)))
