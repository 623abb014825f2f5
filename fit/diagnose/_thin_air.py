"""Air that thins out from a limb's edge on.

    widths of air near the limb, scale height, edge ──> columns of light

NumPy and SciPy.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.special import erfcx

from ._edge import BLUR, SHARP_PX, SHIFT
from ._limb import Light
from ._limb_fit import Air, Beside, air_at


@dataclass(frozen=True)
class Shell:
    """Used pixels near the limb, where air may thin out."""

    index: Int[np.ndarray, " m"]
    distance: Float[np.ndarray, " m"]
    turn: Float[np.ndarray, "m 5"]
    """All three as `near_limb` has them."""
    light: Float[np.ndarray, "m 3"]
    """Less the mean of all used pixels."""
    shares: Float[np.ndarray, "m c"]
    """Of lit and of shadowed air."""
    at_limb: Int[np.ndarray, " n"]
    """Which of these each of the limb's pixels is; -1 where it is none."""

    def thinned(self, height: float, edge: Float[np.ndarray, "8"]) -> Float[np.ndarray, "m c"]:
        """Light of air that thins out from an edge on, blurred as that is, lit as widths are.

        The exponential exp(-x / H) beyond an edge, convolved with a Gaussian, is
        ½ exp(-x² / 2σ²) erfcx((σ / H - x / σ) / √2).
        """
        # A blur wider than that of a resolved limb may be air's, taken for blur.
        away, blur = self.distance - self.turn @ edge[SHIFT], min(np.exp(edge[BLUR]), SHARP_PX)
        slant = (blur / height - away / blur) / np.sqrt(2)
        # Far outside, erfcx of a negative number is 2 exp(slant²), and the product an exponential.
        near = 0.5 * np.exp(-0.5 * (away / blur) ** 2) * erfcx(np.maximum(slant, -5.0))
        far = np.exp(0.5 * (blur / height) ** 2 - np.maximum(away, 0.0) / height)
        return self.shares * np.where(slant > -5.0, near, far)[:, None]

    def air(self, height: float, edge: Float[np.ndarray, "8"], beside: Beside) -> Air:
        """The same as a fit needs it."""
        return air_at(self.thinned(height, edge), self.light, self.at_limb, beside)

    def framed(
        self, columns: Float[np.ndarray, "m c"], shape: tuple[int, ...]
    ) -> list[Float[np.ndarray, "h w"]]:
        """Columns as large as the photo."""
        found = []
        for column in columns.T:
            frame = np.zeros(shape, np.float32)
            frame.reshape(-1)[self.index] = column
            found.append(frame)
        return found


def shell_of(
    light: Light,
    widths: Sequence[Float[np.ndarray, "h w"]],
    ring: tuple[Int[np.ndarray, " m"], Float[np.ndarray, " m"], Float[np.ndarray, "m 5"]],
    beside: Beside,
) -> Shell:
    """The ring that `near_limb` found, with the light and the widths of its pixels."""
    index, distance, turn = ring
    height, width = np.shape(widths[0])
    seen = light[np.divmod(index, width)].astype(np.float64) - beside.mean
    parts = np.stack([np.ravel(one)[index].astype(np.float64) for one in widths])
    total = parts.sum(axis=0)
    number = np.full(height * width, -1, np.int32)
    number[index] = np.arange(len(index))
    return Shell(
        index,
        distance,
        turn,
        np.asfortranarray(seen),
        (parts / np.where(total > 0, total, 1.0)).T,
        number[beside.limb.index],
    )
