"""What an ArduPilot log says of its motors: which outputs they are, on which scale, and what their ESCs report.

Sources: ArduPilot's parameter documentation (``FRAME_CLASS``, ``FRAME_TYPE``, ``SERVOn_FUNCTION``, ``MOT_PWM_MIN``,
``_MAX``) and log messages (RCOU, ESC).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import Stream, motor_columns
from groundstation.recording.airframes import ARDUPILOT, ARDUPILOT_CLASSES, Airframe
from groundstation.recording.autopilot import (
    MOTORS_SLOW_HZ,
    check_count,
    motor_map,
    motor_order,
    running,
    slow_note,
    wanted_input,
)
from groundstation.recording.computed_speeds import motors_by_data
from groundstation.recording.settings import Settings
from groundstation.recording.tables import MissingField, Table
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Tables = Mapping[str, Table]

_REMEDY = (
    "ArduPilot writes RCOU at 10 Hz whatever the setting: record SERVO_OUTPUT_RAW over the link at full rate, or use "
    'ESC telemetry (a vehicle file with input = "rotor_speed").'
)
_FUNCTIONS = (*range(33, 41), *range(82, 86))  # of motors 1 to 8 and 9 to 12
_MOST_OUTPUTS = 32
_PWM_RANGE, _PWM_ANGLE = 8, 9  # MOT_PWM_TYPE: outputs scaled as those of servos
_TESTED = (
    "MOT_PWM_MIN and MOT_PWM_MAX, and the throttle channel's RC3_MIN and RC3_MAX",
    "SERVOn_MIN and SERVOn_MAX, which MOT_PWM_TYPE 8 asks for",
)
_RPM = 2.0 * np.pi / 60.0


def read_motors(tables: Tables, settings: Settings, vehicle: Vehicle, source: str) -> tuple[Stream, list[str]]:
    """The motors in the vehicle file's order: commands from RCOU, or the speeds that ESCs report.

    Raises:
        BadInput: no outputs, another number of motors, or outputs whose scale the log does not give.
    """
    outputs = _outputs(tables)
    if outputs is not None and not len(outputs[0]):
        outputs = None
    start, _ = running(*outputs) if outputs else (-np.inf, np.inf)
    channels, said = _channels(settings, start, vehicle.rotors.count, source)
    airframe = _airframe(settings, start, len(channels), source)
    wires = [f"output {channel}" for channel in channels]
    frame = airframe.name if airframe else "not told by the log, motor i is taken for rotor i"
    check_count(vehicle, len(channels), f"{frame}; {', '.join(wires)}", source)
    order, notes = motor_order(vehicle, airframe, source) if airframe else (list(range(len(channels))), [])
    there: dict[str, Stream] = {}
    escs = _escs(tables)
    if outputs is not None:
        try:
            there["command"], scaling = _commands(outputs, channels, settings, source)
        except BadInput:  # of no account where the ESCs' speeds are asked for and there
            if vehicle.rotors.input != "rotor_speed" or not escs:
                raise
    wires_esc: list[str] = []
    if escs:
        try:
            there["rotor_speed"], wires_esc = _speeds(escs, channels, there.get("command"), source)
        except BadInput:  # the speeds of some rotors are nothing to who asks for commands
            if "command" not in there or vehicle.rotors.input == "rotor_speed":
                raise
            said = [*said, "motors: ESC telemetry does not cover all rotors; it is not used."]
    kind = wanted_input(vehicle, {name: name in there for name in ("command", "rotor_speed")}, source)
    stream = there[kind]
    stream = replace(stream, values=stream.values[:, order])
    if kind == "rotor_speed":
        notes = [motor_map(order, wires_esc, frame), *notes, *said]
        notes.append("motors: ESC telemetry; speeds of the other rotors are interpolated to the stamps of the first.")
        return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, "raise the ESC telemetry rate.")
    notes = [
        motor_map(order, wires, frame),
        *notes,
        *said,
        *settings.told(scaling, *running(stream.t_s, stream.values)),
    ]
    return stream, notes + slow_note("motors", stream, MOTORS_SLOW_HZ, _REMEDY)


def _outputs(tables: Tables) -> tuple[Array, Array] | None:
    """Times and pulse widths of all outputs in order; C1 and on, to 3.2 Ch1 and Chan1."""
    table = tables.get("RCOU")
    if table is None:
        return None
    stem = next((stem for stem in ("C", "Ch", "Chan") if f"{stem}1" in table), None)
    if stem is None:
        raise MissingField("RCOU", "C1")
    width = sum(f"{stem}{i}" in table for i in range(1, _MOST_OUTPUTS + 1))
    t_s, values = table.seconds(), table.columns(*(f"{stem}{i}" for i in range(1, width + 1)))
    more = tables.get("RCO2")  # outputs 15 and on, where the vehicle has them
    if more is not None and len(more) == len(table):
        names = sorted((n for n in more.fields if n[0] == "C" and n[1:].isdigit()), key=lambda n: int(n[1:]))
        values = np.hstack([values, more.columns(*names)])
    return t_s, values


def _channels(settings: Settings, at_s: float, rotors: int, source: str) -> tuple[list[int], list[str]]:
    """Output of each motor, from 1, by SERVOn_FUNCTION (to 3.4 RCn_FUNCTION).

    Raises:
        BadInput: the log has output functions, and none or only some are motors.
    """
    for stem in ("SERVO", "RC"):
        functions = {
            channel: int(settings.value(name, at_s, 0.0))
            for channel in range(1, _MOST_OUTPUTS + 1)
            if (name := f"{stem}{channel}_FUNCTION") in settings
        }
        by_motor = {_FUNCTIONS.index(f): channel for channel, f in functions.items() if f in _FUNCTIONS}
        if by_motor and sorted(by_motor) == list(range(len(by_motor))):
            return [by_motor[motor] for motor in range(len(by_motor))], []
        if functions and (stem == "SERVO" or by_motor):
            given = ", ".join(f"{stem}{channel}_FUNCTION {f}" for channel, f in functions.items() if f) or "all 0"
            raise BadInput(
                f"{source}: its outputs are not those of a multicopter's motors 1 to n ({given}); motors have the "
                "functions 33 and on. Give a log of a multicopter."
            )
    return list(range(1, rotors + 1)), [
        "motors: the log has no output functions; outputs 1 and on are taken for motors."
    ]


def _airframe(settings: Settings, at_s: float, motors: int, source: str) -> Airframe | None:
    """By FRAME_CLASS and FRAME_TYPE (to 3.4 FRAME, of a quad); None where the log has neither.

    Raises:
        BadInput: the frame has another number of motors than there are outputs, or is not one known here.
    """
    if "FRAME_CLASS" in settings:
        kind = int(settings.value("FRAME_CLASS", at_s, 1.0)), int(settings.value("FRAME_TYPE", at_s, 1.0))
    elif motors == 4:
        kind = 1, int(settings.value("FRAME", at_s, 1.0))
    else:
        return None
    airframe = ARDUPILOT.get(kind)
    name = ARDUPILOT_CLASSES.get(kind[0], "unknown")
    if airframe is None:
        raise BadInput(
            f"{source}: the motors' places on a frame of class {kind[0]} ({name}) and type {kind[1]} are not known "
            f"here ({motors} outputs are motors); say which output is which rotor with `groundstation convert --map`."
        )
    if airframe.count != motors:
        raise BadInput(
            f"{source}: FRAME_CLASS {kind[0]} ({airframe.name}) has {airframe.count} motors, and {motors} outputs are "
            "motors by their functions; the log contradicts itself. Say which output is which rotor with "
            "`groundstation convert --map`."
        )
    return airframe


def _limits(settings: Settings, t_s: Array) -> tuple[Array, Array, list[str]] | None:
    """Least and greatest pulse over time: MOT_PWM_MIN and _MAX, or where those are 0 the throttle channel's."""
    throttle = int(settings.value("RCMAP_THROTTLE", -np.inf, 3.0))
    names = [("MOT_PWM_MIN", f"RC{throttle}_MIN"), ("MOT_PWM_MAX", f"RC{throttle}_MAX")]
    bounds = []
    for own, radio in names:
        value = settings.at(own, t_s, 0.0)
        bounds.append(np.where(value > 0.0, value, settings.at(radio, t_s, 0.0)))
    if np.any(bounds[0] <= 0.0) or np.any(bounds[1] <= bounds[0]):
        return None
    return bounds[0][:, None], bounds[1][:, None], [name for pair in names for name in pair]


