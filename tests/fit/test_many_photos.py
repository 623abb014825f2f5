"""Several photos at once: one look in physical units, a response for each, one covariance."""

from pathlib import Path

import jax
import numpy as np
import pytest
from PIL import Image

from fit import FitResult, fit, load_photo
from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    Layers,
    LayersLook,
    Planet,
    Response,
    Scene,
    Srgb,
    Sun,
    composite,
    record,
)

from .looks import START, exact_layers, scene, to_values

TRUTH = LayersLook(3.0, 0.2, (0.8, 0.9, 1.3))
"""Brightness by the first layers' unit. The background is the black levels' affair."""

RESPONSES = (Response(1.0, black_level=0.01), Response(2.5, black_level=0.02))
SHARED = ("shadow", "tint.r", "tint.g", "tint.b")
NOISE = 0.02


def elsewhere() -> Scene:
    """The planet of `scene`, by another camera: place, field, size and clip planes."""
    return Scene(
        camera=Camera(
            position=(-1.6, 0.9, 2.2),
            forward=(1.5, -0.8, -2.2),
            up=(0, 1, 0),
            fov_y_deg=58,
            width=120,
            height=100,
            near=1.0,
            far=9.0,
        ),
        planet=Planet(radius=1.0),
        atmosphere=Atmosphere(height=0.2),
        sun=Sun(direction=(1, 0.2, 0.3)),
    )


@pytest.fixture(scope="module")
def both() -> tuple[Layers, Layers]:
    return exact_layers(scene()), exact_layers(elsewhere())


def shoot(
    layers: Layers, response: Response, unit: float, noise: float = 0.0, seed: int = 0
) -> np.ndarray:
    """A photo of the true look, its brightness taken from the length `unit` to the layers' own."""
    brightness = TRUTH.brightness * float(layers.width_unit) / unit
    look = LayersLook(brightness, TRUTH.shadow, TRUTH.tint, background=TRUTH.background)
    with jax.enable_x64(True):
        clean = np.asarray(record(composite(layers, look)[..., :3], response))
    return clean + np.random.default_rng(seed).normal(scale=noise, size=clean.shape)


def shots(both: tuple[Layers, Layers], noise: float = 0.0) -> list[np.ndarray]:
    unit = float(both[0].width_unit)
    return [
        shoot(layers, response, unit, noise, seed)
        for seed, (layers, response) in enumerate(zip(both, RESPONSES, strict=True))
    ]


@pytest.fixture(scope="module")
def noisy(both: tuple[Layers, Layers]) -> FitResult:
    return fit(shots(both, NOISE), both, START)


def true_values() -> dict[str, float]:
    tints = dict(zip(("tint.r", "tint.g", "tint.b"), (0.8, 0.9, 1.3), strict=True))
    levels = {"black_level.1": 0.01, "black_level.2": 0.02}
    return {"brightness": 3.0, "shadow": 0.2, "exposure.2": 2.5, **tints, **levels}


def test_recovers_one_look_from_two_cameras(both: tuple[Layers, Layers]) -> None:
    result = fit(shots(both), both, START)
    assert result.verdict == "converged", result.message
    for name, true in true_values().items():
        assert result.parameters[name].value == pytest.approx(true, rel=1e-6, abs=1e-8), name
    assert set(result.correlation_names) == set(true_values())
    assert [photo.width_unit for photo in result.photos] == [5.5, 8.0]
    assert result.per_length["brightness"] == pytest.approx(3.0 / 5.5, rel=1e-6)
    exposures = [float(photo.response.exposure) for photo in result.photos]
    assert exposures == pytest.approx([1.0, 2.5], rel=1e-6)
    assert result.pixels["used"] == sum(int(photo.used.sum()) for photo in result.photos)
    assert [photo.used.shape for photo in result.photos] == [(128, 160), (100, 120)]


def test_brightness_is_no_number_of_one_clip_plane(both: tuple[Layers, Layers]) -> None:
    """Moving a photo's near and far changes brightness, not brightness per length."""
    first, second = both
    moved = Layers(
        first.front,
        first.back,
        first.shadow_front,
        first.shadow_back,
        planet=first.planet,
        width_unit=11.0,
    )
    photos = shots(both)
    result = fit(photos, [moved, second], START)
    assert result.look.brightness == pytest.approx(6.0, rel=1e-6)
    assert result.per_length["brightness"] == pytest.approx(3.0 / 5.5, rel=1e-6)
    assert result.parameters["exposure.2"].value == pytest.approx(2.5, rel=1e-6)


