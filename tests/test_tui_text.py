"""What the terminal UI says of a flight, as text: checks, streams, distances to limits."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.samples import Event
from groundstation.flight.core.ground_check import with_troubles
from groundstation.flight.core.overview import FlightView
from groundstation.flight.messages import CheckStatus, CoreStatus, StreamStatus
from groundstation.flight.sequence import Phase
from groundstation.flight.sequence import Sequence as FlightSequence
from groundstation.flight.station import load_station
from groundstation.paths import find_config
from groundstation.tui.checks import WHY, checklist
from groundstation.tui.setup import flight_limits
from groundstation.tui.text import margin_lines, stream_notes, stream_rows
from groundstation.vehicle import load_vehicle


def status(**values: object) -> CoreStatus:
    return CoreStatus("flight", "folder", "qball2", **values)


def test_each_check_says_what_was_seen_what_to_do_and_why_and_the_failed_come_first():
    text = checklist(
        status(
            phase=Phase.UPLOADED,
            checks=(CheckStatus("imu", True, "arrives at 500 Hz"), CheckStatus("battery", False, "14 %; charge it")),
        )
    )
    assert text.index("[FAIL] battery: 14 %; charge it (why: it must last") < text.index(
        "[ ok ] imu: arrives at 500 Hz"
    )
    assert "[ ok ] the plan is uploaded" in text
    assert "[ …  ] everything below is checked" in text


def test_an_end_says_why_and_a_good_end_is_no_trouble():
    assert "! the compass says no" in checklist(status(phase=Phase.ABORTED, reason="the compass says no"))
    assert "!" not in checklist(status(phase=Phase.DONE, reason="identified by IV"))


def test_every_check_of_the_link_has_its_why():
    """Names in the preflight that are no parameters of the autopilot."""
    source = (find_config("stations", "default").parents[2] / "groundstation/flight/link/preflight.py").read_text()
    for name in ("link", "streams", "arming", "disarmed", "estimate", "clock", "battery", "log", "disk", "poses",
                 "frames", "plan", "room", "vibration", "oscillation"):  # fmt: skip
        assert f'"{name}"' in source
        assert name in WHY


def test_the_checks_of_a_link_reach_the_view(tmp_path):
    view = FlightView(tmp_path, load_vehicle(find_config("vehicles", "x500")))
    for text in (
        "battery failed: 14 %; charge it",
        "MC_RATE forced: 3 instead of 0",
        "link ok: last heartbeat 0.1 s ago",
    ):
        view.see([Event(0.0, "preflight", text)], Phase.PLANNED)

    class Recorder:
        recorded = lost_batches = 0

        def streams(self, host_s):
            return {"imu": StreamStatus(500, 500.0)}

    checks = {check.name: check for check in view.status(FlightSequence(), Recorder(), 1.0).checks}
    assert checks["battery"] == CheckStatus("battery", False, "14 %; charge it")
    assert checks["MC_RATE"] == CheckStatus("MC_RATE", True, "forced: 3 instead of 0")
    assert checks["link"].ok and checks["imu"].ok
    assert not checks["motors"].ok and "switch the motors' stream on" in checks["motors"].text


@pytest.mark.parametrize(
    ("stream", "said"),
    [
        (StreamStatus(900, 100.0, age_s=1.4), "silent for 1.4 s; look whether the cameras see the markers"),
        (StreamStatus(900, 100.0, longest_gap_s=0.8), "had a gap of 0.8 s"),
        (StreamStatus(), "nothing came yet"),
    ],
)
def test_what_is_wrong_with_a_stream_comes_with_what_to_do(stream, said):
    streams = with_troubles(
        {"pose": stream, "imu": StreamStatus(10, 500.0), "motors": StreamStatus(9, 500.0)}, in_flight=True
    )
    now = status(streams=streams)
    assert f"! pose: {said}" in stream_notes(now)
    assert "! imu" not in stream_notes(now)
    assert dict((row[0], row[-1]) for row in stream_rows(now)) == {
        "pose": "! see below",
        "imu": "arrives",
        "motors": "arrives",
    }


def test_a_needed_stream_that_never_came_is_told():
    assert with_troubles({}, in_flight=False)["motors"].trouble.startswith(
        "nothing came yet; switch the motors' stream on"
    )


def test_clocks_are_told_with_their_interval():
    streams = {"pose": StreamStatus(9, 100.0), "imu": StreamStatus(9, 500.0)}
    assert "motion capture minus IMU +12.3 ± 0.9 ms" in stream_notes(status(streams=streams, clock_s=(0.0123, 0.0009)))
    assert "not known yet" in stream_notes(status(streams=streams))


@pytest.mark.parametrize("began_s", [0.0, 4000.0])
def test_latency_is_told_against_the_least_where_device_clocks_began_at_another_time(began_s):
    streams = {
        "pose": StreamStatus(9, 100.0, delay_s=began_s + 0.012, delay_std_s=2e-3),
        "imu": StreamStatus(9, 500.0, delay_s=began_s + 0.002, delay_std_s=5e-4),
        "motors": StreamStatus(),
    }
    latency = {row[0]: row[-2] for row in stream_rows(status(streams=streams))}
    if began_s:
        assert latency == {"pose": "10.0 ± 2.0 ms", "imu": "0.0 ± 0.5 ms", "motors": "–"}
    else:
        assert latency == {"pose": "12.0 ± 2.0 ms", "imu": "2.0 ± 0.5 ms", "motors": "–"}


def test_distance_to_each_limit():
    now = status(
        position_m=(0.9, -1.2, 1.0), euler_rad=(np.radians(3.0), 0.0, 0.0), tracking_error_m=0.2, battery_v=11.0
    )
    limits = {"x_max_m": 1.0, "y_max_m": 1.0, "z_max_m": 1.5, "z_min_m": 0.7, "tilt_max_rad": np.radians(5.0)}
    guard = {"tracking_m": 1.2, "tilt_rad": np.radians(40.0), "empty_v": 10.5}
    lines = margin_lines(now, limits, guard).splitlines()
    assert [float(line[17:].split()[0]) for line in lines] == pytest.approx([0.1, -0.2, 0.5, 0.3, 2.0, 1.0, 37.0, 0.5])
    assert not [line for line in lines if "PAST IT" in line], "the plan's own limit is no alarm"
    past = margin_lines(now, limits, guard | {"tilt_rad": 0.01}).splitlines()
    assert [line.split()[1] for line in past if "PAST IT" in line] == ["guard:"]
    assert max(map(len, lines)) <= 34, "the column of a narrow terminal"


def test_limits_come_from_the_flights_own_plan_and_the_guard_from_the_station(tmp_path):
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    limits, guard = flight_limits(tmp_path, "default")
    assert limits["x_max_m"] == 1.0
    of_station = load_station("default").guard
    assert guard == {"empty_v": 10.5, "tracking_m": of_station.tracking.limit, "tilt_rad": of_station.tilt.limit}
    assert flight_limits(tmp_path / "absent", None) == ({}, {})
