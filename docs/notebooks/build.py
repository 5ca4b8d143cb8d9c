"""Notebooks from their sources, executed: ``python docs/notebooks/build.py [NAME ...]``.

A source is a Python file in ``sources/`` with ``# %%`` cells. The notebook beside it is what it gives when it is run,
with outputs, so that it reads on the web. A test runs the sources against the code.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[2] / "shared" / "data"


def notebook(source: Path) -> nbformat.NotebookNode:
    """The notebook of a source, without outputs, with cell identifiers that do not change from run to run."""
    made = jupytext.read(source)
    for number, cell in enumerate(made.cells):
        cell["id"] = f"cell-{number}"
        cell["metadata"] = {}
    made.metadata = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return made


def needs_data(source: Path) -> bool:
    """It reads measured flights that are not part of the repository."""
    return "GROUNDSTATION_DATA" in source.read_text(encoding="utf-8")


def execute(source: Path, folder: Path, timeout_s: int = 240) -> nbformat.NotebookNode:
    """Run a source in a kernel; files that it writes go to ``folder``."""
    os.environ.setdefault("GROUNDSTATION_DATA", str(DATA))
    made = notebook(source)
    NotebookClient(made, timeout=timeout_s, resources={"metadata": {"path": str(folder)}}).execute()
    for cell in made.cells:
        cell["metadata"] = {}  # times of execution change with each run
    made.metadata = {"kernelspec": made.metadata["kernelspec"], "language_info": {"name": "python"}}
    return made


def main(names: list[str]) -> int:
    """Build the named notebooks, or all."""
    for source in sorted((HERE / "sources").glob("*.py")):
        if names and source.stem not in names:
            continue
        if needs_data(source) and not DATA.is_dir():
            print(f"{source.stem}: not run, {DATA.name} of measured flights is absent", file=sys.stderr)
            continue
        nbformat.write(execute(source, HERE), HERE / f"{source.stem}.ipynb")
        print(f"{source.stem}: written", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
