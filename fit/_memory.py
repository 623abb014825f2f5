"""What a process holds stays bounded: freed memory goes back to the system, old programs go.

The C library, where it is glibc, keeps what was freed in blocks below 32 MB, and what compiling
left behind: hundreds of MB beside a large photo's own. JAX keeps every program that it has
compiled, and each holds memory maps, a descent's three hundred. Linux gives a process 65,530 of
them (`vm.max_map_count`), and beyond the compiler ends in a segmentation fault: 26 fits of ever new
sizes and options hold 13,800 of them, and 1.9 GB.
"""

import ctypes
import gc
from contextlib import suppress
from pathlib import Path

import jax

MOST_MAPS = 8_000
"""From this many on programs go: those of eleven fits of ever new sizes and options, 1.2 GB."""

_M_MMAP_THRESHOLD = -3
"""Number of the setting in glibc's malloc.h."""


def map_large_blocks() -> None:
    """From now on blocks of 4 MB are mapped one by one, and go back when they are freed."""
    with suppress(AttributeError, OSError, TypeError):  # another C library, or none to be found
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, 4 << 20)


def give_back() -> None:
    """Give back what is free now."""
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def count_maps() -> int:
    """Memory maps of this process; 0 where the system does not tell, which then has no limit."""
    try:
        return Path("/proc/self/maps").read_bytes().count(b"\n")
    except OSError:
        return 0


def bound_programs() -> None:
    """Clear JAX's caches once the process holds too many programs: what is still used is compiled
    again. All of JAX's, for the operations on the photo's arrays are in none of our own."""
    if count_maps() > MOST_MAPS:
        jax.clear_caches()
        gc.collect()
        give_back()
