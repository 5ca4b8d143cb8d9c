"""The compiled loop: plant, flight software and sampling, step by step, for a stretch of time.

Noise is drawn outside and handed in, so that one seed gives one flight however it is cut into stretches. Everything that
lasts from one stretch to the next is in :class:`Memory`.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from sim.algebra import (
    add,
    copy,
    exponential,
    multiply,
    scale,
    to_world,
)
from sim.autopilot import Law, Observer, attitude_loop, correct, euler_of, lead, mix, position_loop, predict
from sim.background import Disturbance, Supply, drain, drift_step
from sim.compiled import compiled
from sim.effects.airframe import gust_step
from sim.effects.rotor_faults import play, power_law
from sim.measure import Instruments, body_pose, measure_imu, measure_pose
from sim.plant import (
    ATTITUDE,
    RATE,
    ROTOR,
    VELOCITY,
    Plant,
    Surroundings,
    mechanical_power,
    rk4_step,
    specific_force,
    thrust_of,
)

STANDING, CRASHED, PENDING_HEAD, PENDING_TAIL, FLAG_COUNT = 0, 1, 2, 3, 4
HISTORY, PENDING = 1024, 256
IDLE, FLYING, EXTERNAL = 0, 1, 2
"""Rotors off; the vehicle's own control law; motor values from outside."""


class World(NamedTuple):
    """Everything constant during a flight."""

    dt: float
    ground_m: float
    control_every: int
    outer_every: float
    plant: Plant
    law: Law
    observer: Observer
    instruments: Instruments
    supply: Supply
    disturbance: Disturbance


class Memory(NamedTuple):
    """Everything that changes, as arrays.

    Attributes:
        x: plant state.
        work: scratch of the integrator, shape (5, len(x)).
        thrust: thrust memory of each rotor.
        target: latest motor values asked for.
        delay: past targets, one per step, shape (HISTORY, n).
        control: controller state.
        estimate: estimator state.
        led: state of the rotors' lead.
        history: estimated position and quaternion, one per step, shape (HISTORY, 7).
        pending: poses on their way: exposure, arrival, pose, shape (PENDING, 9).
        last_pose: last measured pose, for freezes.
        battery: charge used (A s), terminal voltage, current.
        drift: disturbance processes, shape (2, 6).
        gust: turbulence processes, shape (2, 3).
        low_pass: filter states, shape (2, 6).
        flags: standing, crashed, head and tail of the pending poses.
    """

    x: np.ndarray
    work: np.ndarray
    thrust: np.ndarray
    target: np.ndarray
    delay: np.ndarray
    control: np.ndarray
    estimate: np.ndarray
    led: np.ndarray
    history: np.ndarray
    pending: np.ndarray
    last_pose: np.ndarray
    battery: np.ndarray
    drift: np.ndarray
    gust: np.ndarray
    low_pass: np.ndarray
    flags: np.ndarray


class Stretch(NamedTuple):
    """Inputs of one stretch of time.

    Attributes:
        first: number of its first step.
        steps: how many.
        mode: IDLE, FLYING or EXTERNAL.
        start_s: time of take-off (infinite before).
        setpoints: one row per control tick, shape (ticks, 11).
        motors: motor values from outside, one row per control tick (EXTERNAL).
        imu_s: true sample times.
        imu_noise: noise with bias, gyro then accelerometer, shape (k, 6).
        pose_s: true exposure times.
        pose_arrival_s: when the flight software gets each; infinite for a lost one.
        pose_frozen: whether the tracker repeats the last pose.
        pose_noise: position (m) and rotation vector (rad), shape (k, 6).
        speed_s: true times of rotor-speed telemetry.
        battery_s: true times of battery telemetry.
        drift_noise: standard normal, shape (steps, 6).
        gust_noise: standard normal, shape (steps, 3).
    """

    first: int
    steps: int
    mode: int
    start_s: float
    setpoints: np.ndarray
    motors: np.ndarray
    imu_s: np.ndarray
    imu_noise: np.ndarray
    pose_s: np.ndarray
    pose_arrival_s: np.ndarray
    pose_frozen: np.ndarray
    pose_noise: np.ndarray
    speed_s: np.ndarray
    battery_s: np.ndarray
    drift_noise: np.ndarray
    gust_noise: np.ndarray


