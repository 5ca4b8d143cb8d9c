"""Logs as autopilots write them, from one truth: any wiring of outputs, scale, protocol and history of parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sim.mavlink.dataflash import DataFlashWriter
from sim.mavlink.ulog import ULogWriter

SECONDS, RATE_HZ = 4.0, 100.0


def truth(rotors: int = 4, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Times and commands 0..1 in the autopilot's order: at rest, then flown, each motor with a motion of its own."""
    t = 5.0 + np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    phase = np.random.default_rng(seed).uniform(0.0, 6.0, rotors)
    u = 0.45 + 0.08 * np.arange(rotors) / rotors + 0.15 * np.sin((2.0 + 0.7 * np.arange(rotors)) * t[:, None] + phase)
    u[(t < 5.5) | (t > 8.5)] = 0.0
    return t, u


@dataclass
class Px4Log:
    """What a PX4 log says of the motors.

    ``limits`` gives per channel (low, high); ``changes`` are (time, name, value) of parameters, limits in force at each
    time; ``raw_full`` writes shares of a full scale; ``decoys`` are instances of actuator_outputs that drive something
    else.
    """

    channels: tuple[int, ...] = (1, 2, 3, 4)
    prefix: str = "PWM_MAIN"
    instance: int = 0
    limits: dict[int, tuple[float, float]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    changes: tuple[tuple[float, str, float], ...] = ()
    functions: bool = True
    decoys: tuple[int, ...] = ()
    topic: str = "actuator_outputs"
    dshot: bool = False
    raw_full: float = 0.0
    esc_places: tuple[int, ...] | None = None
    esc_functions: bool = True

    def write(self, t: np.ndarray, u: np.ndarray) -> bytes:
        rotors = u.shape[1]
        parameters = [(name, not float(value).is_integer(), value) for name, value in self.parameters.items()]
        if self.functions:
            parameters += [(f"{self.prefix}_FUNC{c}", False, 101 + m) for m, c in enumerate(self.channels)]
        for channel, (low, high) in self.limits.items():
            parameters += [(f"{self.prefix}_MIN{channel}", False, low), (f"{self.prefix}_MAX{channel}", False, high)]
        escs = "uint64_t timestamp;int32_t esc_rpm;"
        if self.esc_functions:
            escs += "uint8_t actuator_function;uint8_t[3] _padding0;"
        formats = {
            "actuator_motors": "uint64_t timestamp;uint64_t timestamp_sample;float[12] control;",
            "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;float[3] "
            "accelerometer_m_s2;",
            "esc_report": escs,
            "esc_status": "uint64_t timestamp;esc_report[8] esc;",
        }
        names = [f"actuator_outputs_{i}" for i in sorted({self.instance, *self.decoys})]
        formats |= dict.fromkeys(names, "uint64_t timestamp;uint32_t noutputs;float[16] output;")
        log = ULogWriter(0, formats, {"sys_name": "PX4"}, parameters)
        waiting = sorted(self.changes)
        bounds = {c: list(self.limits.get(c, (1000.0, 2000.0))) for c in self.channels}
        for k, moment in enumerate(t):
            now = round(moment * 1e6)
            log.add("sensor_combined", now, 0.1, 0.2, 0.3, 0, 0.0, 0.0, -9.8)
            while waiting and waiting[0][0] <= moment:
                _, name, value = waiting.pop(0)
                log.parameter(name, not float(value).is_integer(), value)
                for channel in self.channels:
                    for side, word in enumerate(("MIN", "MAX")):
                        if name in (f"{self.prefix}_{word}{channel}",):
                            bounds[channel][side] = value
            if self.topic == "actuator_motors":
                log.add("actuator_motors", now, now, *u[k], *[math.nan] * (12 - rotors))
                continue
            out = np.zeros(16)
            for motor, channel in enumerate(self.channels):
                if self.raw_full:
                    out[channel - 1] = self.raw_full * u[k, motor]
                elif self.dshot:
                    low = math.floor(self.parameters.get("DSHOT_MIN", 0.055) * 1999.0)
                    out[channel - 1] = 0.0 if u[k, motor] == 0.0 else low + u[k, motor] * (1999.0 - low)
                else:
                    low, high = bounds[channel]
                    out[channel - 1] = low + u[k, motor] * (high - low)
            for decoy in self.decoys:
                log.add(f"actuator_outputs_{decoy}", now, 16, *[1500.0] * 16)
            log.add(f"actuator_outputs_{self.instance}", now, 16, *out)
            if self.esc_places is not None:
                rpm = [0] * 8
                function = [0] * 8
                for motor, place in enumerate(self.esc_places):
                    rpm[place], function[place] = (
                        round(9000.0 * math.sqrt(max(u[max(k - 4, 0), motor], 0.0))),
                        101 + motor,
                    )
                reports = [
                    x
                    for i in range(8)
                    for x in ((now, rpm[i], function[i], 0, 0, 0) if self.esc_functions else (now, rpm[i]))
                ]
                log.add("esc_status", now, *reports)
        return _with_instances(bytes(log.data))


def _with_instances(data: bytes) -> bytes:
    """The subscriptions to actuator_outputs_N as instance N of actuator_outputs, and one format for all."""
    out, at = bytearray(data[:16]), 16
    seen = False
    while at + 3 <= len(data):
        length = int.from_bytes(data[at : at + 2], "little")
        body = data[at + 3 : at + 3 + length]
        if data[at + 2 : at + 3] == b"F" and body.startswith(b"actuator_outputs_"):
            body = b"actuator_outputs" + body[len(b"actuator_outputs_0") :]
            if seen:
                at += 3 + length
                continue
            seen = True
        elif data[at + 2 : at + 3] == b"A" and body[3:].startswith(b"actuator_outputs_"):
            body = bytes([int(body[-1:])]) + body[1:3] + b"actuator_outputs"
        out += len(body).to_bytes(2, "little") + data[at + 2 : at + 3] + body
        at += 3 + length
    return bytes(out)


@dataclass
class ArduLog:
    """What an ArduPilot log says of the motors."""

    channels: tuple[int, ...] = (1, 2, 3, 4)
    limits: tuple[float, float] = (1000.0, 2000.0)
    frame: tuple[int, int] = (1, 1)
    parameters: dict[str, float] = field(default_factory=dict)
    changes: tuple[tuple[float, str, float], ...] = ()
    functions: bool = True
    instanced: bool = True
    clock: str = "TimeUS"
    esc_instances: tuple[int, ...] | None = None
    column: str = "C"
    throttle_limits: bool = False

    def write(self, t: np.ndarray, u: np.ndarray) -> bytes:
        us = self.clock == "TimeUS"
        letter, per_s = ("Q", 1e6) if us else ("I", 1e3)
        formats = {
            "PARM": (32, f"{letter}Nf", f"{self.clock},Name,Value"),
            "RCOU": (62, letter + "H" * 14, ",".join([self.clock, *(f"{self.column}{i}" for i in range(1, 15))])),
            "ESC": (86, f"{letter}Bf", f"{self.clock},Instance,RPM"),
            "IMU": (
                164,
                f"{letter}{'B' if self.instanced else ''}ffffff",
                f"{self.clock},{'I,' if self.instanced else ''}GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
            ),
        }
        log = DataFlashWriter(formats)
        low, high = self.limits
        names = ("RC3_MIN", "RC3_MAX") if self.throttle_limits else ("MOT_PWM_MIN", "MOT_PWM_MAX")
        parameters = {names[0]: low, names[1]: high, **self.parameters}
        if self.throttle_limits:
            parameters |= {"MOT_PWM_MIN": 0.0, "MOT_PWM_MAX": 0.0}
        if self.functions:
            parameters |= {"FRAME_CLASS": self.frame[0], "FRAME_TYPE": self.frame[1]}
            function = {m: 33 + m if m < 8 else 74 + m for m in range(12)}
            parameters |= {f"SERVO{c}_FUNCTION": function[m] for m, c in enumerate(self.channels)}
        start = round(t[0] * per_s) - 10
        for name, value in parameters.items():
            log.add("PARM", start, name.encode(), float(value))
        waiting = sorted(self.changes)
        for k, moment in enumerate(t):
            now = round(moment * per_s)
            while waiting and waiting[0][0] <= moment:
                _, name, value = waiting.pop(0)
                log.add("PARM", now, name.encode(), float(value))
                low = value if name == "MOT_PWM_MIN" else low
                high = value if name == "MOT_PWM_MAX" else high
            out = [1500] * 14
            for motor, channel in enumerate(self.channels):
                out[channel - 1] = round(low + u[k, motor] * (high - low))
            log.add("IMU", now, *((0,) if self.instanced else ()), 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
            log.add("RCOU", now, *out)
            for motor, instance in enumerate(self.esc_instances or ()):
                log.add("ESC", now, instance, 9000.0 * math.sqrt(max(u[max(k - 4, 0), motor], 0.0)))
        return bytes(log.data)
