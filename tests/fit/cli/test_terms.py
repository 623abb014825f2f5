"""`--terms`: what is added to a look, from the command line to the fitted numbers and back."""

import json
from pathlib import Path

import pytest

from tests.command import airlight
from tests.scene_text import SCENE


def test_air_that_thins_out_is_drawn_fitted_and_exported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was drawn is found again; 16-bit codes of a linear picture leave a part in 10⁴."""
    monkeypatch.chdir(tmp_path)
    look = '[look]\nkind = "air+density+saturation"\n'
    values = "scale_height = 60.0\nextinction = [1.0, 2.0, 4.0]\nbrightness = 3.0\nshadow = 0.3\n"
    (tmp_path / "true.toml").write_text(SCENE.split("[look]")[0] + look + values)
    (tmp_path / "scene.toml").write_text(SCENE.split("[look]")[0])
    assert airlight("render", "true.toml", "-o", "photo.exr") == 0
    asked = ("--look", "air", "--terms", "density,saturation", "--sampling", "point")
    assert airlight("fit", "scene.toml", "photo.exr", *asked, "--out", "out") == 0
    found = json.loads((tmp_path / "out/fit.json").read_text())
    assert found["look"]["kind"] == "air+density+saturation"
    estimates = {name: p["value"] for name, p in found["parameters"].items()}
    true = {"scale_height": 60.0, "extinction.r": 1.0, "extinction.b": 4.0, "shadow": 0.3}
    for name, value in true.items():
        assert estimates[name] == pytest.approx(value, rel=1e-3), name
    assert found["selection"] is None
    assert airlight("export", "out/fit.json", "--to", "toml", "-o", "look.toml") == 0
    (tmp_path / "again.toml").write_text(
        SCENE.split("[look]")[0] + (tmp_path / "look.toml").read_text()
    )
    assert airlight("check", "again.toml", "-o", "check") == 0


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--terms", "density"), "--terms: goes with --look"),
        (("--look", "haze.py", "--terms", "density"), "--terms: goes with --look"),
        (("--look", "air", "--terms", "density,fog"), "look air: has no term 'fog'; choose from"),
        (("--look", "layers", "--terms", "density"), "look layers: has no term 'density'"),
        (("--look", "air", "--terms", ""), "look air: has no term ''"),
        (("--look", "auto", "--terms", "density"), "--terms: --look auto chooses them"),
        (("--look", "auto"), "look 'auto' is unknown; choose from layers, air"),
    ],
)
def test_terms_that_are_not_there_are_refused(
    options: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    assert airlight("check", tmp_path / "scene.toml", *options) == 2
    assert told in capsys.readouterr().err


def test_where_nobody_names_a_look_its_terms_are_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A scene's values without a kind are where it begins; a kind, on either place, is the look."""
    monkeypatch.chdir(tmp_path)
    bare, kind = SCENE.split("[look]")[0], '[look]\nkind = "air+density"\n'
    (tmp_path / "true.toml").write_text(f"{bare}{kind}scale_height = 60.0\nbrightness = 5.0\n")
    (tmp_path / "values.toml").write_text(f"{bare}[look]\nshadow = 0.3\n")
    (tmp_path / "named.toml").write_text(f'{bare}[look]\nkind = "layers"\n')
    assert airlight("render", "true.toml", "-o", "photo.exr") == 0
    how = ("photo.exr", "--sampling", "point", "--source", "analytic", "-o", "out")
    for scene, options, chosen in (
        ("values.toml", ("--accept-misfit",), True),
        ("named.toml", ("--look", "auto"), True),
        ("named.toml", ("--accept-misfit",), False),
        ("values.toml", ("--look", "layers", "--accept-misfit"), False),
    ):
        assert airlight("fit", scene, *how, *options) == 0
        found = json.loads((tmp_path / "out/fit.json").read_text())
        assert (found["selection"] is not None) == chosen
        assert found["look"]["kind"] == ("air+density" if chosen else "layers")
        said = capsys.readouterr().out
        assert ("terms chosen by" in said) == chosen
        assert ("Terms of the look" in (tmp_path / "out/report.html").read_text()) == chosen
        assert found["parameters"]["shadow"]["initial"] == (0.3 if scene == "values.toml" else 0.2)
    assert airlight("fit", "values.toml", *how, "--look", "auto", "--terms", "blur") == 2
    assert "chooses no terms of blurred photos" in capsys.readouterr().err
