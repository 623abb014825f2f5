"""What JPEG did is done again exactly, and taken off the fitted values."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import ExifTags, Image

from fit import FitResult, Photo, fit, load_photo
from fit.diagnose._compression import _bounded, _read_backwards
from fit.photo._camera import JpegCamera, _Noise
from fit.photo._columns import Columns
from fit.solve._declare import declare
from fit.solve._parameters import free_directions, to_entries
from fit.solve._problem import Point
from model_jax import Exposure, InputError, Layers, LayersLook, Response
from model_jax._tone import Srgb
from tests.fit.looks import START, evidence_of, picture

SIZE = (50, 70)  # no multiple of a block


def columns_at(photo: Photo, index: np.ndarray) -> Columns:
    nothing = np.zeros(len(index))
    return Columns(
        index=index.astype(np.int32),
        fields={"lit": nothing},
        light=photo.linear_at(index),
        surface=None,
        clipped=None,
        color=np.ones(3),
        width_error=0.0,
    )


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"quality": 85}, id="4:2:0"),
        pytest.param({"quality": 60, "subsampling": 1}, id="4:2:2"),
        pytest.param({"quality": 95, "subsampling": 0}, id="4:4:4"),
        pytest.param({"quality": 85, "progressive": True}, id="progressive"),
        pytest.param({"quality": 85, "orientation": 6}, id="turned"),
        pytest.param({"quality": 85, "orientation": 2}, id="mirrored"),
        pytest.param({"quality": 85, "tone_curve": Exposure(1.0, 2.2)}, id="film"),
    ],
)
def test_a_file_is_made_again(options: dict[str, Any], tmp_path: Path) -> None:
    """The light that was stored gives, without noise, each code that the file holds."""
    options = dict(options)
    orientation, curve = options.pop("orientation", 1), options.pop("tone_curve", None)
    rng = np.random.default_rng(3)
    rows, cols = np.indices(SIZE)
    smooth = 120 + 60 * np.sin(cols / 9)[..., None] * np.cos(rows / 7)[..., None] * [1, 0.6, -0.5]
    codes = np.clip(smooth + rng.normal(scale=4, size=(*SIZE, 3)), 0, 255).astype(np.uint8)
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    Image.fromarray(codes).save(tmp_path / "a.jpg", exif=exif, **options)
    photo = load_photo(tmp_path / "a.jpg", curve)

    Image.fromarray(codes).save(tmp_path / "a.png", exif=exif)
    before = load_photo(tmp_path / "a.png", curve)
    chosen = rng.random(codes[..., 0].size) < 0.7
    used, near = columns_at(photo, np.flatnonzero(chosen)), np.flatnonzero(~chosen)
    light, near_light = before.linear_at(used.index), before.linear_at(near)
    camera = JpegCamera(
        photo,
        used,
        columns_at(photo, near),
        light,
        near_light,
        np.ones_like(light),  # as much noise as lets all pixels agree with the model
        robust=False,
    )
    camera._noise = _Noise(np.array([0.0, 1.0]), np.zeros(2))
    taken = camera.take(light, near_light, rng)
    np.testing.assert_array_equal(taken.light, photo.linear_at(used.index))


def test_what_cannot_be_made_again_is_not_tried(tmp_path: Path) -> None:
    """Grey: one channel of light made of three. Stored as RGB, with and without a marker: decoders
    without one go by the names of the components."""
    codes = np.random.default_rng(1).integers(0, 256, (*SIZE, 3)).astype(np.uint8)
    Image.fromarray(codes[..., 0]).save(tmp_path / "grey.jpg")
    Image.fromarray(codes).save(tmp_path / "marked.jpg", keep_rgb=True)
    data = (tmp_path / "marked.jpg").read_bytes()
    marker = data.index(b"\xff\xee")
    length = 2 + int.from_bytes(data[marker + 2 : marker + 4], "big")
    (tmp_path / "named.jpg").write_bytes(data[:marker] + data[marker + length :])
    for name in ("grey", "marked", "named"):
        photo = load_photo(tmp_path / f"{name}.jpg")
        assert photo.lossy
        assert photo.jpeg is None, name


def test_a_line_is_read_backwards() -> None:
    rng = np.random.default_rng(4)
    slope = np.array([[0.9, 0.2, 0.0], [-0.1, 1.1, 0.0], [0.0, 0.3, 0.5]])
    scale = np.array([1e-3, 1.0, 1e4])
    found, covariances = [], []
    for _ in range(300):
        steps = rng.normal(size=(40, 3))
        ends = 0.7 + steps @ slope.T + rng.normal(scale=0.05, size=(40, 3))
        read = _read_backwards(steps * scale, ends * scale)
        assert read is not None
        found.append(read[0] / scale)
        covariances.append(read[1] / scale / scale[:, None])
    truth = -np.linalg.solve(slope, np.full(3, 0.7))
    # One photo's scatter, of which the line's own uncertainty is a seventh or so.
    expected = 0.05**2 * np.linalg.inv(slope.T @ slope)
    np.testing.assert_allclose(np.mean(found, axis=0), truth, atol=0.01)
    ratio = np.diag(np.mean(covariances, axis=0)) / np.diag(expected)
    assert np.all((ratio > 0.95) & (ratio < 1.4)), ratio


def test_a_level_line_says_nothing() -> None:
    rng = np.random.default_rng(5)
    steps = rng.normal(size=(40, 2))
    ends = np.column_stack([steps[:, 0], np.zeros(40)])
    assert _read_backwards(steps, ends) is None
    assert _read_backwards(np.zeros((40, 2)), ends) is None
    assert _read_backwards(steps, np.full((40, 2), np.nan)) is None


def test_a_line_along_a_diagonal_is_not_level() -> None:
    """A slope of 1 in every direction, of parameters that are correlated to 0.9999."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        one, other = rng.normal(size=(2, 40))
        steps = np.column_stack([one, 0.9999 * one + np.sqrt(1 - 0.9999**2) * other])
        scatter = np.column_stack([one, 0.9999 * one + np.sqrt(1 - 0.9999**2) * other])
        rng.shuffle(scatter)
        read = _read_backwards(steps, steps + scatter)
        assert read is not None
        assert np.all(np.abs(read[0]) < 5 * np.sqrt(np.diag(read[1])))


