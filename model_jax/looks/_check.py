"""Is a look what it says? Its record, and its `air` tried on sample fields.

What a user would meet hours later as a NaN or a wrong reduction is refused here by name.
"""

import itertools
import math
import re
from functools import cache
from typing import Any, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .._composite import air_light, dims
from .._errors import InputError, cut, shown
from .._fields import FIELDS, WIDTHS
from .._look import Blend, Look
from .._shapes import AnyArray

SAMPLES = np.concatenate([[0.0, 1e-6, 1.0, 4.0], np.random.default_rng(8).uniform(0, 1, 12)])
"""Widths that a look is tried on, in width units: none, next to none, a few, and any."""

MOST_ROUNDINGS = 4096
"""ulp that a look may claim: with more a fault of 0.05 % in its shader would pass."""

_AWAY = 0.37
"""Typical sizes by which parameters are moved off their defaults; in no formula by chance."""

LINEAR = 1e-4
"""Relative difference from a straight line that float32 may make of one: some hundred roundings."""


@cache
def check_look(kind: type[Look]) -> None:
    """Raise `InputError` naming the look and what is wrong with it, if anything is."""
    try:
        _check_record(kind)
        with jax.ensure_compile_time_eval():  # a fit may be inside of somebody's jit
            _check_air(kind)
    except InputError as error:
        begin = f"look {kind.NAME}: "
        text = str(error)
        raise InputError(text if text.startswith(f"look {kind.NAME}") else begin + text) from None
    except Exception as error:
        told = cut(f"{type(error).__name__}: {' '.join(str(error).split())}")
        raise InputError(f"look {kind.NAME}: air cannot be run ({told}); mend it") from error


def _check_record(kind: type[Look]) -> None:
    """The facts that need no arithmetic."""
    unknown = [name for name in (*kind.NEEDS, *kind.LINEAR_IN) if name not in FIELDS]
    if unknown:
        raise InputError(f"no field is called {shown(unknown[0])}; there are {', '.join(FIELDS)}")
    name, *terms = kind.NAME.split("+") if kind.TERMS else [kind.NAME]
    if not re.fullmatch(r"[a-z][a-z0-9_-]*", name) or not set(terms) <= kind.TERMS.keys():
        raise InputError(
            f"NAME is {shown(kind.NAME)}; give small letters, digits, - and _, a letter first"
        )
    if all(FIELDS[name].absent for name in kind.NEEDS):
        raise InputError(
            "NEEDS names no field that every scene has; add one of "
            + ", ".join(name for name, field in FIELDS.items() if not field.absent)
        )
    if not set(kind.LINEAR_IN) <= set(kind.NEEDS):
        raise InputError("LINEAR_IN names fields that NEEDS does not; add them there")
    if kind.BLEND not in get_args(Blend):
        raise InputError(
            f"BLEND is {shown(kind.BLEND)}; choose from {', '.join(map(repr, get_args(Blend)))}"
        )
    roundings = np.shape(kind.ROUNDINGS) == (2,) and all(n >= 0 for n in kind.ROUNDINGS)
    if not roundings or not 0 < max(kind.ROUNDINGS) <= MOST_ROUNDINGS:
        raise InputError(
            f"ROUNDINGS is {shown(kind.ROUNDINGS)}; give two numbers, ulp of the light and of 1, "
            f"one of them above 0 and none above {MOST_ROUNDINGS}"
        )
    shares = [name for name, about in kind.PARAMETERS.items() if about.mean_one]
    if len(shares) > 1 or any(kind.PARAMETERS[name].shape != "rgb" for name in shares):
        raise InputError(
            f"parameters of mean one are {', '.join(shares)}; there may be one, of shape 'rgb'"
        )
    ground = kind.PARAMETERS.get(kind.GROUND)
    if kind.GROUND and (ground is None or ground.shape != "rgb" or ground.lower < 0):
        raise InputError(
            f"GROUND: {shown(kind.GROUND)} must be a parameter of shape 'rgb', at least 0"
        )
    for name, about in kind.PARAMETERS.items():
        if about.of is not None and about.of not in kind.NEEDS:
            raise InputError(f"parameter {name} is of {shown(about.of)}, which NEEDS does not name")


def _check_air(kind: type[Look]) -> None:
    """Light and slopes at the defaults and at every bound; and the facts about them."""
    for look, where in _tried(kind):
        light, alpha, passed, slopes = _values(kind, look)
        if kind.BLEND != "add" and alpha is None:
            raise InputError(
                f"BLEND is {shown(kind.BLEND)}, and air returns no alpha; return light [..., 4]"
            )
        shares = {"transmittance": passed} | ({} if alpha is None else {"alpha": alpha})
        if not all(np.isfinite(part).all() for part in (light, *shares.values())):
            raise InputError(f"light or transmittance is not finite {where}; mend air")
        for name, share in shares.items():
            if (share < -LINEAR).any() or (share > 1 + LINEAR).any():
                raise InputError(f"{name} leaves 0 to 1 {where}; mend air")
        if kind.LINEAR_IN:
            _check_linear(kind, look)
        for name, slope in slopes.items():
            if not np.isfinite(slope).all():
                raise InputError(
                    f"the gradient by {name} is not finite {where}; mend air (a power, root or "
                    "quotient at 0)"
                )
    if kind.AMPLITUDE:
        _check_amplitude(kind)
    if kind.SEPARABLE is not None:
        _check_separable(kind)


