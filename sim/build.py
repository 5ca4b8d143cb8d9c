"""From a declared vehicle and a scenario to the constants of the compiled loop."""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt, tan

import numpy as np

from groundstation import frames
from groundstation.errors import BadInput
from groundstation.vehicle import Vehicle
from sim.algebra import Symmetric, Vector
from sim.autopilot import LEAD_RATIO, Law, Observer
from sim.background import Disturbance, Supply
from sim.loop import World
from sim.measure import Instruments
from sim.plant import Body, Plant, Rotors
from sim.scenario import Scenario, true_vehicle
from sim.tuning import tuned_control

STEP_S = 0.001
"""Integration step of the seed paper (section IV-A)."""

_TILT_MAX = 0.7  # what the control law may command, rad
_UNBOUNDED = 1e9


def _vector(values) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _symmetric(matrix: np.ndarray) -> Symmetric:
    m = np.asarray(matrix, dtype=float)
    return (float(m[0, 0]), float(m[0, 1]), float(m[0, 2]), float(m[1, 1]), float(m[1, 2]), float(m[2, 2]))


def _quaternion(rotation_vector) -> tuple[float, float, float, float]:
    w, x, y, z = (float(v) for v in frames.quat_exp(np.asarray(rotation_vector, dtype=float)))
    return w, x, y, z


def motor_curve(vehicle: Vehicle) -> Vector:
    """c0, c1, c2 of thrust against the motor value by the declared constants; newton itself for a wrench vehicle."""
    rotors = vehicle.rotors
    if rotors.input == "wrench":
        return 0.0, 1.0, 0.0
    if rotors.thrust_curve is not None:
        return _vector(rotors.thrust_curve)
    k = rotors.thrust_coefficient_n_s2 or 0.0
    return 0.0, 0.0, k * (rotors.speed_max_rad_s or 1.0) ** 2 if rotors.input == "command" else k


def motor_value_max(vehicle: Vehicle) -> float:
    """Largest motor value."""
    rotors = vehicle.rotors
    if rotors.input == "command":
        return 1.0
    if rotors.input == "rotor_speed" and rotors.speed_max_rad_s is not None:
        return rotors.speed_max_rad_s
    return _UNBOUNDED


def _speed_coefficient(vehicle: Vehicle) -> float:
    """K of T = k Omega^2: declared, or for a usual propeller, C_T = T/(rho n^2 D^4) = 0.1 (Brandt & Selig 2011)."""
    declared = vehicle.rotors.thrust_coefficient_n_s2
    if declared is not None:
        return declared
    diameter = 2.0 * vehicle.rotors.radius_m
    return 0.1 * vehicle.identification.air_density_kg_m3 * diameter**4 / (2.0 * pi) ** 2


def _body(vehicle: Vehicle, com: np.ndarray, extra_kg: float, extra_at: np.ndarray) -> Body:
    """Mass properties of the vehicle with a point mass on board (parallel-axis theorem)."""
    mass = vehicle.mass_kg + extra_kg
    if mass <= 0.0:
        raise BadInput(f"scenario: payload_change leaves a mass of {mass:g} kg; make the load lighter.")
    centre = (vehicle.mass_kg * com + extra_kg * extra_at) / mass
    tensor = vehicle.inertia_tensor()
    for m, at in ((vehicle.mass_kg, com), (extra_kg, extra_at)):
        d = at - centre
        tensor = tensor + m * (d @ d * np.eye(3) - np.outer(d, d))
    return Body(float(mass), _vector(centre), _symmetric(tensor), _symmetric(np.linalg.inv(tensor)))


def _rotors(declared: Vehicle, truth: Vehicle) -> Rotors:
    """The true rotors; curve and speeds are the declared vehicle's, lag and hover the true one's."""
    rotors, curve, k = truth.rotors, motor_curve(declared), _speed_coefficient(declared)
    hover = truth.mass_kg * truth.gravity_m_s2 / rotors.count
    # One pole of zero beside one that is not would freeze a rotor: the step is the shortest lag there is.
    up, down = rotors.lag.up_s, rotors.lag.down_s
    if up > 0.0 or down > 0.0:
        up, down = max(up, STEP_S), max(down, STEP_S)
    return Rotors(
        position=np.array(rotors.position_m, dtype=float),
        spin=np.array(rotors.spin, dtype=float),
        axis=rotors.axes(),
        curve=curve,
        torque_ratio=rotors.torque_to_thrust_m,
        radius=rotors.radius_m,
        speed_coefficient=k,
        lag_up=up,
        lag_down=down,
        value_max=motor_value_max(declared),
        thrust_min=-_UNBOUNDED if rotors.input == "wrench" else 0.0,
        hover_thrust=hover,
        hover_value=value_for(curve, hover),
        hover_speed=sqrt(hover / k),
        hover_inflow=sqrt(hover / (2.0 * truth.identification.air_density_kg_m3 * pi * rotors.radius_m**2)),
    )


