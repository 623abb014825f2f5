"""Fits of the look `rim` to pictures that it made: every parameter that a picture tells is found,
the others are told as flat."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from fit import fit
from model_jax import Layers, analytic_layers, composite, find_look
from tests.model_jax.scenes import scene_of

TRUTH: dict[str, Any] = {
    "brightness": 1.4,
    "tint": (0.8, 0.9, 1.3),
    "opacity": 0.7,
    "exponent": 3.5,
    "slump": 20.0,
    "background": 0.01,
    "specular": 0.8,
    "shininess": 25.0,
    "red": np.linspace(1, 2, 9),
    "green": np.linspace(1, 0.5, 9),
    "blue": np.linspace(1, 0.3, 9),
}


def layers_for(terms: str) -> Layers:
    """A planet with its terminator in view, half of whose ground mirrors by chance."""
    scene = scene_of((0.9, -2.4, 0.6), sun=(0.8, -0.5, 0.25), shell=0.03, size=(96, 72), fov=52.0)
    scene = replace(scene, planet=replace(scene.planet, albedo=(0.3, 0.25, 0.15)))
    with jax.enable_x64(True):
        layers = analytic_layers(scene, np.float64, find_look(terms)())
        layers = jax.tree.map(np.asarray, layers)
    wet = np.random.default_rng(0).uniform(size=np.shape(layers.front)) < 0.5
    return replace(layers, water=wet * np.asarray(layers.planet))


@pytest.mark.parametrize(
    "terms",
    ["rim", "rim+single", "rim+specular", pytest.param("rim+gradient", marks=pytest.mark.full)],
)
def test_what_a_picture_tells_is_found(terms: str) -> None:
    kind, layers = find_look(terms), layers_for(terms)
    truth = {name: TRUTH[name] for name in kind.PARAMETERS}
    with jax.enable_x64(True):
        light = np.asarray(composite(layers, kind(**truth)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    result = fit(light + noise, layers, kind(), sampling="point")
    assert result.verdict in ("converged", "at_bound"), result.message
    told = 0
    for name, estimate in result.parameters.items():
        family, _, part = name.partition(".")
        if family in truth and estimate.stderr is not None:
            k = {"r": 0, "g": 1, "b": 2}.get(part, int(part) - 1 if part.isdigit() else 0)
            value = float(np.ravel(truth[family])[k])
            assert abs(estimate.value - value) < 5 * estimate.stderr, name
            told += 1
    flat = {left.what for left in result.left_out}
    # Beyond 90° + slump no light falls: nodes at 140° and more are behind that.
    dark = {f"{c}.{k}" for c in ("red", "green", "blue") for k in (7, 8, 9)}
    # That at 120° shines through the last degrees before, if at all.
    edge = {f"{c}.6" for c in ("red", "green", "blue")}
    assert flat - edge == (dark if "gradient" in terms else set())
    everything = sum(np.size(value) for value in truth.values())
    assert told >= everything - len(flat | edge)
    if "gradient" not in terms:
        assert result.verdict == "converged", result.message
        assert told == everything


def test_without_ground_its_cover_is_not_told() -> None:
    """Before black space opacity and brightness are one product."""
    layers = replace(layers_for("rim"), surface=None, is_albedo=False)
    light = np.asarray(composite(layers, find_look("rim")(brightness=1.4, opacity=0.7)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    result = fit(light + noise, layers, find_look("rim")(), sampling="point")
    assert result.verdict == "converged", result.message
    (left,) = (left for left in result.left_out if left.what in ("opacity", "brightness"))
    assert left.what == "opacity"
    product = result.parameters["brightness"].value * result.parameters["opacity"].value
    assert product == pytest.approx(
        1.4 * 0.7, abs=5 * (result.parameters["brightness"].stderr or 0)
    )


def test_without_water_its_glint_is_held() -> None:
    layers = replace(layers_for("rim+specular"), water=None)
    light = np.asarray(composite(layers, find_look("rim")()))[..., :3]
    result = fit(light, layers, find_look("rim+specular")(), sampling="point")
    held = {left.what: left.why for left in result.left_out}
    assert held.keys() == {"specular", "shininess"}
    assert held["specular"] == "no pixel used shows water"
