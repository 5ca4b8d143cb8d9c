"""Indoors on the emulated autopilots, on virtual time: poses into the estimator, its parameters, cameras that go
dark.
"""

from __future__ import annotations

import math
import random
import socket
from collections import deque

import numpy as np
import pytest
from emulated import RigidAirframe, quadrotor
from mavlink_vehicle import small_plan

from drivers.mavlink.geometry import rotate
from drivers.mocap.natnet import NatNet
from drivers.mocap.readings import Exchange
from drivers.samples import Event, Pose
from groundstation.errors import BadInput
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.markers import Markers
from groundstation.flight.link.phase import IN_AIR, Phase
from groundstation.flight.link.pilot import Pilot
from groundstation.flight.link.pose_latency import Latency, latency_sentence
from groundstation.flight.link.preflight import failures
from groundstation.flight.link.profiles import PROFILES
from groundstation.flight.station import MarkerCalibration, MocapSource, station_from_dict
from groundstation.vehicle import Mocap
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.px4 import Px4
from sim.natnet import BODY, NatNetServer
from sim.scenario import Clock

KINDS = {"px4": Px4, "arducopter": ArduCopter}
BOTH = pytest.mark.parametrize("kind", KINDS)
LATE_S = 0.02
SEED = 3


class Room:
    """A link core, an emulated autopilot and cameras of 100 Hz on one clock; poses come, and are stamped, ``LATE_S``
    late.
    """

    def __init__(self, kind: str, *, set_parameters: bool = True, declared_s: float = 0.0, yaw_rad: float = 0.0):
        vehicle = quadrotor()
        self.autopilot = KINDS[kind](vehicle, RigidAirframe(vehicle), boot_s=60.0)
        self.autopilot.add_link("link", "companion")
        station = station_from_dict(
            {"indoors": True, "mocap": {"system": "natnet", "latency_s": declared_s},
             "policy": {"climb_m_s": 1.0, "settle_s": 1.0}}
        )  # fmt: skip
        self.core = LinkCore(vehicle, station, Options(set_parameters=set_parameters, keep_raw=False))
        self.now_s, self.step_s, self.lit = 0.0, 0.01, True
        self.told: list[Event] = []
        self._random = random.Random(SEED)
        self._turn = (math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2))
        self._seen: deque[Pose] = deque()
        self._outgoing: list[bytes] = []

    def step(self) -> None:
        self.now_s += self.step_s
        frames = self.autopilot.step(self.now_s, [("link", data) for data in self._outgoing])
        self.core.core_heard(self.now_s)
        out = self.core.step(self.now_s, [("vehicle", data) for _, data in frames])
        self._outgoing = out.send
        self.told += [s for s, _ in out.samples if isinstance(s, Event)]
        truth = self.autopilot.truth
        (w, x, y, z), (a, _, _, b) = truth.quaternion, self._turn
        turned = (a * w - b * z, a * x - b * y, a * y + b * x, a * z + b * w)
        self._seen.append(Pose(self.now_s, rotate(self._turn, truth.position_m), turned))
        while self._seen[0].device_s <= self.now_s - LATE_S + 1e-9:
            pose = self._seen.popleft()
            if self.lit:
                x, y, z = (p + self._random.gauss(0.0, 1e-3) for p in pose.position_m)
                late = Pose(self.now_s, (x, y, z), pose.quaternion)
                self._outgoing = self._outgoing + self.core.pose(late, self.now_s).send

    def run(self, until, limit_s: float = 60.0) -> bool:
        end = self.now_s + limit_s
        while not until() and self.now_s < end:
            self.step()
        return until()

    @property
    def pilot(self) -> Pilot:
        """Of the flight, once a vehicle was heard."""
        assert self.core.pilot is not None
        return self.core.pilot

    def fly_until(self, phase) -> None:
        """Prepared, uploaded, armed, started, and on until it is so."""
        assert self.run(lambda: self.core.ready, 90.0), self.core.trouble
        taken = self.core.upload(small_plan(), self.now_s)
        assert taken.ok, taken.reason
        armed = self.core.order("arm", self.now_s)
        assert self.run(lambda: armed.ok is not None, 10.0)
        assert armed.ok, armed.reason
        if phase == "armed":
            return
        self.core.order("start", self.now_s)
        pilot = self.pilot
        reached = {
            "climbing": lambda: self.autopilot.truth.position_m[2] > 0.4,
            "exciting": lambda: pilot.exciting,
            "landing": lambda: pilot.phase is Phase.LANDING,
        }[phase]
        assert self.run(reached, 60.0), (pilot.phase, pilot.reason)

    def down(self, limit_s: float = 30.0) -> bool:
        return self.run(lambda: self.pilot.phase not in IN_AIR and not self.autopilot.armed, limit_s)

    def said(self, kind: str) -> list[str]:
        return [e.text for e in self.told if e.kind == kind]


