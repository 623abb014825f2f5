"""Is there air at all? A planet without air, blurred by the camera, as the rival of one with.

    light, planet, used ──> bare limb ───────┐
                 widths ──> bare limb + air ─┴──> ΔBIC, and how much more of the light it explains

A camera spreads the disc's light over its edge, and a scene is aligned to a photo to a pixel or
so: both put light where air would be. The bare limb is the photo's own disc, continued outward and
ended by a blurred edge. Blur neither makes light nor colours it, so the disc's light comes in its
own colour; only the edge's place and width are free, and how the light goes on toward it. Air comes
on top of that: a planet with air is seen by the same camera, so its limb leaks into the ring too.
It fills the shell evenly or thins out from the edge on.

A bare limb is not exact: a sun that is low cuts it off, its light may change within the blur. What
air explains beside that has to be more than such errors are, or air cannot be told from them.

NumPy; knows nothing of looks and solvers.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from ._edge import BLUR, BLUR_PX, HALO, MAX_HALO, PARAMETERS, SHARP_PX
from ._effective import effective_samples
from ._limb import Light, Place, glows, limb_of, near_limb, outline_of
from ._limb_fit import (
    Air,
    Beside,
    LimbModel,
    air_of,
    best_limb,
    light_beside,
    no_air,
    residual_of,
)
from ._thin_air import Shell, shell_of

_TINY = float(np.finfo(np.float64).tiny)

EVIDENCE = 10.0
"""Least ΔBIC that tells air: "very strong", odds of 150 to 1 (Kass & Raftery 1995, J. Am. Stat.
Assoc. 90, 773, §3.2 and 4.1.3)."""

NO_BARE_LIMB = 0.999
"""Share of the light's variance that no shell explains of a bare limb. A straight edge blurred by a
Gaussian, a shell's width that falls as the root of the distance from its top, and a sky level agree
to 0.9980 at most, whatever blur, place, height and lit share of the limb (0.9955 if all is lit)."""

HEIGHTS_PX = (None, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Scale heights of air that are tried; None is one density within the shell."""
_SEEN = 6.0
"""Scale heights beyond which air is dark: a four-hundredth of its light."""
_LEAST_REACH = 0.1
"""Of a shell that ends within the photo's limb, px."""
_AGAIN = 3
_LESS = 0.01
"""How often air is laid on the edge anew, and what it must gain for another time."""

LEAST_SHARE = 0.1
"""Share of what a bare limb leaves that air must explain to be worth the question."""
FRINGE_PX, COMMON = 0.3, 0.6
"""How far a lens lays channels beside each other, and the share of thin air's light, as a shift of
the edge, from which all channels have it: of the Moon's limb, the red a third of a pixel farther
out, it is a half, of EPIC's air 0.86 and more."""
CLEAR, CLEAR_THIN, CLEAR_BLURRED = 0.12, 0.35, 0.5
"""Share from which air is told: where the limb is resolved; where it is not, or the air is thinner
than `THIN_PX`; and where the shell is within the blur's reach."""
WHITE = 0.9
"""Share of samples that are independent from which what is left over is white noise."""
THIN_PX = 1.0
"""Scale height up to which air looks like the edge itself."""
EVEN = 4.0
"""How many scale heights high a shell of one density is that looks as air that thins out."""
WITHIN_BLURS, WITHIN_WIDE_BLURS = 4.0, 9.0
"""How many blurs high a shell must be to reach out of the edge's own light, where that is resolved,
and where it is not: the wider a blur, the less is known of its tail."""


