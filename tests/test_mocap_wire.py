"""Bytes of motion-capture servers: whatever comes, no reader raises; the makers' own clients understand our servers."""

# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportOptionalOperand=false
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportGeneralTypeIssues=false,
# reportOperatorIssue=false
from __future__ import annotations

import asyncio
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.mocap import qtm, vicon, vrpn
from drivers.mocap.natnet import FRAME, SERVER_INFO, message
from drivers.mocap.readings import Frame, quaternion_of_matrix
from drivers.mocap.session import SYSTEMS
from drivers.mocap.shared import keyed
from drivers.mocap.source import FrameReader
from drivers.samples import Batch, Pose, encode_batch
from sim.mocap.published import MavlinkWire, pose_stamped
from sim.mocap.scene import Figure
from sim.mocap.server import Server, Setup
from sim.mocap.wire import NatNetWire, QtmWire, Shot, ViconWire, VrpnWire, matrix_of

SHOT = Shot(7, 100.0, 100.004, Figure().at(1.0))
NAMES = ("drone", "wand")


def said(system: str) -> list[bytes]:
    """What a server of that system says to a client that asks all the right things."""
    if system == "natnet":
        wire = NatNetWire(NAMES)
        return [*wire.receive(message(0), 1.0), *wire.receive(message(4), 1.0), *wire.frame(SHOT)]
    if system == "qtm":
        wire = QtmWire(NAMES)
        asked = [
            qtm.command("Version 1.23"),
            qtm.command("GetParameters 6D"),
            qtm.command("StreamFrames AllFrames 6DRes"),
        ]
        return [*wire.greeting(), *[a for each in asked for a in wire.receive(each, 1.0)], *wire.frame(SHOT)]
    if system == "vicon":
        wire = ViconWire(NAMES, 100.0)
        out = wire.greeting()
        kinds = struct.pack("<I3I", 3, vicon.FRAME_INFO, vicon.GLOBAL_SEGMENTS, vicon.SUBJECT_INFO)
        wire.receive(vicon.packet(vicon.thing(vicon.OBJECT_KINDS, kinds), vicon.thing(vicon.REQUEST_FRAME, b"\1")), 1.0)
        return out + wire.frame(SHOT)
    if system == "vrpn":
        wire = VrpnWire(NAMES)
        return [*wire.greeting(), *wire.receive(vrpn.COOKIE, 1.0), *wire.frame(SHOT)]
    if system == "mavlink":
        return MavlinkWire().frame(SHOT)
    if system == "zenoh":
        pose = Pose(1.0, *SHOT.seen[0].pose)
        return [keyed("mocap/drone", encode_batch(Batch(1, (1.004,), (pose,))))]
    return [keyed("drone", pose_stamped(1.0, SHOT.seen[0]))]


@pytest.mark.parametrize("system", SYSTEMS)
@given(data=st.lists(st.binary(max_size=200), max_size=6))
@settings(max_examples=60, deadline=None)
def test_any_bytes_are_taken_in_without_a_word(system, data):
    reader = SYSTEMS[system].reader()
    for portion in data:
        assert isinstance(reader.feed(portion, 1.0), list)
        assert all(isinstance(out, bytes) for out in reader.due(1.0))


@pytest.mark.parametrize("system", SYSTEMS)
@given(data=st.data())
@settings(max_examples=120, deadline=None)
def test_damaged_messages_are_skipped_and_the_next_ones_read(system, data):
    reader = SYSTEMS[system].reader()
    packets = said(system)
    hurt = data.draw(st.integers(0, len(packets) - 1))
    for index, packet in enumerate(packets):
        if index == hurt:
            body = bytearray(packet)
            for _ in range(data.draw(st.integers(1, 6))):
                body[data.draw(st.integers(0, len(body) - 1))] = data.draw(st.integers(0, 255))
            packet = bytes(body[: data.draw(st.integers(0, len(body)))])
        for reading in reader.feed(packet, 1.0):
            for body in reading.bodies if isinstance(reading, Frame) else ():
                assert abs(np.linalg.norm(body.quaternion) - 1.0) < 1e-6
                assert max(abs(v) for v in body.position_m) <= 1e4
        reader.due(1.0)


@pytest.mark.parametrize("system", [name for name, system in SYSTEMS.items() if system.kind == "tcp"])
def test_streams_may_be_cut_anywhere(system):
    whole, cut = SYSTEMS[system].reader(), SYSTEMS[system].reader()
    stream = b"".join(said(system))
    expected = whole.feed(stream, 1.0)
    got = [reading for i in range(len(stream)) for reading in cut.feed(stream[i : i + 1], 1.0)]
    assert got == expected
    assert any(isinstance(reading, Frame) for reading in expected)


@pytest.mark.parametrize(
    ("system", "data"),
    [
        ("natnet", message(FRAME, struct.pack("<III", 1, 0, 0) + b"\xff" * 40)),
        ("qtm", struct.pack("<II", 0, 2) + b"x" * 32),
        ("vicon", vicon.packet(vicon.thing(vicon.SUBJECT_INFO, b"\xff" * 16))),
        ("vrpn", b"vrpn: ver. 07.35  0".ljust(24, b"\0") + b"\xff" * 64),
    ],
    ids=["counts beyond the datagram", "a length of nothing", "names beyond the packet", "a length of 4 GB"],
)
def test_claims_of_more_than_there_is_cost_nothing(system, data):
    reader = SYSTEMS[system].reader()
    reader.feed(said(system)[0], 1.0)
    began = time.process_time()
    assert reader.feed(data, 1.0) == []
    assert reader.malformed
    assert time.process_time() - began < 1.0