@BOTH
def test_parameters_are_set_poses_fused_the_plan_flown_their_latency_measured_and_all_restored(kind):
    room = Room(kind)
    before = {p.name: p.value for p in room.autopilot.parameters.all}
    room.fly_until("landing")
    fusion = next(c for c in room.core.checks if c.name == "fusion")
    assert fusion.ok and "uses the poses" in fusion.reason
    assert failures(room.core.checks) == ""
    assert room.autopilot.estimator.source == "vision"
    assert room.down()
    assert room.pilot.reason == ""
    (sentence,) = room.said("latency")
    measured_s = float(sentence.split("stamped ")[1].split(" ms")[0]) * 1e-3
    assert measured_s == pytest.approx(LATE_S, abs=0.006), sentence  # the stamps of a step are 10 ms apart here
    assert "write into [mocap]" in sentence
    set_to = dict(room.core.changed)
    assert {"px4": "EKF2_EV_CTRL", "arducopter": "EK3_SRC1_POSXY"}[kind] in set_to
    room.core.restore_parameters()
    assert room.run(lambda: not room.core.changed, 20.0)
    assert {n: v for n, v in before.items() if room.autopilot.parameters[n] != v} == {}
    if kind == "arducopter":
        assert room.core.view is not None and room.core.view.restarts == 1, "VISO_TYPE takes effect at a start"


@BOTH
def test_a_declared_latency_is_told_to_the_estimator(kind):
    room = Room(kind, declared_s=LATE_S)
    assert room.run(lambda: room.core.ready, 90.0), room.core.trouble
    name = {"px4": "EKF2_EV_DELAY", "arducopter": "VISO_DELAY_MS"}[kind]
    assert room.autopilot.parameters[name] == 1e3 * LATE_S


@pytest.mark.parametrize(
    ("kind", "phase"),
    [("px4", "armed"), ("px4", "climbing"), ("px4", "exciting"), ("px4", "landing"), ("arducopter", "exciting")],
)
def test_cameras_that_go_dark_at_any_phase_end_safe(kind, phase):
    room = Room(kind)
    room.fly_until(phase)
    room.lit, dark_s = False, room.now_s
    if phase == "armed":
        room.run(lambda: False, 0.5)
        room.core.order("start", room.now_s)
    assert room.down()
    assert room.now_s - dark_s < 15.0
    assert math.dist(room.autopilot.truth.position_m[:2], (0.0, 0.0)) < 1.5
    if phase != "landing":
        assert "no new motion-capture pose" in room.pilot.reason


@BOTH
def test_without_leave_to_set_parameters_the_flight_is_refused_with_their_names(kind):
    room = Room(kind, set_parameters=False)
    assert room.run(lambda: room.core.ready, 90.0)
    taken = room.core.upload(small_plan(), room.now_s)
    assert taken.ok is False
    assert {"px4": "EKF2_EV_CTRL: is 0", "arducopter": "VISO_TYPE: is 0"}[kind] in taken.reason
    assert "--set-parameters" in taken.reason


@BOTH
def test_a_room_turned_against_north_is_flown_by_the_yaw_of_the_poses(kind):
    room = Room(kind, yaw_rad=2.0)
    room.fly_until("armed")
    frames = next(c for c in room.core.checks if c.name == "frames")
    assert frames.ok, frames.reason


def test_poses_that_only_are_recorded_do_not_reach_the_vehicle():
    station = station_from_dict({"indoors": False, "mocap": {"system": "natnet"}})
    assert not station.flies_by_poses
    room = Room("px4")
    assert room.run(lambda: room.core.view is not None, 5.0)
    core = LinkCore(quadrotor(), station, Options(keep_raw=False))
    core.view, core.pilot = room.core.view, room.core.pilot
    assert core.pose(Pose(0.0, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)), 0.0).send == []


