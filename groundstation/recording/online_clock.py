"""What the link knew of the clocks in flight, from the events it recorded. Pure."""

from __future__ import annotations

import numpy as np

from drivers.mocap.health import reported_clock
from groundstation.flightdata import OnlineClock
from groundstation.recording.recorded import Texts


def online_clock(events: Texts | None) -> OnlineClock | None:
    """Motion capture's stamps are on the host's clock, the IMU's on the vehicle's: the host minus vehicle that TIMESYNC
    told.

    Its bound is that of the stamps plus that of TIMESYNC. None where nothing was told.
    """
    if events is None:
        return None
    rows, steps = [], 0
    for t_s, row in zip(events.t_s.tolist(), events.rows, strict=True):
        told = reported_clock(row[1]) if row[0] == "clock" else None
        if told is not None and told.host_minus_vehicle_s is not None:
            rows.append((t_s, told.host_minus_vehicle_s, told.error_s + told.vehicle_error_s))
            steps = max(steps, told.steps)
    if not rows:
        return None
    table = np.array(sorted(rows))
    return OnlineClock(table[:, 0], table[:, 1], table[:, 2], steps)
