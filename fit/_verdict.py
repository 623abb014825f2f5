"""How a fit ended, in a word, a sentence and a remedy; and the shares from which a fit warns.

A verdict is an integer code, so that it survives arrays; its sentence and its remedy live on the
host (`VERDICTS`).
"""

from enum import IntEnum


class Verdict(IntEnum):
    """How a fit ended."""

    CONVERGED = 0
    AT_BOUND = 1
    NOT_IDENTIFIABLE = 2
    NOT_CONVERGED = 3
    DIVERGED = 4
    NO_DATA = 5
    MISFIT = 6

    @property
    def label(self) -> str:
        """As in `FitResult.verdict` and `fit.json`: `converged`, `at_bound` …"""
        return self.name.lower()


VERDICTS: dict[Verdict, tuple[str, str]] = {
    Verdict.CONVERGED: ("The fit converged", ""),
    Verdict.AT_BOUND: (
        "The best fit lies at a bound",
        "check the alignment of photo and layers, the tone curve and the background, and mask what "
        "is no air",
    ),
    Verdict.NOT_IDENTIFIABLE: (
        "The photo cannot tell all that was asked",
        "hold what is named in left_out, or use a photo that shows it",
    ),
    Verdict.NOT_CONVERGED: (
        "The solver stopped before the best fit",
        "use solver 'lm' or allow more steps",
    ),
    Verdict.DIVERGED: (
        "The solver ran off to infinity",
        "use solver 'lm' and check the photo's values",
    ),
    Verdict.NO_DATA: (
        "There is nothing to fit",
        "check the mask, the alignment of photo and layers, and the exposure",
    ),
    Verdict.MISFIT: (
        "The look does not match the photo",
        "look at what is left over, and give the look what it lacks",
    ),
}
"""Sentence and remedy of each verdict, without full stops."""


LEAST_EXPLAINED = 0.5
"""Share of the light's variance below which a look does not match a photo: more of it is left over
than shown. And"""
MOST_STRUCTURE = 0.4
"""what is left over and hangs together, as a share of the air's light (root mean squares), above
which it does not either: nobody would take such pictures for the same."""

WELL_EXPLAINED = 0.9
"""Below this share of the variance the message points at the residual picture: a tenth of the light
left over is visible to the eye in it."""


MOST_CLIPPED = 0.05
"""Clipped samples for each measured one up to which what JPEG did can be undone: they do not show
the noise, and where most are clipped the tail that is not tells little of it."""

STRUCTURED_PX = 16.0
"""Correlation length of the residual, in pixels, from which the message warns: JPEG's largest
blocks are 16 pixels, and no sharp photo is blurred over as much; something is no noise there."""