def _tried(kind: type[Look]) -> list[tuple[Look, str]]:
    """Looks to try, and what is said of each."""
    found = [(kind(), "at the defaults")]
    for name, about in kind.PARAMETERS.items():
        for bound in (about.lower, about.upper):
            if np.isfinite(bound) and not about.mean_one:
                value = np.broadcast_to(bound, np.shape(about.default))
                found.append((kind(**{name: value}), f"where {name} is {bound:g}"))
        # What holds at the defaults alone, such as a power of 1, is no fact.
        if not about.mean_one:
            moved = np.clip(np.add(about.default, _AWAY * about.scale), about.lower, about.upper)
            found.append((kind(**{name: moved}), f"where {name} is {shown(moved.tolist())}"))
    return found


def _fields(kind: type[Look]) -> dict[str, Float[np.ndarray, " n"]]:
    """Sample fields: every pair of two widths, or of a width and what is 0 or 1."""
    rows = list(itertools.product(SAMPLES, repeat=2))
    found = {}
    for k, name in enumerate(kind.NEEDS):
        values = np.array([row[k % 2] for row in rows], np.float32)
        found[name] = values if name in WIDTHS else (np.arange(len(values)) % 2).astype(np.float32)
    return found | {name: part for name, part in _places().items() if name in kind.NEEDS}


def _places() -> dict[str, Float[np.ndarray, " n"]]:
    """Sample rays through 100 km of air above 6,371 km: as many as pairs of widths, of which every
    third meets the ground; some through the centre, some along the shell, some half in shadow."""
    low, high = np.array(list(itertools.product(SAMPLES, repeat=2))).T / SAMPLES.max()
    radius, top = 6371.0, 6471.0
    hits = np.arange(len(low)) % 3 == 0
    impact = np.where(hits, low * radius, radius + low * (top - radius))
    end = np.sqrt(np.maximum(top**2 - impact**2, 0))
    ground = -np.sqrt(np.maximum(radius**2 - impact**2, 0))
    last = np.where(hits, ground, end)
    found = {
        "begin": -end,
        "end": last,
        "dark_begin": -end + high / 2 * (last + end),
        "dark_end": -end + high * (last + end),
        "altitude": impact - radius,
        "impact": impact,
        "per_length": np.full(len(low), 1e-3),
        "sunward": np.cos(9 * low + 5 * high) * impact,
        "sun_cos": np.sin(9 * low + 5 * high) * np.cos(7 * low),
        "begin_sun_cos": np.sin(11 * low + 3 * high),
        "end_sun_cos": np.cos(7 * low + 8 * high),
        "shell": np.full(len(low), top - radius),
    }
    # Seen from a third of the air's height, or from two radii.
    eye = np.where(np.arange(len(low)) % 2 == 0, (2 * radius + top) / 3, 3 * radius)
    turned = np.where(eye > top, 1, np.where(high > 1, 1, -1))
    nadir_cos = turned * np.sqrt(np.maximum(1 - (impact / eye) ** 2, 0))
    found |= {
        "nadir_cos": nadir_cos,
        "radius": np.full(len(low), radius),
        "eye_height": eye - radius,
        "ground_horizon": np.sqrt(1 - (radius / eye) ** 2),
        "shell_horizon": np.sqrt(np.maximum(1 - (top / eye) ** 2, 0)),
        "eye_sun_cos": np.sin(5 * low + 2 * high),
    }
    return {name: part.astype(np.float32) for name, part in found.items()}


_COLOR = np.array([0.3, 0.6, 1.0], np.float32)
"""Of the air: channels apart, so that none passes for another."""

_FACTORS = np.array([0.5, 1.0, 1.5])
"""Of mean one."""


def _light(look: Look, fields: dict[str, Any]) -> tuple[AnyArray, AnyArray | None, AnyArray]:
    air = air_light(look, fields, _COLOR)
    passed = jnp.ones(1) if air.transmittance is None else air.transmittance
    return air.light, air.alpha, passed


