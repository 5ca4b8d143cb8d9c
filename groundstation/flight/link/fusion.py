"""Whether the vehicle's estimator flies by the external poses: by its own flags and innovations, and by where it says
it is. Pure.
"""

from __future__ import annotations

from math import sqrt

from drivers.mavlink.dialect import mavlink
from groundstation.flight.link.view import VehicleView

WITHIN_M = 0.3
"""Standing, estimate and pose lie closer than this where the one is made from the other; 0.4 m in flight land the
vehicle.
"""
GATE = 0.8
"""Of its innovation gates: above it ArduPilot's own failsafe (FS_EKF_THRESH) takes the estimate for lost; PX4 rejects
at 1.
"""

_HORIZONTAL = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
_AIDED = mavlink.ESTIMATOR_PRED_POS_HORIZ_REL | mavlink.ESTIMATOR_PRED_POS_HORIZ_ABS
"""PX4 says a constant position of every vehicle at rest, and with this that something external aids it all the same."""
_VERTICAL, _CONSTANT = mavlink.ESTIMATOR_POS_VERT_ABS, mavlink.ESTIMATOR_CONST_POS_MODE


def not_fused(view: VehicleView) -> str:
    """Why the estimator does not use the poses; empty while it does.

    ESTIMATOR_STATUS (PX4) and EKF_STATUS_REPORT (ArduPilot) have the same flags, and ratios of innovations to their
    gates.
    """
    flags, ratios = view.estimator_flags, view.estimator_ratios
    if flags is None:
        return "the vehicle reports no estimator status"
    if not flags & _HORIZONTAL or (flags & _CONSTANT and not flags & _AIDED):
        return f"the estimator has no horizontal position (flags {flags:#x})"
    if not flags & _VERTICAL:
        return f"the estimator has no height (flags {flags:#x})"
    if not max(ratios) <= GATE:
        return (
            f"its innovations are at {max(ratios):.2f} of their gates, more than {GATE:g}: poses and inertial "
            "sensors disagree"
        )
    if view.pose is None or view.state is None:
        return "there is no pose or no estimate"
    distance = sqrt(sum((a - b) ** 2 for a, b in zip(view.pose.position_m, view.state.position_m, strict=True)))
    if distance >= WITHIN_M:
        return f"poses and estimate lie {distance:.2f} m apart"
    return ""
