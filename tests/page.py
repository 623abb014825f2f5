"""The page docs/add-a-look.md, as files that a test writes."""

import re
from pathlib import Path

from .data import REPOSITORY

PAGE = (REPOSITORY / "docs" / "add-a-look.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


def write_look(folder: Path) -> Path:
    """The page's look, in Python and GLSL; the path of the Python file."""
    (folder / "haze.py").write_text(blocks("python")[0])
    (folder / "haze.glsl").write_text(blocks("glsl")[0])
    return folder / "haze.py"


def write_scene(folder: Path) -> Path:
    """The page's scene, which names the look."""
    (folder / "scene.toml").write_text(blocks("toml")[0])
    return folder / "scene.toml"
