"""What a fit says of the terms that it chose (`_auto`)."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TermChoice:
    """A term of a look, and why the photo's light is told with it or without."""

    term: str
    taken: bool
    delta_bic: float | None
    """Extended BIC of the terms without it less that with it, at the effective sample size, light
    that is not worth a term uncounted (`_auto`): above 0 for it.
    Of what is taken beside all others that are; of what is not when it was left out. None where it
    was not compared."""
    parameters: tuple[str, ...]
    """That it brings, by their names in the look."""
    meaning: str
    """What it does, without a full stop."""
    why: str = ""
    """Why it was not compared, if it was not; or with which terms."""


@dataclass(frozen=True)
class Selection:
    """How the terms of a look were chosen."""

    terms: tuple[TermChoice, ...]
    samples: int
    """Measured samples that were looked at."""
    effective_samples: float
    """Samples that tell as much if they were independent."""

    @property
    def taken(self) -> tuple[str, ...]:
        return tuple(choice.term for choice in self.terms if choice.taken)
