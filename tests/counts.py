"""What work is done, in numbers that no other machine changes: the guard of speed.

    python -m tests.counts            compare with counts.json
    python -m tests.counts --write    make it anew; only for a change on purpose, in a commit that
                                      says why

Times belong to a machine and are never tested (`airlight bench` reports them). What is counted here
is what a program asks for: operations and bytes of the combine step and of a fit's pass before XLA
optimises them, draw calls, passes of fits, compiled programs.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from fit._compile import float64
from fit.bench._combine_points import _air, _cast
from fit.bench._frontier import _of_shell
from fit.bench._plans import FULL
from fit.bench._scenes import THIN, synthetic, synthetic_fit
from fit.bench._settings import Setting, run_search, run_setting
from fit.bench._whole import _FRESH, _uncached
from fit.photo._columns import take_columns
from fit.photo._pixels import choose_pixels
from fit.solve._declare import declare
from fit.solve._gram import pixel_gram
from fit.solve._layout import Layout
from fit.solve._loss import Loss
from fit.solve._model import Model
from fit.solve._parameters import free_directions, to_entries
from fit.solve._samples import to_samples
from model_jax import Response, analytic_layers
from render_gl import load_scene
from render_gl._draw import draw

from .data import REPOSITORY

COUNTS = Path(__file__).with_name("counts.json")

SAME = 0.25
"""How far passes of a fit may differ, as a share: another processor's rounding lets a damped solver
try a step more, and a descent that ends at a tolerance takes one less."""

Counts = dict[str, Any]

SIZE = (64, 48)
"""Operations are counted for each pixel, of which there have to be some."""


def operations(look: str) -> Counts:
    """Of the combine step, its slopes and a fit's pass, before optimisation; for each pixel."""
    view = synthetic(*SIZE)
    made = _of_shell(look, float(view.atmosphere.height))
    with float64():
        layers = analytic_layers(view, jnp.float64, made)
        given = _cast((layers, made), "float32")
        photo = jnp.zeros((SIZE[1], SIZE[0], 3), jnp.float32)

        def loss(made: Any, layers: Any, photo: jax.Array) -> jax.Array:
            return ((_air(layers, made)[..., :3] - photo) ** 2).mean()

        slopes = eqx.filter_value_and_grad(loss)
        found = {
            "combine": _cost(_air, *given),
            "slopes": _cost(slopes, given[1], given[0], photo),
        }
        kind = type(made)
        shown = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
        used = choose_pixels(shown, layers, "point").used
        columns = take_columns(shown, layers, used, float(layers.width_unit), kind)
        parameters = declare(made, [Response()])
        free = [p for p in parameters if p.role == "free"]
        directions = free_directions(free, parameters)[0]
        model = Model(Loss("linear"), None, Layout(kind), True)
        entries = to_entries(parameters)
        found["pass"] = _cost(pixel_gram, entries, directions, to_samples([columns]), model)
    return found


def _cost(function: Callable[..., Any], *given: Any) -> Counts:
    """Of a program that is not yet optimised: operations it is written with, arithmetic and bytes.

    The last two are XLA's count, in which a loop is one pass through it.
    """
    jit: Any = eqx.filter_jit  # its type leaves out what it passes on
    lowered = jit(function).lower(*given).lowered
    text, cost = lowered.as_text(), lowered.cost_analysis()
    return {
        "operations": text.count("stablehlo."),
        "loops": text.count("stablehlo.while"),
        "flops": int(cost["flops"]),
        "bytes": int(cost["bytes accessed"]),
    }


def draw_calls(name: str) -> Counts:
    """Of an example's picture."""
    file = load_scene(REPOSITORY / "examples" / f"{name}.toml")
    camera = file.scene.camera
    small = file.scene.resized(camera.width // 8, camera.height // 8)
    return {
        "window24": draw(small, file.look, "window24").drawn,
        "linear": draw(small, file.look, "linear").drawn,
    }


def fit_passes(look: str) -> Counts:
    """Of a fit of a small synthetic photo, as `fit` makes it, and of one descent over all."""
    case = synthetic_fit("synthetic", synthetic(80, 64), look, 80, 64).case()
    found = {"search": run_search(case), "descent": run_setting(case, Setting(), 256)}
    return {
        name: {"passes": ended.evaluations, "bytes": ended.bytes} for name, ended in found.items()
    }


def programs() -> Counts:
    """Compiled by the first `fit()` of a process, by the same again, and by one of another size."""
    done = subprocess.run(
        [sys.executable, "-c", _FRESH, "80", "64"],
        capture_output=True,
        text=True,
        check=True,
        env=_uncached(),
        cwd=REPOSITORY,
    )
    told = json.loads(done.stdout.splitlines()[-1])
    return {"first": told[2], "again": told[5], "another size": told[8]}


CASES: dict[str, Callable[[], Counts]] = {
    **{f"operations, {look}": partial(operations, look) for look in FULL.looks},
    **{
        f"draw calls, {name}": partial(draw_calls, name)
        for name in ("paper", "reference", "rim", "gradient")
    },
    **{f"passes, {look}": partial(fit_passes, look) for look in ("layers", THIN)},
    "programs": programs,
}


def differences(name: str, made: Counts, before: Counts) -> list[str]:
    """What is not as it was; passes but for rounding."""
    room = SAME if name.startswith("passes") else 0.0
    return [
        f"{name}: {key} is {value}, and was {was}"
        for (key, value), (_, was) in zip(_leaves(made), _leaves(before), strict=True)
        if abs(value - was) > room * was
    ]


def _leaves(counts: Counts, prefix: str = "") -> list[tuple[str, int]]:
    found: list[tuple[str, int]] = []
    for key, value in counts.items():
        nested = isinstance(value, dict)
        found += _leaves(value, f"{prefix}{key} ") if nested else [(prefix + key, value)]
    return found


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--write", action="store_true", help="make counts.json anew")
    made = {}
    asked = words.parse_args()
    for name, count in CASES.items():
        print(name, file=sys.stderr)
        made[name] = count()
    if asked.write:
        COUNTS.write_text(json.dumps({"jax": jax.__version__, **made}, indent=1) + "\n")
        return
    before = json.loads(COUNTS.read_text())
    found = [line for name in CASES for line in differences(name, made[name], before[name])]
    print("\n".join(found) or f"{len(made)} counts are as they were")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
