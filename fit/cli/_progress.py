"""What a person sees while a command computes, and its last word."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ._guard import check_devices


@contextmanager
def computing(keep: bool = True, bar: bool = False) -> Iterator[Any]:
    """JAX with our settings, under a progress line that is there before JAX is.

    Args:
        keep: compiled programs for the next command.
        bar: with how much of the whole is done, which steps then say.
    """
    with _steps(bar) as step:
        check_devices()
        from .._compile import float64, keep_programs

        if keep:
            keep_programs()
        with float64():
            yield step


@contextmanager
def _steps(bar: bool) -> Iterator[Any]:
    """A progress line on standard error that names the step; gone when done."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    bars = (BarColumn(bar_width=24),) if bar else ()
    columns = (SpinnerColumn(), *bars, TextColumn("{task.description}"), TimeElapsedColumn())
    console = Console(stderr=True)
    quiet = not console.is_terminal  # a pipe or a log would get stray blank lines
    with Progress(*columns, console=console, transient=True, disable=quiet) as progress:
        task = progress.add_task("starting", total=1 if bar else None)
        yield lambda text, share=None: progress.update(task, description=text, completed=share)


def console() -> Any:
    from rich.console import Console

    return Console()


def say(as_json: bool, facts: dict[str, Any], text: str) -> None:
    print(json.dumps(facts) if as_json else text)
