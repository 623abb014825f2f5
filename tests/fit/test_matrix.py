"""The matrix of fits: solver × problem × units × start × dtype, and no verdict that is wrong.

Each fit is judged by a model of its own, in NumPy and float64 on all pixels, whose optimum SciPy
finds from several starts. `python -m tests.fit.test_matrix` runs the whole matrix and lists every
verdict; words after it choose the rows that hold them all (`"gamma" " lm "`).
"""

import re
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from time import perf_counter

import jax
import numpy as np
import pytest
from scipy.optimize import least_squares

from fit import FitResult, Verdict, fit
from fit._choices import SOLVERS
from fit.solve._loss import TUNING
from model_jax import (
    Atmosphere,
    Camera,
    Layers,
    Look,
    Planet,
    Response,
    Scene,
    Sun,
    analytic_layers,
    layer_widths,
)

SCALES = (1e-8, 1.0, 1e8)
"""Of the photo's light, and of the length unit; brightness goes as their ratio."""

STARTS = ("near", "far", "bound")
DTYPES = ("float32", "float64")

TRUTH = np.array([3.0, 0.2, 0.8, 0.9, 1.3, 0.01, 1.0])
"""Brightness, shadow, three tints, background, gamma; brightness by the widths of unit 1."""

NAMES = ("brightness", "shadow", "tint.r", "tint.g", "tint.b", "background", "gamma")
LOOK = ("brightness", "shadow", "tint", "background")


@dataclass(frozen=True)
class Case:
    """A photo and what is asked of it."""

    name: str
    noise: float
    """Standard deviation, in light of the picture's own order (its maximum is 1.1)."""
    gamma: float = 1.0
    """Of the photo; free where it is not 1."""
    loss: str = "linear"
    outliers: float = 0.0
    """Share of pixels that show something bright that is no air."""

    @property
    def free(self) -> tuple[str, ...]:
        return LOOK if self.gamma == 1 else (*LOOK, "gamma")


CASES = (
    Case("linear", noise=0.05),
    Case("exact", noise=0.0),
    Case("gamma", noise=0.02, gamma=1.8),
    Case("huber", noise=0.02, loss="huber", outliers=0.05),
    Case("cauchy", noise=0.02, loss="cauchy", outliers=0.05),
)


@dataclass(frozen=True)
class Fit:
    """One fit of the matrix: its place, and what came out."""

    case: Case
    solver: str
    light: float
    length: float
    start: str
    dtype: str

    def __str__(self) -> str:
        place = f"{self.case.name} {self.solver} light {self.light:g} length {self.length:g}"
        return f"{place} {self.start} {self.dtype}"


@dataclass(frozen=True)
class Outcome:
    """What a fit said, beside what is true."""

    fit: Fit
    verdict: str
    excess: float
    """(cost - what is allowed) / what is allowed, which is the oracle's cost and rounding."""
    widening: float
    """Median over parameters of half its 95 % interval by 1.96 of the oracle's standard errors; NaN
    without."""
    seconds: float

    @property
    def is_wrong(self) -> bool:
        return self.verdict == "converged" and not self.excess <= 1e-6

    def __str__(self) -> str:
        flag = "  WRONG" if self.is_wrong else ""
        return (
            f"{self.fit!s:<62} {self.verdict:<17} {self.excess:+9.1e} {self.widening:6.2f}"
            f" {self.seconds:6.2f} s{flag}"
        )


def run(place: Fit) -> Outcome:
    """One fit, judged."""
    layers, photo = _photo(place.case, place.light, place.length, place.dtype)
    look, response = _start(place)
    begin = perf_counter()
    result = fit(
        photo,
        layers,
        look,
        free=place.case.free,
        response=response,
        loss=place.case.loss,
        sampling="point",
        solver=place.solver,
    )
    seconds = perf_counter() - begin
    dense = _Dense(place, layers, photo, result)
    x = dense.to_normal(result)
    best = dense.optimum()
    allowed = dense.cost(best) + dense.rounding
    widening = float("nan")
    intervals = [result.parameters[name].interval for name in dense.names]
    if place.case.noise and None not in intervals:  # where all is rounding there is no noise
        low, high = np.array(intervals, float).T
        oracle = 2 * 1.96 * dense.stderr(best) * dense.units
        widening = float(np.median((high - low) / oracle))
    return Outcome(place, result.verdict, dense.cost(x) / allowed - 1, widening, round(seconds, 3))


