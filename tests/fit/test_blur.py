"""A fit with a blur: its model against a true convolution, what it finds, what it refuses."""

import json
from dataclasses import replace
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import fit
from fit.photo._columns import planet_light, take_columns
from fit.photo._pixels import choose_pixels
from fit.photo._stencil import SKY
from fit.solve._declare import declare
from fit.solve._layout import Layout
from fit.solve._loss import Loss
from fit.solve._model import Model, predict, tile_slopes
from fit.solve._parameters import to_entries
from fit.solve._samples import on_device, tile_at, to_samples
from model_jax import (
    Atmosphere,
    Camera,
    InputError,
    LayersLook,
    Look,
    Planet,
    Response,
    Scene,
    Sun,
    analytic_layers,
    composite,
    find_look,
)
from tests.command import airlight
from tests.scene_text import SCENE

RADIUS = 6371.0
BLACK, BRIGHT = (0.0, 0.0, 0.0), (0.4, 0.45, 0.5)
FINE = 8
"""Pixels across one of a photo's, of the picture that is spread and averaged."""


def planet(albedo: tuple[float, float, float] | None, size: int = 120) -> Scene:
    """A planet's limb from three radii, 82 px in radius: the sun from the upper right."""
    distance, tilt = 3 * RADIUS, np.radians(18.0)
    return Scene(
        Camera(
            position=np.array([distance, 0.0, 0.0]),
            forward=np.array([-np.cos(tilt), np.sin(tilt), 0.0]),
            up=np.array([0.0, 0.0, 1.0]),
            fov_y_deg=29.2,
            width=size,
            height=size,
            near=distance - 1.3 * RADIUS,
            far=distance + 1.3 * RADIUS,
        ),
        Planet(RADIUS, albedo=albedo),
        Atmosphere(1000.0, color=np.array([0.33, 0.5, 1.0])),
        Sun(np.array([0.5, 0.8, 0.3])),
    )


TRUTH = {"scale_height": 100.0, "brightness": 60.0, "extinction": np.array([10.0, 20.0, 40.0])}


def air(**other: object) -> Look:
    return find_look("air+density+saturation")(**TRUTH | other)


def photo_of(scene: Scene, look: Look, blur: float) -> np.ndarray:
    """What a camera makes of it: spread on pixels eight times as fine, and averaged."""
    size = scene.camera.width
    fine = replace(scene.camera, width=size * FINE, height=size * FINE)
    light = np.asarray(composite(analytic_layers(replace(scene, camera=fine)), look), float)
    light = gaussian_filter(light[..., :3], (blur * FINE, blur * FINE, 0), mode="nearest")
    return light.reshape(size, FINE, size, FINE, 3).mean(axis=(1, 3))


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(
    ("blur", "albedo"),
    [
        (1.3, BRIGHT),
        (2.5, BLACK),
        *(
            pytest.param(*case, marks=pytest.mark.full)
            for case in ((0.5, BLACK), (0.5, BRIGHT), (1.3, BLACK), (2.5, BRIGHT))
        ),
    ],
)
def test_model_is_a_convolution(blur: float, albedo: tuple[float, float, float]) -> None:
    """Within 0.95 % of the light at the limb, rms, and a quarter of that over all pixels, in front
    of a black planet and a bright one.

    What is left: the planet's light is averaged over 16 px of the limb and goes on as a line, where
    Lambert's law bends; the air ends at 64 km, 0.8 px, and so does each place's parabola; the
    Gaussian in place of a pixel's square.
    """
    scene, look = planet(albedo), air()
    photo = photo_of(scene, look, blur)
    layers = analytic_layers(replace(scene, planet=Planet(RADIUS)), np.float64)
    used = choose_pixels(photo, layers, "area", "all", blurs=True).used
    inside = planet_light(photo, layers, blur)
    columns = take_columns(photo, layers, used, float(layers.width_unit), type(look), inside)
    samples = on_device(to_samples([columns]))
    entries = jnp.asarray(to_entries(declare(look, [Response(blur=blur)])))
    model = Model(Loss("linear"), None, Layout(type(look), True), True, 1 / 12)
    tiles = [tile_at(samples, np.array(k)) for k in range(int(samples.used))]
    seen = eqx.filter_jit(predict)
    found = np.concatenate([np.asarray(seen(entries, tile, model)).T for tile in tiles])
    assert columns.stencil is not None
    height, off = columns.stencil.height, found[: len(columns.index)] - columns.light
    # Beyond its border the true picture goes on, the one that is spread is taken to repeat itself.
    place = np.stack(np.divmod(columns.index, used.shape[1]))
    whole = ((place >= 11) & (place < used.shape[1] - 11)).all(axis=0)
    limb = (height < 1) & whole
    most = float(np.sqrt(np.mean(columns.light[limb] ** 2)))
    assert np.sqrt(np.mean(off[limb] ** 2)) < 0.0095 * most
    assert np.sqrt(np.mean(off[whole] ** 2)) < 0.0022 * most
    # Sky is looked at, and what is beyond the blur's reach shows none of it.
    assert (height > 14 + SKY / 2).any()
    # Padding and pixels without air have slopes that are numbers.
    for tile in tiles:
        _, slopes = tile_slopes(entries, jnp.eye(len(entries)), tile, model)
        assert np.isfinite(np.asarray(slopes)).all()


