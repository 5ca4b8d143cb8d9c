r"""A first estimate in a fraction of a second: weighted least squares on the filtered wrench, ten parameters, with
intervals.

    m f_z = F_z,    J w' + w x J w + (c_y F_z, -c_x F_z, n) = tau

for mass, tensor, centre of mass and yaw trim (Khalil and Dombre 2002, Modeling, Identification and Control of Robots,
section 12.3), all signals through one zero-phase low-pass. Rotors answer late, and most of what a regression on
commands misses is that: so rotors are taken behind a first-order lag, which is found along with the rest, W(t) =
W_lag(t) - d tau W_lag'(t), by Gauss-Newton. Every row weighs by the scatter of its own residual. The residual is
coloured: the covariance is taken from sums over blocks of time longer than its memory (batch means: Heidelberger and
Welch 1981). The full estimate follows and replaces this one: nothing here models what the controller feeds back, and
clocks are taken as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable, Refused
from groundstation.flightdata import FlightData
from groundstation.identification.alignment import arrival_difference
from groundstation.identification.anchoring import anchored
from groundstation.identification.clock import coarse_offset
from groundstation.identification.filters import zero_phase_low_pass
from groundstation.identification.regressors import standard_regressor
from groundstation.identification.results import MASS_AND_TENSOR, Estimate
from groundstation.identification.seed_signals import Processing, SeedSignals, process_flight
from groundstation.identification.streams import clean
from groundstation.identification.wrench import declared_wrench
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

NAMES = (*MASS_AND_TENSOR, "com_offset_x_m", "com_offset_y_m", "yaw_trim_nm")
LAG_S = 0.05
"""Where the search for a lag begins: a small vehicle's."""
LAG_MOST_S = 0.3
ROUNDS = 4
BLOCK_S = 1.5
"""Of the batch means: several times the memory of a low-passed disturbance, and enough of them in 20 s to know a
spread.
"""
TELLS = 0.5
"""Share of its size by which a moment of inertia has to be known to be shown at all."""
SETTLED_S = 5e-4
"""Change of the lag below which the search ends: it moves no parameter by a tenth of a percent."""
FORM = 0.01
"""Share of itself by which a number may be wrong for what is left out here: lags of rising and falling rotors,
feedback, the pull of air.
"""
RATE_HZ = 100.0
"""Rows a second: ten times what the low-pass leaves."""


def first_estimate(flight: FlightData) -> dict[str, Estimate]:
    """Mass and tensor under the vehicle's anchor, centre of mass and yaw trim; those that the flight tells.

    Raises:
        NotIdentifiable: the streams overlap for too short, or the motion reveals nothing.
    """
    signals = process_flight(flight, Processing(mocap_minus_imu_s=_pose_offset_s(flight)))
    if signals.specific_force is None:
        raise NotIdentifiable("Nothing tells the specific force.", "Record an accelerometer or poses.")
    values, covariance = _fitted(flight, signals)
    largest = np.array([values[0], *[np.max(np.abs(values[1:7]))] * 6, 0.0, 0.0, 0.0])
    covariance = covariance + np.diag((FORM * largest) ** 2)
    rigid, _ = anchored(flight.vehicle, NAMES, values, covariance)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    offsets = {name: Estimate.normal(v, s) for name, v, s in zip(NAMES[7:], values[7:], std[7:], strict=True)}
    found = {**rigid, **offsets}
    size = max(abs(rigid[name].value) for name in MASS_AND_TENSOR[1:])
    told = {name: e for name, e in found.items() if name not in MASS_AND_TENSOR[1:] or e.std < TELLS * size}
    if not any(name in told for name in MASS_AND_TENSOR[1:]):
        raise NotIdentifiable("This motion reveals no moment of inertia.", "Fly an excitation.", MASS_AND_TENSOR)
    return told


def _answers_late(vehicle: Vehicle) -> bool:
    """Whether the recorded inputs are what was asked of the rotors."""
    rotors = vehicle.rotors
    return rotors.input == "command" or (rotors.input == "rotor_speed" and rotors.speed_source == "command")


