"""A thrust constant other than declared, which only a weighed mass tells (``effects/thrust_scale.py``)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.diagnosis.effects.thrust_scale import EFFECT
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.rivals import posterior
from groundstation.diagnosis.sentences import filled
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle


def scale_findings(vehicle: Vehicle, parameters: Mapping[str, Estimate]) -> list[Finding]:
    """``thrust_scale`` where the constants estimated by the weighed mass differ from the declared ones beyond both
    uncertainties.

    Args:
        parameters: of the base with the findings put in, thrust constants among them under the anchor "mass".
    """
    declared = {"thrust_coefficient_n_s2": vehicle.rotors.thrust_coefficient_n_s2} | {
        f"thrust_curve_c{i}_n": c for i, c in enumerate(vehicle.rotors.thrust_curve or ())
    }
    known = {name: value for name, value in declared.items() if value and name in parameters}
    if not known:
        return []
    name, value = max(known.items(), key=lambda item: abs(item[1]))
    ratio, std = parameters[name].value / value, parameters[name].std / abs(value)
    wald = ((ratio - 1.0) / float(np.hypot(std, vehicle.identification.thrust_coefficient_std))) ** 2
    if wald < THRESHOLDS.timing_wald or abs(ratio - 1.0) < EFFECT.least:
        return []
    return [
        Finding(
            effect=EFFECT.identifier,
            parameters={EFFECT.names()[0]: Estimate.normal(ratio, std)},
            sentence=filled(EFFECT.sentence, **{EFFECT.names()[0]: ratio}),
            confidence=posterior([THRESHOLDS.timing_wald - wald]),
            gain=wald,
        )
    ]