@pytest.mark.usefixtures("x64")
def test_opaque_air_has_slopes_that_are_numbers() -> None:
    """Where the planet's light is measured, exp(-τ) is a number whose square is none, or 0."""
    scene, look = planet(None), air()
    layers = analytic_layers(scene, np.float64)
    photo = np.asarray(composite(layers, look))[..., :3]
    used = choose_pixels(photo, layers, "point", "ring", blurs=True).used
    inside = planet_light(photo, layers, 0.5)
    columns = take_columns(photo, layers, used, float(layers.width_unit), type(look), inside)
    tile = tile_at(on_device(to_samples([columns])), np.array(0))
    model = Model(Loss("linear"), None, Layout(type(look), True), True)
    for depth in np.geomspace(1e2, 1e6, 40):
        opaque = air(extinction=depth * np.array([1.0, 1.01, 1.02]))
        entries = jnp.asarray(to_entries(declare(opaque, [Response(blur=1.0)])))
        found, slopes = tile_slopes(entries, jnp.eye(len(entries)), tile, model)
        assert np.isfinite(np.asarray(found)).all(), depth
        assert np.isfinite(np.asarray(slopes)).all(), depth


@pytest.mark.usefixtures("x64")
def test_without_blur_the_model_is_the_sharp_one() -> None:
    """Of the light in the pixels' middles: `SHARPEST` and places of float64 are left."""
    scene, look = planet(None), air()
    layers = analytic_layers(scene, np.float64)
    photo = np.asarray(composite(layers, look))[..., :3]
    used = choose_pixels(photo, layers, "point", "ring", blurs=True).used
    columns = take_columns(
        photo, layers, used, float(layers.width_unit), type(look), planet_light(photo, layers, 0.5)
    )
    samples = on_device(to_samples([columns]))
    entries = jnp.asarray(to_entries(declare(look, [Response(blur=0.0)])))
    model = Model(Loss("linear"), None, Layout(type(look), True), True)
    assert columns.stencil is not None
    height = columns.stencil.height
    for k in range(int(samples.used)):
        tile = tile_at(samples, np.array(k))
        seen = np.asarray(eqx.filter_jit(predict)(entries, tile, model)).T[: int(samples.count[k])]
        start = k * tile.weight.shape[0]
        part = slice(start, start + len(seen))
        away = (height[part] > 0.02) & (height[part] < 10)
        expected = columns.light[part][away]
        np.testing.assert_allclose(seen[away], expected, atol=2e-3 * columns.light.max())


def test_blur_and_air_are_found() -> None:
    """Each within four standard errors of what the photo was made of, from the defaults."""
    scene, look = planet((0.4, 0.45, 0.5)), air()
    noise = np.random.default_rng(1).normal(0, 0.004, (120, 120, 3))
    photo = (photo_of(scene, look, 1.3) + noise).astype(np.float32)
    for border in (np.s_[:8], np.s_[-8:], np.s_[:, :8], np.s_[:, -8:]):
        photo[border] = np.nan  # see above
    layers = analytic_layers(replace(scene, planet=Planet(RADIUS)))
    look = find_look("air+density+saturation")()
    found = fit.fit(photo, layers, look, response=Response(blur=1.0))
    assert found.verdict == "converged", found.message
    blur = found.photos[0].response.blur
    assert blur is not None
    true = {"blur": 1.3, "scale_height": 100.0, "brightness": 60.0}
    true |= {"extinction.r": 10.0, "extinction.g": 20.0, "extinction.b": 40.0}
    for name, value in true.items():
        p = found.parameters[name]
        assert p.stderr is not None
        assert abs(p.value - value) < 4 * p.stderr, (name, p.value, p.stderr)
    assert (found.parameters["blur"].stderr or 1) < 0.1
    assert found.photos[0].excluded.keys() == {
        "far from the air",
        "in front of the planet",
        "not finite",
    }


