"""Which product files and functions are longer than a reader holds in mind, without a reason.

    python .ci/lengths.py FOLDER…

A file may have 400 lines, a function 60 of code: its body without docstring, blank lines and
comments. More needs a comment `# long: why`: of a file on a line of its own, of a function beside
its name.
"""

import ast
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

FILE_LINES = 400
CODE_LINES = 60
REASON = "# long: "


def main(folders: list[str]) -> int:
    paths = sorted(path for folder in folders for path in Path(folder).rglob("*.py"))
    if not paths:
        print(f"no Python files in {' '.join(folders)}", file=sys.stderr)
        return 2
    faults = [fault for path in paths for fault in faults_of(path)]
    print(*faults, sep="\n") if faults else print(f"{len(paths)} files are short enough")
    return 1 if faults else 0


def faults_of(path: Path) -> Iterator[str]:
    lines = path.read_text(encoding="utf-8").splitlines()
    if len(lines) > FILE_LINES and not any(line.startswith(REASON) for line in lines):
        yield f"{path}: {len(lines)} lines, over {FILE_LINES}; split it, or say `{REASON}why`"
    code = code_lines(path)
    for node in ast.walk(ast.parse("\n".join(lines))):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        body = node.body[1:] if ast.get_docstring(node) is not None else node.body
        first, last = (body[0].lineno, node.end_lineno or 0) if body else (1, 0)
        count = sum(first <= line <= last for line in code)
        signature = lines[node.lineno - 1 : node.body[0].lineno - 1]
        if count > CODE_LINES and not any(REASON in line for line in signature):
            yield (
                f"{path}:{node.lineno}: {node.name} has {count} lines of code, over {CODE_LINES}; "
                f"split it, or say `{REASON}why` beside its name"
            )


def code_lines(path: Path) -> set[int]:
    """Numbers of the lines that hold more than a comment."""
    nothing = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    found: set[int] = set()
    with tokenize.open(path) as stream:
        for token in tokenize.generate_tokens(stream.readline):
            if token.type not in nothing and token.type != tokenize.ENDMARKER:
                found.update(range(token.start[0], token.end[0] + 1))
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
