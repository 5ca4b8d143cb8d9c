"""A flight, an identification and a diagnosis with every field filled, made from the trajectory's own kinematics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from groundstation.analysis.analyse import identification_document
from groundstation.analysis.documents import write_json
from groundstation.diagnosis.results import Diagnosis, Finding, Unexplained
from groundstation.flightdata import (
    BATTERY_COLUMNS,
    IMU_COLUMNS,
    MOCAP_COLUMNS,
    SETPOINT_COLUMNS,
    FlightData,
    Stream,
    motor_columns,
)
from groundstation.frames import quat_from_euler, quat_rotate_inverse
from groundstation.identification.results import (
    MASS_AND_TENSOR,
    OUTPUTS,
    Clock,
    Estimate,
    Evolution,
    Identification,
    MethodResult,
    Validation,
)
from groundstation.paths import find_config
from groundstation.trajectory import Plan, coefficients_from_arrays, flight_path, rigid_motion
from groundstation.vehicle import Inertia, Vehicle, load_vehicle

OFFSET_S = 0.0124
DURATION_S = 36.0
TRUE_TENSOR = {"xx": 0.0268, "yy": 0.0331, "zz": 0.0412, "xy": 0.0011, "xz": -0.0006, "yz": 0.0004}


def vehicle() -> Vehicle:
    return load_vehicle(find_config("vehicles", "qball2"))


def truth(declared: Vehicle) -> Vehicle:
    """Two percent heavier, another tensor, and a lag that nobody declared."""
    rotors = declared.rotors.model_copy(
        update={"lag": declared.rotors.lag.model_copy(update={"up_s": 0.042, "down_s": 0.055})}
    )
    return declared.model_copy(update={"mass_kg": 1.8258, "inertia_kg_m2": Inertia(**TRUE_TENSOR), "rotors": rotors})


def plan() -> Plan:
    rng = np.random.default_rng(3)
    a, b = 0.11 * rng.standard_normal((2, 4, 5))
    c = np.array([0.0, 0.0, 1.1, 0.0])
    return Plan(
        vehicle="qball2",
        base_frequency_rad_s=2 * np.pi / 10,
        periods=1.0,
        coefficients=coefficients_from_arrays(a, b, c),
        condition_number=16.4,
    )


def flight(seed: int = 1) -> FlightData:
    """The streams of ``plan`` flown with a small tracking error, with gaps and noise, the poses' clock off by
    OFFSET_S.
    """
    rng = np.random.default_rng(seed)
    declared = vehicle()
    true = truth(declared)
    path = flight_path(plan(), [0.0, 0.0, 0.0, 0.0])
    duration = min(DURATION_S, path.duration_s)

    def times(rate: float, start: float = 0.0) -> np.ndarray:
        return start + np.arange(0.0, duration, 1.0 / rate)

    t_imu = times(500.0)
    motion = rigid_motion(path.sample(t_imu))
    gyro = motion.angular_velocity_body_rad_s + 0.004 * rng.standard_normal((len(t_imu), 3))
    q = quat_from_euler(*motion.euler_rad.T)
    accel = quat_rotate_inverse(q, motion.acceleration_world_m_s2 + np.array([0.0, 0.0, 9.80665]))
    imu = Stream(
        t_imu,
        np.column_stack([gyro, accel + 0.05 * rng.standard_normal((len(t_imu), 3))]),
        IMU_COLUMNS,
        t_imu + 100.0 + rng.exponential(2e-4, len(t_imu)),
    )

    t_pose = times(120.0)
    t_pose = t_pose[(t_pose < 14.2) | (t_pose > 14.9)]
    flown = path.sample(t_pose - 0.08)
    pose = rigid_motion(flown)
    mocap_values = np.column_stack(
        [pose.position_m + 4e-4 * rng.standard_normal((len(t_pose), 3)), quat_from_euler(*pose.euler_rad.T)]
    )
    mocap = Stream(t_pose + OFFSET_S, mocap_values, MOCAP_COLUMNS)

    force = true.mass_kg * motion.specific_thrust_m_s2
    torque = motion.angular_acceleration_body_rad_s2 @ true.inertia_tensor().T
    thrusts = np.linalg.solve(declared.allocation(), np.column_stack([force, torque]).T).T
    speeds = declared.motor_for_thrust(thrusts) + 1.5 * rng.standard_normal(thrusts.shape)
    t_set = times(50.0)
    wanted = path.sample(t_set)
    return FlightData(
        name="2026-03-14_15-09-26_qball2",
        vehicle=declared,
        motors=Stream(t_imu, speeds, motor_columns("rotor_speed", 4)),
        imu=imu,
        mocap=mocap,
        battery=Stream(
            times(5.0), np.column_stack([12.5 - 0.02 * times(5.0), np.full(len(times(5.0)), 14.0)]), BATTERY_COLUMNS
        ),
        setpoint=Stream(t_set, np.column_stack([wanted.position[0], wanted.yaw[0]]), SETPOINT_COLUMNS),
        plan=plan(),
        window_s=(10.0, 20.0),
        truth=true,
        metadata={"scenario": "seed", "seed": "17", "source": "logs/2026-03-14_15-09-26_qball2/flight.mcap"},
        notes=("mocap: 3 frozen poses left out.", "imu: 1 spike at 21.334 s replaced by interpolation."),
    )


def _method(rng: np.random.Generator, scatter: float, bias: float, best: bool = False) -> MethodResult:
    true = {"mass_kg": 1.8258, **{f"i{axes}_kg_m2": value for axes, value in TRUE_TENSOR.items()}}
    t = np.linspace(0.5, 10.0, 400)
    parameters, values = {}, {}
    for name in MASS_AND_TENSOR:
        size = true[name] if name == "mass_kg" else 0.1 * 0.1
        std = scatter * size * (0.1 if name == "mass_kg" else 1.0)
        value = true[name] * (1.0 - bias * (name != "mass_kg")) + std * rng.standard_normal()
        parameters[name] = Estimate.normal(value, std)
        values[name] = value + 12.0 * std * np.exp(-t / 1.5) * np.cos(3.0 * t) + std * np.sin(t) / t
    return MethodResult(
        parameters=parameters,
        condition_number=None if best else 16.4,
        rms_output_error={} if best else {name: 0.08 * (1 + bias) for name in OUTPUTS},
        evolution=None if best else Evolution(t, values),
        note="" if not bias else "Noise in the regressor pulls the inertias down.",
    )


def identification(seed: int = 2) -> Identification:
    rng = np.random.default_rng(seed)
    methods = {
        "LS": _method(rng, 0.02, 0.14),
        "GD": _method(rng, 0.03, 0.16),
        "FMLS": _method(rng, 0.02, 0.05),
        "FMGD": _method(rng, 0.03, 0.06),
        "PE": _method(rng, 0.01, 0.0, best=True),
    }
    scales = {"nominal": 1.0, "LS": 0.62, "GD": 0.66, "FMLS": 0.51, "FMGD": 0.53, "PE": 0.22}
    pose = {"x_m": 0.012, "y_m": 0.0144, "z_m": 0.006, "roll_rad": 0.021, "pitch_rad": 0.019, "yaw_rad": 0.009}
    output = dict(zip(OUTPUTS, (0.41, 0.031, 0.028, 0.0094), strict=True))
    return Identification(
        flight="2026-03-14_15-09-26_qball2",
        vehicle="qball2",
        anchor="thrust",
        methods=methods,
        model={
            "rotor_lag_up_s": Estimate.normal(0.0417, 0.0009),
            "rotor_lag_down_s": Estimate.normal(0.0561, 0.0011),
            "input_delay_s": Estimate(0.0011, 0.0006, (0.0, 0.0023)),
            "gyro_bias_x_rad_s": Estimate.normal(0.00213, 0.00004),
        },
        best="PE",
        best_reason="Its innovations are white, it lies inside the set of real bodies, and it agrees with the filtered "
        "regression.",
        clock=Clock(OFFSET_S, 0.00011, 2.1e-5, 4.0e-6),
        not_identifiable={
            "com_offset_z_m": "Fly with changing horizontal acceleration at constant thrust, or tilt beyond 15°."
        },
        warnings=("The pose stream stood still for 0.7 s at 14.2 s.",),
        bound={name: 0.5 * e.std for name, e in methods["PE"].parameters.items()},
        window_s=(10.0, 20.0),
        excluded_s=((14.1, 15.0),),
        quality=(
            "Gyro and attitude agree to 0.004 rad/s RMS after alignment.",
            "Marker body turned by 0.3° ± 0.1° against the IMU.",
        ),
        validation=(
            Validation(
                "closed_loop",
                {
                    k: {n: s * v * (1.3 if n == "z_m" and k in ("LS", "GD") else 1) for n, v in pose.items()}
                    for k, s in scales.items()
                },
                5000,
            ),
            Validation(
                "output",
                {k: {n: s**0.5 * v for n, v in output.items()} for k, s in scales.items()},
                5000,
                "Standard regressor (12).",
            ),
        ),
    )


def diagnosis(seed: int = 4) -> Diagnosis:
    rng = np.random.default_rng(seed)
    t = np.arange(10.0, 20.0, 0.004)
    residual: dict[str, np.ndarray] = {"t_s": t}
    for channel, size in (("force_x_n", 0.4), ("force_z_n", 0.2), ("torque_y_nm", 0.012)):
        noise = 0.15 * size * rng.standard_normal(len(t))
        residual[channel] = size * np.sin(1.9 * t) * np.cos(0.7 * t) + noise
        residual[f"{channel}/after"] = noise
    ident = identification()
    before = ident.methods["FMLS"].parameters
    channels = {
        "force_x_n": 0.41,
        "force_y_n": 0.38,
        "force_z_n": 0.22,
        "torque_x_nm": 0.013,
        "torque_y_nm": 0.012,
        "torque_z_nm": 0.004,
    }

    def scaled(factor: float) -> dict[str, float]:
        return {name: factor * value for name, value in channels.items()}

    return Diagnosis(
        flight=ident.flight,
        vehicle="qball2",
        verdict="explained",
        findings=(
            Finding(
                "rotor_drag",
                {"d_x_kg_s": Estimate.normal(0.302, 0.011), "d_y_kg_s": Estimate.normal(0.287, 0.012)},
                "The vehicle is held back in proportion to its speed: 0.30 N for each metre per second.",
                0.994,
            ),
            Finding(
                "motor_lag",
                {"rotor_lag_up_s": Estimate.normal(0.0417, 0.0009)},
                "Thrust follows the command 42 ms late, speeding up faster than slowing down.",
                0.97,
                ("input_delay",),
            ),
            Finding(
                "weak_rotor",
                {"thrust_scale": Estimate.normal(0.91, 0.01)},
                "Rotor 3 gives 9 % less thrust than the others at the same speed.",
                0.88,
                ("com_offset",),
                3,
            ),
        ),
        unexplained=(Unexplained("torque_z_nm", 0.12, ("position_x_m", "speed_m_s"), "0.0021 N m/m · x"),),
        error={
            "held_out": {
                "nominal": scaled(1.4),
                "before": scaled(1.0),
                "after": {**scaled(0.2), "torque_z_nm": 0.0042},
                "prediction_0.1_s_nominal": {"position_m": 0.0015, "body_rate_rad_s": 0.11},
                "prediction_0.1_s_before": {"position_m": 0.0004, "body_rate_rad_s": 0.035},
                "prediction_0.1_s_after": {"position_m": 0.0001, "body_rate_rad_s": 0.007},
                "prediction_0.5_s_before": {"position_m": 0.012},
                "prediction_0.5_s_after": {"position_m": 0.003},
                "simulation_before": {"x_m": 0.011, "y_m": 0.009},
                "simulation_after": {"x_m": 0.003, "y_m": 0.0021},
            }
        },
        parameters_before=before,
        parameters_after=ident.methods["PE"].parameters,
        next_flight="Hover 10 s, then fly 1.5 m/s along x and y: it separates the weak rotor from a centre-of-mass "
        "offset with odds of 40 to 1.",
        reason="Three effects together remove 80 % of the residual on the held-out blocks; the rest is as large as the "
        "sensor noise.",
        warnings=(
            "The controller of this autopilot is not known; closed-loop simulation is the simulated vehicle's own.",
        ),
        notes=("Predictions are judged on 144 windows that lie in data no estimate saw.",),
        candidates=(
            {"effect": "rotor_drag", "gain": 0.61, "kept": True, "why": "beats every rival"},
            {"effect": "wind", "gain": 0.02, "kept": False, "why": "no better than chance"},
        ),
        residual=residual,
    )


def written(folder: Path, seed: int = 2) -> Path:
    """A flight's folder with the documents of an analysis."""
    found, judged = identification(seed), diagnosis()
    folder.mkdir()
    write_json(folder / "identification.json", identification_document(found, judged))
    write_json(folder / "diagnosis.json", judged.to_dict())
    return folder


def hostile(text: str) -> tuple[FlightData, Identification, Diagnosis]:
    """The same with ``text`` in every place where a log, a vehicle file or a folder can put words."""
    data, ident, found = flight(), identification(), diagnosis()
    named = data.vehicle.model_copy(update={"name": text})
    data = replace(
        data,
        name=text,
        vehicle=named,
        metadata={text: text, "source": text, "scenario": text},
        notes=(text,),
        truth=None,
    )
    methods = {**ident.methods, text: ident.methods["LS"]}
    ident = replace(
        ident,
        flight=text,
        vehicle=text,
        methods=methods,
        best_reason=text,
        warnings=(text,),
        quality=(text,),
        not_identifiable={text: text},
        model={**ident.model, text: ident.model["rotor_lag_up_s"]},
    )
    finding = replace(
        found.findings[0],
        effect=text,
        sentence=text,
        alternatives=(text,),
        parameters={text: Estimate.normal(1.0, 0.1)},
    )
    found = replace(
        found,
        findings=(finding,),
        next_flight=text,
        reason=text,
        candidates=({text: text},),
        unexplained=(Unexplained(text, 0.1, (text,), text),),
    )
    return data, ident, found
