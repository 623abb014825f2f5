"""The combine contract by hand, its clamps, its colour, and what `composite` adds."""

from dataclasses import fields
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from model_jax import (
    DepthTextures,
    InputError,
    Layers,
    LayersLook,
    combine,
    composite,
    layer_widths,
    linearize_depth,
)
from model_jax._view import ray_offsets, view_of

from .ray_march import union
from .scenes import scene_of

VIEW = view_of(scene_of((9000.0, 0.0, 0.0)))

# name: (front, back, shadow_front, shadow_back) -> (lit, dark), all exact in binary.
CASES = {
    "shadow inside": ((1.0, 9.0, 3.0, 5.0), (6.0, 2.0)),
    "shadow before the air": ((4.0, 9.0, 1.0, 3.0), (5.0, 0.0)),
    "shadow behind the air": ((1.0, 4.0, 6.0, 8.0), (3.0, 0.0)),
    "shadow enters before": ((2.0, 9.0, 1.0, 5.0), (4.0, 3.0)),
    "shadow leaves behind": ((2.0, 9.0, 6.0, 12.0), (4.0, 3.0)),
    "shadow around the air": ((2.0, 9.0, 1.0, 12.0), (0.0, 7.0)),
    "shadow is the air": ((2.0, 9.0, 2.0, 9.0), (0.0, 7.0)),
    "shadow touches the front": ((2.0, 9.0, 1.0, 2.0), (7.0, 0.0)),
    "empty shadow in the air": ((2.0, 9.0, 4.0, 4.0), (7.0, 0.0)),
    "no air": ((5.0, 5.0, 1.0, 9.0), (0.0, 0.0)),
    "nothing at all": ((5.0, 5.0, 5.0, 5.0), (0.0, 0.0)),
    "before the reference": ((-3.0, 1.0, -2.0, 0.5), (1.5, 2.5)),
}
COLUMNS = [np.array([case[0][k] for case in CASES.values()]) for k in range(4)]
LIT, DARK = (np.array([case[1][k] for case in CASES.values()]) for k in range(2))


def layers_of(dtype: np.dtype, shadow: bool = True, **more: Any) -> Layers:
    """All cases as the pixels of one row."""
    front, back, shadow_front, shadow_back = (c[None, :].astype(dtype) for c in COLUMNS)
    if not shadow:
        return Layers(front, back, **more)
    return Layers(front, back, shadow_front, shadow_back, **more)


@pytest.mark.parametrize("unit", [1.0, 4.0])
def test_widths_by_hand(unit: float, dtype: np.dtype) -> None:
    lit, dark = layer_widths(layers_of(dtype, width_unit=unit))
    assert dark is not None
    assert lit.dtype == dark.dtype == dtype
    for k, name in enumerate(CASES):
        assert (float(lit[0, k]), float(dark[0, k])) == (LIT[k] / unit, DARK[k] / unit), name


def test_without_shadow_all_air_is_lit(dtype: np.dtype) -> None:
    lit, dark = layer_widths(layers_of(dtype, shadow=False))
    assert dark is None
    np.testing.assert_array_equal(lit[0], LIT + DARK)


def test_clamping_commutes_with_linearising_bit_for_bit(
    rng: np.random.Generator, dtype: np.dtype
) -> None:
    """min and max select, and linearising is monotone: which of two equal depths is taken does not
    show. So the contract's clamp in window depth equals the clamp in eye depth exactly."""
    near, far = 1.0, 300.0
    front, back = np.sort(rng.random((2, 40, 50)), axis=0).astype(dtype)
    shadow_front, shadow_back = np.sort(rng.random((2, 40, 50)), axis=0).astype(dtype)
    shadow_back[0], shadow_front[1] = front[0], back[1]
    textures = DepthTextures(front, back, shadow_front, shadow_back, near, far, encoding="window")
    lit, dark = layer_widths(textures.linearize())
    shb = linearize_depth(np.minimum(np.maximum(shadow_back, front), back), near, far)
    shf = linearize_depth(np.minimum(np.maximum(shadow_front, front), back), near, far)
    z_front, z_back = linearize_depth(front, near, far), linearize_depth(back, near, far)
    unit = jnp.asarray(far - near, dtype)
    np.testing.assert_array_equal(lit, ((z_back - shb) + (shf - z_front)) / unit)
    np.testing.assert_array_equal(dark, (shb - shf) / unit)
    assert float(np.max(np.asarray(dark))) > 0.1


