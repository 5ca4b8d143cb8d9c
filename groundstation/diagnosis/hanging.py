"""A load that hangs below the vehicle: the mass of a rigid body's fit holds it, and nothing in that fit says so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.swing import Swing, swing_of
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate
from groundstation.model.parameters import Parameters

Array = NDArray[np.float64]


def hanging(flight: Prepared, p: Parameters, known: Sequence[tuple[Candidate, Array]] = ()) -> Swing | None:
    """What swings below the vehicle in the liveliest part of a flight, with the lags and the mass of ``p``.

    Args:
        known: effects that were found, with the values of their parameters: their force is none of a load.
    """
    flight = flight.liveliest()
    signals = flight.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    vehicle = flight.record.vehicle.model_copy(update={"mass_kg": p.mass_kg})
    force = np.zeros((len(signals.t_s), 3))
    for candidate, values in known:
        force += candidate.effect.wrench(signals, vehicle, candidate.settings)[:, :3] @ values
    return swing_of(signals, flight.record.keep, flight.record.vehicle, force)


def holding(
    parameters: Mapping[str, Estimate], covariance: Array | None, swing: Swing
) -> tuple[dict[str, Estimate], Array | None]:
    """Estimates and their covariance, mass first, with a mass whose interval holds the vehicle without its load; one
    that is not told, or was weighed, stays.
    """
    mass = parameters.get("mass_kg")
    if mass is None or mass.std <= 0.0:
        return dict(parameters), covariance
    away = mass.value - swing.body_kg
    wider = Estimate.normal(mass.value, float(np.hypot(mass.std, away)))
    if covariance is not None:
        covariance = covariance + np.diag([away**2, *[0.0] * (len(covariance) - 1)])
    return {**parameters, "mass_kg": wider}, covariance
