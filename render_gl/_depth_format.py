"""How depths are stored, how exact that is, and which format a scene needs.

    window16     16-bit window depth in a colour attachment
    window24     the paper's: the depth buffer itself
    window32f    window depth as float32: no finer than 24 bits where depths are large
    reversed32f  reversed window depth as float32: relative to the eye depth
    linear       float32 eye depth relative to the planet's centre

At eye depth z a step ε of window depth is a step ε z² (far - near) / (far near) (Akeley & Su 2006,
"Minimum triangle separation for correct z-buffer occlusion", §2). moderngl makes depth buffers of
24 bits only, so the other formats are written to colour attachments, where blending keeps the
nearer depth.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from model_jax import Encoding, InputError, Scene, eye_center
from model_jax._errors import shown
from model_jax._kinds import need, need_number

from ._choices import DEPTH_FORMATS, DepthFormat

SHARE = 1e-3
"""Share of the shell's height that depths may be wrong by, unless one asks for another."""

EPS = float(np.finfo(np.float32).eps)
WINDOW_ULP = 9
"""Window depth is a difference times a factor over an eye depth, at most 1: 4 roundings of ½ ulp,
and a quotient of 2½."""
LINEAR_ULP = 8
"""Error of eye depth: three products and sums of the transform, interpolation, clamp, scaling."""


@dataclass(frozen=True)
class Storage:
    """What a format is made of."""

    encoding: Encoding
    texture: str | None
    """Number type of the colour attachment, in moderngl's words; None is the depth buffer."""
    rounding: float
    """Half a step of stored window depths."""


STORAGE: dict[DepthFormat, Storage] = {
    "window16": Storage("window", "nu2", 0.5 / 65535),
    "window24": Storage("window", None, 0.5 * 2.0**-24),
    "window32f": Storage("window", "f4", 0.0),
    "reversed32f": Storage("reversed", "f4", 0.0),
    "linear": Storage("linear", "f4", 0.0),
}


@dataclass(frozen=True)
class Choice:
    """A depth format for a scene, and why."""

    depth_format: DepthFormat
    error: float
    """Predicted error of a width by the format alone, scene length units; inf: it tells nothing."""
    reason: str


def depth_error(
    scene: Scene, depth_format: DepthFormat, relative: Float[np.ndarray, "*shape"]
) -> Float[np.ndarray, "*shape"]:
    """Largest error of stored depths, scene length units.

    Args:
        relative: eye depths relative to the planet's centre.
    """
    near, far = float(scene.camera.near), float(scene.camera.far)
    storage = STORAGE[depth_format]
    if storage.encoding == "linear":
        return LINEAR_ULP * EPS * np.abs(relative)
    center = float(eye_center(scene)[2])
    depth = relative + center
    if storage.encoding == "reversed":
        # The depth itself, formed from the two, and the far plane's distance from it, which
        # counts by its share of the whole.
        size = np.abs(relative) + abs(center)
        return LINEAR_ULP * EPS * np.maximum(size, depth)
    step = storage.rounding + WINDOW_ULP * EPS / 2
    relative_step = step * depth * (far - near) / (far * near)
    # Beyond the first order; a step as large as the depth itself leaves nothing to know.
    blown = np.where(
        relative_step < 0.5, relative_step / (1 - np.minimum(relative_step, 0.5)), np.inf
    )
    return blown * depth + WINDOW_ULP * EPS * depth


def width_error(scene: Scene, depth_format: DepthFormat) -> float:
    """Largest error of a width by the depth format, scene length units.

    A lit width is the sum of two differences of depths; none in the air lies deeper than the far
    side of the shell.
    """
    center = float(eye_center(scene)[2])
    shell = float(scene.planet.radius + scene.atmosphere.height)
    low = max(float(scene.camera.near) - center, -shell)
    high = min(float(scene.camera.far) - center, shell)
    if high <= low:
        return 0.0  # no air between the clip planes
    return float(np.max(4 * depth_error(scene, depth_format, np.array([low, high]))))


def widest_chord(scene: Scene) -> float:
    """Longest way through air past the planet, scene length units."""
    radius, height = float(scene.planet.radius), float(scene.atmosphere.height)
    return 2 * float(np.sqrt(height * (2 * radius + height)))


def choose_format(scene: Scene, asked: str = "auto", share: float = SHARE) -> Choice:
    """The cheapest format that is exact to a share of the shell's height, or the one asked for.

    Args:
        asked: "auto" or one of `DEPTH_FORMATS`.
        share: of the shell's height, that "auto" allows a width to be wrong by.

    Raises:
        InputError: an unknown format; one whose error would exceed the widest chord of air.
    """
    need("scene", scene, Scene)
    share = float(need_number("share", share))
    if asked != "auto":
        return _checked(scene, asked)
    limit = share * float(scene.atmosphere.height)
    refused = []
    for depth_format in DEPTH_FORMATS:
        error = width_error(scene, depth_format)
        if error <= limit:
            reason = (
                f"the cheapest that keeps widths to {100 * share:g} % of the shell's height "
                f"({_percent(error, scene)})"
            )
            return Choice(depth_format, error, reason)
        refused.append(f"{depth_format} {_percent(error, scene)}")
    error = width_error(scene, "linear")
    reason = (
        f"no format stays below {100 * share:g} % of the shell's height ({', '.join(refused)}); "
        "analytic layers (--source analytic) do not depend on it"
    )
    return Choice("linear", error, reason)


def _checked(scene: Scene, asked: str) -> Choice:
    depth_format = next((known for known in DEPTH_FORMATS if known == asked), None)
    if depth_format is None:
        raise InputError(
            f"depth format {shown(asked)} is unknown; use auto or one of {', '.join(DEPTH_FORMATS)}"
        )
    error, chord = width_error(scene, depth_format), widest_chord(scene)
    if STORAGE[depth_format].encoding != "linear" and not error < chord:
        raise InputError(
            f"depth format {asked}: between near {float(scene.camera.near):g} and far "
            f"{float(scene.camera.far):g} its widths are uncertain by {error:.3g}, more than the "
            f"widest chord of air, {chord:.3g}; bring the clip planes together or use linear"
        )
    reason = f"asked for; keeps widths to {_percent(error, scene)} of the shell's height"
    return Choice(depth_format, error, reason)


def _percent(error: float, scene: Scene) -> str:
    return f"{100 * error / float(scene.atmosphere.height):.2g} %"
