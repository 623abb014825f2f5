"""Which pixels a fit uses, how they are counted, and that the reduction loses nothing."""

from pathlib import Path

import numpy as np
import pytest

from fit._photo import Photo
from fit._pixels import TILE, choose_pixels, tiles
from fit._reduce import reduce_pixels
from model_jax import InputError, Layers, Linear, layer_widths

SIZE = (6, 5)


def slab(
    planet: np.ndarray | None = None,
    surface: np.ndarray | None = None,
    size: tuple[int, int] = SIZE,
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
    )


def photo_of(linear: np.ndarray, masked: np.ndarray, saturated: np.ndarray) -> Photo:
    """A photo with the given pixels left out by mask and by saturation, mask first."""
    finite = np.isfinite(linear).all(axis=-1)
    return Photo(
        path=Path("made.png"),
        linear=linear,
        valid=~masked & finite & ~saturated,
        excluded={
            "masked": int(masked.sum()),
            "not finite": int((~masked & ~finite).sum()),
            "saturated": int((~masked & finite & saturated).sum()),
        },
        quantisation=None,
        tone_curve=Linear(),
        bits=32,
    )


def check_sum(photo: Photo | np.ndarray, layers: Layers) -> dict[str, int]:
    pixels = choose_pixels(photo, layers)
    assert pixels.count + sum(pixels.excluded.values()) == pixels.used.size
    return pixels.excluded


def test_sky_only_by_default() -> None:
    planet = np.zeros(SIZE, np.float32)
    planet[3:] = 1
    light = np.full((*SIZE, 3), 0.5, np.float32)
    pixels = choose_pixels(light, slab(planet))
    assert pixels.excluded == {"no air": 5, "planet without a surface layer": 15}
    assert pixels.used.sum() == 10
    assert not pixels.remarks


def test_surface_brings_in_the_planet() -> None:
    planet = np.ones(SIZE, np.float32)
    light = np.full((*SIZE, 3), 0.5, np.float32)
    assert check_sum(light, slab(planet, np.zeros((*SIZE, 3), np.float32))) == {"no air": 5}


def test_unknown_planet_is_said() -> None:
    pixels = choose_pixels(np.full((*SIZE, 3), 0.5), slab())
    assert pixels.count == 25
    assert [what for what, _ in pixels.remarks] == ["choice of sky pixels"]


def test_each_pixel_is_counted_once() -> None:
    light = np.full((*SIZE, 3), 0.25, np.float32)
    masked, saturated = np.zeros(SIZE, bool), np.zeros(SIZE, bool)
    light[0, 0] = np.nan  # no air either
    light[1, 0] = np.nan
    light[2, 0:2], saturated[2, 0:2] = 1.0, True
    masked[3, 0:3] = True
    layers = slab()
    back = np.array(layers.back)
    back[4, 0] = np.nan
    layers = Layers(layers.front, back, layers.shadow_front, layers.shadow_back)
    assert check_sum(photo_of(light, masked, saturated), layers) == {
        "no air": 5,
        "masked": 3,
        "not finite": 1,
        "saturated": 2,
        "layers not finite": 1,
    }


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


def test_tiles_hold_the_contract_widths() -> None:
    """More pixels than a tile, and the widths of `layer_widths` (here exact in float32)."""
    size = (200, 100)
    layers = slab(size=size)
    light = np.random.default_rng(0).uniform(size=(*size, 3))
    pixels = choose_pixels(light, layers)
    parts = list(tiles(light, layers, pixels.used))
    assert [part.lit.size for part in parts] == [TILE, pixels.count - TILE]
    lit, dark = layer_widths(layers)
    assert dark is not None
    np.testing.assert_array_equal(
        np.concatenate([part.lit for part in parts]), np.asarray(lit)[pixels.used]
    )
    np.testing.assert_array_equal(
        np.concatenate([part.dark for part in parts]), np.asarray(dark)[pixels.used]
    )
    np.testing.assert_array_equal(
        np.concatenate([part.light for part in parts]), light[pixels.used]
    )


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_reduction_keeps_every_square_sum(scale: float) -> None:
    """|A x - y|² from the triangle and from all pixels, for random x: equal to rounding.

    The first rows have the thinnest air and so the smallest numbers: the scale grows on the way.
    """
    size = (300, 100)
    layers = slab(size=size)
    rng = np.random.default_rng(1)
    light = rng.normal(size=(*size, 3)) * scale * np.indices(size)[0][..., None]
    pixels = choose_pixels(light, layers)
    reduced = reduce_pixels(light, layers, pixels)
    lit, dark = (np.asarray(w, np.float64)[pixels.used] for w in layer_widths(layers))
    matrix = np.column_stack([np.ones_like(lit), lit / reduced.width, dark / reduced.width])
    target = light[pixels.used] / reduced.light
    for _ in range(3):
        x = rng.normal(size=(3, 3))
        whole = ((matrix @ x - target) ** 2).sum()
        small = ((reduced.design @ x - reduced.target) ** 2).sum() + reduced.rest
        # 30,000 terms added pairwise and a backward stable QR: a hundred roundings at most.
        assert small == pytest.approx(whole, rel=100 * np.finfo(float).eps)
    assert reduced.variation == pytest.approx(((target - target.mean(0)) ** 2).sum(), rel=1e-12)
