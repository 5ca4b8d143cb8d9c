r"""Mass and tensor while the vehicle still flies: least squares on the equations of motion in weak form, block by
block.

With J the tensor, c the centre of mass in the rotor plane, q a yaw trim, and [F, tau] the wrench that the declared
rotors make of the motor values, the rigid body says

    J w' + w x J w = tau - c x F e_z - q e_z,        m (f_z - b) = F.

Multiplied by a function phi that is zero at both ends of a short window, and integrated by parts, w' is gone:

    -int phi' J w + int phi (w x J w) = int phi (tau - c x F e_z - q e_z).

Modulating functions: Shinbrot (1957), "On the analysis of linear and nonlinear systems", Trans. ASME 79; Preisig and
Rippin (1993), Computers & Chemical Engineering 17. Here phi is a hat over two blocks of h = 80 ms, so that -int phi' w
/ h is the difference of two consecutive means of the measured rates over h: noise and vibration above 1/h average out,
and no signal is differentiated. Hats follow each other at h, which is a new row, hence a new estimate, 12.5 times a
second.

All that rows say of the parameters is kept as the triangular square root of their information, [R z], with R^T R = sum
G^T G and R theta = z; each row is rotated in (Bierman 1977, Factorization Methods for Discrete Sequential Estimation,
ch. IV), which keeps the digits that the normal equations would square away.
Rows overlap and disturbances are coloured, so the covariance is that of :mod:`uncertainty`, from the spectrum of the
residuals where the regressor listens; it is renewed every fifth row, because it costs most. After T seconds a spectral
average over 0.5 Hz holds K = 0.5 Hz T ordinates, one of which the fit has taken out: the covariance is multiplied by
K/(K - 1), and the interval is Student's with 2 (K - 1) degrees of freedom.

What it does not do: it estimates no lag (the declared one is applied), and it takes the regressor for exact. A vehicle
under feedback answers a disturbance d, so part of d is correlated with w'; ``best`` of the analysis after landing is
immune to that, this first look is not. The bias b of the accelerometer is read off the vehicle while it stands: |f| -
g.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from groundstation.flightdata import FlightData
from groundstation.identification.anchoring import anchored
from groundstation.identification.regressors import inertia_columns, rate_products
from groundstation.identification.results import Estimate
from groundstation.identification.uncertainty import SMOOTHING_HZ, coloured_covariance
from groundstation.model.parameters import TENSOR
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]

SHOWN = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
BLOCK_S = 0.08
MEMORY = 2048
"""Rows kept: 164 s. When they are full the oldest quarter goes."""
COVARIANCE_EVERY = 5
FEWEST = 40
"""Rows before the first estimate: 3.2 s, longer than disturbances remember."""
LARGEST_STD = 0.25
"""As a share; above it a parameter is not shown."""
BIAS_STD_M_S2 = 0.002
"""How far the accelerometer's bias wanders from what was read on the ground, within minutes."""
UNKNOWN_BIAS_STD_M_S2 = 0.05
"""Of a bias that was not read on the ground: 5 mg, a consumer sensor after calibration."""
BUFFERED = 10_000
"""Samples of one stream that wait for the other."""
REST_SAMPLES = 100
STILL_RAD_S = 0.05
FASTEST_RATE_RAD_S = 50.0


@dataclass(frozen=True, slots=True)
class RecursiveEstimate:
    """What is known so far.

    ``parameters`` holds those of SHOWN that the motion has revealed by ``t_s`` (the IMU's clock).
    """

    t_s: float
    parameters: Mapping[str, Estimate]


