"""Where a photo's limb lies beside the scene's: drawn discs, and cameras that mend it."""

from dataclasses import replace

import numpy as np
import pytest

from fit import FitResult, align, fit
from fit._align import aligned_camera, camera_lines
from fit._of_photo import Alignment
from fit.diagnose._alignment import OFF_PX, limb_beside, misaligned
from model_jax import Atmosphere, Camera, InputError, Planet, Scene, Sun, analytic_layers
from tests.fit.diagnose.discs import disc_scene, full_moon, moon

SIZE = (200, 200)


def mask(x: float, y: float, radius: float) -> np.ndarray:
    return np.asarray(analytic_layers(disc_scene(SIZE, (x, y, radius), 0.03)).planet) != 0


KNOWN = np.ones(SIZE, bool)


@pytest.mark.parametrize("blur", [0.5, 1.5, 3.0])
@pytest.mark.parametrize(
    "wrong", [(0, 0, 0), (0.6, 0, 0), (-3, 2, -4), (0, 0, 4), (5, -4, 0), (0, 0, -9)], ids=str
)
def test_finds_a_disc(
    wrong: tuple[float, float, float], blur: float, rng: np.random.Generator
) -> None:
    """The disc is at (99.5, 99.5), 60 px in radius. There are some twenty edges, each known to a
    third of a bin of half a pixel. A blur moves a bent limb by blur² / 2R, and its edge is flat;
    two circles that are apart by s are so by s² / 2R more at the sides."""
    light = moon(99.5, 99.5, blur, np.ones_like) + rng.normal(scale=0.005, size=(*SIZE, 3))
    x, y, larger = wrong
    found = limb_beside(light, mask(99.5 + x, 99.5 + y, 60 + larger), KNOWN)
    assert found is not None
    loose = 0.1 + 0.05 * blur + (x**2 + y**2) / 120
    assert found.place == pytest.approx((-larger, -x, -y), abs=loose)
    assert found.scale == pytest.approx(60 / (60 + larger), rel=0.005)
    expected = np.sqrt(larger**2 + (x**2 + y**2) / 2)
    assert found.off == pytest.approx(expected, abs=loose)
    assert found.rms < loose


def test_a_half_lit_limb_tells_where_it_is_seen(rng: np.random.Generator) -> None:
    """On the right the limb lies 2 px outward; that may be shift or size, and the errors say so."""
    light = moon(101.5, 99.5, 1.0, lambda right: np.clip(3 * (right + 0.1), 0, 1))
    found = limb_beside(
        light + rng.normal(scale=0.002, size=light.shape), mask(99.5, 99.5, 60), KNOWN
    )
    assert found is not None
    assert found.outward + found.right == pytest.approx(2, abs=0.2)
    assert found.off > OFF_PX


@pytest.mark.parametrize("light", [0.0, 0.3], ids=["black", "grey"])
def test_nothing_is_said_where_no_limb_is_seen(light: float, rng: np.random.Generator) -> None:
    flat = np.full((*SIZE, 3), light)
    planet = mask(99.5, 99.5, 60)
    for picture in (flat, flat + rng.normal(scale=0.01, size=flat.shape)):
        assert limb_beside(picture, planet, KNOWN) is None
    disc = full_moon(99.5, 99.5)
    assert limb_beside(disc, np.zeros(SIZE, bool), KNOWN) is None
    assert limb_beside(disc, np.ones(SIZE, bool), KNOWN) is None
    assert limb_beside(disc, planet, ~KNOWN) is None
    assert (
        limb_beside(disc, mask(99.5, 99.5, 30), KNOWN) is None
    )  # farther off than it is looked for


def test_air_brighter_than_the_planet_is_not_taken_for_its_limb() -> None:
    """A black planet under its air: light rises at the limb and falls where the air ends."""
    scene = disc_scene(SIZE, (99.5, 99.5, 60.0), 0.1)
    layers = analytic_layers(scene)
    air = np.asarray(layers.has_air) & (np.asarray(layers.planet) == 0)
    light = np.where(air, 0.5, 0.0)[..., None] * np.ones(3)
    assert limb_beside(light, np.asarray(layers.planet) != 0, KNOWN) is None


