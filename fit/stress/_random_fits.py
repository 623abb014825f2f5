"""Fits of random looks to random views of random planets."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from model_jax import Layers, Look, Scene, find_look

from ._fit_row import MOST_INTERVALS, FitRow
from ._made import RADIUS, Made, Tell, changed, layers_of, light_of, noisy, row_of, view

KINDS = ("layers", "air", "rim", "gradient")
SHARES = (0.55, 0.25, 0.10, 0.10)
"""Of the kinds among random fits."""

AIRS = (
    "air+saturation",
    "air+density",
    "air+density+saturation",
    "air+density+saturation+phase",
    "air+density+top+saturation",
    "air+top+saturation",
    "air+density+saturation+ground",
    "air+density+saturation+sun",
)
"""Sets of terms: few, so that their programs are compiled once. The last takes longest, and"""
SUNLIT_SHARE = 0.03
"""of all airs it is so many."""

GROUNDS = 0.1
"""Share of scenes whose layers tell the ground's light, besides those for looks that change it."""

SMALL = (48, 36)
"""Width and height of all pictures, so that their programs are compiled once."""

QUANTILES = (0.5, 0.9, 0.99, 1.0)

Random = np.random.Generator


def random_fits(count: int, seed: int, tell: Tell, looks: Sequence[str] = ()) -> Iterator[FitRow]:
    """So many fits, each with random numbers of its own, so that any of them can be made again
    (`random_case`).

    Args:
        tell: hears of every fiftieth fit, and of those that break the promise.
        looks: names to draw from; empty: all, by their shares.
    """
    for number in range(count):
        row = row_of(random_case(number, seed, looks))
        if not row.kept or (number + 1) % 50 == 0:
            tell(f"{row.case}, {row.look}: {row.verdict}{'' if row.kept else ', broken'}")
        yield row


def random_case(number: int, seed: int, looks: Sequence[str] = ()) -> Made:
    """The photo and the fit of a number."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    kind = find_look(str(rng.choice(looks)) if looks else _name(rng))
    scene = random_scene(rng, bool(kind.GROUND))
    unscaled = random_look(rng, kind, scene)
    layers = layers_of(scene, unscaled)
    truth = _exposed(rng, unscaled, layers)
    noise = _log_uniform(rng, 1e-4, 0.1)
    photo = noisy(light_of(layers, truth), noise, int(rng.integers(2**31)))
    case = f"random fit {number}, noise {noise:.1g}, {_described(scene)}"
    untraced = "each would be compiled anew"
    return Made(case, photo, layers, start_of(kind, scene), truth, untraced=untraced)


def start_of(kind: type[Look], scene: Scene) -> Look:
    """Defaults, but for what is a length: that is the shell's."""
    shell = float(scene.atmosphere.height)
    lengths = {"scale_height": shell / 6, "top": 0.9 * shell}
    return kind(**{name: value for name, value in lengths.items() if name in kind.PARAMETERS})


def random_scene(rng: Random, ground: bool = False) -> Scene:
    """A camera in the air or up to a thousand radii above the ground; a shell of a thousandth of
    the radius or up to as thick as it; the whole planet in view, or its limb.

    Args:
        ground: the layers shall tell its light.
    """
    shell = _log_uniform(rng, 1e-3, 1.0)
    height = _log_uniform(rng, 0.2 * shell, 1e3)
    distance, outer = 1 + height, 1 + shell
    place, side = _turned(rng)
    sun = rng.normal(size=3)
    albedo = (0.2, 0.3, 0.4) if rng.random() < (1.0 if ground else GROUNDS) else None
    limb = np.arcsin(1 / distance)
    if height < shell * 1.05:  # there the air has no edge to look at
        angle, fov = limb, rng.uniform(20.0, 80.0)
    else:
        edge = np.arcsin(outer / distance)
        is_whole = shell > 0.1 and height > 0.5 and rng.random() < 0.6
        angle = 0.0 if is_whole else (limb + edge) / 2
        fov = np.degrees(2.2 * edge if is_whole else rng.uniform(2.0, 5.0) * (edge - limb))
    forward = -np.cos(angle) * place + np.sin(angle) * side
    at = distance * place
    return view(
        at,
        at + forward,
        sun,
        fov=float(min(fov, 100.0)),
        shell=float(shell),
        size=SMALL,
        albedo=albedo,
    )


