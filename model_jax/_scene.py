"""What is looked at: camera, planet, atmosphere, sun and occluders.

World: right-handed, planet at the origin, one length unit per scene (km by default), directions in
float64 on the host. All records are pytrees whose numbers are leaves, so that layers can be
differentiated with respect to them; texture names and image sizes are static. Construction checks
the values and raises `InputError` naming the field, its value and the remedy; numbers that JAX is
tracing cannot be checked and are taken as they are.

Files are no business of this module: `relief` and an `albedo` that is a path only name what a
renderer loads.
"""

from collections.abc import Callable
from dataclasses import replace
from os import PathLike

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from ._errors import InputError, need_path, shown
from ._kinds import need
from ._shapes import AnyArray, Four, Scalar, Three, converter, namespace

EARTH_SUN_ANGULAR_RADIUS_DEG = 0.2666
"""Mean angular radius of the Sun from 1 au: 695,700 km / 149,597,871 km (IAU 2015 B3, 2012 B2)."""


MAX_PIXELS = 2**26
"""Largest picture, 67 million pixels: drawing keeps up to 14 float32 textures' worth of each pixel
on the device and the host, 8 GB then, and beyond the allocator aborts instead of raising."""


def _unit(name: str) -> Callable[[object], Scalar | AnyArray]:
    """Converter to a unit vector; a zero or broken one passes through for the check to name."""
    convert = converter(name)

    def unit(value: object) -> Scalar | AnyArray:
        vector = convert(value)
        if np.shape(vector) != (3,):
            return vector
        if not isinstance(vector, jax.Array):
            # By a power of two, which changes no digit: squares of 1e200 are infinite.
            vector = np.ldexp(vector, -np.frexp(np.max(np.abs(vector)))[1])
        xp = namespace(vector)
        length = xp.sqrt(xp.sum(vector * vector))
        if not _traced(length) and not (np.isfinite(length) and length > 0):
            return vector
        return vector / length

    return unit


def _floats(name: str) -> Callable[[object], tuple[float, ...]]:
    """Converter to a tuple of Python's floats, which static fields need."""
    convert = converter(name)
    return lambda value: tuple(np.ravel(convert(value)).tolist())


def _path(name: str) -> Callable[[object], str | None]:
    """Converter of the path of a file, or of None, to what records of scenes can hold."""

    def text(value: object) -> str | None:
        return None if value is None else need_path(name, value)

    return text


def _albedo(value: object) -> str | tuple[float, ...] | None:
    """Converter of the path of a texture, or of a colour to numbers that records of scenes hold."""
    name = "planet.albedo"
    if value is None or isinstance(value, str | PathLike):
        return _path(name)(value)
    if _traced(value):
        raise InputError(f"{name}: is traced; give numbers")
    return _floats(name)(value)


def _rgba(value: object) -> Scalar | AnyArray:
    vector = converter("atmosphere.color")(value)
    return namespace(vector).append(vector, 1.0) if np.shape(vector) == (3,) else vector


def _traced(value: object) -> bool:
    return isinstance(value, jax.core.Tracer)


class Camera(eqx.Module):
    """A pinhole camera with square pixels; the principal point is the image's centre."""

    position: Three = eqx.field(converter=converter("camera.position"))
    """Centre of projection, scene length units."""
    forward: Three = eqx.field(converter=_unit("camera.forward"))
    """Unit vector along the optical axis, into the picture."""
    up: Three = eqx.field(converter=_unit("camera.up"))
    """Any direction that is up in the picture and not parallel to `forward`."""
    fov_y_deg: Scalar = eqx.field(converter=converter("camera.fov_y_deg"))
    """Full vertical field of view, degrees, in (0, 180)."""
    width: int = eqx.field(static=True)
    """Columns of the image."""
    height: int = eqx.field(static=True)
    """Rows of the image."""
    near: Scalar = eqx.field(converter=converter("camera.near"))
    """Eye depth of the near plane, > 0."""
    far: Scalar = eqx.field(converter=converter("camera.far"))
    """Eye depth of the far plane, > near."""

    def __check_init__(self) -> None:
        for name in ("position", "forward", "up"):
            _require_vector(f"camera.{name}", getattr(self, name))
        for name in ("forward", "up"):
            _require_direction(f"camera.{name}", getattr(self, name))
        for name in ("width", "height"):
            size = getattr(self, name)
            if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= 65536:
                raise InputError(f"camera.{name}: {shown(size)} must be a whole number, 1 to 65536")
        fov = self.fov_y_deg
        if self.width * self.height > MAX_PIXELS:
            raise InputError(
                f"camera.width × camera.height: {self.width}×{self.height} are more than "
                f"{MAX_PIXELS:,} pixels; make the picture smaller"
            )
        _require("camera.fov_y_deg", fov, (fov > 0) & (fov < 180), "between 0 and 180")
        _require("camera.near", self.near, self.near > 0, "above 0")
        _require("camera.far", self.far, self.far > self.near, f"above camera.near ({self.near})")
        if not _traced(self.forward) and not _traced(self.up):
            sine = np.linalg.norm(np.cross(self.forward, self.up))
            if sine < 1e-6:
                raise InputError(
                    f"camera.up: {_show(self.up)} is parallel to the viewing direction "
                    f"{_show(self.forward)}; choose another up"
                )

    def basis(self) -> Float[AnyArray, "3 3"]:
        """Rows right, up, forward: an orthonormal basis, `right = forward × up`."""
        xp = namespace(self.forward, self.up)
        right = xp.cross(self.forward, self.up)
        right = right / xp.sqrt(xp.sum(right * right))
        return xp.stack([right, xp.cross(right, self.forward), self.forward])

    def pixel_size(self) -> Scalar:
        """Side of a pixel on the plane at eye depth 1: `2 tan(fov_y / 2) / height`."""
        xp = namespace(self.fov_y_deg)
        return 2.0 * xp.tan(xp.deg2rad(self.fov_y_deg) / 2.0) / self.height

    def resized(self, width: int, height: int) -> "Camera":
        """The same view on another pixel grid; the vertical field of view stays."""
        return replace(self, width=width, height=height)


