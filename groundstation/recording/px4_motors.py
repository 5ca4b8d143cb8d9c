"""What a PX4 log says of its motors: which outputs they are, on which scale, and what their ESCs report.

Sources: PX4's parameter reference (``PWM_MAIN_FUNCn``, ``_MINn``, ``_MAXn``, ``_TIMn``, ``DSHOT_MIN``, ``THR_MDL_FAC``,
``CA_ROTORn_*``) and the messages ActuatorMotors, ActuatorOutputs and EscReport.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import Stream, motor_columns
from groundstation.recording.airframes import PX4_AUTOSTART, Airframe
from groundstation.recording.autopilot import (
    MOTORS_SLOW_HZ,
    check_count,
    motor_map,
    motor_order,
    running,
    slow_note,
    wanted_input,
)
from groundstation.recording.computed_speeds import commands_behind, motors_by_data
from groundstation.recording.settings import Settings
from groundstation.recording.tables import Table
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Topics = Mapping[tuple[str, int], Table]

PX4_MOTORS = ("actuator_motors", "actuator_outputs", "esc_status")
"""Topics that tell of the motors."""
SETTINGS_REMEDY = "set SDLOG_PROFILE to 25, and IMU_INTEG_RATE and IMU_GYRO_RATEMAX to 1000."
_FIRST_FUNCTION, _MOST_MOTORS = 101, 12  # actuator function Motor 1, and how many there are
_DSHOT_FULL = 1999.0
_UAVCAN_FULL = 8191.0  # uavcan.equipment.esc.RawCommand; before 1.13 its outputs have no limits of their own
_DSHOT_TIMERS = (-5.0, -4.0, -3.0, -2.0)
_RPM = 2.0 * np.pi / 60.0
_AT_BOOT = -np.inf
"""When protocols and types of vehicles are read: set later, they wait for the next start."""


@dataclass(frozen=True, slots=True)
class _Commands:
    """What the motors were sent, 0..1 in the autopilot's order, and where it was read from."""

    stream: Stream
    wires: tuple[str, ...]
    used: tuple[str, ...]
    notes: tuple[str, ...] = ()


def read_motors(topics: Topics, settings: Settings, vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    """The motors in the vehicle file's order: commands, or the speeds that ESCs report.

    Raises:
        BadInput: no outputs, another number of motors, or outputs whose scale the log does not give.
    """
    _require_multicopter(topics, settings, source)
    try:
        commands = _commands(topics, settings, source)
    except BadInput:  # of no account where the ESCs' speeds are asked for and there
        if vehicle.rotors.input != "rotor_speed" or _turning(topics)[0] is None:
            raise
        commands = None
    start, end = running(commands.stream.t_s, commands.stream.values) if commands else (-np.inf, np.inf)
    count = len(commands.stream.columns) if commands else vehicle.rotors.count
    airframe = _airframe(settings, start, count)
    check_count(vehicle, count, airframe.name if airframe else "by its outputs", source)
    order, notes = motor_order(vehicle, airframe, source) if airframe else (list(range(count)), [])
    frame = airframe.name if airframe else "not told by the log: motor i is taken for rotor i"
    said: list[str] = []
    try:
        speeds, wires = _speeds(topics, commands, count, source)
    except (
        BadInput
    ):  # the speeds of some rotors are none where speeds are asked for, and nothing to who asks for commands
        if commands is None or vehicle.rotors.input == "rotor_speed":
            raise
        speeds, wires, said = None, (), ["motors: esc_status does not tell the speeds of all rotors; it is not used."]
    there = {
        name: s for name, s in (("command", commands and commands.stream), ("rotor_speed", speeds)) if s is not None
    }
    computed = commands_behind(speeds, commands.stream) if speeds is not None and commands is not None else None
    if computed is not None:
        there, said = {"command": computed[0]}, [*said, computed[1]]
    kind = wanted_input(vehicle, {name: name in there for name in ("command", "rotor_speed")}, source)
    if kind == "command" and commands is not None:
        wires = commands.wires
        said += [*commands.notes, *settings.told(commands.used, start, end)]
    stream = there[kind]
    stream = replace(stream, values=stream.values[:, order])
    notes = [motor_map(order, wires, frame), *notes, *said]
    return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, SETTINGS_REMEDY)