def test_indoors_needs_cameras():
    with pytest.raises(BadInput, match=r"name the .mocap. system"):
        station_from_dict({"indoors": True})


def test_a_latency_as_declared_asks_for_nothing_and_a_calibrated_system_for_a_calibration():
    late = Latency(0.0202, 1e-4)
    assert "write" not in latency_sentence(late, 5e-4, MocapSource(latency_s=0.02))
    assert "latency_s = 0.02" in latency_sentence(late, 5e-4, MocapSource())
    known = MarkerCalibration(
        body="1", measured="2026-11-29", position_m=(0, 0, 0), rotation_rad=(0, 0, 0), delay_s=0.02
    )
    assert "calibrate` again" in latency_sentence(late, 5e-4, MocapSource(calibration=known))
    assert "calibrate" not in latency_sentence(Latency(0.0002, 1e-4), 5e-4, MocapSource(calibration=known))


def test_a_delay_is_counted_once():
    section = {
        "body": "1",
        "measured": "2026-11-29",
        "position_m": [0, 0, 0],
        "rotation_rad": [0, 0, 0],
        "delay_s": 0.02,
    }
    with pytest.raises(BadInput, match="counts a delay twice"):
        station_from_dict({"mocap": {"system": "natnet", "latency_s": 0.015, "calibration": section}})
    assert station_from_dict({"mocap": {"system": "natnet", "calibration": section}}).mocap.calibration is not None


def test_the_body_lies_behind_its_markers_as_the_vehicle_file_says():
    markers = Markers(Mocap(position_m=(0.1, 0.0, 0.05), rotation_rad=(0.0, 0.0, math.pi / 2)))
    half = math.sqrt(0.5)
    body = markers.body(Pose(1.0, (1.0, 2.0, 3.0), (half, 0.0, 0.0, half)))
    np.testing.assert_allclose(body.quaternion, (1.0, 0.0, 0.0, 0.0), atol=1e-12)
    np.testing.assert_allclose(body.position_m, (0.9, 2.0, 2.95), atol=1e-12)


def test_the_simulated_optitrack_server_sends_after_its_latency_and_tells_its_clock():
    server, reader = NatNetServer("127.0.0.1:0", Clock(offset_s=0.5), monotonic=lambda: 0.0), NatNet()
    client = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    client.settimeout(5.0)

    def heard(received_s: float) -> list:
        return reader.feed(client.recv(4096), received_s)

    try:
        for data in reader.due(0.0):
            client.sendto(data, ("127.0.0.1", server.port))
        row = np.array([[1.0, 2.0, 3.0, 0.8, 0.0, 0.0, 0.6]])
        poses = [(np.array([1.5]), np.array([1.015]), row)]
        server.turn(1.0, poses)
        assert poses == [] and server.sent == 0, "not yet"
        server.turn(1.02, [])
        assert server.sent == 1
        assert heard(1.02) == [] and reader.server.startswith("Motive")
        (frame,) = heard(1.02)
        body = frame.body("1")
        assert body.position_m == (1.0, 2.0, 3.0)
        assert body.quaternion == pytest.approx((0.8, 0.0, 0.0, 0.6))
        assert frame.exposure_s == pytest.approx(101.5, abs=1e-7)
        assert frame.sent_s - frame.exposure_s == pytest.approx(0.02, abs=1e-7)
        for data in reader.due(1.03):
            client.sendto(data, ("127.0.0.1", server.port))
        server.turn(1.03, [])
        told = [reading for _ in range(2) for reading in heard(1.03)]  # names, and the clock
        assert reader.names == (BODY,)
        (clock,) = told
        assert isinstance(clock, Exchange) and clock.sent_s == pytest.approx(1.03)
        assert clock.server_s == pytest.approx(101.53, abs=1e-7)
        server.covered = True
        server.turn(1.05, [(np.array([1.51]), np.array([1.04]), row)])
        assert server.sent == 1
    finally:
        client.close()
        server.close()


def test_an_origin_is_where_each_firmware_wants_it():
    """PX4 takes heights of poses for altitudes; ArduCopter takes an altitude of 0 for none, and its height ran away."""
    assert PROFILES["px4"]().origin().altitude == 0
    assert PROFILES["arducopter"]().origin().altitude > 0
