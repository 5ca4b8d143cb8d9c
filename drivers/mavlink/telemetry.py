"""MAVLink messages to samples. Stateful only where a message leaves something out (time, attitude, text parts).

Every stamp is the autopilot's time since boot. Messages without one (battery, ESC telemetry of ArduPilot, texts) get
the newest stamp seen, which is late by at most the spacing of the fastest stream.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, pi

from drivers.mavlink.codec import Received
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.geometry import flip, flip_quaternion, quaternion_of, rotate, turned
from drivers.samples import Battery, Event, Imu, Motors, Quaternion, Sample, State, Vector3

_MILLI_G = 9.80665e-3
_RPM = 2.0 * pi / 60.0
_WRAP_S = 2**32 * 1e-6
_BODY_FRAMES = (mavlink.MAV_FRAME_BODY_FRD, mavlink.MAV_FRAME_BODY_NED)
_OPEN_TEXTS = 8
_IMU_NAMES = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU")


@dataclass(frozen=True, slots=True)
class _Attitude:
    device_s: float
    quaternion: Quaternion
    rate_rad_s: Vector3


class _Rivals:
    """Two messages that say the same, one of them better: the better one counts while it comes often enough.

    A slow link carries the better one once in a second or two; it must not silence the other then.
    """

    _SHARE = 0.6
    _MEMORY = 0.9

    def __init__(self) -> None:
        self._last = [-inf, -inf]
        self._period_s = [inf, inf]

    def counts(self, better: bool, t: float) -> bool:
        """Note a message of one of the two; whether it is the one to use."""
        n = int(better)
        since = t - self._last[n]
        smooth = isfinite(self._period_s[n]) and since < 5.0 * self._period_s[n]
        self._period_s[n] = self._MEMORY * self._period_s[n] + (1.0 - self._MEMORY) * since if smooth else since
        self._last[n] = t
        silent = self._last[1] == -inf or t - self._last[1] > max(1.0, 2.0 * self._period_s[1])
        return better is (not silent and self._period_s[0] >= self._SHARE * self._period_s[1])


class Telemetry:
    """Samples of one vehicle.

    Args:
        rotors: number of rotors; outputs and ESCs past it are not rotors.
        system: the vehicle's system id; other senders give no samples.
        imu: the one message whose IMU is taken, so that two streams of one sensor never mix.
        pwm_us: servo output at command 0 and at 1.
    """

    def __init__(
        self, rotors: int, *, system: int = 1, imu: str = "HIGHRES_IMU", pwm_us: tuple[float, float] = (1000.0, 2000.0)
    ):
        if imu not in _IMU_NAMES:
            raise ValueError(f"no IMU in {imu}; there are {', '.join(_IMU_NAMES)}")
        self._rotors, self._system, self._pwm_us = rotors, system, pwm_us
        self._newest_s = 0.0
        self._last: dict[str, float] = {}
        self._attitude: _Attitude | None = None
        self._states, self._outputs = _Rivals(), _Rivals()
        self._esc: dict[int, float] = {}
        self._texts: dict[int, dict[int, str]] = {}
        self._handlers: dict[str, Callable[[Message], list[Sample]]] = {
            imu: self._highres_imu if imu == "HIGHRES_IMU" else self._scaled_imu,
            "ATTITUDE_QUATERNION": self._attitude_quaternion,
            "ATTITUDE": self._attitude_angles,
            "LOCAL_POSITION_NED": self._local_position,
            "ODOMETRY": self._odometry,
            "SERVO_OUTPUT_RAW": self._servo_output,
            "ACTUATOR_OUTPUT_STATUS": self._actuator_output,
            "ESC_STATUS": self._esc_status,
            **{f"ESC_TELEMETRY_{4 * i + 1}_TO_{4 * i + 4}": self._esc_telemetry for i in range(4)},
            "BATTERY_STATUS": self._battery,
            "STATUSTEXT": self._statustext,
        }

    @property
    def newest_s(self) -> float:
        """The newest device time seen."""
        return self._newest_s

    def samples(self, received: Received) -> list[Sample]:
        """What this message tells. A message whose stamp was there already (a duplicate) tells nothing."""
        if received.frame.system != self._system or received.message is None:
            return []
        handler = self._handlers.get(received.name)
        return [] if handler is None else handler(received.message)

    def restart(self) -> None:
        """The vehicle rebooted: its time starts again."""
        self._newest_s = 0.0
        self._states, self._outputs = _Rivals(), _Rivals()
        self._last.clear()
        self._attitude = None

    def _stamp(self, name: str, device_s: float) -> bool:
        """Remember a message's stamp; False if it is a duplicate."""
        if self._last.get(name) == device_s:
            return False
        self._last[name] = device_s
        self._newest_s = max(self._newest_s, device_s)
        return True

    def _unwrap(self, microseconds: int) -> float:
        """32-bit microseconds wrap after 71.6 minutes: choose the turn nearest to the newest full stamp."""
        short = microseconds * 1e-6
        return short + _WRAP_S * round((self._newest_s - short) / _WRAP_S)

    def _highres_imu(self, m: Message) -> list[Sample]:
        t = m.time_usec * 1e-6
        if m.id or not self._stamp("imu", t):  # further instances are other sensors
            return []
        return [Imu(t, flip((m.xgyro, m.ygyro, m.zgyro)), flip((m.xacc, m.yacc, m.zacc)))]

    def _scaled_imu(self, m: Message) -> list[Sample]:
        """SCALED_IMU, and ArduPilot's RAW_IMU which has the same units: mrad/s and thousandths of g."""
        t = m.time_usec * 1e-6 if m.get_type() == "RAW_IMU" else m.time_boot_ms * 1e-3
        if getattr(m, "id", 0) or not self._stamp("imu", t):
            return []
        gyro = flip((m.xgyro * 1e-3, m.ygyro * 1e-3, m.zgyro * 1e-3))
        return [Imu(t, gyro, flip((m.xacc * _MILLI_G, m.yacc * _MILLI_G, m.zacc * _MILLI_G)))]

    def _attitude_quaternion(self, m: Message) -> list[Sample]:
        t = m.time_boot_ms * 1e-3
        if self._stamp("attitude", t):
            rate = flip((m.rollspeed, m.pitchspeed, m.yawspeed))
            self._attitude = _Attitude(t, flip_quaternion((m.q1, m.q2, m.q3, m.q4)), rate)
        return []

    def _attitude_angles(self, m: Message) -> list[Sample]:
        """ATTITUDE, where no quaternion flows."""
        t = m.time_boot_ms * 1e-3
        if t - self._last.get("attitude", -1e9) > 1.0 and self._stamp("angles", t):
            rate = flip((m.rollspeed, m.pitchspeed, m.yawspeed))
            self._attitude = _Attitude(t, flip_quaternion(quaternion_of(m.roll, m.pitch, m.yaw)), rate)
        return []

    def _local_position(self, m: Message) -> list[Sample]:
        """Position with the newest attitude, turned by its rate to the position's stamp.

        ODOMETRY, where it flows, says all at once.
        """
        t = m.time_boot_ms * 1e-3
        if not self._stamp("position", t) or not self._states.counts(False, t) or self._attitude is None:
            return []
        dt = t - self._attitude.device_s
        if abs(dt) > 0.2:
            return []
        q = turned(self._attitude.quaternion, self._attitude.rate_rad_s, dt)
        return [State(t, flip((m.x, m.y, m.z)), flip((m.vx, m.vy, m.vz)), q, self._attitude.rate_rad_s)]

    def _odometry(self, m: Message) -> list[Sample]:
        t = m.time_usec * 1e-6
        if m.frame_id not in (mavlink.MAV_FRAME_LOCAL_NED, mavlink.MAV_FRAME_LOCAL_FRD) or not self._stamp("odo", t):
            return []
        if not self._states.counts(True, t):
            return []
        q = flip_quaternion((m.q[0], m.q[1], m.q[2], m.q[3]))
        velocity = flip((m.vx, m.vy, m.vz))
        if m.child_frame_id in _BODY_FRAMES:
            velocity = rotate(q, velocity)
        return [State(t, flip((m.x, m.y, m.z)), velocity, q, flip((m.rollspeed, m.pitchspeed, m.yawspeed)))]

    def _servo_output(self, m: Message) -> list[Sample]:
        """Pulse widths to commands; ACTUATOR_OUTPUT_STATUS, where it flows, says the same with more digits."""
        t = self._unwrap(m.time_usec)
        if m.port or not self._stamp("servo", t) or not self._outputs.counts(False, t):
            return []
        low, high = self._pwm_us
        pulses = [getattr(m, f"servo{i}_raw") for i in range(1, self._rotors + 1)]
        return [Motors(t, tuple(min(max((p - low) / (high - low), 0.0), 1.0) for p in pulses), "command")]

    def _actuator_output(self, m: Message) -> list[Sample]:
        """Outputs 0..1 (in simulation) or pulse widths (on hardware), as the numbers show."""
        t = m.time_usec * 1e-6
        if not self._stamp("actuator", t):
            return []
        values = m.actuator[: self._rotors]
        if not all(isfinite(v) for v in values) or not self._outputs.counts(True, t):
            return []
        low, high = self._pwm_us
        if max(values) > 2.0:
            values = [(v - low) / (high - low) for v in values]
        return [Motors(t, tuple(min(max(v, 0.0), 1.0) for v in values), "command")]

    def _esc_status(self, m: Message) -> list[Sample]:
        t = m.time_usec * 1e-6
        return self._speeds(t, m.index, m.rpm) if self._stamp(f"esc{m.index}", t) else []

    def _esc_telemetry(self, m: Message) -> list[Sample]:
        """ArduPilot: four ESCs a message, no stamp."""
        return self._speeds(self._newest_s, int(m.get_type().split("_")[2]) - 1, m.rpm)

    def _speeds(self, t: float, first: int, rpm: list[int]) -> list[Sample]:
        """A sample once the message with the last rotor came."""
        self._esc.update({first + i: abs(value) * _RPM for i, value in enumerate(rpm)})
        if not first <= self._rotors - 1 < first + len(rpm) or any(i not in self._esc for i in range(self._rotors)):
            return []
        return [Motors(t, tuple(self._esc[i] for i in range(self._rotors)), "rotor_speed")]

    def _battery(self, m: Message) -> list[Sample]:
        cells = [v * 1e-3 for v in m.voltages if v != 0xFFFF] + [v * 1e-3 for v in m.voltages_ext if v]
        if m.id or not cells:
            return []
        return [Battery(self._newest_s, sum(cells), m.current_battery * 1e-2 if m.current_battery >= 0 else 0.0)]

    def _statustext(self, m: Message) -> list[Sample]:
        """A text; long ones come in numbered parts that end with one shorter than 50 characters."""
        text = m.text if isinstance(m.text, str) else bytes(m.text).decode(errors="replace")
        full = len(text.encode()) >= 50
        text = "".join(c if c.isprintable() or c in "\t\n" else "\N{REPLACEMENT CHARACTER}" for c in text)
        text = text if full else text.rstrip("\t\n ")
        if not m.id and m.chunk_seq:
            return []  # PX4 gives its first long text the number 0, which means a whole one: the beginning was told
        if not m.id:
            return [Event(self._newest_s, "statustext", f"{_severity(m.severity)}: {text}")]
        if m.id not in self._texts and len(self._texts) >= _OPEN_TEXTS:
            del self._texts[next(iter(self._texts))]  # the oldest never ended
        parts = self._texts.setdefault(m.id, {})
        parts[m.chunk_seq] = text
        if full:
            return []
        whole = "".join(parts.get(i, "…") for i in range(m.chunk_seq + 1))
        del self._texts[m.id]
        return [Event(self._newest_s, "statustext", f"{_severity(m.severity)}: {whole}")]


def _severity(number: int) -> str:
    names = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
    return names[number] if number < len(names) else str(number)