def _of_servos(settings: Settings, t_s: Array, channels: list[int]) -> tuple[Array, Array, list[str]] | None:
    """Least and greatest pulse of each output over time under MOT_PWM_TYPE 8: those of the servo output."""
    names = [(f"SERVO{channel}_MIN", f"SERVO{channel}_MAX") for channel in channels]
    low, high = (np.column_stack([settings.at(pair[side], t_s, 0.0) for pair in names]) for side in (0, 1))
    if np.any(low <= 0.0) or np.any(high <= low):
        return None
    return low, high, [name for pair in names for name in pair]


def _require_one_way(settings: Settings, channels: list[int], kind: int, source: str) -> None:
    """Refuse outputs that do not rise with thrust from their least value to their greatest.

    Raises:
        BadInput: says which parameter has it otherwise.
    """
    both_ways = int(settings.value("SERVO_BLH_3DMASK", -np.inf, 0.0))
    why = "MOT_PWM_TYPE 9: thrust goes from an angle to the other" if kind == _PWM_ANGLE else ""
    for channel in channels:
        if both_ways >> (channel - 1) & 1:
            why = f"SERVO_BLH_3DMASK {both_ways}: output {channel} drives a motor both ways"
        if kind == _PWM_RANGE and settings.value(f"SERVO{channel}_REVERSED", -np.inf, 0.0) > 0.0:
            why = f"SERVO{channel}_REVERSED 1: output {channel} falls where thrust rises"
    if why:
        raise BadInput(
            f"{source}: its motor outputs do not rise with thrust from MIN to MAX ({why}); such motors are not read. "
            'Log ESC telemetry (a vehicle file with input = "rotor_speed"), or say the scale with '
            "`groundstation convert --map`."
        )


