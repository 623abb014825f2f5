"""Our compiler options are a shorter wait where XLA knows them, and nothing else."""

import jax.numpy as jnp
import numpy as np
import pytest

from fit import _compile


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
    monkeypatch.setattr(_compile, "_options", lambda: asked.append(1) or {})
    sine = _compile.program(jnp.sin)
    assert not asked
    assert float(sine(jnp.float32(0))) == 0
    assert asked
