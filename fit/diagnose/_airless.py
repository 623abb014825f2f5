"""Does each photo show air: yes, no, or not to be told at its resolution?

Asked of every fit whose layers know a planet, of the light beside the planet's edge alone: a bare
limb that a camera blurs looks much like thin air, and any look will fit it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from model_jax import Layers

from .._of_photo import PhotoResult
from .._result import LeftOut
from .._verdict import WELL_EXPLAINED
from ..photo._columns import Columns, as_picture, fields_at, take_columns
from ..photo._photo import Photo
from ..photo._pixels import Pixels
from ..photo._widths import with_shadows
from ..solve._task import Task
from ._alignment import known_pixels, misaligned
from ._bare_limb import EVIDENCE, NO_BARE_LIMB, AirEvidence, find_air
from ._evidence import BELIEVED, Evidence, explained_share
from ._remarks import percent
from ._residuals import left_over_of


@dataclass(frozen=True)
class Answers:
    """Of each photo in words; None where it shows air."""

    none: tuple[str | None, ...]
    """Why it shows none."""
    open: tuple[str | None, ...]
    """Why it cannot be told."""
    doubts: tuple[str, ...]
    """What is doubtful where there is some."""

    @property
    def is_open(self) -> bool:
        """No photo shows air, and one does not tell whether there is some."""
        both = [no or maybe for no, maybe in zip(self.none, self.open, strict=True)]
        return all(both) and any(self.open)

    def left_out(self) -> list[LeftOut]:
        """The question, where it has no answer."""
        what = "whether there is air"
        return [
            LeftOut(f"{what}, photo {number}" if len(self.open) > 1 else what, why)
            for number, why in enumerate(self.open, 1)
            if why
        ]

    def warnings(self) -> list[str]:
        """What has to be said beside the verdict."""
        for_some = [
            f"Photo {number}: {why}. Leave it out, or check its alignment and exposure."
            for number, why in enumerate(self.none, 1)
            if why
        ]
        return [*self.doubts, *for_some]


def ask_for_air(
    task: Task,
    pixels: Sequence[Pixels],
    columns: Sequence[Columns],
    evidence: Evidence | None,
    photos: Sequence[PhotoResult],
) -> Answers:
    """Whether each photo shows air.

    Asked only where the look leaves more of the light unexplained than `NO_BARE_LIMB`: the question
    costs seconds. A share that holds the planet's surface tells less, and so does the ring
    beside it: `WELL_EXPLAINED` is enough there. Edges tell a bare limb from air best and count
    here; where a look explains so much of them and of the rest, it does of all.
    """
    none: list[str | None] = [None] * len(task.photos)
    maybe: list[str | None] = [None] * len(task.photos)
    doubts: list[str] = []
    if not any(_shows_planet(layers) for layers in task.layers):
        return Answers(tuple(none), tuple(maybe), ())
    unit = float(task.layers[0].width_unit)
    beside = [
        take_columns(photo, layers, px.edges, unit, type(task.look))
        for photo, layers, px in zip(task.photos, task.layers, pixels, strict=True)
    ]
    shares = zip(photos, _shares(beside, evidence), strict=True)
    for number, (one, of_edges) in enumerate(shares):
        layers = task.layers[number]
        enough = NO_BARE_LIMB if layers.surface is None else WELL_EXPLAINED
        explained = all(
            share is not None and share >= enough for share in (one.explained, *of_edges)
        )
        if explained or not _shows_planet(layers):
            continue
        # In the ring alone: of how much of the sky a fit uses the answer must not depend.
        used = (pixels[number].used | pixels[number].edges) & np.asarray(layers.has_air)
        if task.loss != "linear" and evidence is not None:
            used &= ~(evidence.weights()[number] <= BELIEVED)
        if not (used & (np.asarray(layers.planet) == 0)).any():
            continue  # nothing beyond the limb, which a bare one could explain
        index = np.concatenate([columns[number].index, beside[number].index])
        air = _ask(task, number, used, index, one)
        if air.is_open:
            maybe[number] = _why_open(air)
        elif not air.has_air:
            off = misaligned(one.alignment)
            none[number] = _why_none(air) + (f"; the scene is misaligned: {off}" if off else "")
        elif air.by_glow:
            which = f" of photo {number + 1}" if len(task.photos) > 1 else ""
            doubts.append(
                f"The ring{which} is brighter than the sky beyond it, but not brighter where there "
                "is more air: check the alignment, and mask what is no air."
            )
    return Answers(tuple(none), tuple(maybe), tuple(doubts))


def _ask(
    task: Task,
    number: int,
    used: Bool[np.ndarray, "h w"],
    index: Int[np.ndarray, " n"],
    of: PhotoResult,
) -> AirEvidence:
    """The light beside one photo's limb, held against a bare one.

    Args:
        index: flat, of the pixels whose widths are needed.
    """
    photo, layers = task.photos[number], task.layers[number]
    planet = np.asarray(layers.planet) != 0
    widths = []
    unit = float(task.layers[0].width_unit)
    shaded = with_shadows(task.given[number])
    for field in fields_at(shaded, index, unit, ("lit", "dark")).values():
        full = np.zeros(np.shape(layers.front), np.float32)
        full.reshape(-1)[index] = field
        widths.append(full)
    return find_air(
        photo if isinstance(photo, Photo) else as_picture(photo),
        planet,
        used,
        widths,
        (0.0, 0.0, 0.0) if of.alignment is None else of.alignment.place,
        known_pixels(photo) & ~planet & ~np.asarray(layers.has_air),
    )


def _why_none(air: AirEvidence) -> str:
    more = percent(max(air.explained, 0.0))
    beside = (
        f"no atmosphere shows: the planet's bare limb, blurred by {air.bare.blur_px:.1f} px, "
        "explains the light beyond it"
    )
    if air.delta_bic <= EVIDENCE:
        return (
            f"{beside} as well (the air's ΔBIC is {air.delta_bic:.0f}, needed are more than "
            f"{EVIDENCE:.0f})"
        )
    if air.is_fringe:
        return (
            f"{beside} but for a fringe of colour, as a lens makes of a limb: air explains {more} "
            "of what is left over, in some channels more than in others"
        )
    return f"{beside} nearly as well: air explains {more} of what is left over"


def _why_open(air: AirEvidence) -> str:
    return (
        f"beside the planet's bare limb, blurred by {air.shell.blur_px:.1f} px, air explains "
        f"{percent(air.explained)} of what is left over, and up to {percent(air.needed)} the "
        f"limb's own errors may; pixels, and the blur with them, {air.finer:.1f} times as fine "
        "would tell"
    )


def _shows_planet(layers: Layers) -> bool:
    """The layers know a planet, whose limb can be held against air."""
    return layers.planet is not None and bool(np.any(layers.planet))


def _shares(columns: Sequence[Columns], evidence: Evidence | None) -> list[list[float | None]]:
    """What a fit explains of the light of other pixels; nothing is said of none."""
    if evidence is None or not any(len(c.index) for c in columns):
        return [[] for _ in columns]
    left = left_over_of(evidence.problem.beside(columns), evidence.point.vector)
    loss = evidence.problem.model.loss
    return [
        [explained_share(c.light, residual, loss)] if len(c.index) else []
        for c, residual in zip(columns, left, strict=True)
    ]
