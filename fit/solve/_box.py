"""Coordinates in which a look's light is as linear as it gets, and in which bounds are a box.

Where a look says what its light is proportional to (`Look.AMPLITUDE`), the amplitude of each
channel stands for a number and factors of mean one: the picture is linear in it, and 0 is a bound
like any other. Levels come next, then all else as it is.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from model_jax import Look

from ._parameters import Entries, FitParameter, followers, shares_basis, shares_in

LEVELS = ("background", "black_level")
"""What light is added by; ground behind the air adds some, too."""


class Box:
    """Coordinates of the free parameters: first those the light is linear in."""

    def __init__(
        self, free: Sequence[FitParameter], parameters: Sequence[FitParameter], kind: type[Look]
    ) -> None:
        shares = shares_in(parameters)
        found = [p for p in free if p.family in kind.AMPLITUDE]
        numbers, factors = [p for p in found if not p.mean_one], [p for p in found if p.mean_one]
        self.amplitude = numbers[0] if len(numbers) == 1 else None
        by_channel = self.amplitude is not None and len(factors) > 1
        for p in found if by_channel else ():  # bounds and ties of parts are none of the product
            wide = p.lower == 0 and p.upper >= (3 if p.mean_one else np.inf)
            by_channel = by_channel and wide and len(followers(p, parameters)) == 1
        self._members = [p.entries[0] for p in factors] if by_channel else []
        self._others = [e for e in range(shares.start, shares.stop) if e not in self._members]
        self._amplitudes = len(self._members) if by_channel else int(self.amplitude is not None)
        plain = [p for p in free if p is not self.amplitude and not p.mean_one]
        levels = (*LEVELS, kind.GROUND)
        self.levels = [p for p in plain if p.family in levels]
        self._plain = [*self.levels, *(p for p in plain if p.family not in levels)]
        self._rows = [
            [e for q in followers(p, parameters) for e in q.entries]
            for p in ([self.amplitude] if self.amplitude else []) + self._plain
        ]
        size = 1 + max(entry for p in parameters for entry in p.entries)
        basis = shares_basis(free, parameters)
        self._basis = np.zeros((size, 0 if by_channel else basis.shape[1]))
        if not by_channel:
            self._basis[shares] = basis

    @property
    def linear(self) -> int:
        """How many of them, the first, the light is linear in."""
        return self._amplitudes + len(self.levels)

    @property
    def lower(self) -> Float[np.ndarray, " n"]:
        """The least value of each."""
        first = 0.0 if self._members or not self.amplitude else self.amplitude.floor
        plain, free = [p.floor for p in self._plain], self._basis.shape[1]
        return np.array([*[first] * self._amplitudes, *plain, *[-np.inf] * free])

    @property
    def upper(self) -> Float[np.ndarray, " n"]:
        """The greatest."""
        first = np.inf if self._members or not self.amplitude else self.amplitude.upper
        plain, free = [p.upper for p in self._plain], self._basis.shape[1]
        return np.array([*[first] * self._amplitudes, *plain, *[np.inf] * free])

    def values(self, vector: Entries) -> Float[np.ndarray, " n"]:
        """Where a vector lies."""
        first = np.zeros(0) if self.amplitude is None else np.atleast_1d(self.amplitude.of(vector))
        if self._members:
            first = first * vector[self._members]
        plain = [float(p.of(vector)) for p in self._plain]
        return np.concatenate([first, plain, self._basis.T @ vector])

    def placed(self, vector: Entries, values: Float[np.ndarray, " n"]) -> Entries:
        """The vector, moved there; without any light its factors stay."""
        moved, first = vector.copy(), values[: self._amplitudes]
        plain = values[self._amplitudes :][: len(self._plain)]
        if self._members:
            whole = first.sum() / self._share(vector)
            if whole > 0:
                moved[self._members] = first / whole
            plain = np.concatenate([[whole], plain])
        else:
            plain = np.concatenate([first, plain])
        for rows, value in zip(self._rows, plain, strict=True):
            moved[rows] = value
        along = values[len(values) - self._basis.shape[1] :]
        return moved + self._basis @ (along - self._basis.T @ moved)

    def slopes(self, vector: Entries) -> Float[np.ndarray, "e n"]:
        """How the entries change with each; without any light factors do not."""
        plain = np.zeros((len(vector), len(self._rows)))
        for column, rows in enumerate(self._rows):
            plain[rows, column] = 1.0
        if not self._members:
            return np.concatenate([plain, self._basis], axis=1)
        assert self.amplitude is not None
        # Amplitude b and factors t of channels' amplitudes a: b = Σa / Σt, t = a / b.
        share, number = self._share(vector), float(self.amplitude.of(vector))
        first = plain[:, :1] / share + np.zeros(len(self._members))
        inner = np.eye(len(self._members)) - vector[self._members][:, None] / share
        first[self._members] = inner / number if number > 0 else 0.0
        return np.concatenate([first, plain[:, 1:]], axis=1)

    def at_bound(self, values: Float[np.ndarray, " n"]) -> list[FitParameter]:
        """What lies at its bound; factors of mean one are not among them."""
        first = [] if self._members or not self.amplitude else [self.amplitude]
        known = [*[None] * len(self._members), *first, *self._plain]
        edge = (values == self.lower) | (values == self.upper)
        return [p for p, there in zip(known, edge, strict=False) if p is not None and there]

    def _share(self, vector: Entries) -> float:
        """What the factors that move add up to."""
        return 3.0 - float(vector[self._others].sum())
