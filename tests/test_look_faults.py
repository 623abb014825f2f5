"""A look with an error is refused by name, in one line, before anything is drawn or fitted."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import render_gl
from model_jax import (
    Fields,
    InputError,
    LayersLook,
    Separable,
    load_look,
    parameter,
)
from model_jax.looks._air import AirLook
from model_jax.looks._check import check_look
from tests.command import airlight
from tests.own_looks import Glow
from tests.page import blocks, write_look, write_scene

FAULTS: dict[str, tuple[str, str, str, str]] = {
    "parameter without uniform": (
        "glsl",
        "uniform float kappa;\n",
        "",
        "no uniform for the parameter kappa; add `uniform float kappa;`",
    ),
    "uniform of another type": (
        "glsl",
        "uniform vec3 tint",
        "uniform float tint",
        "declares tint as float; write `uniform vec3 tint;`",
    ),
    "uniform that is no parameter": (
        "glsl",
        "uniform float kappa",
        "uniform float fog;\nuniform float kappa",
        "has a uniform fog, which is no parameter",
    ),
    "no function": ("glsl", "vec3 air(", "vec3 fog(", "defines no function `vec3 air("),
    "name of a shader's own": (
        "both",
        "kappa",
        "plane_depths",
        "the parameter plane_depths has a name that airlight's shaders use",
    ),
    "no GLSL": ("glsl", "exp(", "exp2pow(", "does not compile"),
    "field that NEEDS lacks": (
        "py",
        '("lit", "dark")',
        '("dark", "width")',
        "fields.lit: is not in the look's NEEDS; add it there",
    ),
    "unknown field": (
        "py",
        '("lit", "dark")',
        '("lit", "dark", "haze")',
        "no field is called 'haze'; there are width, lit, dark, planet",
    ),
    "gradient that is not finite": (
        "py",
        "jnp.exp(-self.kappa * (",
        "jnp.exp(-self.kappa * jnp.sqrt(",
        "the gradient by field dark is not finite at the defaults",
    ),
    "light that is not finite": (
        "py",
        "light = 1 -",
        "light = jnp.log(fields.lit) -",
        "light or transmittance is not finite at the defaults",
    ),
    "false linearity": (
        "py",
        "    ROUNDINGS",
        '    LINEAR_IN = ("lit", "dark")\n    ROUNDINGS',
        "light is not linear in lit, dark; correct LINEAR_IN",
    ),
    "blend without alpha": (
        "py",
        "    ROUNDINGS",
        '    BLEND = "over"\n    ROUNDINGS',
        "BLEND is 'over', and air returns no alpha",
    ),
    "no name": (
        "py",
        "    ROUNDINGS",
        '    NAME = "Haze 2"\n    ROUNDINGS',
        "NAME is 'Haze 2'; give small letters",
    ),
    "no annotation": (
        "py",
        "kappa: float =",
        "kappa =",
        "kappa has no annotation; write kappa: float",
    ),
    "no roundings": (
        "py",
        "    ROUNDINGS = (14.0, 8.0)\n",
        "",
        "ROUNDINGS is (0.0, 0.0); give two numbers",
    ),
    "default of another shape": (
        "py",
        "default=1.0, lower",
        "default=(1.0, 2.0), lower",
        "parameter kappa has the default (1.0, 2.0); give one number",
    ),
    "a name that is taken": ("py", "kappa", "gamma", "parameter gamma has a name that is taken"),
    "light of another shape": (
        "py",
        "return light,",
        "return light[..., :2],",
        "air returns light of shape",
    ),
    "no pair": (
        "py",
        "return light, jnp.exp(-self.kappa * (fields.lit + fields.dark))",
        "return light",
        "air returns no pair",
    ),
    "a word of GLSL": ("py", "kappa", "half", "parameter half has a name that is taken"),
    "a transmittance of another shape": (
        "py",
        "return light, jnp.exp(",
        "return light, jnp.ones((1, 2)) * (",
        "air returns a transmittance of shape (",
    ),
    "an air that fails": (
        "py",
        "return light,",
        "return light.fog,",
        "air cannot be run (AttributeError",
    ),
    "a transmittance above 1": (
        "py",
        "return light, jnp.exp(-",
        "return light, jnp.exp(",
        "transmittance leaves 0 to 1 at the defaults",
    ),
    "too many roundings": (
        "py",
        "(14.0, 8.0)",
        "(14.0, 1e9)",
        "ROUNDINGS is (14.0, 1000000000.0); give two numbers",
    ),
    "a table of one": (
        "py",
        "default=1.0, lower",
        "default=(1.0,), shape=1, lower",
        "has the shape 1; give",
    ),
    "a mark of the preprocessor": (
        "glsl",
        "uniform float kappa",
        "#include <fog>\nuniform float kappa",
        "does not compile",
    ),
    "no Python": ("py", "class Haze", "klass Haze", "cannot be run (SyntaxError"),
    "no look": (
        "py",
        "class Haze(Look)",
        "class Haze(object)",
        "must define one look, a subclass of Look; it defines none",
    ),
}
"""Fault: in which file, what is written, what in its place, and what is said of it."""


@pytest.mark.parametrize("fault", FAULTS)
def test_a_look_with_an_error_is_refused_by_name(
    fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_look(tmp_path)
    write_scene(tmp_path)
    ending, right, wrong, said = FAULTS[fault]
    endings = ("py", "glsl") if ending == "both" else (ending,)
    for path in (tmp_path / f"haze.{ending}" for ending in endings):
        text = path.read_text()
        assert right in text
        path.write_text(text.replace(right, wrong))
    if ending == "both":
        Path("scene.toml").write_text(blocks("toml")[0].replace(right, wrong))
    assert airlight("render", "scene.toml", "--look", "haze.py", "-o", "out.png") == 2
    told = capsys.readouterr().err
    assert said in told, told
    assert "haze" in told.lower()
    assert told.count("\n") == 1
    assert not Path("out.png").exists()


def test_linearity_at_the_defaults_alone_is_refused() -> None:
    class Bent(Glow):
        """Linear where `bend` is 0."""

        bend: float = parameter("second order", default=0.0)
        LINEAR_IN = ("width",)

        def air(self, fields: Fields) -> tuple[Any, Any]:
            return self.gain * fields.color * fields.width * (1 + self.bend * fields.width), None

    with pytest.raises(InputError, match="look bent: light is not linear in width"):
        check_look(Bent)


def test_the_nearest_class_says_what_a_parameter_is() -> None:
    class Less(Glow):
        """Less of it."""

        gain: float = parameter("half of it at most", default=0.1, lower=0.0, upper=0.5)

    assert Less.PARAMETERS["gain"].upper == 0.5
    assert list(Less.PARAMETERS) == ["gain", "background"]
    assert Glow.PARAMETERS["gain"].upper == np.inf
    with pytest.raises(InputError, match="parameter background has a name that is taken"):

        class Own(Glow):
            """Another background."""

            background: float = parameter("own", default=0.1)


def test_a_false_product_is_refused() -> None:
    class Squared(LayersLook):
        """Not linear in its weight."""

        SEPARABLE = Separable("brightness", "tint", "shadow", "lit", "dark")

        def air(self, fields: Fields) -> tuple[Any, Any]:
            return self.brightness * fields.color * self.tint * (
                fields.lit + self.shadow**2 * fields.dark
            ), None

    class Single(LayersLook):
        """One weight, which no colour can be."""

        shadow: float = parameter("share of dark air", default=0.2, of="dark")

    class Swapped(LayersLook):
        """Its first field is not in every scene."""

        SEPARABLE = Separable("brightness", "tint", "shadow", "dark", "lit")

    with pytest.raises(InputError, match="look squared: SEPARABLE: the light is not that product"):
        check_look(Squared)
    with pytest.raises(InputError, match="look single: SEPARABLE: shadow is no parameter of shape"):
        check_look(Single)
    with pytest.raises(InputError, match="look swapped: SEPARABLE: its first field must be in"):
        check_look(Swapped)


def test_a_false_amplitude_is_refused() -> None:
    class Bent(AirLook):
        """Not proportional to its brightness."""

        LINEAR_IN = ()
        SEPARABLE = None

        def air(self, fields: Fields) -> tuple[Any, Any]:
            light, passed = super().air(fields)
            return light / (1 + light), passed

    class Dimming(AirLook):
        """What lies behind hangs on it, too."""

        SEPARABLE = None

        def air(self, fields: Fields) -> tuple[Any, Any]:
            light, _ = super().air(fields)
            return light, 1 / (1 + self.brightness * fields.lit)

    class Twice(AirLook):
        """Two numbers."""

        AMPLITUDE = ("brightness", "shadow")

    for kind in (Bent, Dimming):
        with pytest.raises(InputError, match="AMPLITUDE: the light is not proportional to it"):
            check_look(kind)
    with pytest.raises(InputError, match=r"look twice: AMPLITUDE: .* must name one number"):
        check_look(Twice)


def test_scenes_run_no_code_and_name_what_they_miss(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_scene(tmp_path)
    write_look(tmp_path)
    assert airlight("render", path, "-o", tmp_path / "out.png") == 2
    told = capsys.readouterr().err
    assert "'haze' is unknown; choose from layers, air, rim, gradient, install" in told
    path.write_text(blocks("toml")[0].replace('"haze"', '"haze.py"'))
    assert airlight("render", path, "-o", tmp_path / "out.png") == 2
    assert "is a Python file; write the look's name there" in capsys.readouterr().err
    path.write_text(blocks("toml")[0].replace("kappa", "cappa"))
    assert airlight("render", path, "--look", tmp_path / "haze.py", "-o", tmp_path / "o.png") == 2
    assert "unknown key 'cappa'; did you mean kappa?" in capsys.readouterr().err


def test_another_look_than_the_scenes_starts_at_its_defaults(tmp_path: Path) -> None:
    path = write_scene(tmp_path)
    write_look(tmp_path)
    kind = load_look(tmp_path / "haze.py")
    assert render_gl.load_scene(path, tmp_path / "haze.py").look.kappa == 0.5
    path.write_text(blocks("toml")[0].replace('kind = "haze"\n', ""))
    assert render_gl.load_scene(path, tmp_path / "haze.py").look.kappa == 0.5
    path.write_text(blocks("toml")[0])
    plain = render_gl.load_scene(path, "layers").look
    assert isinstance(plain, LayersLook)
    assert plain.brightness == 3.0
    assert kind is load_look(tmp_path / "haze.py")
