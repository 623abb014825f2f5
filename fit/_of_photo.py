"""What a fit says of one photo: which pixels it used, how well they are explained, where its limb
lies beside the scene's."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from model_jax import Response


@dataclass(frozen=True)
class Alignment:
    """Where a photo's limb lies beside the scene's."""

    outward: float
    right: float
    down: float
    """Change of its radius, and shift, px."""
    stderr: tuple[float, float, float]
    """Of the three, px: large where only part of the limb is lit, for then none stands alone."""
    scale: float
    """How many times as large as the scene's the photo's planet is."""
    off: float
    """Root mean square distance of the two limbs where they are seen, px."""
    rms: float
    """The same once the scene's is at its place, px."""
    edges: int
    """Places along the limb where it is seen."""

    @property
    def place(self) -> tuple[float, float, float]:
        """Outward, to the right, downward."""
        return self.outward, self.right, self.down

    def to_dict(self) -> dict[str, Any]:
        """Its part of `fit.json`."""
        return vars(self) | {"stderr": list(self.stderr)}


@dataclass(frozen=True)
class PhotoResult:
    """What one photo had to say."""

    used: Bool[np.ndarray, "h w"]
    """Which pixels were used."""
    excluded: dict[str, int]
    """Reason → pixels, each pixel once."""
    clipped: int
    """Samples, of three to a used pixel, that tell a bound only: at the highest or lowest code."""
    residual_rms: float
    """Over measured samples, linear light; NaN without data."""
    explained: float | None
    """1 - Σ(y - ŷ)² / Σ(y - mean of the channel)² over all used pixels and channels, linear light,
    dark codes included; without what a robust loss dismissed as no light of the air. None without
    variance."""
    structure: float | None
    """Root mean square of what is left over and hangs together, over that of what the air changes
    in the picture; None without air."""
    response: Response
    """The fitted one."""
    mix: Float[np.ndarray, "3 3"] | None
    """What each channel of a grey photo shows of red, green and blue; else None."""
    width_unit: float
    """Scene length that widths of these layers are divided by (far - near)."""
    alignment: Alignment | None = None
    """Of its limb; None where none is seen."""

    @property
    def measured(self) -> int:
        """Samples that tell their light: neither clipped nor copies."""
        channels = 3 if self.mix is None else len(np.unique(self.mix, axis=0))
        return channels * int(self.used.sum()) - self.clipped

    @property
    def pixels(self) -> dict[str, Any]:
        """`{"used", "total", "excluded"}`; used and excluded add up to total."""
        return {
            "used": int(self.used.sum()),
            "total": int(self.used.size),
            "excluded": dict(self.excluded),
            "clipped_samples": self.clipped,
        }
