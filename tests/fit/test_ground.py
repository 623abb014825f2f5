"""Fits of air in front of ground of unknown brightness: `where="all"` and the term `ground`; and
what one photo does not tell of terms."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from fit import fit
from fit.solve._box import Box
from fit.solve._declare import declare
from model_jax import Look, Planet, Response, Scene, analytic_layers, composite, find_look
from tests.model_jax.scenes import RADIUS, scene_of

LOOK = find_look("air+saturation+ground")
BARE = scene_of((0.0, -3.0, 0.4), sun=(0.5, -0.6, 0.2), size=(65, 49), fov=45.0, shell=0.1)
SCENE = replace(BARE, planet=Planet(RADIUS, albedo=(1.0, 1.0, 1.0)))
TRUE: dict[str, Any] = {
    "extinction": (2.0, 5.0, 11.0),
    "brightness": 2.5,
    "tint": (0.8, 1.0, 1.2),
    "shadow": 0.3,
    "background": 0.02,
    "ground": (0.3, 0.25, 0.2),
}
NOISE = 2e-3


def photo_of(scene: Scene, look: Look) -> np.ndarray:
    light = np.asarray(composite(analytic_layers(scene), look), np.float32)[..., :3]
    noise = np.random.default_rng(5).normal(0, NOISE, light.shape)
    return light + noise.astype(np.float32)


@pytest.mark.parametrize("albedo", [(1.0, 1.0, 1.0), (0.9, 0.5, 0.3)])
def test_the_ground_of_a_photo_is_found_beside_its_air(
    albedo: tuple[float, float, float],
) -> None:
    """Its albedo, or the factor on the scene's. Four standard errors of a Gaussian are passed by
    one of 16,000 values."""
    scene = replace(SCENE, planet=Planet(RADIUS, albedo=albedo))
    photo = photo_of(scene, LOOK(**TRUE))
    found = fit(photo, analytic_layers(scene), LOOK(), sampling="point")
    assert found.verdict == "converged", found.message
    for name, p in found.parameters.items():
        if p.role == "free":
            family, _, channel = name.partition(".")
            true = np.asarray(TRUE[family])
            one = float(true["rgb".index(channel)] if channel else true)
            assert p.stderr is not None
            assert abs(p.value - one) < 4 * p.stderr, name
    ground = [found.parameters[f"ground.{c}"] for c in "rgb"]
    assert all(p.stderr is not None and p.stderr < 0.01 * p.value for p in ground)


def test_of_a_ring_the_ground_is_left_out_with_a_word() -> None:
    photo = photo_of(SCENE, LOOK(**TRUE))
    found = fit(photo, analytic_layers(SCENE), LOOK(), sampling="point", where="ring")
    assert found.verdict == "converged", found.message
    assert {found.parameters[f"ground.{c}"].role for c in "rgb"} == {"held"}
    said = {left.what: left.why for left in found.left_out}
    assert said["ground"] == "behind no pixel used is lit ground"


def test_of_a_planet_whose_light_nobody_tells_the_ground_is_left_out_with_a_word() -> None:
    photo = photo_of(BARE, LOOK(**TRUE))
    found = fit(photo, analytic_layers(BARE), LOOK(), sampling="point")
    (left,) = (one for one in found.left_out if one.what == "ground")
    assert "give it an albedo, [1, 1, 1] if nobody knows it" in left.why
    assert found.photos[0].excluded["planet without a surface layer"] > 0


def test_of_a_grey_photo_the_ground_is_one_number() -> None:
    look = find_look("air+ground")
    given = {name: TRUE[name] for name in ("brightness", "shadow", "background", "ground")}
    light = photo_of(SCENE, look(**given)).astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    grey = np.repeat(light[..., None], 3, axis=-1)
    found = fit(grey, analytic_layers(SCENE), look(), sampling="point")
    assert found.verdict == "converged", found.message
    ground = found.parameters["ground.r"]
    assert ground.stderr is not None
    # A grey planet of the luminance of the true one, for white light.
    assert abs(ground.value - np.dot(TRUE["ground"], [0.2126, 0.7152, 0.0722])) < 4 * ground.stderr
    assert {found.parameters[f"ground.{c}"].role for c in "gb"} == {"tied"}


def test_the_ground_and_the_exposure_are_one() -> None:
    free = ["brightness", "extinction", "ground", "background", "exposure"]
    photo, look = photo_of(SCENE, LOOK(**TRUE)), LOOK(**TRUE)
    found = fit(photo, analytic_layers(SCENE), look, free=free, sampling="point")
    assert found.verdict == "not_identifiable"
    (left,) = found.left_out
    assert left.what == "exposure"
    assert "brightness, ground.r, ground.g, ground.b and exposure act alike" in left.why


def test_from_far_away_the_phase_is_a_factor_with_a_word() -> None:
    """Between the rays there is half a degree: haze's angle and share scale the lit air, and with
    the shadow's weight so does brightness."""
    far = scene_of((140.0, -185.0, 15.0), fov=0.62, sun=(0.2, -1.0, 0.4), size=(65, 49), shell=0.1)
    look = find_look("air+saturation+phase")
    deep = {"extinction": (60.0, 120.0, 200.0), "brightness": 80.0, "tint": TRUE["tint"]}
    photo = photo_of(far, look(**deep, background=0.02, aerosol=0.4, asymmetry=0.6))
    found = fit(photo, analytic_layers(far), look(), sampling="point")
    (left,) = found.left_out
    assert left.what in ("aerosol", "asymmetry")
    assert left.what in left.why
    assert "brightness" in left.why
    assert "act alike" in left.why


def test_light_is_linear_in_the_ground_of_a_box() -> None:
    parameters = declare(LOOK(**TRUE), [Response()])
    free = [p for p in parameters if p.role == "free"]
    box = Box(free, parameters, LOOK)
    assert [p.family for p in box.levels] == ["ground"] * 3 + ["background"]
    assert box.linear == 3 + 4


@pytest.mark.usefixtures("x64")
def test_traced_fits_know_the_ground() -> None:
    layers = analytic_layers(SCENE, np.float64)
    photo = np.asarray(composite(layers, LOOK(**TRUE)))[..., :3]
    start = LOOK(**TRUE | {"brightness": 2.0, "ground": (1.0, 1.0, 1.0)})
    free = ["brightness", "ground"]

    def fitted(photo: jax.Array) -> jax.Array:
        return fit(photo, layers, start, free=free, sampling="point").look.ground

    np.testing.assert_allclose(jax.jit(fitted)(photo), TRUE["ground"], rtol=1e-6)
