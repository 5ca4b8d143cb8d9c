"""Long logs: the stretch that tells most is used and told, all of it on demand; whoever waits is told so."""

from __future__ import annotations

import itertools
import threading

import numpy as np
import pytest

from drivers.samples import Imu, Motors
from groundstation.commands.common import ProgressLine
from groundstation.errors import BadInput
from groundstation.flightdata import IMU_COLUMNS, Stream, motor_columns
from groundstation.paths import find_config
from groundstation.recording import McapRecorder, bundle, load, load_flight, read_recording, write_bundle
from groundstation.recording.mcapfile import read_mcap
from groundstation.recording.part import Part
from groundstation.recording.thinning import KEPT_S, LONG_S, informative_stretch
from groundstation.vehicle import load_vehicle, vehicle_from_dict, vehicle_to_dict
from studies import log_memory, long_logs
from tests.recording_flight import flight


def by_commands(name):
    """A shipped vehicle whose motors are known by their commands."""
    document = vehicle_to_dict(load_vehicle(find_config("vehicles", name)))
    document["rotors"]["input"] = "command"
    return vehicle_from_dict(document)


def long_streams(busy_from, seconds=900.0, rate=20.0):
    """Hovering, but for three minutes of motion; carried about before the motors turn, and a hard landing."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    rng = np.random.default_rng(3)
    values = rng.normal(size=(len(t), 6)) * 0.01
    values[:, 5] += 9.8
    busy = (t >= busy_from) & (t < busy_from + 180.0)
    values[busy, :3] += np.sin(t[busy, None] * [2.0, 3.0, 1.0])
    values[t < 60.0] += 20.0 * np.sin(t[t < 60.0, None] * [2.0, 3.0, 1.0, 2.0, 3.0, 1.0])
    values[-20:, 3:] += 80.0 * np.sin(np.arange(20.0))[:, None]
    motors = np.full((len(t), 4), 500.0)
    motors[t < 60.0] = 0.0
    return Stream(t, values, IMU_COLUMNS), Stream(t, motors, motor_columns("rotor_speed", 4))


@pytest.mark.parametrize("busy_from", [100.0, 333.0, 700.0])
def test_the_stretch_in_which_the_vehicle_moves_is_found(busy_from):
    found = informative_stretch(*long_streams(busy_from))
    assert found.end_s - found.start_s == KEPT_S
    assert found.start_s == pytest.approx(busy_from, abs=2.0)


def test_a_flight_of_ten_minutes_is_used_whole():
    imu, motors = long_streams(100.0, LONG_S)
    assert informative_stretch(imu, motors) is None
    assert informative_stretch(None, long_streams(100.0)[1]) is None


def test_a_long_flight_is_cut_and_told_and_used_whole_on_demand(tmp_path):
    imu, motors = long_streams(333.0)
    made = flight(2.0)
    whole = type(made)(name="long", vehicle=made.vehicle, motors=motors, imu=imu)
    write_bundle(whole, tmp_path / "b")
    cut = load_flight(tmp_path / "b")
    assert cut.motors.t_s[-1] - cut.motors.t_s[0] == pytest.approx(KEPT_S, abs=0.1)
    assert any("of 900 s those from 333" in note and "--all" in note for note in cut.notes)
    assert len(load_flight(tmp_path / "b", everything=True).motors) == len(motors)
    assert load_flight(tmp_path / "b", start_s=70.0, end_s=800.0).motors.t_s[-1] > 799.0


def test_nobody_waits_two_seconds_without_a_word(capsys):
    clock = [0.0]
    line = ProgressLine(clock=lambda: clock[0])
    spoken = []
    for k in range(100):
        clock[0] = 0.1 * k
        if k == 40:
            line.fraction(0.5, "fitting")
        line.quiet("reading big.ulg", 0.0)
        if said := capsys.readouterr().err.strip():
            spoken.append((clock[0], said))
    assert spoken[0] == (1.5, "reading big.ulg: 2 s")
    assert max(b[0] - a[0] for a, b in itertools.pairwise([(0.0, ""), *spoken, (9.9, "")])) < 2.0
    assert spoken[-1][1].startswith("fitting: ")


def test_the_line_is_kept_alive_by_itself():
    line = ProgressLine()
    with line.ticking("reading"):
        assert "progress" in [thread.name for thread in threading.enumerate()]
    assert "progress" not in [thread.name for thread in threading.enumerate()]


@pytest.mark.parametrize("name", list(long_logs.WRITERS))
def test_a_large_log_is_read_in_two_passes_and_gives_what_one_would(tmp_path, monkeypatch, name):
    monkeypatch.setattr(long_logs, "RATE_HZ", 25.0)
    file, write = long_logs.WRITERS[name]
    write(tmp_path / file, 11.0)
    vehicle = by_commands("x500")
    once = load_flight(tmp_path / file, vehicle=vehicle)
    part = load_flight(tmp_path / file, vehicle=vehicle, start_s=100.0, end_s=130.0)
    read = []
    monkeypatch.setattr(load, "LARGE_BYTES", 0)
    monkeypatch.setattr(bundle, "_LARGE_BYTES", 0)
    monkeypatch.setattr(load, "read_recording", lambda *given: read.append(read_recording(*given)) or read[-1])
    twice = load_flight(tmp_path / file, vehicle=vehicle)
    assert [len(recording.streams["motors"]) < 200.0 * 25.0 for recording in read] == [False, True]
    assert any("of 660 s those from" in note for note in twice.notes)
    for flown, other in (
        (twice, once),
        (load_flight(tmp_path / file, vehicle=vehicle, start_s=100.0, end_s=130.0), part),
    ):
        for key, stream in other.streams().items():
            assert np.array_equal(flown.streams()[key].t_s, stream.t_s)
            assert np.array_equal(flown.streams()[key].values, stream.values)
    with pytest.raises(BadInput, match=r"the flight lasts from 1\.0 to 66"):
        load_flight(tmp_path / file, vehicle=vehicle, start_s=5000.0)


def test_a_recording_whose_stamps_need_companions_is_thinned_with_them(tmp_path):
    """Stamps that whole nanoseconds do not give back: each message has a companion with the exact ones."""
    t = np.arange(3000) / 997.0
    with McapRecorder(tmp_path / "a.mcap") as recorder:
        for k, x in enumerate(t.tolist()):
            recorder.add(Imu(x, (float(k), 0.0, 0.0), (0.0, 0.0, 9.8)), x + 0.002)
            recorder.add(Motors(x, (0.5,) * 4, "command"), x + 0.002)
    thin = read_mcap(tmp_path / "a.mcap", Part(step_s=0.02)).streams["imu"]
    assert np.allclose(thin.t_s, t[thin.values[:, 0].astype(int)], rtol=0.0, atol=1e-9)
    assert 130 < len(thin) <= 151
    part = read_mcap(tmp_path / "a.mcap", Part(1.0, 1.5)).streams["imu"]
    assert np.array_equal(part.t_s, t[(t >= 1.0) & (t <= 1.5)])


def test_a_long_logs_memory_goes_by_what_is_used_of_it(tmp_path):
    """Of eleven minutes at 1 kHz three are used.

    They take 2.7 times their samples; read whole, the log takes 6.2 times as much.
    """
    file, write = long_logs.WRITERS["PX4 ULog"]
    write(tmp_path / "short.ulg", 0.1)
    write(tmp_path / file, 11.0)
    base, found = log_memory.measured(tmp_path / "short.ulg", False), log_memory.measured(tmp_path / file, False)
    assert found["used_mb"] == pytest.approx(16.5, abs=0.5)
    assert found["peak_mb"] - base["peak_mb"] < 4.5 * found["used_mb"] < log_memory.FACTOR * found["used_mb"]


@pytest.mark.parametrize("parameter", [300.0, 630.0])
def test_a_parameter_that_changes_outside_the_stretch_is_not_told_of_it(tmp_path, parameter):
    """Its time is that of the sample before it, whether that one is kept or not."""
    from groundstation.recording.ulogfile import decode_ulog
    from sim.mavlink.ulog import ULogWriter

    log = ULogWriter(0, {"sensor_combined": "uint64_t timestamp;float x;"}, {}, [("A", True, 1.0)])
    for k in range(700):
        log.add("sensor_combined", k * 1_000_000, 0.0)
        if k == parameter:
            log.parameter("A", True, 2.0)
    found = decode_ulog(np.frombuffer(bytes(log.data), np.uint8), Part(400.0, 500.0))
    assert len(found.topics["sensor_combined", 0]) == 101
    assert found.settings.histories["A"][-1] == (parameter, 2.0)
    thin = decode_ulog(np.frombuffer(bytes(log.data), np.uint8), Part(step_s=10.0))
    assert thin.topics["sensor_combined", 0].seconds().tolist() == list(np.arange(0.0, 700.0, 10.0))