def test_a_limb_with_relief(rng: np.random.Generator) -> None:
    """No conic: distances come from the mask, to some tenths of a pixel."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    angle = np.arctan2(y - 99.5, x - 99.5)
    bumpy = np.hypot(x - 99.5, y - 99.5) < 60 + 2 * np.sin(9 * angle)
    light = bumpy[..., None] * 0.5 + rng.normal(scale=0.005, size=(*SIZE, 3))
    found = limb_beside(light, np.roll(bumpy, (0, 2), (0, 1)), KNOWN)
    assert found is not None
    assert found.place == pytest.approx((0, -2, 0), abs=0.4)


def lit_fit(scene: Scene, truth: Scene, rng: np.random.Generator) -> FitResult:
    """A fit of a scene to a disc with air, drawn by another."""
    drawn = analytic_layers(truth)
    planet, air = np.asarray(drawn.planet) != 0, np.asarray(drawn.has_air)
    width = np.asarray(drawn.back) - np.asarray(drawn.front)
    ring = np.where(air, 0.4 * width / width[~planet].max(), 0.0)[..., None]
    light = np.where(planet[..., None], np.array([0.6, 0.4, 0.2]), ring * np.array([0.1, 0.3, 1.0]))
    light += rng.normal(scale=0.002, size=light.shape)
    return fit(light, analytic_layers(scene))


def test_a_fit_beside_the_photo_says_so_and_how_to_mend_it(rng: np.random.Generator) -> None:
    """The camera that the command line names lays the limbs on each other."""
    truth = disc_scene(SIZE, (99.5, 99.5, 60.0), 0.1)
    wrong = disc_scene(SIZE, (102.5, 98.0, 58.0), 0.1)
    result = lit_fit(wrong, truth, rng)
    found = result.photos[0].alignment
    assert found is not None
    assert any("The scene is misaligned: the photo's limb lies" in w for w in result.warnings)
    assert result.to_dict()["photos"][0]["alignment"]["scale"] == found.scale
    mended = Scene(aligned_camera(wrong, found), Planet(1.0), wrong.atmosphere)
    assert "forward = [" in camera_lines(mended.camera)
    again = lit_fit(mended, truth, rng)
    assert not any("misaligned" in text for text in again.warnings)
    assert again.photos[0].alignment is not None
    assert again.photos[0].alignment.off < 0.3


def test_little_is_not_worth_a_word() -> None:
    assert misaligned(None) == ""
    found = Alignment(2.0, 0.0, 0.0, (0.1, 0.1, 0.1), 1.02, off=2.0, rms=0.3, edges=40)
    assert "2.0 ± 0.1 px farther out" in misaligned(found)
    assert misaligned(replace(found, off=0.9)) == ""
    assert misaligned(replace(found, rms=2.5)) == ""


@pytest.mark.parametrize("blur", [0.5, 1.5])
def test_align_lays_a_scene_on_the_photo(blur: float, rng: np.random.Generator) -> None:
    """To a tenth of a pixel, as alignment is told; the scene's disc is 8 px off, 5 px too large."""
    light = moon(99.5, 99.5, blur, np.ones_like) + rng.normal(scale=0.003, size=(*SIZE, 3))
    wrong = disc_scene(SIZE, (106.0, 95.0, 65.0), 0.1, Sun((1.0, 0.3, 0.4)))
    scene = align(light, wrong)
    found = limb_beside(light, np.asarray(analytic_layers(scene).planet) != 0, KNOWN)
    assert found is not None
    assert found.off < 0.1
    assert scene.planet is wrong.planet
    assert scene.sun is wrong.sun


@pytest.mark.parametrize("pitch", [0.0, 8.0], ids=["centre below", "centre behind"])
def test_align_from_an_orbit(pitch: float, rng: np.random.Generator) -> None:
    """The planet's centre is far from the picture, or behind it."""
    # The limb is arccos(R / r) below the horizon, 20 degrees from 400 km above Earth.
    down = np.arccos(6371 / 6771) - np.radians(pitch)

    def scene(turn: float) -> Scene:
        angle = down + np.radians(turn)
        camera = Camera(
            position=(0.0, 6771.0, 0.0),
            forward=(0.0, -np.sin(angle), -np.cos(angle)),
            up=(0.0, 1.0, 0.0),
            fov_y_deg=50.0,
            width=200,
            height=200,
            near=1.0,
            far=9000.0,
        )
        return Scene(camera, Planet(radius=6371.0), Atmosphere(height=100.0))

    truth, wrong = scene(0.0), scene(1.5)
    light = 0.5 * (np.asarray(analytic_layers(truth).planet) != 0)[..., None] * np.ones(3)
    light += rng.normal(scale=0.003, size=light.shape)
    before = limb_beside(light, np.asarray(analytic_layers(wrong).planet) != 0, KNOWN)
    assert before is not None
    assert before.off > 4
    mended = align(light, wrong)
    after = limb_beside(light, np.asarray(analytic_layers(mended).planet) != 0, KNOWN)
    assert after is not None
    assert after.off < 0.15


def test_align_says_what_it_cannot(rng: np.random.Generator) -> None:
    scene = disc_scene(SIZE, (99.5, 99.5, 60.0), 0.1)
    with pytest.raises(InputError, match="no limb of the planet is seen within 12 px"):
        align(rng.random((*SIZE, 3)), scene)
    with pytest.raises(InputError, match="photo"):
        align(np.zeros(5), scene)
    with pytest.raises(InputError, match=r"give scene.resized\(200, 100\)"):
        align(np.zeros((100, 200, 3)), scene)
