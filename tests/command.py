"""Commands in tests: airlight in the process of the test, mypy on what a user may write."""

import os
import subprocess
import sys
from pathlib import Path
from unittest import mock

from fit.cli._cli import main

from .data import REPOSITORY


def airlight(*words: object) -> int:
    """Run the command; returns its exit code."""
    with mock.patch.object(sys, "argv", ["airlight", *map(str, words)]):
        try:
            main()
        except SystemExit as stop:
            return int(stop.code or 0)
        return 0


def mypy(file: Path) -> subprocess.CompletedProcess[str]:
    """As `make types` runs it, with what that has cached."""
    settings = ("--config-file", str(REPOSITORY / "pyproject.toml"), "--no-error-summary")
    return subprocess.run(
        [sys.executable, "-m", "mypy", *settings, str(file)],
        cwd=REPOSITORY,
        env=os.environ | {"MYPYPATH": "."},
        capture_output=True,
        text=True,
        check=False,
    )
