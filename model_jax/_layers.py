"""Depth layers, and the one way from depth textures to them.

    DepthTextures (values, encoding) ── linearize ──> Layers (relative eye depth)

`Layers` is what the combine reads, whoever made it: the rasteriser, the analytic intersection or
somebody's own renderer. What a scene does not need is absent (`None`), never zero-filled.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._errors import InputError
from ._safe import is_host
from ._shapes import AnyArray, Depth, Mask, Rgb, Scalar, Shadows

Encoding = Literal["window", "reversed", "linear"]
"""What a depth texture's numbers are: window depth in [0, 1] with the near plane at 0, "reversed"
with the near plane at 1, or eye depth."""


def _array(value: object) -> AnyArray:
    return value if isinstance(value, jax.Array) else np.asarray(value, dtype=np.float64)


class Layers(eqx.Module):
    """Where each pixel's ray enters and leaves the air and the shadow, as eye depth.

    Depths are relative to `reference`, because at a million kilometres plain float32 eye depth
    resolves only a tenth of a kilometre. Widths are differences, so the reference cancels.
    A pixel that no air covers has `front == back`.
    """

    front: Depth
    """Where the ray enters the air (the near plane for a camera inside)."""
    back: Depth
    """Where it leaves the air or hits the planet."""
    shadow_front: Shadows | None = None
    """Where it enters the shadow volume; not clamped to the air. `None`: nothing is in shadow.
    [n, h, w] for the shadows of n bodies, which may overlap."""
    shadow_back: Shadows | None = None
    """Where it leaves the shadow volume; equal to `shadow_front` where the ray misses it."""
    surface: Rgb | None = None
    """Light of the planet's surface in front of which the air lies; 0 where there is none."""
    planet: Float[AnyArray, "h w"] | None = None
    """1 where the planet or an occluder ends the ray, 0 where space does; `None` when nobody
    knows."""
    color: Float[AnyArray, "4"] = eqx.field(converter=_array, default=(1.0, 1.0, 1.0, 1.0))
    """Linear RGB and alpha of the air (the shell's vertex colour in the paper)."""
    reference: Scalar = 0.0
    """Eye depth that the depths are relative to; float64 on the host."""
    width_unit: Scalar = 1.0
    """Length that widths are divided by: far − near, as in the paper."""
    stretch: Float[AnyArray, "h w"] | None = None
    """Length along the ray for each unit of eye depth, at least 1, where widths are lengths along
    rays; `None` where they are eye depths, as in the paper."""
    width_error: Float[AnyArray, "h w"] | None = None
    """How far widths may be off by what drew the layers, scene length units; `None`: they are as
    exact as their numbers."""

    def __check_init__(self) -> None:
        if np.shape(self.color) != (4,):
            raise InputError(
                f"layers.color: {self.color} must be four numbers [red, green, blue, alpha]"
            )
        front, back = (() if s is None else s.shape for s in (self.shadow_front, self.shadow_back))
        if front != back:
            raise InputError(
                f"layers: shadow_front has shape {front} and shadow_back {back}; give both, of one "
                "shape, or none"
            )

    @property
    def has_shadow(self) -> bool:
        return self.shadow_front is not None

    def rows(self, band: slice) -> "Layers":
        """The layers of some rows of the picture."""

        def some(part: AnyArray | None) -> AnyArray | None:
            return None if part is None else part[..., band, :]

        return Layers(
            self.front[band],
            self.back[band],
            some(self.shadow_front),
            some(self.shadow_back),
            None if self.surface is None else self.surface[band],
            some(self.planet),
            self.color,
            self.reference,
            self.width_unit,
            some(self.stretch),
            some(self.width_error),
        )

    @property
    def has_air(self) -> Mask:
        """True where the ray passes through any air."""
        return self.front != self.back


class DepthTextures(eqx.Module):
    """What a depth-pass renderer leaves behind, before linearisation.

    Eye depth of the "linear" encoding is relative to `reference`.
    """

    front: Float[AnyArray, "h w"]
    back: Float[AnyArray, "h w"]
    shadow_front: Shadows | None
    shadow_back: Shadows | None
    near: Scalar
    far: Scalar
    encoding: Encoding = eqx.field(static=True)
    reference: Scalar = 0.0

    def linearize(self) -> Layers:
        """`Layers` without surface, planet mask or colour (the renderer adds what it drew)."""

        linear, is_reversed = self.encoding == "linear", self.encoding == "reversed"

        def depth(texture: AnyArray) -> AnyArray:
            if linear:
                return texture
            return linearize_depth(texture, self.near, self.far, is_reversed)

        shadow_front, shadow_back = self.shadow_front, self.shadow_back

        return Layers(
            front=depth(self.front),
            back=depth(self.back),
            shadow_front=None if shadow_front is None else depth(shadow_front),
            shadow_back=None if shadow_back is None else depth(shadow_back),
            reference=self.reference if linear else 0.0,
            width_unit=self.far - self.near,
        )


def depth_constants(near: Scalar, far: Scalar, is_reversed: bool = False) -> tuple[Scalar, Scalar]:
    """`a = far / (far - near)`, `b = far·near / (near - far)` of the paper's ZParam.

    Of a reversed window depth, `near (far - z) / (z (far - near))`, solved for z likewise:
    `a = near / (near - far)`, `b = far·near / (far - near)`.
    """
    if is_reversed:
        return near / (near - far), far * near / (far - near)
    return far / (far - near), far * near / (near - far)


def linearize_depth(
    window: Float[AnyArray, "*shape"], near: Scalar, far: Scalar, is_reversed: bool = False
) -> Float[AnyArray, "*shape"]:
    """Eye depth of a window depth: `z = b / (window - a)`.

    The paper, "Depth Buffer Linearization".

    Args:
        window: depth-buffer values in [0, 1], any shape; near plane = 0, far plane = 1.
        is_reversed: near plane = 1, far plane = 0.
        near, far: eye depths of the clip planes, 0 < near < far, any length unit.

    Returns:
        Eye depth (distance along the camera's axis) in the unit of `near`, in `window`'s dtype. The
        two constants are computed in float64 on the host when `near` and `far` are plain numbers.

    Twin: `linearize_depth` in `combine.glsl`.
    """
    window = jnp.asarray(window)
    a, b = depth_constants(near, far, is_reversed)
    if is_host(near, far):
        a, b = jnp.asarray(a, window.dtype), jnp.asarray(b, window.dtype)
    return b / (window - a)
