"""An identification that says where a load hangs below the vehicle: its mass holds the load, and nothing in a fit of a
rigid body says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.swing import Swing, swing_of
from groundstation.flightdata import FlightData
from groundstation.identification import pipeline
from groundstation.identification.dynamic_fit import Progress
from groundstation.identification.preparation import Prepared
from groundstation.identification.results import Estimate, Identification
from groundstation.identification.work import Work
from groundstation.model.parameters import Parameters
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions

Array = NDArray[np.float64]


def identify(
    flights: Sequence[FlightData],
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    predictive: bool = False,
    progress: Progress = lambda fraction, text: None,
    work: Work | None = None,
) -> Identification:
    """:func:`.identification.pipeline.identify`, with a warning of a load that swings below the first flight's vehicle,
    and a mass whose interval holds the vehicle without it.
    """
    work = Work() if work is None else work
    found = pipeline.identify(flights, options, predictive=predictive, progress=progress, work=work)
    prepared = work.prepared(flights, options.exclude)
    swing = hanging(prepared[0], work.fitted(prepared).best.parameters)
    if swing is None:
        return found
    own = found.methods[found.best]
    parameters, covariance = holding(own.parameters, own.covariance, swing)
    own = replace(own, parameters=parameters, covariance=covariance)
    return replace(found, methods={**found.methods, found.best: own}, warnings=(swing.sentence(), *found.warnings))


def hanging(flight: Prepared, p: Parameters) -> Swing | None:
    """What swings below the vehicle in the liveliest part of a flight, with the lags of ``p``."""
    flight = flight.liveliest()
    signals = flight.signals(p.lag_up_s, p.lag_down_s, p.delay_s, p.lag_slope)
    return swing_of(signals, flight.record.keep, flight.record.vehicle)


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