def test_a_shift_beyond_a_bound_takes_what_follows_along(layers64: Layers) -> None:
    """The tints' mean stays 1, and what is correlated with the tint at its bound moves too."""
    parameters = declare(
        START, [Response()], free=["brightness", "tint"], bounds={"tint.r": (0.9, 3.0)}
    )
    free = [p for p in parameters if p.role == "free"]
    vector, (along, _) = to_entries(parameters), free_directions(free, parameters)
    problem = evidence_of(fit(picture(layers64, START), layers64, START)).problem  # any
    covariance = np.diag([0.1, 0.2, 0.3]) + 0.05
    shift = np.linalg.lstsq(along, 0.3 * np.eye(len(vector))[0], rcond=None)[0]
    shift += np.linalg.lstsq(along[4:7], np.array([-0.4, 0.3, 0.1]), rcond=None)[0]
    end = Point(problem, vector, along)
    found = end.moved(_bounded(shift, covariance, end, free)).vector
    assert found[4] == pytest.approx(0.9, abs=1e-8)
    assert found[4] >= 0.9
    assert found[4:7].mean() == pytest.approx(1, abs=1e-12)
    row = along[4]
    expected = shift - covariance @ row * ((vector + along @ shift)[4] - 0.9) / (
        row @ covariance @ row
    )
    np.testing.assert_allclose(found, vector + along @ expected, atol=1e-8)


LOOK = LayersLook(brightness=1.6, shadow=0.3, tint=(0.8, 0.95, 1.25), background=0.12)
NAMES = ("brightness", "shadow", "tint.r", "tint.g", "tint.b", "background")


def shot(layers: Layers, folder: Path, name: str, look: LayersLook = LOOK, seed: int = 6) -> Photo:
    """A photo with some noise, in the format of the name; level and light 0.03 noise apart."""
    with jax.enable_x64(True):
        light = picture(layers, look).astype(np.float64)
    light += np.random.default_rng(seed).normal(scale=0.02, size=light.shape)
    codes = np.rint(255 * np.clip(np.asarray(Srgb().encode(light)), 0, 1)).astype(np.uint8)
    options: dict[str, Any] = {"quality": 85} if name.endswith("jpg") else {}
    Image.fromarray(codes).save(folder / name, **options)
    return load_photo(folder / name)


def distances(result: FitResult) -> np.ndarray:
    """Of `NAMES` from their truth, in standard errors."""
    truth = [LOOK.brightness, LOOK.shadow, *LOOK.tint, LOOK.background]
    found = [result.parameters[name] for name in NAMES]
    assert all(e.stderr is not None for e in found)
    return np.array(
        [(e.value - t) / (e.stderr or np.nan) for e, t in zip(found, truth, strict=True)]
    )


