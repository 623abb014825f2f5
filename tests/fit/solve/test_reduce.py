"""Pseudo-pixels that stand for all."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from fit import fit, load_photo
from fit.solve._problem import Problem
from fit.solve._reduce import THIN
from model_jax import analytic_layers, composite, find_look
from tests.model_jax.scenes import RADIUS, scene_of

AIR = find_look("air+density+saturation")


class Stopped(Exception):
    pass


def test_what_is_believed_as_measured_is_so_in_the_thinned_picture(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The first round takes codes at an end for light. A thinned picture that still called them
    bounds asked 2 ln 2 for each black sample, and photos with a dark sky went astray."""
    problems: list[Problem] = []

    def stop(problem: Problem, *_: Any, **__: Any) -> None:
        problems.append(problem)
        raise Stopped

    monkeypatch.setattr("fit._rounds.search", stop)
    scene = scene_of((0.0, -3.0, 0.4), size=(480, 360), fov=45.0, shell=0.4)
    layers = analytic_layers(scene)
    look = AIR(scale_height=0.02 * RADIUS, brightness=60.0, extinction=np.full(3, 20.0))
    light = np.asarray(composite(layers, look))[..., :3]
    Image.fromarray(np.clip(255 * light, 0, 255).astype(np.uint8)).save(tmp_path / "photo.png")
    with pytest.raises(Stopped):
        fit(load_photo(tmp_path / "photo.png"), layers, AIR(), sampling="point")
    believing = problems[0]
    assert believing.samples.clipped is None
    (columns,) = believing.columns
    assert columns.clipped is not None
    assert (columns.clipped < 0).any()
    assert len(columns.index) > 2 * THIN  # so it is thinned