def test_order_matters_to_the_reference_only(both: tuple[Layers, Layers], noisy: FitResult) -> None:
    """The first photo's exposure is the one that the other is relative to.

    Both ends are within 1e-3 standard errors of the optimum (`_polish.CHECK`).
    """
    turned = fit(shots(both, NOISE)[::-1], both[::-1], START)
    for name in SHARED:
        one, other = noisy.parameters[name], turned.parameters[name]
        assert one.stderr is not None
        assert other.value == pytest.approx(one.value, abs=2e-3 * one.stderr)
        assert other.stderr == pytest.approx(one.stderr, rel=1e-2)
    ratio = noisy.parameters["exposure.2"].value
    assert turned.parameters["exposure.2"].value == pytest.approx(1 / ratio, rel=1e-5)
    assert turned.per_length["brightness"] == pytest.approx(
        noisy.per_length["brightness"] * ratio, rel=1e-5
    )
    level = noisy.parameters["black_level.2"].value
    assert turned.parameters["black_level.1"].value == pytest.approx(level, abs=1e-6)


def test_noise_is_what_the_errors_say(both: tuple[Layers, Layers], noisy: FitResult) -> None:
    for name, true in true_values().items():
        estimate = noisy.parameters[name]
        assert estimate.stderr is not None
        assert abs(estimate.value - true) <= 3 * estimate.stderr, name
    assert noisy.errors is not None
    # Of 3 × 6,000 samples and more: known to 1 / √(2 n) = 0.5 %.
    assert noisy.errors.noise == pytest.approx(NOISE, rel=0.02)


def test_information_adds_up(both: tuple[Layers, Layers], noisy: FitResult) -> None:
    """What is shared is known as well as both photos know it: C⁻¹ = C₁⁻¹ + C₂⁻¹.

    Exactly, because amplitude and level are each photo's own (the second's exposure is free). Each
    matrix is estimated from a hundred blocks or two, the same ones: its entries are uncertain by
    √(2/100), and half of that is common.
    """
    free = ("brightness", "shadow", "tint", "black_level")
    names = ("shadow", "tint.r", "tint.g")

    def known(result: FitResult) -> np.ndarray:
        index = [result.correlation_names.index(name) for name in names]
        return np.linalg.inv(result.covariance[np.ix_(index, index)])

    photos = shots(both, NOISE)
    single = [
        fit(photo, layers, START, free=free) for photo, layers in zip(photos, both, strict=True)
    ]
    expected = np.linalg.inv(sum(known(result) for result in single))
    joint = np.linalg.inv(known(noisy))
    np.testing.assert_allclose(np.sqrt(np.diag(joint) / np.diag(expected)), 1.0, atol=0.15)
    for name in names:
        alone = min(result.parameters[name].stderr or 0 for result in single)
        assert (noisy.parameters[name].stderr or np.inf) < alone


def test_a_photo_twice_is_known_better_by_the_root_of_two(both: tuple[Layers, Layers]) -> None:
    """The leverage of a block is half as large, which is a hundredth of the stretch."""
    photo, layers = shots(both, NOISE)[0], both[0]
    free = ("brightness", "shadow", "tint", "background")
    once, twice = (
        fit([photo] * n, [layers] * n, START, free=free) if n > 1 else fit(photo, layers, START)
        for n in (1, 2)
    )
    assert set(once.correlation_names) == set(twice.correlation_names)
    for name in once.correlation_names:
        one, two = once.parameters[name], twice.parameters[name]
        assert one.stderr is not None
        assert two.stderr is not None
        assert two.value == pytest.approx(one.value, abs=2e-3 * one.stderr)
        assert one.stderr / two.stderr == pytest.approx(np.sqrt(2), rel=0.03)
    assert twice.residual_rms == pytest.approx(once.residual_rms, rel=1e-9)


