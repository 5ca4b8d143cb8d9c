"""The catalogue of a logs folder: made from the flights, never the only copy, asked with SQL."""

from __future__ import annotations

import json
import os
import threading

import pytest

from groundstation.errors import BadInput
from groundstation.fleet import catalogue as module
from groundstation.fleet.catalogue import FILE, Catalogue, Filter
from groundstation.fleet.rows import set_notes


def put(logs, name, when, *, vehicle="quad", mass=None, std=0.01, verdict=None, refused=None, findings=()):
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
            "methods": {
                "OE": {"parameters": {"mass_kg": estimate}},
                "LS": {"parameters": {"mass_kg": {**estimate, "value": 9.0}}},
            },
            "model": {"rotor_lag_up_s": {"value": 0.05, "std": 0.001, "ci95": []}},
        }
        (folder / "identification.json").write_text(json.dumps(document))
    if verdict:
        (folder / "diagnosis.json").write_text(json.dumps({"verdict": verdict, "findings": list(findings)}))
    if refused:
        (folder / "refused.json").write_text(json.dumps({"refused": True, "reason": refused}))


DRAG = {
    "effect": "rotor_drag",
    "rotor": None,
    "confidence": 0.99,
    "evidence": "Drag.",
    "alternatives": ["wind"],
    "parameters": {"d_x_kg_s": {"value": 0.3, "std": 0.01, "ci95": [0.28, 0.32]}},
}


@pytest.fixture
def logs(tmp_path):
    put(tmp_path, "third", 3000.0, mass=1.75, verdict="explained", findings=[DRAG])
    put(tmp_path, "first", 1000.0, mass=1.70, verdict="clean")
    put(tmp_path, "second", 2000.0, refused="too little motion")
    put(tmp_path, "other", 2500.0, vehicle="hexa", mass=4.0)
    put(tmp_path, "crashed", 4000.0)
    return tmp_path


def test_flights_are_listed_in_the_order_they_were_flown(logs):
    rows = Catalogue(logs).rows()
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
    """50 g more, both known to 10 g: 3.5 combined standard deviations, across a refusal and another vehicle's
    flight.
    """
    rows = {row["flight"]: row for row in Catalogue(logs).rows()}
    assert rows["third"]["moved"]["mass_kg"] == pytest.approx(0.05 / (0.01 * 2**0.5))
    assert rows["third"]["moved"]["rotor_lag_up_s"] == 0.0
    assert rows["other"]["moved"] == {}


def test_a_result_that_was_cut_off_counts_as_none(logs):
    (logs / "first" / "identification.json").write_text('{"methods": {"OE"')
    assert next(row for row in Catalogue(logs).rows() if row["flight"] == "first")["state"] == "recorded"


def test_no_logs_no_flights(tmp_path):
    assert Catalogue(tmp_path / "nowhere").rows() == []
    assert not (tmp_path / "nowhere").exists()


def test_filters_and_tags(logs):
    set_notes(logs / "first", add=("payload", "payload"), note="with the camera")
    catalogue = Catalogue(logs)
    names = lambda **f: [row["flight"] for row in catalogue.rows(Filter(**f))]  # noqa: E731
    assert names(tag="payload") == ["first"]
    assert names(finding="rotor_drag") == ["third"]
    assert names(vehicle="hexa") == ["other"]
    assert names(since="1970-01-01T00:40") == ["other", "third", "crashed"]
    assert catalogue.rows(Filter(tag="payload"))[0]["note"] == "with the camera"
    set_notes(logs / "first", remove=("payload",))
    assert Catalogue(logs).rows(Filter(tag="payload")) == []
    with pytest.raises(BadInput, match="holds no flight"):
        set_notes(logs, add=("x",))


