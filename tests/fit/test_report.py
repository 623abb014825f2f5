"""The report: one self-contained page that says what fit.json says, whatever the fit was."""

import re
from typing import Any

import numpy as np
import pytest

from fit import fit
from fit._report import measured, number, report_html
from model_jax import (
    Atmosphere,
    Camera,
    Look,
    Planet,
    Scene,
    Srgb,
    Sun,
    analytic_layers,
    combine,
    limb_height,
)

SCENE = Scene(
    Camera([0, -20000, 6000], [0, 20000, -6000], [0, 0, 1], 42, 96, 72, 12000, 30000),
    Planet(6371),
    Atmosphere(600, [0.3, 0.6, 1.0]),
    Sun([1, -0.3, 0.2]),
)
LAYERS = analytic_layers(SCENE)
PICTURE = np.asarray(combine(LAYERS, Look()))[..., :3]


def document(photo: np.ndarray = PICTURE, **changes: Any) -> dict[str, Any]:
    """A fit.json document as the command line makes it."""
    facts = {
        "schema": 1,
        "scene": "scene.toml",
        "photo": "photo.png",
        **fit(photo, LAYERS).to_dict(),
        "versions": {"airlight": "0.1.0"},
        "command": "airlight fit",
    }
    facts["seconds"] = {"render": 0.1, "reduce": 0.2, "solve": 0.3, "report": 0.4}
    return facts | changes


def page(facts: dict[str, Any], photo: np.ndarray = PICTURE, **changes: Any) -> str:
    settings = {
        "picture": PICTURE,
        "used": np.asarray(LAYERS.has_air),
        "height": limb_height(SCENE),
        "tone_curve": Srgb(),
        "command": "airlight fit scene.toml photo.png -o out",
    } | changes
    return report_html(facts, photo, **settings)


def test_every_section_is_there() -> None:
    text = page(document())
    for heading in (
        "Converged",
        "Photo and model",
        "Limb profile",
        "Parameters",
        "Correlation",
        "Left out",
        "Pixels",
        "Time",
        "Command",
    ):
        assert heading in text
    for name in ("brightness", "shadow", "tint.r", "tint.g", "tint.b", "background"):
        assert name in text
    assert "airlight fit scene.toml photo.png -o out" in text


def test_nothing_is_asked_from_outside() -> None:
    text = page(document())
    assert not re.search(r"(src|href)\s*=\s*[\"']?(https?:)?//", text)
    assert "<script" not in text
    sources = re.findall(r"<img[^>]*\bsrc=\"([^\"]{0,30})", text)
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)


def test_names_and_commands_are_escaped() -> None:
    evil = "<script>alert(1)</script>"
    text = page(document(photo=PICTURE, scene=evil), command=evil)
    assert evil not in text
    assert "&lt;script&gt;" in text


def test_a_large_photo_makes_no_large_page() -> None:
    rng = np.random.default_rng(1)
    noise = rng.random((2400, 3200, 3)).astype(np.float32)
    used = np.ones((2400, 3200), bool)
    text = page(document(), photo=noise, picture=noise, used=used, height=None)
    assert len(text) < 4_000_000


def spoilt() -> np.ndarray:
    photo = PICTURE.copy()
    photo[10:20] = np.nan
    photo[30:34] = np.inf
    return photo


CASES = {
    "black": (np.zeros_like(PICTURE), "No data"),
    "constant": (np.full_like(PICTURE, 0.3), "No data"),
    "not finite": (spoilt(), "Converged"),
}


@pytest.mark.parametrize(("photo", "heading"), CASES.values(), ids=CASES.keys())
def test_photos_of_every_kind_get_a_page(photo: np.ndarray, heading: str) -> None:
    used = np.asarray(LAYERS.has_air) & np.all(np.isfinite(photo), axis=-1)
    assert heading in page(document(photo), photo=photo, used=used)


def test_no_used_pixel_and_one_pixel() -> None:
    assert "No pixel was used" in page(document(), used=np.zeros(PICTURE.shape[:2], bool))
    one = np.full((1, 1, 3), 0.5, np.float32)
    text = page(document(), photo=one, picture=one, used=np.ones((1, 1), bool), height=None)
    assert "without a camera" in text


def test_an_empty_correlation_and_no_errors() -> None:
    facts = document(correlation={"names": [], "matrix": []})
    for estimate in facts["parameters"].values():
        estimate["stderr"] = None
    assert "Parameters" in page(facts)


@pytest.mark.parametrize(
    ("value", "stderr", "text"),
    [(2.99712, 0.0123, "2.997 ± 0.012"), (-0.1545, 0.0018, "−0.1545 ± 0.0018")],
)
def test_values_are_written_to_two_digits_of_their_error(value, stderr, text) -> None:
    assert measured(value, stderr) == text


def test_missing_numbers_are_dashes() -> None:
    assert number(None) == "—"
