"""The README's table of looks has the picture that each look makes now."""

import importlib.util
from typing import Any

import numpy as np
import pytest
from PIL import Image

from model_jax.looks._registry import BUILT_IN
from tests.data import REPOSITORY


def _script() -> Any:
    path = REPOSITORY / "examples" / "draw_gallery.py"
    spec = importlib.util.spec_from_file_location("draw_gallery", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


DRAW = _script()


def test_every_look_has_a_picture_in_one_table() -> None:
    assert [name.partition("+")[0] for name in DRAW.GALLERY] == list(BUILT_IN)
    lines = (REPOSITORY / "README.md").read_text().splitlines()
    first = lines.index("| look | picture | light | from |")
    rows = lines[first + 2 : first + 2 + len(BUILT_IN)]
    for name, row in zip(BUILT_IN, rows, strict=True):
        assert row.startswith(f"| `{name}` | ![{name}](docs/look-{name}.png) | ")
    assert not lines[first + 2 + len(BUILT_IN)].startswith("|")


@pytest.mark.parametrize("name", DRAW.GALLERY)
def test_it_is_what_the_look_makes(name: str) -> None:
    """Drivers differ by codes at the edges of what they cover; `python examples/draw_gallery.py`
    makes it anew."""
    kept = np.asarray(Image.open(REPOSITORY / "docs" / f"look-{name.partition('+')[0]}.png"))
    apart = np.abs(kept.astype(int) - DRAW.picture_of(name))
    assert np.mean(apart > 1) < 0.005
    assert np.ptp(kept) > 100
