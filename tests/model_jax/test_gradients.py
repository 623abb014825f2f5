"""Gradients against central differences in float64, forward and reverse; finite at every pixel.

Each row of the tables is a function of one argument, evaluated along a random direction whose
entries are scaled to the argument. The reference is a Richardson-extrapolated central difference,
`(4 D(h) - D(2h)) / 3`: error h⁴ f⁽⁵⁾ from truncation and ε/h from rounding, both below 1e-9 of f′
for h = 1e-3 and functions without structure finer than their argument.
"""

import itertools
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    Atmosphere,
    Camera,
    DepthTextures,
    Layers,
    LayersLook,
    Planet,
    Scene,
    Sun,
    analytic_layers,
    combine,
    composite,
    layer_widths,
)

from .scenes import ECLIPSES, LENGTHS, SCENES, scene_of

RELATIVE = 1e-6
STEP = 1e-3
SHAPE = (4, 5)
COLOR = np.array([0.4, 0.6, 0.9, 0.8])
Numbers = jax.Array | np.ndarray
Function = Callable[[Any], Numbers]


def depths() -> dict[str, np.ndarray]:
    """Eye depths of 20 pixels in five clamp situations, a column each, with no two depths close."""
    rng = np.random.default_rng(7)
    front = 20 + rng.random(SHAPE)
    back = front + 10 + rng.random(SHAPE)
    # Columns: inside, before, behind, straddling the front, straddling the back.
    begin = np.array([3.0, -8.0, 14.0, -5.0, 6.0])[None, :] + rng.random(SHAPE)
    end = np.array([7.0, -4.0, 18.0, 5.0, 15.0])[None, :] + rng.random(SHAPE)
    return {
        "front": front,
        "back": back,
        "shadow_front": front + begin,
        "shadow_back": front + end,
    }


def painted(look: LayersLook, **changes: Any) -> Numbers:
    """The picture of `depths` under a look; a depth or the colour may be replaced."""
    fields: dict[str, Any] = depths() | {"color": COLOR, "width_unit": 7.0} | changes
    return composite(Layers(**fields), look)[..., :3]


def through_windows(name: str, far: float) -> Function:
    """The combine of one window-depth texture, the others fixed; near is 1."""
    textures = {key: far / (far - 1) * (1 - 1 / z) for key, z in depths().items()}

    def picture(window: jax.Array) -> Numbers:
        replaced = DepthTextures(
            **(textures | {name: window}), near=1.0, far=far, encoding="window"
        )
        return combine(replaced.linearize(), LayersLook())[..., :3] * far

    return picture


LOOKS: dict[str, tuple[Function, object]] = {
    "brightness": (lambda v: painted(LayersLook(brightness=v)), 2.5),
    "shadow": (lambda v: painted(LayersLook(shadow=v)), 0.3),
    "shadow per channel": (lambda v: painted(LayersLook(shadow=v)), (0.1, 0.2, 0.6)),
    "tint": (lambda v: painted(LayersLook(tint=v)), (0.8, 1.0, 1.2)),
    "background": (lambda v: painted(LayersLook(background=v)), 0.1),
    "background per channel": (lambda v: painted(LayersLook(background=v)), (0.1, 0.2, 0.3)),
    "color": (lambda v: painted(LayersLook(), color=v), COLOR),
}
OTHER = np.random.default_rng(8).random((2, *SHAPE))
SHADOWS = {
    # Columns: after, across the end of, inside, and around the first shadow; before the air.
    "shadow_front": np.array([8.0, -3.0, 15.0, -6.0, -9.0])[None, :] + OTHER[0],
    "shadow_back": np.array([9.5, 2.0, 16.5, 7.0, -7.5])[None, :] + OTHER[1],
}
"""Eye depths of a second shadow, relative to the front of the air."""


def with_depth(name: str, value: jax.Array) -> Numbers:
    """The picture with another of its depths."""
    return painted(LayersLook(), **{name: value})


def overshadowed(name: str, value: jax.Array) -> Numbers:
    """The picture with two shadows, of which one depth of the second is given."""
    first = depths()
    second = {key: jnp.asarray(first["front"] + more) for key, more in SHADOWS.items()}
    second[name] = value
    return painted(LayersLook(), **{key: jnp.stack([first[key], second[key]]) for key in SHADOWS})


