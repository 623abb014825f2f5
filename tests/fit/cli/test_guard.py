"""What stands between the command line and the terminal: one line, and nobody else's."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import render_gl
from fit.cli import _guard
from model_jax import LayersLook, analytic_layers, composite
from tests.command import airlight
from tests.scene_text import resized


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(resized(64, 48))
    return tmp_path


def alone(*words: str | bytes, **variables: str) -> subprocess.CompletedProcess[bytes]:
    """The installed command in a process of its own: that is what has a terminal."""
    command = [os.fsencode(Path(sys.executable).parent / "airlight"), *map(os.fsencode, words)]
    return subprocess.run(
        command, env=os.environ | variables, capture_output=True, timeout=300, check=False
    )


def inside(capfd: pytest.CaptureFixture[str], *words: str | bytes) -> tuple[int, str]:
    """The command in this process; returns its exit code and what it says on standard error."""
    capfd.readouterr()
    code = airlight(*map(os.fsdecode, words))
    return code, capfd.readouterr().err


def guarded(body: str) -> subprocess.CompletedProcess[str]:
    """A program that does something inside the guard."""
    program = (
        f"import sys\nfrom fit.cli._guard import guard\nwith guard(lambda: 'airlight'):\n{body}"
    )
    return subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=False
    )


def test_a_bug_is_one_line_and_its_traceback_a_file() -> None:
    done = guarded(
        "    import os\n    os.write(2, b'a library said so')\n    print('shown')\n    {}['key']\n"
    )
    assert done.returncode == _guard.BUG == 70
    assert done.stdout == "shown\n"
    told = re.fullmatch(
        r"airlight: a bug of airlight's, not of your input \(KeyError: 'key'\); report (\S+)\n",
        done.stderr,
    )
    assert told is not None, done.stderr
    saved = Path(told[1])
    text = saved.read_text()
    saved.unlink()
    assert "Traceback (most recent call last)" in text
    assert "KeyError: 'key'" in text
    assert "a library said so" in text


@pytest.mark.parametrize(
    "noise",
    [
        "import os; os.write(2, b'libEGL warning: no such thing\\n')",
        "import warnings; warnings.warn('deprecated', DeprecationWarning, stacklevel=1)",
        "import logging; logging.getLogger('tifffile').warning('odd tag')",
        "import ctypes; ctypes.CDLL(None).perror(b'a C library')",
    ],
)
def test_other_libraries_say_nothing(noise: str) -> None:
    done = guarded(f"    {noise}\n    print('ours', file=sys.stderr)\n")
    assert (done.returncode, done.stderr) == (0, "ours\n")


@pytest.mark.parametrize(
    ("fault", "line", "code"),
    [
        ("raise MemoryError", "the memory is full; use a smaller photo", 2),
        ("raise RuntimeError('RESOURCE_EXHAUSTED: out of memory')", "the memory is full", 2),
        ("raise OSError(28, 'No space left', 'fit.json')", "the disk is full (fit.json)", 2),
        ("raise KeyboardInterrupt", "stopped", 130),
        ("raise RecursionError('too deep')", "a bug of airlight's, not of your input (Rec", 70),
    ],
)
def test_faults_of_the_machine_are_named(fault: str, line: str, code: int) -> None:
    done = guarded(f"    {fault}\n")
    assert done.returncode == code
    assert done.stderr.startswith(f"airlight: {line}")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "words",
    [
        pytest.param(("render", "scene.toml", "-o", "a.exr"), marks=pytest.mark.full, id="render"),
        pytest.param(("fit", "scene.toml", "scene.toml", "-o", "b"), id="fit"),
    ],
)
def test_a_platform_without_a_device_is_named_before_the_work(
    words: tuple[str, ...], here: Path
) -> None:
    """JAX_PLATFORMS=cuda without a GPU was 106 lines."""
    done = alone(*words, JAX_PLATFORMS="cuda")
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr == (
        b"airlight: JAX finds no device to compute on; JAX_PLATFORMS is 'cuda': unset it, or "
        b"set JAX_PLATFORMS=cpu\n"
    )


def test_names_that_are_no_text(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The fit of a photo whose name is no UTF-8 failed at its very end, with EXR files left."""
    scene = render_gl.load_scene("scene.toml").scene
    picture = np.asarray(composite(analytic_layers(scene), LayersLook()))
    photo = os.fsdecode(b"p\xff.png")
    Image.fromarray(np.uint8(np.clip(picture[..., :3] * 255, 0, 255))).save(
        os.fsencode(photo), format="PNG"
    )
    os.rename("scene.toml", b"s\xff.toml")
    words = ("fit", b"s\xff.toml", b"p\xff.png", "-o", "out", "--source", "analytic")
    assert inside(capfd, *words)[1] == ""
    assert sorted(os.listdir("out"))[0] == "fit.json"
    assert r"p\\xff.png" in Path("out/fit.json").read_text()
    assert r"p\xff.png" in Path("out/report.html").read_text()
    refusals: list[tuple[list[str | bytes], str]] = [
        (["fit", b"s\xff.toml", b"p\xff.png", "-o", b"o\xff"], r"o\xff: is no UTF-8 text"),
        (["render", b"s\xff.toml", "-o", b"r\xff.exr"], r"r\xff.exr: is no UTF-8 text"),
        (["fit", b"s\xff.toml", b"p\xff.png", "-o", ""], "-o: is empty; name a folder"),
        (["check", b"s\xff.toml", "-o", ""], "-o: is empty; name a folder"),
        (["render", b"s\xff.toml", "-o", ""], "-o: is empty; name a file"),
        (["export", "out/fit.json", "--to", "csv", "-o", ""], "write is empty; name one"),
    ]
    for refused, line in refusals:
        code, said = inside(capfd, *refused)
        assert code == 2
        assert line in said
        assert said.count("\n") == 1


def test_output_that_cannot_be_written(here: Path) -> None:
    command: list[str | Path] = [Path(sys.executable).parent / "airlight", "version"]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr == "airlight: the disk is full (standard output); free some space\n"
    plain = alone("version", PYTHONIOENCODING="ascii")
    assert (plain.returncode, plain.stderr) == (0, b"")


def test_what_a_mask_holds_is_not_told(here: Path, capfd: pytest.CaptureFixture[str]) -> None:
    Path("secret").write_bytes(b"password=1234")
    for words in (
        ["fit", "scene.toml", "secret", "-o", "out"],
        ["fit", "--layers", "secret", "scene.toml", "-o", "out"],
        ["fit", "scene.toml", "scene.toml", "--mask", "secret", "-o", "out"],
    ):
        code, said = inside(capfd, *words)
        assert code == 2
        assert "pass" not in said
        assert said.count("\n") == 1
