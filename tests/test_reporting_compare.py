"""Two flights on one page, and a report as Markdown: the same numbers as the report, and text that stays text."""

from __future__ import annotations

import json
import re

import pytest
from test_cli_commands import groundstation

from groundstation import api
from groundstation.errors import BadInput, NotIdentifiable
from groundstation.fleet.catalogue import Catalogue
from groundstation.fleet.report import compare as catalogue_compare
from groundstation.fleet.rows import set_notes
from groundstation.identification.results import Estimate
from groundstation.reporting.canonical import canonical
from groundstation.reporting.compare import cell, change, comparison_rows, read_flown, summary, write_comparison
from groundstation.reporting.report import write_report
from groundstation.reporting.units import interval_text, label, scale_for, significant
from tests import reporting_fixture as fixture


def test_a_difference_beyond_the_intervals_is_named_and_one_within_is_not(tmp_path):
    a, b, c = (fixture.written(tmp_path / name, seed) for name, seed in (("a", 2), ("b", 2), ("c", 3)))
    document = json.loads((b / "identification.json").read_text())
    mass = document["estimate"]["parameters"]["mass_kg"]
    step = 10.0 * mass["std"]
    document["estimate"]["parameters"]["mass_kg"] = {
        "value": mass["value"] + step, "std": mass["std"], "ci95": [bound + step for bound in mass["ci95"]],
    }  # fmt: skip
    (b / "identification.json").write_text(json.dumps(document))
    flights = [read_flown(folder) for folder in (a, b, c)]
    rows = {row[0]: row for row in comparison_rows(flights[:2])}
    assert rows["mass"][-1] == "differs (7.1 σ)", "ten standard deviations of one are 7.1 of a difference"
    assert rows["Ixx"][-1] == "agrees (0 σ)"
    assert summary(flights[:2]) == f"From a to b these differ beyond their intervals: mass {rows['mass'][-2]}."
    assert summary([flights[0], flights[0]]).startswith("Nothing differs")
    assert len(comparison_rows(flights)[0]) == 3 + 2 + 2


def _moved(folder, name, steps):
    """The same flight with one parameter moved by some of its standard deviations."""
    path = folder / "identification.json"
    document = json.loads(path.read_text())
    entry = document["estimate"]["parameters"][name]
    entry |= {"value": entry["value"] + steps * entry["std"], "ci95": [b + steps * entry["std"] for b in entry["ci95"]]}
    path.write_text(json.dumps(document))
    return folder


def test_the_api_compares_two_flights_as_the_command_does(tmp_path):
    a = fixture.written(tmp_path / "a")
    b = _moved(fixture.written(tmp_path / "b"), "mass_kg", 10.0)
    found = api.compare(a, b)
    assert found.summary == summary([read_flown(a), read_flown(b)])
    rows = {row[0]: row for row in comparison_rows([read_flown(a), read_flown(b)])}
    told = {label(name): row for name, row in found.parameters.items()}
    assert set(told) == set(rows)
    for name, row in told.items():
        assert rows[name][-1] == f"{'differs' if row.differs else 'agrees'} ({significant(abs(row.z), 2)} σ)"
        assert rows[name][-2] == row.change
    assert found.parameters["mass_kg"].differs and found.parameters["mass_kg"].z == pytest.approx(7.07, abs=0.01)
    frame = found.to_frame()
    assert frame.loc["mass_kg", "differs"] == "yes" and "mass_kg" in str(found)
    assert found.to_dict()["parameters"]["mass_kg"]["z"] == found.parameters["mass_kg"].z


def test_the_api_compares_two_groups_as_the_flights_list_does(tmp_path):
    names = ("a1", "a2", "a3", "b1", "b2", "b3")
    steps = (0, 1, -1, 60, 61, 59)
    folders = [_moved(fixture.written(tmp_path / n), "mass_kg", s) for n, s in zip(names, steps, strict=True)]
    for folder in folders:
        set_notes(folder, add=(folder.name[0],))
    found = api.compare(folders[:3], folders[3:])
    listed = catalogue_compare(Catalogue(tmp_path), "a", "b")
    for name, row in found.parameters.items():
        difference, p = listed[name]
        assert (row.size, row.std) == pytest.approx((difference.size, difference.std))
        assert row.differs == (name == "mass_kg"), name
        if len(listed) == len(found.parameters):
            assert row.p == pytest.approx(p)
    assert found.first == names[:3] and found.summary.startswith("From a1, a2, a3 to b1, b2, b3 these differ")


def test_the_api_compares_results_in_memory_and_refuses_nothing_against_something(tmp_path):
    folder = fixture.written(tmp_path / "a")
    found = api.compare(fixture.identification(), folder)
    assert not any(row.differs for row in found.parameters.values())
    with pytest.raises(BadInput, match="a flight on each side"):
        api.compare([], folder)
    with pytest.raises(BadInput, match="has no identification"):
        api.compare(tmp_path / "nowhere", folder)


def test_no_share_of_what_may_as_well_be_zero():
    near_zero, moved = Estimate.normal(2e-6, 3e-5), Estimate.normal(3e-4, 3e-5)
    assert change("ixy_kg_m2", near_zero, moved) == "+0.298 10⁻³ kg m²"
    assert change("mass_kg", Estimate.normal(2.0, 0.01), Estimate.normal(2.1, 0.01)) == "+5.0 %"


def test_the_command_writes_a_page_and_markdown_and_refuses_what_is_not_identified(tmp_path):
    for name in ("a", "b"):
        fixture.written(tmp_path / name)
    done = groundstation("compare", "a", "b", "--output", "out.html", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["flights"] == ["a", "b"]
    assert "Nothing differs between a and b" in (tmp_path / "out.html").read_text()
    assert "Nothing differs between a and b" in (tmp_path / "out.md").read_text()
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="has no identification"):
        write_comparison(tmp_path / "x.html", [tmp_path / "a", tmp_path / "empty"])
    with pytest.raises(BadInput, match="two flights or more"):
        write_comparison(tmp_path / "x.html", [tmp_path / "a"])
    assert not (tmp_path / "x.html").exists() and not (tmp_path / "x.md").exists()


def test_the_report_stands_beside_itself_as_markdown_with_the_same_digits(tmp_path):
    flight, identification, diagnosis = fixture.flight(), fixture.identification(), fixture.diagnosis()
    write_report(tmp_path / "report.html", flight, identification, diagnosis)
    text = (tmp_path / "report.md").read_text()
    mass = canonical(identification, diagnosis).parameters["mass_kg"]
    assert f"| {interval_text(mass, scale_for('kg', [mass.value]))} |" in text
    assert text.index("Trust:") < text.index("## Parameters") < text.index("## Findings") < text.index("## Reproduce")
    assert "    groundstation rehearse --vehicle qball2 --scenario seed --seed 17 --plan plan.toml" in text
    assert re.search(r"SHA-256 of the plan: `[0-9a-f]{64}`", text)
    refused = write_report(tmp_path / "no.html", flight, NotIdentifiable("It stood still.", "Fly it.", ()))
    assert "**Refused.** It stood still. Fly it." in refused.with_suffix(".md").read_text()


def test_names_from_logs_are_text_in_markdown():
    assert cell("<b>*x*|y\n# z [a](b)") == r"\<b\>\*x\*\|y \# z \[a\](b)"
