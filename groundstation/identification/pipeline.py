"""``identify``: from recorded flights to parameters with intervals, by every method, and which of them to believe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored
from groundstation.identification.answer import Answer, as_rigid_body, believed, bound_of, with_methods, within_limits
from groundstation.identification.declarations import said_first
from groundstation.identification.disagreement import with_doubts
from groundstation.identification.dynamic_fit import Progress
from groundstation.identification.predictive_choice import physical_model, prediction_section, with_moments
from groundstation.identification.results import Estimate, Identification
from groundstation.identification.turning import turning_disturbance
from groundstation.identification.validation import validate
from groundstation.identification.work import Work
from groundstation.json_types import Document
from groundstation.model.parameters import BASIS, RIGID_BODY
from groundstation.model.vehicle_model import VehicleModel
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
    """Identify one vehicle from one or several of its flights.

    Args:
        flights: recordings of the same vehicle; they are pooled.
        options: stretches to leave out.
        predictive: fit and choose a prediction model beside the physical one, too.
        progress: told the fraction done and what is being done.
        work: of another analysis of the same flights, or to be kept for one.

    Raises:
        BadInput: an option that only a diagnosis can use, or a stretch outside the flights.
        Refused: too short, clocks that cannot be aligned, or a motion that reveals too little; with the remedy.
    """
    progress(0.05, "bringing the streams onto one clock")
    options.require_only("identify", "exclude")
    work = Work() if work is None else work
    checks = work.checked(flights[0])
    prepared = work.prepared(flights, options.exclude)
    answer = believed(work.fitted(prepared, progress), said_first(checks))
    answer = with_methods(answer, options.exclude, progress)
    answer = within_limits(as_rigid_body(answer))
    found = _documented(answer, options, progress)
    if predictive:
        progress(0.96, "prediction model")
        found = replace(found, prediction=_predictive(answer, found))
    progress(1.0, "done")
    return replace(found, declarations=tuple(check.to_dict() for check in checks))


def _documented(answer: Answer, options: AnalysisOptions, progress: Progress) -> Identification:
    """An answer with its validation, as the document that is kept."""
    prepared, fitted = answer.fitted.prepared, answer.fitted
    first = prepared[0]
    progress(0.95, "validation")
    validation = validate(
        first.flight,
        answer.methods,
        mocap_minus_imu_s=0.0 if first.clock is None else first.clock.mocap_minus_imu_s,
        exclude=options.exclude,
        regressions=answer.regressions,
    )
    return Identification(
        flight=" + ".join(item.flight.name for item in prepared),
        vehicle=answer.vehicle.name,
        anchor=answer.vehicle.identification.anchor,
        methods=with_doubts(answer.methods, answer.name),
        model=answer.model,
        best=answer.name,
        best_reason=answer.reason,
        clock=first.clock,
        not_identifiable=answer.hidden,
        warnings=answer.warnings,
        bound=bound_of(answer),
        window_s=first.window_s,
        excluded_s=tuple((float(a), float(b)) for a, b in options.exclude),
        quality=tuple(note for item in prepared for note in (*item.flight.notes, *item.notes)),
        validation=validation,
        revealed=answer.combinations,
        disturbance=turning_disturbance(fitted.models, answer.best, fitted.options),
    )


def _predictive(answer: Answer, found: Identification) -> Document:
    """The prediction model beside the physical one, for the model file."""
    parameters = found.methods[found.best].parameters
    physical = physical_model(answer.vehicle, parameters, answer.model, found.disturbance)
    if all(name in parameters for name in RIGID_BODY):
        return prediction_section(answer.fitted.prepared, physical)
    return prediction_section(answer.fitted.prepared, physical, _unpublished(answer, physical, parameters))


def _unpublished(answer: Answer, physical: VehicleModel, published: Mapping[str, Estimate]) -> VehicleModel:
    """The physical model with the fit's own moments in the place of declared ones: what is no claim about the vehicle
    may predict it.
    """
    fitted, best = answer.fitted, answer.fitted.best
    own, _ = anchored(answer.vehicle, best.names, best.values, best.covariance)
    known = {**own, **published}
    tensor: Array = np.einsum("k,kij->ij", [known[name].value for name in RIGID_BODY[1:]], BASIS)
    return with_moments(physical, tensor, turning_disturbance(fitted.models, best, fitted.options))
