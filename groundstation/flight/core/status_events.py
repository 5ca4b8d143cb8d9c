"""What a new phase of the vehicle means to the sequence."""

from __future__ import annotations

from drivers import bus
from groundstation.flight import sequence as seq


def event_of(status: bus.DroneStatus, phase: seq.Phase) -> seq.Event | None:
    """The event of a vehicle that came into another phase; None where the sequence has none for it.

    Args:
        status: the vehicle's.
        phase: of the flight.
    """
    if status.phase == "takeoff":
        return seq.VehicleAirborne()
    if status.phase == "exciting":
        return seq.VehicleExciting()
    if status.phase == "landing":
        return seq.VehicleLanding(_early(status, phase))
    if status.phase == "landed":
        return seq.VehicleLanded(_early(status, phase))
    if status.phase == "crashed":
        text = f"the vehicle crashed: {status.text}" if status.text else "the vehicle crashed"
        return seq.VehicleLost(text, down=True)
    return None


def _early(status: bus.DroneStatus, phase: seq.Phase) -> str:
    """Why the vehicle comes down before the excitation's end although nobody here asked for it; else empty."""
    if phase is seq.Phase.LANDING:
        return ""
    if status.window_s is not None and status.device_s >= status.window_s[1] - 0.1:
        return ""
    return status.text or "the vehicle came down by itself before the excitation was over"
