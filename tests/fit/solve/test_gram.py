"""The exact pass is a residual like any other: optimistix's own solvers run on it as they are."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

from fit.photo._columns import take_columns
from fit.photo._pixels import choose_pixels
from fit.solve._declare import declare
from fit.solve._descend import Atlas, Pass
from fit.solve._gram import compressed
from fit.solve._layout import Layout
from fit.solve._loss import Loss
from fit.solve._model import Model
from fit.solve._parameters import chart, to_entries
from fit.solve._samples import to_samples
from model_jax import Layers, LayersLook, Response, composite
from tests.fit.looks import TRUTH, picture

SOLVERS: dict[str, Any] = {
    "dogleg": optx.Dogleg(rtol=1e-12, atol=1e-12),
    "lm": optx.LevenbergMarquardt(rtol=1e-12, atol=1e-12),
    "bfgs": optx.BFGS(rtol=1e-12, atol=1e-12),
}


@pytest.mark.parametrize("name", SOLVERS)
def test_optimistix_solves_the_tiled_pass(name: str, layers64: Layers, x64: None) -> None:
    """Brightness, shadow and background over six tiles: SciPy's optimum over all pixels."""
    photo = picture(layers64, TRUTH)
    photo = photo + np.random.default_rng(5).normal(scale=0.02, size=photo.shape)
    pixels = choose_pixels(photo, layers64)
    columns = take_columns(photo, layers64, pixels.used, float(layers64.width_unit))
    samples = jax.tree.map(jnp.asarray, to_samples([columns], tile=len(columns.index) // 5))
    assert int(samples.used) == 6
    start = LayersLook(2.0, 0.4, TRUTH.tint)
    parameters = declare(start, [Response()], free=["brightness", "shadow", "background"])
    free = [p for p in parameters if p.role == "free"]
    here = chart(to_entries(parameters), free, parameters)
    whiten = jnp.eye(len(here.start))
    known = {k: jnp.asarray(v) for k, v in vars(here).items() if k != "shares"}
    atlas = Atlas(**known, whiten=whiten, shares=here.shares)
    model = Model(Loss("linear"), None, Layout(LayersLook), True)
    whole = Pass(atlas, samples, model, jnp.asarray(1.0))
    solution: optx.Solution = optx.least_squares(
        compressed, SOLVERS[name], jnp.zeros_like(here.start), whole, max_steps=500, throw=False
    )
    found = atlas.entries(solution.value)

    def residual(x: np.ndarray) -> np.ndarray:
        look = LayersLook(x[0], x[1], TRUTH.tint, background=x[2])
        return np.ravel((np.asarray(composite(layers64, look))[..., :3] - photo)[pixels.used])

    best = scipy.optimize.least_squares(residual, [2.0, 0.4, 0.0], xtol=1e-12, ftol=1e-12).x
    # SciPy's slopes are differences: good to 1e-8 of the numbers, of order one.
    np.testing.assert_allclose([found[0], found[1], found[7]], best, rtol=0, atol=1e-6)
