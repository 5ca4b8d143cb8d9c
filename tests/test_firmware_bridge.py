"""The physics bridges to real firmware, tested by scripted peers that follow the documented exchanges."""

from __future__ import annotations

import json
import math
import os
import pty
import socket
import struct
import threading
import tty

import numpy as np
import pytest

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import mavlink
from drivers.mavlink.geometry import flip, flip_quaternion
from drivers.mavlink.transports import SerialTransport
from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.build import STEP_S
from sim.firmware.__main__ import serve_json, serve_serial, serve_tcp
from sim.firmware.arducopter import JsonExchange
from sim.firmware.px4 import FIELDS, HilExchange, pressure_hpa
from sim.loop import run
from sim.mavlink.control import Cascade, Setpoint
from sim.mavlink.messages import EARTH_RADIUS_M, LATITUDE_DEG, LONGITUDE_DEG
from sim.mavlink.plant import SimulatedAirframe
from sim.scenario import Scenario
from tests.emulated import RigidAirframe, quadrotor

VEHICLE = quadrotor()
ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def servo_packet(frame: int, widths: list[int], *, rate_hz: int = 400, magic: int = 18458) -> bytes:
    return struct.pack("<HHI16H", magic, rate_hz, frame, *(widths + [0] * 16)[:16])


class ScriptedArduCopter:
    """Hovers by the emulator's own cascade on nothing but what the JSON line says."""

    def __init__(self, height_m: float):
        self.cascade, self.frame, self.setpoint = Cascade(VEHICLE), 0, Setpoint((0.0, 0.0, height_m), yaw_rad=0.0)
        self.widths = [1000] * 4
        self.states: list[dict] = []

    def packet(self) -> bytes:
        self.frame += 1
        return servo_packet(self.frame, self.widths)

    def take(self, line: bytes) -> None:
        assert line.startswith(b"\n")
        assert line.endswith(b"\n")
        state = json.loads(line)
        self.states.append(state)
        commands = self.cascade.update(
            1 / 400, self.setpoint, flip(state["position"]), flip(state["velocity"]),
            flip_quaternion(state["quaternion"]), flip(state["imu"]["gyro"]),
        )  # fmt: skip
        self.widths = [round(1000 + 1000 * u) for u in commands]


def test_arducopter_at_rest_feels_gravity_upwards_in_its_own_frame():
    exchange = JsonExchange(RigidAirframe(VEHICLE), 4)
    state = json.loads(exchange.answer(servo_packet(1, [1000] * 4)))
    assert state["timestamp"] == pytest.approx(1 / 400)
    assert state["imu"]["accel_body"] == pytest.approx([0.0, 0.0, -9.80665], abs=0.2)
    assert state["quaternion"] == pytest.approx([1.0, 0.0, 0.0, 0.0])


def test_arducopter_flies_in_lock_step_and_climbs_towards_negative_z():
    exchange, firmware = JsonExchange(RigidAirframe(VEHICLE), 4), ScriptedArduCopter(1.5)
    for _ in range(400 * 6):
        line = exchange.answer(firmware.packet())
        assert line is not None
        firmware.take(line)
    assert firmware.states[-1]["position"] == pytest.approx([0.0, 0.0, -1.5], abs=0.1)
    times = np.array([s["timestamp"] for s in firmware.states])
    assert np.diff(times) == pytest.approx(1 / 400)
    assert exchange.missed == 0


def test_a_frame_sent_again_is_answered_again_and_moves_nothing():
    exchange = JsonExchange(RigidAirframe(VEHICLE), 4)
    first = exchange.answer(servo_packet(1, [1900] * 4))
    assert exchange.answer(servo_packet(1, [1900] * 4)) == first
    assert exchange.time_s == pytest.approx(1 / 400)


def test_lost_frames_are_counted_and_a_restarted_firmware_begins_anew():
    exchange = JsonExchange(RigidAirframe(VEHICLE), 4)
    for frame in (1, 2, 6, 1):
        assert exchange.answer(servo_packet(frame, [1000] * 4)) is not None
    assert exchange.missed == 3


@pytest.mark.parametrize(
    "packet", [b"", b"\x00" * 40, servo_packet(1, [1500] * 4, magic=1), servo_packet(1, [1500] * 4)[:-2]]
)
def test_what_is_no_servo_packet_is_not_answered(packet):
    exchange = JsonExchange(RigidAirframe(VEHICLE), 4)
    assert exchange.answer(packet) is None
    assert exchange.time_s == 0.0


