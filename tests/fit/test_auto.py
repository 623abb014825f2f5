"""`look="auto"`: which terms of air a photo supports, and how it says so."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from PIL import Image

from fit import FitResult, fit, load_photo
from fit._auto import Auto
from model_jax import (
    InputError,
    Layers,
    LayersLook,
    Planet,
    Response,
    Scene,
    analytic_layers,
    composite,
    find_look,
)
from tests.fit.looks import TRUTH, exact_layers, picture, scene
from tests.model_jax.scenes import RADIUS, scene_of

NOISE = 0.01
"""Of the pictures: a fortieth of their brightest light."""

SMALL = scene_of((0.0, -3.0, 0.4), sun=(0.5, -0.6, 0.2), size=(97, 73), fov=45.0, shell=0.1)


def noisy(light: np.ndarray, seed: int = 3, noise: float = NOISE) -> np.ndarray:
    return light + np.random.default_rng(seed).normal(0, noise, light.shape)


def drawn(seen: Scene, name: str, **values: Any) -> tuple[np.ndarray, Layers]:
    """A noisy picture by a look of that name, and its layers."""
    layers, look = analytic_layers(seen), find_look(name)(**values)
    light = np.asarray(composite(layers, look), np.float64)[..., :3]
    return noisy(light, noise=NOISE * float(np.quantile(light, 0.99))), layers


def taken(result: FitResult) -> set[str]:
    assert result.selection is not None
    return set(result.selection.taken)


def test_of_a_picture_by_layers_it_is_layers_with_the_same_numbers() -> None:
    layers = exact_layers(scene())
    photo = noisy(picture(layers, TRUTH))
    named, chosen = fit(photo, layers, LayersLook()), fit(photo, layers, "auto")
    assert type(chosen.look) is LayersLook
    assert chosen.parameters == named.parameters
    assert (chosen.verdict, chosen.message) == (named.verdict, named.message)
    assert taken(chosen) == set()
    assert chosen.selection is not None
    rows = {row.term: row for row in chosen.selection.terms}
    for term in ("density", "saturation", "top"):
        bic = rows[term].delta_bic
        assert bic is not None
        assert bic <= 0
    assert "left out: ΔBIC" in str(chosen)
    assert named.selection is None
    assert "terms chosen" not in str(named)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("air+saturation", {"extinction": (3.0, 6.0, 12.0)}),
        ("air+density", {"scale_height": 0.02 * RADIUS, "brightness": 8.0}),
        ("air+top", {"top": 0.05 * RADIUS}),
        (
            "air+density+saturation",
            {"scale_height": 0.03 * RADIUS, "extinction": (4.0, 9.0, 20.0), "brightness": 9.0},
        ),
    ],
)
def test_the_terms_of_a_picture_are_found_and_told(name: str, values: dict[str, Any]) -> None:
    """Five standard errors: one of four million values of a Gaussian is farther away, and choosing
    the right terms moves none."""
    photo, layers = drawn(SMALL, name, **values)
    result = fit(photo, layers, "auto", sampling="point")
    assert name == type(result.look).NAME
    for term, value in values.items():
        for part, true in zip(
            [p for n, p in result.parameters.items() if n.partition(".")[0] == term],
            np.atleast_1d(value),
            strict=True,
        ):
            assert part.stderr is not None
            assert abs(part.value - true) < 5 * part.stderr, term
    assert result.selection is not None
    for row in result.selection.terms:
        assert row.taken == (row.term in name.split("+"))
        if row.taken:
            assert row.delta_bic is not None
            assert row.delta_bic > 0
            assert row.term in str(result)
    told = json.loads(json.dumps(result.to_dict(), allow_nan=False))["selection"]
    assert [row["term"] for row in told["terms"]] == [r.term for r in result.selection.terms]


def test_dimmed_sunlight_is_found_by_the_dearer_program() -> None:
    values = {
        "scale_height": 0.02 * RADIUS,
        "extinction": (8.0, 20.0, 45.0),
        "brightness": 20.0,
        "shadow": 0.02,
    }
    photo, layers = drawn(SMALL, "air+density+saturation+sun", **values)
    result = fit(photo, layers, "auto", sampling="point")
    assert {"density", "saturation", "sun"} <= taken(result)
    assert result.selection is not None
    rows = {row.term: row for row in result.selection.terms}
    assert "sun" in rows["density"].why  # which needs it, and goes with it
    assert "sun" in rows["saturation"].why
    assert result.explained is not None
    assert result.explained > 0.99


def test_the_ground_is_a_term_where_the_scene_tells_its_light() -> None:
    seen = replace(SMALL, planet=Planet(RADIUS, albedo=(1.0, 1.0, 1.0)))
    photo, layers = drawn(seen, "air+ground", ground=(0.3, 0.25, 0.2))
    assert "ground" in taken(fit(photo, layers, "auto", sampling="point"))
    ring = fit(photo, layers, "auto", sampling="point", where="ring")
    assert taken(ring) == set()
    assert ring.selection is not None
    assert "behind no pixel used is lit ground" in {row.why for row in ring.selection.terms}


def test_layers_that_do_not_tell_heights_leave_terms_out_with_a_word() -> None:
    photo, layers = drawn(SMALL, "air+saturation", extinction=(3.0, 6.0, 12.0))
    bare = replace(layers, view=None)
    result = fit(photo, bare, "auto", sampling="point")
    assert taken(result) == {"saturation"}
    assert result.selection is not None
    rows = {row.term: row for row in result.selection.terms}
    assert rows["density"].why == "the layers do not tell how rays pass the planet"
    without_sun = analytic_layers(replace(SMALL, sun=None))
    light = picture(without_sun, TRUTH)
    result = fit(noisy(light), without_sun, "auto", sampling="point")
    assert result.selection is not None
    rows = {row.term: row for row in result.selection.terms}
    assert rows["sun"].why == rows["upwelling"].why == "the layers do not tell where the sun is"
    assert taken(result) == set()


def test_highlights_at_the_highest_code_are_no_air_that_saturates(tmp_path: Path) -> None:
    """A tenth of the air is white."""
    layers = exact_layers(scene())
    light = picture(layers, TRUTH)
    light = noisy(light / np.quantile(light[np.asarray(layers.has_air)], 0.9), noise=0.03)
    codes = np.clip(light, 0, 1) ** (1 / 2.2)
    Image.fromarray(np.rint(255 * codes).astype(np.uint8)).save(tmp_path / "white.png")
    photo = load_photo(tmp_path / "white.png")
    result = fit(photo, layers, "auto", sampling="point")
    assert result.pixels["clipped_samples"] > 500
    assert taken(result) == set()


def test_what_a_robust_loss_doubts_asks_for_no_term() -> None:
    layers = exact_layers(scene())
    photo = noisy(picture(layers, TRUTH))
    dirt = np.random.default_rng(1).random(photo.shape[:2]) < 0.03
    dirt[:, 80:] = False
    photo[dirt] = 1.5
    assert taken(fit(photo, layers, "auto", sampling="point", loss="cauchy")) == set()


def test_several_photos_choose_together() -> None:
    layers = exact_layers(scene())
    light = picture(layers, TRUTH)
    photos = [noisy(light), noisy(0.5 * light, seed=4)]
    named = fit(photos, [layers] * 2, LayersLook())
    chosen = fit(photos, [layers] * 2, "auto")
    assert taken(chosen) == set()
    assert chosen.parameters == named.parameters


def test_what_is_asked_of_the_plain_look_is_asked_of_every_set_of_terms() -> None:
    """Free are the names given and what the terms bring; the rest is held at the start."""
    photo, layers = drawn(SMALL, "air+saturation", extinction=(3.0, 6.0, 12.0))
    asked: Any = Auto(LayersLook(shadow=0.2))
    result = fit(
        photo, layers, asked, free="brightness", bounds={"brightness": (0, 50)}, sampling="point"
    )
    assert taken(result) == {"saturation"}
    free = {p for p, told in result.parameters.items() if told.role == "free"}
    assert free == {"brightness", "extinction.r", "extinction.g", "extinction.b"}
    assert result.parameters["brightness"].bounds == (0, 50)
    assert result.parameters["shadow"].value == 0.2


@pytest.mark.parametrize("what", ["black", "few", "covered"])
def test_where_there_is_nothing_to_choose_by_it_is_the_plain_look(what: str) -> None:
    layers = exact_layers(scene())
    photo = noisy(picture(layers, TRUTH))
    if what == "black":
        photo[:] = 0
    elif what == "few":
        photo[np.arange(photo.shape[0]) % 16 > 0] = np.nan
        photo[:, np.arange(photo.shape[1]) % 16 > 0] = np.nan
    else:
        photo[:] = np.nan
    result = fit(photo, layers, "auto", sampling="point")
    assert type(result.look) is LayersLook
    if what == "few":
        assert result.selection is not None
        assert {row.delta_bic for row in result.selection.terms} == {None}
        assert "no term was tried: fewer than 64 pixels have no edge" in str(result)
    else:
        assert result.verdict == "no_data"
        assert result.selection is None


def test_what_it_does_not_take_is_refused_with_a_remedy() -> None:
    layers = exact_layers(scene())
    photo = picture(layers, TRUTH)
    for more, words in (
        ({"response": Response(blur=1.0)}, "chooses no terms of blurred photos; name them"),
        ({"bounds": {"scale_height": (1.0, 2.0)}}, "'scale_height' is no parameter"),
        ({"look": "layers"}, "'layers' is a name; give 'auto', or find_look"),
    ):
        asked: dict[str, Any] = {"look": "auto", **more}
        with pytest.raises(InputError, match=words):
            fit(photo, layers, **asked)
    with pytest.raises(InputError, match="chooses outside of jit, vmap and grad"):
        jax.jit(lambda one: fit(one, layers, "auto"))(photo)


def test_exact_pictures_are_told_by_the_plain_look() -> None:
    """Nothing is left over, so no term is worth anything. The picture is of float32."""
    layers = exact_layers(scene())
    result = fit(picture(layers, TRUTH), layers, "auto", sampling="point")
    assert taken(result) == set()
    assert result.parameters["brightness"].value == pytest.approx(3.0, rel=1e-6)


def test_of_grey_photos_white_is_no_air_that_saturates(tmp_path: Path) -> None:
    """Copied channels are not known; the others tell what may be white."""
    layers = exact_layers(scene())
    light = picture(layers, TRUTH)[..., 1:2].repeat(3, axis=2)
    light = light / np.quantile(light[np.asarray(layers.has_air)], 0.9)
    light = light + np.random.default_rng(3).normal(0, 0.03, (*light.shape[:2], 1))
    codes = np.clip(light, 0, 1) ** (1 / 2.2)
    Image.fromarray(np.rint(255 * codes).astype(np.uint8)).save(tmp_path / "white.png")
    result = fit(load_photo(tmp_path / "white.png"), layers, "auto", sampling="point")
    assert result.pixels["clipped_samples"] > 100
    assert taken(result) == set()


def test_where_nothing_is_free_without_terms_one_is_found_or_none() -> None:
    """A colour of a grey photo, which tells none, and the terms beside it."""
    layers = exact_layers(scene())
    light = noisy(picture(layers, TRUTH))[..., 1:2].repeat(3, axis=2)
    with pytest.raises(InputError, match="nothing to fit") as _:
        fit(light, layers, "auto", free=())
    result = fit(light, layers, "auto", free="tint", sampling="point")
    assert result.selection is not None


def test_priors_bound_what_choosing_may_use() -> None:
    """A gamma that is free would bend the light as saturation does; one that is known does not."""
    photo, layers = drawn(SMALL, "air+saturation", extinction=(3.0, 6.0, 12.0))
    names = ["brightness", "tint", "shadow", "background", "gamma"]
    result = fit(photo, layers, "auto", free=names, priors={"gamma": (1.0, 0.01)}, sampling="point")
    assert taken(result) == {"saturation"}


def test_light_beyond_all_measure_ends_as_it_does_without_a_choice() -> None:
    layers = exact_layers(scene())
    result = fit(picture(layers, TRUTH), layers, "auto", bounds={"brightness": (1e200, np.inf)})
    assert result.verdict == "diverged"
