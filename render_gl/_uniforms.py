"""What the shaders are told: numbers from scene and look, computed in float64, and switches."""

from typing import Any

import numpy as np

from model_jax import Camera, Encoding, Look, Scene, Sun, depth_constants, eye_center
from model_jax._column import DEEPEST, NODES, REACH, SERIES_DEPTH, SHARES, STEEPEST
from model_jax._fields import horizon, straight_down
from model_jax._phase import NEAREST
from model_jax._sun_column import HIGH_SUN, LOW_SUN, ON_GROUND, SUNK, TAIL_FACTORS, TAIL_RATE
from model_jax._sunlight import NODES as SUN_NODES
from model_jax._sunlight import SHARES as SUN_SHARES
from model_jax._sunlight import WITHIN
from model_jax._view import Aim, ShadowCone, view_of

from ._depth_format import Storage
from ._looks import look_defines


def uniforms_of(scene: Scene, encoding: Encoding) -> dict[str, Any]:
    """Every number of the scene that shaders take, by uniform name; lengths in planet radii but for
    layers."""
    camera, radius = scene.camera, float(scene.planet.radius)
    near, far = float(camera.near), float(camera.far)
    basis = np.asarray(camera.basis())
    center = -basis @ np.asarray(camera.position) / radius
    albedo = scene.planet.albedo
    focal_y = 2.0 / (camera.height * float(camera.pixel_size()))
    return {
        "basis": tuple(basis.T.reshape(-1)),  # GL wants columns
        "center": tuple(center[:2]),
        "center_depth": center[2],
        "clip_planes": (near / radius - center[2], far / radius - center[2]),
        "clip_factors": (far / (far - near), near / (far - near)),
        "focal": (focal_y * camera.height / camera.width, focal_y),
        "length_unit": radius,
        "eye_reference": (center[2], near / radius),
        "body_depths": _body_depths(scene, near / radius - center[2]),
        "reversed_factor": near / (far - near),
        "window_factor": far / (far - near),
        # Eye depths need none.
        "depth_constants": depth_constants(
            near, far, "window" if encoding == "linear" else encoding
        ),
        "plane_depths": (near, far),
        "width_unit": far - near,
        "pixel_size": float(camera.pixel_size()),
        "principal": (camera.width / 2, camera.height / 2),
        "first_row": 0.0,
        "column_nodes": list(NODES),
        "column_shares": list(SHARES),
        "column_limits": (REACH, STEEPEST, DEEPEST, float(np.finfo(np.float32).tiny) ** 0.5),
        "sun_nodes": list(SUN_NODES),
        "sun_shares": list(SUN_SHARES),
        "sun_within": [share for row in WITHIN for share in row],
        "tail_factors": list(TAIL_FACTORS),
        "sun_limits": (TAIL_RATE, LOW_SUN, HIGH_SUN, SUNK),
        "on_ground": ON_GROUND,
        "phase_nearest": NEAREST,
        "series_depth": SERIES_DEPTH,
        "shell_height": float(scene.atmosphere.height),
        **_eye_uniforms(scene),
        "color": tuple(np.asarray(scene.atmosphere.color)),
        "planet_color": albedo if isinstance(albedo, tuple) else (0.0, 0.0, 0.0),
        "relief_scale": relief_scale(scene),
        "sun": (0.0, 0.0, 0.0) if scene.sun is None else tuple(np.asarray(scene.sun.direction)),
        "sun_in_view": (0.0, 0.0, 0.0) if scene.sun is None else tuple(basis @ scene.sun.direction),
        "sun_tangent": 0.0 if scene.sun is None else _tangent(scene.sun),
        "occluders": [(*np.asarray(o.center) / radius, o.radius / radius) for o in scene.occluders],
    }


def aim_uniforms(camera: Camera, aim: Aim, radius: float) -> dict[str, Any]:
    """How rays pass a sphere, for `rays.glsl`: `model_jax._view`'s numbers, rows from below."""
    column, row = aim.anchor
    return {
        "anchor": (column + 0.5, camera.height - 0.5 - row),
        "aim": (aim.slope, *aim.offset),
        "body_center": tuple(aim.center),
        "body_radius": radius,
    }


