"""Which pixels a fit uses, how they are counted, and that few pseudo-pixels stand for all."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit._choices import Sampling, check_sampling, check_where
from fit.photo._columns import Columns, take_columns, unlit_columns
from fit.photo._photo import REASONS, Photo
from fit.photo._pixels import choose_pixels
from fit.solve._descend import exact_gram
from fit.solve._layout import Layout
from fit.solve._loss import Loss
from fit.solve._model import Model
from fit.solve._reduce import BINS, THIN, bins, moments, thinned
from fit.solve._samples import TILE, Samples, to_samples
from model_jax import InputError, Layers, LayersLook, Linear, layer_widths

SIZE = (6, 5)
LINEAR = Model(Loss("linear"), None, Layout(LayersLook), True)


def slab(
    planet: np.ndarray | None = None,
    surface: np.ndarray | None = None,
    size: tuple[int, int] = SIZE,
    color: Sequence[float] = (1.0, 1.0, 1.0, 1.0),
) -> Layers:
    """Air of growing thickness in all rows but the first; shadow in its right half."""
    rows, columns = np.indices(size)
    back = (rows * (1 + columns)).astype(np.float32)
    return Layers(
        front=np.zeros(size, np.float32),
        back=back,
        shadow_front=np.where(columns > size[1] // 2, back / 2, back).astype(np.float32),
        shadow_back=back,
        planet=planet,
        surface=surface,
        color=color,
    )


def photo_of(linear: np.ndarray, masked: np.ndarray, codes: np.ndarray | None = None) -> Photo:
    """A photo with the given pixels left out, mask first; with codes one of 8 bits."""
    reason = np.where(np.isfinite(linear).all(axis=-1), 0, 1 + REASONS.index("not finite"))
    return Photo(
        path=Path("made.png"),
        stored=linear if codes is None else codes,
        reason=np.where(masked, 1 + REASONS.index("masked"), reason).astype(np.uint8),
        tone_curve=Linear(),
        bits=32 if codes is None else 8,
        light=None if codes is None else np.arange(256, dtype=np.float32) / 255,
        half_steps=None if codes is None else np.full(256, 0.5 / 255, np.float32),
    )


def columns_of(photo: Photo | np.ndarray, layers: Layers, unit: float = 1.0) -> Columns:
    return take_columns(photo, layers, choose_pixels(photo, layers, "point").used, unit)


def check_sum(photo: Photo | np.ndarray, layers: Layers) -> dict[str, int]:
    pixels = choose_pixels(photo, layers, "point")
    assert pixels.count + sum(pixels.excluded.values()) == pixels.used.size
    return pixels.excluded


def test_sky_only_by_default() -> None:
    planet = np.zeros(SIZE, np.float32)
    planet[3:] = 1
    light = np.full((*SIZE, 3), 0.5, np.float32)
    pixels = choose_pixels(light, slab(planet), "point")
    assert pixels.excluded == {"no air": 5, "planet without a surface layer": 15}
    assert pixels.used.sum() == 10
    assert not pixels.remarks


def test_surface_brings_in_the_planet() -> None:
    planet = np.ones(SIZE, np.float32)
    light = np.full((*SIZE, 3), 0.5, np.float32)
    assert check_sum(light, slab(planet, np.zeros((*SIZE, 3), np.float32))) == {"no air": 5}


@pytest.mark.parametrize("sampling", ["area", "point"])
def test_ring_and_planet_are_the_parts_of_all(sampling: Sampling) -> None:
    size = (12, 14)
    planet = np.zeros(size, np.float32)
    planet[7:] = 1
    layers = slab(planet, np.ones((*size, 3), np.float32), size)
    light = np.full((*size, 3), 0.5, np.float32)
    whole = choose_pixels(light, layers, sampling)
    ring = choose_pixels(light, layers, sampling, "ring")
    disc = choose_pixels(light, layers, sampling, "planet")
    assert ring.count > 0
    assert disc.count > 0
    np.testing.assert_array_equal(ring.used, whole.used & (planet == 0))
    np.testing.assert_array_equal(disc.used, whole.used & (planet == 1))
    np.testing.assert_array_equal(ring.edges | disc.edges, whole.edges)
    assert ring.excluded["in front of the planet"] == 5 * 14
    assert disc.excluded["in front of space"] == 6 * 14  # row 0 has no air
    for pixels in (ring, disc):
        assert pixels.count + sum(pixels.excluded.values()) == pixels.used.size


def test_a_place_needs_a_planet_that_is_known() -> None:
    light, planet = np.full((*SIZE, 3), 0.5, np.float32), np.ones(SIZE, np.float32)
    message = r"where: 'ring' asks where the planet is, which the layers do not tell; give layers"
    with pytest.raises(InputError, match=message):
        choose_pixels(light, slab(), "point", "ring")
    # Of a planet without a surface nothing is known either.
    bare = choose_pixels(light, slab(planet), "point", "planet")
    assert bare.excluded == {"no air": 5, "planet without a surface layer": 25}
    assert check_where("ring") == "ring"
    with pytest.raises(InputError, match=r"where: 'rim' is unknown; choose from \['all', 'ring'"):
        check_where("rim")


def test_a_black_surface_is_none() -> None:
    """Of the pixels used: what is behind the others costs the fit nothing either."""
    light = np.random.default_rng(0).uniform(size=(*SIZE, 3)).astype(np.float32)
    surface, planet = np.zeros((*SIZE, 3), np.float32), np.ones(SIZE, np.float32)
    assert columns_of(light, slab(planet, surface)).surface is None
    surface[0] = 1  # no air
    assert columns_of(light, slab(planet, surface)).surface is None
    surface[3, 1, 2] = 0.25
    seen = columns_of(light, slab(planet, surface))
    assert seen.surface is not None
    np.testing.assert_array_equal(seen.surface, surface.reshape(-1, 3)[seen.index])
    every = np.arange(SIZE[0] * SIZE[1])
    beside = unlit_columns(slab(planet, surface), every, seen, 1.0)
    np.testing.assert_array_equal(beside.surface, surface.reshape(-1, 3))
    assert unlit_columns(slab(planet, 0 * surface), every, seen, 1.0).surface is None


def test_unknown_planet_is_said() -> None:
    pixels = choose_pixels(np.full((*SIZE, 3), 0.5), slab(), "point")
    assert pixels.count == 25
    assert [what for what, _ in pixels.remarks] == ["choice of sky pixels"]


def test_each_pixel_is_counted_once() -> None:
    light = np.full((*SIZE, 3), 0.25, np.float32)
    masked = np.zeros(SIZE, bool)
    light[0, 0] = np.nan  # no air either
    light[1, 0] = np.nan
    light[3, 0] = np.nan  # masked as well
    masked[3, 0:3] = True
    layers = slab()
    back = np.array(layers.back)
    back[4, 0] = np.nan
    layers = Layers(layers.front, back, layers.shadow_front, layers.shadow_back)
    counts = {"no air": 5, "masked": 3, "not finite": 1, "layers not finite": 1}
    assert check_sum(photo_of(light, masked), layers) == counts
    codes = np.full((*SIZE, 3), 255, np.uint8)
    codes[5] = 0
    assert check_sum(photo_of(light, masked, codes), layers) == counts


def test_edges_of_a_picture_of_areas_are_left_out() -> None:
    """Both sides of the border between air and none, limb and sky, shaded and sunlit air."""
    size = (12, 14)
    planet = np.zeros(size, np.float32)
    planet[10:] = 1
    layers = slab(planet, size=size)
    light = np.full((*size, 3), 0.5, np.float32)
    pixels = choose_pixels(light, layers)
    expected = np.zeros(size, bool)
    expected[2:9] = True  # without row 1 beside space and row 9 beside the planet
    expected[:, 7:9] = False  # the shadow begins at column 8
    np.testing.assert_array_equal(pixels.used, expected)
    assert pixels.excluded == {
        "no air": 14,
        "planet without a surface layer": 28,
        "planet's limb": 14,
        "edge of the air": 14,
        "edge of the shadow": 14,
    }
    assert not pixels.remarks
    every = choose_pixels(light, layers, "point")
    np.testing.assert_array_equal(pixels.edges, every.used & ~pixels.used)
    assert not every.edges.any()
    assert every.excluded == {"no air": 14, "planet without a surface layer": 28}


def test_air_that_is_all_edges_keeps_them() -> None:
    pixels = choose_pixels(np.full((*SIZE, 3), 0.5), slab(np.zeros(SIZE, np.float32)))
    assert pixels.count == 12
    thin = choose_pixels(np.full((2, 5, 3), 0.5), slab(np.zeros((2, 5), np.float32), size=(2, 5)))
    assert thin.count == 5
    assert [what for what, _ in thin.remarks] == ["averaging on edges"]


def test_missing_layers_make_no_edge() -> None:
    layers = slab(size=(12, 14))
    back = np.array(layers.back)
    back[5, 3] = np.nan
    holed = replace(layers, back=back)
    light = np.full((12, 14, 3), 0.5)
    whole, found = choose_pixels(light, layers), choose_pixels(light, holed)
    assert found.excluded == whole.excluded | {"layers not finite": 1}


def test_sampling_is_named() -> None:
    assert check_sampling("point") == "point"
    with pytest.raises(InputError, match=r"sampling: 'pixel' is unknown; choose from \['area'"):
        check_sampling("pixel")


def test_infinite_shadow_depths_are_no_fault() -> None:
    layers = slab()
    endless = np.full(SIZE, np.inf, np.float32)
    light = np.full((*SIZE, 3), 0.5)
    assert check_sum(light, Layers(layers.front, layers.back, layers.back, endless)) == {
        "no air": 5
    }


def test_sizes_are_named() -> None:
    with pytest.raises(InputError, match=r"photo: is 4×6, the layers are 5×6"):
        choose_pixels(np.zeros((6, 4, 3)), slab())


@pytest.mark.parametrize(
    ("photo", "message"),
    [
        (np.zeros(SIZE), "shape"),
        (np.zeros((*SIZE, 4)), "shape"),
        (np.zeros((*SIZE, 3), np.uint8), "uint8"),
    ],
    ids=["grey", "rgba", "codes"],
)
def test_wrong_arrays(photo: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choose_pixels(photo, slab())


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_columns_hold_the_contract_widths(dtype: type) -> None:
    """The widths of `layer_widths`, exact here in float32, as float64; light as it is, if not half
    floats."""
    light: np.ndarray = np.random.default_rng(0).uniform(size=(*SIZE, 3)).astype(dtype)
    layers = slab()
    found, scaled = columns_of(light, layers), columns_of(light, layers, 4.0)
    used = choose_pixels(light, layers, "point").used
    lit, dark = layer_widths(layers)
    assert found.fields["lit"].dtype == found.fields["dark"].dtype == np.float64
    assert found.light.dtype == max(np.dtype(dtype), np.dtype(np.float32))
    np.testing.assert_array_equal(found.index, np.flatnonzero(used))
    np.testing.assert_array_equal(found.fields["lit"], np.asarray(lit)[used])
    np.testing.assert_array_equal(found.fields["dark"], np.asarray(dark)[used])
    np.testing.assert_array_equal(found.light, light[used])
    np.testing.assert_array_equal(4 * scaled.fields["lit"], found.fields["lit"])
    np.testing.assert_array_equal(4 * scaled.fields["dark"], found.fields["dark"])
    assert 4 * scaled.width_error == found.width_error
    assert (found.surface, found.clipped) == (None, None)


def test_lengths_along_rays_are_stretched_widths() -> None:
    stretch = np.linspace(1, 2, SIZE[0] * SIZE[1]).reshape(SIZE).astype(np.float32)
    longer = replace(slab(), stretch=stretch)
    light = np.ones((*SIZE, 3))
    plain, found = columns_of(light, slab()), columns_of(light, longer)
    factor = stretch.reshape(-1)[found.index].astype(np.float64)
    np.testing.assert_allclose(found.fields["lit"], plain.fields["lit"] * factor, rtol=1e-15)
    np.testing.assert_allclose(found.fields["dark"], plain.fields["dark"] * factor, rtol=1e-15)
    assert found.width_error == plain.width_error * np.max(factor)
    broken = np.where(stretch == stretch.max(), np.nan, stretch)
    pixels = choose_pixels(light, replace(slab(), stretch=broken))
    assert pixels.excluded["layers not finite"] == 1


def test_layers_without_shadow_have_no_dark_column() -> None:
    layers = slab()
    found = columns_of(np.ones((*SIZE, 3)), Layers(layers.front, layers.back))
    assert list(found.fields) == ["lit"]


def test_clipped_samples_hold_their_bound_and_come_last() -> None:
    codes = np.full((*SIZE, 3), 100, np.uint8)
    codes[0] = 255  # no air
    codes[2, 3, 1] = 255
    codes[4, 1] = [0, 7, 255]
    photo = photo_of((codes / 255).astype(np.float32), np.zeros(SIZE, bool), codes)
    found = columns_of(photo, slab())
    assert found.clipped is not None
    assert found.clipped.dtype == np.int8
    assert len(found.index) == 25
    np.testing.assert_array_equal(found.index[-2:], [2 * 5 + 3, 4 * 5 + 1])
    np.testing.assert_array_equal(found.clipped[-2:], [[0, 1, 0], [-1, 0, 1]])
    assert not found.clipped[:-2].any()
    assert (np.diff(found.index[:-2]) > 0).all()
    expected = [[100 / 255, 254.5 / 255, 100 / 255], [0.5 / 255, 7 / 255, 254.5 / 255]]
    np.testing.assert_allclose(found.light[-2:], expected, rtol=2e-7)


def test_no_infinite_light_reaches_a_fit() -> None:
    """A photo's NaN and infinite samples are left out, and a clipped one's bound is finite."""
    light = np.full((*SIZE, 3), 0.5)
    light[2, 2], light[3, 3, 0] = np.inf, np.nan
    found = columns_of(light, slab())
    assert len(found.index) == 23
    assert np.isfinite(found.light).all()


def sizes_of_tiles(samples: Samples) -> list[int]:
    return np.asarray(samples.count)[: int(samples.used)].tolist()


def test_tiles_hold_each_pixel_once() -> None:
    """Two photos: tiles of their own, in order, the last ones part full and the rest empty."""
    size = (2 * TILE // 40, 50)  # two tiles and part of a third
    first = columns_of(np.random.default_rng(0).uniform(size=(*size, 3)), slab(size=size))
    second = columns_of(np.random.default_rng(1).uniform(size=(7, 9, 3)), slab(size=(7, 9)))
    second = replace(second, fields={"lit": second.fields["lit"]})
    samples = to_samples([first, second])
    n = len(first.index)
    assert sizes_of_tiles(samples) == [TILE, TILE, n - 2 * TILE, len(second.index)]
    assert np.asarray(samples.photo)[:4].tolist() == [0, 0, 0, 1]
    assert not np.asarray(samples.count)[4:].any()
    lit = np.asarray(samples.fields["lit"])
    np.testing.assert_array_equal(lit[:3].reshape(-1)[:n], first.fields["lit"])
    np.testing.assert_array_equal(lit[3, : len(second.index)], second.fields["lit"])
    light = np.moveaxis(np.asarray(samples.light)[:3], 1, 2).reshape(-1, 3)
    np.testing.assert_array_equal(light[:n], first.light)
    # What one photo has, all have: no shadow is a width of 0.
    assert not np.asarray(samples.fields["dark"])[3].any()
    assert (samples.surface, samples.clipped, samples.weight, samples.one) == (None,) * 4


def pictures(rng: np.random.Generator, surface: bool, scale: float) -> list[Columns]:
    """Two photos of random light, of which the first needs two tiles, with colours of their own."""
    found = []
    for size, color in (((60, 50), (1.0, 0.8, 0.5, 1.0)), ((30, 20), (0.3, 1.0, 1.0, 1.0))):
        behind = rng.uniform(size=(*size, 3)) * scale if surface else None
        layers = slab(surface=behind, size=size, color=color)
        found.append(columns_of(rng.normal(size=(*size, 3)) * scale, layers))
    return found


def random_entries(rng: np.random.Generator, scale: float, photos: int) -> np.ndarray:
    """A look and responses of gamma 1: brightness, shadow, tint, background, then each photo's."""
    look = [scale, *rng.uniform(0, 2, 3), *rng.uniform(0, 2, 3), *scale * rng.normal(size=3)]
    responses = [[rng.uniform(0.5, 2), 1.0, scale * rng.normal()] for _ in range(photos)]
    return np.array([*look, *np.ravel(responses)])


