"""Coordinates within bounds, and descents in them from the defaults."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import fit
from fit.solve import _reduce, _search
from fit.solve._box import Box
from fit.solve._declare import declare
from fit.solve._parameters import FitParameter, free_directions, to_entries
from fit.solve._problem import Point, Problem
from model_jax import (
    Fields,
    LayersLook,
    Look,
    Response,
    analytic_layers,
    composite,
    find_look,
    layer_widths,
    parameter,
)
from tests.model_jax.scenes import RADIUS, scene_of

AIR = find_look("air+density+saturation")
HEIGHT = 0.02 * RADIUS
TRUE = {
    "scale_height": HEIGHT,
    "brightness": 60.0,
    "shadow": 0.3,
    "tint": np.array([0.8, 1.1, 1.1]),
    "background": 0.01,
}


@pytest.mark.parametrize(
    "asked",
    [
        {},
        {"free": ["tint", "scale_height"]},  # no amplitude: factors along their basis
        {"free": ["brightness", "tint.r", "tint.g", "background"]},  # a factor that stays
        {"free": ["brightness", "extinction"]},
        {"bounds": {"tint.r": (0.5, 2.0)}},  # a part's bound is none of the product
        {"bounds": {"brightness": (1.0, 90.0), "background": (-1.0, 1.0)}},
        {"tied": {"extinction.g": "extinction.r", "tint.b": "tint.g"}},
    ],
)
def test_coordinates_are_where_their_slopes_lead(asked: Mapping[str, object]) -> None:
    """A place read and set is the same place, factors keep their mean, and slopes are those of
    `placed`: half the difference of two of its values, a step of 1e-4 apart, is good to 1e-7."""
    parameters = declare(AIR(**TRUE), [Response()], **asked)  # type: ignore[arg-type]
    free = [p for p in parameters if p.role == "free"]
    box, vector = Box(free, parameters, AIR), to_entries(parameters)
    values = box.values(vector)
    assert len(values) == len(box.lower) == len(box.upper) == box.slopes(vector).shape[1]
    np.testing.assert_allclose(box.placed(vector, values), vector, rtol=1e-14)
    slopes = box.slopes(vector)
    factors = next(p.entries[0] for p in parameters if p.mean_one)
    for column, slope in enumerate(slopes.T):
        step = 1e-4 * np.eye(len(values))[column]
        up, down = (box.placed(vector, values + side * step) for side in (1, -1))
        np.testing.assert_allclose((up - down) / 2e-4, slope, rtol=1e-6, atol=1e-7)
        assert up[factors : factors + 3].sum() == pytest.approx(3, rel=1e-14)
    assert (values >= box.lower).all()
    assert (values <= box.upper).all()
    dark = box.placed(vector, np.maximum(box.lower, np.where(np.isfinite(box.lower), 0, values)))
    assert np.isfinite(box.slopes(dark)).all()


@pytest.mark.parametrize(("extinction", "unit"), [(0.0, 1.0), (20.0, 1.0), (20.0, 1e3)])
def test_thinning_air_is_found_from_the_defaults(extinction: float, unit: float) -> None:
    """In kilometres and metres; without dimming, where the best fit lies at bounds of 0."""
    scene = scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0, shell=0.2, radius=RADIUS * unit)
    layers = analytic_layers(scene)
    look = AIR(**TRUE | {"scale_height": HEIGHT * unit}, extinction=np.full(3, extinction))
    picture = np.array(composite(layers, look)[..., :3], np.float32)
    photo = picture + np.random.default_rng(4).normal(0, 1e-3, picture.shape)
    found = fit.fit(photo.astype(np.float32), layers, AIR(), sampling="point")
    assert found.verdict == ("converged" if extinction else "at_bound"), found.message
    for name, true in (("scale_height", HEIGHT * unit), ("brightness", 60.0), ("shadow", 0.3)):
        p = found.parameters[name]
        assert p.stderr is not None
        assert abs(p.value - true) < 4 * p.stderr, (name, p.value, p.stderr)


class Steep(Look):
    """Light that overflows where it is steep."""

    steepness: float = parameter("how fast it grows", default=3.0, lower=0.0)
    NEEDS = ("lit",)
    ROUNDINGS = (1e3, 0.0)

    def air(self, fields: Fields) -> tuple[Any, None]:
        return fields.color * jnp.expm1(self.steepness * fields.lit), None


def test_starts_whose_light_overflows_are_passed_over() -> None:
    layers = analytic_layers(scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0))
    photo = np.asarray(composite(layers, Steep(steepness=3.0)))[..., :3]
    widest = float(np.nanmax(layer_widths(layers)[0]))
    found = fit.fit(photo, layers, Steep(steepness=1e4 / widest), sampling="point")
    assert found.verdict == "diverged"  # no start's light is a number
    found = fit.fit(photo, layers, Steep(steepness=10 / widest), sampling="point")
    assert found.look.steepness == pytest.approx(3.0, rel=1e-4), found.message


def test_all_pixels_lead_where_exact_steps_do_not_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every 16th pixel leads a few standard errors astray; without exact steps from there, only a
    descent over all of them gets to what all of them say."""
    scene = scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0, shell=0.2)
    layers = analytic_layers(scene)
    look = AIR(**TRUE, extinction=np.full(3, 20.0))
    picture = np.array(composite(layers, look)[..., :3], np.float32)
    photo = picture + np.random.default_rng(4).normal(0, 1e-3, picture.shape).astype(np.float32)
    true = fit.fit(photo, layers, AIR(), sampling="point")

    def without_steps(
        problem: Problem, vector: np.ndarray, free: list[FitParameter]
    ) -> tuple[np.ndarray, np.ndarray]:
        directions = free_directions(free, problem.parameters)[0]
        return vector, Point(problem, vector, directions).gram()

    monkeypatch.setattr(_search, "finish", without_steps)
    monkeypatch.setattr(_reduce, "THIN", 100)
    led = fit.fit(photo, layers, AIR(), sampling="point")
    assert led.verdict == true.verdict == "converged", led.message
    for name, p in true.parameters.items():
        if p.stderr:  # the check of the end point is of a thousandth
            assert led.parameters[name].value == pytest.approx(p.value, abs=2e-3 * p.stderr)
    monkeypatch.setattr(_search, "_ends_elsewhere", lambda *_: False)
    assert fit.fit(photo, layers, AIR(), sampling="point").verdict == "not_converged"


@pytest.mark.parametrize("terms", ["density", "density+saturation"])
def test_uniform_air_ends_at_the_largest_scale_height(terms: str) -> None:
    """A slab thins out nowhere: its scale height runs to the bound that the scene gives it, where
    air is uniform to a quarter of a thousandth, and all else is as it was drawn."""
    scene = scene_of((0.0, -3.0, 0.4), size=(97, 73), fov=45.0, shell=0.2)
    layers = analytic_layers(scene)
    picture = np.asarray(composite(layers, LayersLook(3.0, 0.2)))[..., :3]
    photo = picture + np.random.default_rng(4).normal(0, 1e-3, picture.shape)
    found = fit.fit(photo.astype(np.float32), layers, find_look(f"air+{terms}")(), sampling="point")
    assert found.verdict == "at_bound", found.message
    assert 900 * 0.2 * RADIUS < found.parameters["scale_height"].value <= 1000 * 0.2 * RADIUS
    assert found.parameters["brightness"].value == pytest.approx(3.0, rel=2e-3)
