"""`align`: a scene's camera, turned and zoomed so that its planet lies on the photo's.

photo, scene ──draw──> planet's mask ──> limb beside the photo's ──> camera ─┐
                 └────────────────── until they meet ───────────────────────┘
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import ArrayLike
from scipy.spatial.transform import Rotation

from model_jax import Camera, InputError, Layers, Scene, analytic_layers
from model_jax._kinds import need

from ._of_photo import Alignment
from .diagnose._alignment import FOUND_PX, OFF_PX, alignment_of
from .photo._columns import size_of
from .photo._photo import Photo

MET_PX = 0.02
"""Distance of two limbs, px, at which they have met: a tenth of what their places are known to."""
_ROUNDS = 6
"""Each leaves a tenth of the distance or less, of wide views a quarter."""


def align(photo: Photo | ArrayLike, scene: Scene) -> Scene:
    """The scene as seen by a camera in which its limb lies on the photo's.

    Shift and scale come from the photo's own limb, as far as it is lit: the camera's `forward` is
    turned and its `fov_y_deg` changed, to a tenth of a pixel or so. Roll is kept: a sphere's limb
    tells none. Where half a limb is lit, shift and scale are told together only; what is seen lies
    right, the rest may not. Everything else of the scene stays.

    Args:
        photo: a loaded photo, or linear light [h, w, 3] as floats, of the scene's size.
        scene: its limb within 12 px of the photo's. Relief counts as none.

    Raises:
        InputError: wrong types or sizes, no limb is seen there, or none that can be met to a
            pixel.
    """
    need("scene", scene, Scene)
    if not isinstance(photo, Photo | np.ndarray | jax.Array):
        raise InputError(
            f"photo: is of type {type(photo).__name__}; give what load_photo returns, or linear "
            "light as an array [height, width, 3] of floats"
        )
    return aligned(photo, scene, _exact)[0]


def aligned(
    photo: Photo | np.ndarray | jax.Array, scene: Scene, draw: Callable[[Scene], Layers]
) -> tuple[Scene, Alignment | None]:
    """`align` with layers drawn by anybody, and how far the photo's limb lay off before; None where
    the scene stays as it is."""
    height, width = size_of(photo)
    camera = scene.camera
    if (height, width) != (camera.height, camera.width):
        raise InputError(
            f"align: the photo has {width}×{height} pixels, the scene's camera "
            f"{camera.width}×{camera.height}; give scene.resized({width}, {height})"
        )
    first = found = alignment_of(photo, draw(scene))
    if first is None or found is None:
        raise InputError(
            f"align: no limb of the planet is seen within {FOUND_PX:.0f} px of the scene's; turn "
            "camera.forward toward it first, or leave the scene as it is"
        )
    mended = scene
    for _ in range(_ROUNDS):
        if found.off <= MET_PX:
            break
        moved = replace(mended, camera=aligned_camera(mended, found))
        again = alignment_of(photo, draw(moved))
        if again is None or again.off >= found.off:
            break  # as near as edges tell
        mended, found = moved, again
    if found.off > OFF_PX:
        raise InputError(
            f"align: the photo's limb, whose edges lie within {found.rms:.1f} px of one, stays "
            f"{found.off:.1f} px beside the scene's however the camera is turned; leave the scene "
            "as it is, or check camera.position and planet.radius"
        )
    return mended, None if mended is scene else first


def _exact(scene: Scene) -> Layers:
    return analytic_layers(scene)


def aligned_camera(scene: Scene, found: Alignment) -> Camera:
    """The scene's camera, turned and zoomed so that its limb meets the photo's.

    The planet's centre is moved by the shift, its image scaled about itself. Where the centre is
    not in the picture, as from an orbit, size and place of an arc are one: the picture's middle is
    moved by what both make of the limb there. Either is so to first order.
    """
    camera = scene.camera
    basis = np.asarray(camera.basis(), np.float64)
    center = -basis @ np.asarray(camera.position, np.float64)
    pixel = float(camera.pixel_size())
    half = np.tan(np.radians(float(camera.fov_y_deg)) / 2)
    shift = np.array([found.right, -found.down])
    frame = np.array([camera.width, camera.height]) / 2 * pixel
    if center[2] > 0 and (np.abs(center[:2]) <= frame * center[2]).all():
        start = center / center[2]
        half /= found.scale
        wanted = (start[:2] + shift * pixel) / found.scale
    else:
        start = np.array([0.0, 0.0, 1.0])
        wanted = pixel * (shift - found.outward * center[:2] / np.linalg.norm(center[:2]))
    turn = Rotation.align_vectors(np.append(wanted, 1.0), start)[0].as_matrix()  # the least
    return replace(
        camera,
        forward=(turn @ basis)[2],
        fov_y_deg=float(np.degrees(2 * np.arctan(half))),
    )


def camera_lines(camera: Camera) -> str:
    """What to write into the scene file, to a thousandth of a pixel."""
    forward = ", ".join(f"{value:.9f}" for value in np.asarray(camera.forward))
    return f"[camera] forward = [{forward}], fov_y_deg = {float(camera.fov_y_deg):.7g}"
