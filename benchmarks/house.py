"""The size and manners of the code at any commit, as a table: ``python -m benchmarks.house [COMMIT ...]`` (default: the
work tree).

Functions are measured from ``def`` to their last line, docstrings included. Suppressions are ``noqa``, ``type: ignore``
and ``pyright: ignore``. ``Any`` counts annotations of arguments and results.
"""

from __future__ import annotations

import argparse
import ast
import io
import statistics
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("groundstation", "drivers", "sim")
LONG, LONGEST, MANY = 40, 80, 6


def sources(commit: str | None) -> dict[str, str]:
    """Python files of the packages, and pyproject.toml, by path."""
    if commit is None:
        paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
        found = {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}
        return found | {"pyproject.toml": (ROOT / "pyproject.toml").read_text(encoding="utf-8")}
    archive = ["git", "archive", commit, *PACKAGES, "pyproject.toml"]
    packed = subprocess.run(archive, cwd=ROOT, capture_output=True, check=True).stdout
    out: dict[str, str] = {}
    with tarfile.open(fileobj=io.BytesIO(packed)) as tar:
        for member in tar.getmembers():
            handle = tar.extractfile(member) if member.name.endswith((".py", ".toml")) else None
            if handle is not None:
                out[member.name] = handle.read().decode("utf-8")
    return out


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Every function and method."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _arguments(node: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.arg]:
    found = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return [argument for argument in found if argument.arg not in ("self", "cls")]


def _anys(node: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    notes = [argument.annotation for argument in _arguments(node)] + [node.returns]
    return sum("Any" in {n.id for n in ast.walk(note) if isinstance(n, ast.Name)} for note in notes if note is not None)


def measure(files: dict[str, str]) -> dict[str, str]:
    """The rows of the table."""
    code = {path: text for path, text in files.items() if path.endswith(".py")}
    lines = {path: text.count("\n") for path, text in code.items()}
    every = [(path, node) for path, text in code.items() for node in functions(ast.parse(text))]
    lengths = [(node.end_lineno or node.lineno) - node.lineno + 1 for _, node in every]
    where, longest = max(zip(every, lengths, strict=True), key=lambda pair: pair[1])
    over = [length for length in lengths if length > LONG]
    contracts = tomllib.loads(files["pyproject.toml"])["tool"]["importlinter"]["contracts"]
    marks = ("# noqa", "type: ignore", "pyright: ignore")
    return {
        "modules": str(len(code)),
        "lines": str(sum(lines.values())),
        "longest module": f"{max(lines.values())} ({max(lines, key=lambda path: lines[path])})",
        "functions": str(len(lengths)),
        "median function": f"{statistics.median(lengths):g}",
        "longest function": f"{longest} ({where[0]}: {where[1].name})",
        f"functions over {LONG} lines": f"{len(over)} ({len(over) / len(lengths):.1%})",
        f"functions over {LONGEST} lines": str(sum(length > LONGEST for length in lengths)),
        f"functions with over {MANY} parameters": str(sum(len(_arguments(node)) > MANY for _, node in every)),
        "Any in signatures": str(sum(_anys(node) for _, node in every)),
        "suppressions": str(sum(text.count(mark) for text in code.values() for mark in marks)),
        "lines over 120 characters": str(sum(len(line) > 120 for text in code.values() for line in text.splitlines())),
        "import contracts": str(len(contracts)),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commits", nargs="*", help="commits to compare; the work tree comes last")
    commits: list[str] = parser.parse_args().commits
    columns = {commit: measure(sources(commit)) for commit in commits} | {"work tree": measure(sources(None))}
    print("| | " + " | ".join(columns) + " |")
    print("|---|" + "---|" * len(columns))
    for name in next(iter(columns.values())):
        print(f"| {name} | " + " | ".join(column[name] for column in columns.values()) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
