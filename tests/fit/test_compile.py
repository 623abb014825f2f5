"""Compiler options are a shorter wait where XLA knows them; a caller's settings are no matter."""

import os
import subprocess
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from fit import _compile

from .looks import TRUTH


def test_a_program_computes_what_it_is_made_of() -> None:
    scaled = _compile.program(lambda x, factor, square: x * factor**2 if square else x * factor)
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(scaled(x, 3.0, True), 9 * np.arange(3.0))
    np.testing.assert_array_equal(scaled(x, 3.0, False), 3 * np.arange(3.0))


def test_the_locked_xla_knows_the_options() -> None:
    assert _compile._options() == _compile.SHORT_WAIT


def test_an_xla_that_does_not_know_them_goes_without(monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = {"xla_cpu_of_another_version": False}
    monkeypatch.setattr(_compile, "SHORT_WAIT", unknown)
    asked = _compile._options.__wrapped__
    assert asked() == {}
    monkeypatch.setattr(_compile, "_options", asked)
    assert float(_compile.program(lambda x: x + 1)(jnp.float32(1))) == 2


def test_importing_starts_no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    """`JAX_PLATFORMS` and the like may still be set after `import fit`: a device is asked for its
    options by the first call."""
    asked = []

    def options() -> dict[str, bool]:
        asked.append(1)
        return {}

    monkeypatch.setattr(_compile, "_options", options)
    sine = _compile.program(jnp.sin)
    assert not asked
    assert float(sine(jnp.float32(0))) == 0
    assert asked


@pytest.mark.parametrize(
    ("traced", "variable"),
    [
        pytest.param(False, "JAX_DEBUG_NANS", marks=pytest.mark.full),
        (True, "JAX_ENABLE_X64"),
        pytest.param(False, "JAX_ENABLE_X64", marks=pytest.mark.full),
        pytest.param(True, "JAX_DEBUG_NANS", marks=pytest.mark.full),
    ],
)
def test_settings_of_jax_are_no_matter(variable: str, traced: bool) -> None:
    """In processes of their own, as a user sets them; a float32 photo with noise."""
    program = f"""
import jax, numpy as np
from fit import fit
from model_jax import analytic_layers
from tests.fit.looks import START, TRUTH, picture, scene
layers = analytic_layers(scene())
clean = picture(layers, TRUTH)
photo = np.float32(clean + np.random.default_rng(0).normal(scale=0.02, size=clean.shape))
fitted = jax.jit(lambda p: fit(p, layers, START).look) if {traced} else (
    lambda p: fit(p, layers, START, sampling="point").look)
print(float(fitted(photo).brightness))
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        check=False, capture_output=True, text=True, timeout=300,
        env=os.environ | {variable: "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) == pytest.approx(TRUTH.brightness, abs=0.02)
