"""Motor lag: rotor speed follows its command through a lag, up and down differently, faster the faster.

The base fit frees it.
"""

from __future__ import annotations

from groundstation.diagnosis.effect import FittedEffect, ParameterInfo

EFFECT = FittedEffect(
    identifier="motor_lag",
    equation="dOmega/dt = (1 + s (Omega_c / Omega_h - 1)) (Omega_c - Omega) / tau, tau_up while Omega rises, tau_down "
    "while it falls",
    source="Furrer, Burri, Achtelik, Siegwart 2016, RotorS (up and down); s: linearised torque balance of motor and "
    "propeller",
    parameters=(
        ParameterInfo("rotor_lag_up_s", plausible=(0.0, 0.5)),
        ParameterInfo("rotor_lag_down_s", plausible=(0.0, 0.5)),
        ParameterInfo("rotor_lag_slope", plausible=(-1.0, 1.0), companion=True),
    ),
    least=5e-3,
    sentence=(
        "Rotors follow their commands with a lag that is not declared: {rotor_lag_up_s:ms} speeding up, "
        "{rotor_lag_down_s:ms} slowing down."
    ),
    confused_with=("clock_offset", "input_delay"),
    manoeuvre="fly faster reversals (5 Hz and more) or attitude steps: a lag rounds them, a dead time shifts them",
)
