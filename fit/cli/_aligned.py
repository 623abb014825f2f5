"""The camera that lays a scene's planet on the photo's."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from model_jax import Camera, Scene

from .._of_photo import Alignment


def aligned_camera(scene: Scene, found: Alignment) -> Camera:
    """The scene's camera, turned and zoomed so that its limb meets the photo's.

    The planet's centre is moved by the shift, its image scaled about itself; the limb of a planet
    that fills much of the view is moved so to first order only.
    """
    camera = scene.camera
    basis = np.asarray(camera.basis(), np.float64)
    center = -basis @ np.asarray(camera.position, np.float64)
    pixel = float(camera.pixel_size())
    seen = center[:2] / center[2] / pixel + np.array([found.right, -found.down])
    half = np.tan(np.radians(float(camera.fov_y_deg)) / 2) / found.scale
    wanted = np.append(seen * pixel / found.scale, 1.0)
    turn = Rotation.align_vectors(wanted, center)[0].as_matrix()  # the least that does
    return replace(
        camera,
        forward=(turn @ basis)[2],
        fov_y_deg=float(np.degrees(2 * np.arctan(half))),
    )


def camera_lines(camera: Camera) -> str:
    """What to write into the scene file, to a thousandth of a pixel."""
    forward = ", ".join(f"{value:.9f}" for value in np.asarray(camera.forward))
    return f"[camera] forward = [{forward}], fov_y_deg = {float(camera.fov_y_deg):.7g}"
