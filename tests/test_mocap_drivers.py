"""What every motion-capture driver promises, each against a server that speaks the real wire format on loopback."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false,
# reportOperatorIssue=false
from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from drivers.mocap.serverclock import ServerClock
from drivers.mocap.session import SYSTEMS, Arrived, Session
from drivers.mocap.source import FrameReader
from drivers.samples import Event, Pose
from sim.mocap.scene import Figure
from sim.mocap.server import Server, Setup

PATIENCE_S = 20.0


@dataclass
class Client:
    """A session driven by hand."""

    session: Session
    server: Server
    body: str

    def collect(self, count: int, *, after=lambda arrived: True) -> list[Arrived]:
        """That many frames of which ``after`` holds, with the body or without."""
        out: list[Arrived] = []
        deadline = time.monotonic() + PATIENCE_S
        while len(out) < count and time.monotonic() < deadline:
            for arrived in self.session.poll(0.02):
                ours = arrived.frame.body(self.body) is not None or self.body in arrived.frame.lost
                if (ours or not arrived.frame.bodies) and after(arrived):
                    out.append(arrived)
        assert len(out) >= count, f"{len(out)} of {count} frames; {self.session.reader.trouble}"
        return out

    def true_stamp_s(self, arrived: Arrived) -> float:
        """Host time of a frame's exposure, by the server's own clock."""
        frame, setup = arrived.frame, self.server.setup
        known = frame.exposure_s if frame.exposure_s is not None else frame.sent_s - setup.processing_s
        return (known - setup.offset_s) / (1.0 + setup.drift)


class DriverContract:
    """The tests; a subclass names the system. Every body is told apart by its name, positions are metres, z up."""

    system = ""
    body = "drone"
    address = "127.0.0.1"
    options: ClassVar[dict[str, object]] = {}
    hides = True
    stamp_error_s = 0.004
    """How far stamps may lie from the exposures on a busy machine; the untold processing of some systems is 1 ms off
    here.
    """

    @pytest.fixture
    def server(self):
        with Server(Setup(self.system, address=self.address, **self.options)) as server:
            yield server

    @pytest.fixture
    def client(self, server):
        session = Session(self.system, server.host, self.body, ServerClock(settling_s=0.3))
        yield Client(session, server, self.body)
        session.close()

    def test_poses_are_in_metres_z_up_scalar_first_and_body_to_world(self, client):
        arrived = client.collect(30)[-1]
        body = arrived.frame.body(self.body)
        (position, quaternion) = Figure().at(client.true_stamp_s(arrived) - client.server.began_s)[0].pose
        tolerance = 2e-6 if arrived.frame.exposure_s is not None else 0.02
        np.testing.assert_allclose(body.position_m, position, atol=tolerance)
        assert abs(np.dot(body.quaternion, quaternion)) > 1.0 - max(1e-6, tolerance**2)

    def test_frames_come_at_the_cameras_rate_and_stamps_are_the_exposures(self, client):
        client.collect(40)
        arrived = client.collect(60)
        stamps = np.array([a.stamp_s for a in arrived])
        assert np.median(np.diff(stamps)) == pytest.approx(1.0 / client.server.setup.rate_hz, rel=0.1)
        errors = stamps - [client.true_stamp_s(a) for a in arrived]
        assert abs(np.median(errors)) < self.stamp_error_s
        assert abs(np.median(errors)) < client.session.error_s() + 1e-3, "within its own error bar, on a busy machine"
        latencies = [a.received_s - a.stamp_s for a in arrived]
        assert 0.0 <= np.median(latencies) < 0.1

    def test_a_body_is_found_by_name_and_by_number(self, client):
        frame = client.collect(20)[-1].frame
        found = frame.body(self.body)
        assert found.name == self.body
        if found.number is not None:
            assert frame.body(str(found.number)) == found

    def test_a_body_that_is_lost_is_told_and_found_again(self, client):
        client.collect(20)
        client.server.scene.hidden.add("drone")
        if self.hides:  # else the protocol goes silent with its only body
            client.collect(1, after=lambda a: a.frame.body(self.body) is None and self.body in a.frame.lost)
        client.server.scene.hidden.clear()
        client.collect(5, after=lambda a: a.frame.body(self.body) is not None)

    def test_a_body_that_does_not_exist_is_none_and_those_that_do_are_named(self, client):
        frame = client.collect(20)[-1].frame
        assert frame.body("nobody") is None
        assert self.body in client.session.reader.names

    def test_another_server_is_not_taken_for_this_one(self, client):
        other = replace(client.server.setup, address="127.0.0.2", port=0, offset_s=9000.0, names=("stranger", "other"))
        with Server(other):
            frames = [a.frame for a in client.collect(40)]
        assert all(body.name not in ("stranger", "other") for frame in frames for body in frame.bodies)

    def test_a_clock_that_is_set_in_flight_is_found_and_cut(self, client):
        client.collect(60)
        client.server.setup.offset_s += 3.0
        client.collect(60)
        assert 1 <= client.session.clock.steps <= 2, "answers of the old clock may still be on their way"
        assert client.session.take_step()
        errors = [a.stamp_s - client.true_stamp_s(a) for a in client.collect(20)]
        assert abs(np.median(errors)) < self.stamp_error_s

    def test_a_cut_network_ends_the_session_and_the_next_one_goes_on(self, server):
        session = Session(self.system, server.host, self.body)
        session.silent_s = 0.4
        Client(session, server, self.body).collect(10)
        server.setup.cut = True
        with pytest.raises(OSError, match=r"nothing came|ended|reset|speaks"):
            deadline = time.monotonic() + PATIENCE_S
            while time.monotonic() < deadline:
                session.poll()
        session.close()
        server.setup.cut = False
        again = Session(self.system, server.host, self.body, session.clock)
        Client(again, server, self.body).collect(10)
        assert again.clock.steps == 0, "the server's clock went on"
        again.close()


class TestNatNet41(DriverContract):
    system = "natnet"
    stamp_error_s = 0.002


class TestNatNet30(DriverContract):
    system = "natnet"
    options: ClassVar = {"version": (3, 0)}
    stamp_error_s = 0.002


class TestNatNetMulticast(DriverContract):
    system = "natnet"
    options: ClassVar = {"multicast": ("239.255.42.98", 15112), "version": (4, 0)}
    stamp_error_s = 0.002


class TestQtm(DriverContract):
    system = "qtm"


class TestVicon(DriverContract):
    system = "vicon"
    stamp_error_s = 0.002


class TestVrpn(DriverContract):
    system = "vrpn"


class TestZenoh(DriverContract):
    system = "zenoh"


class TestRos2(DriverContract):
    system = "ros2"


class TestMavlink(DriverContract):
    system = "mavlink"
    body = "1"
    hides = False
    stamp_error_s = 0.002

    def test_another_server_is_not_taken_for_this_one(self, client):
        other = replace(client.server.setup, address="127.0.0.2", port=0, offset_s=9000.0)
        with Server(other):
            frames = [a.frame for a in client.collect(40)]
        assert all(abs(frame.exposure_s - time.monotonic() - 5000.0) < 100.0 for frame in frames)


def test_every_system_has_a_contract():
    assert {kind.system for kind in DriverContract.__subclasses__()} == set(SYSTEMS)


class Driver:
    """The process, as the link runs it."""

    def __init__(self, *arguments: str):
        command = [sys.executable, "-P", "-m", "drivers.mocap.source", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE)
        self.reader = FrameReader()
        self.events: list[str] = []

    def poses(self, count: int) -> list[tuple[Pose, float]]:
        out: list[tuple[Pose, float]] = []
        deadline = time.monotonic() + PATIENCE_S
        while len(out) < count and time.monotonic() < deadline:
            for sample, received_s in self.reader.feed(self.process.stdout.read1(1 << 16)):
                if isinstance(sample, Event):
                    self.events.append(sample.text)
                else:
                    out.append((sample, received_s))
        assert len(out) >= count, self.events
        return out

    def event(self, words: str) -> str:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            told = next((text for text in self.events if words in text), None)
            if told is not None:
                return told
            for sample, _ in self.reader.feed(self.process.stdout.read1(1 << 16)):
                if isinstance(sample, Event):
                    self.events.append(sample.text)
        raise AssertionError(f"'{words}' was not told: {self.events}")

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()


def test_the_process_gives_poses_and_goes_on_when_the_server_restarts_with_another_clock():
    first = Server(Setup("vicon"))
    driver = Driver("--system", "vicon", "--host", first.host, "--body", "drone")
    try:
        poses = driver.poses(20)
        assert all(pose.device_s <= received for pose, received in poses)
        setup = replace(first.setup, offset_s=77.0)
        first.stop()
        driver.event("trying again")
        with Server(setup, began_s=first.began_s) as second:
            pose, received = driver.poses(60)[-1]
            assert 0.0 <= received - pose.device_s < 0.5
            there = Figure().at(pose.device_s - second.began_s)[0].pose[0]
            np.testing.assert_allclose(pose.position_m, there, atol=0.02)
    finally:
        driver.close()


def test_the_process_names_the_bodies_there_are_when_the_wanted_one_is_none_of_them():
    with Server(Setup("qtm")) as server:
        driver = Driver("--system", "qtm", "--host", server.host, "--body", "dron")
        try:
            assert driver.event("knows no body") == "qtm knows no body 'dron'; there are drone, wand"
        finally:
            driver.close()


def test_a_world_with_y_up_is_turned_upright():
    with Server(Setup("natnet")) as server:
        driver = Driver("--system", "natnet", "--host", server.host, "--body", "2", "--up", "y")
        try:
            pose, _ = driver.poses(3)[-1]
        finally:
            driver.close()
    np.testing.assert_allclose(pose.position_m, (-1.0, -0.2, 0.5), atol=1e-6)
    np.testing.assert_allclose(pose.quaternion, (np.cos(np.pi / 8), 0.0, -np.sin(np.pi / 8), 0.0), atol=1e-6)