def test_the_values_are_those_before_compression(layers64: Layers, tmp_path: Path) -> None:
    """Least squares of a JPEG's codes is off by more than three of its standard errors somewhere,
    though these know of what hangs together."""
    photo = shot(layers64, tmp_path, "a.jpg")
    plain = fit(photo, layers64, START, sampling="point")
    undone = fit(photo, layers64, START, jpeg="undo", sampling="point")
    assert np.abs(distances(plain)).max() > 3
    assert np.abs(distances(undone)).max() < 4
    assert any("compression" in warning for warning in plain.warnings)
    assert not any("compression" in warning for warning in undone.warnings)
    for name in NAMES:
        before, after = plain.parameters[name], undone.parameters[name]
        assert before.compression_shift is None
        assert after.compression_shift is not None
        assert after.value == pytest.approx(before.value + after.compression_shift, abs=1e-12)
    assert undone.look.brightness == undone.parameters["brightness"].value
    assert undone.verdict == plain.verdict == "converged"
    tints = [undone.parameters[name].value for name in NAMES[2:5]]
    assert np.mean(tints) == pytest.approx(1, abs=1e-12)
    again = fit(photo, layers64, START, jpeg="undo", sampling="point")
    assert again.to_dict()["parameters"] == undone.to_dict()["parameters"]


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({"loss": "huber"}, id="robust"),
        pytest.param({"priors": {"shadow": (0.3, 0.001)}}, id="prior"),
        pytest.param({"bounds": {"shadow": (0.0, 0.301)}}, id="by a bound", marks=pytest.mark.full),
    ],
)
def test_other_fits(options: dict[str, Any], layers64: Layers, tmp_path: Path) -> None:
    """They know of the compression too, and what was known before is not forgotten over it."""
    result = fit(
        shot(layers64, tmp_path, "a.jpg"), layers64, START, jpeg="undo", sampling="point", **options
    )
    assert result.verdict in ("converged", "at_bound")
    assert result.parameters["brightness"].compression_shift is not None
    shadow = result.parameters["shadow"]
    assert shadow.bounds[0] <= shadow.value <= shadow.bounds[1]
    if "priors" in options:
        assert shadow.stderr is not None
        assert shadow.stderr < 1.3 * 0.001  # known from 26 degrees of freedom, to a seventh
        assert abs(shadow.value - 0.3) < 4 * 0.001
    brightness = result.parameters["brightness"]
    assert brightness.stderr is not None
    assert abs(brightness.value - float(LOOK.brightness)) < 4 * brightness.stderr


@pytest.mark.parametrize("bound", [0.79, 0.81])
def test_bounded_tints_keep_their_mean(bound: float, layers64: Layers, tmp_path: Path) -> None:
    result = fit(
        shot(layers64, tmp_path, "a.jpg"),
        layers64,
        START,
        bounds={"tint.r": (bound, 3.0)},
        jpeg="undo",
        sampling="point",
    )
    tints = [result.parameters[name].value for name in NAMES[2:5]]
    assert np.mean(tints) == pytest.approx(1, abs=1e-9)
    assert tints[0] >= bound


def test_nothing_free_in_the_end_is_undone(layers64: Layers, tmp_path: Path) -> None:
    """One of two tints at its bound: the other has nowhere to go."""
    result = fit(
        shot(layers64, tmp_path, "a.jpg"),
        layers64,
        START,
        free=["tint.r", "tint.g"],
        bounds={"tint.g": (0.5, 0.9)},
        jpeg="undo",
        sampling="point",
    )
    assert all(e.compression_shift is None for e in result.parameters.values())


def test_much_that_is_clipped_is_not_undone(layers64: Layers, tmp_path: Path) -> None:
    bright = replace(LOOK, brightness=6.0)
    result = fit(
        shot(layers64, tmp_path, "a.jpg", bright), layers64, START, jpeg="undo", sampling="point"
    )
    assert result.photos[0].clipped > 0.05 * 3 * result.photos[0].used.sum()
    assert all(e.compression_shift is None for e in result.parameters.values())
    assert any("compression" in warning for warning in result.warnings)


def test_one_of_two_photos_is_a_jpeg(layers64: Layers, tmp_path: Path) -> None:
    photos = [shot(layers64, tmp_path, "a.jpg"), shot(layers64, tmp_path, "b.png", seed=7)]
    free = ("brightness", "shadow", "tint", "background")
    result = fit(photos, [layers64] * 2, START, free=free, jpeg="undo", sampling="point")
    assert result.verdict == "converged"
    assert np.abs(distances(result)).max() < 4
    assert all(result.parameters[name].compression_shift is not None for name in NAMES)


