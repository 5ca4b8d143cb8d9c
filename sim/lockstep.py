"""The compiled loop for eight flights in lockstep: that of :mod:`sim.loop` by the same formulas, a flight in each lane.

What happens at the same step in all lanes (plant, air, battery, control) is done at once. What each flight does at a
time of its own (samples, poses that arrive, landing) is done for all lanes on a scratch copy and kept where it is due.
"""

# pyright: reportCallIssue=false
# Numba's intrinsics take an argument less than they are written with.

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sim.algebra import copy
from sim.autopilot import correct
from sim.background import drift_step
from sim.compiled import compiled
from sim.effects.airframe import gust_step
from sim.lanes import any_of, nearest, negate, select
from sim.loop import (
    CRASHED,
    HISTORY,
    PENDING,
    PENDING_HEAD,
    PENDING_TAIL,
    STANDING,
    Memory,
    Start,
    World,
    ask_rotors,
    fly_law,
    remember,
    remember_thrust,
    sample_imu,
    sample_pose,
    touch_floor,
)
from sim.measure import body_pose
from sim.plant import ROTOR, Surroundings, rk4_step
from sim.rows import Rows, pick, place


class Inputs(NamedTuple):
    """Inputs of one stretch; rows end with one more than there are, whose time is infinite.

    Attributes:
        first: number of its first step.
        steps: how many.
        flying: 1 under the vehicle's own law, 0 with the rotors off; lanes.
        start_s: time of take-off (infinite before); lanes.
        setpoints: shape (ticks, 11).
        imu_s: true sample times, shape (k, 1).
        imu_noise: noise with bias, shape (k, 6).
        poses: true exposure time, arrival at the flight software (infinite for a lost one), whether the tracker
            repeats the last pose, noise (6), shape (k, 9).
        speed_s: true times of rotor-speed telemetry, shape (k, 1).
        battery_s: true times of battery telemetry, shape (k, 1).
        drift_noise: standard normal, shape (steps, 6).
        gust_noise: standard normal, shape (steps, 3).
    """

    first: int
    steps: int
    flying: float
    start_s: float
    setpoints: Rows
    imu_s: Rows
    imu_noise: Rows
    poses: Rows
    speed_s: Rows
    battery_s: Rows
    drift_noise: Rows
    gust_noise: Rows


class Outputs(NamedTuple):
    """What a stretch leaves, its last row scratch; ``taken`` counts samples of IMU, poses, speeds and battery."""

    imu: Rows
    poses: Rows
    speeds: Rows
    volts: Rows
    commands: Rows
    estimates: Rows
    taken: Rows


class Scratch(NamedTuple):
    """Copies on which a flight's own event is worked out, and rows of samples."""

    control: Rows
    led: Rows
    estimate: Rows
    low_pass: Rows
    last_pose: Rows
    asked: Rows
    noise: Rows
    row: Rows
    pose: Rows


@compiled
def keep(due, new, state) -> None:
    """Take the new numbers where they are due."""
    for i in range(len(state)):
        state[i] = select(due, new[i], state[i])


@compiled
def gather(rows, number, first: int, out) -> None:
    """Each lane's own row, from a column on."""
    for i in range(len(out)):
        out[i] = pick(rows, number, first + i)


@compiled
def scatter(rows, number, values) -> None:
    """Each lane's values into a row of its own."""
    for i in range(len(rows[0])):
        place(rows, number, i, values[i])


@compiled
def deliver_poses(world: World, memory: Memory, scratch: Scratch, step: int, t: float) -> None:
    """Hand poses that have arrived to the estimators, compared with what each had estimated at its exposure."""
    flags = memory.flags
    age = min(nearest(world.instruments.latency / world.dt), HISTORY - 1)
    row = step % HISTORY - age
    row = select(age > step, 0.0, select(row < 0.0, row + HISTORY, row))
    while True:
        head = flags[PENDING_HEAD]
        due = negate((head == flags[PENDING_TAIL]) | (pick(memory.pending, head, 1) > t))
        if not any_of(due):
            return
        gather(memory.pending, head, 2, scratch.pose)
        gather(memory.history, row, 0, scratch.row)
        copy(memory.estimate, scratch.estimate)
        correct(world.observer, scratch.estimate, scratch.row, scratch.pose)
        keep(due, scratch.estimate, memory.estimate)
        flags[PENDING_HEAD] = select(due, select(head + 1.0 == PENDING, 0.0, head + 1.0), head)


@compiled
def control_tick(world: World, memory: Memory, inputs: Inputs, scratch: Scratch, step: int, tick: int, flying) -> None:
    """New motor values by the vehicles' own law, or none."""
    if any_of(flying):
        before = int((step - world.control_every) / world.outer_every + 1e-9)
        outer = int(step / world.outer_every + 1e-9) != before or step == 0
        inner_s, outer_s = world.control_every * world.dt, world.outer_every * world.dt
        standing, setpoint = memory.flags[STANDING] == 1, inputs.setpoints[tick]
        control, led = scratch.control, scratch.led
        copy(memory.control, control)
        copy(memory.led, led)
        fly_law(world.law, control, memory.estimate, led, memory.target, setpoint, outer, inner_s, outer_s, standing)
        keep(flying, control, memory.control)
        keep(flying, led, memory.led)
    for i in range(len(memory.target)):
        memory.target[i] = select(flying, memory.target[i], 0.0)


