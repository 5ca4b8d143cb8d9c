"""What a motion revealed: parameters that get no number, with what would show them, and why a flight shows only a
part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.identification.prediction_error import Fitted
from groundstation.identification.preparation import Prepared
from groundstation.identification.record_model import RecordModel
from groundstation.identification.results import MASS_AND_TENSOR, Revealed
from groundstation.linear_filters import both_ways, low_pass
from groundstation.model.parameters import FitOptions, Parameters, declared_parameters
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

APART = 2.0
"""Factor between two estimates of a moment from which neither is told."""
UNREVEALED = 0.25
"""A mass or moment known to no better than this fraction gets no number."""
UNREVEALED_PRODUCT = 0.05
"""The same for a product of inertia, as a fraction of the trace."""

STILL_RAD_S = 0.03
"""An axis that turns by less (RMS) only answers the disturbance: noise in the rotor speeds then passes for inertia."""

QUIET = 0.2
"""Share of the angular acceleration of the liveliest flight below which a flight without a plan only answers its
disturbance.
"""

NOTHING = 1e-5
"""Share of weight (times arm) below which what a change of all of a parameter makes is numerical."""
SPACING_S = 0.1
"""Over which torques are averaged: what is quicker is rotor noise and not motion."""
TYPICAL_LAG_S = 0.05

REMEDY = {
    "mass_kg": "an accelerometer or poses while the rotors carry the vehicle",
    "ixx_kg_m2": "roll: accelerate sideways (y) and back, repeatedly",
    "iyy_kg_m2": "pitch: accelerate forward (x) and back, repeatedly",
    "izz_kg_m2": "yaw: turn left and right, repeatedly",
    "ixy_kg_m2": "roll and pitch at different frequencies at once",
    "ixz_kg_m2": "roll and yaw at different frequencies at once",
    "iyz_kg_m2": "pitch and yaw at different frequencies at once",
}


def angular_acceleration(prepared: Prepared) -> Array:
    """RMS of the angular acceleration below 5 Hz, rad/s^2, (3,)."""
    record = prepared.record
    rate_hz = 1.0 / float(np.median(np.diff(record.t_s)))
    sections = low_pass(2, min(5.0, 0.4 * rate_hz), rate_hz)
    slow = both_ways(sections, record.rate_rad_s)
    return np.std(np.gradient(slow, record.t_s, axis=0)[record.keep], axis=0)


def quiet_axes(prepared: Sequence[Prepared]) -> NDArray[np.bool_]:
    """Axes about which a flight turns so much less than the liveliest one that it leaves them to that, (flights, 3)."""
    strength = np.array([angular_acceleration(item) for item in prepared])
    return strength < QUIET * strength.max(axis=0)


def revealed(models: Sequence[RecordModel], vehicle: Vehicle, options: FitOptions) -> list[Revealed]:
    """Which combinations of mass and tensor the motion acts on, from singular values in scaled units, before any fit.

    The sensitivities of torque and vertical force at the declared vehicle, as shares of weight (times arm), to each
    parameter in units of its declared value (products: of the trace), less what lags, delays, offsets and biases could
    do in their place (Golub and Van Loan, Matrix Computations, 2.4; for rigid bodies Gautier and Khalil 1990). The
    largest first.
    """
    start = declared_parameters(vehicle, lag_s=TYPICAL_LAG_S, extra=len(models[0].extra))
    trace = float(np.trace(start.tensor))
    names = models[0].names(replace(options, mass=True))
    parts = [part for model in models for part in _scaled_rows(model, start, replace(options, mass=True))]
    stacked = np.concatenate(parts) / np.sqrt(len(models))
    own = [names.index(name) for name in MASS_AND_TENSOR]
    entries = [
        getattr(vehicle.inertia_kg_m2, name[1:3]) if name[1] == name[2] else trace for name in MASS_AND_TENSOR[1:]
    ]
    columns = stacked[:, own] * np.array([vehicle.mass_kg, *entries])
    others = np.delete(stacked, own, axis=1)
    size = np.linalg.norm(others, axis=0)
    if np.any(size > 0.0):
        basis, values, _ = np.linalg.svd(others[:, size > 0.0] / size[size > 0.0], full_matrices=False)
        basis = basis[:, values > 1e-9 * values[0]]
        columns = columns - basis @ (basis.T @ columns)
    _, values, directions = np.linalg.svd(columns, full_matrices=False)
    return [
        Revealed(float(share), {name: float(v) for name, v in zip(MASS_AND_TENSOR, direction, strict=True)})
        for share, direction in zip(values, directions, strict=True)
    ]


def _scaled_rows(model: RecordModel, p: Parameters, options: FitOptions) -> list[Array]:
    """Sensitivities of torque and vertical force as shares of weight (times arm), each over the root of how many rows
    there are, (n, P); of a long flight triangular factors of them, which have the same products.
    """
    vehicle, step, parts = model.record.vehicle, float(np.median(model.dt)), model.parts()
    weight, spacing = vehicle.mass_kg * vehicle.gravity_m_s2, max(1, round(SPACING_S / step))
    torques, forces = list[Array](), list[Array]()
    counts = np.zeros(2, dtype=int)
    for blocks in parts:
        before = min(spacing, blocks.start)
        sensitivity = model.sensitivities(p, options, slice(blocks.start - before, blocks.stop))
        whole = np.cumsum(model.restart[blocks.start - before : blocks.stop])
        torque = (sensitivity[spacing:, :3] - sensitivity[:-spacing, :3]) / (spacing * step)
        torque = np.einsum("ij,kjp->kip", p.tensor, torque)[whole[spacing:] == whole[:-spacing]]
        torques.append(torque.reshape(-1, torque.shape[2]) / (weight * vehicle.arm_m()))
        if 5 in options.channels:
            forces.append(sensitivity[before:, 5] * vehicle.mass_kg / weight)
        counts += len(torques[-1]), len(forces[-1]) if forces else 0
        if len(parts) > 1:
            torques, forces = _triangular(torques), _triangular(forces)
    return [part / np.sqrt(count) for kind, count in zip((torques, forces), counts, strict=True) for part in kind]


def _triangular(rows: Sequence[Array]) -> list[Array]:
    """One triangular factor of rows, (P, P); none of none."""
    return [np.asarray(np.linalg.qr(np.concatenate(rows), mode="r"), dtype=float)] if rows else []


def never_moved(combinations: Sequence[Revealed]) -> dict[str, str]:
    """Parameters most of which lies in combinations that the motion does not act on at all, with what would."""
    hidden = dict.fromkeys(MASS_AND_TENSOR, 0.0)
    for each in combinations:
        if each.share < NOTHING:
            for name, part in each.combination.items():
                hidden[name] += part**2
    return {name: REMEDY[name] for name, lost in hidden.items() if lost > 0.5}


def unrevealed(fit: Fitted, prepared: Sequence[Prepared]) -> dict[str, str]:
    """Parameters that the motion did not show, by their standard deviation or for want of motion, with what would."""
    trace = float(np.trace(fit.parameters.tensor))
    rates = [np.std(item.record.rate_rad_s[item.record.keep], axis=0) for item in prepared]
    still = {axis for axis, rate in zip("xyz", np.max(rates, axis=0), strict=True) if rate < STILL_RAD_S}
    hidden: dict[str, str] = {}
    for name in MASS_AND_TENSOR:
        if name != "mass_kg" and set(name[1:3]) <= still:
            hidden[name] = REMEDY[name]
            continue
        relative = fit.std(name) / (trace if name[1] != name[2] and name != "mass_kg" else abs(fit.value(name)))
        limit = UNREVEALED_PRODUCT if name[1] != name[2] and name != "mass_kg" else UNREVEALED
        if relative > limit:
            hidden[name] = REMEDY[name]
    return hidden


def unsettled(one: Fitted, other: Fitted) -> dict[str, str]:
    """Moments of inertia that two estimates of the same flight give a factor APART of each other: neither is known to a
    quarter.
    """
    ratios = {name: abs(one.value(name) / other.value(name)) for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")}
    return {name: REMEDY[name] for name, ratio in ratios.items() if not 1.0 / APART < ratio < APART}


def unphysical(fit: Fitted, prepared: Sequence[Prepared]) -> dict[str, str]:
    """The moment of the least excited axis, where without a plan it comes out larger than the other two together.

    No rigid body has such a tensor: feedback from the disturbance passes for inertia where an axis is not excited.
    """
    moments = np.diag(fit.parameters.tensor)
    axis = int(np.argmax(moments))
    strength = np.max([angular_acceleration(item) for item in prepared], axis=0)
    if moments[axis] <= moments.sum() - moments[axis] or axis != int(np.argmin(strength)):
        return {}
    return {name: REMEDY[name] for name in MASS_AND_TENSOR if name != "mass_kg" and "xyz"[axis] in name[1:3]}


def partial_answer(fit: Fitted, hidden: Mapping[str, str], prepared: Sequence[Prepared]) -> str | None:
    """Why a flight shows at most one moment of inertia, for a warning beside what it does show; None where it shows
    more.

    Raises:
        NotIdentifiable: it is a hover, or shows neither mass nor any moment.
    """
    moments = [name for name in ("ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2") if name not in hidden]
    if len(moments) >= 2:
        return None
    first = prepared[0]
    record = first.record
    signals = first.signals(fit.parameters.lag_up_s, fit.parameters.lag_down_s, 0.0)
    thrust: Array = signals.thrust_n[record.keep].sum(axis=1)
    heaves = record.vehicle.rotors.input != "wrench" and np.std(thrust) > 0.1 * np.mean(thrust)
    turned = record.rate_rad_s if first.planned is None else first.planned.rate_rad_s
    line = _one_axis(turned[record.keep])
    rate = float(np.std(record.rate_rad_s[record.keep], axis=0).max())
    asked = first.flight.plan is not None or first.flight.setpoint is not None
    hover = not heaves and (rate < STILL_RAD_S or (asked and first.planned is None and line is None))
    if hover:
        reason = (
            f"this flight is a hover: the largest body rate is {rate:.3f} rad/s RMS, and inertia shows only when the "
            "body turns."
        )
    elif line is not None and moments:
        reason = f"this flight turns about one axis only ({line}), so it shows at most one moment of inertia."
    else:
        reason = "the motion is too weak against the disturbance of this flight: no two moments of inertia stand out."
    remedy = "Fly an excitation in x, y, z and yaw, larger or faster (`groundstation plan`)."
    if hover or not (moments or heaves or "mass_kg" not in hidden):
        if "mass_kg" not in hidden:
            reason += (
                f" Its mass, by the declared thrust, is {fit.value('mass_kg'):.4g} +- {fit.std('mass_kg'):.2g} kg."
            )
        listed = tuple(name for name in MASS_AND_TENSOR if name in hidden)
        raise NotIdentifiable(reason, remedy, listed)
    return f"{reason} What it does show is given. {remedy}"


def _one_axis(rate: Array) -> str | None:
    """The axis in words when a vehicle turns about one axis only (its second principal rate is under 0.3 of the
    first).
    """
    values, vectors = np.linalg.eigh(np.cov(rate.T))
    if values[1] > 0.3**2 * values[2]:
        return None
    axis = np.abs(vectors[:, 2])
    nearest = int(np.argmax(axis))
    return ("roll", "pitch", "yaw")[nearest] if axis[nearest] > 0.95 else "a line aslant to the body's axes"
