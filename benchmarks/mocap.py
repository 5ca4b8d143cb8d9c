"""Motion-capture drivers on one flight, clocks of many flights, and calibrations of many hands.

``python -m benchmarks.mocap --part drivers|clocks|hand [--seeds N] [--json FILE]``; kept in docs/results/mocap.json,
tables in docs/mocap.md.

*drivers*: a simulated flight's poses are served by each emulated server in real time, with a clock that is off and
drifts, read by the driver's own process, and identified with them. *clocks*: flights of the study; online (server
stamps, TIMESYNC) and afterwards (rates). *hand*: random mountings.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.mavlink.timesync import Timesync
from drivers.mocap.health import reported_clock
from drivers.mocap.serverclock import ServerClock
from drivers.mocap.source import FrameReader
from drivers.samples import Pose
from groundstation.errors import GroundStationError
from groundstation.flightdata import MOCAP_COLUMNS, FlightData, Stream
from groundstation.frames import quat_conjugate, quat_exp, quat_log, quat_multiply
from groundstation.identification.anchoring import anchored
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.handheld import calibrate_by_hand
from groundstation.identification.preparation import prepare
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.mocap.hand import Mounting, Sensors, carry
from sim.mocap.scene import Replay
from sim.mocap.server import Server, Setup
from sim.scenario import scenario_from_dict
from studies.flown import flight_data
from studies.study import draw

Array = NDArray[np.float64]
Row = dict[str, object]

RATE_HZ = 120.0
DRIFT = 2e-5
PARAMETERS = ("mass_kg", "ixx_kg_m2", "iyy_kg_m2", "izz_kg_m2")
KEPT = Path("docs/results/mocap.json")
SCENARIO = {
    "name": "one clock",
    "imu": {
        "rate_hz": 250.0,
        "gyro_density": 1e-4,
        "accel_density": 1.5e-3,
        "gyro_bias_std": 2e-3,
        "accel_bias_std": 2e-2,
    },
    "mocap": {"rate_hz": RATE_HZ, "position_std_m": 1.5e-4, "attitude_std_rad": 1e-3, "clock": {}},
    "motors": {"rate_hz": 250.0, "noise_share": 0.002, "clock": {}},
    "disturbance": {"force_share": 0.003, "torque_share": 0.002, "correlation_s": 0.5},
    "truth": {"mass_factor": 1.03, "inertia_factor": [1.2, 0.9, 0.95], "lag": {"up_s": 0.04, "down_s": 0.05}},
}
"""All streams on the true clock, so that whatever a driver adds is seen."""


# One flight over each driver
# -------------------------------------------------------------------------------------------


def flown(seed: int) -> FlightData:
    """The flight whose poses are served."""
    vehicle, plan = load_vehicle(find_config("vehicles", "qball2")), load_plan(find_config("plans", "paper_table2"))
    plan = plan.model_copy(update={"periods": 0.5 * plan.periods})
    return flight_data(simulate(vehicle, plan, scenario_from_dict(SCENARIO), seed), f"served {seed}")


def served(flight: FlightData, system: str) -> tuple[Array, Array, Array, str]:
    """True exposure times, stamps and arrivals (k,), all seconds of the flight's clock, of what came; and the driver's
    last words.
    """
    assert flight.mocap is not None
    t, rows = flight.mocap.t_s, flight.mocap.values
    poses = [((r[0], r[1], r[2]), (r[3], r[4], r[5], r[6])) for r in rows.tolist()]
    rate_hz, began_s = RATE_HZ / (1.0 + DRIFT), time.monotonic() + 3.0 - float(t[0])
    first = 1_000_000  # of the frame that shows the first pose: frames are exposed where the recording's were
    offset_s = first / rate_hz - (1.0 + DRIFT) * (began_s + float(t[0]))
    setup = Setup(system, rate_hz=rate_hz, drift=DRIFT, offset_s=offset_s, names=("drone",))
    with Server(setup, Replay(t.tolist(), poses), began_s) as server:
        body = "1" if system == "mavlink" else "drone"
        command = [
            sys.executable,
            "-P",
            "-m",
            "drivers.mocap.source",
            "--system",
            system,
            "--host",
            server.host,
            "--body",
            body,
        ]
        source = subprocess.Popen(command, stdout=subprocess.PIPE)
        try:
            got, told = _received(source, began_s + float(t[-1]) + 1.0)
        finally:
            source.kill()
            source.wait()
    stamps, arrivals = np.array([(p.device_s - began_s, r - began_s) for p, r in got]).T
    near = np.clip(np.searchsorted(t, stamps)[:, None] + np.arange(-3, 4), 0, len(t) - 1)
    seen = np.array([p.position_m for p, _ in got])
    apart = np.linalg.norm(rows[near, :3] - seen[:, None, :], axis=2)  # each pose is known by its place
    index, same = near[np.arange(len(near)), np.argmin(apart, axis=1)], np.min(apart, axis=1) < 2e-6
    return t[index][same], stamps[same], arrivals[same], told


def _received(source: subprocess.Popen[bytes], until_s: float) -> tuple[list[tuple[Pose, float]], str]:
    assert source.stdout is not None
    reader, got, told = FrameReader(), [], ""
    while time.monotonic() < until_s:
        for sample, received_s in reader.feed(source.stdout.read1(1 << 16)):  # type: ignore[attr-defined]
            if isinstance(sample, Pose):
                got.append((sample, received_s))
            elif sample.kind == "clock":
                told = sample.text
        if got and time.monotonic() - got[-1][1] > 0.5:
            break
    return got, told


def driver_row(flight: FlightData, system: str) -> Row:
    """Figures of one driver, and what is identified with its poses."""
    assert flight.mocap is not None
    true, stamps, arrivals, told = served(flight, system)
    clock = reported_clock(told)
    error = stamps - true
    lookup = np.searchsorted(flight.mocap.t_s, true)
    stream = Stream(stamps, flight.mocap.values[lookup], MOCAP_COLUMNS, arrivals)
    order = np.argsort(stream.t_s)
    stream = Stream(stamps[order], stream.values[order], MOCAP_COLUMNS, arrivals[order])
    row: Row = {
        "driver": system,
        "poses": len(true),
        "share": len(true) / len(flight.mocap),
        "rate_hz": float(1.0 / np.median(np.diff(true))),
        "latency_p50_ms": float(1e3 * np.quantile(arrivals - true, 0.5)),
        "latency_p99_ms": float(1e3 * np.quantile(arrivals - true, 0.99)),
        "clock_error_ms": float(1e3 * np.median(error)),
        "clock_error_p95_ms": float(1e3 * np.quantile(np.abs(error), 0.95)),
        "told_ms": None if clock is None else 1e3 * clock.error_s,
        "method": "" if clock is None else clock.method,
        "drift_ppm": None if clock is None else 1e6 * clock.drift,
    }
    row["inside"] = bool(clock is not None and abs(np.median(error)) <= clock.error_s)
    return row | identified(replace(flight, mocap=stream), float(np.median(error)))


def identified(flight: FlightData, error_s: float) -> Row:
    """Parameters with standard deviations, and the clock afterwards against the stamps' true error."""
    prepared = prepare(flight)
    best = fit_dynamics([prepared]).best
    found, _ = anchored(prepared.record.vehicle, best.names, best.values, best.covariance)
    clock = prepared.clock
    assert clock is not None
    return {
        "parameters": {n: [found[n].value, found[n].std] for n in PARAMETERS},
        "after_ms": 1e3 * clock.mocap_minus_imu_s,
        "after_std_ms": 1e3 * clock.std_s,
        "after_inside": bool(abs(clock.mocap_minus_imu_s - error_s) <= 1.96 * clock.std_s + 5e-5),
    }