class Planet(eqx.Module):
    """A sphere at the origin, with optional relief and surface colour or texture."""

    radius: Scalar = eqx.field(converter=converter("planet.radius"))
    """Mean radius, > 0; also the radius of the shadow cone's base."""
    relief: str | None = eqx.field(static=True, converter=_path("planet.relief"), default=None)
    """Height map, equirectangular (-180…180°, north up); its name is the renderer's business."""
    relief_unit: Scalar = eqx.field(converter=converter("planet.relief_unit"), default=1.0)
    """Height of one unit of the map (white = 1 in pictures of 8 or 16 bits), scene length units."""
    relief_scale: tuple[float, float] = eqx.field(
        static=True, converter=_floats("planet.relief_scale"), default=(1.0, 1.0)
    )
    """Exaggeration of the heights for a camera on the ground, and for one far away."""
    relief_distance: tuple[float, float] = eqx.field(
        static=True, converter=_floats("planet.relief_distance"), default=(0.01, 2.0)
    )
    """Camera heights, in planet radii, at which the first and the second scale are reached."""
    albedo: str | tuple[float, float, float] | None = eqx.field(
        static=True, converter=_albedo, default=None
    )
    """Surface colour: one for all, linear light in [0, 1], or an equirectangular sRGB picture; none
    = drawn black, and what the planet looks like is not known."""
    water: str | None = eqx.field(static=True, converter=_path("planet.water"), default=None)
    """How much of the ground mirrors, equirectangular, 1 = water: a grey picture, or the alpha
    channel of one that has it, which may be the albedo's own."""
    triangles: int = eqx.field(static=True, default=196_000)
    """At least this many triangles (the paper's number)."""

    def __check_init__(self) -> None:
        _require("planet.radius", self.radius, self.radius > 0, "above 0")
        _require("planet.relief_unit", self.relief_unit, True, "finite")
        for name in ("relief_scale", "relief_distance"):
            pair = getattr(self, name)
            if len(pair) != 2 or not all(np.isfinite(n) and n >= 0 for n in pair):
                raise InputError(
                    f"planet.{name}: {shown(pair)} must be two finite numbers, at least 0"
                )
        if not self.relief_distance[0] < self.relief_distance[1]:
            raise InputError(
                f"planet.relief_distance: {shown(self.relief_distance)} must grow from near to far"
            )
        color = self.albedo
        if isinstance(color, tuple) and not (len(color) == 3 and all(0 <= c <= 1 for c in color)):
            raise InputError(
                f"planet.albedo: {shown(color)} must be three numbers, 0 to 1, or the path of a "
                "texture"
            )
        number = self.triangles
        if not isinstance(number, int | np.integer) or not 20 <= number <= 20_000_000:
            raise InputError(
                f"planet.triangles: {shown(number)} must be a whole number, 20 to 20,000,000"
            )


class Atmosphere(eqx.Module):
    """A spherical shell of air of uniform density above the planet's mean radius."""

    height: Scalar = eqx.field(converter=converter("atmosphere.height"))
    """Thickness of the shell, > 0, scene length units."""
    color: Four = eqx.field(converter=_rgba, default=(1.0, 1.0, 1.0, 1.0))
    """Linear RGB and alpha of the air; three numbers mean alpha 1."""
    path: str = eqx.field(static=True, default="depth")
    """What a width is: "depth" along the camera's axis, as in the paper, or "distance" along the
    ray, longer by 1 / cos of the angle between the two."""

    def __check_init__(self) -> None:
        if self.path not in ("depth", "distance"):
            raise InputError(f"atmosphere.path: {shown(self.path)} must be 'depth' or 'distance'")
        _require("atmosphere.height", self.height, self.height > 0, "above 0")
        if np.shape(self.color) != (4,):
            raise InputError(
                f"atmosphere.color: {_show(self.color)} must be 3 or 4 numbers (rgb or rgba)"
            )
        if not _traced(self.color) and not (
            np.all(np.isfinite(self.color)) and np.all(np.asarray(self.color) >= 0)
        ):
            raise InputError(f"atmosphere.color: {_show(self.color)} must be finite and at least 0")


