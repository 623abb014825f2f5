"""The least square sum in closed form: against an eigenvector, against fits, against wrong ends."""

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
import pytest
import scipy.linalg

from fit import fit
from fit.solve import _opinion, _search
from fit.solve._descend import Descent
from fit.solve._parameters import free_directions
from fit.solve._problem import Problem
from fit.solve._search import End
from fit.solve._separable import Least, least_square_sum
from model_jax import Layers, LayersLook, Response, layer_widths
from tests.fit.looks import START, TRUTH, picture

NOISE = 0.02
CHANNELS = LayersLook(3.0, (0.2, 0.3, 0.4))


@pytest.fixture(scope="module")
def noisy(layers: Layers) -> np.ndarray:
    light = picture(layers, TRUTH)
    return light + np.random.default_rng(11).normal(scale=NOISE, size=light.shape)


def ends(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Problem, End]]:
    """What the searches of later fits ended with."""
    found: list[tuple[Problem, End]] = []
    original = _search.search

    def spy(problem: Problem, *arguments: Any, **more: Any) -> End:
        end = original(problem, *arguments, **more)
        found.append((problem, end))
        return end

    monkeypatch.setattr("fit._rounds.search", spy)
    return found


def least(problem: Problem, end: End) -> Least:
    reduced = jax.device_get(problem.reduced)
    found = least_square_sum(
        reduced, end.vector, end.free, problem.parameters, problem.model.layout
    )
    assert found is not None
    return found


def test_it_is_the_generalised_eigenvalue(
    noisy: np.ndarray, layers: Layers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """DESIGN §4: with one shadow weight and free tints the problem has rank one, and its optimum is
    the leading eigenvector of (Σ Aᵀy yᵀA, AᵀA), A = [lit dark]."""
    found = ends(monkeypatch)
    result = fit(noisy, layers, START, free=["brightness", "tint", "shadow"])
    (problem, end) = found[-1]
    with jax.enable_x64(True):
        exact = layer_widths(jax.tree.map(lambda a: np.asarray(a, np.float64), layers))
    widths = np.stack([np.asarray(width).ravel() for width in exact], axis=1)
    used = result.photos[0].used.ravel()
    light, design = noisy.reshape(-1, 3)[used], widths[used]
    toward = design.T @ light
    value = scipy.linalg.eigh(toward @ toward.T, design.T @ design, eigvals_only=True)[-1]
    expected = (light**2).sum() - value
    # Both are differences of sums of all light, known to some eps of these.
    room = 1e-12 * (light**2).sum()
    assert least(problem, end).square_sum == pytest.approx(expected, abs=room)


FREE: dict[str, tuple[LayersLook, Sequence[str] | None]] = {
    "all": (START, None),
    "brightness": (START, ["brightness"]),
    "shadow": (START, ["shadow"]),
    "tint": (START, ["tint", "shadow"]),
    "two tints": (START, ["tint.r", "tint.g", "shadow"]),
    "level": (START, ["brightness", "shadow", "black_level"]),
    "channels": (CHANNELS, None),
    "one channel": (CHANNELS, ["brightness", "tint", "shadow.r"]),
    "two channels": (CHANNELS, ["brightness", "shadow.r", "shadow.g"]),
}


@pytest.mark.parametrize("name", FREE)
def test_fits_end_at_it(
    name: str, noisy: np.ndarray, layers: Layers, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, free = FREE[name]
    found = ends(monkeypatch)
    result = fit(noisy, layers, start, free=free)
    assert result.second_opinion == "closed form"
    (problem, end) = found[-1]
    best = least(problem, end)
    # The scan ends within 1e-7 of the shadow weight's scale, which is second order here.
    assert best.square_sum == pytest.approx(end.square_sum, rel=1e-9)
    np.testing.assert_allclose(best.vector, end.vector, rtol=1e-4, atol=1e-5)


def test_several_exposures_need_a_second_descent(noisy: np.ndarray, layers: Layers) -> None:
    """Brightness times exposure is no sum."""
    dimmer = fit([noisy, noisy / 2], [layers, layers], START)
    assert dimmer.second_opinion == "same"
    known = fit(
        [noisy, noisy / 2],
        [layers, layers],
        START,
        free=["brightness", "shadow", "tint", "black_level"],
        response=[Response(), Response(exposure=0.5)],
    )
    assert known.second_opinion == "closed form"


@pytest.mark.parametrize("free", [["brightness", "shadow"], ["brightness", "shadow", "gamma"]])
def test_a_worse_end_is_told(
    free: list[str], noisy: np.ndarray, layers: Layers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An end that is no optimum is compared with a lower one, whichever way that is found."""
    found = ends(monkeypatch)
    fit(noisy, layers, START, free=free)
    (problem, end) = found[-1]
    wrong = end.vector.copy()
    wrong[0] *= 1.05
    words, better = _opinion.second_opinion(
        problem, wrong, problem.square_sum(wrong), end.free, "lm", wrong, 0.0
    )
    assert words == "lower"
    assert problem.square_sum(better) == pytest.approx(end.square_sum, rel=1e-6)


@pytest.mark.parametrize("free", [["brightness", "shadow"], ["brightness", "shadow", "gamma"]])
def test_a_descent_that_goes_nowhere_is_overruled(
    free: list[str], noisy: np.ndarray, layers: Layers, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second opinion's end becomes the fit's."""
    right = fit(noisy, layers, START, free=free)
    monkeypatch.setattr(
        _search,
        "_descend",
        lambda problem, held, *rest: Descent(held, True, 1, (1.0, 1.0)),
    )
    for module in (_search, _opinion):
        monkeypatch.setattr(
            module,
            "finish",
            lambda problem, vector, free: (
                vector,
                problem.gram(vector, free_directions(free, problem.parameters)[0]),
            ),
        )
    result = fit(noisy, layers, START, free=free)
    assert result.verdict == "converged"
    assert len(result.history) == 2
    # The accuracy of the check at the end, 1e-3 standard errors, and that of bins, which no exact
    # step follows here.
    for name in free:
        estimate = right.parameters[name]
        assert estimate.stderr is not None
        allowed = 1e-3 * estimate.stderr + 1e-5 * estimate.value
        assert result.parameters[name].value == pytest.approx(estimate.value, abs=allowed)
