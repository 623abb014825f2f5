"""The pictures of `docs/air.md`: the terms of the look `air`, switched on one after the other.

    python examples/draw_terms.py [-o docs]

writes `air-disc.png`, a planet beside its terminator, and `air-limb.png`, the limb at the
terminator from near by. Air and planet are Earth's, lengths in km.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from make_photo_scenes import AIR_COLOR, EARTH_RADIUS
from matplotlib.figure import Figure

from model_jax import (
    Atmosphere,
    Camera,
    Planet,
    Scene,
    Srgb,
    Sun,
    analytic_layers,
    composite,
    find_look,
)

SCALE_HEIGHT = 8.0
HALF_DEPTH = 1.1 * EARTH_RADIUS
WIDTH_UNIT = 2 * HALF_DEPTH
"""Distance of the clip planes, which enclose the planet: widths are divided by it."""
DEPTH = 0.24
"""Optical depth of Earth's molecules from the ground to the zenith at 440 nm (Bucholtz, "Rayleigh-
scattering calculations for the terrestrial atmosphere", 1995)."""
AIRLIGHT = 0.5
"""Light of air so deep that nothing passes it, under a sun of 1."""
TERMS: dict[str, dict[str, Any]] = {
    "": {"shadow": 0.0},
    "density": {"scale_height": SCALE_HEIGHT},
    "saturation": {"extinction": DEPTH * WIDTH_UNIT / SCALE_HEIGHT * np.array(AIR_COLOR)},
    "sun": {},
    "upwelling": {"upwelling": 0.3},
    "phase": {"aerosol": 0.2, "asymmetry": 0.7},
    "ground": {"ground": (0.10, 0.12, 0.16)},
    "top": {"top": 25.0},
}
"""In the order of the page, and what each sets."""
SHELL = 60.0
UNIFORM = SCALE_HEIGHT / SHELL
"""How dense uniform air is that is as much as thinning air."""
EXPOSURE = 1.2
WHITE = (1.0, 1.0, 1.0)
SUN = np.array([1.0, 0.0, 0.0])
PLACE = np.array([0.9, -2.4, 0.5])
"""Of the camera, planet radii: a third of what it sees is night."""


def limb_at_terminator() -> np.ndarray:
    """Where the limb that the camera sees crosses the terminator, planet radii: p · place = 1."""
    across = PLACE - (PLACE @ SUN) * SUN
    along = np.cross(SUN, across)
    share = 1 / (across @ across)
    return share * across - np.sqrt((1 - share) / (along @ along)) * along


def scene_of(aim: np.ndarray, fov: float) -> Scene:
    """The Earth from a place, aimed at another."""
    position = EARTH_RADIUS * PLACE
    distance = float(np.linalg.norm(position))
    forward = EARTH_RADIUS * aim - position
    clip = distance - HALF_DEPTH, distance + HALF_DEPTH
    camera = Camera(position, forward, (0.0, 0.0, 1.0), fov, 320, 240, *clip)
    air = Atmosphere(SHELL, AIR_COLOR, "distance")
    return Scene(camera, Planet(EARTH_RADIUS), air, Sun(SUN, 0.2666))


VIEWS = {
    "disc": scene_of(np.zeros(3), 50.0),
    "limb": scene_of(limb_at_terminator(), 4.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parents[1] / "docs")
    folder = parser.parse_args().output
    for name, scene in VIEWS.items():
        draw(scene).savefig(folder / f"air-{name}.png", dpi=110)


def draw(scene: Scene) -> Figure:
    """The scene with more and more terms."""
    figure = Figure((9.6, 4.0), layout="constrained")
    values: dict[str, Any] = {"brightness": UNIFORM * AIRLIGHT * DEPTH * WIDTH_UNIT / SCALE_HEIGHT}
    terms: list[str] = []
    for axes, (term, more) in zip(figure.subplots(2, 4).flat, TERMS.items(), strict=True):
        terms += [term] if term else []
        values |= more
        if terms == ["density"]:
            values["brightness"] /= UNIFORM
        if term == "ground":
            scene = replace(scene, planet=Planet(EARTH_RADIUS, albedo=WHITE))
        look = find_look("+".join(["air", *terms]))(**values)
        light = composite(analytic_layers(scene, look=look), look)[..., :3]
        axes.imshow(np.asarray(Srgb().encode(np.clip(EXPOSURE * np.asarray(light), 0, 1))))
        axes.set_title(f"+ {term}" if term else "air", fontsize=9)
        axes.set_axis_off()
    return figure


if __name__ == "__main__":
    main()
