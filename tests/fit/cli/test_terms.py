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
    ],
)
def test_terms_that_are_not_there_are_refused(
    options: tuple[str, ...], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.toml").write_text(SCENE)
    assert airlight("check", tmp_path / "scene.toml", *options) == 2
    assert told in capsys.readouterr().err