def _commands(
    outputs: tuple[Array, Array], channels: list[int], settings: Settings, source: str
) -> tuple[Stream, list[str]]:
    """Pulse widths as fractions between the limits in force at each time.

    Raises:
        BadInput: the log has no limits, lacks an output, or the widths lie outside.
    """
    t_s, widths = outputs
    if max(channels) > widths.shape[1]:
        raise BadInput(
            f"{source}: RCOU holds outputs 1 to {widths.shape[1]}, and a motor is on output {max(channels)}."
        )
    kind = int(settings.value("MOT_PWM_TYPE", -np.inf, 0.0))  # what is set later waits for the next start
    _require_one_way(settings, channels, kind, source)
    limits = _of_servos(settings, t_s, channels) if kind == _PWM_RANGE else _limits(settings, t_s)
    sent = widths[:, [channel - 1 for channel in channels]]
    if limits is None:
        raise BadInput(
            f"{source}: the scale of its outputs ({np.min(sent):g} to {np.max(sent):g}) is not in the log: tested were "
            f"{_TESTED[kind == _PWM_RANGE]}. Log the parameters."
        )
    low, high, names = limits
    command = (sent - low) / (high - low)
    if float(np.mean(np.max(command, axis=1) > 1.02)) > 0.01:
        raise BadInput(
            f"{source}: outputs of up to {np.max(sent):g} lie beyond the limits {np.min(low):g} to {np.max(high):g} "
            f"({_TESTED[kind == _PWM_RANGE]}); the log contradicts itself."
        )
    return Stream(t_s, np.clip(command, 0.0, 1.0), motor_columns("command", len(channels))), names


def _escs(tables: Tables) -> dict[int, tuple[Array, Array]]:
    """Times and rpm of each ESC that ever turned, by instance: ESC (4.1 on), or ESC1, ESC2, ..."""
    found: dict[int, tuple[Array, Array]] = {}
    table = tables.get("ESC")
    if table is not None:
        instance, t_s, rpm = table.raw("Instance"), table.seconds(), table.column("RPM")
        found = {int(i): (t_s[instance == i], rpm[instance == i]) for i in np.unique(instance)}
    else:
        for number in range(1, 13):
            one = tables.get(f"ESC{number}")
            if one is not None:
                found[number - 1] = one.seconds(), one.column("RPM")
    return {i: (t_s, np.abs(rpm)) for i, (t_s, rpm) in found.items() if len(t_s) > 1 and rpm.any()}


def _speeds(
    escs: dict[int, tuple[Array, Array]], channels: list[int], commands: Stream | None, source: str
) -> tuple[Stream, list[str]]:
    """Speeds in the order of the motors; an ESC's instance is its output's number less one, or the motor's.

    Raises:
        BadInput: they cannot be told apart as the motors.
    """
    count = len(channels)
    instances = sorted(escs)
    by_output = [channel - 1 for channel in channels]
    chosen = next((h for h in (by_output, list(range(count))) if sorted(h) == instances), None)
    stream = _together([escs[i] for i in instances])
    if chosen is None and len(instances) == count and commands is not None:
        follows = motors_by_data(stream, commands)
        chosen = [instances[follows.index(motor)] for motor in range(count)] if follows else None
    if chosen is None:
        raise BadInput(
            f"{source}: ESC telemetry covers {len(instances)} of {count} rotors, or under numbers that are not theirs: "
            f"it has the instances {', '.join(map(str, instances))}; tested were the outputs' "
            f"({', '.join(map(str, sorted(by_output)))}), the motors' (0 to {count - 1}), and which command each speed "
            "follows."
        )
    values = stream.values[:, [instances.index(i) for i in chosen]]
    speeds = Stream(stream.t_s, values * _RPM, motor_columns("rotor_speed", count))
    return speeds, [f"ESC instance {i}" for i in chosen]


def _together(escs: list[tuple[Array, Array]]) -> Stream:
    """All at the stamps of the first, between the latest start and the earliest end."""
    begin, end = max(t_s[0] for t_s, _ in escs), min(t_s[-1] for t_s, _ in escs)
    t_s = escs[0][0]
    t_s = t_s[(t_s >= begin) & (t_s <= end)]
    values = np.column_stack([np.interp(t_s, own, rpm) for own, rpm in escs])
    return Stream(t_s, values, tuple(f"esc_{i}" for i in range(len(escs))))
