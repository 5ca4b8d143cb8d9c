"""Torque scale: all rotors' ratio of torque to thrust is off. No flight shows it, and it never makes a finding.

Yaw torque and yaw inertia scale together in everything that flies: the ratio of the two is the yaw acceleration.
Weighing fixes the thrust constant and not this; a reaction torque measured on a stand does, or a yaw inertia measured
on a torsion pendulum.
"""

from __future__ import annotations

from groundstation.diagnosis.effect import EffectInfo, ParameterInfo

EFFECT = EffectInfo(
    identifier="torque_scale",
    equation="I_zz domega_z/dt = a c sum s_i T_i + ...: only a / I_zz shows in flight",
    source="Euler's equation about z; Leishman 2006, sec. 2.2 (torque and thrust coefficients)",
    parameters=(ParameterInfo("torque_scale", plausible=(0.2, 5.0)),),
    confused_with=("rotor_gyroscopic",),
    manoeuvre="none: measure a rotor's reaction torque on a stand, or the yaw inertia on a torsion pendulum",
)