@dataclass(frozen=True)
class AirEvidence:
    """The comparison of the two."""

    bare: LimbModel
    shell: LimbModel
    samples: int
    """Three of each pixel."""
    samples_effective: float
    """As many independent ones tell as much, by what air leaves over."""
    delta_bic: float
    """BIC(bare) − BIC(shell)."""
    explained: float
    """Share of what the bare limb leaves over that air explains."""
    reach_px: float
    """How far beyond the limb the shell goes; 0 where no limb is lit beside it."""
    air: Float[np.ndarray, "3"]
    """The light at the limb of air that thins out, else that of its width's unit."""
    disc: Float[np.ndarray, "3"]
    """The disc's light where it is brightest beside the limb."""
    glows: bool
    """The bare limb needs a sky that is brighter beside it than beyond: a ring of even light."""

    @property
    def has_air(self) -> bool:
        return self.glows or self.is_told

    @property
    def is_told(self) -> bool:
        """By more light where there is more air."""
        return self.is_evident and self.explained >= self.needed

    @property
    def is_evident(self) -> bool:
        """Noise does not look like this, nor a lens's errors; the limb's own errors may."""
        return self.delta_bic > EVIDENCE and not self.is_fringe

    @property
    def is_fringe(self) -> bool:
        """Thin air in some channels more than in others, as a lens makes of a limb."""
        height = self.shell.height_px
        if height is None or height > THIN_PX or self.explained >= CLEAR_THIN:
            return False
        shift = self.air * height / np.maximum(self.disc, 1e-3 * self.disc.max() + _TINY)
        return bool(shift.min() < COMMON * shift.max() and np.ptp(shift) <= FRINGE_PX)

    @property
    def by_glow(self) -> bool:
        """Nothing but the ring's even light tells air."""
        return self.glows and not self.is_told

    @property
    def is_open(self) -> bool:
        """Neither air nor none can be told."""
        worth = self.explained >= LEAST_SHARE or self.is_all
        return self.is_evident and worth and not self.has_air

    @property
    def needed(self) -> float:
        """Share that air must explain to be told; of no limb's errors none."""
        if not self.reach_px or (self.is_all and self.is_resolved):
            return 0.0
        if self.is_within_blur and not self.is_at_limits:
            return CLEAR_BLURRED
        return CLEAR if self.is_resolved else CLEAR_THIN

    @property
    def is_all(self) -> bool:
        """Beside air there is nothing but noise, which hides a limb's errors as well."""
        return self.samples_effective >= WHITE * self.samples

    @property
    def is_resolved(self) -> bool:
        """Air and edge are told apart by their shapes."""
        wide = self.shell.blur_px <= SHARP_PX and not self.is_within_blur
        return wide and not self.is_thin

    @property
    def is_within_blur(self) -> bool:
        """The edge's own light covers the ring."""
        return self.reach_px < self.reach_needed_px

    @property
    def is_at_limits(self) -> bool:
        """Blur and halo are the widest allowed: what they stand for is no edge."""
        edge = self.shell.edge
        return bool(edge[BLUR] >= np.log(0.99 * BLUR_PX[1]) and edge[HALO] >= 0.99 * MAX_HALO)

    @property
    def reach_needed_px(self) -> float:
        """How high the shell must be for that."""
        blur = self.shell.blur_px
        return blur * (WITHIN_BLURS if blur <= SHARP_PX else WITHIN_WIDE_BLURS)

    @property
    def finer(self) -> float:
        """How many times as fine a picture would have to be for a clear answer."""
        within = self.reach_needed_px / max(self.reach_px, _LEAST_REACH)
        return max(within, self.shell.blur_px / SHARP_PX, 2 * THIN_PX / max(self.height_px, 1e-3))

    @property
    def is_thin(self) -> bool:
        return self.height_px <= THIN_PX

    @property
    def height_px(self) -> float:
        """Scale height of the air; of one density, that of the shell's edge."""
        return self.shell.height_px or self.reach_px / EVEN


def find_air(
    light: Light,
    planet: Bool[np.ndarray, "h w"],
    used: Bool[np.ndarray, "h w"],
    widths: Sequence[Float[np.ndarray, "h w"]],
    place: Place = (0.0, 0.0, 0.0),
    sky: Bool[np.ndarray, "h w"] | None = None,
) -> AirEvidence:
    """Does air explain what a bare limb, blurred by the camera, does not?

    Args:
        light: linear light; not finite where it is unknown, but finite in the used pixels.
        planet: where the planet ends the ray; may be empty.
        used: pixels to explain; those on the planet are left out.
        widths: of air, lit and shadowed (either may be missing), any unit, finite where used.
        place: of the photo's limb beside the planet's edge, as `limb_beside` finds it.
        sky: pixels beyond the air, if there are any.
    """
    used = used & ~planet
    widths = [width for width in widths if np.any(width[used])]
    if not used.any():
        nothing = LimbModel(
            0.0, PARAMETERS + 3, np.zeros(PARAMETERS), (0.0, 0.0, 0.0), np.zeros((0, 3))
        )
        return AirEvidence(
            nothing, nothing, 0, 1.0, 0.0, 0.0, 0.0, np.zeros(3), np.zeros(3), glows=False
        )
    outline = outline_of(planet)
    beside = light_beside(light, used, limb_of(light, planet, used, place, outline))
    limb, bare = beside.limb, best_limb(beside, no_air(beside), anew=True)
    within = _SEEN * max(h for h in HEIGHTS_PX if h is not None)
    ring = near_limb(planet, used, place, within, outline)
    best, columns = bare, list(widths)
    if widths:
        shell = shell_of(light, widths, ring, beside)
        search = _AirSearch(beside, air_of(light, used, widths, beside), shell, bare)
        rough = min((search.rough(height) for height in HEIGHTS_PX), key=lambda m: m.square_sum)
        laid = search.settled(rough)
        best = laid.model
        if best.height_px is not None:
            columns = shell.framed(shell.thinned(best.height_px, laid.edge), used.shape)
    samples = effective_samples(residual_of(light, used.shape[1], columns, limb, best), used, True)
    floor = float(np.finfo(np.float32).eps) ** 2 * beside.energy
    filled = ring[1][sum(np.ravel(width)[ring[0]] for width in widths) > 0] if widths else ring[1]
    reach = max(float(filled.max()), _LEAST_REACH) if len(filled) and limb.disc.any() else 0.0
    return AirEvidence(
        bare=bare,
        shell=best,
        samples=3 * int(used.sum()),
        samples_effective=samples,
        delta_bic=air_evidence(bare, best, samples, floor),
        explained=1 - max(best.square_sum, floor, _TINY) / max(bare.square_sum, floor, _TINY),
        reach_px=reach,
        air=_amplitude(best, columns, used),
        disc=np.percentile(limb.disc, 95, axis=0) if len(limb.disc) else np.zeros(3),
        glows=reach >= WITHIN_BLURS * bare.blur_px and glows(light, limb, bare.level, sky),
    )


