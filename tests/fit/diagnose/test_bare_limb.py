"""Air or no air: the Moon and synthetic bare discs have none, Earth and model shells have."""

import json
import re
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from fit import fit, load_photo
from fit.diagnose import _airless
from fit.diagnose._alignment import limb_beside
from fit.diagnose._bare_limb import EVIDENCE, AirEvidence, find_air
from fit.diagnose._edge import SHIFT
from fit.diagnose._effective import effective_samples
from fit.diagnose._limb import limb_of, near_limb
from fit.diagnose._limb_fit import best_limb, light_beside, no_air
from model_jax import Scene, Srgb, Sun, analytic_layers, find_look, layer_widths
from render_gl import load_scene
from tests.data import REPOSITORY
from tests.fit.diagnose.discs import disc_scene, full_moon, moon
from tests.fit.diagnose.planets import Drawn, airless, with_air

EXAMPLES = REPOSITORY / "examples"
SIDEWAYS = Sun(direction=(1.0, 0.3, 0.4))


@pytest.mark.parametrize("sigma", [1.0, 2.0, 4.0])
def test_effective_samples_of_blurred_noise(sigma: float, rng: np.random.Generator) -> None:
    """Areas 4πσ² and 2πσ² of white noise blurred by a Gaussian; a fifth is the sampling error of
    some hundred independent patches and what tiles of 128 px cut off."""
    noise = gaussian_filter(rng.normal(size=(512, 512, 3)), (sigma, sigma, 0), mode="wrap")
    used = np.ones((512, 512), dtype=bool)
    used[100:200, 50:300] = False
    count = 3 * used.sum()
    assert count / effective_samples(noise.__getitem__, used) == pytest.approx(
        4 * np.pi * sigma**2, rel=0.2
    )
    squares = effective_samples(noise.__getitem__, used, squares=True)
    assert count / squares == pytest.approx(2 * np.pi * sigma**2, rel=0.2)


def test_effective_samples_of_white_noise(rng: np.random.Generator) -> None:
    noise = rng.normal(size=(200, 300, 3))
    used = rng.random((200, 300)) < 0.3
    assert effective_samples(noise.__getitem__, used) == pytest.approx(3 * used.sum(), rel=0.1)
    grey = np.repeat(noise[..., :1], 3, axis=2)
    assert effective_samples(grey.__getitem__, used) == pytest.approx(used.sum(), rel=0.1)
    assert effective_samples((0 * noise).__getitem__, used) == 3 * used.sum()
    assert effective_samples(noise.__getitem__, np.zeros_like(used)) == 1.0


@pytest.mark.parametrize("height", [0.03, 0.1])
@pytest.mark.parametrize("sun", [None, SIDEWAYS], ids=["no sun", "sun"])
def test_synthetic_bare_disc_has_no_air(
    height: float, sun: Sun | None, rng: np.random.Generator
) -> None:
    """Half a moon, blurred by 1.5 px and 0.7 px beside the scene's planet."""
    light = half_moon(100.7, 99.5) + rng.normal(scale=0.002, size=(200, 200, 3))
    evidence = search(light, disc_scene((200, 200), (99.5, 99.5, 60.0), height, sun))
    assert not evidence.has_air
    assert evidence.bare.blur_px == pytest.approx(1.5, abs=0.3)


NOISES, HEIGHTS = (0.002, 0.005, 0.01, 0.03), (0.01, 0.03, 0.05, 0.1)


@pytest.mark.parametrize(
    ("lit", "noise", "height", "sun"),
    [
        # A Latin square: each pair of noise and height, each of the rest with every noise.
        pytest.param(
            lit,
            NOISES[j],
            HEIGHTS[k],
            (None, SIDEWAYS)[s],
            id=f"{lit}-{NOISES[j]}-{HEIGHTS[k]}-{('no sun', 'sun')[s]}",
            marks=() if (j + k) % 4 == 2 * s + (lit == "half") else pytest.mark.full,
        )
        for lit, j, k, s in product(("full", "half"), range(4), range(4), range(2))
    ],
)
def test_aligned_bare_disc_has_no_air(
    lit: str, noise: float, height: float, sun: Sun | None, rng: np.random.Generator
) -> None:
    """The limb runs along rows of pixels where it is lit: its place must not come from them."""
    disc = full_moon(99.5, 99.5) if lit == "full" else half_moon(99.5, 99.5)
    light = disc + rng.normal(scale=noise, size=(200, 200, 3))
    evidence = search(light, disc_scene((200, 200), (99.5, 99.5, 60.0), height, sun))
    assert not evidence.has_air


