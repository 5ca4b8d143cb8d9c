"""From a prepared flight to what a prediction starts from and is judged by."""

from __future__ import annotations

import numpy as np

from groundstation.errors import BadInput
from groundstation.flightdata import FlightData
from groundstation.frames import quat_continuous
from groundstation.identification.parts import double
from groundstation.identification.preparation import Prepared, prepare
from groundstation.identification.streams import clean
from groundstation.model.flight_states import FlightStates


def flight_states(flight: FlightData, *, own: bool = False) -> FlightStates:
    """Starts and references of a flight for prediction.

    Args:
        flight: recorded.
        own: take both from the vehicle's own estimate (``state.csv``) instead of the smoothed motion.

    Raises:
        BadInput: ``own`` was asked of a flight without a state stream.
    """
    prepared = prepare(flight)
    return own_states(prepared) if own else smoothed_states(prepared)


def own_states(prepared: Prepared) -> FlightStates:
    """Starts and references from the vehicle's own estimate.

    Raises:
        BadInput: there is none.
    """
    flight, record = prepared.flight, prepared.record
    if flight.state is None or len(flight.state) < 50:
        raise BadInput(f"{flight.name}: there is no state.csv to start from; leave out --state own.")
    state = clean(flight.state)
    x = state.values
    parts = (x[:, :3], x[:, 3:6], quat_continuous(x[:, 6:10]), x[:, 10:13])
    voltage = np.interp(state.t_s, record.t_s, prepared.voltage_v)
    return FlightStates(
        state.t_s, *parts, *parts, record.motors, voltage, prepared.window_s, record.vehicle, prepared.stretches
    )


def smoothed_states(prepared: Prepared) -> FlightStates:
    """Starts from the past alone, and the smoothed motion to judge by."""
    record = prepared.record
    q, causal = quat_continuous(prepared.quaternion), quat_continuous(double(prepared.causal_quaternion))
    return FlightStates(
        record.t_s,
        double(prepared.causal_position_m), double(prepared.causal_velocity_m_s), causal, record.rate_rad_s,
        prepared.position_m, prepared.velocity_m_s, q, record.rate_rad_s,
        record.motors, prepared.voltage_v, prepared.window_s, record.vehicle, prepared.stretches,
    )  # fmt: skip
