"""Blemishes of real logs: repaired, counted and reported, up to half of a stream; past that it is refused by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import BadInput
from groundstation.flightdata import FlightData, Stream
from groundstation.identification.clock_steps import cut_steps
from groundstation.recording import blemishes, plausible
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LONGEST_BRIDGE = 5  # samples in a row that are interpolated; longer runs are left out and become a gap
_SPEED_OF_SOUND_M_S = 340.0


def repair(flight: FlightData) -> FlightData:
    """Check a flight as it was read, and repair it.

    Returns:
        The flight with blemished samples left out or bridged, and a sentence in ``notes`` for each stream that had any.

    Raises:
        BadInput: units cannot be, time runs backwards, or more than half of a stream is blemished.
    """
    vehicle = flight.vehicle
    streams: dict[str, Stream] = {}
    notes: list[str] = []
    unusable: dict[str, _Unusable] = {}

    def attempt(name: str, step: Callable[[Stream, str], tuple[Stream, list[str]]], stream: Stream) -> None:
        try:
            streams[name], said = step(stream, name)
            notes.extend(said)
        except _Unusable as error:
            unusable[name] = error
            streams.pop(name, None)

    given = flight.streams()
    if "mocap" in given:
        given["mocap"], notes[:] = cut_steps(given["mocap"])
    for name, stream in given.items():
        attempt(name, _with_stamps, stream)
    _refuse_needed(unusable, streams)
    _check_units(streams, vehicle)
    for name, stream in dict(streams).items():
        attempt(name, lambda given, which: _REPAIRS[which](given, which, vehicle), stream)
    _refuse_needed(unusable, streams)
    left_out = {name: None for name in unusable}
    told = [f"{error.what} It is left out; the flight goes by {_motion_of(streams)}." for error in unusable.values()]
    return replace(flight, **streams, **left_out, notes=(*flight.notes, *told, *notes))


class _Unusable(BadInput):
    """A stream that holds too little to go by. A flight that does not need it goes on without."""

    def __init__(self, what: str, remedy: str):
        super().__init__(f"{what} {remedy}")
        self.what = what


def _motion_of(streams: Mapping[str, Stream]) -> str:
    return ", ".join(name for name in ("imu", "mocap", "state") if name in streams)


def _refuse_needed(unusable: Mapping[str, _Unusable], streams: Mapping[str, Stream]) -> None:
    """Raise where what is left holds no motors or no motion."""
    if "motors" in unusable:
        raise unusable["motors"]
    for name in ("imu", "mocap", "state"):
        if name in unusable and not _motion_of(streams):
            raise unusable[name]


def _with_stamps(stream: Stream, name: str) -> tuple[Stream, list[str]]:
    """Samples whose stamps increase."""
    if not len(stream):
        raise _Unusable(
            f"{name}: holds no samples.", f"Record them, or leave {name} out if the flight has other motion data."
        )
    if blemishes.runs_backwards(stream.t_s):
        raise BadInput(f"{name}: time t_s runs backwards over the whole file; sort it or correct the clock.")
    return _with_rising_stamps(stream, name)


def _with_rising_stamps(stream: Stream, name: str) -> tuple[Stream, list[str]]:
    keep = blemishes.increasing(stream.t_s)
    _refuse_past_half(name, {"stamps that repeat, run backwards or stray": ~keep}, len(keep))
    bad = int(np.sum(~keep))
    if not bad:
        return stream, []
    return stream.select(keep), [
        f"{name}: {bad} of {len(keep)} samples left out (time stamps that repeat, run backwards or stray)."
    ]


def _check_units(streams: Mapping[str, Stream], vehicle: Vehicle) -> None:
    for name in ("imu", "mocap", "state", "motors"):
        if name in streams:
            plausible.check_times(streams[name], name)
    for name in ("mocap", "state"):
        if name in streams:
            plausible.check_quaternions(streams[name], name)
            plausible.check_positions(streams[name], name)
    plausible.check_motors(streams["motors"], vehicle)
    if "imu" in streams:
        plausible.check_accelerometer(streams["imu"], vehicle.gravity_m_s2)
        plausible.check_gyro(streams["imu"], streams.get("mocap", streams.get("state")), streams["motors"], vehicle)
    if "battery" in streams:
        plausible.check_battery(streams["battery"])


def _refuse_past_half(name: str, causes: Mapping[str, Mask], total: int) -> None:
    """Raise where the causes together spoil more than half of a stream.

    Raises:
        BadInput: names the stream and the most frequent cause.
    """
    bad = int(np.sum(np.any(list(causes.values()), axis=0)))
    if 2 * bad > total:
        worst = max(causes, key=lambda cause: int(causes[cause].sum()))
        raise _Unusable(
            f"{name}: {bad} of {total} samples are unusable, most for {worst}; the stream is refused.",
            f"Record it anew, or leave {name} out if the flight has other motion data.",
        )


def _said(name: str, causes: Mapping[str, Mask], stream: Stream, how: str) -> list[str]:
    """The sentences about a stream's repairs and gaps."""
    notes = []
    counted = {cause: int(mask.sum()) for cause, mask in causes.items() if mask.any()}
    if counted:
        bad = int(np.sum(np.any(list(causes.values()), axis=0)))
        total = len(next(iter(causes.values())))
        parts = ", ".join(f"{count} {cause}" for cause, count in counted.items())
        notes.append(f"{name}: {bad} of {total} samples {how} ({parts}).")
    wide = blemishes.gaps(stream.t_s)
    if wide and name in ("imu", "mocap", "motors", "state"):
        start, length = max(wide, key=lambda gap: gap[1])
        notes.append(
            f"{name}: {len(wide)} gap{'s' if len(wide) > 1 else ''} in the stream, {sum(g[1] for g in wide):.2f} s "
            f"in all; the longest {length:.2f} s at {start:.2f} s."
        )
    return notes


