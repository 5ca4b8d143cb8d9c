"""One truth in any wiring, scale and history at once: several settings that change in flight, outputs of any protocol,
ESCs in any place, any frame of any number of rotors, and bundles in any form.
"""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundstation.recording import read_recording, write_bundle
from groundstation.recording.airframes import ARDUPILOT
from groundstation.recording.px4_motors import thrust_curve
from groundstation.vehicle import vehicle_from_dict, vehicle_to_dict
from tests.recording_flight import flight
from tests.test_recording_settings import QUAD, STEP, like, motors
from tests.written_logs import ArduLog, Px4Log, truth

RPM = 30.0 / np.pi
SPUN = 9000.0 / RPM
IN_FLIGHT_S, LANDED_S = (5.6, 8.4), (8.8, 8.95)


def moments(rng: random.Random, count: int, span: tuple[float, float]) -> list[float]:
    """Times between two samples, so that a change is of one side alone."""
    return [round(rng.uniform(*span), 2) + 0.005 for _ in range(count)]


def speeds(u: np.ndarray) -> np.ndarray:
    """What the written logs' ESCs report: late by four samples."""
    return SPUN * np.sqrt(np.maximum(u[np.maximum(np.arange(len(u)) - 4, 0)], 0.0))


def any_px4(rng: random.Random) -> tuple[Px4Log, str]:
    """A log with several changes, and what tells of its motors: thrusts, pulses, DShot or the ESCs."""
    kind = rng.choice(["thrust", "pulses", "dshot", "escs"])
    prefix, channels = rng.choice(["PWM_MAIN", "PWM_AUX"]), tuple(rng.sample(range(1, 9), 4))
    log = Px4Log(channels, prefix, instance=rng.randrange(3))
    log.decoys = tuple({0, 1, 2} - {log.instance})
    bounds = {"MIN": lambda: float(rng.randint(900, 1150)), "MAX": lambda: float(rng.randint(1850, 2100))}
    log.limits = {c: (bounds["MIN"](), bounds["MAX"]()) for c in channels}
    flown, landed = moments(rng, rng.randrange(4), IN_FLIGHT_S), moments(rng, rng.randrange(3), LANDED_S)
    if kind == "thrust":
        log.topic, log.parameters = "actuator_motors", {"THR_MDL_FAC": round(rng.uniform(0.0, 1.0), 2)}
        log.changes = tuple((t, "THR_MDL_FAC", round(rng.uniform(0.05, 1.0), 2)) for t in flown + landed)
        return log, kind
    names = [f"{prefix}_{rng.choice(('MIN', 'MAX'))}{rng.choice(channels)}" for _ in flown]
    log.changes = tuple((t, name, bounds[name[-4:-1]]()) for t, name in zip(flown, names, strict=True))
    waiting = [(f"{prefix}_FUNC{channels[0]}", 0.0), (f"{prefix}_TIM0", -3.0), ("MAV_TYPE", 13.0)]
    log.parameters = {f"{prefix}_TIM0": 400.0, "MAV_TYPE": 2.0}
    log.changes += tuple((t, *rng.choice(waiting)) for t in landed)
    if kind == "dshot":
        log.dshot, log.changes = True, ()
        log.parameters = {f"{prefix}_TIM0": -3.0, "DSHOT_MIN": rng.choice((0.03, 0.055, 0.1))}
    if kind == "escs":
        log.esc_places, log.esc_functions = tuple(rng.sample(range(8), 4)), rng.random() < 0.5
    return log, kind


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_any_history_protocol_and_escs_of_a_px4_log(tmp_path_factory, seed):
    log, kind = any_px4(random.Random(seed))
    vehicle = like(ARDUPILOT[1, 1], "rotor_speed") if kind == "escs" else QUAD
    read, u, _ = motors(tmp_path_factory.mktemp("px4"), log, vehicle=vehicle)
    expected, within = u, 1e-5
    if kind == "escs":
        expected, within = speeds(u), 0.51 / RPM
    if kind == "thrust":
        factor = np.full(len(read), log.parameters["THR_MDL_FAC"])
        for t, _, value in sorted(log.changes):
            factor[read.t_s > t] = value
        expected = thrust_curve(u, factor[:, None])
    assert np.abs(read.values - expected).max() < within, log


