"""What the guard is shown: observations of an instant, from what is known of the vehicle and of the flight. Pure."""

from __future__ import annotations

from drivers.samples import Vector3
from groundstation.flight.link.guard import Observations
from groundstation.flight.link.phase import Phase
from groundstation.flight.link.pilot import Pilot
from groundstation.flight.link.view import VehicleView
from groundstation.flight.station import Station


class Disagreement:
    """How differently poses and estimate moved since the start; the constant between their origins does not count."""

    def __init__(self) -> None:
        self._origin: tuple[Vector3, Vector3] | None = None

    def metres(self, view: VehicleView) -> float | None:
        """As of now; None before both are known."""
        state, pose = view.state, view.pose
        if state is None or pose is None:
            return None
        if self._origin is None:
            self._origin = (state.position_m, pose.position_m)
        there, here = self._origin
        moved = zip(state.position_m, there, pose.position_m, here, strict=True)
        return sum(((s - a) - (p - b)) ** 2 for s, a, p, b in moved) ** 0.5


def observe(
    now_s: float, pilot: Pilot, station: Station, disagreement: Disagreement, core_s: float | None, abort: str
) -> Observations:
    """The flight as of now.

    Args:
        now_s: host time.
        pilot: of the flight, with the view of its vehicle.
        station: which sources are there, and what a silent core means.
        disagreement: of poses and estimate since the start.
        core_s: when the core was heard last; None before it ever was.
        abort: the operator's reason; empty without.
    """
    view = pilot.view
    led = pilot.phase in (Phase.CLIMBING, Phase.FOLLOWING)
    state = view.state
    silent = station.policy.when_core_is_silent == "land" and led
    watched = station.mocap.system != "none"
    return Observations(
        position_m=None if state is None else pilot.placement.to_plan(state.position_m),
        velocity_m_s=None if state is None else state.velocity_m_s,
        quaternion=None if state is None else state.quaternion,
        target_m=pilot.target.position_m if pilot.target is not None and pilot.phase is Phase.FOLLOWING else None,
        state_age_s=now_s - view.state_s,
        link_age_s=now_s - view.heard_s,
        pose_age_s=now_s - view.pose_changed_s if watched else None,
        pose_disagreement_m=disagreement.metres(view) if watched else None,
        battery_remaining=view.battery_remaining,
        battery_v=None if view.battery is None else view.battery.voltage_v,
        estimator_jump_m=view.take_jump(),
        oscillation_rad_s=view.oscillation.rms_rad_s,
        core_age_s=now_s - core_s if silent and core_s is not None else None,
        setpoint_age_s=now_s - pilot.setpoint_sent_s if led and pilot.setpoint_sent_s is not None else None,
        clock_rate=view.clock_rate,
        abort=abort,
    )
