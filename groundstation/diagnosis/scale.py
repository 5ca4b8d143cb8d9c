"""A thrust constant other than declared, which only a weighed mass tells: mass, tensor and thrust scale together.

Under the anchor "mass" the base estimate gives the thrust constants; their ratio to the declared ones is the finding. What weighing
cannot tell is the ratio of torque to thrust: it scales with yaw inertia (``torque_scale``), and no flight shows either.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from groundstation.diagnosis.attribution import MATERIAL, posterior
from groundstation.diagnosis.results import Finding
from groundstation.diagnosis.timing import CERTAIN
from groundstation.identification.results import Estimate
from groundstation.vehicle import Vehicle


def scale_findings(vehicle: Vehicle, parameters: Mapping[str, Estimate]) -> list[Finding]:
    """``thrust_scale`` where the constants estimated by the weighed mass differ from the declared ones beyond both uncertainties.

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
    if wald < CERTAIN or abs(ratio - 1.0) < MATERIAL:
        return []
    return [
        Finding(
            effect="thrust_scale",
            parameters={"thrust_scale": Estimate.normal(ratio, std)},
            evidence=f"By its weighed mass the vehicle's rotors give {ratio:.3f} times the declared thrust.",
            confidence=posterior([CERTAIN - wald]),
            gain=wald,
        )
    ]
