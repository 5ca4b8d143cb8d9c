"""IMU misalignment: the IMU's axes are turned in the body.

IMU and marker body turned against each other is all that their data say; which of the two is turned in the body, the direction
of thrust decides (``kinematic.py``).
"""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import ParameterInfo, Reading, SensorEffect

EFFECT = SensorEffect(
    identifier="imu_misalignment",
    equation="v_body = exp(e) v_imu: R_capture = R_imu exp(-e), and thrust stands along e_z - e x e_z in the IMU",
    source="Klein & Morelli 2006, Aircraft System Identification, ch. 10 (data compatibility)",
    parameters=tuple(ParameterInfo(f"rotation_{a}_rad", plausible=(-np.pi, np.pi)) for a in "xyz"),
    readings=(
        Reading(
            names=tuple(f"mocap_rotation_{a}_rad" for a in "xyz"),
            parameters=tuple(f"rotation_{a}_rad" for a in "xyz"),
            least=np.deg2rad(0.3),
            sentence="IMU and body are turned against each other by {size:.2f} degrees.",
            size=lambda departure: float(np.degrees(np.linalg.norm(departure))),
            sign=-1.0,
        ),
    ),
    confused_with=("mocap_misalignment",),
    manoeuvre="tilt by 15 degrees and more in roll and pitch",
)
