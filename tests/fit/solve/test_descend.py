"""The descent: which solver runs, what numbers it is given, and how exactly it ends."""

from itertools import product
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from PIL import Image

from fit import FitResult, fit, load_photo
from fit.solve import _descend, _polish, _search
from model_jax import Srgb
from tests.fit.looks import evidence_of
from tests.fit.solve.problems import CASES, Dense, Fit, photo_of, start_of

EPS = float(np.finfo(np.float64).eps)
SOLVERS = {
    "lm": optx.LevenbergMarquardt,
    "dogleg": optx.Dogleg,
    "bfgs": optx.BFGS,
}
BY_NAME = {case.name: case for case in CASES}


def place_of(case: str, light: float = 1.0, length: float = 1.0, start: str = "far") -> Fit:
    return Fit(BY_NAME[case], "lm", light, length, start, "float64")


def fit_at(place: Fit, **options: Any) -> FitResult:
    """The matrix's own photo, 48 × 40 pixels, fitted as the matrix does."""
    layers, photo = photo_of(place.case, place.light, place.length, place.dtype)
    look, response = start_of(place)
    asked = {"free": place.case.free, "loss": place.case.loss, "solver": place.solver} | options
    return fit(photo, layers, look, response=response, **asked)


@pytest.mark.parametrize(("name", "kind"), SOLVERS.items(), ids=SOLVERS)
def test_a_name_is_optimistixs_solver(name: str, kind: type) -> None:
    """And what records its steps has it inside."""
    made = _descend.make_solver(name)
    assert type(made) is kind
    recorder: Any = _descend._recorded(made, 7, jnp.asarray(5))
    assert recorder.inner is made
    assert (recorder.room, int(recorder.most)) == (7, 5)


class Stopped(Exception):
    """A descent was asked for; holds what it was given, or what it found."""


@pytest.mark.parametrize(("name", "kind"), SOLVERS.items(), ids=SOLVERS)
@pytest.mark.parametrize("case", ["linear", "gamma", "cauchy"])
def test_the_solver_named_is_the_one_that_descends(
    case: str, name: str, kind: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    def descend(chart: Any, samples: Any, model: Any, solver: Any, max_steps: int) -> None:
        raise Stopped(solver, max_steps)

    monkeypatch.setattr(_search, "descend", descend)
    with pytest.raises(Stopped) as caught:
        fit_at(place_of(case), solver=name, max_steps=77)
    solver, max_steps = caught.value.args
    assert type(solver) is kind
    assert max_steps == 77


SEEN: list[tuple[np.ndarray, ...]] = []


class Watching(optx.LevenbergMarquardt):
    """Levenberg–Marquardt that notes the problem it is given: start, residuals and slopes there."""

    def init(self, fn: Any, y: Any, args: Any, *rest: Any) -> Any:
        residual = fn(y, args)[0]
        slopes = jax.jacfwd(lambda step: fn(step, args)[0])(y)
        jax.debug.callback(lambda *seen: SEEN.append(seen), y, residual, slopes)
        return super().init(fn, y, args, *rest)


UNITS = list(product([1e-8, 1.0, 1e8], repeat=2))


@pytest.mark.parametrize(
    ("case", "light", "length"),
    [("linear", *units) for units in UNITS] + [("gamma", *units) for units in UNITS[::2]],
)
def test_solvers_see_numbers_of_order_one(
    case: str, light: float, length: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In what optimistix itself is handed, whatever the units and however far the start.

    Columns have length one and right angles to each other. That costs eps times the condition of
    what they share at the start, some thousands here; half of float64's digits are to be left. A
    length of one is that of the photo's light, and a start explains more of it than nothing does.
    """
    really = _search.descend

    def descend(chart: Any, samples: Any, model: Any, *_: Any) -> None:
        watching: Any = Watching  # mypy takes its fields for its arguments
        really(chart, samples, model, watching(_descend.TOLERANCE, _descend.TOLERANCE), 1)
        raise Stopped

    monkeypatch.setattr(_search, "descend", descend)
    SEEN.clear()
    with pytest.raises(Stopped):
        fit_at(place_of(case, light, length))
    jax.effects_barrier()
    step, residual, slopes = (np.asarray(part) for part in SEEN[0])
    assert not step.any()
    np.testing.assert_allclose(slopes.T @ slopes, np.eye(len(step)), atol=1e-8)
    assert 0 < np.linalg.norm(residual) < 1


def polished(model: Dense) -> np.ndarray:
    """SciPy's optimum, after Gauss–Newton steps of NumPy's: `least_squares` stops where the cost
    stands still, which is 1e-8 of a parameter away."""
    best = model.optimum()
    for _ in range(8):
        best -= np.linalg.lstsq(model.jacobian(best), model.residual(best), rcond=None)[0]
    return best


@pytest.mark.parametrize("start", ["near", "far"])
def test_a_free_gamma_ends_at_the_optimum_of_all_pixels(start: str) -> None:
    """Not at that of the averaged pixels that the descent runs on: to 1e-6, and far better."""
    place = place_of("gamma", start=start)
    result = fit_at(place)
    assert result.verdict == "converged"
    model = Dense(place, *photo_of(place.case, 1.0, 1.0, "float64"), result)
    np.testing.assert_allclose(model.to_normal(result), polished(model), rtol=1e-6)


def clipped(folder: Path) -> FitResult:
    """The matrix's linear photo as 8-bit codes, its brightest tenth white."""
    layers, photo = photo_of(BY_NAME["linear"], 1.0, 1.0, "float64")
    bright = photo / np.quantile(photo[np.asarray(layers.has_air)], 0.9)
    codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(np.maximum(bright, 0))), 0, 1))
    Image.fromarray(codes.astype(np.uint8)).save(folder / "photo.png")
    result = fit(load_photo(folder / "photo.png"), layers)
    assert result.pixels["clipped_samples"] > 100
    return result


@pytest.mark.parametrize("case", ["gamma", "cauchy", "clipped"])
def test_the_gradient_at_the_end_is_rounding(case: str, tmp_path: Path) -> None:
    """The cosine between residuals and slopes, over all samples: a sum of n products of unit
    vectors is known to √n eps or so, and the slopes themselves to a few eps."""
    result = clipped(tmp_path) if case == "clipped" else fit_at(place_of(case))
    evidence = evidence_of(result)
    gram, count = evidence.end.gram, evidence.problem.count
    cosine = np.sqrt(_polish._promise(gram) / gram[-1, -1])
    assert cosine <= 4 * np.sqrt(count) * EPS
