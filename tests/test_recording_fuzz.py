"""Whatever bytes a file holds: it is read, or refused in a sentence. Never a traceback, never a wrong program state."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from groundstation.errors import BadInput
from groundstation.recording import load_flight, write_bundle, write_mcap
from groundstation.recording.csvfile import parse_csv
from tests.recording_flight import flight
from tests.test_recording_autopilots import quad, write_dataflash, write_ulog
from tests.test_recording_blackbox import flown
from tests.test_recording_crazyflie import IMU_VARIABLES, usd
from tests.written_logs import Px4Log, truth


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sound")
    made = flight(0.6)
    rows = [(1000 * k, 0.0, 0.0, 1.0, 0.1, 0.0, 0.0, 1, 2, 3, 4) for k in range(300)]
    (folder / "log00").write_bytes(usd(rows, IMU_VARIABLES))
    return {
        "mcap": write_mcap(made, folder / "a.mcap").read_bytes(),
        "ulg": write_ulog(folder / "a.ulg", made).read_bytes(),
        "bin": write_dataflash(folder / "a.bin", made).read_bytes(),
        "usd": (folder / "log00").read_bytes(),
        "bbl": flown(folder, truth()[1]).read_bytes(),
        "outputs.ulg": Px4Log(limits=dict.fromkeys((1, 2, 3, 4), (1000.0, 2000.0)), esc_places=(1, 0, 3, 2)).write(
            *truth()
        ),
    }


@pytest.mark.parametrize("kind", ["mcap", "ulg", "bin", "usd", "bbl", "outputs.ulg"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_bytes_anywhere(tmp_path_factory, files, kind, data):
    body = bytearray(files[kind])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(body) - 1))
        patch = data.draw(st.binary(min_size=1, max_size=12))
        body[at : at + len(patch)] = patch
    if data.draw(st.booleans()):
        body = body[: data.draw(st.integers(0, len(body)))]
    path = tmp_path_factory.mktemp("fuzz") / f"a.{kind}"
    path.write_bytes(bytes(body))
    try:
        load_flight(path, vehicle=None if kind == "mcap" else quad())
    except BadInput as error:
        assert "\n" not in str(error)


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=200) | st.text(alphabet='0123456789.,;"\n\r et_sinfaxy-+#', max_size=200).map(str.encode))
def test_any_csv(data):
    try:
        columns = parse_csv(data, "x.csv", frozenset(("t_s",)))
    except BadInput as error:
        assert str(error).startswith("x.csv: ")
        return
    lengths = {len(c) for c in (*columns.numbers.values(), *columns.texts.values())}
    assert len(lengths) <= 1


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_a_bundle_with_any_file_damaged(tmp_path_factory, data):
    folder = write_bundle(flight(0.5), tmp_path_factory.mktemp("fuzz") / "b")
    names = sorted(path.name for path in folder.iterdir())
    path = folder / data.draw(st.sampled_from(names))
    body = bytearray(path.read_bytes())
    at = data.draw(st.integers(0, len(body) - 1))
    patch = data.draw(st.binary(min_size=1, max_size=6))
    body[at : at + len(patch)] = patch
    path.write_bytes(bytes(body))
    with contextlib.suppress(BadInput):
        load_flight(folder)
