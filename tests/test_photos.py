"""What the README says of real photos: how much of the light of their rings each look explains."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from .test_examples import EXAMPLES, example

pytestmark = pytest.mark.full

AIR = "air+density+saturation"
EXPLAINED = {
    "EPIC 2022-01-10": (0.06, 0.736),
    "EPIC 2025-06-21": (-0.08, 0.680),
    "EPIC 2025-07-09": (-0.15, 0.809),
    "crescent AS12-50-7364": (0.32, 0.860),
    "limb, ISS": (0.30, 0.798),
}
"""Of `layers` and of thinning air, as measured; kept within a point."""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], ModuleType]:
    """Examples, with their folder on the path as Python has it where one of them is run."""
    monkeypatch.setattr(sys, "path", [str(EXAMPLES), *sys.path])
    return example


@pytest.mark.parametrize("name", EXPLAINED)
def test_thinning_air_explains_what_a_slab_does_not(
    name: str, data_dir: Path, script: Callable[[str], ModuleType]
) -> None:
    photos = script("photos")
    path, scene = photos.photos(data_dir)[name]
    for look, asked in zip(("layers", AIR), EXPLAINED[name], strict=True):
        found = photos.fit_ring(data_dir / path, scene(), look)
        assert found.explained == pytest.approx(asked, abs=0.01), look
        assert all(found.parameters[level].value >= 0 for level in ("background", "black_level"))


def test_mean_profile_of_the_limb_is_four_times_nearer(
    data_dir: Path, script: Callable[[str], ModuleType]
) -> None:
    """From 8 km below the edge of the blue upward."""
    photos, draw = script("photos"), script("draw_looks")
    path, scene = photos.photos(data_dir)["limb, ISS"]
    found = {look: photos.fit_ring(data_dir / path, scene(), look) for look in ("layers", AIR)}
    profiles = draw.limb_profiles(data_dir / path, scene(), found)
    above = profiles.blue_edge - 8
    assert 10 < above < 15
    assert profiles.residual(AIR, above) <= profiles.residual("layers", above) / 4