UNIONS: dict[str, tuple[Function, object]] = {
    f"second {name}": (partial(overshadowed, name), depths()["front"] + SHADOWS[name])
    for name in SHADOWS
}
DEPTHS: dict[str, tuple[Function, object]] = {
    name: (partial(with_depth, name), z) for name, z in depths().items()
}
WINDOWS: dict[str, tuple[Function, object]] = {
    f"{name}, far/near {far:g}": (through_windows(name, far), far / (far - 1) * (1 - 1 / z))
    for far in (60.0, 1e4)
    for name, z in depths().items()
}
TABLE = LOOKS | DEPTHS | UNIONS | WINDOWS


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", TABLE)
def test_combine(name: str, rng: np.random.Generator) -> None:
    function, at = TABLE[name]
    at = np.asarray(at, np.float64)
    # A step of window depth that moves eye depth by some percent: dw = (1 - w) · dz/z.
    scale = 1 - at if name in WINDOWS else at
    compare(function, at, scale * rng.uniform(0.5, 1.0, at.shape), rng)


@cache
def modes(function: Function) -> tuple[Callable, Callable, Callable]:
    """The function, its forward and its reverse mode, compiled once for all that share it."""
    return (
        jax.jit(function),
        jax.jit(lambda point, along: jax.jvp(function, (point,), (along,))[1]),
        jax.jit(lambda point, weights: jax.vjp(function, point)[1](weights)[0]),
    )


def compare(
    function: Function,
    at: Numbers | dict[str, np.ndarray],
    direction: Numbers | dict[str, np.ndarray],
    rng: np.random.Generator,
    least_smooth: float = 1.0,
) -> None:
    """Both modes against differences; pixels with a kink between the samples may be left out.

    A pixel has a kink when its differences at h and 2h are not alike; without one they differ by
    3 h² f‴/6. `least_smooth` is the share of pixels that must remain.
    """
    point, along = jax.tree.map(jnp.asarray, (at, direction))
    picture, push, pull = modes(function)

    def moved(step: float) -> jax.Array:
        return picture(jax.tree.map(lambda x, d: x + step * d, point, along))

    def central(step: float) -> np.ndarray:
        difference = moved(step) - moved(-step)
        return np.asarray(difference) / (2 * step)

    fine, coarse = central(STEP), central(2 * STEP)
    reference = (4 * fine - coarse) / 3
    size = np.max(np.abs(reference))
    assert size > 1e-3, "the reference is zero: nothing is tested"
    smooth = np.abs(fine - coarse) <= 3e-4 * np.abs(reference) + 1e-9 * size
    assert smooth.mean() >= least_smooth
    assert np.max(np.abs(reference[smooth])) > 1e-3

    forward = push(point, along)
    assert np.all(np.isfinite(forward))
    size = np.max(np.abs(reference[smooth]))
    np.testing.assert_allclose(forward[smooth], reference[smooth], rtol=0, atol=RELATIVE * size)

    weights = np.where(smooth, rng.uniform(0.5, 1.0, forward.shape) * np.sign(reference), 0)
    reverse = pull(point, jnp.asarray(weights))
    expected = np.sum(weights * np.where(smooth, reference, 0))
    assert abs(expected) > 1e-3
    got = sum(jax.tree.leaves(jax.tree.map(lambda g, d: np.sum(g * d), reverse, direction)))
    assert float(got) == pytest.approx(expected, rel=RELATIVE)


BASE = {
    "position": np.array([-0.4, -2.6, 0.7]),
    "height": np.array(0.3),
    "radius": np.array(1.0),
    "sun": np.array([0.9, 0.4, -0.5]),
    "angular_radius": np.array(6.0),
    "fov": np.array(44.0),
    "forward": np.array([0.4, 2.6, -0.7]),
}


def widths(use: dict[str, jax.Array]) -> jax.Array:
    """Lit and dark widths [2, h, w] of a scene, as a function of all its numbers."""
    camera = Camera(use["position"], use["forward"], (0.0, 0.0, 1.0), use["fov"], 12, 9, 0.01, 6.0)
    sun = Sun(use["sun"], use["angular_radius"])
    scene = Scene(camera, Planet(use["radius"]), Atmosphere(use["height"]), sun)
    layers = analytic_layers(scene, jnp.float64)
    lit, dark = layer_widths(layers)
    assert dark is not None
    return jnp.stack([lit, dark]) * layers.width_unit


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize("name", BASE)
def test_analytic_layers(name: str, rng: np.random.Generator) -> None:
    """Kinks (limb, shell's edge, shadow's edge) run between pixels; a step of 1e-4 of each number
    carries them over few of them, and at most the pixels beside them are left out."""
    at = BASE[name]
    scale = 0.03 * np.maximum(np.abs(at), 0.1) * np.sign(at)
    direction = {other: np.zeros_like(value) for other, value in BASE.items()}
    direction[name] = scale * rng.uniform(0.5, 1.0, at.shape)
    compare(widths, BASE, direction, rng, 0.8)


def loss_of(scene: Scene, look: LayersLook, dtype: np.dtype) -> jax.Array:
    """Any NaN or infinity of any pixel's gradient would show in the gradient of this sum."""
    layers = analytic_layers(scene, dtype)
    widths = [w for w in layer_widths(layers) if w is not None]
    picture = composite(layers, look)
    return sum(jnp.sum(jnp.sqrt(1 + w * w)) for w in widths) + jnp.sum(picture * picture)


