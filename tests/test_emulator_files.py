"""FTP and logs of the emulated autopilots: transfers whole, and logs that the public readers open."""

from __future__ import annotations

import io
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyulog import ULog

from drivers.mavlink.dialect import mavlink
from sim.mavlink import ftp
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, Station, position_setpoint, quadrotor

TELEMETRY = {"input": "rotor_speed", "thrust_coefficient_n_s2": 8e-6, "speed_max_rad_s": 790.0, "thrust_curve": None}


class Client:
    """The asking end of MAVLink FTP."""

    def __init__(self, server: ftp.FtpServer):
        self.server, self.sequence = server, 0

    def ask(self, opcode: int, data: bytes = b"", *, session: int = 0, offset: int = 0, size: int | None = None):
        self.sequence += 1
        length = len(data) if size is None else size
        packet = ftp.Packet(self.sequence, session, opcode, length, 0, 0, offset, data)
        return [ftp.Packet.parse(reply) for reply in self.server.handle(packet.pack())]

    def put(self, path: str, content: bytes) -> None:
        (opened,) = self.ask(ftp.CREATE, path.encode())
        assert opened.opcode == ftp.ACK
        for at in range(0, len(content), ftp.CHUNK):
            (reply,) = self.ask(ftp.WRITE, content[at : at + ftp.CHUNK], session=opened.session, offset=at)
            assert reply.opcode == ftp.ACK
        self.ask(ftp.TERMINATE, session=opened.session)

    def get(self, path: str) -> bytes:
        (opened,) = self.ask(ftp.OPEN_READ, path.encode())
        size, got = struct.unpack("<I", opened.data)[0], bytearray()
        while len(got) < size:
            for reply in self.ask(ftp.BURST, session=opened.session, offset=len(got), size=ftp.CHUNK):
                assert reply.offset == len(got)
                got += reply.data
            assert reply.burst_complete
        self.ask(ftp.TERMINATE, session=opened.session)
        return bytes(got)


def server() -> ftp.FtpServer:
    return ftp.FtpServer({}, ("/APM/scripts", "/log"))


@settings(max_examples=30, deadline=None)
@given(content=st.binary(max_size=20_000))
def test_what_is_put_comes_back_with_its_checksum(content):
    client = Client(server())
    client.put("/APM/scripts/plan.bin", content)
    assert client.get("/APM/scripts/plan.bin") == content
    (reply,) = client.ask(ftp.CRC32, b"/APM/scripts/plan.bin")
    assert struct.unpack("<I", reply.data)[0] == ftp.crc32(content)


def test_the_checksum_is_the_one_of_the_specification():
    # CRC-32 of "123456789" without initial value and final inversion (CRC-32/JAMCRC relatives): bit by bit.
    crc = 0
    for byte in b"123456789":
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    assert ftp.crc32(b"123456789") == crc


def test_a_repeated_request_is_answered_again_but_not_done_twice():
    s = server()
    packet = ftp.Packet(7, 0, ftp.CREATE, 4, 0, 0, 0, b"/a.b").pack()
    assert s.handle(packet) == s.handle(packet)
    (opened,) = [ftp.Packet.parse(p) for p in s.handle(ftp.Packet(8, 0, ftp.CREATE, 4, 0, 0, 0, b"/c.d").pack())]
    assert opened.session == 1, "the repetition opened no second session"


def test_what_cannot_be_done_is_refused_by_its_reason():
    client = Client(server())
    assert client.ask(ftp.OPEN_READ, b"/none")[0].data == bytes([ftp.NOT_FOUND])
    assert client.ask(ftp.READ, session=3)[0].data == bytes([ftp.INVALID_SESSION])
    assert client.ask(99)[0].data == bytes([ftp.UNKNOWN])
    assert client.ask(ftp.CREATE, b"/no/such/folder/x")[0].data == bytes([ftp.NOT_FOUND])
    for k in range(ftp.FtpServer.MAX_SESSIONS):
        client.ask(ftp.CREATE, f"/f{k}".encode())
    assert client.ask(ftp.CREATE, b"/one-more")[0].data == bytes([ftp.NO_SESSIONS])


def test_a_listing_names_files_with_sizes_and_folders_and_ends():
    client = Client(server())
    client.put("/APM/a.txt", b"12345")
    (reply,) = client.ask(ftp.LIST, b"/APM")
    assert reply.data == b"Dscripts\0Fa.txt\t5\0"
    assert client.ask(ftp.LIST, b"/APM", offset=2)[0].data == bytes([ftp.EOF])


def flown(kind, settings: dict[str, float], vehicle) -> Station:
    """A short flight at rest over the origin, then landed and disarmed."""
    s = Station(kind(vehicle, RigidAirframe(vehicle, seed=3), boot_s=60.0), step_s=0.01)
    for name, value in settings.items():
        index = s.autopilot.parameters.index(name)
        s.autopilot.parameters[name] = value
        s.autopilot.parameter_changed(s.autopilot.parameters.all[index])
    s.repeating = lambda t: position_setpoint(0.3 * np.sin(2.0 * t), 0.0, 1.0)
    s.run(0.5)
    guided = (1, 6) if kind is Px4 else (1, 4)
    s.command(mavlink.MAV_CMD_DO_SET_MODE, *guided)
    s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    if kind is ArduCopter:
        s.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.0)
    s.run(8.0)
    s.repeating = None
    s.command(mavlink.MAV_CMD_NAV_LAND)
    assert s.run(15.0, lambda: not s.autopilot.armed)
    return s


