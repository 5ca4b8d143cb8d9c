"""The sensitivities that the planned motion would have: instruments, which owe nothing to a flight's disturbances."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.identification.record_model import BASIS, TENSOR, Options, Parameters, RecordModel, stacked

Array = NDArray[np.float64]


def planned_sensitivities(model: RecordModel, p: Parameters, options: Options) -> Array:
    """Those of a record's plan at ``p``, shape (blocks, 6, P), columns as in :meth:`.RecordModel.evaluate`.

    A thrust y behind a lag: y' = (u - y) / tau, so dy/dtau = -y' through the same lag, of rising or falling rotors. Where its rate is
    (1 + s x) / tau, dy/ds = tau x y' through the lag, with x of the command u = y + tau y' above hover's.
    """
    plan = model.planned
    if plan is None:
        raise ValueError("no planned motion was given for this record")
    inverse = np.asarray(np.linalg.inv(p.tensor), dtype=float)
    rate = plan.rate_rad_s
    thrust = p.mass_kg * plan.specific_thrust_m_s2[:, None]
    torque = plan.angular_acceleration_rad_s2 @ p.tensor + np.cross(rate, rate @ p.tensor)
    wrench = np.concatenate([thrust, torque], axis=1)
    slope = np.gradient(wrench, model.record.t_s, axis=0)
    impulse = model.integrated(thrust)[:, 0]
    blank = np.zeros((len(impulse), 3))

    def upward(values: Array) -> Array:
        out = blank.copy()
        out[:, 2] = values
        return out

    def later(values: Array) -> tuple[Array, Array]:
        """What a wrench (k, 4) that is taken away changes."""
        mean = model.integrated(values)
        return -mean[:, 1:] @ inverse.T, upward(-model.average(values)[:, 0] / p.mass_kg)

    table: dict[str, tuple[Array, Array]] = {}
    table["mass_kg"] = blank, upward(-model.average(thrust)[:, 0] / p.mass_kg**2)
    turned = model.average(rate)
    for name, basis, column in zip(TENSOR, BASIS, np.moveaxis(model.integrated_gyroscopic(rate), -1, 0), strict=True):
        table[name] = -(turned @ basis.T + column) @ inverse.T, blank
    if options.delay:
        table["input_delay_s"] = later(slope)
    if options.lag:
        inverse_matrix = np.linalg.pinv(model.matrix).T
        each = slope @ inverse_matrix
        up = _behind_lag(model, np.maximum(each, 0.0), p.lag_up_s)
        down = _behind_lag(model, np.minimum(each, 0.0), p.lag_down_s)
        if options.symmetric_lag:
            table["rotor_lag_s"] = later((up + down) @ model.matrix.T)
        else:
            asked = wrench @ inverse_matrix + np.where(each > 0.0, p.lag_up_s, p.lag_down_s) * each
            above = model.record.vehicle.motor_for_thrust(asked) / model.record.motors.hover - 1.0
            bent = p.lag_up_s * _behind_lag(model, above * up, p.lag_up_s)
            bent += p.lag_down_s * _behind_lag(model, above * down, p.lag_down_s)
            table["rotor_lag_up_s"] = later(up @ model.matrix.T)
            table["rotor_lag_down_s"] = later(down @ model.matrix.T)
            table["rotor_lag_slope"] = later(-bent @ model.matrix.T)
    model.add_offsets(table, inverse, impulse, options)
    for term, extra in zip(model.extra, plan.extra, strict=True):
        table[term.name] = (
            model.integrated(extra)[:, 3:] @ inverse.T,
            model.average(extra[:, :3]) / p.mass_kg,
        )
    return stacked(table)


def _behind_lag(model: RecordModel, values: Array, lag_s: float) -> Array:
    """Columns at the IMU's stamps through a first-order lag, shape kept."""
    from scipy.signal import lfilter

    if lag_s < 1e-4:
        return values
    keep = np.exp(-float(np.median(np.diff(model.record.t_s))) / lag_s)
    return np.asarray(lfilter([1.0 - keep], [1.0, -keep], values, axis=0))
