"""All solvers are asked the same: with budget enough each ends where the others do."""

from dataclasses import replace

import numpy as np
import pytest

from fit.bench._fit_points import Limits, fit_points
from fit.bench._peers import PEERS, installed
from fit.bench._problems import Case
from fit.bench._scenes import synthetic, synthetic_fit
from fit.bench._settings import Setting, run_search, run_setting

ENOUGH = {
    "SciPy trf": 60,
    "SciPy lm": 60,
    "lmfit leastsq": 200,
    "optax Adam": 1500,
    "optax L-BFGS": 40,
    "optimistix LM": 40,
}

NEAR = {"optax Adam": 1e-4, "lmfit leastsq": 1e-6}
"""Adam's steps end within a share of its rate; lmfit's slopes are differences, right to √eps."""


@pytest.fixture(scope="module")
def case() -> Case:
    return synthetic_fit("synthetic", synthetic(96, 80), "layers", 96, 80).case()


@pytest.mark.parametrize("name", PEERS)
def test_peers_end_at_the_optimum(case: Case, name: str) -> None:
    if not installed(name):
        pytest.skip("not installed")
    ended = PEERS[name](case, ENOUGH[name])
    assert case.worst(ended.vector, case.best) < NEAR.get(name, 1e-8)
    assert ended.evaluations > 1
    assert ended.bytes == ended.evaluations * case.residuals.bytes()


@pytest.mark.parametrize(
    ("setting", "near"),
    [
        (Setting(), 1e-7),
        (Setting("dogleg"), 1e-7),
        (Setting("bfgs"), 1e-7),
        (Setting(dtype="float32"), 1e-4),
        (Setting(reduction="moments"), 1e-7),
        # 256 bins along each field of 1,500 pixels are nearly a bin for each.
        (Setting(reduction="bins"), 1e-3),
        (Setting(reduction="bins", exact=2), 1e-11),
    ],
    ids=str,
)
def test_settings_end_at_the_optimum(case: Case, setting: Setting, near: float) -> None:
    """As near as a tolerance of 1e-12 of the cost leaves parameters, its root; float32's 1e-6 and
    eps alike; exact steps at rounding."""
    ended = run_setting(case, setting, 256)
    assert case.worst(ended.vector, case.best) < near
    assert ended.bytes > 0


def test_pixels_that_tell_nothing_have_no_curves() -> None:
    """A look whose every number is held: of black light, nothing says how bright air is."""
    dark = synthetic_fit("synthetic", synthetic(48, 40), "layers", 48, 40)
    dark = replace(dark, photo=np.zeros_like(dark.photo), free=("shadow",), truth=None)
    case = dark.case()
    assert case.told.free == []
    found = list(
        fit_points(case, {}, (Setting(),), ("SciPy trf",), (), Limits(), lambda step: None)
    )
    assert [p.method for p in found] == ["airlight"]
    assert "tell nothing" in found[0].note


def test_the_picture_is_of_pixels_not_of_padding(case: Case) -> None:
    assert len(case.residuals.light(case.best)) == 3 * case.pixels
    assert case.judged(case.start)["picture_rms"] > 1


def test_a_budget_of_few_steps_is_kept(case: Case) -> None:
    for steps in (1, 3, 5):
        assert run_setting(case, Setting(), steps).evaluations == steps + 1


def test_exact_steps_count_as_passes_over_all_pixels(case: Case) -> None:
    reduced = run_setting(case, Setting(reduction="moments"), 256)
    exact = run_setting(case, Setting(reduction="moments", exact=2), 256)
    assert exact.evaluations == reduced.evaluations + 2
    columns = case.columns
    size = columns.light.nbytes + sum(field.nbytes for field in columns.fields.values())
    assert exact.bytes == reduced.bytes + 2 * size


def test_the_optimum_is_flat_in_all_directions(case: Case) -> None:
    """Its residuals are square to all slopes, to rounding of sums."""
    residual, slopes = case.residuals.at(case.best, case.directions)
    cosines = slopes.T @ residual / np.linalg.norm(slopes, axis=0) / np.linalg.norm(residual)
    assert np.abs(cosines).max() < 64 * np.finfo(float).eps * np.sqrt(len(residual))
    assert case.worst(run_search(case).vector, case.best) < 1e-11
