"""The command line in the test's own process."""

import sys
from unittest import mock

from fit.cli._cli import main


def airlight(*words: object) -> int:
    """Run the command; returns its exit code."""
    with mock.patch.object(sys, "argv", ["airlight", *map(str, words)]):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0
