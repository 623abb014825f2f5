"""Known looks on a small scene, and independent measures of how well a fit found them."""

import jax
import numpy as np
from scipy.optimize import minimize_scalar

from fit import FitResult
from fit.diagnose._evidence import Evidence
from model_jax import (
    Atmosphere,
    Camera,
    Layers,
    LayersLook,
    Look,
    Planet,
    Scene,
    Sun,
    analytic_layers,
    composite,
    layer_widths,
)

TRUTH = LayersLook(brightness=3.0, shadow=0.2, tint=(0.8, 0.9, 1.3), background=0.01)
START = LayersLook(brightness=1.0, shadow=0.5)


def scene(unit: float = 1.0, sun: bool = True) -> Scene:
    """A thick shell all around a planet that the sun lights from the right; lengths × `unit`."""
    return Scene(
        camera=Camera(
            position=(0, 0, 3 * unit),
            forward=(0, 0, -1),
            up=(0, 1, 0),
            fov_y_deg=50,
            width=160,
            height=128,
            near=0.5 * unit,
            far=6 * unit,
        ),
        planet=Planet(radius=unit),
        atmosphere=Atmosphere(height=0.2 * unit),
        sun=Sun(direction=(1, 0.2, 0.3)) if sun else None,
    )


def exact_layers(seen: Scene) -> Layers:
    """In float64, and NumPy's, so that JAX's settings leave them as they are."""
    with jax.enable_x64(True):
        return jax.tree.map(np.asarray, analytic_layers(seen, np.float64))


def picture(layers: Layers, look: Look) -> np.ndarray:
    return np.asarray(composite(layers, look))[..., :3]


def check_values(result: FitResult, truth: LayersLook, tolerance: float) -> None:
    assert result.verdict == "converged", result.message
    for name in ("brightness", "shadow", "tint", "background"):
        np.testing.assert_allclose(
            getattr(result.look, name),
            getattr(truth, name),
            rtol=tolerance,
            atol=tolerance * 0.1,  # the background is a tenth of what is bright in the picture
            err_msg=name,
        )


def evidence_of(result: FitResult) -> Evidence:
    """Samples and end point of the fit."""
    assert isinstance(result.evidence, Evidence)
    return result.evidence


def square_sum(photo: np.ndarray, layers: Layers, result: FitResult) -> float:
    with jax.enable_x64(True):
        residual = picture(layers, result.look) - photo
    return float((residual[result.used] ** 2).sum())


def oracle(photo: np.ndarray, layers: Layers, used: np.ndarray) -> tuple[float, float]:
    """Least square sum, and its shadow weight, by a search in the one weight (DESIGN §4).

    Given the weight, brightness × tint and the background are linear: NumPy's lstsq on all pixels.
    """
    with jax.enable_x64(True):
        widths = layer_widths(layers)
    lit, dark = (np.asarray(width)[used] for width in widths if width is not None)
    target = photo[used].T.reshape(-1)

    def cost(shadow: float) -> float:
        matrix = np.kron(np.eye(3), (lit + shadow * dark)[:, None])
        matrix = np.column_stack([matrix, np.ones_like(target)])
        solution = np.linalg.lstsq(matrix, target, rcond=None)[0]
        return float(((matrix @ solution - target) ** 2).sum())

    grid = np.linspace(0, 3, 61)
    middle = int(np.argmin([cost(s) for s in grid]))
    best = minimize_scalar(
        cost,
        bounds=(grid[max(middle - 1, 0)], grid[min(middle + 1, 60)]),
        method="bounded",
        options={"xatol": 1e-10},
    )
    return float(best.fun), float(best.x)


def to_values(result: FitResult) -> dict[str, float]:
    return {name: estimate.value for name, estimate in result.parameters.items()}