@dataclass(frozen=True)
class _AirSearch:
    """Bare limbs with air on them."""

    beside: Beside
    even: Air
    """Of one density."""
    shell: Shell
    bare: LimbModel

    def rough(self, height: float | None) -> "_Laid":
        """About the best of one scale height, laid first where the photo's edge is, then where the
        bare limb's is: that one has swallowed thin air, or the first was air's own."""
        if height is None:
            return self._lay(None, self.bare.edge, [self.bare.edge], rough=True, anew=True)
        found = []
        for edge in (np.zeros(PARAMETERS), self.bare.edge):
            laid = self._lay(height, edge, [self.bare.edge], rough=True, anew=True)
            for _ in range(_AGAIN):
                again = self._lay(height, laid.model.edge, [laid.model.edge], rough=True)
                if not again.square_sum < (1 - _LESS) * laid.square_sum:
                    break
                laid = again
            found.append(laid)
        return min(found, key=lambda laid: laid.square_sum)

    def settled(self, laid: "_Laid") -> "_Laid":
        """The best from there on, of all pixels."""
        height, begin = laid.model.height_px, [laid.model.edge, self.bare.edge]
        best = self._lay(height, laid.edge, begin)
        again = self._lay(height, best.model.edge, [best.model.edge])
        return min(best, again, key=lambda laid: laid.square_sum)

    def _lay(
        self,
        height: float | None,
        edge: Float[np.ndarray, "8"],
        begin: Sequence[Float[np.ndarray, "8"]],
        rough: bool = False,
        anew: bool = False,
    ) -> "_Laid":
        """The best model with air on an edge."""
        shell, air = self.shell, self.even
        if height is not None:
            air = shell.air(height, edge, self.beside)
        return _Laid(best_limb(self.beside, air, begin, height, rough, anew), edge)


@dataclass(frozen=True)
class _Laid:
    """A limb with air that was laid on an edge, which need not be its own."""

    model: LimbModel
    edge: Float[np.ndarray, "8"]

    @property
    def square_sum(self) -> float:
        return self.model.square_sum


def _amplitude(
    model: LimbModel, columns: Sequence[Float[np.ndarray, "h w"]], used: Bool[np.ndarray, "h w"]
) -> Float[np.ndarray, "3"]:
    """Light of each channel per light of the columns together, as root mean squares."""
    found = np.zeros(3)
    if len(model.widths):
        parts = np.stack([column[used].astype(np.float64) for column in columns])
        whole = float((parts.sum(axis=0) ** 2).sum())
        found = np.sqrt(((parts.T @ model.widths) ** 2).sum(axis=0) / max(whole, _TINY))
    return np.asarray(found)


def air_evidence(bare: LimbModel, shell: LimbModel, samples: float, floor: float = 0.0) -> float:
    """BIC(bare) − BIC(shell), BIC = samples · log(square sum) + parameters · log(samples).

    Schwarz 1978, Ann. Stat. 6, 461, for errors of equal unknown variance. Square sums below `floor`
    count as `floor`: the rounding of the photo tells nothing.
    """
    ratio = max(bare.square_sum, floor, _TINY) / max(shell.square_sum, floor, _TINY)
    more = shell.parameters - bare.parameters
    return float(samples * np.log(ratio) - more * np.log(samples))
