"""An identification that says what its numbers may hold: a load below the vehicle, or a rotor that gives too little.

Both bend the mass, and nothing in a fit of a rigid body says so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.diagnosis.hanging import hanging, holding
from groundstation.diagnosis.worn import weakest_rotor, widened
from groundstation.flightdata import FlightData
from groundstation.identification import pipeline
from groundstation.identification.dynamic_fit import DynamicFit, Progress
from groundstation.identification.results import Estimate, Identification
from groundstation.identification.work import Work
from groundstation.options import DEFAULT_OPTIONS, AnalysisOptions

Array = NDArray[np.float64]
Wider = tuple[str, dict[str, Estimate], Array | None]


def identify(
    flights: Sequence[FlightData],
    options: AnalysisOptions = DEFAULT_OPTIONS,
    *,
    predictive: bool = False,
    progress: Progress = lambda fraction, text: None,
    work: Work | None = None,
) -> Identification:
    """:func:`.identification.pipeline.identify`, with a warning and wider intervals where a load swings below the first
    flight's vehicle or one of its rotors gives less than declared.
    """
    work = Work() if work is None else work
    found = pipeline.identify(flights, options, predictive=predictive, progress=progress, work=work)
    fitted = work.fitted(work.prepared(flights, options.exclude))
    own = found.methods[found.best]
    wider = _doubt(fitted, own.parameters, own.covariance)
    if wider is None:
        return found
    sentence, parameters, covariance = wider
    own = replace(own, parameters=parameters, covariance=covariance)
    return replace(found, methods={**found.methods, found.best: own}, warnings=(sentence, *found.warnings))


def _doubt(fitted: DynamicFit, parameters: Mapping[str, Estimate], covariance: Array | None) -> Wider | None:
    """What is said, and the estimates with intervals that hold it; None where there is nothing to say.

    A load that swings turns a vehicle as it likes, and a rotor is looked for where there is none.
    """
    swing = hanging(fitted.prepared[0], fitted.best.parameters)
    if swing is not None:
        return swing.sentence(), *holding(parameters, covariance, swing)
    weak = weakest_rotor(fitted)
    if weak is not None:
        return weak.sentence(), *widened(parameters, covariance, weak.share, fitted.prepared[0].record.vehicle)
    return None