def build_plant(declared: Vehicle, scenario: Scenario) -> Plant:
    """Nature: the true vehicle with the scenario's effects."""
    truth = true_vehicle(declared, scenario)
    effects = scenario.effects
    com = np.array(effects.com_offset.offset_m) if effects.com_offset.on else np.zeros(3)
    load = effects.payload_change
    at = np.array(load.position_m)
    after = _body(truth, com, 0.0, at)
    before = _body(truth, com, load.mass_kg, at) if load.on else after
    rotors = truth.rotors
    for effect in (effects.weak_rotor, effects.rotor_degradation):
        if effect.on and effect.rotor > rotors.count:
            raise BadInput(f"scenario: there is no rotor {effect.rotor}; {declared.name} has {rotors.count}.")
    at_once = rotors.lag.up_s == rotors.lag.down_s == 0.0 and not effects.motor_lag.on
    if effects.rotor_gyroscopic.on and at_once:
        raise BadInput(
            "scenario: rotors with an inertia (rotor_gyroscopic) do not change their speed at once; give them a lag "
            f"([truth.lag], the effect motor_lag, or the lag that {declared.name} declares)."
        )
    wall = effects.attracting_wall.azimuth_rad
    return Plant(
        before=before,
        after=after,
        change_s=float(load.time_s) if load.on else -_UNBOUNDED,
        rotors=_rotors(declared, truth),
        effects=effects,
        gravity=truth.gravity_m_s2,
        air_density=truth.identification.air_density_kg_m3,
        wall_direction=(cos(wall), sin(wall), 0.0),
    )


def value_for(curve: Vector, thrust: float) -> float:
    """Motor value for a thrust by a curve."""
    c0, c1, c2 = curve
    if c2 == 0.0:
        return (thrust - c0) / c1
    return (-c1 + sqrt(max(c1 * c1 - 4.0 * c2 * (c0 - thrust), 0.0))) / (2.0 * c2)


def control_every(scenario: Scenario) -> int:
    """Steps from one control tick to the next."""
    return round(1.0 / (scenario.control.attitude_hz * STEP_S))


def build_law(declared: Vehicle, scenario: Scenario) -> Law:
    """The control law with the vehicle file's gains, or with gains tuned to the vehicle where the file has none."""
    truth = true_vehicle(declared, scenario)
    effects = scenario.effects
    lag = max(truth.rotors.lag.up_s, truth.rotors.lag.down_s)
    if effects.motor_lag.on:
        lag = effects.motor_lag.hover_s / effects.motor_lag.braking_share
    if effects.input_delay.on:
        lag += effects.input_delay.delay_s
    tuned = "control" not in declared.model_fields_set
    delay = LEAD_RATIO * lag + 1.0 / scenario.control.attitude_hz + 1.0 / scenario.imu.rate_hz
    gains = tuned_control(declared, delay) if tuned else declared.control
    count = declared.rotors.count
    weight = declared.mass_kg * declared.gravity_m_s2
    highest = declared.rotor_thrust_max_n()
    bounded = declared.rotors.input != "wrench" and highest < _UNBOUNDED
    limits = declared.limits
    lead = lag if tuned else 0.0
    period = control_every(scenario) * STEP_S
    return Law(
        mass=declared.mass_kg,
        gravity=declared.gravity_m_s2,
        position_p=gains.position_p,
        position_i=gains.position_i,
        position_d=gains.position_d,
        attitude_p=gains.attitude_p,
        attitude_i=gains.attitude_i,
        attitude_d=gains.attitude_d,
        filter_rad_s=gains.derivative_filter_rad_s,
        filter_share=1.0 - exp(-gains.derivative_filter_rad_s * period),
        mixing=np.ascontiguousarray(declared.mixing()),
        rotor_min=-_UNBOUNDED if declared.rotors.input == "wrench" else 0.05 * weight / count,
        rotor_max=highest if bounded else _UNBOUNDED,
        thrust_max=limits.thrust_max_n or (count * highest if bounded else 4.0 * weight),
        torque_max=limits.torque_max_nm or _UNBOUNDED,
        tilt_max=_TILT_MAX,
        curve=motor_curve(declared),
        value_max=motor_value_max(declared),
        lead_s=lead,
        lead_share=1.0 - exp(-period / (LEAD_RATIO * lead)) if lead > 0.0 else 1.0,
    )


