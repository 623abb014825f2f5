"""Rasterised widths lie where tessellation, pixel grid and depth format allow them to lie."""

import equinox as eqx
import jax
import numpy as np
import pytest

import render_gl
from model_jax import Atmosphere, Camera, Planet, Scene, analytic_layers, layer_widths, width_ranges
from render_gl._accuracy import displacement, measure_accuracy, predict_accuracy, smooth
from render_gl._depth_format import EPS, choose_format
from render_gl._mesh import cone_mesh, sphere_mesh

from ..model_jax.scenes import ANYWHERE, EXTREMES, LENGTHS
from .test_parity import SCENES

STEPPED = {
    f"near plane at {near:g} radii": eqx.tree_at(
        lambda s: s.camera.near, SCENES["sun (1, -1, 1)"], near * 6371.0
    )
    for near in (0.01, 0.001)
}
"""The paper's Fig. 12: where window depths are coarse, up to half the widest chord."""


@pytest.mark.parametrize("depth_format", render_gl.DEPTH_FORMATS)
@pytest.mark.parametrize("name", SCENES | STEPPED)
def test_rasterised_widths_are_as_predicted(name: str, depth_format: str) -> None:
    """Every width is within its bound; and what is said of the scene, before it is drawn, is no
    more than ten times what is found."""
    case = (SCENES | STEPPED)[name]
    accuracy = measure_accuracy(case, depth_format)
    assert accuracy.passed, accuracy.summary()
    predicted = predict_accuracy(case, depth_format).error
    assert predicted == accuracy.predicted.error
    assert accuracy.largest <= predicted <= accuracy.predicted.chord
    assert accuracy.largest > 4 * EPS * accuracy.predicted.chord
    assert predicted <= 10 * accuracy.largest
    assert np.isfinite(accuracy.measured).sum() >= 1e4
    assert accuracy.predicted.silhouette.mean() < 0.02


@pytest.mark.parametrize("name", ANYWHERE | EXTREMES | LENGTHS)
def test_cameras_anywhere_see_the_right_widths(name: str) -> None:
    """On and above the ground, in the shadow, looking along it: in the format the scene gets."""
    case = (ANYWHERE | EXTREMES | LENGTHS)[name]
    case = eqx.tree_at(lambda s: s.camera, case, case.camera.resized(320, 240))
    accuracy = measure_accuracy(case, choose_format(case).depth_format)
    assert accuracy.passed, accuracy.summary()
    predicted = accuracy.predicted
    assert accuracy.largest <= predicted.error
    known = np.isfinite(accuracy.measured).any(axis=0) & ~predicted.silhouette
    if known.sum() >= 1e4 and accuracy.largest > 4 * EPS * predicted.chord:
        assert predicted.error <= 10 * accuracy.largest


def test_a_finer_mesh_is_predicted_and_found() -> None:
    coarse, fine = (
        measure_accuracy(
            eqx.tree_at(lambda s: s.planet, SCENES["no sun"], Planet(6371.0, triangles=count)),
            "linear",
        )
        for count in (5_000, 500_000)
    )
    # A facet's depth below its sphere falls as 1 / triangles; a chord's error as that, or near
    # tangency as its root. The pixel grid's part of the bound stays.
    assert 10 < coarse.largest / fine.largest < 100
    assert 5 < coarse.predicted.error / fine.predicted.error < 100


def test_an_edge_on_facet_is_no_false_alarm() -> None:
    """A limb pixel whose facet is followed far beyond its snapped edge (found by review)."""
    case = render_gl.load_scene("examples/reference.toml").scene
    position = [11000.0, -11000.0, 0.0]
    camera = Camera(position, np.negative(position), [0, -0.5, 1], 50, 160, 120, 8100, 21050)
    case = Scene(camera, case.planet, Atmosphere(300.0), case.sun)
    for depth_format in render_gl.DEPTH_FORMATS:
        accuracy = measure_accuracy(case, depth_format)
        assert accuracy.passed, accuracy.summary()
        assert np.mean(accuracy.predicted.silhouette) < 0.05


