"""What a drawing leaves, whatever drew it, and how shaders get their uniforms."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

if TYPE_CHECKING:
    import moderngl


@dataclass(frozen=True)
class Frame:
    """What the passes left, as images with row 0 on top."""

    air: Float[np.ndarray, "h w 4"]
    """The combine shader's output."""
    front: Float[np.ndarray, "h w"]
    """Its own depth."""
    back: Float[np.ndarray, "h w"]
    """What it read behind the air; equal to `front` without air."""
    shadows: Float[np.ndarray, "n 2 h w"]
    """What it read of each shadow that was drawn: front and back."""
    surface: Float[np.ndarray, "h w 3"] | None
    """Light of the planet; None where it has no albedo."""
    is_albedo: bool
    """It is the ground's albedo, which the look lights."""
    planet: Float[np.ndarray, "h w"]
    """1 where the planet was drawn."""
    water: Float[np.ndarray, "h w"] | None = None
    """How much of the ground mirrors; None where nobody asks, or the scene does not know."""
    transmittance: Float[np.ndarray, "h w 3"] | None = None
    """How much of what lies behind passes the air; None where the look says nothing of it."""
    drawn: int = 0
    """Draw calls that it took."""


def assign_uniforms(shader: "moderngl.Program", values: dict[str, Any]) -> None:
    """Give a program its uniforms by name; one that `values` lacks is a `KeyError`."""
    import moderngl

    for name in shader:
        member = shader[name]
        if isinstance(member, moderngl.Uniform):
            value = values[name]
            # moderngl takes an array of one element for that element.
            single = isinstance(value, list) and len(value) == 1
            member.value = value[0] if single else value