def test_shadow_seen_by_the_second_photo_only(both: tuple[Layers, Layers]) -> None:
    """Layers without shadow beside layers with; alone, the first photo cannot tell its weight."""
    lit = Layers(both[0].front, both[0].back, planet=both[0].planet, width_unit=both[0].width_unit)
    unit = float(lit.width_unit)
    photos = [
        shoot(layers, response, unit)
        for layers, response in zip((lit, both[1]), RESPONSES, strict=True)
    ]
    result = fit(photos, [lit, both[1]], START)
    assert result.verdict == "converged", result.message
    for name, true in true_values().items():
        assert result.parameters[name].value == pytest.approx(true, rel=1e-6, abs=1e-8), name
    assert not result.left_out
    alone = fit(photos[0], lit, START)
    assert [item.what for item in alone.left_out] == ["shadow"]


def test_gamma_of_one_camera(both: tuple[Layers, Layers]) -> None:
    """Both photos by one camera, whose gamma is found and the same in both."""
    unit = float(both[0].width_unit)
    cameras = [Response(1.0, 1.8, 0.01), Response(2.5, 1.8, 0.02)]
    photos = [shoot(la, camera, unit) for la, camera in zip(both, cameras, strict=True)]
    free = ("brightness", "shadow", "tint", "black_level", "exposure.2", "gamma")
    result = fit(photos, both, START, free=free, tied={"gamma.2": "gamma.1"})
    assert result.verdict == "converged", result.message
    for name, true in {**true_values(), "gamma.1": 1.8, "gamma.2": 1.8}.items():
        assert result.parameters[name].value == pytest.approx(true, rel=1e-6, abs=1e-7), name
    assert result.parameters["gamma.2"].role == "tied"
    assert result.parameters["gamma.2"].stderr == result.parameters["gamma.1"].stderr
    assert [float(photo.response.gamma) for photo in result.photos] == pytest.approx([1.8, 1.8])


def test_a_clipped_photo_beside_a_float_one(both: tuple[Layers, Layers], tmp_path: Path) -> None:
    """The second overexposes: a third of its samples are white, and tell what is left to tell."""
    unit = float(both[0].width_unit)
    noise = 0.01
    cameras = (RESPONSES[0], Response(2.5, black_level=0.02))
    photos = [
        shoot(la, camera, unit, noise, 5 + k)
        for k, (la, camera) in enumerate(zip(both, cameras, strict=True))
    ]
    codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(np.maximum(photos[1], 0))), 0, 1))
    Image.fromarray(codes.astype(np.uint8)).save(tmp_path / "white.png")
    result = fit([photos[0], load_photo(tmp_path / "white.png")], both, START)
    assert result.verdict == "converged", result.message
    counts = [photo.clipped / photo.used.sum() / 3 for photo in result.photos]
    assert counts[0] == 0
    assert 0.1 < counts[1] < 0.5
    for name, true in {**true_values(), "black_level.2": 0.02}.items():
        estimate = result.parameters[name]
        assert estimate.stderr is not None
        assert abs(estimate.value - true) <= 3 * estimate.stderr, name
        assert abs(estimate.value - true) <= 0.01 * max(abs(true), 0.2), name
    bounds = [result.parameters[name].quantisation_bound for name in SHARED]
    assert all(bound is not None and 0 < bound < 0.02 for bound in bounds)


def test_wrong_numbers_of_things(both: tuple[Layers, Layers]) -> None:
    first, second = shots(both)
    for photos, layers, message in (
        ([first, second], both[0], "2 photos and 1 sets of layers"),
        ([first], both, "1 photos and 2 sets of layers"),
        ([], [], "0 photos and 0 sets"),
        ([second, first], both, r"120×100.*160×128"),
    ):
        with pytest.raises(InputError, match=message) as error:
            fit(photos, layers, START)
        assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="1 responses for 2 photos"):
        fit([first, second], both, START, response=[Response()])
    with pytest.raises(InputError, match=r"'exposure\.3' is no parameter"):
        fit([first, second], both, START, free=["exposure.3"])
    with pytest.raises(InputError, match="different quantities"):
        fit([first, second], both, START, tied={"exposure.2": "gamma.1"})


def test_a_photo_that_shows_nothing_is_named(both: tuple[Layers, Layers]) -> None:
    first, second = shots(both)
    result = fit([first, np.zeros_like(second)], both, START)
    assert result.verdict == "no_data"
    assert "photo 2: the photo is black" in result.message
    assert to_values(result)["brightness"] == 1.0
