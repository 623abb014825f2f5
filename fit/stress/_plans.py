"""How much of the tables is made."""

from collections.abc import Sequence
from dataclasses import dataclass

from ._combine_cases import LOOKS


@dataclass(frozen=True)
class Plan:
    """What a run holds."""

    looks: tuple[str, ...]
    """Taken to the ends of their ranges."""
    every: int
    """One of so many scenes and curves; 0: none."""
    hard: int
    """One of so many hard fits; 0: none."""
    fits: int
    """Random ones."""
    kinds: tuple[str, ...] = ()
    """Looks of random fits; none: all."""

    @classmethod
    def only(cls, looks: Sequence[str]) -> "Plan":
        """Of looks, and nothing else."""
        return cls(tuple(looks), 0, 0, 0)


FULL = Plan(LOOKS, 1, 1, 1000)
QUICK = Plan(("layers", "air+density"), 4, 4, 40, ("layers", "air+density+saturation"))
SAMPLE = Plan(("layers",), 8, 60, 3, ("layers",))
"""What the tests can wait for."""
