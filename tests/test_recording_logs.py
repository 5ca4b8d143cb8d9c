"""The catalogue of a logs folder, and how parameters moved from flight to flight."""

from __future__ import annotations

import json
import os

import pytest

from groundstation.recording import catalogue, parameter_history


def put(logs, name, when, *, vehicle="quad", mass=None, std=0.01, verdict=None, refused=None):
    folder = logs / name
    folder.mkdir(parents=True)
    (folder / "flight.mcap").write_bytes(b"")
    os.utime(folder / "flight.mcap", (when, when))
    if mass is not None:
        estimate = {"value": mass, "std": std, "ci95": [mass - 2 * std, mass + 2 * std]}
        document = {
            "schema": "groundstation.identification/1",
            "flight": name,
            "vehicle": vehicle,
            "best": "OE",
            "methods": {"OE": {"parameters": {"mass_kg": estimate}}, "LS": {"parameters": {}}},
            "model": {"rotor_lag_up_s": {"value": 0.05, "std": 0.001, "ci95": []}},
        }
        (folder / "identification.json").write_text(json.dumps(document))
    if verdict:
        (folder / "diagnosis.json").write_text(json.dumps({"verdict": verdict}))
    if refused:
        (folder / "refused.json").write_text(json.dumps({"refused": True, "reason": refused}))


@pytest.fixture
def logs(tmp_path):
    put(tmp_path, "third", 3000.0, mass=1.75, verdict="explained")
    put(tmp_path, "first", 1000.0, mass=1.70, verdict="clean")
    put(tmp_path, "second", 2000.0, refused="too little motion")
    put(tmp_path, "other", 2500.0, vehicle="hexa", mass=4.0)
    put(tmp_path, "crashed", 4000.0)
    return tmp_path


def test_flights_are_listed_in_the_order_they_were_flown(logs):
    rows = catalogue(logs)
    assert [row["flight"] for row in rows] == ["first", "second", "other", "third", "crashed"]
    assert [row["state"] for row in rows] == ["identified", "refused", "identified", "identified", "recorded"]
    assert [row["verdict"] for row in rows] == ["clean", None, None, "explained", None]
    assert rows[0]["date"] == "1970-01-01T00:16:40+00:00"
    assert rows[1]["reason"] == "too little motion"
    assert rows[0]["parameters"] == {
        "rotor_lag_up_s": {"value": 0.05, "std": 0.001},
        "mass_kg": {"value": 1.70, "std": 0.01},
    }
    json.dumps(rows)


def test_a_parameter_is_compared_with_the_same_vehicles_last_result(logs):
    """50 g more, both known to 10 g: 3.5 combined standard deviations, across a refusal and another vehicle's flight."""
    third = next(row for row in catalogue(logs) if row["flight"] == "third")
    assert third["moved"]["mass_kg"] == pytest.approx(0.05 / (0.01 * 2**0.5))
    assert third["moved"]["rotor_lag_up_s"] == 0.0
    other = next(row for row in catalogue(logs) if row["flight"] == "other")
    assert other["moved"] == {}


def test_the_history_of_a_parameter(logs):
    assert parameter_history(catalogue(logs), "quad", "mass_kg") == [("first", 1.70, 0.01), ("third", 1.75, 0.01)]


def test_a_result_that_was_cut_off_counts_as_none(logs):
    (logs / "first" / "identification.json").write_text('{"methods": {"OE"')
    assert next(row for row in catalogue(logs) if row["flight"] == "first")["state"] == "recorded"


def test_no_logs_no_flights(tmp_path):
    assert catalogue(tmp_path / "nowhere") == []
