"""Motion capture: stamps, the process's wire form, a NatNet server on loopback, frames told apart before take-off."""

from __future__ import annotations

import random
import socket
import struct
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mavlink.dialect import mavlink
from drivers.mocap.source import FrameReader, StampMap, frame
from drivers.samples import Pose, State
from groundstation.flight.link.preflight import compare_frames
from groundstation.flight.link.profiles import PROFILES

LEVEL = (1.0, 0.0, 0.0, 0.0)


def test_late_packets_do_not_move_the_clock():
    rng, stamps, worst = random.Random(1), StampMap(), 0.0
    for n in range(2400):
        server = 5.0 + n / 240
        mapped = stamps.host_s(server, server + 100.0 + 0.0002 + rng.expovariate(1 / 0.004))
        worst = max(worst, abs(mapped - server - 100.0)) if n > 500 else 0.0
    assert worst < 0.001, "although packets are 4 ms late on average"


def test_a_server_that_restarts_begins_anew():
    stamps = StampMap()
    stamps.host_s(100.0, 200.0)
    assert stamps.host_s(1.0, 205.0) == pytest.approx(205.0)


@given(st.integers(1, 90))
@settings(max_examples=20, deadline=None)
def test_poses_cross_the_pipe_in_any_portions(portion):
    poses = [Pose(float(n), (n, 2.0, 3.0), LEVEL) for n in range(5)]
    data = b"".join(frame(pose, pose.device_s + 0.5, n) for n, pose in enumerate(poses))
    reader = FrameReader()
    got = [entry for i in range(0, len(data), portion) for entry in reader.feed(data[i : i + portion])]
    assert got == [(pose, pose.device_s + 0.5) for pose in poses]


def natnet_server(server: socket.socket, stop: threading.Event) -> None:
    """NatNet 4.1 at about 200 Hz: answers the connection request, then one rigid body with number 1."""
    peer, n = None, 0
    server.settimeout(0.005)
    while not stop.is_set():
        try:
            data, address = server.recvfrom(2048)
            if struct.unpack_from("<H", data)[0] == 0:
                body = b"Motive".ljust(256, b"\0") + bytes([3, 1, 0, 0]) + bytes([4, 1, 0, 0])
                server.sendto(struct.pack("<HH", 1, len(body)) + body, address)
                peer = address
        except TimeoutError:
            pass
        if peer is None:
            continue
        n += 1

        def section(count: int, data: bytes = b"") -> bytes:
            return struct.pack("<II", count, len(data)) + data

        rigid = struct.pack("<I3f4ffH", 1, 1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8, 0.0005, 1)
        body = struct.pack("<I", n) + section(0) + section(0) + section(1, rigid) + section(0) * 5
        body += (
            struct.pack("<II", 0, 0) + struct.pack("<d", n / 200) + struct.pack("<3Q", n, n, n) + struct.pack("<H", 0)
        )
        server.sendto(struct.pack("<HH", 7, len(body)) + body, peer)


def test_a_natnet_server_on_loopback_gives_poses_scalar_first():
    pytest.importorskip("natnet", reason="the natnet package is not installed")
    server, stop = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), threading.Event()
    server.bind(("127.0.0.1", 0))
    thread = threading.Thread(target=natnet_server, args=(server, stop))
    thread.start()
    command = [sys.executable, "-P", "-m", "drivers.mocap.source", "--system", "natnet", "--body", "1",
               "--host", f"127.0.0.1:{server.getsockname()[1]}"]  # fmt: skip
    source = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    try:
        reader, poses = FrameReader(), []
        deadline = time.monotonic() + 20.0
        while len(poses) < 20 and time.monotonic() < deadline:
            poses += reader.feed(source.stdout.read1(4096))
    finally:
        stop.set()
        source.kill()
        source.wait()
        thread.join()
        server.close()
    assert len(poses) >= 20
    np.testing.assert_allclose(poses[0][0].position_m, (1.0, 2.0, 3.0))
    np.testing.assert_allclose(poses[0][0].quaternion, (0.8, 0.0, 0.0, 0.6), rtol=1e-6)
    assert all(pose.device_s <= received for pose, received in poses)


def carried(matrix) -> list[tuple[State, Pose]]:
    """A hand-carried loop as the estimator and a motion capture with other axes see it."""
    out = []
    for t in np.linspace(0.0, 6.0, 60):
        p = np.array([0.5 * np.sin(t), 0.4 * np.sin(2 * t), 0.2 + 0.2 * np.cos(t)])
        state = State(float(t), tuple(p + 3.0), (0.0, 0.0, 0.0), LEVEL, (0.0, 0.0, 0.0))
        out.append((state, Pose(float(t), tuple(np.asarray(matrix) @ p), LEVEL)))
    return out


def test_equal_frames_pass_whatever_their_origins():
    assert compare_frames(carried(np.eye(3))).ok


@pytest.mark.parametrize(
    "matrix",
    [[[0, 1, 0], [1, 0, 0], [0, 0, 1]], [[1, 0, 0], [0, -1, 0], [0, 0, 1]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]],
    ids=["x and y swapped", "y mirrored", "y up"],
)
def test_swapped_mirrored_and_tilted_axes_are_caught_and_the_map_is_shown(matrix):
    check = compare_frames(carried(matrix))
    assert not check.ok
    assert "best map" in check.reason


def test_too_little_motion_says_nothing_about_frames():
    still = [
        (State(float(n), (0, 0, 0), (0, 0, 0), LEVEL, (0, 0, 0)), Pose(float(n), (0, 0, 0), LEVEL)) for n in range(9)
    ]
    assert compare_frames(still) is None


@pytest.mark.parametrize("name", PROFILES)
def test_a_pose_for_the_vehicle_turns_left_and_up_into_right_and_down(name):
    yaw = 0.6
    pose = Pose(12.5, (1.0, 2.0, 3.0), (float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))))
    (message,) = PROFILES[name]().external_pose(pose, 12.5, 0.01, 0.02, 3)
    assert (message.x, message.y, message.z) == (1.0, -2.0, -3.0)
    if name == "px4":
        assert message.time_usec == 12_500_000
        assert message.estimator_type == mavlink.MAV_ESTIMATOR_TYPE_VISION, "PX4 does not fuse MOCAP"
        np.testing.assert_allclose(message.q, [np.cos(0.3), 0, 0, -np.sin(0.3)])
    else:
        assert message.usec == 12_500_000
        assert message.yaw == pytest.approx(-yaw)
    covariance = message.pose_covariance if name == "px4" else message.covariance
    assert covariance[0] == pytest.approx(1e-4)
    assert covariance[20] == pytest.approx(4e-4)