@given(st.lists(st.binary(max_size=60), max_size=8))
@settings(max_examples=100, deadline=None)
def test_the_link_takes_any_bytes_from_its_client(portions):
    reader = FrameReader()
    for portion in portions:
        assert isinstance(reader.feed(portion), list)


def test_a_matrix_that_is_no_rotation_is_no_pose():
    quaternion = (0.5, -0.5, 0.1, 0.7)
    quaternion = tuple(np.array(quaternion) / np.linalg.norm(quaternion))
    assert abs(np.dot(quaternion_of_matrix(matrix_of(quaternion)), quaternion)) == pytest.approx(1.0)
    assert quaternion_of_matrix([1, 0, 0, 0, -1, 0, 0, 0, 1]) is None, "mirrored"
    assert quaternion_of_matrix([float("nan")] * 9) is None


def test_a_motive_older_than_exposure_stamps_is_refused_by_name():
    reader = SYSTEMS["natnet"].reader()
    reader.feed(message(SERVER_INFO, b"Arena".ljust(256, b"\0") + bytes([1, 0, 0, 0, 2, 7, 0, 0])), 1.0)
    assert "NatNet 2.7" in reader.trouble
    assert "update" in reader.trouble


# The makers' own clients, where they are installed ------------------------------------------------------------------


@pytest.mark.parametrize("version", [(3, 0), (4, 1)], ids=["NatNet 3.0", "NatNet 4.1"])
def test_the_natnet_library_reads_our_server_as_we_do(version):
    from natnet.data_descriptions import DataDescriptions
    from natnet.data_frame import DataFrame
    from natnet.packet_buffer import PacketBuffer
    from natnet.version import Version

    wire = NatNetWire(NAMES, version)
    theirs = DataFrame.read_from_buffer(PacketBuffer(wire.frame(SHOT)[0][4:]), Version(*version))
    names = DataDescriptions.read_from_buffer(PacketBuffer(wire.receive(message(4), 1.0)[0][4:]), Version(*version))
    reader = SYSTEMS["natnet"].reader()
    for data in (*wire.receive(message(0), 1.0), *wire.receive(message(4), 1.0)):
        reader.feed(data, 1.0)
    (ours,) = reader.feed(wire.frame(SHOT)[0], 1.0)
    assert [body.name for body in names.rigid_bodies] == [body.name for body in ours.bodies] == list(NAMES)
    for body, rigid in zip(ours.bodies, theirs.rigid_bodies, strict=True):
        assert rigid.pos == body.position_m
        np.testing.assert_allclose(np.roll(rigid.rot, 1), body.quaternion, atol=1e-6)
    assert theirs.suffix.stamp_camera_mid_exposure / NatNetWire.TICKS == ours.exposure_s
    assert theirs.suffix.stamp_transmit / NatNetWire.TICKS == ours.sent_s


def test_the_qualisys_client_reads_our_server():
    import qtm_rt

    async def stream(port: int):
        connection = await qtm_rt.connect("127.0.0.1", port=port)
        arrived: asyncio.Queue = asyncio.Queue()
        await connection.stream_frames(components=["6dres"], on_packet=arrived.put_nowait)
        packet = await asyncio.wait_for(arrived.get(), 10.0)
        connection.disconnect()
        return packet

    with Server(Setup("qtm")) as server:
        packet = asyncio.run(stream(server.setup.port))
    _, bodies = packet.get_6d_residual()
    assert bodies[1][0] == (-1000.0, 500.0, 200.0)
    np.testing.assert_allclose(
        np.reshape(bodies[1][1].matrix, (3, 3)).T.ravel(), matrix_of(SHOT.seen[1].pose[1]), atol=1e-6
    )


VIA_MAKER = """
import sys, motioncapture
client = motioncapture.connect(sys.argv[1], {"hostname": sys.argv[2]})
for _ in range(300):
    client.waitForNextFrame()
    found = client.rigidBodies
    if "wand" in found:
        q = found["wand"].rotation
        print(*found["wand"].position, q.w, q.x, q.y, q.z)
        break
"""


@pytest.mark.parametrize("system", ["vicon", "vrpn"])
def test_the_vicon_sdk_and_the_vrpn_client_read_our_servers(system):
    port = {"vicon": 801, "vrpn": 3883}[system]
    try:
        server = Server(Setup(system, port=port))
    except PermissionError:
        pytest.skip("the Vicon SDK knows port 801 alone, which takes a privilege here")
    with server:
        host = "127.0.0.1" if system == "vicon" else "tcp://127.0.0.1"
        run = [sys.executable, "-c", VIA_MAKER, system, host]
        told = subprocess.run(run, capture_output=True, text=True, timeout=60)
    numbers = [float(v) for v in told.stdout.split()]
    np.testing.assert_allclose(numbers, [*SHOT.seen[1].pose[0], *SHOT.seen[1].pose[1]], atol=1e-6)
