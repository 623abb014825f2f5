"""Rendering, and layer files: what comes out has the right shape, side up and numbers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import render_gl
from model_jax import (
    InputError,
    LayersLook,
    Occluder,
    Planet,
    Scene,
    analytic_layers,
    combine,
    composite,
    layer_widths,
)
from render_gl._mesh import sphere_mesh
from render_gl._uniforms import relief_scale
from tests.render_gl.scenes import SCENES, scene

from ..model_jax.ray_march import camera_rays


def test_layers_of_a_scene_without_sun_have_no_shadow() -> None:
    layers = render_gl.render(SCENES["no sun"])
    assert layers.shadow_front is None
    assert layers.shadow_back is None
    assert layers.surface is None


def test_shadow_passes_are_left_out_when_no_air_in_view_is_in_shadow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """From the sun's side the planet hides its shadow: the layers are the same without it."""
    case = SCENES["sun behind camera"]
    pruned = render_gl.render(case, "linear")
    assert pruned.shadow_front is None
    assert render_gl.render(SCENES["sun (1, -1, 1)"]).shadow_front is not None
    monkeypatch.setattr(render_gl._raster, "shadows_in_view", lambda scene: (True,))
    full = render_gl.render(case, "linear")
    assert full.shadow_front is not None
    np.testing.assert_array_equal(pruned.front, full.front)
    np.testing.assert_array_equal(pruned.back, full.back)
    _, dark = layer_widths(full)
    # What the full passes find is the meshes' deviation from the sphere, 5e-5 radii, seen at a
    # tangent: 2 √(2 · 5e-5) radii at most.
    assert float(np.max(np.asarray(dark))) * float(full.width_unit) <= 2 * np.sqrt(2 * 5e-5) * 6371


def test_image_is_the_right_way_up() -> None:
    """A sun straight up in the picture lights the upper half of the ring."""
    case = scene(sun=(0.0, 0.0, 1.0))
    image = render_gl.render_image(case, LayersLook())[..., 2]
    exact = np.asarray(composite(analytic_layers(case), LayersLook()))[..., 2]
    assert image[:120].sum() > 1.5 * image[120:].sum()
    assert exact[:120].sum() > 1.5 * exact[120:].sum()


