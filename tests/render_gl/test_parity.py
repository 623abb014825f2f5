"""GLSL and JAX agree on the same depths, within the bound that `_parity` derives; and the check
that says so fails on planted faults."""

import dataclasses
from collections.abc import Callable
from itertools import product
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest

import render_gl
from model_jax import InputError, LayersLook, Look, Scene, combine
from render_gl import _shaders
from render_gl._draw import draw
from render_gl._parity import Parity, compare, measure_division
from render_gl._render import frame_layers
from tests.render_gl.scenes import SCENES, scene


def checked(case: Scene, look: Look, depth_format: render_gl.DepthFormat) -> Parity:
    frame = draw(case, look, depth_format)
    division = measure_division(case, depth_format)
    return compare(case, look, frame, depth_format, division)


@pytest.mark.parametrize(
    ("case", "depth_format"),
    [
        # Two formats for each scene, all for every fifth scene.
        pytest.param(
            SCENES[name],
            form,
            id=f"{name}-{form}",
            marks=() if k % 5 == 0 or (j - k) % 5 in (0, 2) else pytest.mark.full,
        )
        for (k, name), (j, form) in product(enumerate(SCENES), enumerate(render_gl.DEPTH_FORMATS))
    ],
)
def test_glsl_and_jax_agree(
    case: Scene, depth_format: render_gl.DepthFormat, tmp_path: Path
) -> None:
    parity = checked(case, LayersLook(), depth_format)
    if not parity.passed:
        for name in ("glsl", "jax", "difference"):
            render_gl.write_picture(tmp_path / f"{name}.exr", getattr(parity, name))
    assert parity.passed, (parity.summary(), tmp_path)
    assert np.max(parity.glsl) > 0  # comparing black with black would be no test
    if parity.division_ulp == 0:
        # Depths divided exactly (llvmpipe on most processors) leave the colour's 11 roundings of
        # 1.2e-7. A driver that is up to 3 ulp off per depth needs z_max / width_max < 8 for this.
        assert parity.summary()["bound_relative"] <= 1e-5


@pytest.mark.parametrize("case", SCENES.values(), ids=SCENES.keys())
def test_bound_is_tight_enough_on_linear_layers(case: Scene) -> None:
    assert checked(case, LayersLook(), "linear").summary()["bound_relative"] <= 1e-5


def test_paper_scene_agrees_to_1e5_of_its_maximum() -> None:
    file = render_gl.load_scene("examples/paper.toml")
    parity = checked(file.scene, file.look, "window24")
    layers = frame_layers(file.scene, draw(file.scene, file.look, "window24"), "window24")
    z_max = float(np.max(np.where(layers.has_air, layers.back, 0)))
    width_max = float(np.max(layers.back - layers.front))
    assert z_max / width_max <= 30  # what the bound of 1e-5 is stated for
    assert parity.passed
    assert parity.summary()["bound_relative"] <= 1e-5
    # The driver's worst allowed division would keep this scene below the bound, too.
    worst = compare(file.scene, file.look, draw(file.scene, file.look, "window24"), "window24", 3.0)
    assert worst.summary()["bound_relative"] <= 1e-5


def test_looks_with_channels_agree() -> None:
    look = LayersLook(brightness=7.0, shadow=[0.0, 0.5, 1.5], tint=[1.5, 0.9, 0.6])
    assert checked(SCENES["odd size"], look, "linear").passed


# --- the check itself is checked ---------------------------------------------------------------

FAULTY = SCENES["sun (1, -1, 1)"]
CROSSED = scene(thickness=0.5, distance=3.0, sun=(-0.2, 0.9, -0.3))
"""Rays enter the shadow, and some leave it, before they reach the air."""


def with_frame(
    change: Callable[[np.ndarray], np.ndarray], depth_format: render_gl.DepthFormat = "window24"
) -> Parity:
    """The comparison after `change` has been done to the depths that JAX gets."""
    frame = draw(FAULTY, LayersLook(), depth_format)
    front, back, *ends = change(np.stack([frame.front, frame.back, *frame.shadows[0]]))
    broken = dataclasses.replace(frame, front=front, back=back, shadows=np.stack(ends)[None])
    return compare(FAULTY, LayersLook(), broken, depth_format, measure_division(FAULTY, "window24"))


def test_fault_shadow_weight_off_by_a_thousandth_is_found() -> None:
    frame = draw(FAULTY, LayersLook(), "window24")
    parity = compare(
        FAULTY, LayersLook(shadow=0.201), frame, "window24", measure_division(FAULTY, "window24")
    )
    assert not parity.passed


@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
def test_fault_shadow_front_and_back_swapped_is_found(depth_format: render_gl.DepthFormat) -> None:
    assert with_frame(lambda d: d, depth_format).passed
    assert not with_frame(lambda d: d[[0, 1, 3, 2]], depth_format).passed


def test_fault_half_pixel_shift_is_found() -> None:
    assert not with_frame(lambda d: (d + np.roll(d, 1, axis=2)) / 2).passed


def test_fault_another_near_plane_is_found() -> None:
    frame = draw(FAULTY, LayersLook(), "window24")
    other = eqx.tree_at(lambda s: s.camera.near, FAULTY, FAULTY.camera.near * 1.001)
    assert not compare(other, LayersLook(), frame, "window24", 0.0).passed


def test_near_and_far_swapped_are_refused() -> None:
    frame = draw(FAULTY, LayersLook(), "window24")
    near, far = FAULTY.camera.near, FAULTY.camera.far
    swapped = eqx.tree_at(lambda s: (s.camera.near, s.camera.far), FAULTY, (far, near))
    with pytest.raises(InputError, match="are no clip planes; give 0 < near < far"):
        compare(swapped, LayersLook(), frame, "window24", 0.0)


@pytest.mark.parametrize(
    ("end", "left", "case"),
    [
        (3, "NEARER(depths[3], depths[1])", CROSSED),
        (3, "FARTHER(depths[3], depths[0])", FAULTY),
        (2, "NEARER(depths[2], depths[1])", CROSSED),
        (2, "FARTHER(depths[2], depths[0])", FAULTY),
    ],
    ids=["back against front", "back against back", "front against front", "front against back"],
)
def test_fault_missing_clamp_in_the_shader_is_found(
    end: int, left: str, case: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    clamp = f"NEARER(FARTHER(depths[{end}], depths[0]), depths[1])"
    original = _shaders._read

    def faulty(name: str) -> str:
        text = original(name)
        if name == "fields.glsl":
            assert clamp in text
            text = text.replace(clamp, left)
        return text

    monkeypatch.setattr(_shaders, "_read", faulty)
    assert not checked(case, LayersLook(), "window24").passed


def test_fault_not_a_number_is_found() -> None:
    def spoil(depths: np.ndarray) -> np.ndarray:
        depths[0, 120, 160] = np.nan
        return depths

    assert not with_frame(spoil).passed


def test_jax_reads_what_the_shader_read() -> None:
    """The front depth is gl_FragCoord.z in float32, not rounded to the texture's 24 bits."""
    frame = draw(FAULTY, LayersLook(), "window24")
    front = frame.front[frame.front != frame.back].astype(np.float64)
    steps = front * (2**24 - 1)
    assert np.mean(np.abs(steps - np.round(steps)) > 0.01) > 0.1
    picture = np.asarray(combine(frame_layers(FAULTY, frame, "window24"), LayersLook()))
    assert picture.shape == frame.air.shape