def _airframe(settings: Settings, at_s: float, count: int) -> Airframe | None:
    """The control allocator's geometry (CA_ROTORi_PX, _PY in FRD), else the airframe's number; None where neither is
    told.
    """
    told = settings.value("CA_ROTOR_COUNT", at_s, 0.0)
    if 0.0 < told <= _MOST_MOTORS:  # a damaged log may say anything
        rotors = int(told)
        x, y = (np.array([settings.value(f"CA_ROTOR{i}_P{axis}", at_s, 0.0) for i in range(rotors)]) for axis in "XY")
        spin = tuple(1 if settings.value(f"CA_ROTOR{i}_KM", at_s, 0.05) > 0.0 else -1 for i in range(rotors))
        return Airframe(f"of {rotors} rotors by CA_ROTORn_PX and _PY", np.column_stack([x, -y]), spin)
    number = int(settings.value("SYS_AUTOSTART", at_s, 0.0))
    if number // 1000 in PX4_AUTOSTART:
        known = PX4_AUTOSTART[number // 1000]
        return replace(known, name=f"{known.name} (SYS_AUTOSTART {number})")
    return PX4_AUTOSTART[4] if count == 4 else None


def _commands(topics: Topics, settings: Settings, source: str) -> _Commands | None:
    topic = topics.get(("actuator_motors", 0))
    if topic is not None:
        return _from_motors(topic, settings, source)
    outputs = [topics[key] for key in sorted(topics) if key[0] == "actuator_outputs"]
    return _from_outputs(outputs, settings, source) if outputs else None


def _require_multicopter(topics: Topics, settings: Settings, source: str) -> None:
    """Refuse a log without ``actuator_motors`` of what flies on wings."""
    kind = int(settings.value("MAV_TYPE", _AT_BOOT, 0.0))
    plane = kind == 1 or 19 <= kind <= 25
    if plane and ("actuator_motors", 0) not in topics and any(name == "actuator_outputs" for name, _ in topics):
        raise BadInput(
            f"{source}: is the log of a {'plane' if kind == 1 else 'VTOL plane'} (MAV_TYPE {kind}), not of a "
            "multicopter."
        )


def _from_motors(topic: Table, settings: Settings, source: str) -> _Commands:
    """``actuator_motors`` is a thrust per motor, whatever output it goes to; what reaches the ESC follows from
    THR_MDL_FAC.

    Raises:
        BadInput: motors turn both ways.
    """
    thrust = topic.array("control", _MOST_MOTORS)
    driven = np.isfinite(thrust).any(axis=0)
    count = int(np.flatnonzero(driven)[-1]) + 1 if driven.any() else 0
    thrust = thrust[:, :count]
    thrust[np.all(np.isnan(thrust), axis=1)] = 0.0  # disarmed
    if float(np.mean(np.any(thrust < -0.01, axis=1))) > 0.01:
        raise BadInput(
            f"{source}: its motors are sent less than nothing: they turn both ways (CA_R_REV), which is not read. Say "
            "with `groundstation convert --map` what drives the rotors."
        )
    t_s = topic.seconds()
    factor = settings.at("THR_MDL_FAC", t_s, 0.0)[:, None]
    stream = Stream(t_s, thrust_curve(thrust, factor), motor_columns("command", count))
    return _Commands(stream, tuple(f"actuator_motors {i + 1}" for i in range(count)), ("THR_MDL_FAC",))


def thrust_curve(thrust: Array, factor: Array) -> Array:
    """The command that reaches the ESC: PX4 inverts thrust = f u^2 + (1 - f) u with f = THR_MDL_FAC before it sends
    u.
    """
    f = np.maximum(factor, 1e-9)
    curved = (f - 1.0 + np.sqrt((1.0 - f) ** 2 + 4.0 * f * np.maximum(thrust, 0.0))) / (2.0 * f)
    return np.where(factor > 1e-6, curved, thrust)


@dataclass(frozen=True, slots=True)
class _Wiring:
    """Which outputs of a driver are motors: output (from 1) of each motor in order."""

    prefix: str
    outputs: tuple[int, ...]

    def name(self, index: int) -> str:
        return f"{self.prefix} {self.outputs[index]}" if self.prefix else f"output {self.outputs[index]}"


def _wirings(settings: Settings, at_s: float, source: str) -> list[_Wiring]:
    """By the parameters PREFIX_FUNCn = 101 (Motor 1), 102, ...; before 1.13 there are none.

    Raises:
        BadInput: the log has functions of motors, and no driver has all of them from the first on.
    """
    found: dict[str, dict[int, int]] = {}
    for name in settings.names():
        match = re.fullmatch(r"(\w+)_FUNC(\d+)", name)
        if match:
            motor = int(settings.value(name, at_s, 0.0)) - _FIRST_FUNCTION
            if 0 <= motor < _MOST_MOTORS:
                found.setdefault(match[1], {})[motor] = int(match[2])
    most = max([-1, *(motor for by_motor in found.values() for motor in by_motor)]) + 1
    whole = {prefix: by_motor for prefix, by_motor in found.items() if len(by_motor) == most}
    if found and not whole:
        told = "; ".join(
            f"{prefix}_FUNC{output} is motor {motor + 1}"
            for prefix, by_motor in sorted(found.items())
            for motor, output in sorted(by_motor.items())
        )
        raise BadInput(
            f"{source}: no driver of its outputs has all motors from 1 to {most} ({told}). Log actuator_motors, or say "
            "which output is which rotor with `groundstation convert --map`."
        )
    return [_Wiring(prefix, tuple(whole[prefix][motor] for motor in range(most))) for prefix in sorted(whole)]


def _from_outputs(outputs: list[Table], settings: Settings, source: str) -> _Commands:
    """``actuator_outputs``: the instance and the scale under which the motors' outputs are what the parameters say.

    Raises:
        BadInput: no hypothesis of instance, wiring and scale fits, or several do; all that were tested are named.
    """
    tested: list[str] = []
    fits: list[_Commands] = []
    for topic in outputs:
        t_s = topic.seconds()
        width = sum(f"output[{i}]" in topic for i in range(16))
        values = topic.array("output", width)
        start, _ = running(t_s, values)
        for wiring in _wirings(settings, start, source) or [_unnamed(values, settings)]:
            label = f"instance {topic.instance} as {wiring.prefix or 'outputs in order'}"
            if not wiring.outputs or max(wiring.outputs) > width:
                tested.append(f"{label}: has no such outputs")
                continue
            sent = values[:, [output - 1 for output in wiring.outputs]]
            if np.all(np.ptp(sent, axis=0) == 0.0):
                tested.append(f"{label}: never moves")
                continue
            scaled = _scaled(sent, t_s, wiring, settings)
            if isinstance(scaled, str):
                tested.append(f"{label}: {scaled}")
                continue
            command, scale, used = scaled
            stream = Stream(t_s, command, motor_columns("command", len(wiring.outputs)))
            wires = tuple(wiring.name(i) for i in range(len(wiring.outputs)))
            fits.append(_Commands(stream, wires, used, (f"motors: actuator_outputs, {scale}.",)))
            tested.append(f"{label}: fits, {scale}")
    if len(fits) == 1:
        return fits[0]
    why = "none fits" if not fits else "several fit"
    raise BadInput(
        f"{source}: which of its actuator_outputs are motors, and on which scale, cannot be told ({why}; tested: "
        f"{'; '.join(tested)}). Log actuator_motors, or say it with `groundstation convert --map`."
    )


_MOTORS_OF_TYPE = {2: 4, 13: 6, 14: 8, 15: 3}  # MAV_TYPE: quad, hexa, octo, tri


def _unnamed(values: Array, settings: Settings) -> _Wiring:
    """Before output functions: the outputs in order, as many as the airframe or the type of vehicle has motors.

    Where the log tells neither, as many as ever move.
    """
    known = PX4_AUTOSTART.get(int(settings.value("SYS_AUTOSTART", _AT_BOOT, 0.0)) // 1000)
    kind = int(settings.value("MAV_TYPE", _AT_BOOT, 0.0))
    moving = np.flatnonzero(np.ptp(values, axis=0) > 0.0)
    count = int(moving[-1]) + 1 if len(moving) else 0
    return _Wiring("", tuple(range(1, (known.count if known else _MOTORS_OF_TYPE.get(kind, count)) + 1)))


def _scaled(sent: Array, t_s: Array, wiring: _Wiring, settings: Settings) -> tuple[Array, str, tuple[str, ...]] | str:
    """Commands 0..1, by what they were scaled and the parameters used; or why no scale fits.

    Limits and protocol decide, and the range of the values must agree: DShot runs from 0 (stopped) to 1999, a pulse
    from the least to the greatest width that the parameters give.
    """
    lowest, highest = float(np.min(sent)), float(np.max(sent))
    if turned := _turned_round(wiring, settings, t_s):
        return turned
    timers = [name for name in settings.names() if re.fullmatch(rf"{wiring.prefix}_TIM\d+", name)]
    protocols = {settings.value(name, _AT_BOOT, 0.0) for name in timers}
    digital = bool(protocols & set(_DSHOT_TIMERS))
    if (
        highest <= 2047.0
        and wiring.prefix.startswith("PWM")
        and ((lowest < 700.0 and digital) or (protocols and protocols <= set(_DSHOT_TIMERS)))
    ):
        if settings.value("DSHOT_3D_ENABLE", _AT_BOOT, 0.0) > 0.0:
            return "motors that turn both ways (DSHOT_3D_ENABLE) are not read"
        least = np.maximum(np.floor(settings.at("DSHOT_MIN", t_s, 0.055) * _DSHOT_FULL), 1.0)[:, None]
        return (
            np.clip((sent - least) / (_DSHOT_FULL - least), 0.0, None),
            "DShot from DSHOT_MIN to 1999",
            ("DSHOT_MIN",),
        )
    bounds = [_limits(wiring, output, settings, t_s) for output in wiring.outputs]
    if any(bound is None for bound in bounds):
        if settings.value("UAVCAN_ENABLE", _AT_BOOT, 0.0) >= 2.0 and 2047.0 < highest <= _UAVCAN_FULL:
            return sent / _UAVCAN_FULL, f"raw commands of UAVCAN, from 0 to {_UAVCAN_FULL:g}", ()
        return (
            f"values {lowest:g} to {highest:g}, and the log has no limits ({wiring.prefix or 'PWM'}_MINn, _MAXn) "
            "for them"
        )
    names = tuple(name for bound in bounds if bound for name in bound[2])
    low, high = (np.column_stack([bound[side] for bound in bounds if bound]) for side in (0, 1))
    if np.any(high <= low):
        return "a limit MAX is not above its MIN"
    if highest <= 260.0 < float(np.min(low)):
        low, high = low / 8.0, high / 8.0  # OneShot125: the same widths, an eighth as long
    command = (sent - low) / (high - low)
    beyond = float(np.mean(np.max(command, axis=1) > 1.02))
    if beyond > 0.01 or float(np.max(np.quantile(command, 0.99, axis=0))) < 0.02:
        return f"values {lowest:g} to {highest:g} do not lie within the limits {np.min(low):g} to {np.max(high):g}"
    return np.clip(command, 0.0, 1.0), f"from {_span(low)} to {_span(high)} by {names[0]} and so on", names


def _turned_round(wiring: _Wiring, settings: Settings, t_s: Array) -> str:
    """Why outputs do not rise with thrust from their least value to their greatest; empty where they do."""
    mask = int(np.max(settings.at(f"{wiring.prefix}_REV", t_s, 0.0)))  # to 1.12 one parameter for each output
    for output in wiring.outputs:
        if mask >> (output - 1) & 1 or np.any(settings.at(f"{wiring.prefix}_REV{output}", t_s, 0.0) > 0.0):
            return f"output {output} is reversed ({wiring.prefix}_REV)"
    return ""


def _span(limit: Array) -> str:
    low, high = float(np.min(limit)), float(np.max(limit))
    return f"{low:g}" if low == high else f"{low:g}..{high:g}"


def _limits(
    wiring: _Wiring, output: int, settings: Settings, t_s: Array
) -> tuple[Array, Array, tuple[str, str]] | None:
    """The least and greatest value of an output over time, by the names of each version."""
    main = wiring.prefix or "PWM_MAIN"
    pairs: Iterable[tuple[str, str]] = (
        (f"{main}_MIN{output}", f"{main}_MAX{output}"),  # 1.13 on; 1.12 where not -1
        (f"{main}_MIN", f"{main}_MAX"),  # 1.12
        ("PWM_MIN", "PWM_MAX"),  # to 1.11
    )
    for low, high in pairs:
        if low in settings and high in settings and np.all(settings.at(high, t_s) > 0.0):
            return settings.at(low, t_s), settings.at(high, t_s), (low, high)
    return None


def _speeds(
    topics: Topics, commands: _Commands | None, count: int, source: str
) -> tuple[Stream | None, tuple[str, ...]]:
    """What the ESCs report, where a rotor was ever seen to turn; rad/s in the autopilot's order.

    An ESC is a motor's by its ``actuator_function`` (1.13 on), else by its place in the message.
    """
    escs, rpm = _turning(topics)
    if escs is None:
        return None, ()
    t_s, turning = escs.seconds(), list(rpm)
    places = [i for i in range(_MOST_MOTORS) if f"esc[{i}].esc_rpm" in escs]
    motor_of = {i: i for i in places}
    if all(f"esc[{i}].actuator_function" in escs for i in places):
        told = {i: int(np.median(escs.column(f"esc[{i}].actuator_function"))) - _FIRST_FUNCTION for i in turning}
        if sorted(told.values()) == list(range(len(turning))):
            motor_of = told
    if sorted(motor_of[i] for i in turning) != list(range(count)) and commands is not None:
        speeds = Stream(t_s, np.column_stack([rpm[i] for i in turning]), tuple(map(str, turning)))
        matched = motors_by_data(speeds, commands.stream)
        motor_of = dict(zip(turning, matched, strict=True)) if matched else motor_of
    by_motor = {motor_of[i]: i for i in turning}
    if sorted(by_motor) != list(range(count)):
        raise BadInput(
            f"{source}: esc_status tells speeds of {len(turning)} ESCs (places {', '.join(str(i) for i in turning)}), "
            f"and they cannot be told apart as the {count} motors; tested: actuator_function, the place in the "
            "message, and which command each speed follows. "
            'Use input = "command", or say it with `groundstation convert --map`.'
        )
    values = np.column_stack([rpm[by_motor[motor]] for motor in range(count)]) * _RPM
    wires = tuple(f"esc[{by_motor[motor]}]" for motor in range(count))
    return Stream(t_s, values, motor_columns("rotor_speed", count)), wires


def _turning(topics: Topics) -> tuple[Table | None, dict[int, Array]]:
    """The first instance of esc_status in which a rotor turns, and the rpm of those that do by their places."""
    for (name, _), escs in sorted(topics.items()):
        if name == "esc_status":
            places = [i for i in range(_MOST_MOTORS) if f"esc[{i}].esc_rpm" in escs]
            rpm = {i: np.abs(escs.column(f"esc[{i}].esc_rpm")) for i in places}
            turning = {i: values for i, values in rpm.items() if values.any()}
            if turning:
                return escs, turning
    return None, {}
