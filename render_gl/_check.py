"""`airlight check`: the renderer examined on one scene, in figures and pictures."""

from dataclasses import dataclass
from typing import Any

from model_jax import Look, Scene

from ._accuracy import Accuracy, measure_accuracy
from ._choices import Source
from ._depth_format import Choice, choose_format
from ._draw import draw
from ._parity import Parity, compare, measure_division


@dataclass(frozen=True)
class Check:
    """Both halves of the cross-check."""

    choice: Choice
    """The depth format, and why."""
    source: Source
    parity: Parity
    """GLSL combine against JAX combine on the same depths."""
    accuracy: Accuracy
    """Rasterised widths against exact ones, for the smooth sphere."""

    @property
    def passed(self) -> bool:
        return self.parity.passed and self.accuracy.passed

    def summary(self) -> dict[str, Any]:
        """Figures of both, as JSON data."""
        return {
            "passed": self.passed,
            "depth": self.choice.depth_format,
            "depth_error": self.choice.error,
            "depth_reason": self.choice.reason,
            "source": self.source,
            "parity": self.parity.summary(),
            "accuracy": self.accuracy.summary(),
        }


def check_scene(
    scene: Scene, look: Look, depth_format: str = "auto", source: Source = "raster"
) -> Check:
    """Render, recombine in JAX, compare; and compare the layers with exact intersection.

    Raises as `render`.
    """
    choice = choose_format(scene, depth_format)
    frame = draw(scene, look, choice.depth_format, source)
    division = measure_division(scene, choice.depth_format)
    return Check(
        choice=choice,
        source=source,
        parity=compare(scene, look, frame, choice.depth_format, division),
        accuracy=measure_accuracy(scene, choice.depth_format, source),
    )
