"""The compiled loop: plant, flight software and sampling, step by step, for a stretch of time.

Noise is drawn outside and handed in, so that one seed gives one flight however it is cut into stretches. Everything
that lasts from one stretch to the next is in :class:`Memory`.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from sim.algebra import (
    add,
    chosen,
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
from sim.lanes import any_of, negate, select
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
from sim.rows import past

STANDING, CRASHED, PENDING_HEAD, PENDING_TAIL, CRASH_STEP, FLAG_COUNT = 0, 1, 2, 3, 4, 5
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
        flags: standing, crashed, head and tail of the pending poses, step of the latest crash.
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
def touch_floor(x, flags, ground_m: float, step: int) -> None:
    """Lift off and touch down: the floor holds the vehicle level until its thrust exceeds its weight."""
    standing, rising = flags[STANDING] != 0, x[VELOCITY + 2] > 0.0
    lands = negate(standing | rising | (x[2] > ground_m))
    flags[STANDING] = select(standing & rising, 0, flags[STANDING])
    if not any_of(lands):
        return
    q = (x[ATTITUDE], x[ATTITUDE + 1], x[ATTITUDE + 2], x[ATTITUDE + 3])
    up = to_world(q, (0.0, 0.0, 1.0))[2]
    speed = sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5])
    crashes = lands & ((up < 0.5) | (speed > 2.5))
    flags[CRASH_STEP] = select(crashes & (flags[CRASHED] == 0), step, flags[CRASH_STEP])
    flags[CRASHED] = select(crashes, 1, flags[CRASHED])
    yaw = euler_of(q)[2]
    x[2] = select(lands, ground_m, x[2])
    for i in range(3):
        x[VELOCITY + i] = select(lands, 0.0, x[VELOCITY + i])
        x[RATE + i] = select(lands, 0.0, x[RATE + i])
    x[ATTITUDE] = select(lands, cos(0.5 * yaw), q[0])
    x[ATTITUDE + 1] = select(lands, 0.0, q[1])
    x[ATTITUDE + 2] = select(lands, 0.0, q[2])
    x[ATTITUDE + 3] = select(lands, sin(0.5 * yaw), q[3])
    flags[STANDING] = select(lands, 1, flags[STANDING])


@compiled
def fly_law(
    law: Law, control, estimate, led, target, setpoint, outer: bool, inner_s: float, outer_s: float, standing: bool
) -> None:
    """One control tick: new motor values into ``target``; the position loop runs where ``outer`` says so."""
    if outer:
        position_loop(law, control, estimate, setpoint, outer_s, standing)
    thrust, torque = attitude_loop(law, control, estimate, setpoint, inner_s, standing)
    mix(law, thrust, chosen(standing, (0.0, 0.0, 0.0), torque), target)
    if any_of(law.lead_s > 0.0):
        lead(law, led, target)


@compiled
def remember(memory: Memory, step: int) -> None:
    """The estimate of this step, position and quaternion, into the history that late poses are compared with."""
    for i in range(7):
        memory.history[step % HISTORY, i] = memory.estimate[i if i < 3 else i + 3]


@compiled
def control_tick(world: World, memory: Memory, stretch: Stretch, step: int, tick: int, powered: bool) -> None:
    """New motor values by the vehicle's own law, from outside, or none."""
    if powered and stretch.mode == FLYING:
        before = int((step - world.control_every) / world.outer_every + 1e-9)
        outer = int(step / world.outer_every + 1e-9) != before or step == 0
        fly_law(
            world.law,
            memory.control,
            memory.estimate,
            memory.led,
            memory.target,
            stretch.setpoints[tick],
            outer,
            world.control_every * world.dt,
            world.outer_every * world.dt,
            memory.flags[STANDING] == 1,
        )
    elif powered:
        copy(stretch.motors[tick], memory.target)
    else:
        memory.target.fill(0.0)


