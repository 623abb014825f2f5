"""Small problems with known answers: cases, photos, starts, and the same fit by other means."""

from dataclasses import dataclass
from functools import cache

import jax
import numpy as np
from scipy.optimize import least_squares

from fit import FitResult
from fit.solve._loss import TUNING
from model_jax import (
    Atmosphere,
    Camera,
    Layers,
    LayersLook,
    Planet,
    Response,
    Scene,
    Sun,
    analytic_layers,
    layer_widths,
)
from tests.fit.looks import evidence_of

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


class Dense:
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
            loss = evidence_of(result).problem.model.loss
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
def photo_of(case: Case, light: float, length: float, dtype: str) -> tuple[Layers, np.ndarray]:
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


def start_of(place: Fit) -> tuple[LayersLook, Response]:
    """Near: 10 % off; far: 100 × off; bound: zero or the end of the range."""
    brightness = TRUTH[0] * place.light**place.case.gamma / place.length
    background = TRUTH[5] * place.light**place.case.gamma
    is_free = place.case.gamma != 1
    if place.start == "near":
        gamma = 0.9 * place.case.gamma if is_free else 1.0
        return LayersLook(1.1 * brightness, 0.22, (1, 1, 1), background=1.1 * background), Response(
            1, gamma
        )
    if place.start == "far":
        gamma = 10.0 if is_free else 1.0
        return LayersLook(100 * brightness, 20.0, (1, 1, 1), background=100 * background), Response(
            1, gamma
        )
    return LayersLook(0.0, 0.0, (3, 0, 0), background=0.0), Response(1, 0.1 if is_free else 1.0)