def test_what_a_blur_needs() -> None:
    scene, soft = planet(None, 40), Response(blur=1.0)
    layers = analytic_layers(scene)
    photo = np.full((40, 40, 3), 0.1, np.float32)
    for wrong, told in (
        (replace(layers, view=None), "response.blur: the layers do not tell how rays pass"),
        (replace(layers, planet=None), "response.blur: the layers do not tell how rays pass"),
    ):
        with pytest.raises(InputError, match=told):
            fit.fit(photo, wrong, response=soft)
    with pytest.raises(InputError, match="where: 'sky': the layers do not tell how rays pass"):
        fit.fit(photo, replace(layers, view=None), where="sky")
    with pytest.raises(InputError, match="where: 'planet' asks for pixels of which a fit with a"):
        fit.fit(photo, layers, response=soft, where="planet")
    with pytest.raises(InputError, match="some photos have a blur, some none"):
        fit.fit([photo, photo], [layers, layers], response=[soft, Response()])
    hidden = np.where(np.asarray(layers.planet)[..., None] > 0, np.nan, photo)
    with pytest.raises(InputError, match="the photo shows no planet inside its limb"):
        fit.fit(hidden.astype(np.float32), layers, response=soft)
    with pytest.raises(InputError, match="free: 'blur' is no parameter"):
        fit.fit(photo, layers, free=["blur"])


def test_sky_pins_the_background() -> None:
    """Pixels beyond the air, as far as `SKY`, of looks without a blur too; none farther away."""
    layers = analytic_layers(planet(None))
    look = LayersLook(background=0.02)
    photo = np.asarray(composite(layers, look))[..., :3]
    ring = fit.fit(photo, layers, where="ring", sampling="point").photos[0]
    sky = fit.fit(photo, layers, where="sky", sampling="point")
    assert sky.verdict == "converged"
    assert sky.look.background == pytest.approx(0.02, rel=1e-6)
    more = sky.photos[0].used & ~ring.used
    assert more.sum() > 0
    assert not np.asarray(layers.has_air)[more].any()
    assert sky.photos[0].excluded["far from the air"] + more.sum() == ring.excluded["no air"]


def test_blur_from_the_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera's term, beside the look's: in the numbers, in the picture, and not for drawing."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.toml").write_text(SCENE)
    assert airlight("render", "scene.toml", "-o", "photo.exr") == 0
    asked = ("--terms", "blur", "--start", "blur=0.5", "--max-steps", "4", "--source", "analytic")
    code = airlight("fit", "scene.toml", "photo.exr", *asked, "--out", "out")
    document = json.loads((tmp_path / "out/fit.json").read_text())
    assert code == 0, document["message"]
    assert document["verdict"] == "at_bound"  # a picture drawn sharp is not blurred
    assert document["parameters"]["blur"]["value"] == 0
    assert document["parameters"]["blur"]["unit"] == "px"
    assert document["parameters"]["blur"]["initial"] == 0.5
    assert airlight("render", "scene.toml", "--look", "air", "--terms", "blur", "-o", "p.exr") == 2


def test_the_middle_of_a_disc_is_no_division_by_zero() -> None:
    """All ways lead out from a pixel whose ray goes through the planet's middle."""
    scene = planet(None, 33)
    camera = replace(scene.camera, forward=np.array([-1.0, 0.0, 0.0]))
    layers = analytic_layers(replace(scene, camera=camera))
    photo = np.asarray(composite(layers, air()))[..., :3]
    inside = planet_light(photo, layers, 1.0)
    assert np.isfinite(inside.light).all()


def test_noise_of_the_planets_light_is_known() -> None:
    """Scatter of level and change in 200 pictures of noise: a standard deviation of 200 is known to
    5 %, the mean ratio of all pieces, of which some 8 are independent, to 2 %. And directions
    between two pieces see both in proportion, all the way round."""
    layers = analytic_layers(planet(None))
    rng = np.random.default_rng(7)
    found = [
        planet_light(rng.normal(0.5, 0.01, (120, 120, 3)).astype(np.float32), layers, 1.0)
        for _ in range(200)
    ]
    scatter = np.std([inside.light for inside in found], axis=0)
    one = found[0]
    np.testing.assert_allclose(one.noise, 0.01, rtol=0.05)
    told = 0.01 * np.sqrt((one.errors**2).sum(axis=0))
    ratio = scatter / np.repeat(told, 3, axis=1)
    np.testing.assert_allclose(ratio.reshape(-1, 2, 3).mean(axis=(0, 2)), 1, atol=0.06)
    angle = np.linspace(-np.pi, np.pi, 50)
    by_channel = [np.interp(angle, one.angle, part, period=2 * np.pi) for part in one.light.T]
    np.testing.assert_allclose(one.at(angle), np.stack(by_channel, axis=-1), rtol=1e-9)