def test_sql_reads_the_tables_and_nothing_else(logs, tmp_path):
    catalogue = Catalogue(logs)
    columns, rows = catalogue.sql(
        "SELECT flight, value FROM parameters WHERE name = 'mass_kg' AND method = 'canonical' ORDER BY value"
    )
    assert columns == ["flight", "value"]
    assert rows == [("first", 1.70), ("third", 1.75), ("other", 4.0)]
    assert catalogue.sql("SELECT effect, alternatives FROM findings")[1] == [("rotor_drag", ["wind"])]
    secret = tmp_path / "secret.csv"
    secret.write_text("a\n1\n")
    for query in (
        "DELETE FROM catalogue",
        f"COPY flights TO '{tmp_path / 'out.csv'}'",
        "SELECT 1; SELECT 2",
        f"SELECT * FROM read_csv('{secret}')",
        "SET enable_external_access = true",
        "ATTACH 'x.db'",
        "SELECT nothing FROM flights",
        "not sql",
        "",
    ):
        with pytest.raises(BadInput):
            catalogue.sql(query)
    assert not (tmp_path / "out.csv").exists()
    assert len(Catalogue(logs).rows()) == 5


def test_a_deleted_damaged_or_half_written_catalogue_is_made_again(logs):
    expected = Catalogue(logs).rows()
    file = logs / FILE
    whole = file.read_bytes()
    for content in (b"", b"PAR1", whole[: len(whole) // 2], b"\0" * 500, whole[:-8] + b"garbage!"):
        file.write_bytes(content)
        again = Catalogue(logs)
        assert again.rows() == expected
        assert "made again" in again.note
        assert Catalogue(logs).note == ""
    file.unlink()
    assert Catalogue(logs).rows() == expected
    assert file.read_bytes()[:4] == b"PAR1"


def test_only_what_changed_is_read_again(logs, monkeypatch):
    Catalogue(logs)
    read = []
    whole = module.row_of
    monkeypatch.setattr(module, "row_of", lambda folder, stamp: read.append(folder.name) or whole(folder, stamp))
    Catalogue(logs)
    assert read == []
    set_notes(logs / "third", note="again")
    assert next(r for r in Catalogue(logs).rows() if r["flight"] == "third")["note"] == "again"
    assert read == ["third"]
    Catalogue(logs, rebuild=True)
    assert len(read) == 6


def test_a_flight_that_is_gone_leaves_the_catalogue(logs):
    Catalogue(logs)
    for path in (logs / "first").iterdir():
        path.unlink()
    (logs / "first").rmdir()
    for path in (logs / "other").iterdir():
        path.unlink()
    assert [r["flight"] for r in Catalogue(logs).rows()] == ["second", "third", "crashed"]


def test_two_stations_that_write_at_once_lose_nothing(logs):
    """Eight threads refresh and tag at once; whoever comes last, the next listing is right."""

    def work(number):
        put(logs, f"more-{number}", 5000.0 + number, mass=1.7)
        Catalogue(logs)

    threads = [threading.Thread(target=work, args=(n,)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    catalogue = Catalogue(logs)
    assert catalogue.note == ""
    assert len(catalogue.rows()) == 13


def test_a_folder_that_cannot_be_written_still_lists(logs, monkeypatch):
    def refuse(**_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(module.tempfile, "mkstemp", refuse)
    catalogue = Catalogue(logs)
    assert len(catalogue.rows()) == 5
    assert "cannot be written" in catalogue.note


def test_names_from_outside_are_data_not_sql(tmp_path):
    put(tmp_path, "it's; DROP TABLE catalogue --", 1.0, vehicle="o'neill", mass=1.0)
    (row,) = Catalogue(tmp_path).rows(Filter(vehicle="o'neill"))
    assert row["flight"] == "it's; DROP TABLE catalogue --"


def test_export_is_whole_or_not_at_all(logs, tmp_path):
    import duckdb

    catalogue = Catalogue(logs)
    for name in ("all.parquet", "all.csv"):
        path = catalogue.export(tmp_path / name)
        count = duckdb.connect().execute(f"SELECT count(*) FROM '{path}'").fetchone()
        assert count == (16,)
    with pytest.raises(BadInput, match=r"neither \.parquet nor \.csv"):
        catalogue.export(tmp_path / "all.xlsx")
    with pytest.raises(BadInput, match="cannot be written"):
        catalogue.export(tmp_path / "nowhere" / "all.csv")
    assert sorted(p.name for p in tmp_path.glob("*all*")) == ["all.csv", "all.parquet"]
