"""Depth formats: what each can tell, and which a scene gets."""

import equinox as eqx
import numpy as np
import pytest

import render_gl
from model_jax import InputError, Scene, depth_constants, eye_center, linearize_depth
from render_gl import DEPTH_FORMATS, choose_format
from render_gl._depth_format import (
    EPS,
    SHARE,
    STORAGE,
    DepthFormat,
    depth_error,
    widest_chord,
    width_error,
)
from tests.render_gl.scenes import SCENES, scene

PLAIN = SCENES["sun (1, -1, 1)"]


def with_near(near: float, far: float | None = None) -> Scene:
    """Clip planes in planet radii."""
    radius = float(PLAIN.planet.radius)
    case = eqx.tree_at(lambda s: s.camera.near, PLAIN, near * radius)
    return case if far is None else eqx.tree_at(lambda s: s.camera.far, case, far * radius)


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        (scene(thickness=1.5, distance=4.0), "window16"),
        (PLAIN, "window24"),
        (with_near(0.01), "reversed32f"),
        (scene(distance=232.0), "linear"),
        (scene(thickness=0.002), "linear"),
    ],
    ids=["thick shell", "ordinary", "near plane too near", "far camera", "thin shell"],
)
def test_the_cheapest_that_is_exact_enough(case: Scene, expected: str) -> None:
    choice = choose_format(case)
    assert choice.depth_format == expected
    limit = SHARE * float(case.atmosphere.height)
    for cheaper in DEPTH_FORMATS[: DEPTH_FORMATS.index(expected)]:
        assert width_error(case, cheaper) > limit
        assert f"{cheaper} " in choice.reason or choice.error <= limit
    assert choice.error == width_error(case, expected)


def test_where_none_is_exact_enough_linear_is_taken_and_said() -> None:
    case = scene(thickness=0.002)
    choice = choose_format(case)
    assert choice.error > SHARE * float(case.atmosphere.height)
    assert "no format stays below 0.1 %" in choice.reason
    assert "--source analytic" in choice.reason


def test_another_share_is_another_choice() -> None:
    assert choose_format(PLAIN, share=0.01).depth_format == "window16"
    assert choose_format(PLAIN, share=1e-4).depth_format == "linear"


@pytest.mark.parametrize("exponent", [0.3, 1, 3, 5, 6, 7, 8, 11, 15])
def test_far_over_near_up_to_1e15(exponent: float) -> None:
    """Window formats are taken while they tell something, then refused by name; the rest serve."""
    case = with_near(21409.7 / 6371.0 / 10**exponent) if exponent > 1 else PLAIN
    chord = widest_chord(case)
    for depth_format in DEPTH_FORMATS:
        error = width_error(case, depth_format)
        if STORAGE[depth_format].encoding == "window" and not error < chord:
            with pytest.raises(InputError, match=rf"{depth_format}.*linear"):
                choose_format(case, depth_format)
            with pytest.raises(InputError, match=depth_format):
                render_gl.render(case, depth_format)
        else:
            assert choose_format(case, depth_format).depth_format == depth_format
    assert choose_format(case).error <= SHARE * float(case.atmosphere.height)
    layers = render_gl.render(case)
    assert np.all(np.isfinite(layers.front))
    assert np.all(np.isfinite(layers.back))
    assert layers.has_air.any()


@pytest.mark.parametrize("near", [1.2, 0.01, 1e-4])
@pytest.mark.parametrize("depth_format", DEPTH_FORMATS)
def test_stored_depths_come_back_within_the_error(depth_format: DepthFormat, near: float) -> None:
    """Exact depths through the format's own rounding and the float32 linearisation."""
    case = with_near(near)
    near, far = float(case.camera.near), float(case.camera.far)
    center = float(eye_center(case)[2])
    storage = STORAGE[depth_format]
    z = np.geomspace(near, far, 10_001)
    if storage.encoding == "linear":
        found = (z - center).astype(np.float32).astype(np.float64) + center
    else:
        a, b = depth_constants(near, far, storage.encoding)
        steps = {"window16": 65535, "window24": 2**24 - 1}.get(depth_format)
        code = np.float32(b / z + a) if steps is None else np.rint((b / z + a) * steps) / steps
        stored = np.asarray(code, np.float32)
        found = np.asarray(linearize_depth(stored, near, far, storage.encoding), np.float64)
    error = np.abs(found - z)
    bound = depth_error(case, depth_format, z - center)
    assert np.all(error <= bound)
    # Beside what the driver's arithmetic is allowed, the bound is what rounding really does.
    if storage.rounding > EPS:
        assert np.max(bound[z < far / 2] / np.max(error[z < far / 2])) < 4


def test_unknown_formats_are_named() -> None:
    with pytest.raises(InputError, match=r"window12.*auto.*window16"):
        choose_format(PLAIN, "window12")