@pytest.mark.parametrize("noise", [0.002, 0.01])
def test_a_fit_of_a_bare_disc_ends_in_no_data(noise: float, rng: np.random.Generator) -> None:
    """Though the shell explains up to 92 % of the light."""
    light = full_moon(99.5, 99.5) + rng.normal(scale=noise, size=(200, 200, 3))
    layers = analytic_layers(disc_scene((200, 200), (99.5, 99.5, 60.0), 0.03))
    assert fit(light, layers).verdict == "no_data"


def test_a_band_of_even_light_is_air(rng: np.random.Generator) -> None:
    """A blue band of 6 px on an orange limb: the sky beyond is dark, so it is no sky."""
    scene = disc_scene((200, 200), (99.5, 99.5, 60.0), 0.1)
    layers = analytic_layers(scene)
    planet, air = np.asarray(layers.planet)[..., None] != 0, np.asarray(layers.has_air)[..., None]
    light = np.where(planet, [0.6, 0.4, 0.2], np.where(air, [0.04, 0.12, 0.4], 0.0))
    light = light + rng.normal(scale=0.002, size=light.shape)
    assert not search(light, scene).has_air
    assert search(light, scene, sky=~(planet | air)[..., 0]).has_air
    result = fit(light, layers)
    assert result.verdict != "no_data"
    assert any("The ring is brighter than the sky beyond it" in text for text in result.warnings)


def test_finds_blur_and_place(rng: np.random.Generator) -> None:
    light = half_moon(100.2, 99.5, blur=1.0) + rng.normal(scale=1e-3, size=(200, 200, 3))
    layers = analytic_layers(disc_scene((200, 200), (99.5, 99.5, 60.0), 0.1))
    planet = np.asarray(layers.planet) != 0
    ring = np.asarray(layers.has_air) & ~planet
    beside = light_beside(light, ring, limb_of(light, planet, ring))
    model = best_limb(beside, no_air(beside), anew=True)
    assert model.blur_px == pytest.approx(1.0, abs=0.15)
    # Only the lit half tells the place: its limb, on the right, is 0.7 px farther right.
    assert np.array([1, 1, 0, 1, 0]) @ model.edge[SHIFT] == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize("disc", [0.0, 0.5], ids=["black planet", "lit planet"])
def test_faint_shell_over_a_disc_is_air(disc: float, rng: np.random.Generator) -> None:
    """A peak of three times the noise in a pixel, in many pixels."""
    scene = disc_scene((200, 200), (99.5, 99.5, 60.0), 0.1, SIDEWAYS)
    layers = analytic_layers(scene)
    lit, dark = layer_widths(layers)
    assert dark is not None
    shell = (np.asarray(lit) + 0.2 * np.asarray(dark)) * (np.asarray(layers.planet) == 0)
    noise = 0.01
    light = disc * half_moon(99.5, 99.5) + rng.normal(scale=noise, size=(200, 200, 3))
    light += 3 * noise * (shell / shell.max())[..., None] * np.array([0.3, 0.6, 1.0])
    assert search(light, scene).delta_bic > 5 * EVIDENCE


def test_black_sky_and_black_planet_have_no_air(rng: np.random.Generator) -> None:
    scene = disc_scene((200, 200), (99.5, 99.5, 60.0), 0.1, SIDEWAYS)
    noise = rng.normal(scale=0.01, size=(200, 200, 3))
    for light in (noise, np.zeros_like(noise), np.full_like(noise, 0.25)):
        assert shows_none(search(light, scene))


def test_disc_that_is_not_finite_counts_for_nothing(rng: np.random.Generator) -> None:
    scene = disc_scene((200, 200), (99.5, 99.5, 60.0), 0.1, SIDEWAYS)
    layers = analytic_layers(scene)
    light = rng.normal(scale=0.01, size=(200, 200, 3))
    light[np.asarray(layers.planet) != 0] = np.nan
    assert shows_none(search(light, scene))


