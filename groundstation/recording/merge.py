"""The vehicle's own log, fetched after landing, joined with what came over the link: one flight on one clock.

The autopilot stamps its log and its telemetry with the same clock. That is verified, not assumed: turn rates of both
must go together, and where they do so at another offset, the log's stamps are moved to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import Stream
from groundstation.recording.recorded import Recording

Array = NDArray[np.float64]

_GRID_S = 0.02
_AGREE = 0.6  # correlation from which two records are of one motion
_SAME_CLOCK_S = 0.1  # transport and filters shift telemetry by less


def onboard_log_of(recording: Path) -> Path | None:
    """The log that was fetched beside a recording."""
    return next(
        (path for suffix in (".ulg", ".bin") if (path := recording.with_name(f"onboard{suffix}")).is_file()), None
    )


def merge_onboard(link: Recording, onboard: Recording, name: str) -> Recording:
    """The link's recording with each of the vehicle's own streams that the log has faster, or has alone.

    Motion capture stays the station's, where the station had it.

    Args:
        link: what was recorded on the ground.
        onboard: the vehicle's log.
        name: the log's, for the notes.
    """
    offset_s, told = clock_offset(link.streams, onboard.streams)
    if offset_s is None:
        return replace(link, notes=(*link.notes, f"{name}: {told}; the log is left out."))
    streams, said = dict(link.streams), []
    for key, stream in onboard.streams.items():
        before = link.streams.get(key)
        if before is not None and (key in ("mocap", "setpoint") or stream.rate_hz() <= before.rate_hz()):
            continue
        if before is not None and stream.columns != before.columns:  # commands do not stand in for measured speeds
            continue
        streams[key] = replace(
            stream, t_s=stream.t_s + offset_s, received_s=_arrivals(stream.t_s + offset_s, link.streams)
        )
        said.append(
            f"{key} at {stream.rate_hz():.0f} Hz" + (f" for {before.rate_hz():.0f}" if before is not None else "")
        )
    if not said:
        return replace(link, notes=(*link.notes, f"{name}: the log has nothing faster than the link; it is left out."))
    both = dict.fromkeys((*link.notes, *onboard.notes))  # what both say is said once
    notes = (*both, f"{name}: {', '.join(said)} from the vehicle's own log; {told}.")
    return replace(link, streams=streams, notes=notes)


def _arrivals(t_s: Array, streams: Mapping[str, Stream]) -> Array | None:
    """When samples of these stamps would have arrived: what relates the vehicle's clock to the other devices'."""
    for key in ("imu", "motors", "state"):
        stream = streams.get(key)
        if stream is not None and stream.received_s is not None:
            return t_s + float(np.nanmedian(stream.received_s - stream.t_s))
    return None


def clock_offset(link: Mapping[str, Stream], onboard: Mapping[str, Stream]) -> tuple[float | None, str]:
    """What to add to the log's stamps to have them on the link's clock, and how that was found.

    Returns:
        The offset, or None where the log is of another flight; and a phrase for the notes.
    """
    pair = _comparable(link, onboard)
    if pair is None:
        return 0.0, "its clock is taken for that of the telemetry: nothing in both can be compared"
    (t_link, x_link), (t_log, x_log) = pair
    shift, agreement = _best_shift(t_link, x_link, t_log, x_log)
    if agreement < _AGREE:
        if t_link[-1] < t_log[0] or t_log[-1] < t_link[0]:
            return None, "it is of another flight: neither its times nor its motion are those of the recording"
        return 0.0, "its clock is taken for that of the telemetry, which is too slow to tell"
    if abs(shift) < _SAME_CLOCK_S:
        return 0.0, f"its clock and the telemetry's agree within {max(abs(shift), _GRID_S):.2f} s"
    return shift, f"its stamps are moved by {shift:.2f} s to the telemetry's clock"


def _comparable(
    link: Mapping[str, Stream], onboard: Mapping[str, Stream]
) -> tuple[tuple[Array, Array], tuple[Array, Array]] | None:
    """The same quantity from both: the size of the turn rate, else the mean motor value."""
    for key in ("imu", "motors"):
        one, other = link.get(key), onboard.get(key)
        if one is not None and other is not None and (key == "imu" or one.columns == other.columns):
            return _magnitude(one, key), _magnitude(other, key)
    return None


def _magnitude(stream: Stream, key: str) -> tuple[Array, Array]:
    values = np.linalg.norm(stream.values[:, :3], axis=1) if key == "imu" else stream.values.mean(axis=1)
    good = np.isfinite(values) & np.isfinite(stream.t_s)
    order = np.argsort(stream.t_s[good], kind="stable")
    return stream.t_s[good][order], values[good][order]


def _best_shift(t_one: Array, x_one: Array, t_other: Array, x_other: Array) -> tuple[float, float]:
    """Shift of the other's stamps at which the two go together best, and their correlation there."""
    if len(t_one) < 10 or len(t_other) < 10:
        return 0.0, 0.0
    one, other = _on_grid(t_one, x_one), _on_grid(t_other, x_other)
    size = len(one) + len(other)
    product = np.fft.irfft(np.fft.rfft(one - one.mean(), size) * np.conj(np.fft.rfft(other - other.mean(), size)), size)
    lag = int(np.argmax(product))
    lag = lag - size if lag >= len(one) else lag
    a, b = one[max(lag, 0) :], other[max(-lag, 0) :]
    common = min(len(a), len(b))
    if common < 50 or np.std(a[:common]) == 0.0 or np.std(b[:common]) == 0.0:
        return 0.0, 0.0
    agreement = float(np.corrcoef(a[:common], b[:common])[0, 1])
    return float(t_one[0] - t_other[0] + lag * _GRID_S), agreement


def _on_grid(t_s: Array, values: Array) -> Array:
    """Means over 20 ms, so that noise and rate of the two matter less; steps without samples by interpolation."""
    width = max(1, round(_GRID_S / max(float(np.median(np.diff(t_s))), 1e-6)))
    smooth = np.convolve(values, np.ones(width) / width, mode="same")
    return np.interp(np.arange(t_s[0], t_s[-1], _GRID_S), t_s, smooth)
