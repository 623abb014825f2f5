"""A run of `make test` always ends: crashes, hangs and hoarding are red at once, and by name."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from .resources import MOST_MAPS

REPOSITORY = Path(__file__).resolve().parent.parent
OTHERS = "import time\n" + "".join(
    f"def test_other_{k}():\n    time.sleep(0.02)\n" for k in range(30)
)


def planned(target: str) -> str:
    """What `make` would run, without the options of a `make` that runs these tests."""
    ours = ("MAKE", "MFLAGS", "PYTEST_ARGS")
    outer = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    command = ["make", "-n", target]
    done = subprocess.run(
        command, capture_output=True, text=True, check=True, cwd=REPOSITORY, env=outer
    )
    return done.stdout


def run(folder: Path, faulty: str, *options: str) -> subprocess.CompletedProcess[str]:
    """The Makefile's own command on a faulty test file and three harmless ones."""
    (folder / "test_faulty.py").write_text(faulty + OTHERS)
    for k in range(3):
        (folder / f"test_well_{k}.py").write_text(OTHERS)
    command = shlex.split(planned("test").splitlines()[-1])
    assert command[1:3] == ["-m", "pytest"]
    command = [sys.executable, *command[1:], "-p", "tests.resources", *options]
    command[command.index("-n") + 1] = "2"  # as on the smallest machine of CI
    config = ["-c", str(REPOSITORY / "pyproject.toml"), "--rootdir", str(folder)]
    return subprocess.run(
        [*command, *config, "-p", "no:cacheprovider", str(folder)],
        capture_output=True,
        text=True,
        check=False,
        cwd=REPOSITORY,
        timeout=120,
    )


def test_a_crashed_worker_ends_the_run(tmp_path: Path) -> None:
    done = run(tmp_path, "import os\ndef test_crash():\n    os.abort()\n")
    assert done.returncode != 0
    assert "crashed while running 'test_faulty.py::test_crash'" in done.stdout


def test_a_test_that_hangs_ends_the_run(tmp_path: Path) -> None:
    """In C, where no Python signal reaches it."""
    hang = "import threading\nlock = threading.Lock()\n"
    hang += "def test_hang():\n    lock.acquire()\n    lock.acquire()\n"
    done = run(tmp_path, hang, "-o", "timeout=2")
    assert done.returncode != 0
    assert "test_faulty.py::test_hang" in done.stdout


def test_a_module_that_hoards_maps_fails_by_name(tmp_path: Path) -> None:
    hoard = (
        "import mmap\nkept = []\ndef test_hoard():\n"
        f"    kept.extend(mmap.mmap(-1, 4096) for _ in range({MOST_MAPS}))\n"
    )
    done = run(tmp_path, hoard)
    assert done.returncode != 0
    assert "test_faulty.py ended with" in done.stdout


def test_a_run_says_what_its_workers_needed(tmp_path: Path) -> None:
    done = run(tmp_path, "")
    assert done.returncode == 0, done.stdout
    said = [line for line in done.stdout.splitlines() if "GB and" in line]
    assert [line.split(":")[0] for line in said] == ["gw0", "gw1"]


@pytest.mark.parametrize("target", ["test", "test-full"])
def test_both_targets_have_the_same_safeguards(target: str) -> None:
    assert "--max-worker-restart=0" in planned(target)
