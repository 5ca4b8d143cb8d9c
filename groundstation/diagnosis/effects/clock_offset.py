"""Clock offset: motion capture stamps an instant at another time than the IMU does, and may drift away from it."""

from __future__ import annotations

from groundstation.diagnosis.effect import ParameterInfo, Reading, SensorEffect

EFFECT = SensorEffect(
    identifier="clock_offset",
    equation="t_capture = t_imu + d + e (t_imu - t_middle): attitude(t_capture) is what the gyro integrates to at "
    "t_imu",
    source="Furgale, Rehder, Siegwart 2013, IROS (time offset between sensors); Klein & Morelli 2006, ch. 10",
    parameters=(
        ParameterInfo("mocap_minus_imu_s", plausible=(-1.0, 1.0)),
        ParameterInfo("clock_drift", plausible=(-1e-3, 1e-3)),
    ),
    readings=(
        Reading(
            names=("mocap_minus_imu_s",),
            parameters=("mocap_minus_imu_s",),
            least=2e-3,
            sentence="Motion-capture timestamps are {mocap_minus_imu_s:ms|later|earlier} than the IMU's; corrected.",
            applies=lambda prepared: prepared.clock is not None,
            beside=("clock_drift",),
        ),
    ),
    confused_with=("motor_lag", "input_delay"),
    manoeuvre="turn the vehicle by hand, rotors off, in view of the cameras",
)