@pytest.mark.parametrize("surface", [False, True], ids=["sky", "surface"])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_moments_keep_every_square_sum(scale: float, surface: bool, x64: None) -> None:
    """Cost and slopes from nine pseudo-pixels a photo and from all, for random looks."""
    rng = np.random.default_rng(1)
    whole = jax.tree.map(jnp.asarray, to_samples(pictures(rng, surface, scale)))
    few = jax.tree.map(jnp.asarray, moments(whole))
    assert np.asarray(few.count).sum() <= 2 * 9
    for _ in range(3):
        entries = jnp.asarray(random_entries(rng, scale, 2))
        along = jnp.asarray(np.diag(np.where(np.abs(entries) > 0, np.abs(entries), 1.0)))
        ours, theirs = (np.asarray(exact_gram(entries, along, s, LINEAR)) for s in (few, whole))
        # Sums of products hold a square sum to some eps of its largest part: of 10⁴ terms added in
        # tiles, and of an eigenvalue decomposition of nine rows.
        size = np.sqrt(np.diag(theirs))
        np.testing.assert_array_less(np.abs(ours - theirs), 1e-13 * np.outer(size, size) + 1e-300)


def test_bins_weigh_all_pixels(x64: None) -> None:
    """Weights add up to the pixels, means and squares to the sums; clipped ones have their own."""
    rng = np.random.default_rng(2)
    first, second = pictures(rng, False, 1.0)
    clipped = np.zeros(first.light.shape, np.int8)
    clipped[-300:] = rng.integers(-1, 2, (300, 3))
    light = np.where(clipped > 0, 0.9, np.where(clipped < 0, 0.1, first.light))
    first = replace(first, clipped=clipped, light=light)
    made = bins([first, second])
    every, weight = np.asarray(made.weight), np.asarray(made.weight) * np.asarray(made.one)
    tiles = [np.asarray(made.photo)[: int(made.used)] == k for k in range(2)]
    for columns, mine in zip((first, second), tiles, strict=True):
        rows = np.flatnonzero(mine)
        assert weight[rows].sum() == pytest.approx(len(columns.index), rel=1e-13)
        for part, whole in (
            (np.asarray(made.fields["lit"])[rows], columns.fields["lit"]),
            (np.asarray(made.fields["dark"])[rows], columns.fields["dark"]),
            (np.asarray(made.light)[rows, 1], columns.light[:, 1]),
        ):
            assert (part * weight[rows]).sum() == pytest.approx(whole.sum(), rel=1e-12, abs=1e-10)
        for k in range(3):
            squares = (np.asarray(made.light)[rows, k] ** 2 * every[rows]).sum()
            assert squares == pytest.approx((columns.light[:, k] ** 2).sum(), rel=1e-12)
    assert made.clipped is not None
    rows = np.flatnonzero(tiles[0])
    for kind, bound in ((1, 0.9), (-1, 0.1)):
        there = np.moveaxis(np.asarray(made.clipped)[rows] == kind, 1, 2)
        own = np.moveaxis(np.asarray(made.light)[rows], 1, 2)[there]
        np.testing.assert_allclose(own, bound, rtol=1e-14)
        counted = (there * weight[rows][..., None]).sum()
        assert counted == pytest.approx((clipped == kind).sum(), rel=1e-13)


