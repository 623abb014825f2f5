"""The report: one self-contained page that says what fit.json says, whatever the fit was."""

import copy
import html
import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from fit import fit
from fit._numbers import measured, number
from fit.report._report import TONES, photo_section, report_html
from fit.report._wording import shown_parameters, span, verdict_sentence
from model_jax import (
    Atmosphere,
    Camera,
    LayersLook,
    Planet,
    Scene,
    Srgb,
    Sun,
    analytic_layers,
    combine,
    limb_height,
)
from tests.fit.report.documents import CASES as GOLDEN

SCENE = Scene(
    Camera([0, -20000, 6000], [0, 20000, -6000], [0, 0, 1], 42, 96, 72, 12000, 30000),
    Planet(6371),
    Atmosphere(600, [0.3, 0.6, 1.0]),
    Sun([1, -0.3, 0.2]),
)
LAYERS = analytic_layers(SCENE)
PICTURE = np.asarray(combine(LAYERS, LayersLook()))[..., :3]


def document(photo: np.ndarray = PICTURE, **changes: Any) -> dict[str, Any]:
    """A fit.json document as the command line makes it."""
    facts = {
        "schema": 3,
        "scene": "scene.toml",
        "photo": "photo.png",
        **copy.deepcopy(told(photo.tobytes())),
        "versions": {"airlight": "0.1.0"},
        "command": "airlight fit",
    }
    facts["seconds"] = {"render": 0.1, "reduce": 0.2, "solve": 0.3, "report": 0.4}
    return facts | changes


@cache
def told(photo: bytes) -> dict[str, Any]:
    """The fit of a photo, given as bytes so that each is fitted once."""
    return fit(np.frombuffer(photo, np.float32).reshape(PICTURE.shape), LAYERS).to_dict()


def page(
    facts: dict[str, Any],
    photo: np.ndarray = PICTURE,
    command: str = "airlight fit scene.toml photo.png -o out",
    **changes: Any,
) -> str:
    return report_html(facts, [section(photo, **changes)], command)


def section(photo: np.ndarray = PICTURE, **changes: Any) -> dict[str, Any]:
    settings: dict[str, Any] = {
        "name": "photo.png",
        "picture": PICTURE,
        "used": np.asarray(LAYERS.has_air),
        "height": limb_height(SCENE),
        "tone_curve": Srgb(),
    } | changes
    return photo_section(photo=photo, **settings)


@cache
def plain_section() -> dict[str, Any]:
    """A small photo's, drawn once."""
    one = np.full((1, 1, 3), 0.5, np.float32)
    return section(one, picture=one, used=np.ones((1, 1), bool), height=None)


def test_every_section_is_there() -> None:
    text = page(document())
    for heading in (
        "Converged",
        "Photo and model",
        "Limb profile",
        "Parameters",
        "95 % interval",
        "What the photo tells",
        "Left out",
        "Correlation",
        "What the errors rest on",
        "Convergence",
        "Pixels",
        "Time",
        "Command",
    ):
        assert heading in text
    for name in ("brightness", "shadow", "tint.r", "tint.g", "tint.b", "background"):
        assert name in text
    assert "airlight fit scene.toml photo.png -o out" in text


@pytest.mark.parametrize("name", GOLDEN)
def test_the_page_says_what_the_golden_reports_say(name: str) -> None:
    """Verdict in the banner, each reason for what was left out, each interval in its row."""
    facts = {"photo": "photo.png", "scene": "scene.toml"} | GOLDEN[name]
    text = html.unescape(report_html(facts, [plain_section()], ""))
    tone, heading = TONES[facts["verdict"]]
    tone = "warn" if tone == "good" and facts["explained"] < 0.9 else tone
    banner = text[text.index(f'<section id="verdict" class="banner {tone}">') :]
    banner = banner[: banner.index("</section>")]
    assert f"<h2>{heading}</h2>" in banner
    assert verdict_sentence(facts) in banner
    assert all(warning in banner for warning in facts["warnings"])
    for item in facts["left_out"]:
        assert f"<dt>{item['what']}</dt><dd>{item['why']}</dd>" in text
    rows = re.findall(r"<tr.*?</tr>", text, re.DOTALL)
    for parameter, estimate in shown_parameters(facts).items():
        row = next(row for row in rows if re.search(rf">\s*{re.escape(parameter)}\s*<", row))
        assert re.search(rf">\s*{re.escape(span(estimate['interval']))}\s*<", row)