def downloaded(s: Station) -> tuple[int, bytes]:
    """The newest log by the LOG protocol: what the list says of its size, and its content."""
    entry = s.request(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY")
    s.send(mavlink.MAVLink_log_request_data_message(1, 1, entry.id, 0, entry.size))
    content = bytearray(entry.size)
    s.run(60.0, lambda: bool(s.heard) and s.heard[-1][1].name == "LOG_DATA" and s.heard[-1][1].message.count < 90)
    for m in s.named("LOG_DATA"):
        content[m.ofs : m.ofs + m.count] = bytes(m.data[: m.count])
    return entry.size, bytes(content)


@pytest.fixture(scope="module")
def px4_log(tmp_path_factory) -> tuple[Station, Path]:
    s = flown(Px4, {"SDLOG_PROFILE": 25}, quadrotor(**TELEMETRY))
    size, content = downloaded(s)
    assert len(content) == size > 100_000
    path = tmp_path_factory.mktemp("log") / "flight.ulg"
    path.write_bytes(content)
    return s, path


def test_the_downloaded_ulog_opens_in_pyulog_with_the_measured_rates(px4_log):
    _, path = px4_log
    log = ULog(str(path))
    topics = {d.name: d.data for d in log.data_list}
    for name, hz in (("sensor_combined", 250), ("actuator_motors", 250), ("vehicle_angular_velocity", 250),
                     ("battery_status", 5), ("vehicle_attitude_groundtruth", 100)):  # fmt: skip
        stamps = topics[name]["timestamp"] * 1e-6
        assert (len(stamps) - 1) / (stamps[-1] - stamps[0]) == pytest.approx(hz, rel=0.02), name
    assert len(log.initial_parameters) == 888
    assert next(m.message for m in log.logged_messages) == "Armed by external command"
    assert not log.file_corruption


def test_the_log_holds_the_physics_that_was_flown(px4_log):
    """Specific force is thrust over mass, and the commands say how much thrust, at the hover and on average."""
    _, path = px4_log
    topics = {d.name: d.data for d in ULog(str(path)).data_list}
    imu, motors = topics["sensor_combined"], topics["actuator_motors"]
    flying = (imu["timestamp"] > imu["timestamp"][0] + 5_000_000) & (imu["timestamp"] < imu["timestamp"][0] + 7_500_000)
    force = -imu["accelerometer_m_s2[2]"][flying].mean()
    when = (motors["timestamp"] > imu["timestamp"][0] + 5_000_000) & (
        motors["timestamp"] < imu["timestamp"][0] + 7_500_000
    )
    thrust = sum(8e-6 * (790.0 * motors[f"control[{i}]"][when]) ** 2 for i in range(4)).mean()
    assert force == pytest.approx(thrust / 1.0, rel=0.01)
    rpm = topics["esc_status"]["esc[0].esc_rpm"]
    assert rpm.max() * np.pi / 30 == pytest.approx(790.0 * np.nanmax(motors["control[0]"]), rel=0.2)


def test_the_same_log_comes_by_ftp(px4_log):
    s, path = px4_log
    name = s.autopilot.logs.logs[0].path
    assert Client(s.autopilot.ftp).get(name) == path.read_bytes()


def test_by_default_px4_logs_motors_too_slowly_and_1_khz_needs_the_imu_rate():
    slow = flown(Px4, {}, quadrotor())
    fast = flown(Px4, {"SDLOG_PROFILE": 25, "IMU_INTEG_RATE": 1000, "IMU_GYRO_RATEMAX": 1000}, quadrotor())
    rates = []
    for s in (slow, fast):
        (content,) = s.autopilot.files.values()
        topics = {d.name: d.data for d in ULog(io.BytesIO(bytes(content))).data_list}
        rates.append(
            {
                n: 1e6 / np.median(np.diff(topics[n]["timestamp"].astype(float)))
                for n in ("actuator_motors", "sensor_combined")
            }
        )
    assert rates[0] == pytest.approx({"actuator_motors": 10.0, "sensor_combined": 250.0}, rel=0.03)
    assert rates[1] == pytest.approx({"actuator_motors": 1000.0, "sensor_combined": 1000.0}, rel=0.03)


@pytest.mark.parametrize(("mask", "imu_hz"), [(180222, 25.0), (180222 | 1 | 1 << 19, 400.0)])
def test_the_dataflash_log_opens_in_pymavlink_with_the_measured_rates(tmp_path, mask, imu_hz):
    from pymavlink import DFReader

    s = flown(ArduCopter, {"LOG_BITMASK": mask}, quadrotor())
    (content,) = s.autopilot.files.values()
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(content))
    reader, stamps, count = DFReader.DFReader_binary(str(path)), {}, Counter()
    while (record := reader.recv_msg()) is not None:
        count[record.get_type()] += 1
        if record.get_type() in ("IMU", "RCOU"):
            stamps.setdefault(record.get_type(), []).append(record.TimeUS * 1e-6)
        if record.get_type() == "MODE":
            mode = record.ModeNum
    assert 1.0 / np.median(np.diff(stamps["IMU"])) == pytest.approx(imu_hz, rel=0.01)
    assert 1.0 / np.median(np.diff(stamps["RCOU"])) == pytest.approx(10.0, rel=0.01), "whatever the setting"
    assert count["PARM"] == 1362
    assert mode == 9


def test_log_ids_are_not_in_time_order_and_the_list_says_when_there_is_none():
    vehicle = quadrotor()
    s = Station(Px4(vehicle, RigidAirframe(vehicle), boot_s=60.0))
    entry = s.request(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF), "LOG_ENTRY")
    assert (entry.num_logs, entry.size) == (0, 0)
    for _ in range(4):
        s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        s.run(1.5)
        s.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    s.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 0xFFFF))
    s.run(0.1)
    begun = [m.time_utc for m in s.named("LOG_ENTRY")[1:]]
    assert len(set(begun)) == 4
    assert begun != sorted(begun)
