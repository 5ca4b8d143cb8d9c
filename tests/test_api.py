"""The Python API: three lines to parameters with intervals and a figure, tables, and the notebooks run against the
code.
"""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from groundstation import api

ROOT = Path(__file__).resolve().parent.parent
NOTEBOOKS = ROOT / "docs" / "notebooks"
SOURCES = sorted((NOTEBOOKS / "sources").glob("*.py"))


def _builder():
    spec = importlib.util.spec_from_file_location("build", NOTEBOOKS / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def flight():
    plan = api.load_plan("qball2").model_copy(update={"periods": 2.0})
    return api.simulate("qball2", scenario="lab", plan=plan, seed=5)


@pytest.fixture(scope="module")
def found(flight):
    return api.identify(flight)


def test_the_same_seed_is_the_same_flight_and_another_is_not(flight):
    again, other = (api.simulate("qball2", scenario="lab", plan=flight.plan, seed=seed) for seed in (5, 6))
    assert np.array_equal(again.imu.values, flight.imu.values)
    assert not np.array_equal(other.imu.values, flight.imu.values)


def test_a_result_is_a_table_a_frame_and_a_document(found):
    frame = found.to_frame()
    assert list(frame.columns) == ["value", "std", "low", "high"]
    best = found.methods[found.best].parameters
    assert (
        frame.loc["mass_kg", "value"]
        == best["mass_kg"].value
        == found.to_dict()["methods"][found.best]["parameters"]["mass_kg"]["value"]
    )
    assert (frame.loc[list(best), "low"] < frame.loc[list(best), "high"]).all()
    assert "mass_kg" in str(found) and "<td>mass_kg</td>" in found._repr_html_()


def test_a_table_escapes_names_that_come_from_a_log(flight):
    from dataclasses import replace

    named = replace(flight, name="<script>alert(1)</script>")
    assert "<script>" not in named._repr_html_() and "&lt;script&gt;" in named._repr_html_()


def test_without_pandas_a_frame_says_what_to_install(found, monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"groundstation\[notebook\]"):
        found.to_frame()


@pytest.mark.parametrize("name", ["flight", "plan", "identification"])
def test_every_figure_is_drawn(name, flight, found):
    result = {"flight": flight, "plan": flight.plan, "identification": found}[name]
    figure = api.plot(result, flight)
    assert figure._repr_png_().startswith(b"\x89PNG") and figure.axes


def test_the_figure_of_an_identification_shows_declared_and_true_values(flight, found):
    shown = [text.get_text() for text in api.plot(found, flight).legends[0].get_texts()]
    assert shown == ["estimate, 95 % interval", "declared", "true"]


def test_a_simulator_that_refuses_says_why_in_one_sentence():
    scenario = api.load_scenario("lab") | {"effects": {"no_such_effect": {}}}
    with pytest.raises(api.BadInput, match="no_such_effect") as raised:
        api.simulate("qball2", scenario=scenario)
    assert "\n" not in str(raised.value)


def test_everything_public_is_documented_and_typed():
    for name in api.__all__:
        thing = getattr(api, name)
        assert thing.__doc__, name
        if not isinstance(thing, type):
            assert "return" in thing.__annotations__, name


def test_commands_and_screens_reach_the_mathematics_through_the_api():
    """What the API offers, commands import from it and not from below."""
    below = {
        "groundstation.identification.pipeline": {"identify"},
        "groundstation.diagnosis": {"diagnose"},
        "groundstation.diagnosis.next_flight": {"plan_next"},
        "groundstation.model.prediction": {"predict"},
        "groundstation.recording": {"load_flight"},
        "groundstation.analysis.analyse": {"analyse"},
    }
    for path in (ROOT / "groundstation" / "commands").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module in below:
                taken = {alias.name for alias in node.names} & below[node.module]
                assert not taken, f"{path.name}: {taken} of {node.module}"


@pytest.mark.parametrize("source", SOURCES, ids=lambda p: p.stem)
def test_a_notebook_runs_and_the_committed_one_is_of_the_same_source(source, tmp_path):
    import nbformat

    builder = _builder()
    committed = nbformat.read(NOTEBOOKS / f"{source.stem}.ipynb", as_version=4)
    assert [c.source for c in committed.cells] == [c.source for c in builder.notebook(source).cells], (
        f"run: python docs/notebooks/build.py {source.stem}"
    )
    if builder.needs_data(source) and not builder.DATA.is_dir():
        pytest.skip("the measured flights of ../shared/data are not here")
    ran = builder.execute(source, tmp_path)
    assert any("image/png" in o.get("data", {}) for c in ran.cells if c.cell_type == "code" for o in c.outputs)