def test_combine_is_the_contract(dtype: np.dtype) -> None:
    """`rgb = brightness · color · tint · (lit + shadow · dark)`; five rounded factors and a sum."""
    look = LayersLook(brightness=2.5, shadow=0.3, tint=(0.5, 1.0, 1.5))
    color = np.array([0.4, 0.6, 0.9, 0.7])
    got = combine(layers_of(dtype, color=color, width_unit=3.0), look)
    assert got.dtype == dtype
    width = (LIT + 0.3 * DARK) / 3.0
    expected = 2.5 * width[:, None] * color[:3] * np.array([0.5, 1.0, 1.5])
    np.testing.assert_allclose(got[0, :, :3], expected, rtol=8 * np.finfo(dtype).eps)


def test_defaults_are_the_papers() -> None:
    look = LayersLook()
    assert (float(look.brightness), float(look.shadow)) == (3.0, 0.2)
    got = combine(layers_of(np.dtype("float32")), look)
    expected = 3.0 * (LIT + 0.2 * DARK)
    np.testing.assert_allclose(got[0, :, 1], expected, rtol=4 * float(np.finfo(np.float32).eps))


def test_alpha_is_the_colours_where_there_is_air(dtype: np.dtype) -> None:
    got = combine(layers_of(dtype, color=np.array([1.0, 1.0, 1.0, 0.5])), LayersLook())
    np.testing.assert_array_equal(got[0, :, 3], np.where(LIT + DARK > 0, 0.5, 0.0))


def test_shadow_per_channel_is_three_pictures_in_one(dtype: np.dtype) -> None:
    weights = (0.1, 0.2, 0.7)
    together = combine(layers_of(dtype), LayersLook(shadow=weights))
    for channel, weight in enumerate(weights):
        alone = combine(layers_of(dtype), LayersLook(shadow=weight))
        np.testing.assert_array_equal(together[..., channel], alone[..., channel])


def test_shadow_one_is_no_shadow(dtype: np.dtype) -> None:
    """A shadow as bright as light: lit + dark is the air, here exactly (small whole numbers)."""
    with_shadow = combine(layers_of(dtype), LayersLook(shadow=1.0))
    without = combine(layers_of(dtype, shadow=False), LayersLook())
    np.testing.assert_array_equal(with_shadow, without)


@pytest.mark.parametrize("background", [0.25, (0.25, 0.5, 0.125)], ids=["number", "channels"])
def test_composite_adds_surface_and_background(background: object, dtype: np.dtype) -> None:
    shape = (1, len(CASES))
    surface = np.full((*shape, 3), 0.5, dtype)
    planet = np.zeros(shape, dtype)
    planet[0, ::2] = 1
    color = np.array([1.0, 1.0, 1.0, 0.5])
    layers = layers_of(dtype, surface=surface, planet=planet, color=color)
    look = LayersLook(background=background)
    got, air = composite(layers, look), combine(layers, look)
    added = np.broadcast_to(np.asarray(background) + 0.5, (*got.shape[:2], 3))
    # One sum of two roundings: the order in which three numbers are added is not the contract's.
    np.testing.assert_allclose(
        got[..., :3] - air[..., :3], added, rtol=0, atol=_ulps(np.asarray(got))
    )
    np.testing.assert_array_equal(got[0, :, 3], np.maximum(air[0, :, 3], planet[0]))


def _ulps(image: np.ndarray) -> float:
    return 2 * float(np.finfo(image.dtype).eps) * float(np.max(image))


def test_composite_of_nothing_but_air_is_the_combine(dtype: np.dtype) -> None:
    layers = layers_of(dtype)
    np.testing.assert_array_equal(composite(layers, LayersLook()), combine(layers, LayersLook()))