@pytest.mark.parametrize(("near", "far"), [(15000.0, 21050.0), (8100.0, 12000.0)])
def test_clip_planes_through_the_scene_clamp_alike(near: float, far: float) -> None:
    case = SCENES["sun (1, -1, 1)"]
    case = eqx.tree_at(lambda s: (s.camera.near, s.camera.far), case, (near, far))
    drawn = render_gl.render(case, "linear")
    exact = analytic_layers(case)
    assert abs(float(np.mean(np.asarray(drawn.planet) - np.asarray(exact.planet)))) < 0.005
    assert abs(float(np.mean(drawn.has_air) - np.mean(exact.has_air))) < 0.01


def test_prediction_is_no_excuse() -> None:
    """Half the median prediction is really used up: the bound is not just large."""
    accuracy = measure_accuracy(SCENES["sun (1, -1, 1)"], "linear")
    lit = accuracy.summary()["lit"]
    assert lit["predicted_median"] <= 20 * lit["median"]


def test_a_wrong_radius_is_found(monkeypatch) -> None:
    """The comparison fails when the shell is drawn 0.1 % too large."""
    case = SCENES["sun (1, -1, 1)"]
    original = render_gl._accuracy.render

    def wrong(scene: Scene, depth_format: str):
        height = scene.atmosphere.height + 0.001 * scene.planet.radius
        return original(eqx.tree_at(lambda s: s.atmosphere.height, scene, height), depth_format)

    monkeypatch.setattr(render_gl._accuracy, "render", wrong)
    assert not measure_accuracy(case, "linear").passed


def test_width_ranges_close_on_the_exact_widths() -> None:
    case = smooth(SCENES["odd size"])
    exact, moved = width_ranges(case, 0.0, 0.0), width_ranges(case, *displacement(case))
    (lit, same), (dark, _) = exact.lit, exact.dark
    np.testing.assert_array_equal(lit, same)
    assert not exact.silhouette.any()
    (low, high), (dark_low, dark_high) = moved.lit, moved.dark
    assert np.all((low <= lit) & (lit <= high))
    assert np.all((dark_low <= dark) & (dark <= dark_high))
    assert np.max(high - low) > 0


@pytest.mark.parametrize("triangles", [20, 1000, 196_000])
def test_sphere_is_closed_and_has_its_triangles(triangles: int) -> None:
    mesh = sphere_mesh(triangles)
    count = len(mesh.triangles)
    assert count >= triangles
    assert len(mesh.vertices) - 3 * count // 2 + count == 2  # Euler: every edge has two faces
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 1, rtol=1e-15 * 4)


def test_paper_mesh_stays_within_3e5_radii() -> None:
    assert 0 < 1 - sphere_mesh(196_000).inner_radius < 3e-5


@pytest.mark.parametrize("tip", [1.0, 0.99, 0.0], ids=["cylinder", "sun", "apex"])
def test_cone_mesh_faces_outward(tip: float) -> None:
    toward = np.array([0.6, 0.0, 0.8])
    mesh = cone_mesh(toward, (np.zeros(3), -1.1 * toward), (1.0, tip))
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    inside = -0.1 * toward
    assert np.min(np.sum((a - inside) * np.cross(b - a, c - a), axis=1)) > -1e-15


def test_relief_hides_air() -> None:
    """Mountains make the air in front of them thinner, never thicker, on the paper's scene."""
    data = render_gl.load_scene("examples/paper.toml").scene
    bare = smooth(data)
    with jax.enable_x64(True):
        flat = layer_widths(render_gl.render(bare, "linear"))
    assert float(np.min(flat[0])) >= -1e-6


def test_thousand_renders_need_no_more_memory_than_fifty() -> None:
    import resource

    case = eqx.tree_at(
        lambda s: s.camera, SCENES["no sun"], SCENES["no sun"].camera.resized(64, 48)
    )

    def peak(renders: int) -> int:
        for _ in range(renders):
            render_gl.render(case, "linear")
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    warm = peak(50)
    # One render's textures are 64·48·(4·3 + 1 + 1)·4 bytes = 0.17 MB and its mesh 0.5 MB: keeping
    # either for 150 renders would add 25 MB or more.
    assert peak(150) - warm < 20_000
