"""A pytest plugin: no worker grows until the compiler dies, and the run says what workers needed.

Every program that XLA compiles holds memory maps until JAX's caches are cleared, and the kernel
gives a process 65,530 of them (`vm.max_map_count`): beyond, the compiler ends in a segmentation
fault. So caches are cleared after each module and after any test that leaves many behind; a module
that still ends with too many, and a test at which a worker outgrows its memory, fail by name. That
a test which hangs or crashes ends the run is pytest-timeout's (pyproject.toml) and pytest-xdist's
part (Makefile).
"""

import gc
import resource
import sys
from collections.abc import Generator
from pathlib import Path

import pytest

CLEAR_AT = 4_000
"""Maps, of about ten kinds of fit, 1 GB with what compiling left behind. What is cleared is read
again from JAX's compilation cache (see conftest.py), not compiled again."""

MOST_MAPS = 20_000
"""At a module's end: a third of the kernel's limit, for one test may need many by itself."""

MOST_BYTES = 3 << 30
"""Of a worker. On two cores they need less than 2 GB; a compiler with more threads needs more."""

_needed = pytest.StashKey[dict[str, tuple[int, int]]]()
"""Worker → its largest number of maps and of bytes."""


def count_maps() -> int:
    """`fit._memory.count_maps`, without the seconds that importing `fit` takes."""
    maps = Path("/proc/self/maps")
    return maps.read_bytes().count(b"\n") if maps.exists() else 0


def bytes_of_process() -> int:
    """The most memory that this process had at once; Linux counts in units of 1024."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(
    item: pytest.Item, nextitem: pytest.Item | None
) -> Generator[None, None, None]:
    before = _measured(item.config)
    yield
    maps, most = count_maps(), bytes_of_process()
    item.config.stash[_needed][""] = max(before[0], maps), most
    ended = nextitem is None or nextitem.path != item.path
    if ended or maps > CLEAR_AT:
        _clear()
    if most > MOST_BYTES >= before[1]:
        pytest.fail(
            f"{item.nodeid}: the worker has needed {most / 1e9:.2f} GB by the end of this test, "
            f"more than {MOST_BYTES / 1e9:.2f}: make smaller what it computes at once"
        )
    if ended and maps > MOST_MAPS:
        pytest.fail(
            f"{item.path.name} ended with {maps} memory maps, more than {MOST_MAPS}: let its tests "
            "share compiled programs, or move repetition into the full sweep"
        )


def _clear() -> None:
    """Drop compiled programs and give memory back, if the tests so far have used any."""
    if "jax" in sys.modules:
        sys.modules["jax"].clear_caches()
    gc.collect()
    if "fit._memory" in sys.modules:
        sys.modules["fit._memory"].give_back()


def _measured(config: pytest.Config) -> tuple[int, int]:
    return config.stash.setdefault(_needed, {}).get("", (0, 0))


def pytest_sessionfinish(session: pytest.Session) -> None:
    output = getattr(session.config, "workeroutput", None)
    if output is not None:
        output["resources"] = _measured(session.config)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: object) -> None:
    """A worker has ended; one that crashed has said nothing."""
    found = getattr(node, "workeroutput", {}).get("resources")
    if found is not None:
        needed = node.config.stash.setdefault(_needed, {})  # type: ignore[attr-defined]
        needed[node.gateway.id] = tuple(found)  # type: ignore[attr-defined]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    needed = terminalreporter.config.stash.get(_needed, {})
    for worker, (maps, most) in sorted(needed.items()):
        name = worker or "this process"
        terminalreporter.write_line(f"{name}: at most {most / 1e9:.2f} GB and {maps} memory maps")