def test_structure_that_compression_makes_is_undone(tmp_path: Path) -> None:
    """Noise of one code does not dither the steps of colours: smooth air gets plateaus of their
    errors, much wider than a block, and the fit without their cause is many errors off."""
    rng = np.random.default_rng(11)
    shape = (192, 256)
    rows, cols = np.indices(shape)
    lit = 1.5 + np.cos(cols / 90) * np.sin(rows / 70)
    dark = np.where(cols > 150, 0.6 * lit, 0.0)
    layers = Layers(np.zeros(shape), lit + dark, lit, lit + dark, planet=np.zeros(shape))
    truth = LayersLook(0.2, 0.3, (0.9, 1.0, 1.1), background=0.05)
    light = picture(layers, truth) + rng.normal(scale=0.003, size=(*shape, 3))
    codes = np.round(255 * np.clip(np.asarray(Srgb().encode(light)), 0, 1)).astype(np.uint8)
    Image.fromarray(codes).save(tmp_path / "a.jpg", quality=85)
    result = fit(load_photo(tmp_path / "a.jpg"), layers, START, jpeg="undo", sampling="point")
    assert result.errors is not None
    assert result.errors.correlation_px > 16
    wanted = dict(zip(NAMES, [0.2, 0.3, 0.9, 1.0, 1.1, 0.05], strict=True))
    for name, value in wanted.items():
        found = result.parameters[name]
        assert found.compression_shift is not None
        assert found.stderr is not None
        assert abs(found.value - value) < 4 * found.stderr
    assert not result.warnings


def test_structure_is_not_taken_for_noise(layers64: Layers, tmp_path: Path) -> None:
    """What the light was before compression is not known where the look cannot follow it."""
    photo = shot(layers64, tmp_path, "a.jpg")
    ramp = np.linspace(0, 25, photo.shape[1]).astype(np.uint8)
    bent = replace(photo, stored=np.minimum(photo.stored, 230) + ramp[None, :, None])
    result = fit(bent, layers64, START, jpeg="undo", sampling="point")
    assert result.errors is not None
    assert result.errors.correlation_px > 16
    assert all(e.compression_shift is None for e in result.parameters.values())
    assert any("compression" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    ("qualities", "why"),
    [
        pytest.param((70, 85), "more than once", id="twice"),
        pytest.param((85, 90), "more than once", id="twice, the finer steps hardly so"),
        pytest.param((30,), "does not show its noise", id="noise hidden"),
        pytest.param((15,), "does not show its noise", id="hardly anything left"),
    ],
)
def test_files_that_cannot_be_made_alike(
    qualities: tuple[int, ...], why: str, layers64: Layers, tmp_path: Path
) -> None:
    """What they were before is not known, and the fit says so instead of a number; no standard
    error is 0."""
    path = tmp_path / "a.jpg"
    shot(layers64, tmp_path, "a.png")
    picture: Image.Image = Image.open(tmp_path / "a.png")
    for quality in qualities:
        picture.save(path, quality=quality)
        picture = Image.open(path).convert("RGB")
    result = fit(load_photo(path), layers64, START, jpeg="undo", sampling="point")
    assert all(e.compression_shift is None for e in result.parameters.values())
    (reason,) = [item.why for item in result.left_out if item.what == "what JPEG did"]
    assert why in reason
    assert any("compression" in warning for warning in result.warnings)
    assert all(result.parameters[name].stderr for name in result.correlation_names)


def test_a_second_compression_that_changes_nothing_is_none(
    layers64: Layers, tmp_path: Path
) -> None:
    """By the same steps, or by coarser ones: the last ones say what was lost."""
    shot(layers64, tmp_path, "a.png")
    for qualities in ((85, 85), (92, 70)):
        picture: Image.Image = Image.open(tmp_path / "a.png")
        for quality in qualities:
            picture.save(tmp_path / "a.jpg", quality=quality)
            picture = Image.open(tmp_path / "a.jpg").convert("RGB")
        result = fit(load_photo(tmp_path / "a.jpg"), layers64, START, jpeg="undo", sampling="point")
        assert np.abs(distances(result)).max() < 4
        assert result.parameters["brightness"].compression_shift is not None


def test_jpeg_is_undone_where_it_is_asked_for(layers64: Layers, tmp_path: Path) -> None:
    photo = shot(layers64, tmp_path, "a.jpg")
    result = fit(photo, layers64, START)
    assert all(e.compression_shift is None for e in result.parameters.values())
    (warning,) = [w for w in result.warnings if "compression" in w]
    assert "--jpeg undo" in warning
    assert not any(item.what == "what JPEG did" for item in result.left_out)
    plain = fit(shot(layers64, tmp_path, "b.png"), layers64, START, jpeg="undo", sampling="point")
    (reason,) = [item.why for item in plain.left_out if item.what == "what JPEG did"]
    assert reason == "no photo is a JPEG"
    with pytest.raises(
        InputError, match=r"jpeg: 'never' is unknown; choose from \['keep', 'undo'\]"
    ):
        fit(photo, layers64, START, jpeg="never")
