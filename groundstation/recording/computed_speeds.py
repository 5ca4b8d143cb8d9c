"""Rotor speeds that nobody measured: an autopilot's simulator multiplies the motor command by a number of its own.

PX4's simulator link reports ``esc_rpm = 6000 control`` whatever turns at the other end (``send_esc_telemetry`` in its
``SimulatorMavlink.cpp``). Taken for measurements, such speeds give every force and inertia on the scale of that number.
A rotor's speed lags its command by tens of milliseconds and sags with the battery, so that it is not the command of the
same instant times one number, down to the last digit of both, on every rotor at once: where it is, at more than half of
all instants, the command is all that is known. Half, because on a late or lossy line a speed stands beside the command
before or after its own; of measured rotors hardly one instant in a hundred agrees like that
(tests/test_recording_computed_speeds.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from groundstation.flightdata import Stream, motor_columns, resampled
from groundstation.recording.recorded import Recording

COMMANDS = "motor_commands"
"""The stream of commands beside one of measured speeds, in a recording's extras."""

_RPM = 2.0 * np.pi / 60.0
_COMMAND_STEP = 1e-3  # of a pulse width in microseconds
_LEAST = 100
_SHARE = 0.5  # of the instants


def computed_gain(speeds: Stream, commands: Stream) -> float | None:
    """rad/s per unit command by which speeds were computed from the commands; None where they are measurements.

    Compared are samples with one stamp, of turning rotors whose speed varies far beyond the digits it is told in.
    """
    if min(len(speeds), len(commands)) < _LEAST:
        return None
    after = np.clip(np.searchsorted(commands.t_s, speeds.t_s), 1, len(commands) - 1)
    at = after - (speeds.t_s - commands.t_s[after - 1] < commands.t_s[after] - speeds.t_s)
    u, w = commands.values[at], speeds.values
    together = np.abs(commands.t_s[at] - speeds.t_s) < 0.25 / max(speeds.rate_hz(), commands.rate_hz())
    paired = together & np.all((u > 0.0) & (w > 0.0), axis=1)
    u, w = u[paired], w[paired]
    if len(u) < _LEAST:
        return None
    gain = _commonest(w / u)
    digits = 0.5 * (_RPM + gain * _COMMAND_STEP)
    if float(np.min(np.std(w, axis=0))) < 10.0 * digits:
        return None
    return gain if float(np.mean(np.all(np.abs(w - gain * u) <= digits, axis=1))) >= _SHARE else None


def _commonest(ratios: np.ndarray) -> float:
    """The middle of the shortest stretch that holds half of all ratios: the median is pulled by what came late."""
    ordered = np.sort(ratios, axis=None)
    half = len(ordered) // 2
    begin = int(np.argmin(ordered[half:] - ordered[: len(ordered) - half]))
    return float(np.median(ordered[begin : begin + half + 1]))


def commands_behind(speeds: Stream, commands: Stream) -> tuple[Stream, str] | None:
    """The commands, at the faster of both rates, and what to say of it; None where the speeds are measurements."""
    if silent := _silent(speeds, commands):
        names = ", ".join(map(str, silent))
        return commands, f"motors: the ESCs tell no speed of rotor {names} while it is driven; the commands are used."
    gain = computed_gain(speeds, commands)
    if gain is None:
        return None
    note = (
        f"motors: the ESCs' speeds are the commands times {gain / _RPM:.0f} rpm at every instant, to the last digit: "
        "the autopilot's simulator computed them, nobody measured them; the commands are used."
    )
    if commands.rate_hz() >= speeds.rate_hz():
        return commands, note
    return replace(speeds, values=speeds.values / gain, columns=commands.columns), note


_DRIVEN = 0.05
"""Command from which on a rotor turns, whatever its idle speed."""


def _silent(speeds: Stream, commands: Stream) -> list[int]:
    """Rotors (from 1) whose speed is told as zero all along while they are driven.

    ArduPilot's simulator does that of its own frames.
    """
    if min(len(speeds), len(commands)) < _LEAST:
        return []
    span = (commands.t_s >= speeds.t_s[0]) & (commands.t_s <= speeds.t_s[-1])
    driven = np.count_nonzero(commands.values[span] > _DRIVEN, axis=0) >= _LEAST
    return [int(i) + 1 for i in np.flatnonzero(driven & ~np.any(speeds.values > 0.0, axis=0))]


_FOLLOWS, _CLEARLY = 0.5, 0.2


def motors_by_data(speeds: Stream, commands: Stream) -> list[int] | None:
    """Which command each speed follows, by correlation of what sets the rotors apart; None where the data do not tell.

    The mean over the rotors is removed from both: what all do together (a climb) tells nothing. A pair counts where its
    correlation is above 0.5 and 0.2 above every other of that speed.

    Args:
        speeds: of any rotors in any order, shape (k, n).
        commands: in the order wanted, shape (m, n).

    Returns:
        For each column of the speeds the column of the commands.
    """
    from scipy.optimize import linear_sum_assignment

    count = len(commands.columns)
    if len(speeds.columns) != count or min(len(speeds), len(commands)) < _LEAST:
        return None
    inside = (speeds.t_s >= commands.t_s[0]) & (speeds.t_s <= commands.t_s[-1])
    sent = resampled(speeds.t_s[inside], commands.t_s, commands.values)
    made = speeds.values[inside]
    on = (sent.mean(axis=1) > 0.1 * sent.mean(axis=1).max(initial=0.0)) & np.all(made > 0.0, axis=1)
    sent, made = sent[on], made[on]
    if len(made) < _LEAST:
        return None
    sent, made = sent - sent.mean(axis=1, keepdims=True), made - made.mean(axis=1, keepdims=True)
    if np.any(np.std(sent, axis=0) == 0.0) or np.any(np.std(made, axis=0) == 0.0):
        return None
    agreement = np.corrcoef(made.T, sent.T)[:count, count:]
    follows = [int(i) for i in linear_sum_assignment(-agreement)[1]]
    for speed, command in enumerate(follows):
        others = np.delete(agreement[speed], command)
        if agreement[speed, command] < _FOLLOWS or agreement[speed, command] < others.max() + _CLEARLY:
            return None
    return follows


def without_computed_speeds(recording: Recording) -> Recording:
    """With the commands as motor values where the speeds were computed from them."""
    speeds, commands = recording.streams.get("motors"), recording.extras.get(COMMANDS)
    if speeds is None or commands is None or speeds.columns != motor_columns("rotor_speed", len(speeds.columns)):
        return recording
    found = commands_behind(speeds, commands)
    if found is None:
        return recording
    extras = {name: stream for name, stream in recording.extras.items() if name != COMMANDS}
    streams = {**recording.streams, "motors": found[0]}
    return replace(recording, streams=streams, extras=extras, notes=(*recording.notes, found[1]))
