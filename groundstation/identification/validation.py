"""The seed's two validations: output prediction error (43), and the closed loop simulated against the flight (Tables
4-6).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundstation.errors import NotIdentifiable
from groundstation.flightdata import FlightData, Stream
from groundstation.frames import euler_from_quat, slerp
from groundstation.identification.estimators import run_of
from groundstation.identification.parts import parts_of
from groundstation.identification.results import MASS_AND_TENSOR, OUTPUTS, MethodResult, Validation
from groundstation.identification.seed import Regression, Regressions
from groundstation.identification.seed_signals import Processing, interpolate, process_flight
from groundstation.identification.streams import clean, excitation_window, origin_poses
from groundstation.identification.wrench import declared_wrench, held_mean
from groundstation.model.closed_loop import STEP_S, Body, ClosedLoop, Conditions, Start, Wrench, simulate_closed_loop
from groundstation.trajectory import Plan
from groundstation.vehicle import Vehicle

Array = NDArray[np.float64]
ParameterSets = Mapping[str, Mapping[str, float]]

LOOP_MOST_S = 600.0
"""Of the excitation that the closed loop is simulated along: hundreds of manoeuvres."""
SETTLE_S = 3.0
"""The simulated loop holds the start for this long before the excitation, as the flight did."""
BEYOND_S = 0.1
"""Flown beyond the last instant that is compared: slopes are taken by what follows."""
CLOSED_LOOP_SIGNALS = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad", *OUTPUTS)


def parameter_sets(vehicle: Vehicle, methods: Mapping[str, MethodResult]) -> dict[str, dict[str, float]]:
    """The nominal set and one per method; what a method does not give is nominal."""
    tensor = vehicle.inertia_tensor()[np.triu_indices(3)]
    nominal = dict(zip(MASS_AND_TENSOR, map(float, (vehicle.mass_kg, *tensor)), strict=True))
    sets = {"nominal": nominal}
    for name, method in methods.items():
        found = {key: estimate.value for key, estimate in method.parameters.items() if key in nominal}
        sets[name] = nominal | found
    return sets


def improvement_percent(validation: Validation, reference: str = "nominal") -> dict[str, dict[str, float]]:
    """P_imp of every set and signal: 100 (RMS of the reference - RMS)/RMS of the reference; positive is better."""
    base = validation.rms[reference]
    return {
        name: {
            signal: 100.0 * (base[signal] - rms) / base[signal] for signal, rms in errors.items() if base[signal] > 0.0
        }
        for name, errors in validation.rms.items()
        if name != reference
    }


def validate(
    flight: FlightData,
    methods: Mapping[str, MethodResult],
    *,
    mocap_minus_imu_s: float = 0.0,
    exclude: Sequence[tuple[float, float]] = (),
    regressions: Regressions | None = None,
) -> tuple[Validation, ...]:
    """All checks of section IV that a flight allows: output error on both models, and the closed loop.

    The closed loop needs poses, the plan with its start, and a vehicle file that declares its controller; what is
    missing leaves that check out.

    Args:
        flight: recorded.
        methods: results by name; the nominal set is added.
        mocap_minus_imu_s: motion-capture stamp minus IMU stamp of one instant.
        exclude: segments that are not compared.
        regressions: of the flight, where they are known; None: worked out here.
    """
    sets = parameter_sets(flight.vehicle, methods)
    checks: list[Validation] = []
    try:
        if regressions is None:
            processing = Processing(mocap_minus_imu_s=mocap_minus_imu_s, exclude=exclude)
            regressions = Regressions.of(process_flight(flight, processing))
        checks.append(output_validation(regressions.standard, sets, "Standard regression model (34)."))
        checks.append(output_validation(regressions.filtered, sets, "Filtered regression model (38)."))
        if flight.plan is not None and "control" in flight.vehicle.model_fields_set:
            checks.append(
                closed_loop_validation(_begun(flight), sets, mocap_minus_imu_s=mocap_minus_imu_s, exclude=exclude)
            )
    except NotIdentifiable:
        return tuple(checks)
    return tuple(checks)


def _begun(flight: FlightData) -> FlightData:
    """With no more than LOOP_MOST_S of its excitation."""
    if flight.window_s is None:
        return flight
    start, end = flight.window_s
    return replace(flight, window_s=(start, min(end, start + LOOP_MOST_S)))


def output_validation(regression: Regression, sets: ParameterSets, note: str = "") -> Validation:
    """RMS of Gamma Theta - Upsilon (eq. 43) for each parameter set, over the samples in use."""
    used = np.flatnonzero(regression.used)
    squares = {name: np.zeros(len(OUTPUTS)) for name in sets}
    for part in parts_of(len(used)):
        run = run_of(used[part])
        gamma, upsilon = regression.rows[run], regression.output[run]
        for name, values in sets.items():
            error = gamma @ np.array([values[key] for key in MASS_AND_TENSOR]) - upsilon
            squares[name] += np.sum(error**2, axis=0)
    rms: dict[str, dict[str, float]] = {
        name: dict(zip(OUTPUTS, map(float, np.sqrt(total / len(used))), strict=True)) for name, total in squares.items()
    }
    return Validation("output", rms, len(used), note)


def closed_loop_validation(
    flight: FlightData,
    sets: ParameterSets,
    *,
    mocap_minus_imu_s: float = 0.0,
    exclude: Sequence[tuple[float, float]] = (),
    conditions: Conditions | None = None,
    wrenches: Mapping[str, Wrench] | None = None,
) -> Validation:
    """Simulate the closed loop with each parameter set and compare it with the flight (Table 4).

    The loop is the declared controller on the plan, started where the flight was three seconds before the excitation.
    It stands for the flight only as far as the vehicle flew by that controller.

    Args:
        flight: with poses, a known excitation window, and the plan that was flown in it.
        sets: parameter sets, names of ``MASS_AND_TENSOR``.
        mocap_minus_imu_s: motion-capture stamp minus IMU stamp of one instant.
        exclude: segments that are not compared.
        conditions: sampling and limits; None: section IV-A's, at the flight's own rate of poses.
        wrenches: of the effects that a set of this name is augmented by.

    Raises:
        NotIdentifiable: no poses, no plan, or the flight does not say when the excitation began.
    """
    plan = flight.plan
    if flight.mocap is None or flight.window_s is None or plan is None:
        unplanned = "the plan that was flown" if flight.window_s is not None else "a known start of the excitation"
        missing = "poses" if flight.mocap is None else unplanned
        raise NotIdentifiable(f"A closed-loop comparison needs {missing}.", "Record it, or validate by output error.")
    conditions = conditions or Conditions(pose_hz=flight.mocap.rate_hz())
    flown = _Flown.of(flight, flight.mocap, flight.window_s, mocap_minus_imu_s, exclude)
    rms: dict[str, dict[str, float]] = {}
    errors: dict[tuple[float, ...], Array] = {}
    for name, values in sets.items():
        if np.linalg.eigvalsh(_tensor(values))[0] <= 0.0 or values["mass_kg"] <= 0.0:
            continue
        wrench = (wrenches or {}).get(name)
        key = *(values[each] for each in MASS_AND_TENSOR), id(wrench)
        if key not in errors:
            errors[key] = flown.error(flown.simulated(plan, values, conditions, wrench))
        error = errors[key]
        if np.isfinite(error).all():
            rms[name] = dict(zip(CLOSED_LOOP_SIGNALS, map(float, np.sqrt(np.mean(error**2, axis=0))), strict=True))
    left_out = [name for name in sets if name not in rms]
    return Validation("closed_loop", rms, int(np.count_nonzero(flown.used)), _loop_note(left_out))


def _loop_note(left_out: Sequence[str]) -> str:
    """How the loop was simulated, and for which sets it was not."""
    note = "The declared controller on the plan, section IV-A's sampling and limits."
    if not left_out:
        return note
    return f"{note} Left out, because no body has such a tensor or the loop diverges with it: {', '.join(left_out)}."


@dataclass(frozen=True, slots=True)
class _Flown:
    """The flight on the simulation's grid.

    Attributes:
        vehicle: as declared.
        begin_s: first instant on the plan's time.
        t_s: instants, from before the excitation, shape (k,).
        pose: position of the origin (m) and roll, pitch, yaw (rad), shape (k, 6).
        wrench: declared, N and N m, shape (k, 4).
        used: whether an instant is compared, shape (k,).
    """

    vehicle: Vehicle
    begin_s: float
    t_s: Array
    pose: Array
    wrench: Array
    used: NDArray[np.bool_]

    @classmethod
    def of(
        cls,
        flight: FlightData,
        mocap: Stream,
        window_s: tuple[float, float],
        mocap_minus_imu_s: float,
        exclude: Sequence[tuple[float, float]],
    ) -> _Flown:
        """From what was recorded."""
        poses, motors = clean(mocap), clean(flight.motors)
        stamps = poses.t_s - mocap_minus_imu_s
        start = max(window_s[0] - SETTLE_S, stamps[0], motors.t_s[0])
        end = min(window_s[1], stamps[-1], motors.t_s[-1])
        t = np.asarray(start + STEP_S * np.arange(int((end - start) / STEP_S)), dtype=float)
        window = excitation_window(flight)
        used = (t >= window[0]) & (t <= window[1])
        for first, last in exclude:
            used &= (t < first) | (t > last)
        flown = slice(_last(used) + round(BEYOND_S / STEP_S))
        t, used = t[flown], used[flown]
        wrench = declared_wrench(flight.vehicle, motors, flight.battery, t)
        pose = _pose(flight.vehicle, t, stamps, poses.values)
        return cls(flight.vehicle, t[0] - window_s[0], t, pose, wrench, used)

    def simulated(
        self, plan: Plan, values: Mapping[str, float], conditions: Conditions, wrench: Wrench | None
    ) -> ClosedLoop:
        """The declared controller on the plan with other parameters, from where the flight was."""
        return simulate_closed_loop(
            self.vehicle,
            plan.series(),
            Body(values["mass_kg"], _tensor(values)),
            Start(self.begin_s, float(self.t_s[-1] - self.t_s[0]), _start_state(self.t_s, self.pose)),
            conditions=conditions,
            wrench=wrench,
        )

    def error(self, simulated: ClosedLoop) -> Array:
        """Flown less simulated, the instants in use, in the order of ``CLOSED_LOOP_SIGNALS``."""
        k = min(len(self.t_s), len(simulated.t_s))
        # Both wrenches hold until their next value, so both are averaged over the same cells.
        applied = held_mean(simulated.t_s, simulated.t_s, simulated.wrench)
        error = np.column_stack([simulated.position_m, simulated.euler_rad, applied])[:k]
        error = np.column_stack([self.pose, self.wrench])[:k] - error
        error[:, 5] = np.angle(np.exp(1j * error[:, 5]))
        return error[self.used[:k]]


def _last(used: NDArray[np.bool_]) -> int:
    """Index behind the last instant in use; the end where none is."""
    inside = np.flatnonzero(used)
    return int(inside[-1]) + 1 if len(inside) else len(used)


def _tensor(values: Mapping[str, float]) -> Array:
    """The symmetric tensor of a parameter set, shape (3, 3)."""
    tensor = np.zeros((3, 3))
    tensor[np.triu_indices(3)] = [values[key] for key in MASS_AND_TENSOR[1:]]
    return tensor + tensor.T - np.diag(np.diag(tensor))


def _pose(vehicle: Vehicle, t_s: Array, stamps_s: Array, poses: Array) -> Array:
    """Position of the origin and roll, pitch, yaw at the grid times, shape (k, 6)."""
    tracked = interpolate(t_s, stamps_s, poses[:, :3]), slerp(t_s, stamps_s, poses[:, 3:7])
    position, q = origin_poses(vehicle.mocap, *tracked)
    return np.column_stack([position, euler_from_quat(q)])


def _start_state(t_s: Array, flown: Array) -> Array:
    """State at the start, at rest: mean pose over the first 0.1 s, for the vehicle hovers there."""
    early = flown[t_s <= t_s[0] + 0.1].mean(axis=0)
    state = np.zeros(12)
    state[:3], state[6:9] = early[:3], early[3:]
    return state