def low_pass(cutoff_hz: float | None, rate_hz: float) -> tuple[float, float, float, float, float]:
    """Second-order Butterworth low-pass by the bilinear transform, b0, b1, b2, a1, a2; None passes everything.

    Raises:
        BadInput: the cut-off is not below half the rate.
    """
    if cutoff_hz is None:
        return 1.0, 0.0, 0.0, 0.0, 0.0
    if cutoff_hz >= 0.5 * rate_hz:
        raise BadInput(f"imu.filter_hz of {cutoff_hz:g} is not below half the IMU's rate of {rate_hz:g} Hz; lower it.")
    k = tan(pi * cutoff_hz / rate_hz)
    scale = 1.0 / (1.0 + sqrt(2.0) * k + k * k)
    b0 = k * k * scale
    return b0, 2.0 * b0, b0, 2.0 * (k * k - 1.0) * scale, (1.0 - sqrt(2.0) * k + k * k) * scale


def build_instruments(declared: Vehicle, scenario: Scenario) -> Instruments:
    """IMU and motion-capture body, with what is wrong about them."""
    imu, shift, tilt = (
        scenario.effects.imu_misalignment,
        scenario.effects.mocap_misalignment,
        scenario.effects.mocap_tilt,
    )
    marker = frames.quat_exp(np.array(declared.mocap.rotation_rad))
    point = np.array(declared.mocap.position_m, dtype=float)
    if shift.on:
        marker = frames.quat_multiply(marker, frames.quat_exp(np.array(shift.rotation_rad)))
        point = point + np.array(shift.offset_m)
    w, x, y, z = (float(v) for v in marker)
    zero, one = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
    return Instruments(
        lever=_vector(declared.imu.position_m),
        imu_turn=_quaternion(imu.rotation_rad if imu.on else zero),
        gyro_scale=imu.gyro_scale if imu.on else one,
        accel_scale=imu.accel_scale if imu.on else one,
        gyro_bias=imu.gyro_bias_rad_s if imu.on else zero,
        accel_bias=imu.accel_bias_m_s2 if imu.on else zero,
        low_pass=low_pass(declared.imu.filter_hz, scenario.imu.rate_hz),
        point=_vector(point),
        marker_turn=(w, x, y, z),
        world_turn=_quaternion([*(-a for a in tilt.tilt_rad), 0.0] if tilt.on else zero),
        latency=scenario.mocap.clock.latency_s + scenario.mocap.clock.latency_jitter_s,
        known_point=_vector(declared.mocap.position_m),
        known_marker_turn=_quaternion(declared.mocap.rotation_rad),
    )


def build_supply(declared: Vehicle, scenario: Scenario) -> Supply:
    """The battery; what vehicle file and scenario leave out is sized to the vehicle.

    Full voltage by the number of cells usual for the mass; capacity for twelve minutes of hover; a resistance that
    drops 4 % of the full voltage at hover current. Drives are 60 % efficient against ideal momentum theory; avionics
    draw a watt and a further watt per kilogram.
    """
    mass, count = declared.mass_kg, declared.rotors.count
    weight = mass * declared.gravity_m_s2
    disc = pi * declared.rotors.radius_m**2 * count
    ideal = weight * sqrt(weight / (2.0 * declared.identification.air_density_kg_m3 * disc))
    cells = 1 if mass < 0.1 else 2 if mass < 0.3 else 3 if mass < 1.9 else 4
    full = declared.battery.full_v or 4.2 * cells
    avionics = 1.0 + mass
    hover_current = (ideal / 0.6 + avionics) / (0.92 * full)
    capacity = scenario.battery.capacity_as or declared.battery.capacity_as or 720.0 * hover_current
    resistance = scenario.battery.resistance_ohm
    if resistance is None:
        resistance = declared.battery.internal_resistance_ohm or 0.04 * full / hover_current
    return Supply(full, capacity, resistance, avionics, 0.6)


def build_world(declared: Vehicle, scenario: Scenario) -> World:
    """All constants of a simulated flight.

    Raises:
        BadInput: the scenario does not fit the vehicle.
    """
    truth = true_vehicle(declared, scenario)
    weight = truth.mass_kg * truth.gravity_m_s2
    model = scenario.disturbance
    delay = scenario.mocap.clock.latency_s
    return World(
        dt=STEP_S,
        ground_m=scenario.start.position_m[2],
        control_every=control_every(scenario),
        outer_every=1.0 / (scenario.control.position_hz * STEP_S),
        plant=build_plant(declared, scenario),
        law=build_law(declared, scenario),
        observer=Observer(
            imu_period=1.0 / scenario.imu.rate_hz,
            pose_period=1.0 / scenario.mocap.rate_hz,
            bandwidth=min(6.0, 0.2 * scenario.mocap.rate_hz, 0.3 / max(delay, 1e-3)),
            attitude_bandwidth=2.0,
            gravity=declared.gravity_m_s2,
        ),
        instruments=build_instruments(declared, scenario),
        supply=build_supply(declared, scenario),
        disturbance=Disturbance(
            force_n=model.force_share * weight,
            torque_nm=model.torque_share * weight * declared.arm_m(),
            correlation=model.correlation_s,
            order=model.order,
        ),
    )