def _refuse_mostly_gaps(name: str, stream: Stream) -> None:
    missing = sum(length for _, length in blemishes.gaps(stream.t_s))
    if len(stream) > 1 and 2.0 * missing > stream.t_s[-1] - stream.t_s[0]:
        raise _Unusable(
            f"{name}: {missing:.1f} of {stream.t_s[-1] - stream.t_s[0]:.1f} s are gaps; the stream is refused.",
            f"Record it anew, or leave {name} out if the flight has other motion data.",
        )


def _bridge(t_s: Array, values: Array, bad: Mask, *, hold: bool) -> tuple[Array, Mask]:
    """Replace marked cells of each column from its good neighbours in time.

    Args:
        t_s: increasing stamps, shape (k,).
        values: shape (k, c).
        bad: marked cells, shape (k, c).
        hold: keep the last good value (what a command does) rather than interpolate.

    Returns:
        The repaired values, and the rows that a run of more than five marked cells or an end leaves without.
    """
    values = values.copy()
    lost = np.zeros(len(t_s), bool)
    for column in np.flatnonzero(bad.any(axis=0)):
        marked = bad[:, column]
        good = np.flatnonzero(~marked)
        at = np.flatnonzero(marked)
        after = np.searchsorted(good, at)
        inside = (after > 0) & ((after < len(good)) | hold)
        left, right = good[np.maximum(after - 1, 0)], good[np.minimum(after, len(good) - 1)]
        short = inside & ((right - left - 1 <= _LONGEST_BRIDGE) | hold)
        if hold:
            values[at[short], column] = values[left[short], column]
        else:
            fraction = (t_s[at] - t_s[left]) / np.where(right > left, t_s[right] - t_s[left], 1.0)
            filled = values[left, column] + fraction * (values[right, column] - values[left, column])
            values[at[short], column] = filled[short]
        lost[at[~short]] = True
    return values, lost