def random_look(rng: Random, kind: type[Look], scene: Scene) -> Look:
    """Around what is usual, with an amplitude of 1; optical depths of 0.1 to 3 in the longest
    column."""
    shell = float(scene.atmosphere.height)
    given: dict[str, Any] = {"brightness": 1.0} if "brightness" in kind.PARAMETERS else {}
    tint = rng.uniform(0.6, 1.4, 3)
    usual: dict[str, Any] = {
        "tint": tint / tint.mean(),
        "shadow": rng.uniform(0.05, 0.6),
        "scale_height": shell * rng.uniform(0.08, 0.3),
        "top": shell * rng.uniform(0.5, 0.95),
        "upwelling": rng.uniform(0.2, 1.0),
        "aerosol": rng.uniform(0.2, 0.8),
        "ground": rng.uniform(0.5, 1.5, 3),
        "opacity": rng.uniform(0.3, 0.9),
        "exponent": rng.uniform(2.0, 10.0),
        "slump": rng.uniform(10.0, 50.0),
        "falloff": rng.uniform(0.7, 3.0),
        "stretch": rng.uniform(0.1, 0.5),
        "tweak": rng.uniform(0.03, 0.3),
    }
    if "asymmetry" in kind.PARAMETERS:
        usual["asymmetry"] = rng.uniform(0.4, 0.85)
    depth = _log_uniform(rng, 0.1, 3.0) * rng.uniform(0.5, 1.5, 3)
    given |= {name: value for name, value in usual.items() if name in kind.PARAMETERS}
    if "extinction" in kind.PARAMETERS:
        given["extinction"] = depth / _longest(scene, given.get("scale_height"))
    return kind(**given)


def summary(rows: Sequence[FitRow]) -> dict[str, Any]:
    """Counts, shares of verdicts, and how far converged fits are off.

    `error` and `intervals` are quantiles among the converged: 50, 90, 99 % and the most. Of
    intervals that are right one value of twenty is outside; each row has that of its worst.
    """
    verdicts = Counter(row.verdict for row in rows)
    settled = [row for row in rows if row.verdict == "converged"]
    off = [row.intervals for row in settled if row.intervals is not None]
    return {
        "count": len(rows),
        "verdicts": {name: number / len(rows) for name, number in verdicts.most_common()},
        "error": _quantiles(row.error for row in settled),
        "intervals": _quantiles(off),
        "over 1 interval": sum(value > 1 for value in off),
        f"over {MOST_INTERVALS:g} intervals": sum(not value <= MOST_INTERVALS for value in off),
        "broken": sum(not row.kept for row in rows),
    }


def _quantiles(values: Iterable[float | None]) -> dict[str, float]:
    known = [value for value in values if value is not None]
    return {f"{100 * q:g} %": float(np.quantile(known, q)) for q in QUANTILES} if known else {}


def _name(rng: Random) -> str:
    """Of a look."""
    kind = str(rng.choice(KINDS, p=SHARES))
    if kind != "air":
        return kind
    return AIRS[-1] if rng.random() < SUNLIT_SHARE else str(rng.choice(AIRS[:-1]))


def _exposed(rng: Random, look: Look, layers: Layers) -> Look:
    """The look with an amplitude that makes the brightest air a tenth to one, and a background."""
    level = _log_uniform(rng, 0.1, 1.0)
    background = level * rng.uniform(0.0, 0.1)
    if "brightness" not in type(look).PARAMETERS:
        return changed(look, background=background)
    bare = jax.tree.map(np.asarray, replace(layers, surface=None))
    brightest = float(light_of(bare, look).max())
    return changed(look, brightness=level / max(brightest, 1e-30), background=background)


def _longest(scene: Scene, scale_height: float | None) -> float:
    """About the longest column of air in width units, of density 1 at the ground."""
    shell = float(scene.atmosphere.height)
    chord = 2 * np.sqrt(shell * (2 * RADIUS + shell))
    column = chord if scale_height is None else np.sqrt(2 * np.pi * RADIUS * scale_height)
    return float(min(chord, column) / (scene.camera.far - scene.camera.near))


def _turned(rng: Random) -> tuple[np.ndarray, np.ndarray]:
    """Two directions at right angles, any."""
    place, other = rng.normal(size=3), rng.normal(size=3)
    place /= np.linalg.norm(place)
    side = np.cross(place, other)
    return place, side / np.linalg.norm(side)


def _log_uniform(rng: Random, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _described(scene: Scene) -> str:
    height = float(np.linalg.norm(scene.camera.position)) / RADIUS - 1
    shell = float(scene.atmosphere.height) / RADIUS
    return f"{height:.1g} radii up, shell {shell:.1g}"
