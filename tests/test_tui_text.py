"""What the terminal UI says of a flight, as text: checks, streams, distances to limits."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from drivers.samples import Event, Imu, Motors, State
from groundstation.flight.core.ground_check import with_troubles
from groundstation.flight.core.overview import FlightView
from groundstation.flight.core.signals import signals, stream_of
from groundstation.flight.messages import CheckStatus, CoreStatus, StreamStatus
from groundstation.flight.sequence import Phase
from groundstation.flight.sequence import Sequence as FlightSequence
from groundstation.flight.station import load_station
from groundstation.paths import find_config
from groundstation.tui.charts import offered, values, words
from groundstation.tui.checks import WHY, checklist
from groundstation.tui.margins import WALL_M, Announcer, FlightLimits, margin_text, margins
from groundstation.tui.screens.plan import numbers_in
from groundstation.tui.setup import flight_limits
from groundstation.tui.text import stream_notes, stream_rows
from groundstation.tui.widgets.room import DOTS_X, DOTS_Y, ZOOMS, View, _clipped, extent, layout
from groundstation.vehicle import load_vehicle


def status(**values: Any) -> CoreStatus:
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

    checks = {check.name: check for check in view.status(FlightSequence(), cast("Any", Recorder()), 1.0).checks}
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


GUARD = FlightLimits(
    tracking_m=1.2, tilt_rad=np.radians(40.0), empty_v=10.5, box=((-3.0, 3.0), (-3.0, 3.0), (-0.5, 3.0))
)


def test_distance_to_each_limit_of_the_guard():
    now = status(
        position_m=(0.9, -2.5, 1.0), euler_rad=(np.radians(30.5), 0.0, 0.0), tracking_error_m=0.2, battery_v=11.0
    )
    found = {margin.name: margin for margin in margins(now, GUARD)}
    assert {name: margin.used for name, margin in found.items()} == pytest.approx(
        {
            "off plan": 0.2 / 1.2,
            "tilt": 30.5 / 40.0,
            "wall": 1.0 - 0.25 * 0.5 / WALL_M,
            "battery": 1.0 - 0.25 * 0.5 / 0.6,
        }
    )
    assert found["wall"].limit == "to −y" and found["wall"].value == "0.50 m"
    assert [margin.name for margin in found.values() if margin.level] == ["tilt", "battery"]
    lines = str(margin_text(list(found.values()))).splitlines()
    assert max(map(len, lines)) <= 38, "the column of a narrow terminal"
    assert [line.split()[0] for line in lines if "NEAR" in line] == ["tilt", "battery"], "a word beside the colour"


def test_a_healthy_flight_and_the_ground_are_silent():
    said = Announcer()
    for height, tilt in ((0.0, 0.0), (0.0, 2.0), (1.0, 10.0), (0.2, 3.0), (-0.03, 0.0)):
        now = status(position_m=(0.2, 0.1, height), euler_rad=(np.radians(tilt), 0.0, 0.0), battery_v=12.0)
        assert said.news(margins(now, GUARD)) == []
        assert not any(margin.level for margin in margins(now, GUARD))


def test_a_limit_that_is_approached_is_said_once_and_again_only_after_it_was_far():
    said, news = Announcer(), []
    for tilt in (10.0, 31.0, 32.0, 29.0, 31.0, 38.0, 41.0, 20.0, 31.0):
        now = status(euler_rad=(np.radians(tilt), 0.0, 0.0), position_m=(0.0, 0.0, 1.0), battery_v=12.0)
        news.append(said.news(margins(now, GUARD)))
    assert [len(each) for each in news] == [0, 1, 0, 0, 0, 1, 1, 0, 1]
    assert news[1] == ["tilt is near the guard's limit: 31.0° of 40°."]
    assert "the guard acts" in news[6][0]


def test_limits_come_from_the_flights_own_plan_and_the_guard_from_the_station(tmp_path):
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    limits = flight_limits(tmp_path, "default", simulated=True)
    of_station = load_station("default")
    assert limits.room["x_max_m"] == 1.0 and limits.empty_v == 10.5
    assert (limits.tracking_m, limits.tilt_rad) == (of_station.guard.tracking.limit, of_station.guard.tilt.limit)
    assert limits.box == (of_station.box.x_m, of_station.box.y_m, of_station.box.z_m)
    assert limits.path.shape[1] == 3 and len(limits.path) > 100
    assert not len(flight_limits(tmp_path / "absent", "default", simulated=False).path)
    assert flight_limits(tmp_path / "absent", "no such station", simulated=False).box is None


@pytest.mark.parametrize("size", [(41, 18), (69, 20), (85, 56), (8, 8)])
@pytest.mark.parametrize("zoom", ZOOMS)
def test_the_room_is_to_scale_and_both_views_hold_the_plan(size, zoom, tmp_path):
    """One scale along every axis of both views; a dot is as wide as high."""
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    limits = flight_limits(tmp_path, "default", simulated=True)
    low, high = extent(limits, limits.path, zoom)
    above, side = layout(size[0], size[1], low, high)
    assert above.dots_m == side.dots_m
    unit = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    for view in (above, side):
        step = np.diff(view.cells(unit), axis=0)[0] * (DOTS_X, DOTS_Y)
        np.testing.assert_allclose(np.abs(step), view.dots_m)
        assert step[0] > 0.0 > step[1], "right is positive, up is up"
        assert view.holds(view.cells(limits.path)).all()
        assert view.left + view.width <= size[0] and view.top + view.height <= size[1]


def test_a_segment_is_cut_at_the_edge_of_its_view():
    view = View((0, 1), 2, 3, 10, 5, (0.0, 0.0), 4.0)
    cells = np.array([[-50.0, 5.0], [50.0, 5.0], [50.0, 90.0], [np.nan, 0.0]])
    assert list(_clipped(view, cells)) == [(2.0, 5.0, pytest.approx(12.0), 5.0)]


def test_every_recorded_signal_is_offered_with_its_unit_and_drawn():
    samples = [
        Imu(0.0, (0.1, 0.2, 0.3), (0.0, 0.0, 9.8)),
        Motors(0.0, (700.0, 701.0), "rotor_speed"),
        Motors(0.0, (0.5, 0.6), "command"),
        State(0.0, (0.0, 0.0, 1.0), (0.3, 0.4, 0.0), (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    ]
    now = status(signals=signals({stream_of(sample): sample for sample in samples}), tracking_error_m=0.02)
    assert now.signals["imu/gyro_y_rad_s"] == 0.2 and now.signals["command/m2_command"] == 0.6
    names = offered(now)
    assert "imu gyro y, rad/s" in map(words, names) and names[0] == "off plan, cm"
    assert values("off plan, cm", [now]) == [2.0]
    assert values("rotor_speed/m1_rad_s", [now, status()]) == [700.0, pytest.approx(np.nan, nan_ok=True)]
    speed = {margin.name: margin for margin in margins(now, FlightLimits(speed_m_s=3.0))}["speed"]
    assert speed.used == pytest.approx(0.5 / 3.0)


def test_all_wrong_fields_are_named_at_once_by_their_labels():
    numbers, wrong = numbers_in(
        {"budget": "1e9239999", "x_max_m": "abc", "y_max_m": "", "z_max_m": "-1", "tilt_max_rad": "8"}
    )
    assert numbers == {"tilt_max_rad": 8.0}
    assert [text.partition(":")[0] for text in wrong] == ["search for", "room, |x| below", "room, z below"]
    assert numbers_in({"budget": "99999"})[1] == ["search for: at most 3600 s"]