def drivers(seeds: int) -> Row:
    """The same flight over each driver, and with arrival times alone."""
    flight = flown(1)
    rows = [{"driver": "as recorded", **identified(flight, 0.0)}]
    for system in ("zenoh", "natnet", "qtm", "vicon", "vrpn", "mavlink", "ros2"):
        rows.append(driver_row(flight, system))
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    return {"rows": rows, "apart": apart(rows)}


def apart(rows: list[Row]) -> dict[str, float]:
    """Of each parameter, the largest difference from the recorded flight's value, in the half width of its 95 %
    interval.
    """
    out = {}
    for name in PARAMETERS:
        values = np.array([row["parameters"][name] for row in rows])  # type: ignore[index]
        out[name] = float(np.max(np.abs(values[1:, 0] - values[0, 0]) / (1.96 * values[0, 1])))
    return out


# Clocks of many flights
# ------------------------------------------------------------------------------------------------


def clock_row(seed: int) -> Row:
    """Both clocks of one flight of the study: errors and standard deviations in ms."""
    flight, _, offset_s = draw(seed, 0.5, 250.0)
    assert flight.mocap is not None and flight.imu is not None
    prepared = prepare(flight)
    assert prepared.clock is not None
    online_s, bar_s = online(flight, offset_s, np.random.default_rng([9, seed]))
    after_s, std_s = prepared.clock.mocap_minus_imu_s, prepared.clock.std_s
    return {
        "seed": seed,
        "online_ms": 1e3 * (online_s - offset_s), "online_bar_ms": 1e3 * bar_s,
        "after_ms": 1e3 * (after_s - offset_s), "after_std_ms": 1e3 * std_s,
        "agree": bool(abs(online_s - after_s) <= bar_s + 1.96 * std_s),
    }  # fmt: skip