class _Dense:
    """The same fit in NumPy and float64, in numbers of order one, by other means.

    Its parameters: three amplitudes (brightness × tint), shadow, background, and gamma if free.
    """

    def __init__(self, place: Fit, layers: Layers, photo: np.ndarray, result: FitResult) -> None:
        self.place = place
        self.result = result
        with jax.enable_x64(True):
            raw = layer_widths(jax.tree.map(lambda a: np.asarray(a, np.float64), layers))
        used = result.used
        self.lit, self.dark = (np.asarray(w)[used] / place.length for w in raw if w is not None)
        self.light = photo[used].astype(np.float64) / place.light
        self.linear = place.case.gamma == 1
        count = self.light.size
        self.rounding = count * (np.finfo(np.float64).eps * np.abs(self.light).max()) ** 2
        self.scale = 1.0
        if place.case.loss != "linear":
            loss = result.evidence.problem.model.loss
            self.scale = float(loss.noise) * TUNING[loss.name] / place.light

    names = property(lambda self: NAMES[: 6 if self.linear else 7])

    @property
    def units(self) -> np.ndarray:
        """Of the fit's parameters, in this model's."""
        place = self.place
        gamma = 1.0 if self.linear else float(self.result.response.gamma)
        light = place.light**gamma
        return np.array([light / place.length, 1, 1, 1, 1, light, 1])[: len(self.names)]

    def to_normal(self, result: FitResult) -> np.ndarray:
        look, place = result.look, self.place
        gamma = float(result.response.gamma)
        light = place.light**gamma  # recorded light in units of `light` → light itself
        amplitude = np.float64(look.brightness) * np.asarray(look.tint) / light * place.length
        x = [*amplitude, float(look.shadow), float(look.background) / light]
        return np.array(x if self.linear else [*x, gamma])

    def predict(self, x: np.ndarray) -> np.ndarray:
        light = x[:3] * (self.lit + x[3] * self.dark)[:, None] + x[4]
        if self.linear:
            return light
        return np.sign(light) * np.abs(light) ** (1 / x[5])

    def residual(self, x: np.ndarray) -> np.ndarray:
        return (self.predict(x) - self.light).reshape(-1)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        width = self.lit + x[3] * self.dark
        light = x[:3] * width[:, None] + x[4]
        rows = np.zeros((*light.shape, len(x)))
        for k in range(3):
            rows[:, k, k] = width
        rows[:, :, 3] = x[:3] * self.dark[:, None]
        rows[:, :, 4] = 1.0
        if not self.linear:
            size = np.maximum(np.abs(light), 1e-300)
            rows *= (size ** (1 / x[5] - 1) / x[5])[..., None]
            rows[:, :, 5] = -np.sign(light) * size ** (1 / x[5]) * np.log(size) / x[5] ** 2
        return rows.reshape(-1, len(x))

    def cost(self, x: np.ndarray) -> float:
        z = (self.residual(x) / self.scale) ** 2
        loss = self.place.case.loss
        if loss == "huber":
            z = np.where(z <= 1, z, 2 * np.sqrt(z) - 1)
        elif loss == "cauchy":
            z = np.log1p(z)
        return float(z.sum()) * self.scale**2

    def optimum(self) -> np.ndarray:
        """SciPy's best of several starts."""
        key = (self.place.case, self.place.light, self.place.length, self.place.dtype)
        if key not in _optima:
            starts = [TRUTH[0] * TRUTH[2:5], np.full(3, 1.0), np.array([0.3, 3.0, 3.0])]
            tails = [(0.2, 0.01, self.place.case.gamma), (0.5, 0.0, 1.0), (0.01, 0.0, 1.4)]
            n = 5 if self.linear else 6
            found = [
                self._descend(np.array([*start, *tail])[:n])
                for start, tail in zip(starts, tails, strict=True)
            ]
            _optima[key] = min(found, key=self.cost)
        return self._descend(_optima[key])

    def _descend(self, x: np.ndarray) -> np.ndarray:
        lower = np.array([0, 0, 0, 0, -np.inf, 0.1])[: len(x)]
        upper = np.array([np.inf] * 5 + [10.0])[: len(x)]
        found = least_squares(
            self.residual,
            x,
            self.jacobian,
            bounds=(lower, upper),
            loss=self.place.case.loss,
            f_scale=self.scale,
            x_scale="jac",
            ftol=1e-15,
            xtol=1e-15,
            gtol=1e-15,
            max_nfev=300,
        )
        return np.asarray(found.x)

    def stderr(self, x: np.ndarray) -> np.ndarray:
        """Standard errors of the fit's parameters for white noise, of this loss."""
        residual, jacobian = self.residual(x), self.jacobian(x)
        z = residual / self.scale
        loss = self.place.case.loss
        if loss == "linear":
            score, curvature = residual, np.ones_like(z)
        elif loss == "huber":
            inner = np.abs(z) <= 1
            score = np.where(inner, residual, np.sign(z) * self.scale)
            curvature = inner.astype(float)
        else:
            score = residual / (1 + z**2)
            curvature = (1 - z**2) / (1 + z**2) ** 2
        hessian = jacobian.T @ (curvature[:, None] * jacobian)
        middle = jacobian.T @ jacobian * (score @ score) / (len(score) - len(x))
        inverse = np.linalg.inv(hessian)
        covariance = inverse @ middle @ inverse
        brightness = x[:3].mean()
        rows = np.zeros((len(self.names), len(x)))
        rows[0, :3] = 1 / 3
        rows[1, 3] = rows[5, 4] = 1.0
        rows[2:5, :3] = np.eye(3) / brightness - np.outer(x[:3], np.ones(3)) / 3 / brightness**2
        if not self.linear:  # a light of `light` is light ** gamma before the power
            rows[0, 5], rows[5, 5] = np.log(self.place.light) * np.array([brightness, x[4]])
            rows[6, 5] = 1.0
        return np.sqrt(np.diag(rows @ covariance @ rows.T))


