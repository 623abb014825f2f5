"""The words that options of `render_gl` take; without OpenGL, for command lines to know them."""

from typing import Literal, get_args

DepthFormat = Literal["window16", "window24", "window32f", "reversed32f", "linear"]
DEPTH_FORMATS: tuple[DepthFormat, ...] = get_args(DepthFormat)
"""The cheapest first."""

Source = Literal["raster", "mesh"]
SOURCES: tuple[Source, ...] = get_args(Source)
"""Depths of each pixel's own ray, or the paper's meshes (see `_raster`)."""