@compiled
def deliver_poses(observer: Observer, estimate, ring, flags, history, step: int, age: int, t: float) -> None:
    """Hand poses that have arrived to the estimator, compared with the estimate ``age`` steps ago."""
    while flags[PENDING_HEAD] != flags[PENDING_TAIL]:
        row = ring[flags[PENDING_HEAD]]
        if row[1] > t:
            return
        correct(observer, estimate, history[max(step - age, 0) % HISTORY], row[2:])
        flags[PENDING_HEAD] = (flags[PENDING_HEAD] + 1) % PENDING


@compiled
def touch_floor(x, flags, ground_m: float) -> None:
    """Lift off and touch down: the floor holds the vehicle level until its thrust exceeds its weight."""
    if flags[STANDING]:
        if x[VELOCITY + 2] > 0.0:
            flags[STANDING] = 0
        return
    if x[2] > ground_m or x[VELOCITY + 2] > 0.0:
        return
    q = (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3])
    up = to_world(q, (0.0, 0.0, 1.0))[2]
    speed = sqrt(x[3] ** 2 + x[4] ** 2 + x[5] ** 2)
    if up < 0.5 or speed > 2.5:
        flags[CRASHED] = 1
    yaw = euler_of(q)[2]
    x[2] = ground_m
    for i in range(3):
        x[VELOCITY + i] = 0.0
        x[RATE + i] = 0.0
    x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3] = cos(0.5 * yaw), 0.0, 0.0, sin(0.5 * yaw)
    flags[STANDING] = 1


@compiled
def fly_law(
    law: Law, control, estimate, led, target, setpoint, outer: bool, inner_s: float, outer_s: float, standing: bool
) -> None:
    """One control tick: new motor values into ``target``; the position loop runs where ``outer`` says so."""
    if outer:
        position_loop(law, control, estimate, setpoint, outer_s, standing)
    thrust, torque = attitude_loop(law, control, estimate, setpoint, inner_s, standing)
    if standing:
        torque = (0.0, 0.0, 0.0)
    mix(law, thrust, torque, target)
    if law.lead_s > 0.0:
        lead(law, inner_s, led, target)


