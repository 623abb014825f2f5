"""What layers cost and how far off they are: depth format, source, tessellation, resolution."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from model_jax import (
    AirlightError,
    Layers,
    Look,
    Planet,
    Scene,
    analytic_layers,
    composite,
)
from render_gl import DEPTH_FORMATS, DepthFormat, Source, render_layers_and_image
from render_gl._accuracy import smooth, width_pair
from render_gl._draw import draw

from .._compile import float64
from ._exact import DIGITS, exact_widths
from ._measure import codes_apart, measure
from ._point import Point, timed

SAMPLE = 4000
"""Pixels of which float64's own rounding is told."""


@dataclass(frozen=True)
class Choices:
    """Which settings are tried."""

    formats: tuple[DepthFormat, ...] = DEPTH_FORMATS
    meshes: tuple[int, ...] = (320, 1280, 5120, 20480, 81920)
    """Triangles of a sphere, besides the scene's own."""
    parts: tuple[int, ...] = (2, 4, 8)
    """By how much pictures are smaller."""


@dataclass(frozen=True)
class Drawn:
    """A scene to draw, and what is right of it. Its ground is smooth, as exact intersection's."""

    name: str
    scene: Scene
    look: Look

    @cached_property
    def exact(self) -> Layers:
        """Layers in float64."""
        with float64():
            return analytic_layers(self.scene, jnp.float64, self.look)

    @cached_property
    def picture(self) -> np.ndarray:
        with float64():
            return np.asarray(composite(self.exact, self.look))[..., :3]


def smoothed(name: str, scene: Scene, look: Look, most_pixels: int) -> Drawn:
    """A scene without relief and textures, of no more than some pixels."""
    camera = scene.camera
    part = 1
    while (camera.width // part) * (camera.height // part) > most_pixels:
        part *= 2
    small = scene if part == 1 else scene.resized(camera.width // part, camera.height // part)
    return Drawn(name, smooth(small), look)


def render_points(case: Drawn, choices: Choices, tell: Callable[[str], None]) -> Iterator[Point]:
    """Points of one scene."""
    for source in ("raster", "mesh"):
        for depth in choices.formats:
            tell(f"{case.name}: {source}, {depth}")
            yield _drawn(case, case.scene, depth, source, f"{source}, by depth format")
    for triangles in choices.meshes:
        tell(f"{case.name}: mesh of {triangles} triangles")
        planet = Planet(case.scene.planet.radius, triangles=triangles)
        scene = eqx.tree_at(lambda s: s.planet, case.scene, planet)
        yield _drawn(case, scene, "linear", "mesh", "mesh, by triangles")
    camera = case.scene.camera
    for part in choices.parts:
        small = case.scene.resized(camera.width // part, camera.height // part)
        tell(f"{case.name}: a {part}th of the width")
        yield _drawn(case, small, "linear", "raster", "raster, by resolution")
        yield _analytic(case, small, "float32", "analytic, by resolution")
    for dtype in ("float32", "float64"):
        tell(f"{case.name}: analytic, {dtype}")
        yield _analytic(case, case.scene, dtype, "analytic, by dtype")


def _drawn(case: Drawn, scene: Scene, depth: DepthFormat, source: Source, method: str) -> Point:
    """By OpenGL."""
    camera = scene.camera
    setting = f"{source}, {depth}, {camera.width}×{camera.height}"
    if source == "mesh":
        setting += f", {scene.planet.triangles} triangles"
    begun = _begun(case, scene, method, setting)
    try:
        (layers, image), times = measure(
            lambda: render_layers_and_image(scene, case.look, depth, source)
        )
        passes = draw(scene, case.look, depth, source).drawn
    except AirlightError as error:
        return replace(begun, status="failed", note=str(error))
    return _judged(case, scene, replace(begun, **timed(times), evaluations=passes), layers, image)


def _analytic(case: Drawn, scene: Scene, dtype: str, method: str) -> Point:
    """By exact intersection in JAX."""
    camera = scene.camera
    begun = _begun(case, scene, method, f"analytic, {dtype}, {camera.width}×{camera.height}")

    def run() -> tuple[Layers, Any]:
        layers = analytic_layers(scene, jnp.dtype(dtype), case.look)
        return layers, composite(layers, case.look)

    with float64():
        (layers, image), times = measure(run)
    point = replace(begun, **timed(times))
    if dtype == "float32":
        return _judged(case, scene, point, layers, image)
    return _rounded(case, scene, point, layers)


def _begun(case: Drawn, scene: Scene, method: str, setting: str) -> Point:
    pixels = scene.camera.width * scene.camera.height
    return Point("render", case.name, case.look.NAME, method, setting, pixels)


def _judged(case: Drawn, scene: Scene, point: Point, layers: Layers, image: Any) -> Point:
    """Widths against exact ones of the same pixels; the picture against the full one."""
    with float64():
        full = scene.camera.width == case.scene.camera.width
        exact = case.exact if full else analytic_layers(scene, jnp.float64, case.look)
        found, right = widths(layers), widths(exact)
        small = jnp.asarray(image, jnp.float64)[..., :3]
        picture = np.asarray(jax.image.resize(small, case.picture.shape, "linear"))
    air = (found != 0) | (right != 0)
    apart = np.abs(found - right)[air] / float(scene.atmosphere.height)
    most, rms = codes_apart(picture, case.picture)
    size = layers_bytes(layers) + np.asarray(image).nbytes
    point = replace(point, bytes=size, per_second=_per_second(point))
    if not np.isfinite(apart).all():
        return replace(point, status="failed", note="some widths are no numbers")
    if not len(apart):
        return replace(point, status="failed", note="no air is in view")
    return replace(
        point,
        width_max=float(apart.max()),
        width_p999=float(np.percentile(apart, 99.9)),
        width_rms=float(np.sqrt(np.mean(apart**2))),
        picture_max=most,
        picture_rms=rms,
    )


def _rounded(case: Drawn, scene: Scene, point: Point, layers: Layers) -> Point:
    """The oracle, against numbers of many digits of some pixels."""
    size, speed = layers_bytes(layers), _per_second(point)
    point = replace(point, status="oracle", bytes=size, per_second=speed)
    if scene.occluders:
        return replace(point, note="not held against more digits: there are moons")
    lit, dark = widths(layers)
    air = np.argwhere(lit + dark > 0)
    if not len(air):
        return point
    row, column = air[np.random.default_rng(0).integers(0, len(air), SAMPLE)].T
    right = exact_widths(scene, row, column)
    apart = np.abs(np.stack([lit[row, column], dark[row, column]]) - np.stack(right))
    apart = apart / float(scene.atmosphere.height)
    return replace(
        point,
        width_max=float(apart.max()),
        width_p999=float(np.percentile(apart, 99.9)),
        width_rms=float(np.sqrt(np.mean(apart**2))),
        note=f"against {DIGITS} digits, {SAMPLE:,} pixels of air",
    )


def _per_second(point: Point) -> float | None:
    return None if point.seconds is None else point.pixels / point.seconds


def widths(layers: Layers) -> np.ndarray:
    """Lit and dark width [2, h, w], scene length units."""
    with float64():
        return np.stack(width_pair(layers))


def layers_bytes(layers: Layers) -> int:
    """Of the pictures in them."""
    leaves = jax.tree.leaves(layers)
    return sum(int(leaf.nbytes) for leaf in leaves if getattr(leaf, "ndim", 0) >= 2)
