"""Memory that was freed goes back to the system, where the C library is glibc.

Left alone it keeps what is below 32 MB, and what compiling left behind: hundreds of MB beside a
large photo's own.
"""

import ctypes
from contextlib import suppress

_M_MMAP_THRESHOLD = -3


def map_large_blocks() -> None:
    """From now on blocks of 4 MB are mapped one by one, and go back when they are freed."""
    with suppress(AttributeError, OSError, TypeError):  # another C library, or none to be found
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 4 << 20)


def give_back() -> None:
    """Give back what is free now."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