def test_what_each_pixel_meant_is_shown_and_said() -> None:
    result = fit(PICTURE, LAYERS)
    weights = np.random.default_rng(0).uniform(size=PICTURE.shape[:2])  # as of a robust fit
    maps: dict[str, Any] = {"influence": ("shadow", result.influence("shadow").sum(axis=-1))}
    text = page(document(), **maps)
    assert "how far <b>shadow</b> moves" in text
    assert "Belief" not in text
    text = page(document(), **maps, weights=weights)
    assert "Belief in each pixel" in text
    assert "Influence of each pixel" not in page(document(), weights=weights)


def test_the_influence_of_half_and_of_the_shadowed_pixels_is_counted() -> None:
    used = np.zeros((72, 96), bool)
    used[:2, :10] = True
    shadowed = np.zeros((72, 96), bool)
    shadowed[1] = True
    influence = np.zeros((72, 96), np.float32)
    influence[0, :10], influence[1, :10] = 3.0, -1.0  # three quarters lie with the ten lit pixels
    made = section(used=used, shadowed=shadowed, influence=("shadow", influence))
    assert made["influence"]["dark"] == "25 %"
    assert made["influence"]["few"] == "35 %"  # 7 of 20 pixels hold 21 of 40


def test_bounds_priors_ties_and_responses_are_in_the_table() -> None:
    facts = document()
    parameters = facts["parameters"]
    assert "black_level" in parameters
    assert "black_level" not in page(facts)  # fixed, and changes nothing
    parameters["brightness"] |= {"prior": [3.0, 0.5], "bounds": [0.0, 5.0]}
    parameters["gamma"] |= {"value": 1.2, "role": "fixed"}
    parameters["exposure"] |= {"role": "tied", "tied_to": "exposure.1"}
    text = page(facts)
    for words in ("3 ± 0.5", "0 … 5", "gamma", "= exposure.1"):
        assert words in text


def test_warnings_are_listed_once() -> None:
    warning = "The background came out negative: the model takes light away."
    text = page(document(warnings=[warning], message=f"The fit converged. {warning}"))
    assert text.count(warning) == 1


def test_the_second_opinion_and_the_curve_are_there() -> None:
    text = page(document(history=[10.0, 1.0, 0.5], second_opinion="lower"))
    assert "ended lower" in text
    assert "square sum after each step" in text
    assert "made no step" in page(document(history=[], second_opinion=""))


def test_several_photos_each_have_their_pictures() -> None:
    sections = [section(name=f"photo{n}.png", count=2) for n in (1, 2)]
    text = report_html(document(), sections, "")
    for which in (1, 2):
        assert f"Photo and model · photo {which}" in text
        assert f"photo{which}.png" in text
    assert text.count("Limb profile") == 2


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
    maps: dict[str, Any] = {"influence": ("shadow", noise[..., 0] - 0.5), "weights": noise[..., 1]}
    text = page(document(), photo=noise, picture=noise, used=used, height=None, **maps)
    assert len(text) < 5_000_000


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
def test_values_are_written_to_two_digits_of_their_error(
    value: float, stderr: float, text: str
) -> None:
    assert measured(value, stderr) == text


@pytest.mark.parametrize(
    ("limits", "text"),
    [
        ((7.0594, 16.771), "7.1 … 16.8"),
        ((-0.24514, -0.06361), "−0.245 … −0.064"),
        ((1e-9, 3e-9), "1 · 10⁻⁹ … 3 · 10⁻⁹"),
        ((2.0, 2.0), "2"),
        ((None, 1.0), "—"),
        (None, "—"),
    ],
)
def test_intervals_are_written_to_two_digits_of_half_their_width(
    limits: tuple[float | None, float] | None, text: str
) -> None:
    assert span(limits) == text


def test_missing_numbers_are_dashes() -> None:
    assert number(None) == "—"


def test_a_telephone_gets_one_column_and_each_number_its_name() -> None:
    """At 390 pixels the influence card kept two columns, and intervals were cut off."""
    text = page(document())
    narrow = text[text.index("@media (max-width: 760px)") : text.index("@media print")]
    columns = re.search(r"([^{}]*)\{ grid-template-columns: minmax\(0, 1fr\); \}", narrow)
    assert columns is not None
    wide = re.findall(
        r"(\.[\w.]+) \{[^}]*grid-template-columns: (?:repeat\([23]|minmax.*minmax)", text
    )
    assert ".maps.alone" in wide
    assert set(wide) <= set(re.findall(r"\.[\w.]+", columns[1])), "no card stays wide"
    (table,) = re.findall(r'<table class="rows">.*?</table>', text, re.DOTALL)
    heads = re.findall(r"<th>(.*?)</th>", table)
    for row in re.findall(r"<tr title.*?</tr>", table, re.DOTALL):
        assert re.findall(r'<td data-name="(.*?)"', row) == heads
