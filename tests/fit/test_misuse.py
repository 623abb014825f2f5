"""What Python callers get wrong is named, with what to give instead."""

from typing import Any

import jax
import numpy as np
import pytest

from fit import fit
from model_jax import Atmosphere, InputError, Layers, Response, Scene, analytic_layers

from .looks import START, TRUTH, picture, scene


@pytest.fixture(scope="module")
def photo(layers: Layers) -> np.ndarray:
    return picture(layers, TRUTH)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"photo": "photo.png"}, r"photo: 'photo.png' is a path, no picture; give load_photo"),
        ({"photo": ["a.png", "b.png"]}, r"photo: 'a.png' is a path"),
        ({"photo": None}, r"photo: is of type NoneType; give what load_photo returns"),
        ({"photo": 3.0}, r"photo: is of type float; give"),
        ({"photo": []}, r"got 0 photos and 1 sets of layers"),
        ({"layers": scene()}, r"layers: is a Scene; give analytic_layers\(scene\) or render_gl"),
        ({"layers": "layers.exr"}, r"layers: 'layers.exr' is a path; give render_gl.read_layers"),
        ({"layers": None}, r"layers: is of type NoneType; give Layers"),
        ({"look": "look"}, r"look: 'look' is a name; give 'auto', or find_look\('look'\)\(\)"),
        ({"response": 2.2}, r"response: is of type float; give a Response"),
        ({"response": [Response()] * 2}, r"got 2 responses for 1 photos"),
        ({"free": 3}, r"free: is 3; give names, such as"),
        ({"free": [3]}, r"free: 3 is no parameter; choose from"),
        ({"bounds": {"shadow": 1}}, r"bounds: shadow has 1; give two numbers, \(lower, upper\)"),
        ({"bounds": {"shadow": "01"}}, r"bounds: shadow has '01'; give two numbers"),
        ({"bounds": {"shadow": (0, 1, 2)}}, r"bounds: shadow has \(0, 1, 2\); give two"),
        ({"bounds": {"shadow": (None, 1)}}, r"bounds: shadow has \(None, 1\); give two"),
        (
            {"bounds": {"shadow": (0, 10**400)}},
            r"bounds: shadow has \(0, a number of about 400 digits\); give",
        ),
        ({"bounds": [("shadow", 0, 1)]}, r"bounds: is \[\('shadow', 0, 1\)\]; give a dict"),
        ({"bounds": {3: (0, 1)}}, r"bounds: is \{3: \(0, 1\)\}; give a dict"),
        ({"priors": {"shadow": 0.2}}, r"priors: shadow has 0.2; give two numbers, \(mean, st"),
        ({"tied": {"shadow": 3}}, r"tied: shadow is tied to 3; give the name"),
        ({"tied": "shadow"}, r"tied: is 'shadow'; give a dict of name → name"),
        ({"max_steps": 0}, r"max_steps: is 0; give a whole number, 1 to 1,000,000"),
        ({"max_steps": 2.5}, r"max_steps: is 2.5; give a whole number"),
        ({"solver": None}, r"solver: None is unknown; choose"),
        ({"solver": ["lm"]}, r"solver: \['lm'\] is unknown; choose"),
        ({"loss": 3}, r"loss: 3 is unknown; choose"),
        ({"jpeg": None}, r"jpeg: None is unknown; choose"),
        ({"sampling": 1}, r"sampling: 1 is unknown; choose"),
        ({"where": 1}, r"where: 1 is unknown; choose"),
    ],
)
def test_slips_are_named(given: Any, told: str, photo: np.ndarray, layers: Layers) -> None:
    with pytest.raises(InputError, match=told) as caught:
        fit(**({"photo": photo, "layers": layers} | given))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


def test_layers_of_what_a_gradient_is_asked_for_are_refused(
    photo: np.ndarray, layers: Layers
) -> None:
    def loss(height: jax.Array) -> Any:
        case = scene()
        air = Atmosphere(height)
        traced = analytic_layers(Scene(case.camera, case.planet, air, case.sun))
        return fit(photo, traced, START).look.brightness

    with pytest.raises(InputError, match=r"layers are traced; make them outside of jit"):
        jax.grad(loss)(0.2)
