"""Tilt of the capture volume: motion capture's z is not along gravity."""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import ParameterInfo, Reading, SensorEffect

EFFECT = SensorEffect(
    identifier="mocap_tilt",
    equation="a_capture = R f - g exp(-t) e_z: a steady horizontal acceleration of g (t_y, -t_x) that f does not hold",
    source="Klein & Morelli 2006, Aircraft System Identification, ch. 10 (data compatibility)",
    parameters=tuple(ParameterInfo(f"tilt_{a}_rad", plausible=(-0.5, 0.5)) for a in "xy"),
    readings=(
        Reading(
            names=("mocap_tilt_x_rad", "mocap_tilt_y_rad"),
            parameters=("tilt_x_rad", "tilt_y_rad"),
            least=np.deg2rad(0.3),
            sentence="The vertical axis of motion capture is tilted by {size:degrees} against gravity.",
        ),
    ),
    confused_with=("wind",),
    manoeuvre="hover long at two headings: a tilt stays with the room, an accelerometer's bias turns with the vehicle",
)
