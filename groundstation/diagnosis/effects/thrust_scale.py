"""Thrust scale: all rotors' thrust constant is off, which only a weighed mass tells.

Mass, tilt inertias and thrust scale together. Under the anchor "mass" the base fit gives the thrust constants, and
their ratio to the declared ones is the effect.
"""

from __future__ import annotations

from groundstation.diagnosis.effect import FittedEffect, ParameterInfo
from groundstation.diagnosis.thresholds import THRESHOLDS

EFFECT = FittedEffect(
    identifier="thrust_scale",
    equation="T_i = a k Omega_i^2, m f = sum T_i e_z: only a / m shows in flight, so that a takes a weighed m",
    source="Newton's second law",
    parameters=(ParameterInfo("thrust_scale", plausible=(0.2, 5.0)),),
    least=THRESHOLDS.material_share,  # a force of as much of the weight: what is material of every force
    sentence="By its weighed mass, the rotors of the vehicle give {thrust_scale:% change|more|less} thrust than "
    "declared.",
    confused_with=("payload_change",),
    manoeuvre='weigh the vehicle, declare its mass as the anchor ("mass"), and hover',
)