def cone_uniforms(cone: ShadowCone) -> dict[str, Any]:
    """A shadow, for `rays.glsl`: `model_jax._view`'s numbers."""
    limit = float(np.finfo(np.float32).max)
    return {
        "cone_axes": tuple(np.reshape(cone.axes, -1)),  # its rows are GL's columns
        "cone_tangent": float(cone.tangent),
        "cone_center": tuple(cone.center),
        "cone_shape": (float(cone.radius), float(cone.base)),
        "unbounded": limit**0.25,
        "quotients": limit**0.5,
    }


def _eye_uniforms(scene: Scene) -> dict[str, Any]:
    """Where the camera is: once per drawing, for fields that are one number for all rays."""
    view = view_of(scene)
    down, distance = straight_down(view)
    sun = view.cones[0].axes[2] if view.cones else np.zeros(3)
    return {
        "straight_down": tuple(np.asarray(down)),
        "eye_height": float((distance - 1) * view.radius),
        "eye_horizons": (float(horizon(distance, 1.0)), float(horizon(distance, view.shell))),
        "eye_sun_cos": float(-down @ sun),
    }


def is_inside(scene: Scene) -> bool:
    """Whether the camera is in the air."""
    view = view_of(scene)
    return float(straight_down(view)[1]) <= float(view.shell)


def _tangent(sun: Sun) -> float:
    return float(np.tan(np.deg2rad(sun.angular_radius_deg)))


def plane_codes(scene: Scene, encoding: Encoding) -> tuple[float, float]:
    """What depth textures hold of the near and the far plane; the latter where nothing is drawn."""
    if encoding == "linear":
        reference = eye_center(scene)[2]
        return float(scene.camera.near - reference), float(scene.camera.far - reference)
    return (1.0, 0.0) if encoding == "reversed" else (0.0, 1.0)


def defines_of(scene: Scene, kind: type[Look], storage: Storage, shadows: int) -> dict[str, int]:
    """The shader switches of a scene: what it does not have, or show, is not compiled."""
    wanted = {
        "COLOR_DEPTH": storage.texture is not None,
        "SORTED": storage.texture is not None and _overlap(scene),
        "LINEAR": storage.encoding == "linear",
        "REVERSED": storage.encoding == "reversed",
        "SHADOWS": shadows,
        "STRETCH": scene.atmosphere.path == "distance",
        "SUN": scene.sun is not None,
        "OCCLUDERS": len(scene.occluders),
        "ALBEDO": scene.planet.albedo is not None,
        "TEXTURE": isinstance(scene.planet.albedo, str),
        "RELIEF": scene.planet.relief is not None,
        "UNLIT": kind.LIGHTS_GROUND,
        "INSIDE": is_inside(scene),
        # Where pass 3 writes it: after light, and depths if these are colours.
        "WATER": has_water(scene, kind) and (2 if storage.texture is not None else 1),
    }
    return {name: int(value) for name, value in wanted.items() if value} | look_defines(kind)


def has_water(scene: Scene, kind: type[Look]) -> bool:
    """Whether what mirrors of the ground is drawn: the scene knows it, and the look asks for it."""
    return scene.planet.water is not None and "water" in kind.NEEDS


def _overlap(scene: Scene) -> bool:
    """Whether bodies can hide parts of each other: a smooth planet alone shows all its front."""
    return scene.planet.relief is not None or bool(scene.occluders)


HIGHEST = 2.0
"""No mountain is higher than the planet's radius."""


def _body_depths(scene: Scene, near: float) -> tuple[float, float]:
    """Between which eye depths planet and occluders lie, relative to the planet's centre, radii."""
    radius = float(scene.planet.radius)
    forward = np.asarray(scene.camera.basis())[2]
    spans = [(0.0, HIGHEST)]
    spans += [(forward @ o.center / radius, float(o.radius) / radius) for o in scene.occluders]
    low, high = min(c - r for c, r in spans), max(c + r for c, r in spans)
    low = max(low, near)
    return low, max(high, low + 1e-3)


def relief_scale(scene: Scene) -> float:
    """Exaggeration of the relief for the scene's camera.

    The paper changes it with the camera's distance and gives no curve; here it runs from the near
    to the far scale with the logarithm of the camera's height.
    """
    planet = scene.planet
    (near, far), (low, high) = planet.relief_distance, planet.relief_scale
    height = float(np.linalg.norm(np.asarray(scene.camera.position)) / planet.radius) - 1.0
    start = max(near, 1e-9)
    share = np.log(max(height, start) / start) / np.log(far / start)
    return float(low + (high - low) * np.clip(share, 0.0, 1.0))