_optima: dict[tuple[Case, float, float, str], np.ndarray] = {}


@cache
def _photo(case: Case, light: float, length: float, dtype: str) -> tuple[Layers, np.ndarray]:
    """Layers whose depths are in units of `length`, and the photo in units of `light`."""
    scene = Scene(
        camera=Camera(
            position=(0, 0, 3),
            forward=(0, 0, -1),
            up=(0, 1, 0),
            fov_y_deg=50,
            width=48,
            height=40,
            near=0.5,
            far=6,
        ),
        planet=Planet(radius=1.0),
        atmosphere=Atmosphere(height=0.2),
        sun=Sun(direction=(1, 0.2, 0.3)),
    )
    with jax.enable_x64(True):
        made = jax.tree.map(np.asarray, analytic_layers(scene, np.float64))

    def depth(values: np.ndarray) -> np.ndarray:
        return (values * length).astype(dtype)

    layers = Layers(
        depth(made.front),
        depth(made.back),
        depth(made.shadow_front),
        depth(made.shadow_back),
        planet=made.planet,
        width_unit=1.0,
    )
    with jax.enable_x64(True):
        raw = layer_widths(jax.tree.map(lambda a: np.asarray(a, np.float64), layers))
    lit, dark = (np.asarray(width) / length for width in raw if width is not None)
    brightness, shadow, background = TRUTH[0], TRUTH[1], TRUTH[5]
    picture = brightness * TRUTH[2:5] * (lit + shadow * dark)[..., None] + background
    picture = picture ** (1 / case.gamma)
    rng = np.random.default_rng(20261123)
    picture = picture + case.noise * rng.normal(size=picture.shape)
    outliers = rng.uniform(size=picture.shape[:2]) < case.outliers
    picture = picture + 2.0 * (outliers * rng.uniform(size=outliers.shape))[..., None]
    return layers, (picture * light).astype(dtype)


def _start(place: Fit) -> tuple[Look, Response]:
    """Near: 10 % off; far: 100 × off; bound: zero or the end of the range."""
    brightness = TRUTH[0] * place.light**place.case.gamma / place.length
    background = TRUTH[5] * place.light**place.case.gamma
    is_free = place.case.gamma != 1
    if place.start == "near":
        gamma = 0.9 * place.case.gamma if is_free else 1.0
        return Look(1.1 * brightness, 0.22, (1, 1, 1), 1.1 * background), Response(1, gamma)
    if place.start == "far":
        gamma = 10.0 if is_free else 1.0
        return Look(100 * brightness, 20.0, (1, 1, 1), 100 * background), Response(1, gamma)
    return Look(0.0, 0.0, (3, 0, 0), 0.0), Response(1, 0.1 if is_free else 1.0)


def whole() -> Iterator[Fit]:
    """Every combination."""
    places = product(CASES, SOLVERS, SCALES, SCALES, STARTS, DTYPES)
    return (Fit(*place) for place in places)