def test_bins_are_close_to_the_pixels(x64: None) -> None:
    """A width is off by half a bin at most: a 512th of the range, of the light's slope by it."""
    columns = columns_of(np.random.default_rng(3).uniform(size=(120, 90, 3)), slab(size=(120, 90)))
    made = bins([columns])
    n = int((np.asarray(made.weight) > 0).sum())
    assert n < len(columns.index)
    spread = float((columns.fields["lit"] ** 2).sum())
    weighted = float((np.asarray(made.weight) * np.asarray(made.fields["lit"]) ** 2).sum())
    # The mean of squares exceeds the square of the mean by a bin's variance, at most (bin / 2)².
    room = len(columns.index) * (np.ptp(columns.fields["lit"]) / BINS / 2) ** 2
    assert 0 <= spread - weighted <= room


def test_thinned_pixels_stand_for_all(x64: None) -> None:
    n = 2 * THIN + 5
    rng = np.random.default_rng(4)
    whole = Columns(
        index=np.arange(n),
        fields={"lit": rng.uniform(size=n)},
        light=rng.uniform(size=(n, 3)),
        surface=rng.uniform(size=(n, 3)),
        clipped=np.zeros((n, 3), np.int8),
        color=np.ones(3),
        width_error=0.0,
    )
    few = thinned([whole])
    kept = -(-n // 2)
    assert np.asarray(few.weight).sum() == 2 * kept
    assert int(np.asarray(few.count).sum()) == kept
    assert np.asarray(few.fields["lit"])[0, :5].tolist() == whole.fields["lit"][:10:2].tolist()
