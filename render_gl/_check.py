"""`airlight check`: the renderer examined on one scene, in figures and pictures."""

from dataclasses import dataclass

from model_jax import Look, Scene

from ._accuracy import Accuracy, measure_accuracy
from ._draw import DepthFormat, draw
from ._parity import Parity, compare, measure_division


@dataclass(frozen=True)
class Check:
    """Both halves of the cross-check."""

    parity: Parity
    """GLSL combine against JAX combine on the same depths."""
    accuracy: Accuracy
    """Rasterised widths against exact ones, for the smooth sphere."""

    @property
    def passed(self) -> bool:
        return self.parity.passed and self.accuracy.passed

    def summary(self) -> dict[str, object]:
        """Figures of both, as JSON data."""
        return {
            "passed": self.passed,
            "parity": self.parity.summary(),
            "accuracy": self.accuracy.summary(),
        }


def check_scene(scene: Scene, look: Look, depth_format: DepthFormat = "window24") -> Check:
    """Render, recombine in JAX, compare; and compare the layers with exact intersection.

    Raises as `render`.
    """
    frame = draw(scene, look, depth_format)
    division = 0.0 if depth_format == "linear" else measure_division(scene)
    return Check(
        parity=compare(scene, look, frame, depth_format, division),
        accuracy=measure_accuracy(scene, depth_format),
    )