def online(flight: FlightData, offset_s: float, rng: np.random.Generator) -> tuple[float, float]:
    """Mocap stamp minus IMU stamp as the link knows it: NatNet's stamps and echoes, and TIMESYNC over a telemetry link.

    The host's clock is the true one plus a constant; transits are 0.15 ms plus an exponential of 0.5 ms on the network,
    0.4 ms plus one of 1 ms on the link, each way. The cameras' own clock drifts by up to 50 ppm, the vehicle's by as
    much.
    """
    assert flight.mocap is not None
    host0, server, sync = 4000.0, ServerClock(), Timesync()
    camera, vehicle = rng.uniform(-5e-5, 5e-5, 2)
    true = flight.mocap.t_s - offset_s
    for index, t in enumerate(true):
        sent = t + 0.004 + abs(rng.normal(0.0, 3e-4))
        server.arrival((1.0 + camera) * sent + 77.0, host0 + sent + 1.5e-4 + rng.exponential(5e-4))
        if index % 24 == 0:
            out, back = 1.5e-4 + rng.exponential(5e-4, 2)
            server.exchange(host0 + t - out, (1.0 + camera) * t + 77.0, host0 + t + back)
        if index % 12 == 0:
            out, back = 4e-4 + rng.exponential(1e-3, 2)
            sync.add(host0 + t - out, (1.0 + vehicle) * t, host0 + t + back)
    middle = 0.5 * float(true[0] + true[-1])
    now, fit = server.now, sync.fit()
    assert now is not None and fit is not None
    exposed = now.host_s((1.0 + camera) * middle + 77.0)  # where the link puts an exposure at the middle of the flight
    seen_by_imu = fit.host((1.0 + vehicle) * middle)
    # the flight's own streams have the drawn offset between them: what the link would add to it is the difference of
    # both maps
    return offset_s + (exposed - seen_by_imu), now.error_s + fit.error_s(host0 + middle)


def clocks(seeds: int) -> Row:
    """Errors of both clocks over many flights, and whether they agree."""
    rows = []
    for seed in range(seeds):
        try:
            rows.append(clock_row(seed))
        except GroundStationError as error:
            print(f"seed {seed}: {error}", file=sys.stderr)
    table = {key: np.array([float(row[key]) for row in rows]) for key in rows[0]}  # type: ignore[arg-type]
    both = np.maximum(np.abs(table["online_ms"]), np.abs(table["after_ms"]))
    return {
        "flights": len(rows),
        "online_within_half_ms": float(np.mean(np.abs(table["online_ms"]) < 0.5)),
        "online_p95_ms": float(np.quantile(np.abs(table["online_ms"]), 0.95)),
        "online_inside_bar": float(np.mean(np.abs(table["online_ms"]) <= table["online_bar_ms"])),
        "after_within_half_ms": float(np.mean(np.abs(table["after_ms"]) < 0.5)),
        "after_p95_ms": float(np.quantile(np.abs(table["after_ms"]), 0.95)),
        "after_inside_95": float(np.mean(np.abs(table["after_ms"]) <= 1.96 * table["after_std_ms"])),
        "both_within_half_ms": float(np.mean(both < 0.5)),
        "agree": float(np.mean(table["agree"])),
    }


# Calibrations of many hands
# --------------------------------------------------------------------------------------------