@pytest.mark.parametrize("source", render_gl.SOURCES)
def test_layers_and_image_come_of_one_drawing(
    source: render_gl.Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    case, look = SCENES["odd size"], LayersLook(2.0, 0.5, (0.5, 1, 1.5), background=0.1)
    layers, image = (
        render_gl.render(case, source=source),
        render_gl.render_image(case, look, source=source),
    )
    drawn: list[tuple[Any, ...]] = []
    original = render_gl._render.draw

    def draw(*given: Any) -> Any:
        drawn.append(given)
        return original(*given)

    monkeypatch.setattr(render_gl._render, "draw", draw)
    both = render_gl.render_layers_and_image(case, look, source=source)
    assert len(drawn) == 1
    assert eqx.tree_equal(both[0], layers)
    np.testing.assert_array_equal(both[1], image)


@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
def test_image_equals_composite_of_its_layers(depth_format: str) -> None:
    look = LayersLook(background=0.25, tint=[1.2, 1.0, 0.8])
    image = render_gl.render_image(SCENES["odd size"], look, depth_format)
    again = np.asarray(composite(render_gl.render(SCENES["odd size"], depth_format), look))
    # 11 roundings of ε = 1.2e-7 on values up to 1 (see _parity), one more for the background.
    np.testing.assert_allclose(image, again, atol=12 * 1.2e-7, rtol=0)


def test_camera_inside_the_shell_sees_air_everywhere() -> None:
    case = scene(distance=1.02, thickness=0.05)
    near = 1e-3 * 6371.0
    case = eqx.tree_at(lambda s: s.camera.near, case, near)
    layers = render_gl.render(case, "linear")
    assert np.all(layers.has_air)
    exact = analytic_layers(case)
    inside = np.asarray(layers.front)
    np.testing.assert_allclose(inside, np.asarray(exact.front), rtol=1e-5)


def test_camera_inside_the_shadow() -> None:
    """No front face of the cone is in view; the shadow begins at the near plane."""
    case = scene(distance=1.03, thickness=0.05, sun=(-0.2, 0.9, -0.3))
    case = eqx.tree_at(lambda s: s.camera.near, case, 6.371)
    picture = np.asarray(combine(render_gl.render(case, "linear"), LayersLook(shadow=0.0)))
    exact = np.asarray(combine(analytic_layers(case), LayersLook(shadow=0.0)))
    wrong = np.abs(picture - exact).max(axis=-1) > 1e-2 * exact.max()
    assert np.mean(wrong) < 0.01  # the limb's edge pixels


def test_relief_scale_grows_with_distance() -> None:
    def scale(distance: float) -> float:
        case = scene(distance=distance)
        planet = Planet(6371.0, relief_scale=(1.0, 20.0), relief_distance=(0.01, 2.0))
        return relief_scale(eqx.tree_at(lambda s: s.planet, case, planet))

    assert scale(1.005) == 1.0
    assert scale(50.0) == 20.0
    assert 1.0 < scale(1.1) < scale(1.5) < 20.0


def test_relief_and_albedo_are_drawn(data_dir: Path) -> None:
    planet = Planet(
        6371.0,
        relief=str(data_dir / "textures/visibleearth_topo_bump_2048x1024.png"),
        relief_unit=8.8,
        relief_scale=(1.0, 10.0),
        albedo=str(data_dir / "textures/land_shallow_topo_2048.jpg"),
    )
    case = scene(sun=(0.2, -0.9, 0.3))
    bare = render_gl.render(case, "linear")
    textured = render_gl.render(eqx.tree_at(lambda s: s.planet, case, planet), "linear")
    assert bare.surface is None
    assert 0.02 < float(np.mean(np.asarray(textured.surface)[100:140, 140:180])) < 0.5
    rise = (np.asarray(bare.back) - np.asarray(textured.back))[np.asarray(bare.planet) == 1]
    # 8.8 km ten times exaggerated; near the limb a slope moves the depth by more than the height.
    assert 20 < np.percentile(rise, 99) < 200
    assert np.median(rise) >= -0.5


@pytest.mark.parametrize("source", ["raster", "mesh"])
@pytest.mark.parametrize("name", ["sun (1, -1, 1)", "no sun", "three moons"])
def test_a_planet_of_one_colour_is_lit_as_the_exact_one(
    name: str, source: render_gl.Source
) -> None:
    albedo, planet = (0.2, 0.5, 1.0), SCENES[name].planet
    case = eqx.tree_at(lambda s: s.planet, SCENES[name], replace(planet, albedo=albedo))
    drawn, exact = render_gl.render(case, "linear", source), analytic_layers(case)
    # Cosine of incidence; where it is a fifth or less the limb is near.
    origin, rays = camera_rays(case)
    depth = np.asarray(exact.back, np.float64) + float(exact.reference)
    normal = (origin + depth[..., None] * rays) / 6371.0
    cosine = -np.sum(normal * rays, axis=-1) / np.linalg.norm(rays, axis=-1)
    seen = (np.asarray(exact.planet) == 1) & (np.asarray(drawn.planet) == 1) & (cosine > 0.2)
    # Some 16 roundings before the root of the discriminant, cosine², move the place along the ray
    # by as much over 2 cosines; as many after it. Both sides round.
    tolerance = 2 * 16 * 2**-24 * (1 / (2 * cosine) + 1)
    if source == "mesh":
        # The facet is met where the sphere is a sagitta e higher: t before it along the ray,
        # cosine · t - t²/2 = e.
        sagitta = 1 - sphere_mesh(case.planet.triangles).inner_radius
        tolerance += cosine - np.sqrt(np.maximum(cosine**2 - 2 * sagitta, 0))
    off = np.max(np.abs(np.asarray(drawn.surface) - np.asarray(exact.surface)), axis=-1)
    # Shadows and silhouettes of moons are edges, which may fall on either side of a pixel's middle.
    edges = np.mean((off > tolerance)[seen])
    assert edges <= (0.002 if case.occluders else 0), edges
    assert seen.sum() > 1000
    assert np.max(np.asarray(drawn.surface)) > 0.5
    assert not np.any(np.asarray(drawn.surface)[np.asarray(drawn.planet) == 0])


def test_window_depths_are_refused_where_they_hold_nothing() -> None:
    case = eqx.tree_at(lambda s: s.camera.near, scene(), 1e-3)
    with pytest.raises(InputError, match=r"window24.*use linear"):
        render_gl.render(case, "window24")
    assert np.all(np.isfinite(render_gl.render(case, "linear").back))


def test_too_large_pictures_are_refused() -> None:
    case = eqx.tree_at(lambda s: s.camera, scene(), scene().camera.resized(65536, 8))
    with pytest.raises(InputError, match="limit"):
        render_gl.render(case)


def test_reading_files_needs_no_opengl() -> None:
    import subprocess
    import sys

    code = (
        "import sys, render_gl; render_gl.load_scene('examples/paper.toml');"
        "assert 'moderngl' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", ["odd size", "lengths"])
def test_layer_files_come_back_as_they_were(name: str, tmp_path: Path) -> None:
    case = SCENES[name]
    layers = render_gl.render(case, "linear")
    render_gl.write_layers(tmp_path / "layers.exr", layers, case)
    again = render_gl.read_layers(tmp_path / "layers.exr")
    parts = ("front", "back", "shadow_front", "shadow_back", "planet", "color", "stretch")
    for part in parts:
        if getattr(layers, part) is None:
            assert getattr(again, part) is None
        else:
            np.testing.assert_array_equal(getattr(again, part), getattr(layers, part))
    assert again.surface is None
    assert (again.reference, again.width_unit) == (layers.reference, layers.width_unit)


def test_several_shadows_come_back_as_they_were(tmp_path: Path) -> None:
    case = SCENES["three moons"]
    layers = render_gl.render(case, "linear")
    # Of four bodies' shadows: one passes beside the air.
    assert np.asarray(layers.shadow_front).shape == (3, 240, 320)
    path = tmp_path / "layers.exr"
    render_gl.write_layers(path, layers, case)
    again = render_gl.read_layers(path)
    np.testing.assert_array_equal(again.shadow_front, layers.shadow_front)
    np.testing.assert_array_equal(again.shadow_back, layers.shadow_back)
    channels, _ = render_gl.read_channels(path)
    assert {"shadow_front.Z", "shadow2_back.Z", "shadow3_front.Z"} <= set(channels)
    del channels["shadow2_front.Z"]
    render_gl.write_channels(path, channels, {})
    with pytest.raises(InputError, match=r"not both of shadow2_front\.Z and shadow2_back\.Z"):
        render_gl.read_layers(path)


def test_a_moon_darkens_the_ground_and_hides_what_is_behind(data_dir: Path) -> None:
    """Sun behind the camera: a moon beside the line of sight hides no pixel of its shadow."""
    bare = scene(sun=(0.2, -0.9, 0.3), sun_radius=0.0)
    assert bare.sun is not None
    toward = np.asarray(bare.sun.direction)
    planet = Planet(
        6371.0, albedo=str(data_dir / "textures/land_shallow_topo_2048.jpg"), triangles=20_000
    )
    aside = np.cross(toward, [0.0, 0.0, 1.0])
    center = (3.0 * toward + 0.4 * aside / np.linalg.norm(aside)) * 6371.0
    moon = (Occluder(center, 0.2 * 6371.0),)
    case = eqx.tree_at(lambda s: s.planet, bare, planet)
    eclipsed = Scene(case.camera, case.planet, case.atmosphere, case.sun, moon)
    layers = render_gl.render(eclipsed, "linear")
    full = np.asarray(render_gl.render(case, "linear").surface)
    shaded = np.asarray(layers.surface)
    dark = np.all(shaded == 0, axis=-1) & np.any(full > 0, axis=-1)
    np.testing.assert_array_equal(shaded[~dark], full[~dark])
    origin, rays = camera_rays(eclipsed)
    depth = np.asarray(layers.back, np.float64) + float(layers.reference)
    ground = origin + depth[..., None] * rays
    off = np.linalg.norm(np.cross(ground - center, toward), axis=-1)
    expected = (np.asarray(layers.planet) == 1) & (ground @ toward > 0) & (off < 0.2 * 6371)
    assert 1000 < np.sum(expected) == pytest.approx(np.sum(dark), rel=0.01)
    assert np.mean(dark != expected) < 0.001
    front = Scene(
        case.camera, case.planet, case.atmosphere, case.sun, (Occluder(1.5 * 6371 * toward, 1000),)
    )
    hidden = render_gl.render(front, "linear")
    exact = analytic_layers(front)
    assert np.mean(~hidden.has_air & render_gl.render(case, "linear").has_air) > 0.05
    assert np.mean(hidden.has_air != exact.has_air) < 0.01
    assert np.mean(hidden.planet != exact.planet) < 0.01
    assert np.all(np.asarray(hidden.surface)[120, 160] == 0)


def test_window_depths_of_another_renderer(tmp_path: Path) -> None:
    case = SCENES["odd size"]
    near, far = float(case.camera.near), float(case.camera.far)
    exact = analytic_layers(case)
    depth = np.asarray(exact.front, np.float64) + float(exact.reference)
    back = np.asarray(exact.back, np.float64) + float(exact.reference)

    def window(z: np.ndarray) -> np.ndarray:
        return far / (far - near) * (1 - near / z)

    path = tmp_path / "other.exr"
    render_gl.write_channels(path, {"front.Z": window(depth), "back.Z": window(back)}, {})
    layers = render_gl.read_layers(path, near, far)
    # Float32 window depth near 1 has steps of 2^-24: a step of ε z² (far - near)/(far near) in z.
    step = 2**-23 * far * far * (far - near) / (far * near)
    np.testing.assert_allclose(layers.back, back, atol=2 * step)
    turned = {
        f"{name}.Z": 1 - np.minimum(window(z), 1) for name, z in (("front", depth), ("back", back))
    }
    render_gl.write_channels(tmp_path / "reversed.exr", turned, {})
    layers = render_gl.read_layers(tmp_path / "reversed.exr", near, far, "reversed")
    # Relative to the eye depth: code, constants, sum and quotient.
    np.testing.assert_allclose(layers.back, back, rtol=3 * 2**-23)
    with pytest.raises(InputError, match="say how depths are coded"):
        render_gl.read_layers(tmp_path / "reversed.exr", near, far)
    with pytest.raises(InputError, match="clip planes"):
        render_gl.read_layers(path, near=5.0)
    other = tmp_path / "eye.exr"
    render_gl.write_channels(other, {"front.Z": depth, "back.Z": back}, {})
    with pytest.raises(InputError, match="no coded depths"):
        render_gl.read_layers(other, near, far)


def test_missing_channels_are_named(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    render_gl.write_channels(path, {"front.Z": np.ones((2, 2))}, {})
    with pytest.raises(InputError, match=r"no channel back\.Z"):
        render_gl.read_layers(path)


@pytest.mark.parametrize("depth_format", ["reversed32f", "linear"])
def test_bodies_hide_each_other_at_any_near_plane(depth_format: str) -> None:
    """Where all window depths are 1: mountains behind mountains, moons before and behind."""
    file = render_gl.load_scene("examples/paper.toml")
    case = eqx.tree_at(lambda s: s.camera, file.scene, file.scene.camera.resized(320, 256))
    moons = scene(
        distance=4.0, thickness=0.3, moons=(((0.3, -2.5, 0.6), 0.4), ((-1.0, 2.0, 0.4), 0.6))
    )
    for each in (case, moons):
        close = eqx.tree_at(lambda s: s.camera.near, each, 1e-9 * each.planet.radius)
        ordinary, found = (render_gl.render(s, depth_format) for s in (each, close))
        depths = [np.asarray(layers.back) + layers.reference for layers in (ordinary, found)]
        # Clip coordinates round otherwise: a pixel on an edge may belong to its neighbour.
        off = np.abs(depths[1] - depths[0]) > 1e-3 * each.planet.radius
        assert np.mean(off & ordinary.has_air) < 1e-4


@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
def test_large_pictures_are_drawn_in_bands(
    monkeypatch: pytest.MonkeyPatch, depth_format: render_gl.DepthFormat
) -> None:
    """The same picture, up to how a driver rounds triangles that it clips at a band's border.

    That moves a depth by a few ulp, at a tangent by its square root; a row in the wrong place or a
    texture of another pass would show in most pixels.
    """
    case = render_gl.load_scene("examples/paper.toml").scene
    camera = case.camera.resized(320, 256)
    case = Scene(camera, case.planet, case.atmosphere, case.sun, case.occluders)
    whole = render_gl._draw.draw(case, LayersLook(), depth_format)
    monkeypatch.setattr(render_gl._raster, "BAND", 320 * 100)
    banded = render_gl._draw.draw(case, LayersLook(), depth_format)
    parts = [(f.air, f.front, f.back, *f.shadows.reshape(-1, 256, 320)) for f in (whole, banded)]
    images = zip(*parts, strict=True)
    for expected, found in [*images, (whole.surface, banded.surface)]:
        assert np.isfinite(found).all()
        far = np.abs(found - expected) > 1e-4 * np.abs(expected)
        assert far.mean() < 0.01
    assert np.mean(whole.planet != banded.planet) < 1e-3
