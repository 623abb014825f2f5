"""What the README shows runs, and what it links to exists."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from .command import airlight, mypy

ROOT = Path(__file__).resolve().parent.parent
LINES = (ROOT / "README.md").read_text().splitlines()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", "\n".join(LINES), re.DOTALL)


def test_the_two_commands_and_the_python_api_come_early() -> None:
    first = "\n".join(LINES[:20])
    assert "make demo" in first
    assert "make test" in first
    assert "```python" in "\n".join(LINES[:40])


def test_the_python_snippet_runs() -> None:
    (snippet,) = blocks("python")
    done = subprocess.run(
        [sys.executable, "-c", snippet + "\nassert picture.shape == (540, 720, 4), slope"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "it explains 70" in done.stdout


def test_the_python_snippet_is_typed(tmp_path: Path) -> None:
    (snippet,) = blocks("python")
    (tmp_path / "snippet.py").write_text(snippet)
    done = mypy(tmp_path / "snippet.py")
    assert done.returncode == 0, done.stdout


def test_the_table_of_verdicts_is_what_happens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The demo's row is `make demo`, which CI's own test of it shows (`test_first_word`)."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    assert airlight("render", "examples/paper.toml", "-o", "paper.exr", "--size", "320x256") == 0
    rows = [
        [cell.strip().strip("`") for cell in line.strip("|").split("|")]
        for line in LINES
        if re.match(r"\| .* \| \d \| .* \| `airlight fit", line)
    ]
    assert len(rows) == 8
    for verdict, code, says, command in rows:
        if verdict == "at_bound":
            continue
        capsys.readouterr()
        assert airlight(*command.split()[1:]) == int(code), command
        told = capsys.readouterr()
        said = " ".join((told.out + told.err).split())
        assert says in said, command
        assert verdict == "bad input" or said.startswith(verdict), command


@pytest.mark.parametrize(
    "command", ["render", "fit", "export", "check", "looks", "bench", "stress", "version"]
)
def test_every_command_is_shown(command: str) -> None:
    assert any(f"airlight {command}" in block for block in blocks("sh"))


def looks_table() -> list[str]:
    """The README's table, from what `airlight looks --json` says."""
    from fit.cli._looks import describe_looks

    rows = ["| look | parameter | default | unit | range | meaning |", "|---|---|---|---|---|---|"]
    for name, look in describe_looks()["looks"].items():
        more = [
            (f"{name}+{term}", key, about)
            for term, added in look["terms"].items()
            for key, about in added["parameters"].items()
        ]
        own = [(name, key, about) for key, about in look["parameters"].items()]
        for look_name, key, about in own + more:
            default = about["default"]
            values = default if isinstance(default, list) else [default]
            low, high = (
                ("−∞" if about["lower"] is None else f"{about['lower']:g}"),
                ("∞" if about["upper"] is None else f"{about['upper']:g}"),
            )
            told = " ".join(f"{v:g}" for v in values)
            if len(values) > 9:
                told = f"{len(values)} numbers"
            cells = [look_name, f"`{key}`", told, about["unit"]]
            rows.append("| " + " | ".join([*cells, f"{low} … {high}", about["meaning"]]) + " |")
    return rows


def test_the_table_of_looks_is_what_the_command_says() -> None:
    start = LINES.index(looks_table()[0])
    end = next(k for k in range(start, len(LINES)) if not LINES[k].startswith("|"))
    assert LINES[start:end] == looks_table()


def test_links_lead_somewhere() -> None:
    targets = re.findall(r"\]\(([^)#]+)\)", "\n".join(LINES))
    assert len(targets) >= 8
    for target in targets:
        assert target.startswith("http") or (ROOT / target).exists(), target


def test_share_explained_is_what_a_fit_says() -> None:
    """The README's 46 % is the embedded example's figure (also a guard on the example itself)."""
    from fit import fit, load_photo
    from model_jax import analytic_layers
    from render_gl import load_scene

    file = load_scene(ROOT / "examples/reference.toml")
    assert file.photo.path is not None
    result = fit(load_photo(file.photo.path), analytic_layers(file.scene))
    assert result.explained == pytest.approx(0.46, abs=0.005)


def test_rows_on_speed_are_those_of_the_full_run() -> None:
    from .frontier_rows import table

    start = LINES.index(table()[0])
    end = next(k for k in range(start, len(LINES)) if not LINES[k].startswith("|"))
    assert LINES[start:end] == table()


def test_no_time_is_stated_outside_of_the_rows() -> None:
    """A time that names no row is one that nobody can measure again."""
    told = [line for line in LINES if re.search(r"\d (ms|s|seconds|minutes)\b", line)]
    assert [line for line in told if not line.startswith("|")] == []