def shadows_of(rng: np.random.Generator, count: int, dtype: np.dtype) -> Layers:
    """Air and shadows of 40 × 50 pixels: apart, overlapping, nested, empty, and beside the air."""
    front, back = np.sort(rng.random((2, 40, 50)), axis=0)
    begin, end = np.sort(rng.uniform(-0.5, 1.5, (2, count, 40, 50)), axis=0)
    end = np.where(rng.random(end.shape) < 0.2, begin, end)
    back[0] = front[0]
    return Layers(*(depth.astype(dtype) for depth in (front, back, begin, end)))


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_overlapping_shadows_count_once(
    count: int, rng: np.random.Generator, dtype: np.dtype
) -> None:
    layers = shadows_of(rng, count, dtype)
    front, back = np.asarray(layers.front, float), np.asarray(layers.back, float)
    ends = (np.asarray(depth, float) for depth in (layers.shadow_front, layers.shadow_back))
    covered = union(list(zip(*(np.clip(depth, front, back) for depth in ends), strict=True)))
    lit, dark = layer_widths(layers)
    assert dark is not None
    assert lit.dtype == dark.dtype == dtype
    # Each of `count` + 1 differences of depths below 1, and each sum, is off by half an ulp of 1.
    atol = (count + 1) * np.finfo(dtype).eps
    np.testing.assert_allclose(dark, covered, rtol=0, atol=atol)
    np.testing.assert_allclose(lit, back - front - covered, rtol=0, atol=atol)
    if count > 1:
        alone = np.asarray(layers.shadow_back)[0] - np.asarray(layers.shadow_front)[0]
        assert np.mean(np.asarray(dark) != alone) > 0.5


def test_one_shadow_of_several_is_the_contract_bit_for_bit(
    rng: np.random.Generator, dtype: np.dtype
) -> None:
    layers = shadows_of(rng, 1, dtype)
    begin, end = np.asarray(layers.shadow_front), np.asarray(layers.shadow_back)
    alone = Layers(layers.front, layers.back, begin[0], end[0])
    for one, several in zip(layer_widths(alone), layer_widths(layers), strict=True):
        np.testing.assert_array_equal(one, several)


def test_the_order_of_shadows_does_not_show(rng: np.random.Generator, dtype: np.dtype) -> None:
    layers = shadows_of(rng, 4, dtype)
    begin, end = np.asarray(layers.shadow_front), np.asarray(layers.shadow_back)
    turned = Layers(layers.front, layers.back, begin[::-1], end[::-1])
    for width, again in zip(layer_widths(layers), layer_widths(turned), strict=True):
        # Shadows that begin together are added in the order given: sums are rounded differently.
        assert width is not None
        assert again is not None
        np.testing.assert_allclose(width, again, rtol=0, atol=5 * np.finfo(dtype).eps)


def test_half_a_shadow_is_refused() -> None:
    pixels = np.zeros((2, 3), np.float32)
    with pytest.raises(InputError, match=r"shadow_front has shape \(2, 3\) and .* give both"):
        Layers(pixels, pixels, pixels)


def test_rows_are_a_part_of_the_picture(rng: np.random.Generator) -> None:
    layers = shadows_of(rng, 3, np.dtype("float32"))
    for width, some in zip(
        layer_widths(layers), layer_widths(layers.rows(slice(5, 9))), strict=True
    ):
        np.testing.assert_array_equal(np.asarray(width)[5:9], some)


def test_rows_have_all_that_the_whole_has() -> None:
    """Every field, so that a new one cannot be lost, or be as large as the whole."""
    shape, several = (6, 4), (2, 6, 4)
    numbers = iter(range(1, 100))
    given = {
        "front": shape,
        "back": shape,
        "shadow_front": several,
        "shadow_back": several,
        "surface": (*shape, 3),
        "planet": shape,
        "color": (4,),
        "reference": (),
        "width_unit": (),
        "stretch": shape,
        "width_error": shape,
        "water": shape,
    }
    names = {*given, "view", "is_albedo"}
    assert names == {field.name for field in fields(Layers)}
    maps: dict[str, Any] = {n: np.full(size, next(numbers), float) for n, size in given.items()}
    whole = Layers(**maps, view=VIEW, is_albedo=True)
    some = whole.rows(slice(1, 3))
    assert some.is_albedo
    for name, size in given.items():
        axis = {"surface": 0}.get(name, len(size) - 2)
        value, part = np.asarray(getattr(whole, name)), np.asarray(getattr(some, name))
        expected = np.take(value, [1, 2], axis) if len(size) > 1 else value
        np.testing.assert_array_equal(part, expected)
    assert some.view is not None  # what the second row was is the first now
    zero, one = np.zeros(1), np.ones(1)
    assert ray_offsets(some.view.aim, zero, zero) == ray_offsets(VIEW.aim, zero, one)