@settings(max_examples=20, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_any_history_frame_and_escs_of_an_ardupilot_log(tmp_path_factory, seed):
    rng = random.Random(seed)
    number = rng.choice([n for n in sorted(ARDUPILOT) if ARDUPILOT[n].count <= 8])
    frame, servos = ARDUPILOT[number], rng.random() < 0.3
    channels = tuple(rng.sample(range(1, 15), frame.count))
    log = ArduLog(channels, (rng.randint(950, 1150), rng.randint(1850, 2050)), number)
    low, high = map(float, log.limits)
    if servos:
        log.parameters = {"MOT_PWM_TYPE": 8.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0}
        log.parameters |= {f"SERVO{c}_{word}": x for c in channels for word, x in (("MIN", low), ("MAX", high))}
    else:
        values = {
            "MOT_PWM_MIN": lambda: float(rng.randint(950, 1150)),
            "MOT_PWM_MAX": lambda: float(rng.randint(1850, 2050)),
        }
        names = rng.choices(sorted(values), k=rng.randrange(4))
        log.changes = tuple(
            (t, name, values[name]()) for t, name in zip(moments(rng, len(names), IN_FLIGHT_S), names, strict=True)
        )
    late = [("MOT_PWM_TYPE", 9.0), ("FRAME_TYPE", 5.0), (f"SERVO{channels[0]}_FUNCTION", 0.0), ("RCMAP_THROTTLE", 7.0)]
    log.parameters = {"MOT_PWM_TYPE": 0.0, "RCMAP_THROTTLE": 3.0} | log.parameters
    log.changes += tuple((t, *rng.choice(late)) for t in moments(rng, rng.randrange(3), LANDED_S))
    escs = rng.random() < 0.4
    if escs:
        log.esc_instances = rng.choice([tuple(c - 1 for c in channels), tuple(range(frame.count))])
    vehicle = like(frame, "rotor_speed" if escs else "command")
    shuffled = rng.sample(range(frame.count), frame.count)
    document = vehicle_to_dict(vehicle)
    for key in ("position_m", "spin"):
        document["rotors"][key] = [document["rotors"][key][i] for i in shuffled]
    made = truth(frame.count, seed % 97)
    read, u, _ = motors(tmp_path_factory.mktemp("ap"), log, "a.bin", vehicle_from_dict(document), made)
    expected = speeds(u)[:, shuffled] if escs else u[:, shuffled]
    assert np.abs(read.values - expected).max() < (1e-2 if escs else STEP), log


@pytest.fixture(scope="module")
def made():
    whole = flight(1.0)
    return replace(whole, plan=None, truth=None, window_s=None, setpoint=None)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(seed=st.integers(0, 10**6))
def test_a_bundle_in_any_form_gives_the_same_streams(tmp_path_factory, made, seed):
    """Columns in any order with others between, commas, semicolons or tabs, decimal commas, quotes, line ends."""
    rng = random.Random(seed)
    folder = write_bundle(made, tmp_path_factory.mktemp("bundle") / "b")
    (folder / "flight.json").unlink(missing_ok=True)
    for path in folder.glob("*.csv"):
        rows = [line.split(",") for line in path.read_text().splitlines()]
        rows = [[*row, *(("spare", "note") if k == 0 else ("3.5", "hover"))] for k, row in enumerate(rows)]
        order = rng.sample(range(len(rows[0])), len(rows[0]))
        separator, end = rng.choice(",;\t"), rng.choice(["\n", "\r\n"])
        decimal = rng.choice(".,") if separator != "," else "."
        quote = rng.choice(["", '"'])
        lines = [
            separator.join(
                f"{quote}{row[i] if k == 0 else row[i].replace('.', decimal)}{quote}" if row[i] else "" for i in order
            )
            for k, row in enumerate(rows)
        ]
        path.write_bytes(rng.choice([b"", b"\xef\xbb\xbf"]) + (end.join(lines) + end).encode())
    streams = read_recording(folder).streams
    assert streams.keys() == made.streams().keys()
    for name, stream in made.streams().items():
        assert np.array_equal(streams[name].values, stream.values), name
        assert np.array_equal(streams[name].t_s, stream.t_s), name
