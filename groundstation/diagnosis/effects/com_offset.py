"""Centre of mass beside the declared origin."""

from __future__ import annotations

from groundstation.diagnosis.effect import Effect, ParameterInfo, about_centre

MOST_M = 1.0
"""The rotors' circle of 10 kg: outside of it nothing flies."""


EFFECT = Effect(
    identifier="com_offset",
    equation="tau = -c x F e_z; F_origin = -m (omega' x c + omega x (omega x c))",
    source="Newton and Euler about a point other than the centre of mass: Etkin & Reid 1996, sec. 4.3",
    parameters=(
        ParameterInfo("com_offset_x_m", lambda v: v.arm_m(), (-MOST_M, MOST_M)),
        ParameterInfo("com_offset_y_m", lambda v: v.arm_m(), (-MOST_M, MOST_M)),
    ),
    wrench=lambda signals, vehicle, settings: about_centre(vehicle, signals),
    pointwise=True,
    sentence=(
        "The centre of mass lies {com_offset_x_m:mm|forward|back} and {com_offset_y_m:mm|to the left|to the right} "
        "of the declared origin."
    ),
    confused_with=("weak_rotor", "constant_wrench"),
    manoeuvre="climb and sink hard: the torque of an offset grows with total thrust; yaw both ways to exclude a weak "
    "rotor",
    shared_by_healthy=0,
)
