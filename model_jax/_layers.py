"""Depth layers, and the one way from depth textures to them.

    DepthTextures (values, encoding) ── linearize ──> Layers (relative eye depth)

`Layers` is what the combine reads, whoever made it: the rasteriser, the analytic intersection or
somebody's own renderer. What a scene does not need is absent (`None`), never zero-filled.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ._choices import ENCODINGS, Encoding
from ._errors import InputError, shown
from ._kinds import as_jax, need, need_array, need_number
from ._safe import is_host
from ._shapes import AnyArray, Depth, Four, Mask, Rgb, Scalar, Shadows, converter
from ._view import View

_MAPS = (
    "front",
    "back",
    "shadow_front",
    "shadow_back",
    "planet",
    "water",
    "stretch",
    "width_error",
)
"""Fields of `Layers` that end in rows and columns."""


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
    color: Four = eqx.field(converter=converter("layers.color"), default=(1.0, 1.0, 1.0, 1.0))
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
    view: View | None = None
    """How the pixels' rays pass planet, shell and shadows, which tells how high their air is, and
    what lies between pixels; `None` when nobody knows."""
    water: Float[AnyArray, "h w"] | None = None
    """How much of the ground mirrors, 0 to 1; `None`: nothing is known to."""
    is_albedo: bool = eqx.field(static=True, default=False)
    """The surface is the ground's albedo, which no sun has lit yet: for looks that light it
    themselves (`Look.LIGHTS_GROUND`)."""

    def __check_init__(self) -> None:
        if np.shape(self.color) != (4,):
            raise InputError(
                f"layers.color: {shown(self.color)} must be four numbers [red, green, blue, alpha]"
            )
        _need_depths("layers", self)
        for name in ("surface", "planet", "water", "stretch", "width_error"):
            if (part := getattr(self, name)) is not None:
                need_array(f"layers.{name}", part, "[h, w, 3]" if name == "surface" else "[h, w]")
        for name in ("reference", "width_unit"):
            need_number(f"layers.{name}", getattr(self, name))
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
        need("band", band, slice)

        maps = {name: getattr(self, name) for name in _MAPS}
        some: dict[str, Any] = {
            name: part[..., band, :] for name, part in maps.items() if part is not None
        }
        view = (
            None if self.view is None else self.view.from_pixel(0, range(len(self.front))[band][0])
        )
        surface = None if self.surface is None else self.surface[band]
        return replace(self, surface=surface, view=view, **some)

    @property
    def has_air(self) -> Mask:
        """True where the ray passes through any air."""
        return self.front != self.back


class DepthTextures(eqx.Module):
    """What a depth-pass renderer leaves behind, before linearisation.

    Eye depth of the "linear" encoding is relative to `reference`. `far` may be infinite in window
    and reversed depths.
    """

    front: Float[AnyArray, "h w"]
    back: Float[AnyArray, "h w"]
    shadow_front: Shadows | None
    shadow_back: Shadows | None
    near: Scalar
    far: Scalar
    encoding: Encoding = eqx.field(static=True)
    reference: Scalar = 0.0
    constant: Scalar = 1.0
    """C of logarithmic depths (see `linearize_depth`)."""

    def __check_init__(self) -> None:
        _need_depths("textures", self)
        _need_coding(self.encoding, self.near, self.far, self.constant)
        need_number("reference", self.reference)

    def linearize(self) -> Layers:
        """`Layers` without surface, planet mask or colour (the renderer adds what it drew).

        Widths are divided by far − near, and by the length unit where the far plane is infinite.
        """
        linear = self.encoding == "linear"

        def depth(texture: AnyArray) -> AnyArray:
            if linear:
                return texture
            return linearize_depth(texture, self.near, self.far, self.encoding, self.constant)

        shadow_front, shadow_back = self.shadow_front, self.shadow_back
        front, back = depth(self.front), depth(self.back)
        endless = is_host(self.far) and bool(np.isinf(self.far))
        if endless:  # pixels without air are at the far plane: no width is infinity less infinity
            no_air = jnp.isinf(front)
            front, back = (jnp.where(no_air, self.near, part) for part in (front, back))
        return Layers(
            front=front,
            back=back,
            shadow_front=None if shadow_front is None else depth(shadow_front),
            shadow_back=None if shadow_back is None else depth(shadow_back),
            reference=self.reference if linear else 0.0,
            width_unit=1.0 if endless else self.far - self.near,
        )


def _need_depths(owner: str, record: "Layers | DepthTextures") -> None:
    """Raise `InputError` for depths that are no arrays."""
    for name in ("front", "back", "shadow_front", "shadow_back"):
        depths = getattr(record, name)
        if depths is not None or name in ("front", "back"):
            several = ", of several shadows [n, h, w]" if name.startswith("shadow") else ""
            need_array(f"{owner}.{name}", depths, f"[h, w]{several}")


def _need_coding(encoding: object, near: Scalar, far: Scalar, constant: Scalar = 1.0) -> None:
    """Raise `InputError` for an unknown encoding, and for planes and constants that cannot be."""
    if encoding not in ENCODINGS:
        raise InputError(
            f"encoding: {shown(encoding)} is unknown; use one of {', '.join(ENCODINGS)}"
        )
    for name, number in (("near", near), ("far", far), ("constant", constant)):
        need_number(name, number)
    if encoding == "linear" or not is_host(near, far, constant):
        return
    if not 0 < near < far:
        raise InputError(
            f"near, far: {shown(near)} and {shown(far)} are no clip planes; give 0 < near < far"
        )
    if not 0 < constant < np.inf:
        raise InputError(f"constant: {shown(constant)} must be finite and above 0")


def depth_constants(
    near: Scalar, far: Scalar, encoding: Encoding = "window"
) -> tuple[Scalar, Scalar]:
    """`a = far / (far - near)`, `b = far·near / (near - far)` of the paper's ZParam.

    Of a reversed window depth, `near (far - z) / (z (far - near))`, solved for z likewise:
    `a = near / (near - far)`, `b = far·near / (far - near)`. An infinite far plane is their limit.

    Raises `InputError` for other encodings, which have no such constants.
    """
    _need_coding(encoding, near, far)
    if encoding not in ("window", "reversed"):
        raise InputError(f"encoding: {encoding!r} depths have no such constants; use window ones")
    is_reversed = encoding == "reversed"
    if is_host(near, far) and np.isinf(far):
        return (0.0, near) if is_reversed else (1.0, -near)
    if is_reversed:
        return near / (near - far), far * near / (far - near)
    return far / (far - near), far * near / (near - far)


def linearize_depth(
    depth: Float[AnyArray, "*shape"],
    near: Scalar,
    far: Scalar,
    encoding: Encoding = "window",
    constant: Scalar = 1.0,
) -> Float[AnyArray, "*shape"]:
    """Eye depth of what a depth texture holds.

        window, reversed   z = b / (depth - a)                        (`depth_constants`)
        log                z = ((C·far + 1)^depth - 1) / C            with the constant C
        linear             z = depth

    The paper, "Depth Buffer Linearization"; the logarithm is that of Outerra ("Maximizing depth
    buffer range and precision", 2012) and, with C = 1, of three.js.

    Args:
        depth: depth-buffer values in [0, 1], any shape; the far plane is at 1, of reversed ones at
            0. The near plane is at the other end, but for logarithmic ones, which begin at the eye.
        near, far: eye depths of the clip planes, 0 < near < far, any length unit; `far` may be
            infinite for window and reversed depths. Logarithmic ones do not use `near`.
        constant: C > 0, in one over the length unit.

    Returns:
        Eye depth (distance along the camera's axis) in the unit of `near`, in `depth`'s dtype;
        exactly `near` and `far` at the clip planes, and never outside of them. The constants are
        computed in float64 on the host when `near` and `far` are plain numbers.

    Raises `InputError` for an unknown encoding and impossible planes, where not traced.

    Twin: `linearize_depth` in `fields.glsl`.
    """
    _need_coding(encoding, near, far, constant)
    depth = as_jax("depth", depth)
    if encoding == "linear":
        return depth
    at_far = 0.0 if encoding == "reversed" else 1.0
    if encoding == "log":
        xp = np if is_host(far, constant) else jnp
        steepness = jnp.asarray(xp.log1p(constant * far), depth.dtype)
        found = jnp.expm1(depth * steepness) / jnp.asarray(constant, depth.dtype)
        return jnp.where(depth == at_far, jnp.asarray(far, depth.dtype), found)
    a, b = depth_constants(near, far, encoding)
    if is_host(near, far):
        a, b = jnp.asarray(a, depth.dtype), jnp.asarray(b, depth.dtype)
    near, far = jnp.asarray(near, depth.dtype), jnp.asarray(far, depth.dtype)
    divisor = depth - a
    # a may round to the far plane's value.
    found = jnp.clip(b / jnp.where(divisor == 0, 1, divisor), near, far)
    return jnp.where(depth == at_far, far, jnp.where(depth == 1 - at_far, near, found))