@compiled
def ask_rotors(world: World, memory: Memory, step: int, powered: bool, asked) -> None:
    """What reaches the rotors: the target of a while ago, less what the battery's voltage takes, into ``asked``."""
    plant, effects = world.plant, world.plant.effects
    copy(memory.target, memory.delay[step % HISTORY])
    idle = world.supply.avionics_w
    drives = mechanical_power(memory.x, plant.rotors, plant.air_density) / world.supply.efficiency
    power = select(powered, idle + drives, idle)
    ratio = drain(world.supply, memory.battery, power, world.dt)
    sag = 1.0
    if effects.battery_sag.on:
        sag = 1.0 - effects.battery_sag.strength * (1.0 - ratio)
    for i in range(len(asked)):
        if effects.input_delay.on:
            asked[i] = sag * past(memory.delay, step, effects.input_delay.delay_s / world.dt, i)
        else:
            asked[i] = sag * memory.target[i]


@compiled
def surroundings(world: World, memory: Memory, stretch: Stretch, k: int, t: float, powered: bool) -> Surroundings:
    """Wind and disturbance of this step, each a process of its own."""
    force, torque = drift_step(world.disturbance, memory.drift, stretch.drift_noise[k], world.dt)
    wind = (0.0, 0.0, 0.0)
    if world.plant.effects.wind.on:
        wind = gust_step(world.plant.effects.wind, memory.gust, stretch.gust_noise[k], world.dt)
    return Surroundings(wind, force, torque, t - stretch.start_s, powered, memory.flags[STANDING] == 1)


@compiled
def remember_thrust(plant: Plant, x, thrust) -> None:
    """The play of each rotor's thrust about its curve (``thrust_memory``)."""
    effects, hover = plant.effects, plant.rotors.hover_thrust
    for i in range(len(thrust)):
        ideal = power_law(effects.thrust_curve, thrust_of(plant.rotors, x[ROTOR + i]), hover)
        thrust[i] = play(effects.thrust_memory, thrust[i], ideal, hover)


class Start(NamedTuple):
    """The rigid body where a step begins, from which samples within the step are taken.

    Attributes:
        t: time (s).
        position: in the world (m).
        velocity: in the world (m/s).
        q: attitude, body to world, w x y z.
        w: body rates (rad/s).
        first: derivative of the state at the beginning.
        last: derivative at the end.
    """

    t: float
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    q: tuple[float, float, float, float]
    w: tuple[float, float, float]
    first: np.ndarray
    last: np.ndarray


@compiled
def sample_imu(world: World, low_pass, estimate, at: Start, s, noise, row) -> None:
    """IMU sample ``s`` after the step's start, into ``row`` and into the flight software's estimate."""
    first, last, share = at.first, at.last, s / world.dt
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
    w = add(at.w, scale(s, (first[10], first[11], first[12])))
    q = multiply(at.q, exponential(scale(s, at.w)))
    felt = specific_force(push, turn, w, q, world.instruments.lever, world.plant.gravity)
    measure_imu(world.instruments, low_pass, w, felt, noise, row)
    predict(world.observer, estimate, (row[0], row[1], row[2]), (row[3], row[4], row[5]))


@compiled
def sample_pose(world: World, last_pose, at: Start, s, frozen, noise, row) -> None:
    """Pose seen ``s`` after the step's start, into ``row``."""
    first = at.first
    seen = add(at.position, add(scale(s, at.velocity), scale(0.5 * s * s, (first[3], first[4], first[5]))))
    middle = add(at.w, scale(0.5 * s, (first[10], first[11], first[12])))
    q = multiply(at.q, exponential(scale(s, middle)))
    measure_pose(world.instruments, last_pose, seen, q, frozen, noise, row)


@compiled
def send_pose(world: World, memory: Memory, stretch: Stretch, i: int, row) -> None:
    """Pose ``i`` of the stretch, unless it is lost, goes on its way to the flight software."""
    if stretch.pose_arrival_s[i] < np.inf:
        tail = memory.flags[PENDING_TAIL]
        memory.pending[tail, 0] = stretch.pose_s[i]
        memory.pending[tail, 1] = stretch.pose_arrival_s[i]
        body_pose(world.instruments, row, memory.pending[tail, 2:])
        memory.flags[PENDING_TAIL] = (tail + 1) % PENDING


