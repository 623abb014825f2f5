"""How much of the tables is made."""

from dataclasses import dataclass

from ._combine_cases import LOOKS


@dataclass(frozen=True)
class Plan:
    """What a run holds."""

    looks: tuple[str, ...]
    """Taken to the ends of their ranges."""
    every: int
    """One of so many scenes and curves."""
    hard: int
    """One of so many hard fits."""
    fits: int
    """Random ones."""
    kinds: tuple[str, ...] = ()
    """Looks of random fits; none: all."""


FULL = Plan(LOOKS, 1, 1, 1000)
QUICK = Plan(("layers", "air+density"), 4, 4, 40, ("layers", "air+density+saturation"))
SAMPLE = Plan(("layers",), 8, 60, 3, ("layers",))
"""What the tests can wait for."""
