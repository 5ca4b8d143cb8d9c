"""IMU misalignment: the IMU's axes are turned in the body.

IMU and marker body turned against each other is all that their data say; which of the two is turned in the body, the
direction of thrust decides (``kinematic.py``).
"""

from __future__ import annotations

from groundstation.diagnosis.effect import ROTATION_PARAMETERS, SensorEffect, turned_reading

EFFECT = SensorEffect(
    identifier="imu_misalignment",
    equation="v_body = exp(e) v_imu: R_capture = R_imu exp(-e), and thrust stands along e_z - e x e_z in the IMU",
    source="Klein & Morelli 2006, Aircraft System Identification, ch. 10 (data compatibility)",
    parameters=ROTATION_PARAMETERS,
    readings=(turned_reading("The IMU is turned by {size:degrees} against its declared mounting.", sign=-1.0),),
    confused_with=("mocap_misalignment",),
    manoeuvre="tilt by 15 degrees and more in roll and pitch",
)
