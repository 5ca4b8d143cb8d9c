"""A simulated flight as the analysis sees a recording: for benchmarks and tests, which fly without a bus."""

from __future__ import annotations

from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    STATE_COLUMNS,
    FlightData,
    Stream,
    motor_columns,
)
from sim.flight import SimulatedFlight


def flight_data(simulated: SimulatedFlight, name: str = "simulated") -> FlightData:
    """The recording of a simulated flight."""
    rotors = simulated.vehicle.rotors
    columns = {
        "imu": IMU_COLUMNS,
        "mocap": MOCAP_COLUMNS,
        "motors": motor_columns(rotors.input, rotors.count),
        "battery": BATTERY_COLUMNS,
        "setpoint": SETPOINT_COLUMNS,
        "state": STATE_COLUMNS,
    }
    streams = {
        key: Stream(stamps, values, columns[key], arrival)
        for key, (stamps, arrival, values) in simulated.streams.items()
    }
    return FlightData(
        name=name,
        vehicle=simulated.vehicle,
        plan=simulated.plan,
        window_s=simulated.window_s,
        truth=simulated.truth,
        metadata={"scenario": simulated.scenario},
        **streams,
    )