def _pose_offset_s(flight: FlightData) -> float:
    """Motion capture's stamps minus the IMU's, to a few milliseconds; zero where nothing aligns them."""
    if flight.imu is None or flight.mocap is None or len(flight.mocap) < 50:
        return 0.0
    imu, pose = clean(flight.imu), clean(flight.mocap)
    expected = arrival_difference(pose, imu) or 0.0
    try:
        return coarse_offset(imu.t_s, imu.values[:, :3], pose.t_s, pose.values[:, 3:7], expected_s=expected)[0]
    except Refused:
        return 0.0


def _fitted(flight: FlightData, signals: SeedSignals) -> tuple[Array, Array]:
    """Values and covariance (10, 10) of NAMES."""
    late = _answers_late(flight.vehicle)
    step = max(1, round(1.0 / (RATE_HZ * signals.period_s)))
    rows = np.flatnonzero(signals.used)[::step]
    force = np.zeros((0, 3)) if signals.specific_force is None else signals.specific_force
    gamma = standard_regressor(force[:, 2], signals.rate, signals.rate_derivative)[rows]
    block = np.floor((signals.t_s[rows] - signals.t_s[rows[0]]) / BLOCK_S).astype(np.int64)
    lag, weight = flight.vehicle.rotors.lag.up_s or (LAG_S if late else 0.0), np.ones(4)
    theta, covariance = np.zeros(len(NAMES)), np.eye(len(NAMES))
    for _ in range(ROUNDS):
        wrench = _wrench(flight, signals, lag) if late else signals.wrench
        slope = np.gradient(wrench, signals.period_s, axis=0)[rows] if late else None
        theta, covariance, scatter = _solved(_columns(gamma, wrench[rows], slope), wrench[rows], weight, block)
        weight = 1.0 / np.maximum(scatter, 1e-12)
        if not late:
            continue
        lag, before = float(np.clip(lag + theta[-1], 0.0, LAG_MOST_S)), lag
        if abs(lag - before) < SETTLED_S:
            break
    return theta[: len(NAMES)], covariance[: len(NAMES), : len(NAMES)]


def _wrench(flight: FlightData, signals: SeedSignals, lag_s: float) -> Array:
    """The wrench of rotors behind a lag, through the signals' low-pass, (k, 4)."""
    lag = flight.vehicle.rotors.lag.model_copy(update={"up_s": lag_s, "down_s": lag_s})
    rotors = flight.vehicle.rotors.model_copy(update={"lag": lag})
    vehicle = flight.vehicle.model_copy(update={"rotors": rotors})
    wrench = declared_wrench(vehicle, clean(flight.motors), flight.battery, signals.t_s)
    return zero_phase_low_pass(wrench, signals.cutoff_hz, signals.period_s)


def _columns(gamma: Array, wrench: Array, slope: Array | None) -> Array:
    """Regressor of [F_z, tau] on NAMES, and on a change of the lag where ``slope`` is given, (k, 4, 10 or 11)."""
    out = np.zeros((len(gamma), 4, len(NAMES) + (slope is not None)))
    out[:, :, :7] = gamma
    out[:, 1, 8], out[:, 2, 7], out[:, 3, 9] = wrench[:, 0], -wrench[:, 0], 1.0
    if slope is not None:
        out[:, :, 10] = slope
    return out


def _solved(a: Array, y: Array, weight: Array, block: NDArray[np.int64]) -> tuple[Array, Array, Array]:
    """Weighted least squares, its covariance from sums over blocks of time, and the scatter of each of the four
    rows.
    """
    white, target = a * weight[:, None], y * weight
    scale: Array = np.sqrt(np.einsum("kij,kij->j", white, white)) + 1e-30
    flat = (white / scale).reshape(-1, a.shape[2])
    inverse = np.linalg.pinv(flat.T @ flat, rcond=1e-10, hermitian=True)
    theta = inverse @ (flat.T @ target.ravel())
    left = target - (white / scale) @ theta
    scores = np.einsum("kij,ki->kj", white / scale, left)
    count = int(block[-1]) + 1
    sums = np.stack([np.bincount(block, column, minlength=count) for column in scores.T], axis=1)
    freedom = count / max(count - 0.5 * a.shape[2], 0.3 * count)
    covariance = freedom * inverse @ (sums.T @ sums) @ inverse / np.outer(scale, scale)
    return theta / scale, covariance, np.sqrt(np.mean(left**2, axis=0)) / weight