@dataclass(slots=True)
class _Signal:
    """Samples that were not used up yet, and how they join: straight lines, or held until the next."""

    held: bool
    t_s: Array = field(default_factory=lambda: np.zeros(0))
    values: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def add(self, t_s: Array, values: Array) -> None:
        """Append what is finite and later than what was."""
        good = np.isfinite(t_s) & np.isfinite(values).all(axis=1)
        t_s, values = t_s[good], values[good]
        if len(self.t_s):
            later = t_s > self.t_s[-1]
            t_s, values = np.concatenate([self.t_s, t_s[later]]), np.concatenate([self.values, values[later]])
        later = np.diff(t_s, prepend=-np.inf) > 0.0
        self.t_s, self.values = t_s[later][-BUFFERED:], values[later][-BUFFERED:]

    def forget(self, before_s: float) -> None:
        """Drop what lies before, but for the last sample there."""
        first = max(0, int(np.searchsorted(self.t_s, before_s, side="right")) - 1)
        self.t_s, self.values = self.t_s[first:], self.values[first:]

    def means(self, start_s: float, length_s: float) -> tuple[Array, Array] | None:
        """Mean over [start, start + length], and with a weight that rises from 0 to 1; None where samples are
        missing.
        """
        end_s = start_s + length_s
        first, last = np.searchsorted(self.t_s, [start_s, end_s])
        around = self.t_s[max(first - 1, 0) : last + 1]
        if len(around) < 4 or around[0] > start_s or around[-1] < end_s or np.diff(around).max() > 0.5 * length_s:
            return None
        values = self.values[max(first - 1, 0) : last + 1]
        if self.held:
            around, values = np.repeat(around, 2)[1:], np.repeat(values, 2, axis=0)[:-1]
        inner = (around > start_s) & (around < end_s)
        t_s = np.concatenate([[start_s], around[inner], [end_s]])
        columns: list[Array] = [np.interp([start_s, end_s], around, column) for column in values.T]
        ends = np.stack(columns, axis=1)
        x = np.concatenate([ends[:1], values[inner], ends[1:]])
        rising = (t_s - start_s) / length_s
        width = np.diff(t_s, prepend=start_s)
        width[:-1] += width[1:]  # of the trapezoids on both sides
        weight = 0.5 * width / length_s
        return weight @ x, (weight * rising) @ x


