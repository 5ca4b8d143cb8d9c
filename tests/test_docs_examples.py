"""Python that README, docs and docstrings print: it runs, and prints what it is said to print. Notebooks have a test of
their own, and so have commands.
"""

from __future__ import annotations

import ast
import doctest
import importlib
import re

import matplotlib as mpl
import pytest
from test_cli_words import DOCUMENTS, ROOT

ELSEWHERE = {"fleet.md": "dask_jobqueue", "extending.md": "sim.algebra"}
"""Documents with a block that needs another machine or a file of its own, and what it needs: such a block is only
parsed. `tests/test_extending.py` runs those of extending.md in their files."""
OPTIONS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def blocks() -> dict[str, str]:
    """Each block of Python in a document once, and the document it stands in."""
    found: dict[str, str] = {}
    for path in DOCUMENTS:
        for code in re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S):
            if ">>>" not in code:
                found.setdefault(code, path.name)
    return found


def examples() -> list[str]:
    """Documents and modules with examples that show what they print."""
    documents = [path for path in DOCUMENTS if ">>> " in path.read_text(encoding="utf-8")]
    packages = [path for package in ("groundstation", "drivers", "sim") for path in (ROOT / package).rglob("*.py")]
    modules = [path for path in packages if ">>> " in path.read_text(encoding="utf-8")]
    return sorted(path.relative_to(ROOT).as_posix() for path in (*documents, *modules))


@pytest.mark.parametrize(("code", "document"), blocks().items(), ids=list(blocks().values()))
def test_a_block_of_python_in_the_documents_runs(code, document, tmp_path, monkeypatch):
    ast.parse(code)
    if ELSEWHERE.get(document, code + "none") in code:
        return
    mpl.use("svg")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(compile(code, document, "exec"), names)  # noqa: S102 - our own documents
    for file in re.findall(r"savefig\(\"(.*?)\"\)", code):
        assert (tmp_path / file).stat().st_size > 1000


@pytest.mark.parametrize("place", examples())
def test_an_example_prints_what_it_is_said_to_print(place):
    if place.endswith(".py"):
        module = importlib.import_module(place.removesuffix(".py").replace("/", "."))
        failed, tried = doctest.testmod(module, optionflags=OPTIONS)
    else:
        failed, tried = doctest.testfile(str(ROOT / place), module_relative=False, optionflags=OPTIONS)
    assert tried and not failed


def test_there_are_examples_at_all():
    assert len(blocks()) >= 2
    assert {"docs/reference/api.md", "groundstation/api.py"} <= set(examples())