gradients = eqx.filter_jit(jax.grad(loss_of, argnums=(0, 1)))


SLOW = {
    # Another image size is another compilation of some seconds, and nothing new to differentiate.
    "odd sizes",
    "one pixel",
    # The gradient of four shadows takes half a minute and 2 GB to compile, of two a quarter: one
    # scene of two is enough.
    "shadows overlap",
    "moon beside the camera, far",
}
ONCE = set(ECLIPSES) | set(LENGTHS)
"""Programs of their own, of a quarter minute each. Every scene is differentiated in one precision,
in the full sweep in both."""


def cases() -> list[object]:
    found: list[object] = []
    for (k, name), precision in itertools.product(enumerate(SCENES), ("float32", "float64")):
        once = "float32" if name in ONCE else ("float32", "float64")[k % 2]
        full = name in SLOW or precision != once
        marks = pytest.mark.full if full else ()
        found.append(pytest.param(name, precision, marks=marks, id=f"{precision}-{name}"))
    return found


@pytest.mark.parametrize(("name", "dtype"), cases(), indirect=["dtype"])
def test_finite_at_every_pixel(name: str, dtype: np.dtype) -> None:
    scene = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), SCENES[name])
    look = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), LayersLook())
    found = gradients(scene, look, dtype)
    for path, leaf in jax.tree_util.tree_leaves_with_path(found):
        assert np.all(np.isfinite(leaf)), f"d loss / d {jax.tree_util.keystr(path)} = {leaf}"


TIES = {
    "all equal": (5.0, 5.0, 5.0, 5.0),
    "no air, shadow elsewhere": (5.0, 5.0, 1.0, 9.0),
    "shadow begins with the air": (2.0, 9.0, 2.0, 5.0),
    "shadow ends with the air": (2.0, 9.0, 4.0, 9.0),
    "shadow is the air": (2.0, 9.0, 2.0, 9.0),
    "shadow ends where air begins": (4.0, 9.0, 1.0, 4.0),
    "shadow begins where air ends": (1.0, 4.0, 4.0, 8.0),
    "empty shadow at the front": (2.0, 9.0, 2.0, 2.0),
}


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev], ids=["forward", "reverse"])
@pytest.mark.parametrize("name", TIES)
def test_ties_are_finite(name: str, mode: Callable, dtype: np.dtype) -> None:
    values = [jnp.full((1, 1), z, dtype) for z in TIES[name]]

    def picture(depths: list[jax.Array], look: LayersLook) -> Numbers:
        front, back, *shadow = depths
        begin, until = shadow or (None, None)
        return combine(Layers(front, back, begin, until), look)

    look = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), LayersLook())
    for argument in (0, 1):
        for leaf in jax.tree.leaves(mode(picture, argument)(values, look)):
            assert np.all(np.isfinite(leaf))


@pytest.mark.usefixtures("x64")
def test_a_tie_takes_half_of_each_side() -> None:
    """Shadow beginning exactly with the air: moved inward it frees lit air, outward none."""

    def lit(shadow_front: jax.Array) -> jax.Array:
        edge = jnp.full((1, 1), 2.0), jnp.full((1, 1), 9.0)
        return layer_widths(Layers(*edge, shadow_front, jnp.full((1, 1), 5.0)))[0][0, 0]

    at = jnp.full((1, 1), 2.0)
    assert float(jax.grad(lit)(at)[0, 0]) == 0.5
    assert float(jax.grad(lit)(at + 0.1)[0, 0]) == 1.0
    assert float(jax.grad(lit)(at - 0.1)[0, 0]) == 0.0


def test_no_air_has_exactly_no_gradient(dtype: np.dtype) -> None:
    """DESIGN §3: where there is no air the combine's gradient in the look is exactly zero."""
    at = jnp.full((2, 3), 5.0, dtype)
    layers = Layers(at, at, at - 1, at + 1)
    look = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), LayersLook())
    found = jax.jacrev(lambda look: combine(layers, look))(look)
    for leaf in jax.tree.leaves(found):
        np.testing.assert_array_equal(leaf, 0)


def test_the_planted_scenes_touch_exactly() -> None:
    """The tangent scenes are worth their name: the middle ray passes at exactly one radius."""
    scene = SCENES["tangent to planet"]
    assert float(scene.camera.position[0]) == 1.0
    assert scene.camera.forward[0] == 0.0
    middle = scene_of((1.0, -5.0, 0.0), (1.0, 0.0, 0.0), size=(1, 1), radius=1.0)
    layers = analytic_layers(middle)
    assert np.asarray(layers.planet)[0, 0] == 0.0
    assert layers.back[0, 0] > 0.0 > layers.front[0, 0]