def sample() -> list[Fit]:
    """Each start of each loss by the default solver, and each other solver once.

    Units are a seeded draw. Each solver is compiled anew for each loss, gamma and dtype, which
    takes seconds: the other solvers are tried on linear light, in one dtype.
    """
    rng = np.random.default_rng(20261123)
    chosen = []
    for case, (k, solver), start in product(CASES, enumerate(SOLVERS), STARTS):
        light, length = rng.choice(SCALES, 2)
        if solver != "lm" and (case.name, start) != ("linear", STARTS[k % 3]):
            continue
        both = case.name == "linear" and solver == "lm"
        for dtype in DTYPES if both else (DTYPES[k % 2],):
            chosen.append(Fit(case, solver, float(light), float(length), start, dtype))
    return chosen


def table(outcomes: Sequence[Outcome]) -> str:
    """Verdicts by case and solver."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for outcome in outcomes:
        row = outcome.fit.case.name, outcome.fit.solver
        verdict = "WRONG" if outcome.is_wrong else outcome.verdict
        counts.setdefault(row, Counter())[verdict] += 1
    lines = [
        f"{case:<8} {solver:<13} " + ", ".join(f"{n} {verdict}" for verdict, n in count.items())
        for (case, solver), count in counts.items()
    ]
    return "\n".join(lines)


@pytest.fixture(scope="module", params=["sample", pytest.param("whole", marks=pytest.mark.full)])
def places(request: pytest.FixtureRequest) -> list[Fit]:
    return sample() if request.param == "sample" else list(whole())


@pytest.fixture(scope="module")
def listing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file in which all verdicts are listed."""
    return tmp_path_factory.mktemp("matrix") / "verdicts.txt"


@pytest.fixture(scope="module")
def outcomes(places: list[Fit], listing: Path) -> list[Outcome]:
    """All verdicts, which are also listed in a file and, when a test fails, in its output."""
    found = [run(place) for place in places]
    listing.write_text("\n".join(map(str, found)))
    print(listing.read_text(), table(found), sep="\n")
    return found


def test_the_matrix_is_whole() -> None:
    """And its sample has each case, solver, start, unit and dtype at least once."""
    everything, some = [str(place) for place in whole()], sample()
    assert len(everything) == len(set(everything)) == 5 * 3 * 3 * 3 * 3 * 2
    assert {str(place) for place in some} <= set(everything)
    assert {place.case for place in some} == set(CASES)
    assert {place.solver for place in some} == set(SOLVERS)
    assert {place.light for place in some} == {place.length for place in some} == set(SCALES)
    assert {(place.start, place.dtype) for place in some} == set(product(STARTS, DTYPES))


def test_every_verdict_is_listed(places: list[Fit], outcomes: list[Outcome], listing: Path) -> None:
    """One row for each combination, in the words that the command line chooses rows by."""
    rows = [line.split("  ")[0] for line in listing.read_text().splitlines()]
    assert rows == [str(place) for place in places]
    assert len(set(rows)) == len(rows)
    verdicts = {verdict.label for verdict in Verdict}
    assert all(outcome.verdict in verdicts for outcome in outcomes)
    summed = table(outcomes).splitlines()
    assert len(summed) == len({(place.case, place.solver) for place in places})
    assert sum(int(n) for line in summed for n in re.findall(r" (\d+) ", line)) == len(rows)


def test_no_verdict_is_wrong(outcomes: list[Outcome]) -> None:
    """`converged` means the cost is the oracle's, to 1e-6 and n roundings of the brightest."""
    wrong = [str(outcome) for outcome in outcomes if outcome.is_wrong]
    assert not wrong, "\n".join(wrong)


def test_caution_hides_nothing(outcomes: list[Outcome]) -> None:
    """The photo tells all that is asked here: 99 % converge, with errors not blown up.

    The widening is of a sandwich over blocks, for white noise: 1 in the mean, but for Student's t.
    """
    for solver in SOLVERS:
        mine = [outcome for outcome in outcomes if outcome.fit.solver == solver]
        missed = [str(outcome) for outcome in mine if outcome.verdict != "converged"]
        assert len(missed) <= 0.01 * len(mine), "\n".join(missed)
        widening = np.nanmedian([outcome.widening for outcome in mine])
        assert 1 / 1.5 <= widening <= 1.5, solver


if __name__ == "__main__":
    outcomes = []
    for place in whole():
        if len(sys.argv) > 1 and not all(word in str(place) for word in sys.argv[1:]):
            continue
        outcomes.append(run(place))
        print(outcomes[-1], flush=True)
    print(table(outcomes))
