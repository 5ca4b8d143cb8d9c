"""Recordings that lie in tests/golden: every version must read them to the same doubles."""

from __future__ import annotations

import json

import pytest

from groundstation.errors import BadInput
from groundstation.recording import convert, load_flight, read_recording
from tests.golden.regenerate import HERE, figures, sample_recording

EXPECTED = json.loads((HERE / "expected.json").read_text(encoding="utf-8"))


def plain(document):
    return json.loads(json.dumps(document))


@pytest.mark.parametrize("name", sorted(EXPECTED))
def test_an_old_recording_reads_as_it_always_did(name):
    assert plain(figures(HERE / name)) == EXPECTED[name]


def test_a_recording_and_its_bundle_hold_the_same():
    for version in {name.rsplit("-", 1)[1].removesuffix(".mcap") for name in EXPECTED}:
        one, other = plain(EXPECTED[f"recording-{version}.mcap"]), plain(EXPECTED[f"bundle-{version}"])
        assert one == other


def test_what_was_recorded_is_what_lies_there():
    made, read = sample_recording(), read_recording(HERE / "recording-1.mcap")
    assert read.window_s == made.window_s
    assert {k: t.rows for k, t in read.texts.items()} == {k: t.rows for k, t in made.texts.items()}
    for name, stream in made.streams.items():
        assert read.streams[name].t_s.tolist() == stream.t_s.tolist()


def test_todays_writer_still_writes_what_todays_schema_says(tmp_path):
    """If this fails the written form has changed: raise the schema version and add golden files of the new one."""
    convert(HERE / "bundle-1", tmp_path / "a.mcap")
    assert plain(figures(tmp_path / "a.mcap")) == EXPECTED["recording-1.mcap"]


def test_a_recording_of_a_later_schema_is_refused_in_a_sentence(tmp_path):
    data = (HERE / "recording-1.mcap").read_bytes()
    path = tmp_path / "a.mcap"
    path.write_bytes(data.replace(b"groundstation.recording/1", b"groundstation.recording/9"))
    with pytest.raises(BadInput, match=r"groundstation\.recording/9.*Update"):
        load_flight(path)