def hand_row(seed: int) -> Array:
    """Errors over standard deviations: offset, rotation, tilt, scale, clock, (10,); and the standard deviations' sizes,
    (4,).
    """
    rng = np.random.default_rng([7, seed])
    truth = Mounting(
        tuple(0.05 * rng.standard_normal(3)), tuple(0.8 * rng.standard_normal(3)), tuple(0.01 * rng.standard_normal(2)),
        0.01 * rng.standard_normal(), 10.0 * rng.standard_normal(), 2e-5 * rng.standard_normal(),
    )  # fmt: skip
    carried = carry(seed, truth, Sensors(imu_hz=float(rng.choice([100.0, 200.0]))))
    t, gyro, accel = carried.imu
    found = calibrate_by_hand((t, gyro, (1.0 + 0.005 * rng.standard_normal(3)) * accel), carried.poses)
    turn = quat_log(quat_multiply(quat_conjugate(quat_exp(np.array(truth.rotation_rad))), quat_exp(found.rotation_rad)))
    middle = 0.5 * (t[0] + t[-1])
    return np.concatenate([
        (found.position_m - truth.position_m) / found.position_std_m, turn / found.rotation_std_rad,
        (found.tilt_rad - truth.tilt_rad) / found.tilt_std_rad, [(found.scale - truth.scale) / found.scale_std],
        [(found.mocap_minus_imu_s - truth.clock_s - truth.drift * middle) / found.clock_std_s],
        [1e3 * np.mean(found.position_std_m), np.degrees(np.mean(found.rotation_std_rad))],
        [np.degrees(np.mean(found.tilt_std_rad)), 1e3 * found.clock_std_s],
    ])  # fmt: skip


def hand(seeds: int) -> Row:
    """Coverage of the calibration's intervals."""
    rows = np.array([hand_row(seed) for seed in range(seeds)])
    z, sizes = rows[:, :10], np.median(rows[:, 10:], axis=0)
    groups = {
        "offset": slice(0, 3),
        "rotation": slice(3, 6),
        "tilt": slice(6, 8),
        "scale": slice(8, 9),
        "clock": slice(9, 10),
    }
    return {
        "carryings": seeds,
        "inside_95": {name: float(np.mean(np.abs(z[:, part]) < 1.96)) for name, part in groups.items()},
        "rms_over_std": {name: float(np.sqrt(np.mean(z[:, part] ** 2))) for name, part in groups.items()},
        "std": dict(zip(("offset_mm", "rotation_deg", "tilt_deg", "clock_ms"), map(float, sizes), strict=True)),
    }


def table(kept: Mapping[str, Row]) -> str:
    """The drivers' rows as Markdown."""
    head = (
        "driver",
        "rate, Hz",
        "latency p50, ms",
        "p99, ms",
        "clock error, ms",
        "reported, ms",
        "how known",
        "after, ms",
        "mass, kg",
    )
    lines = ["| " + " | ".join(head) + " |", "| --- " * len(head) + "|"]
    for row in kept["drivers"]["rows"]:  # type: ignore[union-attr]
        mass, std = row["parameters"]["mass_kg"]
        online = ["", "", "", "", "", ""]
        if "rate_hz" in row:
            numbers = (f"{row['rate_hz']:.0f}", f"{row['latency_p50_ms']:.1f}", f"{row['latency_p99_ms']:.1f}")
            online = [*numbers, f"{row['clock_error_ms']:+.2f}", f"{row['told_ms'] or 0:.2f}", row["method"]]
        after = f"{row['after_ms']:+.2f} ± {1.96 * row['after_std_ms']:.2f}"
        lines.append("| " + " | ".join([row["driver"], *online, after, f"{mass:.4f} ± {1.96 * std:.4f}"]) + " |")
    return "\n".join(lines)


PARTS: Mapping[str, Callable[[int], Row]] = {"drivers": drivers, "clocks": clocks, "hand": hand}


def main() -> int:
    """Run a part and keep it."""
    parser = argparse.ArgumentParser(prog="benchmarks.mocap", description=__doc__)
    parser.add_argument("--part", choices=(*PARTS, "table"), required=True)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--json", type=Path, default=KEPT)
    options = parser.parse_args()
    if options.part == "table":
        print(table(json.loads(options.json.read_text())))
        return 0
    found = PARTS[options.part](options.seeds)
    kept = json.loads(options.json.read_text()) if options.json.is_file() else {"schema": "groundstation.mocap/1"}
    options.json.write_text(json.dumps(kept | {options.part: found}, indent=1) + "\n")
    print(json.dumps(found, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
