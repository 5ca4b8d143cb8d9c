"""A recorded flight: independent streams, each on its own device clock, as the devices gave them."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from groundstation.tabular import Record, Tabular
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

IMU_COLUMNS = ("gyro_x_rad_s", "gyro_y_rad_s", "gyro_z_rad_s", "accel_x_m_s2", "accel_y_m_s2", "accel_z_m_s2")
MOCAP_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")
BATTERY_COLUMNS = ("voltage_v", "current_a")
SETPOINT_COLUMNS = ("x_m", "y_m", "z_m", "yaw_rad")
STATE_COLUMNS = (
    *("x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"),
    *("qw", "qx", "qy", "qz", "wx_rad_s", "wy_rad_s", "wz_rad_s"),
)
WRENCH_COLUMNS = ("force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")


def motor_columns(kind: str, count: int) -> tuple[str, ...]:
    """Column names of the motors stream for ``rotors.input`` and a rotor count."""
    if kind == "wrench":
        return WRENCH_COLUMNS
    unit = "rad_s" if kind == "rotor_speed" else "command"
    return tuple(f"m{i}_{unit}" for i in range(1, count + 1))


@dataclass(frozen=True, slots=True)
class Stream(Tabular):
    """Samples of one device.

    Attributes:
        t_s: device time, seconds, shape (k,).
        values: samples, shape (k, len(columns)).
        columns: one name per column, unit last.
        received_s: arrival on the host's monotonic clock, seconds, shape (k,), where it is known.
    """

    t_s: Annotated[Array, "k"]
    values: Annotated[Array, "k n"]
    columns: tuple[str, ...]
    received_s: Annotated[Array, "k"] | None = None

    def __len__(self) -> int:
        return len(self.t_s)

    def select(self, mask: NDArray[np.bool_] | slice) -> Stream:
        """The samples where ``mask`` holds."""
        received = None if self.received_s is None else self.received_s[mask]
        return Stream(self.t_s[mask], self.values[mask], self.columns, received)

    def column(self, name: str) -> Annotated[Array, "k"]:
        """One column by name, shape (k,)."""
        return self.values[:, self.columns.index(name)]

    def records(self) -> list[Record]:
        """One row per sample: time and each column."""
        return [
            dict(zip(("t_s", *self.columns), row, strict=True))
            for row in np.column_stack([self.t_s, self.values]).tolist()
        ]

    def __str__(self) -> str:
        """A summary: a stream has too many rows to show."""
        return f"{len(self)} samples at {self.rate_hz():.0f} Hz: {', '.join(self.columns)}"

    def _repr_html_(self) -> str:
        """The summary."""
        return f"<p>{html.escape(str(self))}</p>"

    def rate_hz(self) -> float:
        """Median sample rate; 0 for fewer than two samples."""
        with np.errstate(divide="ignore"):  # stamps that are all alike are dealt with by whoever repairs
            return float(1.0 / np.median(np.diff(self.t_s))) if len(self.t_s) > 1 else 0.0


def resampled(
    at_s: Annotated[ArrayLike, "q"], stamps_s: Annotated[Array, "k"], values: Annotated[Array, "k n"]
) -> Annotated[Array, "q n"]:
    """Columns of samples (n, d) at other times, linear between neighbours, held at the ends, shape (k, d)."""
    at = np.asarray(at_s, dtype=float)
    columns: list[Array] = [np.interp(at, stamps_s, column) for column in values.T]
    return np.stack(columns, axis=-1)


@dataclass(frozen=True, slots=True)
class OnlineClock:
    """Motion-capture stamp minus IMU stamp of one instant, as the link knew it in flight by stamps, echoes and
    TIMESYNC.

    Attributes:
        t_s: on the IMU's clock, (k,).
        offset_s, error_s: and its bound, (k,).
        steps: how often the capture system's clock stepped.
    """

    t_s: Array
    offset_s: Array
    error_s: Array
    steps: int = 0

    def at(self, t_s: float) -> tuple[float, float]:
        """Offset and bound at a time of the IMU's clock."""
        return float(np.interp(t_s, self.t_s, self.offset_s)), float(np.interp(t_s, self.t_s, self.error_s))


@dataclass(frozen=True, slots=True)
class FlightData(Tabular):
    """One flight. Streams that were not recorded are None; ``extras`` carries columns and files nobody here reads.

    Attributes:
        name: what the flight is called in reports and JSON.
        vehicle: what was declared before the flight.
        plan: the plan that was flown, where it is known.
        window_s: start and end of the excitation on the motors' clock, where it is known.
        truth: the simulated drone's true vehicle (simulation only; for reports, never for estimation).
        metadata: scenario name, versions, vehicle kind and the like.
        notes: repairs and losses on the way in, one sentence each.
        online: the clocks as the link knew them; None where it told nothing.
    """

    name: str
    vehicle: Vehicle
    motors: Stream
    imu: Stream | None = None
    mocap: Stream | None = None
    battery: Stream | None = None
    setpoint: Stream | None = None
    state: Stream | None = None
    extras: Mapping[str, Stream] = field(default_factory=dict[str, Stream])
    plan: Plan | None = None
    window_s: tuple[float, float] | None = None
    truth: Vehicle | None = None
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])
    notes: tuple[str, ...] = ()
    online: OnlineClock | None = None

    def records(self) -> list[Record]:
        """One row per stream: samples, rate and time on its own clock."""
        return [
            {
                "stream": name,
                "samples": float(len(stream)),
                "rate_hz": stream.rate_hz(),
                "from_s": float(stream.t_s[0]) if len(stream) else None,
                "to_s": float(stream.t_s[-1]) if len(stream) else None,
                "columns": ", ".join(stream.columns),
            }
            for name, stream in self.streams().items()
        ]

    def _title(self) -> str:
        return f"{self.name}: {self.vehicle.name}"

    def streams(self) -> dict[str, Stream]:
        """The recorded streams by file name in a bundle ("imu", "motors", ...), extras excluded."""
        named = {key: getattr(self, key) for key in ("imu", "motors", "mocap", "battery", "setpoint", "state")}
        return {key: stream for key, stream in named.items() if stream is not None}

    def between(self, start_s: float, end_s: float) -> FlightData:
        """The part of every stream with start <= t < end on its own clock."""
        cut = {
            key: stream.select((stream.t_s >= start_s) & (stream.t_s < end_s)) for key, stream in self.streams().items()
        }
        extras = {k: s.select((s.t_s >= start_s) & (s.t_s < end_s)) for k, s in self.extras.items()}
        return replace(self, **cut, extras=extras)
