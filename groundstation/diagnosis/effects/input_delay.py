"""Input delay: a dead time between command and thrust. The base fit frees it."""

from __future__ import annotations

from groundstation.diagnosis.effect import FittedEffect, ParameterInfo

EFFECT = FittedEffect(
    identifier="input_delay",
    equation="Omega_c(t) = command(t - T): phase -omega T, gain 1",
    source="Ljung 1999, System Identification, 2nd ed., ch. 4 (dead time of the input)",
    parameters=(ParameterInfo("input_delay_s", plausible=(0.0, 0.5)),),
    least=5e-3,
    sentence="Commands reach the rotors {input_delay_s:ms|late|early}.",
    confused_with=("motor_lag", "clock_offset"),
    manoeuvre="fly faster reversals (5 Hz and more) or attitude steps: a lag rounds them, a dead time shifts them",
)