class RecursiveEstimator:
    """Fed with samples as they come; every 80 ms of the excitation it has a new estimate.

    Args:
        vehicle: as declared: rotor constants, lag, lever arms, anchor.
    """

    def __init__(self, vehicle: Vehicle):
        rotors = vehicle.rotors
        self._vehicle = vehicle
        measured = rotors.measured
        lag = () if measured or rotors.input == "wrench" else (rotors.lag.up_s, rotors.lag.down_s)
        self._lag = lag if any(lag) else ()
        self._lagged: tuple[float, Array, Array] | None = None
        self._full_v = vehicle.battery.full_v or 0.0
        self._voltage_v = 0.0
        self._imu = _Signal(held=False)
        self._wrench = _Signal(held=not measured and not self._lag)
        self._rest = (0, np.zeros(3))
        self._start_s: float | None = None
        self._last: tuple[Array, Array] | None = None
        self._rows = self._appended = self._renew_at = 0
        self._gamma = np.zeros((MEMORY, 4, 10))
        self._upsilon = np.zeros((MEMORY, 4))
        self._root: Array = np.zeros((11, 11))
        self._covariance = np.zeros((10, 10))

    def rest(self, imu: Array) -> None:
        """Take samples of the ground in, rows as in :meth:`add`; those at which it stood still tell the accelerometer's
        bias.
        """
        still = imu[(np.abs(imu[:, 1:4]) < STILL_RAD_S).all(axis=1) & np.isfinite(imu).all(axis=1), 4:7]
        count, total = self._rest
        self._rest = (count + len(still), total + still.sum(axis=0))

    def battery(self, voltage_v: float) -> None:
        """The newest voltage; it scales what a command does."""
        self._voltage_v = voltage_v
        if self._vehicle.battery.full_v is None:
            self._full_v = max(self._full_v, voltage_v)

    def add(self, imu: Array, motors: Array) -> RecursiveEstimate | None:
        """Take samples of the excitation in; returns the newest estimate when there is a new one.

        Args:
            imu: [t, gyro x y z, accel x y z] per row; s, rad/s, m/s^2; the device's clock.
            motors: [t, values] per row, as ``rotors.input`` says; the same clock.
        """
        if len(imu):
            self._add_imu(imu)
        if len(motors):
            self._add_motors(motors)
        if not len(self._imu.t_s) or not len(self._wrench.t_s):
            return None
        newest = min(self._imu.t_s[-1], self._wrench.t_s[-1])
        first = max(self._imu.t_s[0], self._wrench.t_s[0])
        if self._start_s is None or newest - self._start_s > MEMORY * BLOCK_S:
            self._start_s, self._last = max(float(first), float(newest) - MEMORY * BLOCK_S), None
        before = self._appended
        while newest >= self._start_s + BLOCK_S:
            self._take_block(self._start_s)
            self._start_s += BLOCK_S
        self._imu.forget(self._start_s)
        self._wrench.forget(self._start_s)
        return self._estimate() if self._appended > before and self._rows >= FEWEST else None

    def _add_imu(self, imu: Array) -> None:
        rate = imu[:, 1:4]
        rate = np.where(np.abs(rate) < FASTEST_RATE_RAD_S, rate, np.nan)
        self._imu.add(imu[:, 0], np.concatenate([rate, rate_products(rate), imu[:, 4:7]], axis=1))

    def _add_motors(self, motors: Array) -> None:
        vehicle, stamps, values = self._vehicle, motors[:, 0], motors[:, 1:]
        if vehicle.rotors.input == "wrench":
            self._wrench.add(stamps, values)
            return
        top = vehicle.rotors.speed_max_rad_s if vehicle.rotors.input == "rotor_speed" else 1.0
        values = np.where((values >= 0.0) & (values <= 1.5 * (top or np.inf)), values, np.nan)
        if vehicle.rotors.input == "command" and self._voltage_v > 0.0:
            values = values * self._voltage_v / self._full_v
        if self._lag:
            good = np.isfinite(values).all(axis=1)
            stamps, values = stamps[good], self._behind_lag(stamps[good], values[good])
        self._wrench.add(stamps, vehicle.thrust(values) @ vehicle.allocation().T)

    def _behind_lag(self, stamps: Array, values: Array) -> Array:
        """Held commands after x' = (u - x)/tau, exact at the stamps; tau by the sign of u - x."""
        out = np.empty_like(values)
        for index, (t_s, value) in enumerate(zip(stamps, values, strict=True)):
            before_s, x, u = self._lagged if self._lagged else (t_s, value, value)
            up, down = (-float(np.expm1(-max(t_s - before_s, 0.0) / max(tau, 1e-6))) for tau in self._lag)
            moved = x + np.where(u > x, up, down) * (u - x)
            out[index] = moved
            self._lagged = (t_s, moved, value)
        return out

    def _take_block(self, start_s: float) -> None:
        """Means of the block; with the block before it, a row.

        Missing samples make a row of zeros, which says nothing.
        """
        imu, wrench = self._imu.means(start_s, BLOCK_S), self._wrench.means(start_s, BLOCK_S)
        before, self._last = self._last, None
        if imu is None or wrench is None:
            if self._rows:
                self._append(np.zeros((4, 10)), np.zeros(4))
            return
        now = np.concatenate([imu[0], wrench[0]]), np.concatenate([imu[1], wrench[1]])
        self._last = now
        if before is not None:
            # A hat rises over the block before and falls over this one; means are over one block, so it has the area 1.
            hat = before[1] + now[0] - now[1]
            self._append(*self._row((now[0] - before[0])[:3] / BLOCK_S, hat))

    def _row(self, alpha: Array, hat: Array) -> tuple[Array, Array]:
        """Rows [torque; force] of [J, c_x, c_y, q, m] from the angular acceleration and the hat means of everything
        else.
        """
        products, force, wrench = hat[3:9], hat[9:12], hat[12:16]
        gamma = np.zeros((4, 10))
        gamma[:3, :6] = inertia_columns(alpha[None], products[None])[0]
        gamma[1, 6], gamma[0, 7], gamma[2, 8] = -wrench[0], wrench[0], 1.0
        x, y, z = self._vehicle.imu.position_m
        pp, _, pr, qq, qr, _ = products
        lever = alpha[0] * y - alpha[1] * x + pr * x + qr * y - (pp + qq) * z
        gamma[3, 9] = force[2] - self._bias()[0] - lever
        return gamma, np.array([*wrench[1:], wrench[0]])

    def _bias(self) -> tuple[float, float]:
        """Bias of the accelerometer along z and its standard deviation, m/s^2."""
        count, total = self._rest
        if count < REST_SAMPLES:
            return 0.0, UNKNOWN_BIAS_STD_M_S2
        return float(np.linalg.norm(total / count)) - self._vehicle.gravity_m_s2, BIAS_STD_M_S2

    def _append(self, gamma: Array, upsilon: Array) -> None:
        if self._rows == MEMORY:
            self._rows -= MEMORY // 4
            self._gamma[: self._rows] = self._gamma[-self._rows :].copy()
            self._upsilon[: self._rows] = self._upsilon[-self._rows :].copy()
            kept = self._gamma[: self._rows].reshape(-1, 10)
            self._root = _triangle(np.column_stack([kept, self._upsilon[: self._rows].reshape(-1)]))
        self._gamma[self._rows], self._upsilon[self._rows] = gamma, upsilon
        self._rows += 1
        self._appended += 1
        self._root = _triangle(np.concatenate([self._root, np.column_stack([gamma, upsilon])]))

    def _estimate(self) -> RecursiveEstimate | None:
        """From the square root of the information: [R z; 0 e] with R'R = Gamma' Gamma and R theta = z (Bierman 1977,
        ch. IV).
        """
        root: Array = self._root[:10, :10]
        z: Array = self._root[:10, 10]
        size: Array = np.linalg.norm(root, axis=0)
        if not (size > 0.0).all():
            return None
        scaled = root / size
        if np.linalg.svd(scaled, compute_uv=False)[-1] ** 2 < 1e-9:
            return None
        theta = solve_triangular(scaled, z) / size
        if self._appended >= self._renew_at:
            self._renew_at = self._appended + COVARIANCE_EVERY
            inverse = solve_triangular(scaled, np.eye(10))
            self._covariance = self._spread(inverse @ inverse.T / np.outer(size, size), theta)
        values, covariance = theta[[9, *range(6)]], self._covariance[np.ix_([9, *range(6)], [9, *range(6)])]
        parameters, _ = anchored(self._vehicle, ("mass_kg", *TENSOR), values, covariance)
        shown = {
            name: parameters[name] for name in SHOWN if parameters[name].std < LARGEST_STD * parameters[name].value
        }
        return RecursiveEstimate(float(self._start_s or 0.0), shown)

    def _spread(self, inverse: Array, theta: Array) -> Array:
        """Covariance that allows for coloured residuals, and for what is not known of the accelerometer's bias."""
        gamma, upsilon = self._gamma[: self._rows], self._upsilon[: self._rows]
        covariance = np.zeros((10, 10))
        for rows, columns in (((0, 1, 2), range(9)), ((3,), (9,))):
            part = np.ix_(columns, columns)
            influence = gamma[:, rows][:, :, columns] @ inverse[part]
            residual = upsilon[:, rows] - np.einsum("krp,p->kr", gamma[:, rows][:, :, columns], theta[list(columns)])
            covariance[part] = coloured_covariance(influence.transpose(0, 2, 1), residual, BLOCK_S)
        covariance *= _few_seconds(BLOCK_S * self._rows)
        covariance[9, 9] += (theta[9] * self._bias()[1] / self._vehicle.gravity_m_s2) ** 2
        return covariance


