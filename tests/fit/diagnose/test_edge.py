"""A disc's blurred edge: against quadrature, against a drawn one, and its derivative."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.ndimage import gaussian_filter1d

from fit.diagnose._edge import (
    BLUR_PX,
    RISE,
    SHIFT,
    _blurred_root,
    _blurred_root_slope,
    disc_light,
    disc_slopes,
    within,
)
from fit.diagnose._limb import Limb


def limb(rng: np.random.Generator, distance: np.ndarray) -> Limb:
    angle = rng.uniform(0, 2 * np.pi, len(distance))
    right, down = np.cos(angle), np.sin(angle)
    turn = [np.ones_like(right), right, down, right**2 - down**2, 2 * right * down]
    return Limb(
        index=np.arange(len(distance)),
        distance=distance,
        turn=np.stack(turn, axis=-1),
        disc=rng.uniform(0.2, 1.0, (len(distance), 3)),
        slope=rng.normal(scale=0.1, size=(len(distance), 3)),
        root=rng.uniform(1.5, 3.0, len(distance)),
    )


@pytest.mark.parametrize("t", [-11.9, -3.0, 0.0, 2.0, 5.0])
def test_the_blurred_root_is_its_integral(t: float) -> None:
    """Interpolated in steps of a hundredth: a second derivative of 0.3 at most makes 4e-6."""

    def integral(power: int) -> float:
        kink = [np.sqrt(-t)] if t < 0 else None
        value, _ = quad(lambda u: u**power * np.exp(-0.5 * (u * u + t) ** 2), 0, 9, points=kink)
        return float(value / np.sqrt(2 * np.pi))

    value, slope = _blurred_root(np.array([t])), _blurred_root_slope(np.array([t]))
    assert value[0] == pytest.approx(2 * integral(2), abs=5e-6)
    assert slope[0] == pytest.approx(-integral(0), abs=5e-6)


def test_a_far_edge_is_sharp() -> None:
    """√(-t) less 1 / 8t² of it: 0.09 % at twelve standard deviations."""
    value = _blurred_root(np.array([-12.01, -11.99, 12.5]))
    assert value[0] == pytest.approx(value[1], rel=2e-3)
    assert value[2] == 0


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_disc_light_is_the_drawn_one(blur: float) -> None:
    """A disc whose light falls with the root of the depth, drawn a hundred times finer."""
    fine = np.arange(-60, 60, 0.01)
    drawn = np.where(fine < 0, 0.5 - 0.1 * np.sqrt(np.maximum(-fine, 0)), 0.0)
    seen = gaussian_filter1d(drawn, blur / 0.01)
    away = np.linspace(-3, 8, 23)
    made = Limb(
        index=np.arange(23),
        distance=away,
        turn=np.eye(5)[[0] * 23],
        disc=np.full((23, 3), 0.5 - 0.1 * 2.5),
        slope=np.full((23, 3), -0.1),
        root=np.full(23, 2.5),
    )
    p = np.array([np.log(blur), 0, 0, 0, 0, 0, 0, 1.0])
    # Steps of 0.01 px, and light that jumps by 0.5 within one.
    assert disc_light(made, p)[:, 0] == pytest.approx(np.interp(away, fine, seen), abs=0.005)


def test_slopes_are_derivatives(rng: np.random.Generator) -> None:
    """Central differences of 0.01: third derivatives of some units make 1e-4, the table less."""
    some = limb(rng, rng.uniform(-3, 9, 50))
    p = np.array([0.2, 0.5, -0.3, 0.2, 0.1, -0.4, 0.05, 0.7])
    slopes = np.stack(disc_slopes(some, p)[1], axis=1)
    for k in range(8):
        step = np.eye(8)[k] * 1e-2
        numeric = (disc_light(some, p + step) - disc_light(some, p - step)) / 2e-2
        assert slopes[..., k] == pytest.approx(numeric, abs=2e-4)


def test_within_keeps_edges_in_their_ranges() -> None:
    wide = within(np.array([9.0, 2, 3, 4, 1, 1, 0.5, -7]))
    assert np.exp(wide[0]) == pytest.approx(BLUR_PX[1])
    out, right, down, oval, slanted = wide[SHIFT]
    assert abs(out) + np.hypot(right, down) + np.hypot(oval, slanted) == pytest.approx(3)
    assert wide[6:] == pytest.approx([0.1, RISE[0]])
    fine = np.array([0.1, 0.2, -0.3, 0.1, 0, 0, 0.01, 1])
    assert within(fine) == pytest.approx(fine)
