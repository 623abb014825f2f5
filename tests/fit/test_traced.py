"""The fit inside JAX's transformations, and its derivatives against refits.

One stack of photos and one set of layers serve most tests, so that JAX compiles once.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fit import FitResult, TracedFit, Verdict, _traced, fit
from fit.solve import _polish, _search
from model_jax import InputError, Layers, LayersLook, Response, analytic_layers

from .looks import START, TRUTH, picture, scene

NOISE = 0.02


@pytest.fixture(scope="module")
def stack(layers: Layers) -> np.ndarray:
    """Three photos of the small scene, and a black one."""
    rng = np.random.default_rng(11)
    clean = picture(layers, TRUTH)
    noisy = [clean + rng.normal(scale=NOISE, size=clean.shape) for _ in range(3)]
    return np.stack([*noisy, np.zeros_like(clean)]).astype(np.float32)


@pytest.fixture(scope="module")
def fit_four(layers: Layers) -> Callable[[np.ndarray], TracedFit]:
    """Of four photos at once, compiled once for all tests."""
    return jax.jit(jax.vmap(lambda photo: fit(photo, layers, START)))


def test_vmap_over_photos_is_a_loop_over_fits(
    fit_four: Callable[[np.ndarray], TracedFit], layers: Layers, stack: np.ndarray
) -> None:
    """In float32, whose sums over 35,000 samples are good to about 1e-5 of a standard error's size.

    The bound is a tenth of a standard error: far above float32, far below what would matter.
    """
    many = fit_four(stack)
    assert isinstance(many, TracedFit)
    converged = int(Verdict.CONVERGED)
    assert many.verdict.tolist() == [converged] * 3 + [int(Verdict.NO_DATA)]
    assert np.isnan(np.asarray(many.covariance)[3]).all()
    for k in range(3):
        one = fit(stack[k], layers, START)
        assert many.names == one.correlation_names
        stderr = np.sqrt(np.diag(one.covariance))
        look = jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], many.look)
        values = [look.brightness, look.shadow, *look.tint, look.background]
        known = np.array([one.parameters[name].value for name in one.correlation_names])
        assert np.all(np.abs(np.array(values) - known) < 0.1 * stderr)
        # The same sandwich with blocks of another size: within a factor of the number of blocks.
        ratio = np.sqrt(np.diag(many.covariance[k])) / stderr
        assert np.all((ratio > 0.5) & (ratio < 2.0))


def test_a_bound_is_told_as_in_a_loop(
    fit_four: Callable[[np.ndarray], TracedFit], layers: Layers
) -> None:
    """A shadow that would have to be darker than black: the weight ends at 0, without an error."""
    some, more = (
        picture(layers, LayersLook(3.0, weight, TRUTH.tint, background=TRUTH.background))
        for weight in (0.2, 0.4)
    )
    noise = np.random.default_rng(3).normal(scale=NOISE, size=some.shape)
    photo = (some - 1.5 * (more - some) + noise).astype(np.float32)  # at a weight of -0.1
    known = fit(photo, layers, START, bounds={"background": (-1.0, 1.0)})
    assert known.verdict == "at_bound"
    traced = jax.tree.map(lambda of_four: of_four[0], fit_four(np.stack([photo] * 4)))
    assert int(traced.verdict) == Verdict.AT_BOUND
    assert float(traced.look.shadow) == pytest.approx(0, abs=1e-3)
    errors = dict(zip(traced.names, np.diag(traced.covariance), strict=True))
    assert [name for name, variance in errors.items() if np.isnan(variance)] == ["shadow"]
    stderr = known.parameters["brightness"].stderr
    assert float(traced.look.brightness) == pytest.approx(known.look.brightness, abs=0.1 * stderr)


def test_samples_that_are_not_finite_do_not_count(
    fit_four: Callable[[np.ndarray], TracedFit], layers: Layers, stack: np.ndarray
) -> None:
    broken = stack[0].copy()
    broken[20:40, 30:60] = np.nan
    traced = jax.tree.map(lambda of_four: of_four[3], fit_four(np.stack([*stack[1:], broken])))
    known = fit(broken, layers, START)
    assert int(traced.verdict) == Verdict.CONVERGED
    assert float(traced.look.shadow) == pytest.approx(float(known.look.shadow), rel=1e-4)


@pytest.fixture(scope="module")
def photo64(layers64: Layers) -> np.ndarray:
    with jax.enable_x64(True):
        clean = picture(layers64, TRUTH)
    return clean + np.random.default_rng(12).normal(scale=NOISE, size=clean.shape)


def central(value: Callable[[float], float], at: float, step: float) -> float:
    return (value(at + step) - value(at - step)) / (2 * step)


def test_derivative_by_pixels(layers64: Layers, photo64: np.ndarray) -> None:
    """JAX's gradient, the influence map and refits agree.

    The first two are the same formula twice: float64 rounding of sums over 35,000 samples, beside
    the largest derivative. A central difference with step h is off by the third derivative times
    h²/6: with a step of 5 % of the noise in one of 35,000 samples far below the 1e-5 allowed.
    """
    with jax.enable_x64(True):
        slope = jax.jit(jax.grad(lambda photo: fit(photo, layers64, START).look.shadow))
        by_photo = np.asarray(slope(jnp.asarray(photo64)))
    result = fit(photo64, layers64, START)
    influence = result.influence("shadow")
    largest = np.abs(influence).max()
    # The map is stored in float32.
    assert np.abs(by_photo - influence).max() <= 1e-6 * largest
    assert (influence[~result.used] == 0).all()
    strong = np.argwhere(np.abs(influence) > 0.5 * largest)
    for place in (tuple(strong[0]), tuple(strong[-1])):

        def refit(value: float, place: tuple[int, ...] = place) -> float:
            changed = photo64.copy()
            changed[place] = value
            return float(fit(changed, layers64, START).look.shadow)

        found = central(refit, float(photo64[place]), 1e-3)
        assert found == pytest.approx(float(influence[place]), rel=1e-5)


def test_derivative_by_what_is_fixed(layers64: Layers, photo64: np.ndarray) -> None:
    """By a background, a tint and an exposure that are held."""
    free = ("brightness", "shadow")

    def fitted(background: jax.Array, blue: jax.Array, exposure: jax.Array) -> jax.Array:
        look = LayersLook(1.0, 0.5, jnp.stack([0.8, 0.9, blue]), background=background)
        found = fit(photo64, layers64, look, free=free, response=Response(exposure)).look
        return jnp.stack([found.shadow, found.brightness])

    with jax.enable_x64(True):
        at = [jnp.asarray(value) for value in (0.01, 1.3, 1.1)]
        slopes = np.stack(jax.jit(jax.jacrev(fitted, argnums=(0, 1, 2)))(*at))

    def refit(**held: float) -> FitResult:
        values = {"background": 0.01, "blue": 1.3, "exposure": 1.1} | held
        look = LayersLook(1.0, 0.5, (0.8, 0.9, values["blue"]), background=values["background"])
        result = fit(photo64, layers64, look, free=free, response=Response(values["exposure"]))
        assert isinstance(result, FitResult)
        return result

    # Third derivatives are of the order of the values: h²/6 of them is below 1e-6.
    found = central(lambda b: float(refit(background=b).look.shadow), 0.01, 1e-3)
    assert slopes[0, 0] == pytest.approx(found, rel=1e-4)
    found = central(lambda b: float(refit(blue=b).look.shadow), 1.3, 1e-3)
    assert slopes[1, 0] == pytest.approx(found, rel=1e-4)
    found = central(lambda e: float(refit(exposure=e).look.brightness), 1.1, 1e-3)
    assert slopes[2, 1] == pytest.approx(found, rel=1e-4)


def test_too_few_steps_do_not_converge(
    layers: Layers, stack: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Traced or not, when what saves every descent is left out: the exact steps at the end, and
    the second opinion that becomes the first."""
    for module, name, steps in (
        (_traced, "_STEPS", 1),
        (_traced, "_NEWTON_STEPS", 1),
        (_traced, "WEIGHTS", ()),
        (_polish, "_FINISHES", 0),
        (_polish, "_FINISH_STEPS", 0),
        (_search, "_OPINIONS", 0),
    ):
        monkeypatch.setattr(module, name, steps)
    far = LayersLook(1.0, 30.0)
    traced = jax.jit(jax.vmap(lambda photo: fit(photo, layers, far)))(stack[:2])
    assert traced.verdict.tolist() == [int(Verdict.NOT_CONVERGED)] * 2
    assert np.isnan(np.asarray(traced.covariance)).all()
    assert fit(stack[0], layers, far, max_steps=1).verdict == Verdict.NOT_CONVERGED.label


def test_what_a_traced_photo_cannot_tell(layers: Layers, stack: np.ndarray) -> None:
    both = jax.jit(lambda photo: fit(photo, layers, START, free=("brightness", "exposure")))
    assert int(both(stack[0]).verdict) == Verdict.NOT_IDENTIFIABLE


def test_what_cannot_be_traced_is_an_error(layers: Layers, stack: np.ndarray) -> None:
    with pytest.raises(InputError, match="loss='linear'"):
        jax.jit(lambda photo: fit(photo, layers, loss="cauchy"))(stack[0])
    dark = analytic_layers(scene(sun=False))
    with pytest.raises(InputError, match="no shadow"):
        jax.jit(lambda photo: fit(photo, dark, START))(stack[0])
    with pytest.raises(InputError, match="layers are traced"):
        jax.jit(lambda photo, traced: fit(photo, traced, START))(stack[0], layers)