def replay(flight: FlightData, step_s: float = 0.4) -> list[RecursiveEstimate]:
    """The estimates of a recorded flight as they would have come while it flew, every ``step_s`` of its excitation."""
    if flight.imu is None or len(flight.imu) == 0 or len(flight.motors) == 0:
        return []
    imu = np.column_stack([flight.imu.t_s, flight.imu.values[:, :6]])
    motors = np.column_stack([flight.motors.t_s, flight.motors.values])
    start_s, end_s = flight.window_s or (max(imu[0, 0], motors[0, 0]), min(imu[-1, 0], motors[-1, 0]))
    estimator = RecursiveEstimator(flight.vehicle)
    estimator.rest(imu[imu[:, 0] < _lift_off(flight)])
    found: list[RecursiveEstimate] = []
    for t_s in np.arange(start_s, end_s, step_s):
        if flight.battery is not None and len(flight.battery):
            voltage = flight.battery.column("voltage_v")
            estimator.battery(float(voltage[max(np.searchsorted(flight.battery.t_s, t_s) - 1, 0)]))
        parts = [x[(x[:, 0] >= t_s) & (x[:, 0] < min(t_s + step_s, end_s))] for x in (imu, motors)]
        if (estimate := estimator.add(*parts)) is not None:
            found.append(estimate)
    return found


def _lift_off(flight: FlightData) -> float:
    """When the declared thrust first comes near the weight."""
    vehicle = flight.vehicle
    values = flight.motors.values
    thrust = values[:, 0] if vehicle.rotors.input == "wrench" else vehicle.thrust(values).sum(axis=1)
    lifting = np.flatnonzero(thrust > 0.5 * vehicle.mass_kg * vehicle.gravity_m_s2)
    return float(flight.motors.t_s[lifting[0]]) if len(lifting) else -np.inf


def _few_seconds(length_s: float) -> float:
    """What a covariance must be multiplied by because the residual's spectrum was read from so short a record."""
    from scipy.special import stdtrit

    ordinates = max(2.0 * SMOOTHING_HZ * length_s, 1.5)
    quantile = float(stdtrit(2.0 * (ordinates - 1.0), 0.975))
    return ordinates / (ordinates - 1.0) * (quantile / 1.959964) ** 2


def _triangle(rows: Array) -> Array:
    """R of rows = Q R: what they say of the unknowns, in as many rows as there are columns."""
    return np.asarray(np.linalg.qr(rows, mode="r"))
