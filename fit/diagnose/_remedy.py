"""Does the look match the photo; and if not, what would help here?"""

from model_jax import Look
from model_jax._composite import transmits
from model_jax._fields import PLACES

from .._of_photo import PhotoResult
from .._result import FitResult
from .._verdict import LEAST_EXPLAINED, MOST_STRUCTURE


def is_misfit(photo: PhotoResult) -> bool:
    """Less than half of the light is explained, or what is left over hangs together and is large
    beside the air's own light."""
    poor = photo.explained is not None and photo.explained < LEAST_EXPLAINED
    return poor or (photo.structure is not None and photo.structure > MOST_STRUCTURE)


def remedy_of(result: FitResult, kind: type[Look]) -> str:
    """What the plainest cause of the photo that matches least asks for, without a full stop.

    Of a look that knows no heights the first answer is air that thins out: no real air is a slab.
    Where terms were tried, others are no answer.
    """
    if not any(_hangs_together(photo) for photo in result.photos):
        return "what is left over is noise: use a photo with less of it, or several"
    worst = min(range(len(result.photos)), key=lambda k: _match(result.photos[k]))
    causes = [m.cause for m in result.misfits if m.photo == worst]
    uniform = not any(name in PLACES for name in kind.NEEDS)
    if result.selection is not None and result.selection.samples:
        return REMEDIES.get(causes[0] if causes else "", ELSE)
    if uniform and (not causes or causes[0] not in ("edges", "colour")):
        return "let the air thin out with height (--look air --terms density)"
    if causes and causes[0] in ("tone", "air") and not transmits(kind):
        return "let the air saturate (--look air --terms density,saturation)"
    return REMEDIES.get(causes[0] if causes else "", ELSE)


def _hangs_together(photo: PhotoResult) -> bool:
    return photo.structure is not None and photo.structure > LITTLE_STRUCTURE


LITTLE_STRUCTURE = 0.1
"""As `MOST_STRUCTURE`: up to a tenth of the air's light a look that explains little is right, and
the photo noisy."""

REMEDIES = {
    "tone": "check the photo's tone curve, or fit its gamma",
    "air": "check the shell's height, and the alignment of photo and layers",
    "vignette": "mask the part of the air that is lit otherwise, or correct the photo's vignette",
    "stray": "fit the background, or mask what shines into the picture",
    "edges": "check the alignment of photo and layers, or leave out the blurred limb by a mask",
    "colour": "fit what colours the air, or check the photo's white balance",
}
"""What helps against each cause (`_patterns.CAUSES`)."""

ELSE = "look at what is left over: shifted layers, or something in front of the air, such as clouds"


def _match(photo: PhotoResult) -> float:
    return -1.0 if photo.explained is None else photo.explained
