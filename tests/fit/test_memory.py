"""A process that fits ever new photos with ever new options does not grow."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fit._memory import MOST_MAPS
from tests.data import REPOSITORY

LOOP = """
import json, resource, sys
import jax
import numpy as np
from fit import fit, _memory
from model_jax import *

count, limit = int(sys.argv[1]), int(sys.argv[2])
_memory.MOST_MAPS = limit
clear, cleared = jax.clear_caches, []
jax.clear_caches = lambda: cleared.append(clear())
rng = np.random.default_rng(20261126)
FREE = [
    ("brightness", "shadow"), ("brightness", "background"), ("brightness", "shadow", "tint"),
    ("brightness", "tint", "black_level"), None, ("brightness", "shadow", "gamma"),
]
rows = []
for number in range(count):
    width, height = (int(n) for n in rng.integers(30, 160 if count < 100 else 400, 2))
    camera = Camera((0, 0, 3), (0, 0, -1), (0, 1, 0), 50, width, height, 0.5, 6)
    scene = Scene(camera, Planet(1.0), Atmosphere(0.2), Sun((1, 0.2, 0.3)))
    layers = analytic_layers(scene)
    light = np.asarray(composite(layers, LayersLook(2.0, 0.3, background=0.02)))[..., :3]
    photo = light + rng.normal(scale=0.01, size=light.shape).astype(np.float32)
    options = {}
    if count < 100:
        options["free"] = FREE[2 * number // count]  # two kinds, one after the other
    else:
        options["free"] = FREE[rng.integers(len(FREE))]
        options["loss"] = str(rng.choice(["linear", "linear", "huber", "cauchy"]))
        options["solver"] = str(rng.choice(["lm", "lm", "dogleg", "bfgs"]))
        if rng.random() < 0.3:
            options["priors"] = {"brightness": (2.0, float(rng.uniform(0.1, 0.9)))}
    if rng.random() < 0.3:
        options["bounds"] = {"brightness": (0.0, float(rng.uniform(5, 9)))}
    fit(photo, layers, **options)
    pages = int(open("/proc/self/statm").read().split()[1])
    rows.append((_memory.count_maps(), pages * resource.getpagesize(), len(cleared)))
print(json.dumps(rows))
"""

ONE_FIT = 2_500
"""Maps that one fit of a new kind may add: six descents at most, of 300 each, and the errors'."""


def loop(count: int, limit: int) -> list[tuple[int, int, int]]:
    """Maps, bytes and how often programs were cleared, after each of some fits in a new process."""
    if not Path("/proc/self/maps").exists():
        pytest.skip("this system does not tell a process's memory maps")
    done = subprocess.run(
        [sys.executable, "-c", LOOP, str(count), str(limit)],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
    )
    assert done.returncode == 0, done.stderr
    return [tuple(row) for row in json.loads(done.stdout)]


def test_eighteen_fits_stay_within_bounds() -> None:
    """With a low limit, so that fits of two kinds reach it."""
    limit = 1_500
    maps, held, cleared = zip(*loop(18, limit), strict=True)
    assert cleared[-1] > 0, "the limit was never reached: nothing is tested"
    assert max(maps) <= limit + ONE_FIT
    # What the middle third needed at most is what the last third needs: nothing is left behind.
    assert max(held[12:]) <= max(held[6:12]) + 100e6


@pytest.mark.full
@pytest.mark.timeout(3600)
def test_three_hundred_fits_stay_within_bounds() -> None:
    maps, held, cleared = zip(*loop(300, MOST_MAPS), strict=True)
    assert cleared[-1] > 0
    assert max(maps) <= MOST_MAPS + ONE_FIT
    assert max(held) <= 2.0e9
    assert max(held[200:]) <= max(held[100:200]) + 200e6