class Samples(NamedTuple):
    """What a stretch leaves: see :func:`run`; ``taken`` counts the samples of IMU, poses, speeds and battery."""

    imu: np.ndarray
    poses: np.ndarray
    speeds: np.ndarray
    volts: np.ndarray
    taken: np.ndarray


@compiled
def sample(world: World, memory: Memory, stretch: Stretch, at: Start, out: Samples) -> None:
    """Every sample whose time lies in the step that has just been integrated."""
    taken, x, end = out.taken, memory.x, at.t + world.dt - 1e-9
    while taken[0] < len(stretch.imu_s) and stretch.imu_s[taken[0]] < end:
        s = max(stretch.imu_s[taken[0]] - at.t, 0.0)
        noise, row = stretch.imu_noise[taken[0]], out.imu[taken[0]]
        sample_imu(world, memory.low_pass, memory.estimate, at, s, noise, row)
        taken[0] += 1
    while taken[1] < len(stretch.pose_s) and stretch.pose_s[taken[1]] < end:
        i = taken[1]
        s = max(stretch.pose_s[i] - at.t, 0.0)
        sample_pose(world, memory.last_pose, at, s, stretch.pose_frozen[i], stretch.pose_noise[i], out.poses[i])
        send_pose(world, memory, stretch, i, out.poses[i])
        taken[1] += 1
    while taken[2] < len(stretch.speed_s) and stretch.speed_s[taken[2]] < end:
        s = max(stretch.speed_s[taken[2]] - at.t, 0.0)
        for i in range(out.speeds.shape[1]):
            out.speeds[taken[2], i] = x[ROTOR + i] - (world.dt - s) * at.first[ROTOR + i]
        taken[2] += 1
    while taken[3] < len(stretch.battery_s) and stretch.battery_s[taken[3]] < end:
        out.volts[taken[3], 0], out.volts[taken[3], 1] = memory.battery[1], memory.battery[2]
        taken[3] += 1


@compiled
def run(world: World, memory: Memory, stretch: Stretch):
    """Advance the world by one stretch.

    Returns:
        imu (k, 6), poses (k, 7), rotor values (k, n), battery voltage and current (k, 2) at the sample times; and per
        control tick the motor values asked for (ticks, n) and the estimate (ticks, 13); and per step the true state
        (steps, 13).
    """
    dt, plant, x, flags = world.dt, world.plant, memory.x, memory.flags
    n, ticks = len(plant.rotors.spin), len(stretch.setpoints)
    out = Samples(
        np.empty((len(stretch.imu_s), 6)),
        np.empty((len(stretch.pose_s), 7)),
        np.empty((len(stretch.speed_s), n)),
        np.empty((len(stretch.battery_s), 2)),
        np.zeros(4, np.int64),
    )
    commands, estimates, path = np.empty((ticks, n)), np.empty((ticks, 13)), np.empty((stretch.steps, 13))
    asked, tick = np.empty(n), 0
    pose_age = min(round(world.instruments.latency / dt), HISTORY - 1)
    for k in range(stretch.steps):
        step = stretch.first + k
        t = step * dt
        powered = stretch.mode != IDLE and flags[CRASHED] == 0
        remember(memory, step)
        deliver_poses(world.observer, memory.estimate, memory.pending, flags, memory.history, step, pose_age, t)
        if step % world.control_every == 0:
            control_tick(world, memory, stretch, step, tick, powered)
            copy(memory.target, commands[tick])
            copy(memory.estimate, estimates[tick])
            tick += 1
        ask_rotors(world, memory, step, powered, asked)
        now = surroundings(world, memory, stretch, k, t, powered)
        if plant.effects.thrust_memory.on:
            remember_thrust(plant, x, memory.thrust)
        copy(x, path[k])
        position, velocity = (x[0], x[1], x[2]), (x[3], x[4], x[5])
        q, w = (x[6], x[7], x[8], x[9]), (x[10], x[11], x[12])
        rk4_step(x, memory.work, asked, memory.thrust, plant, now, dt)
        sample(world, memory, stretch, Start(t, position, velocity, q, w, memory.work[0], memory.work[3]), out)
        touch_floor(x, flags, world.ground_m, step)
    return out.imu, out.poses, out.speeds, out.volts, commands, estimates, path
