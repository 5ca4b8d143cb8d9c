"""A scripted autopilot for the link's tests, on virtual time: the exchange as recorded from PX4 and ArduCopter, and a
vehicle that follows its setpoints like a point on a spring. It shares no code with the simulator's autopilot."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import MESSAGES, mavlink
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.phase import IN_AIR, Phase
from groundstation.flight.station import station_from_dict
from groundstation.trajectory import Plan, plan_from_dict
from groundstation.vehicle import load_vehicle

STEP_S = 0.01
PX4_MODES = {"OFFBOARD": 6 << 16, "AUTO.LAND": 4 << 16 | 6 << 24, "AUTO.RTL": 4 << 16 | 5 << 24, "POSCTL": 3 << 16,
             "AUTO.LOITER": 4 << 16 | 3 << 24}  # fmt: skip
ARDU_MODES = {"GUIDED": 4, "LAND": 9, "RTL": 6, "LOITER": 5, "BRAKE": 17, "STABILIZE": 0}


def small_plan(**changes) -> Plan:
    """A gentle excitation of three seconds at one metre height."""
    channel = {"a": [0.3], "b": [0.0], "c": 0.0}
    document = {
        "schema": "groundstation.plan/1", "vehicle": "x500", "base_frequency_rad_s": 2.0944, "periods": 1.0,
        "coefficients": {"x": channel, "y": {"a": [0.0], "b": [0.0]}, "z": {"a": [0.0], "b": [0.0], "c": 1.0},
                         "yaw": {"a": [0.0], "b": [0.0]}},
    }  # fmt: skip
    return plan_from_dict(document | changes)


@dataclass
class Vehicle:
    """The scripted autopilot. Everything in NED, as a real one."""

    kind: str = "px4"
    codec: MavlinkCodec = field(default_factory=lambda: MavlinkCodec(1, 1))
    now_s: float = 0.0
    boot_s: float = -20.0
    clock_rate: float = 1.0
    position: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    velocity: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    mode: int = 0
    armed: bool = False
    deny_arming: str = ""
    ignores_mode: int | None = None
    battery: int = 90
    target: list[float] | None = None
    setpoint_s: float = -1e9
    setpoints: list[tuple[float, object]] = field(default_factory=list)
    commands: list[tuple[float, int, tuple[float, ...]]] = field(default_factory=list)
    parameters: dict[str, tuple[float, int]] = field(default_factory=dict)
    climbing_to: float | None = None
    intervals: dict[int, float] = field(default_factory=dict)
    due: dict[int, float] = field(default_factory=dict)
    landed_s: float | None = None
    offset: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    bias: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    out: list[bytes] = field(default_factory=list)

    def __post_init__(self) -> None:
        modes = PX4_MODES if self.kind == "px4" else ARDU_MODES
        self.modes = modes
        self.mode = modes["AUTO.LOITER" if self.kind == "px4" else "STABILIZE"]
        names = {"px4": {"COM_OBL_RC_ACT": (4.0, 6), "COM_OF_LOSS_T": (1.0, 9), "NAV_DLL_ACT": (3.0, 6)},
                 "arducopter": {"FS_GCS_ENABLE": (5.0, 2), "FS_EKF_ACTION": (1.0, 2)}}  # fmt: skip
        self.parameters = {**names[self.kind], **self.parameters}
        if self.kind == "px4":
            self.intervals = {31: 0.02, 32: 0.02, 105: 0.01, 36: 0.02, 147: 0.5, 245: 0.2}

    @property
    def device_s(self) -> float:
        return (self.now_s - self.boot_s) * self.clock_rate

    @property
    def height_m(self) -> float:
        return -self.position[2]

    @property
    def follow(self) -> int:
        return self.modes["OFFBOARD" if self.kind == "px4" else "GUIDED"]

    @property
    def land(self) -> int:
        return self.modes["AUTO.LAND" if self.kind == "px4" else "LAND"]

    def send(self, message) -> None:
        self.out.append(self.codec.encode(message))

    def text(self, text: str, severity: int = 2) -> None:
        self.send(mavlink.MAVLink_statustext_message(severity, text.encode(), 0, 0))

    def heartbeat(self) -> None:
        base = 1 | (128 if self.armed else 0)
        autopilot = 12 if self.kind == "px4" else 3
        self.send(mavlink.MAVLink_heartbeat_message(2, autopilot, base, self.mode, 4, 3))

    def reboot(self) -> None:
        self.boot_s, self.armed, self.target = self.now_s, False, None
        self.mode = self.modes["AUTO.LOITER" if self.kind == "px4" else "STABILIZE"]

    def set_mode(self, name: str) -> None:
        self.mode = self.modes[name]
        self.target = None

    def step(self, now_s: float, incoming: list[bytes]) -> list[bytes]:
        dt, self.now_s = now_s - self.now_s, now_s
        for data in incoming:
            for received in self.codec.decode(data, datagram=True):
                if received.message is not None:
                    self.handle(received.message)
        self.fly(dt)
        self.tell()
        out, self.out = self.out, []
        return out

    def handle(self, m) -> None:
        name = m.get_type()
        if name == "COMMAND_LONG":
            self.command(m)
        elif name == "SET_POSITION_TARGET_LOCAL_NED":
            self.setpoints.append((self.now_s, m))
            self.setpoint_s, self.target = self.now_s, [m.x, m.y, m.z]
        elif name == "TIMESYNC" and m.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(int(self.device_s * 1e9), m.ts1))
        elif name == "PARAM_REQUEST_READ" and m.param_id in self.parameters:
            self.parameter(m.param_id)
        elif name == "PARAM_SET" and m.param_id in self.parameters:
            self.parameters[m.param_id] = (decoded(m, self.kind), self.parameters[m.param_id][1])
            self.parameter(m.param_id)

    def parameter(self, name: str) -> None:
        from drivers.mavlink.parameters import encode_value

        value, kind = self.parameters[name]
        wire = encode_value(value, kind, bytewise=self.kind == "px4")
        self.send(mavlink.MAVLink_param_value_message(name.encode(), wire, kind, 100, 0))

    def command(self, m) -> None:
        values = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        self.commands.append((self.now_s, m.command, values))
        result = 0
        if m.command == 511:
            supported = int(m.param1) in MESSAGES and int(m.param1) not in (291, 375, 331, 436, 230, 241, 193)
            if supported and m.param2 > 0:
                self.intervals[int(m.param1)] = m.param2 * 1e-6
            result = 0 if supported else 4
        elif m.command == 400 and m.param1 == 1.0:
            if self.deny_arming:
                self.text(self.deny_arming)
                result = 4
            else:
                self.armed = True
                self.heartbeat()
        elif m.command == 400:
            if self.height_m > 0.1 and m.param2 != 21196.0:
                result = 1
            else:
                self.armed = False
                self.heartbeat()
        elif m.command == 176:
            asked = int(m.param2) << 16 | int(m.param3) << 24 if self.kind == "px4" else int(m.param2)
            if asked != self.ignores_mode:
                self.mode = asked
                self.heartbeat()
        elif m.command == 22:
            self.climbing_to = m.param7
        self.send(mavlink.MAVLink_command_ack_message(m.command, result))

    def fly(self, dt: float) -> None:
        target = list(self.position)
        if self.armed and self.mode == self.follow:
            if self.kind == "px4" and self.now_s - self.setpoint_s > 1.0:
                self.mode = self.modes["AUTO.LAND"]
                self.text("Failsafe activated")
            if self.kind == "arducopter" and self.climbing_to is not None:
                target[2] = -self.climbing_to
                if abs(self.height_m - self.climbing_to) < 0.05 and self.target is not None:
                    self.climbing_to = None
            elif self.target is not None:
                target = [t - o + b for t, o, b in zip(self.target, self.offset, self.bias, strict=True)]
        if self.armed and self.mode in (self.land, self.modes.get("AUTO.RTL"), self.modes.get("RTL")):
            target[2] = self.position[2] + 0.1
        for axis in range(3):
            speed = min(max(4.0 * (target[axis] - self.position[axis]), -1.5), 1.5)
            self.velocity[axis] = speed
            self.position[axis] += speed * dt
        self.position[2] = min(self.position[2], 0.0)
        if not self.armed:
            self.position[2], self.velocity = 0.0, [0.0, 0.0, 0.0]  # it fell, if it was not down
        down = self.height_m < 0.02 and self.mode == self.land and self.armed
        self.landed_s = (self.now_s if self.landed_s is None else self.landed_s) if down else None
        if self.landed_s is not None and self.now_s - self.landed_s > 1.0:
            self.armed, self.landed_s = False, None
            self.heartbeat()

    def tell(self) -> None:
        self.every(0, 1.0, self.heartbeat)
        ms, us = int(self.device_s * 1e3), int(self.device_s * 1e6)
        x, y, z = (p + o for p, o in zip(self.position, self.offset, strict=True))
        vx, vy, vz = self.velocity
        builders: dict[int, Callable[[], object]] = {
            31: lambda: mavlink.MAVLink_attitude_quaternion_message(ms, 1, 0, 0, 0, 0, 0, 0),
            32: lambda: mavlink.MAVLink_local_position_ned_message(ms, x, y, z, vx, vy, vz),
            105: lambda: mavlink.MAVLink_highres_imu_message(us, 0, 0, -9.81, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 63),
            27: lambda: mavlink.MAVLink_raw_imu_message(us, 0, 0, -1000, 0, 0, 0, 0, 0, 0),
            36: lambda: mavlink.MAVLink_servo_output_raw_message(us & 0xFFFFFFFF, 0, *(1500,) * 4, 0, 0, 0, 0),
            147: lambda: mavlink.MAVLink_battery_status_message(
                0, 0, 0, 0, [16000, *(65535,) * 9], 100, 0, 0, self.battery
            ),
            245: lambda: mavlink.MAVLink_extended_sys_state_message(0, 2 if self.height_m > 0.05 else 1),
            1: lambda: mavlink.MAVLink_sys_status_message(1 << 28, 1 << 28, 1 << 28, 0, 16000, 0, 90, 0, 0, 0, 0, 0, 0),
        }
        for number, build in builders.items():
            if number in self.intervals:
                self.every(number, self.intervals[number], lambda build=build: self.send(build()))

    def every(self, key: int, period: float, job: Callable[[], None]) -> None:
        if self.now_s >= self.due.get(key, -1e9):
            self.due[key] = self.now_s + period
            job()


def decoded(m, kind: str) -> float:
    from drivers.mavlink.parameters import decode_value

    return decode_value(m.param_value, m.param_type, bytewise=kind == "px4")


class Rig:
    """Link core and scripted vehicle on one virtual clock, with a way between them that a test can disturb.

    ``down`` and ``up`` turn the frames of one step into those that arrive; ``hooks`` run before each step.
    """

    def __init__(self, kind: str = "px4", station: dict | None = None, **options):
        from groundstation.paths import find_config

        self.vehicle = Vehicle(kind)
        quick = {"climb_m_s": 1.2, "settle_s": 0.5, "settled_error_m": 0.4, **(station or {}).get("policy", {})}
        self.core = LinkCore(
            load_vehicle(find_config("vehicles", "x500")),
            station_from_dict({**(station or {}), "policy": quick}),
            Options(**{"keep_raw": False, **options}),
        )
        self.now_s = 100.0
        self.vehicle.now_s, self.vehicle.boot_s = self.now_s, self.now_s - 20.0
        self.down: Callable[[list[bytes]], list[bytes]] = lambda frames: frames
        self.up: Callable[[list[bytes]], list[bytes]] = lambda frames: frames
        self.hooks: list[Callable[[], None]] = []
        self.samples: list = []
        self.changed: list = []
        self.core_beats = True
        self.link_runs = True
        self._to_vehicle: list[bytes] = []

    def step(self) -> None:
        self.now_s += STEP_S
        for hook in self.hooks:
            hook()
        frames = self.down(self.vehicle.step(self.now_s, self.up(self._to_vehicle)))
        self._to_vehicle = []
        if not self.link_runs:
            return
        if self.core_beats:
            self.core.core_heard(self.now_s)
        out = self.core.step(self.now_s, [("vehicle", data) for data in frames])
        self._to_vehicle = out.send
        self.samples += [(s, t) for s, t in out.samples if type(s).__name__ != "Raw"]
        self.changed += out.changed

    def run(self, until: Callable[[], bool], limit_s: float = 60.0) -> bool:
        end = self.now_s + limit_s
        while self.now_s < end:
            if until():
                return True
            self.step()
        return until()

    def wait(self, seconds: float) -> None:
        self.run(lambda: False, seconds)

    @property
    def phase(self) -> Phase:
        assert self.core.pilot is not None
        return self.core.pilot.phase

    @property
    def reason(self) -> str:
        assert self.core.pilot is not None
        return self.core.pilot.reason

    def prepare(self) -> None:
        assert self.run(lambda: self.core.ready, 30.0), self.core.trouble

    def upload(self, plan: Plan | None = None):
        return self.core.upload(plan or small_plan(), self.now_s)

    def order(self, name: str):
        answer = self.core.order(name, self.now_s)
        self.run(lambda: answer.ok is not None, 10.0)
        return answer

    def start(self) -> None:
        """Until setpoints lead the vehicle."""
        self.prepare()
        answer = self.upload()
        assert answer.ok, answer.reason
        answer = self.order("arm")
        assert answer.ok, answer.reason
        self.core.order("start", self.now_s)
        assert self.run(lambda: self.phase is Phase.FOLLOWING, 40.0), (self.phase, self.reason)

    def excite(self) -> None:
        """Until the excitation runs."""
        self.start()
        assert self.run(lambda: self.core.pilot.exciting, 40.0), (self.phase, self.reason)

    def finish(self, limit_s: float = 60.0) -> bool:
        """Until it is down and disarmed."""
        return self.run(lambda: self.phase not in IN_AIR and not self.vehicle.armed, limit_s)

    def setpoints_after(self, when_s: float) -> int:
        return sum(t > when_s for t, _ in self.vehicle.setpoints)


def lossy(fraction: float, seed: int) -> Callable[[list[bytes]], list[bytes]]:
    """Drop, duplicate, reorder and corrupt a fraction of the frames each."""
    rng = random.Random(seed)

    def disturb(frames: list[bytes]) -> list[bytes]:
        out = []
        for frame in frames:
            if rng.random() < fraction:
                continue
            if rng.random() < fraction:
                out.append(frame)
            if rng.random() < fraction:
                at = rng.randrange(len(frame))
                frame = frame[:at] + bytes([frame[at] ^ 1 << rng.randrange(8)]) + frame[at + 1 :]
            out.append(frame)
        if rng.random() < fraction:
            rng.shuffle(out)
        return out

    return disturb
