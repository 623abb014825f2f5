"""The plain-text report, held against golden files: good and bad fits alike.

The documents are made by hand, so that no machine's rounding is in them. To write the golden files
anew after a wanted change: `python -m tests.fit.test_terminal`.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fit import FitResult, Verdict, fit
from fit._verdict import VERDICTS
from fit.report._terminal import fit_text
from model_jax import Layers
from tests.fit.report.documents import CASES, document, photo_row

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("name", CASES)
def test_reports_are_the_golden_ones(name: str) -> None:
    assert fit_text(CASES[name]) == (GOLDEN / f"{name}.txt").read_text(encoding="utf-8")


def keys_of(made: Any, path: str = "") -> set[str]:
    """All keys, at any depth; names of parameters, reasons and steps are no keys."""
    if isinstance(made, list):
        return set().union(*(keys_of(item, path) for item in made))
    if not isinstance(made, dict):
        return set()
    if path in (".parameters", ".seconds", ".pixels.excluded", ".photos.pixels.excluded"):
        return set().union(*(keys_of(item, f"{path}.*") for item in made.values()))
    here = {f"{path}.{key}" for key in made}
    return here.union(*(keys_of(item, f"{path}.{key}") for key, item in made.items()))


@pytest.fixture(scope="module")
def real() -> dict[str, FitResult]:
    """Fits by their verdicts, of a few pixels."""
    rng = np.random.default_rng(9)
    lit, dark = rng.uniform(0.1, 0.6, (16, 20)), rng.uniform(0.0, 0.4, (16, 20))
    air = Layers(np.zeros_like(lit), lit + dark, lit, lit + dark)
    light = 3.0 * (lit + 0.2 * dark)[..., None] + rng.normal(scale=0.01, size=(16, 20, 3))
    free = ("brightness", "exposure", "tint")
    found = [fit(light, air), fit(light, air, free=free), fit(0 * light, air)]
    return {result.verdict: result for result in found}


@pytest.mark.parametrize("name", CASES)
def test_documents_have_the_keys_of_a_fit(name: str, real: dict[str, FitResult]) -> None:
    """But for what was left out and for errors, which not every fit has."""
    told = {verdict: keys_of(result.to_dict()) for verdict, result in real.items()}
    whole = told["not_identifiable"]
    optional = {key for key in whole if key.startswith((".left_out.", ".errors."))}
    assert {key.split(".")[1] for key in optional} == {"left_out", "errors"}
    added = {".photos.tone_curve", ".photos.tone_curve.exposure", ".photos.tone_curve.gamma"}
    mine = keys_of(CASES[name]) - added
    assert mine | optional == whole
    assert all(found | optional == whole for found in told.values())


@pytest.mark.parametrize("verdict", [Verdict.NOT_IDENTIFIABLE, Verdict.NO_DATA])
def test_reports_of_real_fits_name_the_verdict_and_the_remedy(
    verdict: Verdict, real: dict[str, FitResult]
) -> None:
    """In whole sentences, wherever the lines are broken."""
    text = " ".join(real[verdict.label].report().split())
    sentence, remedy = VERDICTS[verdict]
    assert text.startswith(f"{verdict.label} {sentence}")
    assert f"To do: {remedy}." in text
    for item in real[verdict.label].left_out:
        assert f"left out: {item.what}, because {item.why}" in text


@pytest.mark.parametrize("width", [60, 80, 100, 140])
@pytest.mark.parametrize("name", CASES)
def test_no_line_is_wider_than_the_terminal(name: str, width: int) -> None:
    text = fit_text(CASES[name], width)
    assert max(map(len, text.splitlines())) <= width
    for parameter in ("brightness", "tint.g"):
        assert (parameter in text) == (name != "no_data")


def test_every_golden_file_is_of_a_case() -> None:
    assert {path.stem for path in GOLDEN.iterdir()} == set(CASES)


def write_golden() -> None:
    """Write what the reports are now; look at the difference before it is kept."""
    GOLDEN.mkdir(exist_ok=True)
    for name, made in CASES.items():
        (GOLDEN / f"{name}.txt").write_text(fit_text(made), encoding="utf-8")


if __name__ == "__main__":
    write_golden()


def test_a_limb_that_was_seen_has_a_line() -> None:
    limb: dict[str, Any] = {
        "off": 2.98,
        "rms": 0.057,
        "right": -3.0,
        "down": 1.5,
        "outward": 1.9,
        "scale": 1.03,
    }
    limb |= {"stderr": [0.1, 0.1, 0.1], "edges": 25}
    text = fit_text(document(photos=[photo_row(alignment=limb)]))
    assert "limb 3 px beside the scene's where it is seen; its edges lie within 0.057 px" in text
    assert "limb" not in fit_text(document())