def _cell_spikes(stream: Stream, columns: range, floor: float) -> Mask:
    out = np.zeros(stream.values.shape, bool)
    for column in columns:
        good = np.isfinite(stream.values[:, column])
        out[good, column] = blemishes.spikes(stream.values[good, column], floor)
    return out


def _repair_imu(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    step = blemishes.typical_step_s(stream.t_s)
    nonfinite = ~np.isfinite(stream.values)
    spiked = np.zeros_like(nonfinite)
    if step < 0.02:  # slower, one sample may be a whole motion
        # rad/s^3 and m/s^4 of the fastest rotors: full torque, or twice hover thrust, within 20 and 30 ms
        spiked |= _cell_spikes(stream, range(3), blemishes.curvature_floor(1.0, 1.5e4, step))
        spiked |= _cell_spikes(stream, range(3, 6), blemishes.curvature_floor(10.0, 2.0e4, step))
    causes = {"not numbers": np.any(nonfinite, axis=1), "spikes": np.any(spiked, axis=1)}
    _refuse_past_half(name, causes, len(stream))
    values, lost = _bridge(stream.t_s, stream.values, nonfinite | spiked, hold=False)
    repaired = replace(stream, values=values).select(~lost)
    _refuse_mostly_gaps(name, repaired)
    return repaired, _said(name, causes, repaired, "bridged or left out")


def _repair_mocap(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    causes: dict[str, Mask] = {}
    keep = np.ones(len(stream), bool)

    def drop(cause: str, find: Callable[[Stream], Mask]) -> None:
        marked = np.zeros(len(stream), bool)
        marked[keep] = find(stream.select(keep))
        causes[cause] = marked
        keep[marked] = False

    drop("not numbers", lambda s: ~np.all(np.isfinite(s.values), axis=1))
    drop("quaternions far from unit length", lambda s: np.abs(np.linalg.norm(s.values[:, 3:], axis=1) - 1.0) > 0.1)
    stuck = np.zeros(len(stream), bool)
    stuck[keep] = _stuck(stream.select(keep))
    drop("frozen poses", lambda s: blemishes.frozen(s.t_s, s.values[:, :3], s.values[:, 3:]))
    # Coarsely rounded poses of a vehicle at rest repeat too. They tell nothing new, but nothing is wrong with them.
    harmless = causes["frozen poses"] & ~stuck
    drop("spikes", lambda s: blemishes.pose_spikes(s.t_s, s.values[:, :3], s.values[:, 3:]))
    drop("poses beyond a jump", lambda s: blemishes.jumps(s.t_s, s.values[:, :3], s.values[:, 3:]))
    _refuse_past_half(name, {cause: mask & ~harmless for cause, mask in causes.items()}, len(stream))
    repaired = _unit_quaternions(stream.select(keep), 3)
    if not causes["frozen poses"].any():
        _refuse_mostly_gaps(name, repaired)
    return repaired, _said(name, causes, repaired, "left out")


def _stuck(stream: Stream) -> Mask:
    """Frozen poses that the next one leaps away from by 1 mm or 2 mrad: those the vehicle moved on from unseen."""
    return blemishes.frozen(stream.t_s, stream.values[:, :3], stream.values[:, 3:], leap_m=1e-3, leap_rad=2e-3)


def _unit_quaternions(stream: Stream, first: int) -> Stream:
    values = stream.values.copy()
    values[:, first : first + 4] /= np.linalg.norm(values[:, first : first + 4], axis=1, keepdims=True)
    return replace(stream, values=values)


def _repair_state(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    finite = np.all(np.isfinite(stream.values), axis=1)
    norm = np.linalg.norm(np.nan_to_num(stream.values[:, 6:10]), axis=1)
    causes = {"not numbers": ~finite, "quaternions far from unit length": finite & (np.abs(norm - 1.0) > 0.1)}
    _refuse_past_half(name, causes, len(stream))
    repaired = _unit_quaternions(stream.select(~np.any(list(causes.values()), axis=0)), 6)
    return repaired, _said(name, causes, repaired, "left out")


def _refuse_a_bad_rotor(name: str, columns: Sequence[str], bad: NDArray[np.bool_]) -> None:
    """No fit is made from a rotor of which most is guessed."""
    for column, share in zip(columns, np.count_nonzero(bad, axis=0) / max(len(bad), 1), strict=True):
        if share > 0.5:
            raise BadInput(
                f"{name}: {share:.0%} of {column} is no number, no possible value or far too low in flight; the stream "
                "is refused. Mend that rotor's telemetry and fly again."
            )


def _repair_motors(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    rotors = vehicle.rotors
    measured = rotors.measured
    notes: list[str] = []
    values = stream.values
    nonfinite = ~np.isfinite(values)
    impossible, spiked = np.zeros_like(nonfinite), np.zeros_like(nonfinite)
    if rotors.input == "rotor_speed":
        signed = 2 * np.count_nonzero(~nonfinite & (values < 0.0), axis=0) > np.count_nonzero(~nonfinite, axis=0)
        if signed.any():
            values = np.where(signed, -values, values)
            stream = replace(stream, values=values)
            notes.append(f"{name}: {int(signed.sum())} rotors have negative speeds throughout; their size is used.")
        top = 2.0 * rotors.speed_max_rad_s if rotors.speed_max_rad_s else 1.5 * _SPEED_OF_SOUND_M_S / rotors.radius_m
        impossible = ~nonfinite & ((values > top) | (values < -0.01 * top))
        if measured and blemishes.typical_step_s(stream.t_s) < 0.02:
            shown = replace(stream, values=np.where(impossible, np.nan, values))
            spiked = _cell_spikes(shown, range(values.shape[1]), 0.125 * top)
    elif rotors.input == "command":
        impossible = ~nonfinite & ((values > 1.5) | (values < -0.1))
    low = np.zeros_like(nonfinite)
    if measured:
        low = blemishes.too_slow(stream.t_s, np.where(nonfinite | impossible | spiked, np.nan, values))
    bad = nonfinite | impossible | spiked | low
    _refuse_a_bad_rotor(name, stream.columns, bad)
    causes = {
        "not numbers": np.any(nonfinite, axis=1),
        "impossible values": np.any(impossible, axis=1),
        "spikes": np.any(spiked, axis=1),
        "far too low in flight": np.any(low, axis=1),
    }
    _refuse_past_half(name, causes, len(stream))
    values, lost = _bridge(stream.t_s, values, bad, hold=not measured)
    repaired = replace(stream, values=values).select(~lost)
    return repaired, notes + _said(name, causes, repaired, "bridged or left out")


def _repair_battery(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    volts = stream.values[:, 0]
    finite = np.isfinite(volts)
    impossible = finite & (volts <= 0.0)
    good = finite & ~impossible
    spiked = np.zeros(len(stream), bool)
    if good.any():
        spiked[good] = blemishes.spikes(volts[good], 0.2 * float(np.median(volts[good])))
    causes = {"not numbers": ~finite, "impossible values": impossible, "spikes": spiked}
    _refuse_past_half(name, causes, len(stream))
    repaired = stream.select(good & ~spiked)
    return repaired, _said(name, causes, repaired, "left out")


def _repair_setpoint(stream: Stream, name: str, vehicle: Vehicle) -> tuple[Stream, list[str]]:
    causes = {"not numbers": ~np.all(np.isfinite(stream.values[:, :3]), axis=1)}
    _refuse_past_half(name, causes, len(stream))
    repaired = stream.select(~causes["not numbers"])
    return repaired, _said(name, causes, repaired, "left out")


_REPAIRS: Mapping[str, Callable[[Stream, str, Vehicle], tuple[Stream, list[str]]]] = {
    "imu": _repair_imu,
    "mocap": _repair_mocap,
    "motors": _repair_motors,
    "battery": _repair_battery,
    "setpoint": _repair_setpoint,
    "state": _repair_state,
}