def test_without_a_planet_the_rival_is_a_level(rng: np.random.Generator) -> None:
    width = np.linspace(0, 1, 100)[:, None] * np.ones(80)
    nowhere, everywhere = np.zeros((100, 80), dtype=bool), np.ones((100, 80), dtype=bool)
    noise = rng.normal(scale=0.1, size=(100, 80, 3))
    assert find_air(noise, nowhere, everywhere, [width]).delta_bic < 0
    assert find_air(noise + 0.1 * width[..., None], nowhere, everywhere, [width]).has_air
    assert not find_air(noise, nowhere, nowhere, [width]).has_air
    exact = np.repeat(width[..., None], 3, axis=2)
    assert find_air(exact, nowhere, everywhere, [width]).has_air


@pytest.mark.parametrize(
    ("height", "wrong"),
    [
        # On its limb with each shell, and beside it with one.
        pytest.param(
            height,
            wrong,
            marks=() if height == 0.01 or wrong == (0, 0, 0) else pytest.mark.full,
        )
        for height in (0.01, 0.02, 0.06)
        for wrong in ((0, 0, 0), (0, 0, -1), (0, 1, 0), (0, 1, -1), (-3, 0, -4), (0, 0, 4))
    ],
    ids=str,
)
def test_moon_has_no_air(data_dir: Path, height: float, wrong: tuple[int, int, int]) -> None:
    """Whatever shell is laid around it, on its limb or pixels beside it. Its red limb lies 0.3 px
    farther out than its blue one, which thin air explains: up to 0.03 of what is left over."""
    light = load_photo(data_dir / "apollo" / "AS11-44-6665.jpg").linear
    circle = np.array(limb_circle(light))
    assert circle[2] == pytest.approx(762.7, abs=3)
    x, y, radius = circle + wrong
    sun = SIDEWAYS if height == 0.02 else None
    assert shows_none(search(light, disc_scene(light.shape[:2], (x, y, radius), height, sun)))


def test_a_fit_of_the_moon_ends_in_no_data(data_dir: Path) -> None:
    photo = load_photo(data_dir / "apollo" / "AS11-44-6665.jpg")
    scene = disc_scene(photo.shape, limb_circle(photo.linear), 0.02, SIDEWAYS)
    result = fit(photo, analytic_layers(scene))
    assert result.verdict == "no_data"
    assert "no atmosphere shows" in result.message
    assert "misaligned" not in result.message


def test_a_scene_beside_the_moon_is_misaligned_and_has_no_air(data_dir: Path) -> None:
    """A circle 4 px too small and 3 px to the right; within the circle's own uncertainty."""
    photo = load_photo(data_dir / "apollo" / "AS11-44-6665.jpg")
    x, y, radius = limb_circle(photo.linear)
    scene = disc_scene(photo.shape, (x + 3, y, radius - 4), 0.02, SIDEWAYS)
    result = fit(photo, analytic_layers(scene))
    assert result.verdict == "no_data"
    assert "no atmosphere shows" in result.message
    assert "the scene is misaligned" in result.message
    found = result.photos[0].alignment
    assert found is not None
    assert found.place == pytest.approx((4, -3, 0), abs=0.6)
    assert found.scale == pytest.approx(radius / (radius - 4), abs=1e-3)


