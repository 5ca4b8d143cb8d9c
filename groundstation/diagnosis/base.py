"""The base fit: mass, tensor, lag and dead time without any effect, the point that the evidence is linear about."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from groundstation.diagnosis.case import Case
from groundstation.diagnosis.linearisation import linearisation
from groundstation.diagnosis.thresholds import THRESHOLDS
from groundstation.identification.dynamic_fit import options_for
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.work import Work
from groundstation.model.parameters import FitOptions


@dataclass(frozen=True, slots=True)
class Base:
    """A fit, and which parameters were free in it."""

    fitted: Fitted
    options: FitOptions


def base_fit(case: Case, work: Work) -> Base:
    """Of the flights that estimates see.

    What divides a lag from a dead time lies above the evidence's rate: it keeps its own there.
    """
    flights = [*case.suspects, *case.healthy]
    free = options_for(flights[0])
    fitted = work.fitted(flights if free.lag else [for_evidence(flight) for flight in flights])
    return Base(linearisation(fitted), fitted.options)


def for_evidence(prepared: Prepared) -> Prepared:
    """Effects are slow: thin the fit to ``evidence_rate_hz``."""
    rate = 1.0 / float(np.median(np.diff(prepared.record.t_s)))
    block = max(prepared.record.block, round(rate / THRESHOLDS.evidence_rate_hz))
    return replace(prepared, record=replace(prepared.record, block=block))
