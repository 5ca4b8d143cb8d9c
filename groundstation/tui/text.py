"""Statuses as rows of text, for the first screen too: it imports no numerics. Pure; the numbers are the core's."""

from __future__ import annotations

import math
from collections.abc import Mapping

from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import Phase

Row = tuple[str, ...]
KEYS = """\
^g, F8  abort and land
^o, F9  stop the rotors, after a question
^p      every command by name
1 … 7   the screens
Escape  leave a field
l       the run's log
t       light or dark
?, F1   this help
q       close this program; a flight goes on
"""
CONFIRM = """\
Everything is checked. A real vehicle is about to arm and take off.
Is the area clear, and is the pilot ready to take over?"""
ELSEWHERE = (
    "This shows another station. Flights are prepared at that station's own machine and appear here; ^g aborts and "
    "lands. With a pass for operators, o takes the lease and s starts."
)
KILL = """\
Stop the rotors now? The vehicle falls from where it is.
Abort and land (^g) brings it down under control."""
OWN_CLOCK_S = 10.0
"""A stamp further than this from its arrival is of a clock that began at another time."""
PHASES: Mapping[str, str] = {
    Phase.IDLE: "the vehicle's process is coming up",
    Phase.PLANNED: "sending the plan to the vehicle",
    Phase.UPLOADED: "the vehicle holds the plan; checking",
    Phase.CHECKED: "everything is checked: ready to start",
    Phase.AIRBORNE: "taking off",
    Phase.EXCITING: "flying the excitation",
    Phase.LANDING: "coming down",
    Phase.LANDED: "landed; the recording is closed",
    Phase.IDENTIFYING: "identifying",
    Phase.DONE: "done",
    Phase.ABORTED: "ended early",
}


def stream_rows(status: CoreStatus) -> list[Row]:
    """One row per stream: name, rate, age, longest gap, samples, latency, and in a word how it does.

    Latency is from stamp to arrival; where device clocks began at another time than this computer's, it is told against
    the stream that has least of it.
    """
    foreign = any(abs(stream.delay_s) > OWN_CLOCK_S for stream in status.streams.values() if stream.count)
    least = min((stream.delay_s for stream in status.streams.values() if stream.count), default=0.0) if foreign else 0.0
    rows = []
    for name, stream in sorted(status.streams.items()):
        gap = f"{1e3 * stream.longest_gap_s:.0f} ms"
        word = "! see below" if stream.trouble else "arrives" if stream.rate_hz > 0.5 else "waiting"
        delay = f"{1e3 * (stream.delay_s - least):.1f} ± {1e3 * stream.delay_std_s:.1f} ms" if stream.count else "–"
        rows.append(
            (name, f"{stream.rate_hz:.0f} Hz", f"{1e3 * stream.age_s:.0f} ms", gap, f"{stream.count}", delay, word)
        )
    return rows


def stream_notes(status: CoreStatus) -> str:
    """What is wrong with which stream and what to do, then the clocks, losses and the newest sentences of the log."""
    lines = [f"! {name}: {stream.trouble}" for name, stream in sorted(status.streams.items()) if stream.trouble]
    if status.mocap:
        lines.append(status.mocap)
    if status.clock_s is not None:
        offset, half = (1e3 * value for value in status.clock_s)
        lines.append(f"clocks: motion capture minus IMU {offset:+.1f} ± {half:.1f} ms (95 %)")
    elif "pose" in status.streams:
        lines.append("clocks: motion capture minus IMU not known yet; 12 s of the excitation tell")
    pace = "at the wall clock's pace" if status.real_time else "in simulated time"
    losses = (
        f"{status.lost} batches lost, {status.rejected} not decoded"
        if status.lost + status.rejected
        else "nothing lost"
    )
    lines.append(f"{status.recorded} samples recorded, {losses}; {pace}")
    return "\n".join([*lines, "", *status.notes[-4:]]).rstrip()


def state_lines(status: CoreStatus) -> str:
    """Where the vehicle is and how it lies."""
    roll, pitch, yaw = (math.degrees(angle) for angle in status.euler_rad)
    x, y, z = status.position_m
    return "\n".join(
        [
            f"position {x:+7.3f} {y:+7.3f} {z:+7.3f} m",
            f"attitude {roll:+7.1f} {pitch:+7.1f} {yaw:+7.1f} °",
        ]
    )