def test_no_jpeg_is_undone_where_there_is_no_air(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is the last step, and takes seconds."""
    light = full_moon(99.5, 99.5)
    codes = 255 * Srgb().encode(np.clip(light + rng.normal(scale=0.01, size=light.shape), 0, 1))
    Image.fromarray(np.round(codes).astype(np.uint8)).save(tmp_path / "moon.jpg", quality=92)
    asked: list[object] = []
    monkeypatch.setattr("fit._fit.debias_jpeg", lambda *given: asked.append(given))
    layers = analytic_layers(disc_scene((200, 200), (99.5, 99.5, 60.0), 0.05, SIDEWAYS))
    photo = load_photo(tmp_path / "moon.jpg")
    assert fit(photo, layers, jpeg="undo").verdict == "no_data"
    assert not asked


@pytest.mark.parametrize("height", [0.01, 0.03])
@pytest.mark.parametrize("name", ["AS11-44-6692", "AS12-50-7364"])
def test_earth_from_apollo_has_air(data_dir: Path, name: str, height: float) -> None:
    light = load_photo(data_dir / "apollo" / f"{name}.jpg").linear
    known = {entry["file"]: entry for entry in json.loads((data_dir / "geometry.json").read_text())}
    x, y, radius, _ = known[f"apollo/{name}.jpg"]["disc_fit_px"]
    azimuth, phase = np.radians({"AS11-44-6692": (90, 100), "AS12-50-7364": (-49, 103)}[name])
    across = np.sin(phase)
    sun = Sun((across * np.cos(azimuth), across * np.sin(azimuth), np.cos(phase)))
    evidence = search(light, disc_scene(light.shape[:2], (x, y, radius), height, sun))
    assert evidence.delta_bic > 5 * EVIDENCE


def test_reference_has_air() -> None:
    scene = load_scene(EXAMPLES / "reference.toml").scene
    assert search(load_photo(EXAMPLES / "reference.png").linear, scene).has_air


def test_earth_from_epic_has_air(data_dir: Path) -> None:
    scene = load_scene(EXAMPLES / "epic.toml").scene
    light = load_photo(data_dir / "epic" / "epic_1b_20220110005515.jpg").linear
    assert search(light, scene).has_air


def test_limb_from_orbit_has_air(data_dir: Path) -> None:
    scene = load_scene(EXAMPLES / "iss.toml").scene
    light = load_photo(data_dir / "iss" / "iss_d4_56mm.jpg").linear
    assert search(light, scene).delta_bic > 5 * EVIDENCE


def ask(drawn: Drawn) -> AirEvidence:
    layers = drawn.layers
    planet, air = np.asarray(layers.planet) != 0, np.asarray(layers.has_air)
    known = np.ones_like(planet)
    found = limb_beside(drawn.light, planet, known)
    place = (0.0, 0.0, 0.0) if found is None else found.place
    widths = [np.asarray(width) for width in layer_widths(layers) if width is not None]
    return find_air(drawn.light, planet, air, widths, place, ~planet & ~air)


def test_three_answers_of_a_few_planets() -> None:
    """No air of six without; of six with air, at most one that is not found."""
    bare = [ask(airless(np.random.default_rng([1, k]))) for k in range(6)]
    assert not any(one.has_air for one in bare)
    full = [ask(with_air(np.random.default_rng([2, k]))) for k in range(6)]
    assert sum(one.has_air for one in full) >= 5


@pytest.mark.full
def test_three_answers_of_many_planets() -> None:
    """Of 500 without air at most one in a hundred is told air, of 300 with air at least 85 in a
    hundred are, and of those that are not at least one in four is not told none either."""
    bare = [ask(airless(np.random.default_rng([1, k]))) for k in range(500)]
    assert sum(one.has_air for one in bare) <= 5
    full = [ask(with_air(np.random.default_rng([2, k]))) for k in range(300)]
    assert sum(one.has_air for one in full) >= 255
    missed = [one for one in full if not one.has_air]
    assert sum(one.is_open for one in missed) >= len(missed) / 4


def test_the_answer_hangs_on_no_look(monkeypatch: pytest.MonkeyPatch) -> None:
    """The question knows the shadow, though the look asks for none, and of layers that were drawn
    without it, too: the crescent had no air by looks without."""
    asked: list[list[np.ndarray]] = []

    def counted(*given: Any) -> AirEvidence:
        asked.append(given[3])
        return find_air(*given)

    monkeypatch.setattr(_airless, "find_air", counted)
    drawn = with_air(np.random.default_rng([2, 0]))
    bare = replace(drawn.layers, shadow_front=None, shadow_back=None)
    cases = ((drawn.layers, "layers"), (drawn.layers, "gradient"), (bare, "gradient"))
    answers = [
        fit(drawn.light, layers, find_look(name)(), max_steps=20).verdict == "no_data"
        for layers, name in cases
    ]
    assert len(set(answers)) == 1
    for widths in asked[1:]:
        for width, known in zip(widths, asked[0], strict=True):
            np.testing.assert_allclose(width, known, atol=1e-5 * np.max(known))


def test_thin_air_under_a_blur_cannot_be_told() -> None:
    """The fit is reported, and what would tell."""
    drawn = with_air(np.random.default_rng([3, 18]), thin=True)
    result = fit(drawn.light, drawn.layers)
    assert result.verdict == "not_identifiable"
    assert [item.what for item in result.left_out][-1] == "whether there is air"
    assert re.search(r"[\d.]+ times as fine would tell", result.left_out[-1].why)
    assert result.explained is not None
    assert result.parameters["brightness"].stderr is not None
    several = fit([drawn.light, drawn.light], [drawn.layers, drawn.layers])
    assert several.verdict == "not_identifiable"
    assert [item.what for item in several.left_out][-1] == "whether there is air, photo 2"


def test_small_planets_have_rings() -> None:
    """Distances from a conic are none near its middle, where tiles have theirs."""
    layers = analytic_layers(disc_scene((65, 65), (32.0, 32.0, 20.0), 0.4))
    planet = np.asarray(layers.planet) != 0
    ring = np.asarray(layers.has_air) & ~planet
    index, distance, _ = near_limb(planet, ring, (0.0, 0.0, 0.0), 48.0)
    assert len(index) == ring.sum()
    assert distance.max() == pytest.approx(8, abs=1)


def shows_none(evidence: AirEvidence) -> bool:
    return not evidence.has_air and not evidence.is_open


def search(light: np.ndarray, scene: Scene, sky: np.ndarray | None = None) -> AirEvidence:
    layers = analytic_layers(scene)
    widths = [np.asarray(width) for width in layer_widths(layers) if width is not None]
    planet = np.asarray(layers.planet) != 0
    aligned = limb_beside(light, planet, np.isfinite(light).all(axis=-1))
    place = (0.0, 0.0, 0.0) if aligned is None else aligned.place
    return find_air(light, planet, np.asarray(layers.has_air), widths, place, sky)


def half_moon(x: float, y: float, blur: float = 1.5) -> np.ndarray:
    """A sphere lit from the right."""
    # The Moon's light hardly falls toward its limb: no Lambert.
    return moon(x, y, blur, lambda right: np.clip(3 * (right + 0.1), 0, 1))


def limb_circle(light: np.ndarray) -> tuple[float, float, float]:
    """The Moon's outline (x, y, radius), px: the steepest fall along each ray from the centre,
    then a circle through them (Kåsa 1976), three times without the outliers."""
    grey = light.mean(axis=-1)
    disc = grey > 0.5 * np.median(grey[grey > 0.25 * np.percentile(grey, 99)])
    y, x = (axis.mean() for axis in np.nonzero(disc))
    radius = np.sqrt(disc.sum() / np.pi)
    angle = np.linspace(0, 2 * np.pi, 1440, endpoint=False)[:, None]
    for _ in range(3):
        along = np.arange(0.85 * radius, 1.15 * radius, 0.5)
        columns, rows = x + along * np.cos(angle), y + along * np.sin(angle)
        rows = np.clip(np.rint(rows).astype(int), 0, grey.shape[0] - 1)
        profile = grey[rows, np.clip(np.rint(columns).astype(int), 0, grey.shape[1] - 1)]
        fall = -np.gradient(gaussian_filter(profile, (0, 1)), axis=1)
        edge = along[fall.argmax(axis=1)]
        edge_x, edge_y = x + edge * np.cos(angle[:, 0]), y + edge * np.sin(angle[:, 0])
        keep = strong = fall.max(axis=1) > 0.3 * np.median(fall.max(axis=1))
        for _ in range(6):
            matrix = np.column_stack([2 * edge_x, 2 * edge_y, np.ones_like(edge_x)])[keep]
            x, y, rest = np.linalg.lstsq(matrix, (edge_x**2 + edge_y**2)[keep], rcond=None)[0]
            radius = np.sqrt(rest + x**2 + y**2)
            off = np.abs(np.hypot(edge_x - x, edge_y - y) - radius)
            keep = strong & (off < max(1.0, 3.7 * np.median(off[keep])))
    return float(x), float(y), float(radius)