def test_thirty_two_channels_are_understood():
    packet = struct.pack("<HHI32H", 29569, 400, 1, *([1500] * 32))
    assert JsonExchange(RigidAirframe(VEHICLE), 4).answer(packet) is not None


def test_arducopter_over_a_real_socket():
    exchange, firmware, done = JsonExchange(RigidAirframe(VEHICLE), 4), ScriptedArduCopter(1.0), threading.Event()
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as place,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
    ):
        place.bind(("127.0.0.1", 0))
        peer.settimeout(5.0)
        server = threading.Thread(target=serve_json, args=(exchange, place, done.is_set))
        server.start()
        try:
            for _ in range(800):
                peer.sendto(firmware.packet(), place.getsockname())
                firmware.take(peer.recv(65536))
        finally:
            done.set()
            server.join(5.0)
    assert firmware.states[-1]["position"][2] < -0.5


class ScriptedPx4:
    """Silent for the first 100 ms, then one HIL_ACTUATOR_CONTROLS per HIL_SENSOR; hovers on its pressure altitude and
    gyro.
    """

    def __init__(self, height_m: float | None):
        self.codec, self.cascade = MavlinkCodec(1, 1), Cascade(VEHICLE)
        self.height_m, self.sensors, self.gps = height_m, [], []
        self.position, self.velocity, self.attitude = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)

    def take(self, data: bytes) -> bytes:
        out = b""
        for received in self.codec.decode(data):
            if received.name == "HIL_GPS":
                self.gps.append(received.message)
            if received.name == "HIL_SENSOR":
                self.sensors.append(received.message)
                if received.message.time_usec >= 100_000:
                    out += self.codec.encode(self.controls(received.message))
        return out

    def controls(self, m):
        height = m.pressure_alt - 489.4
        rate = flip((m.xgyro, m.ygyro, m.zgyro))
        dt = 0.004
        climb = 0.8 * self.velocity[2] + 0.2 * (height - self.position[2]) / dt
        self.position, self.velocity = (0.0, 0.0, height), (0.0, 0.0, climb)
        mode, outputs = 0, [0.0] * 16
        if self.height_m is not None:
            setpoint = Setpoint((math.nan, math.nan, self.height_m), yaw_rad=0.0)
            commands = self.cascade.update(dt, setpoint, self.position, self.velocity, self.attitude, rate)
            mode, outputs = ARMED, list(commands) + [math.nan] * 12
        return mavlink.MAVLink_hil_actuator_controls_message(m.time_usec, outputs, mode, 1)


def test_px4_gets_every_sensor_it_needs_in_its_own_frame():
    exchange, firmware = HilExchange(RigidAirframe(VEHICLE), 4), ScriptedPx4(None)
    for _ in range(50):
        firmware.take(exchange.step())
    m = firmware.sensors[-1]
    assert m.fields_updated == FIELDS
    assert (m.xacc, m.yacc, m.zacc) == pytest.approx((0.0, 0.0, -9.80665), abs=0.2)
    assert (m.xmag, m.ymag, m.zmag) == pytest.approx((0.2152, 0.0077, 0.4274), abs=3e-3)
    for name in ("xmag", "ymag", "zmag", "abs_pressure"):
        values = [getattr(s, name) for s in firmware.sensors]
        assert len(set(values)) > 0.9 * len(values), f"{name} repeats: PX4 takes it for stuck"
    assert m.abs_pressure == pytest.approx(955.8, abs=0.5), "as recorded at 489 m"
    assert [s.time_usec for s in firmware.sensors] == list(range(4000, 204_000, 4000))
    assert len(firmware.gps) == 2, "10 Hz"


def test_px4_is_told_the_truth_for_its_log():
    exchange, codec = HilExchange(RigidAirframe(VEHICLE, position_m=(1.0, 2.0, 0.0)), 4), MavlinkCodec(1, 1)
    told = [r.message for _ in range(10) for r in codec.decode(exchange.step()) if r.name == "HIL_STATE_QUATERNION"]
    assert len(told) == 5
    assert list(told[0].attitude_quaternion) == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert told[0].zacc == -1000
    north = math.radians(told[0].lat * 1e-7 - LATITUDE_DEG) * EARTH_RADIUS_M
    east = math.radians(told[0].lon * 1e-7 - LONGITUDE_DEG) * EARTH_RADIUS_M * math.cos(math.radians(LATITUDE_DEG))
    assert (north, -east) == pytest.approx((1.0, 2.0), abs=0.02)