class Sun(eqx.Module):
    """A disc of uniform radiance at infinity."""

    direction: Three = eqx.field(converter=_unit("sun.direction"))
    """Unit vector from the planet toward the sun."""
    angular_radius_deg: Scalar = eqx.field(
        converter=converter("sun.angular_radius_deg"), default=EARTH_SUN_ANGULAR_RADIUS_DEG
    )
    """Half the disc's angle, degrees, in [0, 90); 0 makes the shadow a cylinder."""

    def __check_init__(self) -> None:
        _require_vector("sun.direction", self.direction)
        _require_direction("sun.direction", self.direction)
        radius = self.angular_radius_deg
        possible = (radius >= 0) & (radius < 90)
        _require("sun.angular_radius_deg", radius, possible, "at least 0 and below 90")


class Occluder(eqx.Module):
    """Another sphere: it casts its shadow on the air, and hides in black what lies behind it."""

    center: Three = eqx.field(converter=converter("occluder.center"))
    """Centre, scene length units."""
    radius: Scalar = eqx.field(converter=converter("occluder.radius"))
    """Radius, > 0."""

    def __check_init__(self) -> None:
        _require_vector("occluder.center", self.center)
        _require("occluder.radius", self.radius, self.radius > 0, "above 0")


class Scene(eqx.Module):
    """Everything that the layers depend on; how they are coloured is a `Look`."""

    camera: Camera
    planet: Planet
    atmosphere: Atmosphere
    sun: Sun | None = None
    """None = no shadow volume: nothing is known of the sun."""
    occluders: tuple[Occluder, ...] = ()

    def __check_init__(self) -> None:
        for name, kind in (("camera", Camera), ("planet", Planet), ("atmosphere", Atmosphere)):
            need(f"scene.{name}", getattr(self, name), kind)
        if self.sun is not None:
            need("scene.sun", self.sun, Sun)
        if not isinstance(self.occluders, tuple | list):
            need("scene.occluders", self.occluders, tuple)
        for number, body in enumerate(self.occluders):
            need(f"scene.occluders[{number}]", body, Occluder)
        if self.occluders and self.sun is None:
            raise InputError(
                f"occluder: {len(self.occluders)} given without a sun, so they cast no shadow; "
                "add [sun] or remove [[occluder]]"
            )
        if _traced(self.camera.position) or _traced(self.planet.radius):
            return
        distance = _length(self.camera.position)
        # Ground level is no digit more exact than its coordinates.
        if distance < self.planet.radius * (1 - 1e-12):
            raise InputError(
                f"camera.position: {_show(self.camera.position)} lies inside the planet "
                f"({distance:g} from its centre, radius {float(self.planet.radius):g}); move it out"
            )
        for number, body in enumerate(self.occluders, 1):
            if _traced(body.center) or _traced(body.radius):
                continue
            distance = _length(self.camera.position, body.center)
            if distance < body.radius:
                raise InputError(
                    f"camera.position: {_show(self.camera.position)} lies inside occluder {number} "
                    f"({distance:g} from its centre, radius {float(body.radius):g}); move it out"
                )

    def resized(self, width: int, height: int) -> "Scene":
        """The same scene on another pixel grid; the vertical field of view stays."""
        return replace(self, camera=self.camera.resized(width, height))


def _require(name: str, value: Scalar, ok: object, rule: str) -> None:
    if _traced(value) or _traced(ok):
        return
    if np.shape(value) != ():
        raise InputError(f"{name}: {_show(value)} must be one number")
    if not (ok and np.isfinite(value)):
        raise InputError(f"{name}: {float(value):g} must be finite and {rule}")


def _require_vector(name: str, value: AnyArray) -> None:
    if np.shape(value) != (3,):
        raise InputError(f"{name}: {_show(value)} must be three numbers [x, y, z]")
    if not _traced(value) and not np.all(np.isfinite(value)):
        raise InputError(f"{name}: {_show(value)} must be finite")


def _require_direction(name: str, value: AnyArray) -> None:
    if not _traced(value) and not np.any(np.asarray(value)):
        raise InputError(f"{name}: {_show(value)} has no length; give a direction")


def _length(start: AnyArray, end: AnyArray | float = 0.0) -> float:
    """Distance; infinite, without a warning, where its square is beyond the range of floats."""
    with np.errstate(over="ignore"):
        return float(np.linalg.norm(start - end))


def _show(value: Scalar | AnyArray) -> str:
    numbers = np.ravel(value)
    return shown([float(f"{number:.6g}") for number in numbers[:7]])
