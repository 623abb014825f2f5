"""`import airlight`: every public name under one, and only those."""

import re
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

import airlight
import fit
import model_jax
import render_gl

from .command import mypy

PACKAGES = (model_jax, render_gl, fit)
WHOLE: Any = airlight
"""Its types list the names that it offers, and neither `__all__` nor what is no name."""


def test_each_public_name_is_its_owners() -> None:
    names = [name for package in PACKAGES for name in package.__all__]
    assert len(names) == len(set(names)), "no two packages offer one name"
    assert set(WHOLE.__all__) == {"__version__", *names}
    assert dir(airlight) == sorted(WHOLE.__all__)
    for package in PACKAGES:
        for name in package.__all__:
            assert getattr(airlight, name) is getattr(package, name), name


def test_the_version_is_the_distributions() -> None:
    assert airlight.__version__ == metadata.version("airlight")


def test_a_name_that_is_none_is_told() -> None:
    with pytest.raises(AttributeError, match="module 'airlight' has no attribute 'atmosphere'"):
        _ = WHOLE.atmosphere


def test_types_come_with_it(tmp_path: Path) -> None:
    """mypy knows each name by its owner's type, and refuses others."""
    (tmp_path / "a.py").write_text(
        "import airlight\n"
        "reveal_type(airlight.fit)\n"
        "reveal_type(airlight.LayersLook(3.0).brightness)\n"
        "reveal_type(airlight.render)\n"
        "reveal_type(airlight.__version__)\n"
        "airlight.atmosphere\n"
    )
    done = mypy(tmp_path / "a.py")
    told = re.sub(r"\n +", " ", done.stdout)
    assert "FitResult" in told.splitlines()[0], told
    assert "def (scene: model_jax._scene.Scene" in told, told
    assert re.search(r'Revealed type is "(builtins\.)?str"', told), told
    assert 'Module has no attribute "atmosphere"' in told, told
