"""Shapes that signatures promise: another one fails while tests run, and the running program pays nothing for it."""

from __future__ import annotations

import ast
import importlib
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import shapes
from jaxtyping import TypeCheckError

from groundstation.flightdata import Stream
from groundstation.identification.estimators import least_squares
from groundstation.identification.regressors import inertia_columns, standard_regressor
from groundstation.planning.criteria import inertia_regressor

ROOT = Path(__file__).resolve().parent.parent
PROMISE = """
from __future__ import annotations
from typing import Annotated
import numpy as np
from numpy.typing import NDArray
Array = NDArray[np.float64]
Rows = Annotated[Array, "k 3"]

def doubled(rows: Rows) -> Rows:
    return np.concatenate([rows, rows]){fault}
"""


@pytest.mark.parametrize(("fault", "kept"), [("[: len(rows)]", True), ("", False), ("[: len(rows), :2]", False)])
def test_a_function_that_gives_another_shape_than_it_promises_fails(tmp_path, monkeypatch, fault, kept):
    (tmp_path / "promised.py").write_text(PROMISE.format(fault=fault))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(shapes, "PACKAGES", ("promised",))
    monkeypatch.delitem(sys.modules, "promised", raising=False)
    import promised  # type: ignore[import-not-found]

    if kept:
        assert promised.doubled(np.zeros((4, 3))).shape == (4, 3)
    else:
        with pytest.raises(TypeCheckError, match="return value"):
            promised.doubled(np.zeros((4, 3)))


def test_arguments_of_our_own_functions_and_results_are_held_to_one_length():
    rates, fewer = np.ones((5, 3)), np.ones((4, 3))
    assert inertia_regressor(rates, rates).shape == (5, 3, 6)
    for wrong in (
        lambda: inertia_regressor(rates, fewer),
        lambda: inertia_columns(rates, rates),
        lambda: standard_regressor(np.ones(4), rates, rates),
        lambda: least_squares(np.ones((5, 4, 7)), np.ones((5, 3)), np.ones(5), np.ones(5, dtype=bool)),
        lambda: Stream(np.arange(5.0), np.ones((4, 2)), ("a", "b")),
    ):
        with pytest.raises(TypeCheckError):
            wrong()


def test_shapes_are_held_in_every_pure_package():
    for module in ("diagnosis.pipeline", "identification.pipeline", "model.prediction", "planning.plan"):
        importlib.import_module(f"groundstation.{module}")
    held = shapes.checked
    assert len(held) > 50
    for package in ("flightdata", "trajectory", "planning", "model", "identification", "diagnosis"):
        assert any(name.startswith(f"groundstation.{package}") for name in held), package


def test_the_running_program_knows_nothing_of_the_check():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not any(name.startswith(("jaxtyping", "beartype")) for name in project["dependencies"])
    for package in ("groundstation", "drivers", "sim"):
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
                names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                assert not any(name.startswith(("jaxtyping", "beartype")) for name in names), path
    told = "import sys; print('groundstation.planning.criteria' in sys.modules, 'jaxtyping' in sys.modules)"
    code = f"import groundstation.identification.pipeline, groundstation.planning.plan\n{told}"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert done.stdout.split() == ["True", "False"], done.stderr
