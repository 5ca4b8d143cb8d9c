"""Long flights: analysed in parts, which changes no number and leaves memory to grow by what is kept of a sample."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from groundstation.diagnosis.base import base_fit, for_evidence
from groundstation.diagnosis.case import case_of
from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import library
from groundstation.diagnosis.flight_evidence import FlightEvidence
from groundstation.diagnosis.pool import candidates
from groundstation.diagnosis.whitening import Whitening
from groundstation.flightdata import FlightData
from groundstation.identification import estimators, instruments, parts, record_model
from groundstation.identification.declarations.signals import LONGEST_S, liveliest
from groundstation.identification.parts import at_times, by_parts, running_integrals, running_sums
from groundstation.identification.pipeline import identify
from groundstation.identification.prediction_error import SETTLED
from groundstation.identification.results import Identification
from groundstation.identification.work import Work
from groundstation.options import DEFAULT_OPTIONS
from studies.study import draw

SEED = 2001
SWINGING = {"length_m": 1.0, "air_1_s": 0.2, "depth_m": 0.05}
RATE_HZ = 250.0
PLAN_S = 40.0
KEPT = 330.0
"""Numbers of eight bytes that may be held for each sample of the IMU at 250 Hz, with those of the motors' millisecond
grid and of the fit's rate.
"""


def flown(length_s: float) -> FlightData:
    """The study's flight, as long as that."""
    return draw(SEED, length_s / PLAN_S, RATE_HZ)[0]


@pytest.fixture
def small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parts so small that a short flight is many of them."""
    monkeypatch.setattr(parts, "PART", 2048)
    monkeypatch.setattr(record_model, "PART", 700)
    monkeypatch.setattr(instruments, "PART", 2048)
    monkeypatch.setattr(estimators, "STRETCH", 4096)


def identified(flight: FlightData) -> tuple[Identification, float]:
    """And the most memory that it took beside the flight, in bytes."""
    tracemalloc.start()
    try:
        found = identify([flight])
        return found, float(tracemalloc.get_traced_memory()[1])
    finally:
        tracemalloc.stop()


def test_a_flight_in_parts_is_identified_as_the_whole_is(monkeypatch: pytest.MonkeyPatch) -> None:
    print("study seed", SEED)
    flight = flown(20.0)
    whole = identify([flight])
    for module, name, size in ((parts, "PART", 1500), (record_model, "PART", 500), (instruments, "PART", 1500)):
        monkeypatch.setattr(module, name, size)
    divided = identify([flight])
    for method in ("FE", "IV", "OE", "LS", "GD", "FMLS", "FMGD"):
        for name, estimate in whole.methods[method].parameters.items():
            other = divided.methods[method].parameters[name]
            assert abs(other.value - estimate.value) < SETTLED * estimate.std, (method, name)  # a fit ends there
            assert other.std == pytest.approx(estimate.std, rel=0.02), (method, name)


def test_columns_of_every_effect_in_parts_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    print("study seed", SEED)
    work = Work()
    case = case_of([flown(20.0)], DEFAULT_OPTIONS, work)
    base, case = base_fit(case, work), case.map(for_evidence)
    found: list[dict[str, np.ndarray]] = []
    for size in (record_model.PART, 300):
        monkeypatch.setattr(record_model, "PART", size)
        flight = FlightEvidence(case.suspects[0], base.fitted, base.options)
        pool = candidates(case.vehicle, flight.excited)
        found.append({f"{number} {each.identifier}": flight.moved_by(each) for number, each in enumerate(pool)})
    whole, divided = found
    assert len(whole) > 10 and whole.keys() == divided.keys()
    for name, moved in whole.items():
        assert np.max(np.abs(divided[name] - moved)) <= 1e-9 * np.max(np.abs(moved)), name


def test_evidence_in_parts_in_single_precision_is_that_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    print("study seed", SEED)
    work = Work()
    case = case_of([flown(20.0)], DEFAULT_OPTIONS, work)
    base, case = base_fit(case, work), case.map(for_evidence)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    whitening: Whitening | None = None
    for size, long in ((record_model.PART, parts.LONG), (300, 1000)):
        monkeypatch.setattr(record_model, "PART", size)
        monkeypatch.setattr(parts, "LONG", long)
        flight = FlightEvidence(case.suspects[0], base.fitted, base.options)
        # the search for a noise stops short of its minimum: columns are compared by the same one
        whitening = flight.whitening = whitening or flight.whitening
        batch = flight.batch([*candidates(case.vehicle, flight.excited), Candidate(library()["slung_load"], SWINGING)])
        found.append((batch.white, batch.wrench_rms))
        assert (flight.signals.thrust_n.dtype == np.float32) == (long == 1000)
    for whole, divided in zip(*found, strict=True):
        assert np.max(np.abs(divided - whole), axis=0) == pytest.approx(0.0, abs=1e-3 * float(np.abs(whole).max()))
        assert np.all(np.sum((divided - whole) ** 2, axis=0) <= 1e-6 * np.sum(whole**2, axis=0))


@pytest.mark.usefixtures("small_parts")
def test_memory_grows_by_no_more_than_what_is_kept_of_each_sample() -> None:
    print("study seed", SEED)
    lengths_s = (12.0, 36.0)
    identify([flown(lengths_s[0])])  # what is imported and compiled belongs to no flight
    most = [identified(flown(length_s))[1] for length_s in lengths_s]
    samples = RATE_HZ * (lengths_s[1] - lengths_s[0])
    print("numbers a sample:", (most[1] - most[0]) / 8.0 / samples)
    assert most[1] - most[0] < 8.0 * KEPT * samples


@pytest.mark.usefixtures("small_parts")
def test_sums_and_integrals_in_parts_are_those_of_the_whole_to_the_last_bit() -> None:
    print("seed", 3)
    random = np.random.default_rng(3)
    count = 9000
    values, dt = random.standard_normal((count, 3)), random.uniform(1e-3, 3e-3, count)
    stamps = np.cumsum(dt)
    at = np.sort(random.uniform(stamps[0] - 0.1, stamps[-1] + 0.1, 700))

    def made(part: slice) -> np.ndarray:
        return values[part] * 2.0

    plain = np.cumsum(2.0 * values, axis=0)
    assert np.array_equal(by_parts(made, count), 2.0 * values)
    found = at_times(running_sums(made, count), stamps, at)
    assert np.array_equal(found, np.stack([np.interp(at, stamps, column) for column in plain.T], axis=1))
    mean = 0.5 * (2.0 * values[1:] + 2.0 * values[:-1]) * dt[1:, None]
    speed = np.concatenate([np.zeros((1, 3)), np.cumsum(mean, axis=0)])
    for samples, speeds, paths in running_integrals(made, dt):
        assert np.array_equal(speeds, speed[samples])
        assert len(paths) == len(speeds)


def test_checks_of_a_long_flight_look_at_its_liveliest_minutes() -> None:
    print("study seed", SEED)
    flight = flown(20.0)
    assert liveliest(flight) is flight
    assert flight.imu is not None and flight.mocap is not None
    long = flown(340.0)
    cut = liveliest(long)
    assert cut.imu is not None and cut.mocap is not None and cut.window_s is not None
    for stream in (cut.imu, cut.mocap, cut.motors):
        assert np.ptp(stream.t_s) == pytest.approx(LONGEST_S, abs=0.1)
    assert cut.window_s[1] - cut.window_s[0] <= LONGEST_S
