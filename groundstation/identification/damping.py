"""Linear damping of the rates and of climb, free in every fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.frames import quat_rotate_inverse
from groundstation.identification.parts import by_parts
from groundstation.identification.preparation import Prepared
from groundstation.identification.record import PlannedMotion
from groundstation.identification.record_model import BodyWrench

Array = NDArray[np.float64]


def damping_terms(prepared: Prepared) -> tuple[list[BodyWrench], PlannedMotion | None]:
    """Linear damping of the three rates and of climb, free in every fit, and the plan with their planned values.

    Every vehicle has some; left out, it passes for rotor lag and lengthens the moments of inertia. Its regressor stands
    at a right angle to the acceleration's, so freeing it costs mass and inertia next to nothing.
    """
    record = prepared.record
    vehicle = record.vehicle
    climb = by_parts(
        lambda part: quat_rotate_inverse(prepared.quaternion[part], prepared.velocity_m_s[part])[:, 2].copy(),
        len(record.t_s),
    )
    sources = [(3, record.rate_rad_s[:, 0]), (4, record.rate_rad_s[:, 1]), (5, record.rate_rad_s[:, 2]), (2, climb)]
    plan = prepared.planned
    terms: list[BodyWrench] = []
    planned: list[Array] = []
    moments = np.diag(vehicle.inertia_tensor())
    scales = (*(5.0 * moments), vehicle.mass_kg)
    names = ("damping_x_nms", "damping_y_nms", "damping_z_nms", "damping_climb_kg_s")
    for index, ((column, values), name, scale) in enumerate(zip(sources, names, scales, strict=True)):
        if not np.isfinite(values).all():
            continue
        terms.append(BodyWrench(name, values, prior_std=float(scale), against=column))
        if plan is not None:
            planned.append(plan.rate_rad_s[:, index] if index < 3 else plan.velocity_body_m_s[:, 2])
    return terms, None if plan is None else replace(plan, extra=tuple(planned))
