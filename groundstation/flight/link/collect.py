"""IMU and poses together for a while, from a vehicle that stands or is carried: no flight, no recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.mavlink.transports import open_transport
from drivers.samples import Imu, Pose, Sample
from groundstation.errors import Refused
from groundstation.flight import timeouts
from groundstation.flight.link.arguments import bandwidth_of, signing_of
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.pose_source import PoseSource
from groundstation.flight.station import Station
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Collected:
    """Both on the host's clock.

    Attributes:
        imu: stamps (k,), gyro (k, 3), accelerometer (k, 3).
        poses: stamps (m,), positions (m, 3), quaternions (m, 4), as the system gives them.
        clock_error_s: of the vehicle's clock against the host's.
    """

    imu: tuple[Array, Array, Array]
    poses: tuple[Array, Array, Array]
    clock_error_s: float


def collect(
    url: str,
    vehicle: Vehicle,
    station: Station,
    seconds: float,
    progress: Callable[[float, str], None] = lambda _f, _t: None,
    *,
    key_file: Path | None = None,
) -> Collected:
    """Listen for a while once both are heard.

    Raises:
        Refused: no vehicle, no IMU, no poses, or no answer to TIMESYNC.
        ConnectionError: the link cannot be opened.
    """
    plain = station.model_copy(
        update={"mocap": station.mocap.model_copy(update={"calibration": None, "to_vehicle_hz": 0.0})}
    )
    memory = signing_of(key_file, None)
    options = Options(station.system, bytes_per_s=bandwidth_of(url), keep_raw=False)
    core = LinkCore(vehicle, plain, options, None if memory is None else memory.signing)
    transport = open_transport(url)
    core.datagrams = transport.datagrams
    poses = PoseSource(plain.mocap, vehicle)
    rows: list[tuple[Sample, float]] = []
    patience_s, begun_s = time.monotonic() + timeouts.VEHICLE_READY_S, None
    try:
        while begun_s is None or time.monotonic() - begun_s < seconds:
            transport.wait(timeouts.IDLE_WAIT_S)
            out = core.step(time.monotonic(), transport.read())
            for data in out.send:
                transport.write(data)
            if core.peer is not None:
                transport.answer(core.peer)
            rows += [(s, t) for s, t in out.samples if isinstance(s, Imu)]
            rows += [(s, t) for s, t in poses.read() if isinstance(s, Pose)]
            if begun_s is None:
                begun_s = time.monotonic() if _both(rows) and core.clock.fit() is not None else None
                if begun_s is None and time.monotonic() > patience_s:
                    raise Refused(*_missing(rows, core, plain))
                rows = rows if begun_s is None else []
            else:
                progress((time.monotonic() - begun_s) / seconds, "carry it and turn it about all axes")
    finally:
        poses.close()
        transport.close()
    return _collected(rows, core, time.monotonic())


def _both(rows: list[tuple[Sample, float]]) -> bool:
    return any(isinstance(s, Imu) for s, _ in rows) and any(isinstance(s, Pose) for s, _ in rows)


def _missing(rows: list[tuple[Sample, float]], core: LinkCore, station: Station) -> tuple[str, str]:
    if core.view is None:
        return f"no vehicle is heard: {core.trouble}.", "Check the link."
    if not any(isinstance(s, Imu) for s, _ in rows):
        return "the vehicle sends no IMU.", "Let it stream HIGHRES_IMU or RAW_IMU on this link."
    if not any(isinstance(s, Pose) for s, _ in rows):
        mocap = station.mocap
        return f"no poses come from {mocap.system} at {mocap.host}.", "See `groundstation doctor --mocap`."
    return "the vehicle does not answer TIMESYNC, so its IMU cannot be dated.", "Use a link that carries it both ways."


def _collected(rows: list[tuple[Sample, float]], core: LinkCore, now_s: float) -> Collected:
    fit = core.clock.fit()
    assert fit is not None  # noqa: S101 - waited for
    imu = np.array([(fit.host(s.device_s), *s.gyro_rad_s, *s.accel_m_s2) for s, _ in rows if isinstance(s, Imu)])
    poses = np.array([(s.device_s, *s.position_m, *s.quaternion) for s, _ in rows if isinstance(s, Pose)])
    imu, poses = _increasing(imu), _increasing(poses)
    return Collected(
        (imu[:, 0], imu[:, 1:4], imu[:, 4:7]),
        (poses[:, 0], poses[:, 1:4], poses[:, 4:8]),
        core.clock.error_s(now_s),
    )


def _increasing(table: Array) -> Array:
    """In order of stamps, each once."""
    return table[np.unique(table[:, 0], return_index=True)[1]]