def test_px4_flies_in_lock_step():
    exchange, firmware = HilExchange(RigidAirframe(VEHICLE), 4), ScriptedPx4(1.5)
    free = 0
    for _ in range(1500):
        answer = firmware.take(exchange.step())
        if not exchange.locked and not answer:
            free += 1
            continue
        assert exchange.receive(answer) == 1
        assert not exchange.waiting
    assert free == 24, "sensors flow freely for the first 100 ms"
    assert exchange.armed
    assert firmware.position[2] == pytest.approx(1.5, abs=0.15)


def test_controls_of_a_disarmed_px4_and_values_that_are_no_numbers_stop_the_rotors():
    airframe = RigidAirframe(VEHICLE)
    exchange, codec = HilExchange(airframe, 4), MavlinkCodec(1, 1)
    for mode, values in ((0, [0.9] * 16), (ARMED, [math.nan] * 16)):
        exchange.receive(codec.encode(mavlink.MAVLink_hil_actuator_controls_message(0, values, mode, 1)))
        for _ in range(50):
            exchange.step()
        assert airframe.state.position_m[2] == 0.0


def test_px4_over_a_real_connection_and_a_closed_one_says_so():
    exchange, firmware = HilExchange(RigidAirframe(VEHICLE), 4), ScriptedPx4(1.0)
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as px4:
        connection, _ = server.accept()
        failure: list[str] = []

        def serve() -> None:
            try:
                with connection:
                    serve_tcp(exchange, connection, lambda: False, 0.0)
            except BadInput as error:
                failure.append(str(error))

        thread = threading.Thread(target=serve)
        thread.start()
        px4.settimeout(5.0)
        while exchange.time_us < 1_500_000:
            px4.sendall(firmware.take(px4.recv(65536)))
        px4.shutdown(socket.SHUT_RDWR)
        thread.join(5.0)
    assert firmware.position[2] > 0.3
    assert failure == ["PX4 closed the simulator link; start it again, then this."]


@pytest.mark.parametrize("seen_while", ["sendall", "recv"])
def test_a_closed_simulator_link_has_one_sentence_wherever_it_is_seen(seen_while):
    """PX4's process ends between our write and our read, or before the write: a reset or a broken pipe, not an empty
    read.
    """
    px4, connection = socket.socketpair()
    with px4, connection:
        if seen_while == "recv":
            px4.shutdown(socket.SHUT_WR)
        else:
            px4.close()

        class Tcp:  # a socket pair has no TCP_NODELAY
            setsockopt = staticmethod(lambda *_: None)
            sendall, recv, fileno = connection.sendall, connection.recv, connection.fileno

        with pytest.raises(BadInput, match=r"^PX4 closed the simulator link; start it again, then this\.$"):
            serve_tcp(HilExchange(RigidAirframe(VEHICLE), 4), Tcp(), lambda: False, 0.0)  # pyright: ignore


def test_a_flight_controller_on_a_serial_line_is_paced_in_real_time():
    exchange, firmware, done = HilExchange(RigidAirframe(VEHICLE), 4), ScriptedPx4(1.0), threading.Event()
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    line = SerialTransport(os.ttyname(slave), 921600)
    thread = threading.Thread(target=serve_serial, args=(exchange, line, done.is_set))
    thread.start()
    try:
        while len(firmware.sensors) < 250:
            os.write(master, firmware.take(os.read(master, 65536)))
    finally:
        done.set()
        thread.join(5.0)
        line.close()
        os.close(master)
        os.close(slave)
    assert exchange.armed
    assert firmware.sensors[-1].time_usec >= 1_000_000


def test_the_standard_atmosphere():
    assert pressure_hpa(0.0) == pytest.approx(1013.25)
    assert pressure_hpa(1000.0) == pytest.approx(898.76, abs=0.2)


@pytest.mark.parametrize("steps", [1, 4])
def test_the_physics_is_compiled_before_a_firmware_waits_and_never_again(steps: int):
    """A second compilation takes ten seconds with cold caches; it came at the first command of a 1 kHz firmware, in the
    air.
    """
    airframe = SimulatedAirframe(load_vehicle(find_config("vehicles", "x500")), Scenario(), seed=1)
    compiled = len(run.signatures)
    for commands in ((0.0,) * 4, (0.3,) * 4, (0.9,) * 4, (0.0,) * 4):
        airframe.step(steps * STEP_S, commands)
    assert len(run.signatures) == compiled
