"""ArduCopter's onboard log of an emulated flight: the records, their fields and their rates by LOG_BITMASK.

By default IMU 25 Hz, ATT and RATE 10 Hz; with fast-attitude logging (bit 0) ATT and RATE at the loop rate and with fast
or raw IMU logging (bits 18, 19) IMU too; with INS_RAW_LOG_OPT the sensors' own samples (GYR, ACC) at 1 kHz; RCOU 10 Hz
whatever is set, ESC 100 Hz per motor (measured).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from drivers.mavlink.geometry import flip, flip_quaternion
from sim.mavlink.airframe import euler
from sim.mavlink.dataflash import DataFlashWriter

if TYPE_CHECKING:
    from sim.mavlink.arducopter import ArduCopter

FORMATS = {
    "PARM": (32, "QNff", "TimeUS,Name,Value,Default"),
    "MSG": (59, "QBBZ", "TimeUS,ID,Seq,Message"),
    "MODE": (122, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "EV": (182, "QB", "TimeUS,Id"),
    "IMU": (164, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
    "GYR": (165, "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
    "ACC": (166, "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ"),
    "ATT": (72, "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    "RATE": (75, "Qfffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut,AOutSlew"),
    "RCOU": (62, "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14"),
    "ESC": (86, "QBffffcfcf", "TimeUS,Instance,RPM,RawRPM,Volt,Curr,Temp,CTot,MotTemp,Err"),
    "BAT": (88, "QBfffffcfBBB", "TimeUS,Inst,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct,H,SH"),
    "XKF1": (44, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "XKQ": (54, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "VISP": (169, "QQIffffffffBBb", "TimeUS,RTimeUS,CTimeMS,PX,PY,PZ,R,P,Y,PErr,AErr,Rst,Ign,Q"),
    "SIM": (77, "QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
}
FAST_ATTITUDE, FAST_IMU, RAW_IMU = 1 << 0, 1 << 18, 1 << 19


class ArduCopterLog:
    """One log from arming to disarming.

    Args:
        a: the autopilot whose state is written.
        data: where the bytes go; readable at any time.
    """

    def __init__(self, a: ArduCopter, data: bytearray):
        self._log = DataFlashWriter(FORMATS, data)
        mask = int(a.parameters["LOG_BITMASK"])
        loop = 1.0 / a.tick_s
        attitude = loop if mask & FAST_ATTITUDE else 10.0
        imu = loop if mask & (FAST_IMU | RAW_IMU) else 25.0
        self._rates = {"IMU": imu, "ATT": attitude, "RATE": max(attitude, 10.0), "RCOU": 10.0, "BAT": 10.0}
        self._rates |= {"XKF1": loop if mask & FAST_ATTITUDE else 10.0, "XKQ": attitude, "SIM": 10.0}
        if a.has_esc_telemetry or a.parameters["SIM_ESC_TELEM"]:
            self._rates["ESC"] = 100.0
        self._raw = bool(int(a.parameters["INS_RAW_LOG_OPT"]))
        self._next = dict.fromkeys(self._rates, -1.0)
        for parameter in a.parameters.all:
            self._log.add("PARM", a.boot_us, parameter.name.encode(), parameter.value, math.nan)
        self.text(a, f"ArduCopter {a.VERSION}")
        self.mode(a)

    def text(self, a: ArduCopter, text: str) -> None:
        """A status text."""
        self._log.add("MSG", a.boot_us, 0, 0, text.encode()[:64])

    def mode(self, a: ArduCopter) -> None:
        """The flight mode."""
        self._log.add("MODE", a.boot_us, a.mode.custom, a.mode.custom, 2)

    def event(self, a: ArduCopter, number: int) -> None:
        """An event of LogEvent: 10 armed, 11 disarmed, 15 auto-armed, 18 land complete, 28 not landed."""
        self._log.add("EV", a.boot_us, number)

    def parameter(self, a: ArduCopter, name: str, value: float) -> None:
        """A parameter that changed."""
        self._log.add("PARM", a.boot_us, name.encode(), value, math.nan)

    def vision(self, a: ArduCopter, position_ned: tuple[float, float, float], yaw_ned: float) -> None:
        """A pose that arrived."""
        self._log.add(
            "VISP",
            a.boot_us,
            a.boot_us,
            a.boot_ms,
            *position_ned,
            0.0,
            0.0,
            math.degrees(yaw_ned),
            0.01,
            0.01,
            0,
            0,
            100,
        )

    def _due(self, name: str, time_s: float) -> bool:
        if time_s < self._next[name] - 1e-9:
            return False
        period = 1.0 / self._rates[name]
        self._next[name] = max(self._next[name] + period, time_s + 0.5 * period)
        return True

    def tick(self, a: ArduCopter) -> None:
        """Whatever is due in this cycle."""
        t, add = a.boot_us, self._log.add
        e = a.estimate
        attitude = [math.degrees(v) for v in euler(flip_quaternion(e.quaternion))]
        wanted = [math.degrees(v) for v in euler(flip_quaternion(a.cascade.attitude_setpoint))]
        for age_s, sample in a.airframe.raw_imu() if self._raw else ():
            taken = t - round(1e6 * age_s)
            add("GYR", t, 0, taken, *flip(sample.gyro_rad_s))
            add("ACC", t, 0, taken, *flip(sample.accel_m_s2))
        for name in [n for n in self._next if self._due(n, a.time_s)]:
            match name:
                case "IMU":
                    gyro, force = flip(a.imu.gyro_rad_s), flip(a.imu.accel_m_s2)
                    add(name, t, 0, *gyro, *force, 0, 0, 28.0, 1, 1, 1000, 1000)
                case "ATT":
                    pairs = [v for pair in zip(wanted[:2], attitude[:2], strict=True) for v in pair]
                    add(name, t, *pairs, wanted[2] % 360.0, attitude[2] % 360.0, 3)
                case "RATE":
                    asked = [math.degrees(v) for v in flip(a.cascade.rate_setpoint)]
                    is_ = [math.degrees(v) for v in flip(a.imu.gyro_rad_s)]
                    triples = [v for pair in zip(asked, is_, strict=True) for v in (*pair, 0.0)]
                    up, level = a.cascade.acceleration_setpoint[2], sum(a.commands) / max(1, len(a.commands))
                    add(name, t, *triples, up, a.imu.accel_m_s2[2] - 9.80665, level, 0.0)
                case "RCOU":
                    add(name, t, *a.pulse_widths_us[:14])
                case "BAT":
                    volt, left = a.truth.voltage_v, a.battery.percent
                    add(name, t, 0, volt, volt, a.truth.current_a, a.battery.used_mah, 0.0, 0.0, 0.0, left, 1, 0)
                case "XKF1":
                    heading = attitude[2] % 360.0
                    north = (*flip(e.velocity_m_s), 0.0, *flip(e.position_m))
                    add(name, t, 0, attitude[0], attitude[1], heading, *north, 0.0, 0.0, 0.0, a.ALTITUDE_M)
                case "XKQ":
                    add(name, t, 0, *flip_quaternion(e.quaternion))
                case "SIM":
                    q = flip_quaternion(a.truth.quaternion)
                    roll, pitch, yaw = (math.degrees(v) for v in euler(q))
                    latitude, longitude, height = a.geodetic(a.truth.position_m)
                    add(name, t, roll, pitch, yaw % 360.0, height, latitude, longitude, *q)
                case "ESC":
                    share = a.truth.current_a / len(a.truth.rotor_speed_rad_s)
                    for index, speed in enumerate(a.truth.rotor_speed_rad_s):
                        rpm = speed * 30.0 / math.pi
                        add(name, t, index, rpm, rpm, a.truth.voltage_v, share, 32.0, 0.0, 35.0, 0.0)
