"""What was asked of a fit, once it is checked."""

from dataclasses import dataclass

from model_jax import Layers, Look

from .._choices import JpegHandling, LossName, Sampling
from .._selection import Selection
from ..photo._columns import PhotoLike, size_of
from ._layout import Layout
from ._parameters import Entries, FitParameter


@dataclass(frozen=True)
class Task:
    """What was asked."""

    photos: tuple[PhotoLike, ...]
    layers: tuple[Layers, ...]
    """Without shadows that the look does not ask for."""
    given: tuple[Layers, ...]
    """The same as they were given: what is asked of the light alone hangs on no look."""
    look: Look
    parameters: tuple[FitParameter, ...]
    loss: LossName
    jpeg: JpegHandling
    sampling: Sampling
    solver: str
    max_steps: int
    named: bool
    """The user named what is free."""
    selection: Selection | None = None
    """How the look's terms were chosen; None where they were named."""
    seed: Entries | None = None
    """Where choosing them ended, and the fit begins."""

    @property
    def blurs(self) -> bool:
        """The photos have a blur."""
        return any(p.family == "blur" for p in self.parameters)

    @property
    def layout(self) -> Layout:
        return Layout(type(self.look), self.blurs)

    @property
    def sizes(self) -> list[tuple[int, int]]:
        return [size_of(photo) for photo in self.photos]
