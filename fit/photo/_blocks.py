"""Square blocks of a photo, within which residuals may be correlated."""

import numpy as np


def block_numbers(index: np.ndarray, size: tuple[int, int], side: int) -> np.ndarray:
    """Number of the block of each pixel, counted over the blocks that hold any."""
    across = -(-size[1] // side)
    rows, columns = np.divmod(index, size[1])
    number = rows // side * across + columns // side
    holds = np.zeros((-(-size[0] // side)) * across, bool)
    holds[number] = True
    return np.asarray((np.cumsum(holds) - 1)[number])