def _values(
    kind: type[Look], look: Look
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, dict[str, np.ndarray]]:
    """Light, alpha, transmittance, and the slopes of all by parameters and fields."""
    fields = _fields(kind)
    look = jax.tree.map(lambda part: jnp.asarray(part, np.float32), look)
    light, alpha, passed = _jitted(look, fields)
    by_look, by_fields = _slopes(look, fields)
    slopes = {name: np.asarray(getattr(by_look, name)) for name in kind.PARAMETERS}
    slopes |= {f"field {name}": np.asarray(part) for name, part in by_fields.items()}
    share = None if alpha is None else np.asarray(alpha)
    return np.asarray(light), share, np.asarray(passed), slopes


_jitted = eqx.filter_jit(_light)


@eqx.filter_jit
def _slopes(look: Look, fields: dict[str, Any]) -> Any:
    def total(look: Look, fields: dict[str, Any]) -> jax.Array:
        light, alpha, passed = _light(look, fields)
        return light.sum() + passed.sum() + (0 if alpha is None else alpha.sum())

    return jax.grad(total, argnums=(0, 1))(look, fields)


def _check_linear(kind: type[Look], look: Look) -> None:
    """Twice the fields make twice the light, and sums of fields sums of light."""
    look, one = jax.tree.map(lambda part: jnp.asarray(part, np.float32), look), _fields(kind)
    other = {n: np.roll(v, 7) if n in kind.LINEAR_IN else v for n, v in one.items()}
    both = {n: 2 * one[n] + other[n] if n in kind.LINEAR_IN else v for n, v in one.items()}
    first, second, whole = (
        np.asarray(_jitted(look, fields)[0], np.float64) for fields in (one, other, both)
    )
    if np.abs(whole - (2 * first + second)).max() > LINEAR * np.abs(whole).max():
        raise InputError(f"light is not linear in {', '.join(kind.LINEAR_IN)}; correct LINEAR_IN")


def _check_amplitude(kind: type[Look]) -> None:
    """The light is proportional to the product of AMPLITUDE, on which nothing else hangs."""
    known = [kind.PARAMETERS.get(name) for name in kind.AMPLITUDE]
    found = [about for about in known if about is not None]
    numbers = [about for about in found if about.shape == "number" and about.lower == 0]
    factors = [about for about in found if about.mean_one]
    if len(found) < len(known) or len(numbers) != 1 or len(numbers) + len(factors) != len(known):
        raise InputError(
            f"AMPLITUDE: {shown(kind.AMPLITUDE)} must name one number ≥ 0, and perhaps factors of "
            "mean one"
        )
    by = {name: _FACTORS if kind.PARAMETERS[name].mean_one else 1.7 for name in kind.AMPLITUDE}
    ones = {name: np.divide(value, value) for name, value in by.items()}
    fields = _fields(kind)
    (light, *passed), (other, *others) = (_jitted(kind(**part), fields) for part in (ones, by))
    said = np.asarray(light, np.float64)[..., :3] * math.prod(by.values())
    apart = np.abs(np.asarray(other, np.float64)[..., :3] - said).max()
    same = jax.tree.all(jax.tree.map(np.array_equal, passed, others))
    if apart > LINEAR * np.abs(said).max() or not same:
        raise InputError(
            "AMPLITUDE: the light is not proportional to it; correct it or leave it out"
        )


def _check_separable(kind: type[Look]) -> None:
    """The light is the product and sum that SEPARABLE says."""
    fact = kind.SEPARABLE
    assert fact is not None
    for name, shape in ((fact.amplitude, "number"), (fact.factors, "rgb"), (fact.weight, None)):
        about = kind.PARAMETERS.get(name)
        shapes = (shape,) if shape else ("rgb", "either")
        if about is None or about.shape not in shapes:
            raise InputError(f"SEPARABLE: {name} is no parameter of shape {' or '.join(shapes)}")
    three = {fact.amplitude, fact.factors, fact.weight}
    if three != kind.PARAMETERS.keys() - Look.PARAMETERS.keys():
        raise InputError("SEPARABLE: names amplitude, factors and weight, and there are others")
    if {fact.first, fact.second} != set(kind.NEEDS) or set(kind.NEEDS) != set(kind.LINEAR_IN):
        raise InputError("SEPARABLE: its two fields must be those of NEEDS and LINEAR_IN")
    if FIELDS[fact.first].absent or dims(kind):
        raise InputError(
            "SEPARABLE: its first field must be in every scene, and nothing behind it be dimmed"
        )
    fields = _fields(kind)
    look = kind(**{fact.amplitude: 1.7, fact.factors: _FACTORS, fact.weight: 0.4})
    light = np.asarray(_jitted(look, fields)[0], np.float64)
    width = fields[fact.first] + 0.4 * fields[fact.second]
    said = 1.7 * _COLOR * _FACTORS * width[:, None]
    if light.shape != said.shape or np.abs(light - said).max() > LINEAR * np.abs(said).max():
        raise InputError("SEPARABLE: the light is not that product; correct it or leave it out")