@compiled
def surroundings(world: World, memory: Memory, inputs: Inputs, k: int, t: float, flying) -> Surroundings:
    """Wind and disturbance of this step, each a process of its own."""
    force, torque = drift_step(world.disturbance, memory.drift, inputs.drift_noise[k], world.dt)
    wind = (0.0, 0.0, 0.0)
    if world.plant.effects.wind.on:
        wind = gust_step(world.plant.effects.wind, memory.gust, inputs.gust_noise[k], world.dt)
    return Surroundings(wind, force, torque, t - inputs.start_s, flying, memory.flags[STANDING] == 1)


@compiled
def sample_imus(world: World, memory: Memory, inputs: Inputs, scratch: Scratch, at: Start, out: Outputs) -> None:
    """IMU samples within the step."""
    end, last = at.t + world.dt - 1e-9, len(out.imu) - 1.0
    while True:
        number = out.taken[0]
        when = pick(inputs.imu_s, number, 0)
        due = when < end
        if not any_of(due):
            return
        gather(inputs.imu_noise, number, 0, scratch.noise)
        copy(memory.estimate, scratch.estimate)
        for i in range(6):
            scratch.low_pass[0, i], scratch.low_pass[1, i] = memory.low_pass[0, i], memory.low_pass[1, i]
        s = max(when - at.t, 0.0)
        sample_imu(world, scratch.low_pass, scratch.estimate, at, s, scratch.noise, scratch.row)
        keep(due, scratch.estimate, memory.estimate)
        keep(due, scratch.low_pass[0], memory.low_pass[0])
        keep(due, scratch.low_pass[1], memory.low_pass[1])
        scatter(out.imu, select(due, number, last), scratch.row)
        out.taken[0] = select(due, number + 1.0, number)


@compiled
def sample_poses(world: World, memory: Memory, inputs: Inputs, scratch: Scratch, at: Start, out: Outputs) -> None:
    """Poses seen within the step; those that are not lost go on their way to the flight software."""
    end, last, flags = at.t + world.dt - 1e-9, len(out.poses) - 1.0, memory.flags
    while True:
        number = out.taken[1]
        when = pick(inputs.poses, number, 0)
        due = when < end
        if not any_of(due):
            return
        gather(inputs.poses, number, 3, scratch.noise)
        frozen = pick(inputs.poses, number, 2) != 0.0
        copy(memory.last_pose, scratch.last_pose)
        s = max(when - at.t, 0.0)
        sample_pose(world, scratch.last_pose, at, s, frozen, scratch.noise, scratch.row)
        keep(due, scratch.last_pose, memory.last_pose)
        scatter(out.poses, select(due, number, last), scratch.row)
        out.taken[1] = select(due, number + 1.0, number)
        arrival, tail = pick(inputs.poses, number, 1), flags[PENDING_TAIL]
        sent = due & (arrival < np.inf)
        body_pose(world.instruments, scratch.row, scratch.pose)
        place(memory.pending, tail, 0, when)
        place(memory.pending, tail, 1, arrival)
        for i in range(7):
            place(memory.pending, tail, 2 + i, scratch.pose[i])
        flags[PENDING_TAIL] = select(sent, select(tail + 1.0 == PENDING, 0.0, tail + 1.0), tail)


@compiled
def sample_telemetry(world: World, memory: Memory, inputs: Inputs, at: Start, out: Outputs) -> None:
    """Rotor speeds and battery within the step."""
    end = at.t + world.dt - 1e-9
    while True:
        number = out.taken[2]
        when = pick(inputs.speed_s, number, 0)
        due = when < end
        if not any_of(due):
            break
        s, row = max(when - at.t, 0.0), select(due, number, len(out.speeds) - 1.0)
        for i in range(len(memory.target)):
            place(out.speeds, row, i, memory.x[ROTOR + i] - (world.dt - s) * at.first[ROTOR + i])
        out.taken[2] = select(due, number + 1.0, number)
    while True:
        number = out.taken[3]
        due = pick(inputs.battery_s, number, 0) < end
        if not any_of(due):
            break
        row = select(due, number, len(out.volts) - 1.0)
        place(out.volts, row, 0, memory.battery[1])
        place(out.volts, row, 1, memory.battery[2])
        out.taken[3] = select(due, number + 1.0, number)


@compiled
def run_lanes(world: World, memory: Memory, inputs: Inputs, scratch: Scratch, out: Outputs) -> None:
    """Advance eight worlds by one stretch; what :func:`sim.loop.run` returns goes into ``out``."""
    dt, plant, x, tick = world.dt, world.plant, memory.x, 0
    for k in range(inputs.steps):
        step = inputs.first + k
        t = step * dt
        flying = (inputs.flying == 1.0) & (memory.flags[CRASHED] == 0.0)
        remember(memory, step)
        deliver_poses(world, memory, scratch, step, t)
        if step % world.control_every == 0:
            control_tick(world, memory, inputs, scratch, step, tick, flying)
            copy(memory.target, out.commands[tick])
            copy(memory.estimate, out.estimates[tick])
            tick += 1
        ask_rotors(world, memory, step, flying, scratch.asked)
        now = surroundings(world, memory, inputs, k, t, flying)
        if plant.effects.thrust_memory.on:
            remember_thrust(plant, x, memory.thrust)
        position, velocity = (x[0], x[1], x[2]), (x[3], x[4], x[5])
        q, w = (x[6], x[7], x[8], x[9]), (x[10], x[11], x[12])
        rk4_step(x, memory.work, scratch.asked, memory.thrust, plant, now, dt)
        at = Start(t, position, velocity, q, w, memory.work[0], memory.work[3])
        sample_imus(world, memory, inputs, scratch, at, out)
        sample_poses(world, memory, inputs, scratch, at, out)
        sample_telemetry(world, memory, inputs, at, out)
        touch_floor(x, memory.flags, world.ground_m, step)
