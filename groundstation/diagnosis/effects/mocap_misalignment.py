"""Marker-body misalignment: the frame that motion capture tracks is turned and shifted in the body beyond what is
declared.
"""

from __future__ import annotations

import numpy as np

from groundstation.diagnosis.effect import ROTATION_PARAMETERS, ParameterInfo, Reading, SensorEffect, turned_reading

EFFECT = SensorEffect(
    identifier="mocap_misalignment",
    equation="R_capture = R_body exp(declared) exp(r), p_capture = p_body + R_body (declared + o)",
    source="Klein & Morelli 2006, Aircraft System Identification, ch. 10 (data compatibility)",
    parameters=(
        *ROTATION_PARAMETERS,
        *(ParameterInfo(f"offset_{a}_m", plausible=(-1.0, 1.0)) for a in "xyz"),
    ),
    readings=(
        turned_reading("The tracked marker body is turned by {size:degrees} against its declared mounting."),
        Reading(
            names=tuple(f"mocap_position_{a}_m" for a in "xyz"),
            parameters=tuple(f"offset_{a}_m" for a in "xyz"),
            least=5e-3,
            sentence="The tracked point lies {size:mm} away from its declared place.",
            declared=lambda v: np.asarray(v.mocap.position_m) - np.asarray(v.imu.position_m),
        ),
    ),
    confused_with=("imu_misalignment", "com_offset"),
    manoeuvre="tilt by 15 degrees and more in roll and pitch",
)
