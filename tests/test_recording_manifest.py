"""The manifest of a flight: what it proves, and what changes its word."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundstation.errors import Refused
from groundstation.recording import manifest
from groundstation.recording.manifest import NAME, is_signed, key_file, provenance, signed, write_manifest
from groundstation.reporting.report import write_report
from tests import reporting_fixture as fixture

KEY = bytes(range(32))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    """A closed flight."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    flight = tmp_path / "flight"
    flight.mkdir()
    (flight / "flight.mcap").write_bytes(b"samples")
    (flight / "plan.toml").write_text("a = 1")
    assert write_manifest(flight, ("flight.mcap", "plan.toml"), {"plan.toml": flight / "plan.toml"}) == ""
    (flight / "raw.tlog").write_bytes(b"frames")
    assert write_manifest(flight, ("raw.tlog",), {"plan.toml": flight / "plan.toml"}) == ""
    return flight


def test_data_are_as_flown_and_the_key_is_its_owner_s_alone(folder):
    assert provenance(folder / "flight.mcap").startswith("The data are as flown: ")
    assert set(json.loads((folder / NAME).read_text())["files"]) == {"flight.mcap", "plan.toml", "raw.tlog"}
    assert stat.S_IMODE(key_file().stat().st_mode) == 0o600
    assert [path.name for path in key_file().parent.iterdir()] == ["manifest.key"]
    (folder / "onboard.ulg").write_bytes(b"later")
    assert "onboard.ulg came later" in provenance(folder / "flight.mcap")


def test_the_report_says_so_or_names_the_file(folder):
    refused = Refused("nothing was flown; fly.")
    text = write_report(folder / "report.html", fixture.flight(), refused).read_text()
    assert "The data are as flown: " in text[text.index('id="reproduce"') :]
    (folder / "raw.tlog").write_bytes(b"other frames")
    text = write_report(folder / "report.html", fixture.flight(), refused).read_text()
    assert "The data are not as flown: raw.tlog changed" in text and "The data are as flown" not in text


@pytest.mark.parametrize("name", ["flight.mcap", "plan.toml", "raw.tlog"])
def test_the_file_that_changed_is_named(folder, name):
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    assert provenance(folder / "flight.mcap") == (
        f"The data are not as flown: {name} changed after the flight was closed."
    )
    (folder / name).unlink()
    assert f"{name} is missing" in provenance(folder / "flight.mcap")


def test_a_sum_that_was_put_right_after_a_change_is_no_signature(folder):
    (folder / "flight.mcap").write_bytes(b"other samples")
    document = json.loads((folder / NAME).read_text())
    document["files"]["flight.mcap"] = manifest.checksum(folder / "flight.mcap")
    (folder / NAME).write_text(json.dumps(document))
    assert "was changed after this station signed it" in provenance(folder / "flight.mcap")


def test_a_second_look_blesses_no_change(folder):
    (folder / "flight.mcap").write_bytes(b"other samples")
    assert write_manifest(folder, ("flight.mcap",), {}) == ""
    assert "flight.mcap changed" in provenance(folder / "flight.mcap")


def test_another_station_s_manifest_is_not_taken_for_this_one_s(folder, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "elsewhere"))
    assert "another station signed" in provenance(folder / "flight.mcap")
    assert not key_file().exists(), "reading makes no key"
    (folder / "flight.mcap").write_bytes(b"other samples")
    assert "flight.mcap changed" in provenance(folder / "flight.mcap")


def test_what_cannot_be_written_is_one_sentence(folder):
    key_file().chmod(0o644)
    assert "others may read it" in write_manifest(folder, ("flight.mcap",), {})
    key_file().chmod(0o600)
    assert "was not written" in write_manifest(folder / "gone", ("flight.mcap",), {})
    assert "was not written" in write_manifest(folder, (), {"plan.toml": folder / "nowhere"})


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{}", '{"files": 3}', '{"files": {"../../x": "0"}}', '{"files": {"flight.mcap": 5}}', '{"files": []}',
     '{"files": {"flight.mcap": "0"}, "key": [], "signature": "\\ud800"}'],
)  # fmt: skip
def test_a_foreign_manifest_is_a_sentence_and_never_as_flown(folder, text):
    (folder / NAME).write_text(text)
    said = provenance(folder / "flight.mcap")
    assert said and "The data are as flown" not in said


@given(st.dictionaries(st.text(max_size=8), st.text(max_size=8), max_size=3), st.binary(min_size=32, max_size=32))
def test_only_the_key_signs_and_only_what_it_says(files, other):
    document = signed(files, {}, KEY)
    assert is_signed(json.loads(json.dumps(document)), KEY)
    assert other == KEY or not is_signed(document, other)
    assert not is_signed({**document, "files": {**files, "more": "0"}}, KEY)


def test_two_processes_that_make_the_key_use_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    made = manifest.station_key(make=True)
    manifest._make_key(key_file())  # the second, which found none a moment ago
    assert manifest.station_key(make=True) == made and len(list(key_file().parent.iterdir())) == 1