@compiled
def run(world: World, memory: Memory, stretch: Stretch):
    """Advance the world by one stretch.

    Returns:
        imu (k, 6), poses (k, 7), rotor values (k, n), battery voltage and current (k, 2) at the sample times; and per control
        tick the motor values asked for (ticks, n) and the estimate (ticks, 13); and per step the true state (steps, 13).
    """
    dt, plant, x = world.dt, world.plant, memory.x
    n = len(plant.rotors.spin)
    ticks = len(stretch.setpoints)
    imu = np.empty((len(stretch.imu_s), 6))
    poses = np.empty((len(stretch.pose_s), 7))
    speeds = np.empty((len(stretch.speed_s), n))
    volts = np.empty((len(stretch.battery_s), 2))
    commands = np.empty((ticks, n))
    estimates = np.empty((ticks, 13))
    path = np.empty((stretch.steps, 13))
    i_imu, i_pose, i_speed, i_battery, i_tick = 0, 0, 0, 0, 0
    asked = np.empty(n)
    effects = plant.effects
    pose_age = min(round(world.instruments.latency / dt), HISTORY - 1)
    delay_steps = round(effects.input_delay.delay_s / dt) if effects.input_delay.on else 0

    for k in range(stretch.steps):
        step = stretch.first + k
        t = step * dt
        powered = stretch.mode != IDLE and memory.flags[CRASHED] == 0
        for i in range(7):
            memory.history[step % HISTORY, i] = memory.estimate[i if i < 3 else i + 3]
        deliver_poses(world.observer, memory.estimate, memory.pending, memory.flags, memory.history, step, pose_age, t)
        if step % world.control_every == 0:
            if powered and stretch.mode == FLYING:
                before = int((step - world.control_every) / world.outer_every + 1e-9)
                outer = int(step / world.outer_every + 1e-9) != before or step == 0
                fly_law(
                    world.law,
                    memory.control,
                    memory.estimate,
                    memory.led,
                    memory.target,
                    stretch.setpoints[i_tick],
                    outer,
                    world.control_every * dt,
                    world.outer_every * dt,
                    memory.flags[STANDING] == 1,
                )
            elif powered:
                copy(stretch.motors[i_tick], memory.target)
            else:
                memory.target.fill(0.0)
            copy(memory.target, commands[i_tick])
            copy(memory.estimate, estimates[i_tick])
            i_tick += 1
        copy(memory.target, memory.delay[step % HISTORY])
        power = world.supply.avionics_w
        if powered:
            power += mechanical_power(x, plant.rotors, plant.air_density) / world.supply.efficiency
        ratio = drain(world.supply, memory.battery, power, dt)
        sag = 1.0
        if effects.battery_sag.on:
            sag = 1.0 - effects.battery_sag.strength * (1.0 - ratio)
        for i in range(n):
            asked[i] = sag * memory.delay[(step - delay_steps) % HISTORY, i]

        force, torque = drift_step(world.disturbance, memory.drift, stretch.drift_noise[k], dt)
        wind = (0.0, 0.0, 0.0)
        if effects.wind.on:
            wind = gust_step(effects.wind, memory.gust, stretch.gust_noise[k], dt)
        now = Surroundings(wind, force, torque, t - stretch.start_s, powered, memory.flags[STANDING] == 1)
        if effects.thrust_memory.on:
            hover = plant.rotors.hover_thrust
            for i in range(n):
                ideal = power_law(effects.thrust_curve, thrust_of(plant.rotors, x[ROTOR + i]), hover)
                memory.thrust[i] = play(effects.thrust_memory, memory.thrust[i], ideal, hover)
        position, velocity = (x[0], x[1], x[2]), (x[3], x[4], x[5])
        q = (x[6], x[7], x[8], x[9])
        w = (x[10], x[11], x[12])
        copy(x, path[k])
        rk4_step(x, memory.work, asked, memory.thrust, plant, now, dt)
        first, last = memory.work[0], memory.work[3]

        while i_imu < len(stretch.imu_s) and stretch.imu_s[i_imu] < t + dt - 1e-9:
            s = max(stretch.imu_s[i_imu] - t, 0.0)
            share = s / dt
            turn = (
                first[10] + share * (last[10] - first[10]),
                first[11] + share * (last[11] - first[11]),
                first[12] + share * (last[12] - first[12]),
            )
            push = (
                first[3] + share * (last[3] - first[3]),
                first[4] + share * (last[4] - first[4]),
                first[5] + share * (last[5] - first[5]),
            )
            w_s = add(w, scale(s, (first[10], first[11], first[12])))
            q_s = multiply(q, exponential(scale(s, w)))
            felt = specific_force(push, turn, w_s, q_s, world.instruments.lever, plant.gravity)
            measure_imu(world.instruments, memory.low_pass, w_s, felt, stretch.imu_noise[i_imu], imu[i_imu])
            row = imu[i_imu]
            predict(world.observer, memory.estimate, (row[0], row[1], row[2]), (row[3], row[4], row[5]))
            i_imu += 1
        while i_pose < len(stretch.pose_s) and stretch.pose_s[i_pose] < t + dt - 1e-9:
            s = max(stretch.pose_s[i_pose] - t, 0.0)
            seen = add(position, add(scale(s, velocity), scale(0.5 * s * s, (first[3], first[4], first[5]))))
            w_mid = add(w, scale(0.5 * s, (first[10], first[11], first[12])))
            q_s = multiply(q, exponential(scale(s, w_mid)))
            frozen = stretch.pose_frozen[i_pose]
            measure_pose(
                world.instruments, memory.last_pose, seen, q_s, frozen, stretch.pose_noise[i_pose], poses[i_pose]
            )
            if stretch.pose_arrival_s[i_pose] < np.inf:
                tail = memory.flags[PENDING_TAIL]
                memory.pending[tail, 0] = stretch.pose_s[i_pose]
                memory.pending[tail, 1] = stretch.pose_arrival_s[i_pose]
                body_pose(world.instruments, poses[i_pose], memory.pending[tail, 2:])
                memory.flags[PENDING_TAIL] = (tail + 1) % PENDING
            i_pose += 1
        while i_speed < len(stretch.speed_s) and stretch.speed_s[i_speed] < t + dt - 1e-9:
            s = max(stretch.speed_s[i_speed] - t, 0.0)
            for i in range(n):
                speeds[i_speed, i] = x[ROTOR + i] - (dt - s) * first[ROTOR + i]
            i_speed += 1
        while i_battery < len(stretch.battery_s) and stretch.battery_s[i_battery] < t + dt - 1e-9:
            volts[i_battery, 0], volts[i_battery, 1] = memory.battery[1], memory.battery[2]
            i_battery += 1
        touch_floor(x, memory.flags, world.ground_m)
    return imu, poses, speeds, volts, commands, estimates, path
