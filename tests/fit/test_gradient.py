"""Fits of the look `gradient` to pictures that it made: every parameter that a picture tells is
found, the others are told as flat."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from fit import fit
from model_jax import Layers, analytic_layers, composite, find_look
from model_jax.looks._gradient import SMOOTH
from tests.model_jax.scenes import scene_of

SHELL = 1200 / 1024 - 1
TRUTH: dict[str, Any] = {
    "falloff": 0.8,
    "tint": (0.8, 0.9, 1.3),
    "opacity": 0.7,
    "stretch": 0.3,
    "tweak": 0.15,
    "background": 0.01,
    "asymmetry": -0.6,
    "light_distance": 0.5,
}


def layers_for(terms: str, height: float = 0.7) -> Layers:
    """Sky and ground from a number of shell heights, the sun low before the camera."""
    scene = scene_of(
        (0.0, 0.0, 1 + height * SHELL),
        (1.0, 0.2, 0.75),
        (0.9, 0.1, 0.25),
        shell=SHELL,
        size=(96, 72),
        fov=75.0,
    )
    scene = replace(scene, planet=replace(scene.planet, albedo=(0.3, 0.25, 0.15)))
    with jax.enable_x64(True):
        layers = analytic_layers(scene, np.float64, find_look(terms)())
        return jax.tree.map(np.asarray, layers)


@pytest.mark.parametrize(
    "terms", ["gradient+veil", "gradient+mie+veil", "gradient+mie+lamp+veil", "gradient"]
)
def test_what_a_picture_tells_is_found(terms: str) -> None:
    kind, layers = find_look(terms), layers_for(terms)
    truth = {name: TRUTH[name] for name in kind.PARAMETERS}
    with jax.enable_x64(True):
        light = np.asarray(composite(layers, kind(**truth)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    # From the document's lamp next to the centre a fit may end where all air is opaque, for which
    # alpha is nothing that can be told.
    start = kind(light_distance=0.3) if "lamp" in terms else kind()
    result = fit(light + noise, layers, start, sampling="point")
    # Without a veil alpha lies before black space.
    flat = set() if "veil" in terms else {"opacity"}
    assert {left.what for left in result.left_out} == flat
    assert result.verdict == "converged", result.message
    for name, estimate in result.parameters.items():
        family, _, part = name.partition(".")
        if family in truth and family not in flat:
            value = float(np.ravel(truth[family])["rgb".index(part) if part else 0])
            assert estimate.stderr is not None, name
            assert abs(estimate.value - value) < 5 * estimate.stderr, name


@pytest.mark.full
def test_a_table_is_found_from_a_flat_one() -> None:
    """127 numbers; those that no light reaches stay as wide as they were known to be before."""
    kind, layers = find_look("gradient+table+veil"), layers_for("gradient+table+veil")
    truth = {name: TRUTH[name] for name in kind.PARAMETERS.keys() & TRUTH.keys()}
    with jax.enable_x64(True):
        light = np.asarray(composite(layers, kind(**truth)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    tables = ("red", "green", "blue", "cover")
    start = kind(**dict.fromkeys(tables, np.ones(31)))
    result = fit(light + noise, layers, start, sampling="point")
    assert result.verdict == "converged", result.message
    assert not result.left_out
    for name in tables:
        for k, value in enumerate(np.asarray(getattr(kind(), name))):
            estimate = result.parameters[f"{name}.{k + 1}"]
            assert estimate.stderr is not None
            assert abs(estimate.value - value) < 4 * estimate.stderr
    assert result.parameters["red.1"].stderr == pytest.approx(0.4, abs=0.1)
    assert (result.parameters["red.31"].stderr or 1) < 0.01


def test_what_is_known_of_a_table_is_of_neighbours() -> None:
    """One number of a table among held ones is drawn to them: by normal distributions of the
    differences to three, one of which is the 1 that the others are shares of."""
    kind, layers = find_look("gradient+table"), layers_for("gradient+table")
    flat = {name: np.full(31, 0.4) for name in ("red", "green", "blue", "cover")}
    light = np.asarray(composite(layers, kind(**flat)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    # Of alpha before black space light says nothing: the prior alone is left.
    result = fit(light + noise, layers, kind(**flat), free=["cover.31"], sampling="point")
    estimate = result.parameters["cover.31"]
    assert estimate.value == pytest.approx((0.4 + 0.4 + 1) / 3, abs=1e-6)
    assert estimate.stderr == pytest.approx(SMOOTH / np.sqrt(3), rel=1e-3)
    own = fit(
        light + noise,
        layers,
        kind(**flat),
        free=["cover.31", "falloff"],
        priors={"cover.31": (0.9, 0.05)},
        sampling="point",
    )
    assert own.parameters["cover.31"].value == pytest.approx(0.9, abs=1e-6)


def test_far_from_the_shell_its_tweak_is_told_as_flat() -> None:
    layers = layers_for("gradient+veil", height=3.0)
    kind = find_look("gradient+veil")
    light = np.asarray(composite(layers, kind(stretch=0.3)))[..., :3]
    noise = np.random.default_rng(1).normal(scale=0.003, size=light.shape)
    result = fit(light + noise, layers, kind(), sampling="point")
    assert {left.what: left.why for left in result.left_out} == {
        "tweak": "it has no effect in the pixels used; held at its start value"
    }
    assert result.verdict == "converged", result.message
