"""What is declared wrongly is found and named before any fit; what is right, on measured flights too, is let pass."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundstation.analysis.suspects import suspicion
from groundstation.cli import main
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification.declarations import check_declarations, go_on, lag_doubts
from groundstation.identification.declarations.scale import scale_checks
from groundstation.identification.declarations.signals import Flown, similarities, similarity
from groundstation.identification.results import Estimate
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.recording.bundle import write_bundle
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.declarations import WRONG, unplanned, verdict, with_state
from studies.flown import flight_data
from tests.flights import laboratory, rest_to_rest_plan
from tests.test_identification_logs import PX4_LOG, sih_vehicle

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="module")
def right() -> FlightData:
    """A laboratory flight, seed 1, as anyone records it: no plan, no setpoints, filtered telemetry at 100 Hz."""
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    return with_state(unplanned(flight_data(simulate(vehicle, rest_to_rest_plan(seed=1), laboratory(), 1))))


def test_many_orders_of_rotors_are_compared_by_products_as_by_their_torques() -> None:
    print("seed", 53)
    random = np.random.default_rng(53)
    thrust, columns = random.normal(0.3, 1.0, (400, 4)), random.normal(size=(6, 4, 2))
    measured = thrust @ columns[2] + random.normal(size=(400, 2))
    torques = [thrust @ each for each in columns]
    expected = [similarity(torque / np.std(torque, axis=0), measured) for torque in torques]
    assert similarities(thrust, columns, measured) == pytest.approx(expected, rel=1e-9)
    assert similarities(np.zeros((400, 4)), columns, measured) == [0.0] * 6


def test_a_right_flight_agrees_with_every_check(right: FlightData) -> None:
    checks = check_declarations(right)
    assert {check.name for check in checks} >= {"attitude", "world_frame", "rotor_order", "rotor_spin", "thrust"}
    assert {check.verdict for check in checks} == {"agrees"}


@pytest.mark.parametrize("name", WRONG)
def test_each_wrong_declaration_is_found(right: FlightData, name: str) -> None:
    said = verdict(WRONG[name](right, np.random.default_rng(8)))
    assert said, name


def test_rotors_that_are_recorded_as_standing_still_in_flight_are_contradicted() -> None:
    t_s = np.arange(0.0, 20.0, 0.01)
    force = np.tile([0.0, 0.0, 9.81], (len(t_s), 1))
    signals = Flown(t_s, np.ones(len(t_s), dtype=bool), 0.0 * force, force, np.zeros((len(t_s), 4)))
    (found,) = scale_checks(signals, load_vehicle(find_config("vehicles", "qball2")))
    assert found.verdict == "contradicted"
    assert found.says.startswith("The recorded rotor values make no thrust in flight")


def test_thrust_in_fast_flight_is_no_word_about_the_declared_mass() -> None:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    vehicle = vehicle.model_copy(
        update={"identification": vehicle.identification.model_copy(update={"anchor": "thrust"})}
    )
    t_s = np.arange(0.0, 20.0, 0.01)
    force = np.tile([0.0, 0.0, 9.81], (len(t_s), 1))
    thrust = np.full((len(t_s), 4), 0.25 * 9.81 * vehicle.mass_kg)

    def found(factor: float, speed_m_s: float | None) -> str:
        flown = Flown(t_s, np.ones(len(t_s), dtype=bool), 0.0 * force, force, factor * thrust, speed_m_s)
        return scale_checks(flown, vehicle)[0].verdict

    assert [found(0.8, speed) for speed in (None, 1.0, 6.0)] == ["doubtful", "doubtful", "cannot tell"]
    assert [found(0.5, speed) for speed in (1.0, 6.0)] == ["contradicted", "contradicted"]


def test_the_line_to_write_puts_the_rotors_right(right: FlightData) -> None:
    order = [2, 0, 3, 1]
    swapped = replace(right, motors=replace(right.motors, values=right.motors.values[:, order]))
    found = {check.name: check for check in check_declarations(swapped)}
    places = np.array(right.vehicle.rotors.position_m)[order]
    assert np.allclose(json.loads(found["rotor_order"].line.removeprefix("position_m = ")), places)
    spins = np.array(right.vehicle.rotors.spin)[order]
    if found["rotor_spin"].verdict == "contradicted":
        assert json.loads(found["rotor_spin"].line.removeprefix("spin = ")) == spins.tolist()
    mended = right.vehicle.rotors.model_copy(
        update={"position_m": tuple(map(tuple, places.tolist())), "spin": tuple(spins.tolist())}
    )
    again = check_declarations(replace(swapped, vehicle=right.vehicle.model_copy(update={"rotors": mended})))
    assert {check.verdict for check in again if check.name.startswith("rotor")} == {"agrees"}


def test_speeds_that_nobody_measured_lead_the_motion(right: FlightData) -> None:
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    commanded = vehicle.model_copy(update={"rotors": vehicle.rotors.model_copy(update={"speed_source": "command"})})
    flown = simulate(commanded, rest_to_rest_plan(seed=1), laboratory(motor_lag={"hover_s": 0.06}), 1)
    flight = replace(flight_data(flown), plan=None, setpoint=None, vehicle=vehicle)
    found = {check.name: check for check in check_declarations(flight)}
    assert found["speed_source"].verdict == "doubtful" and 'speed_source = "command"' in found["speed_source"].line
    assert {check.name: check.verdict for check in check_declarations(right)}["speed_source"] == "agrees"


def test_a_wrong_declaration_is_told_while_the_vehicle_still_hovers(right: FlightData, tmp_path: Path) -> None:
    wrong = replace(right, motors=replace(right.motors, values=right.motors.values[:, [2, 0, 3, 1]]))
    for flight, told in ((right, []), (wrong, ["rotor order declared wrongly"])):
        folder = tmp_path / ("wrong" if told else "right")
        write_bundle(flight, folder)
        found = suspicion(folder)
        assert found["seconds"] == 0.0
        assert [each["effect"] for each in found["suspects"]][: len(told)] == told, found


def test_a_refusal_says_how_to_go_on_and_an_accepted_one_does(right: FlightData) -> None:
    checks = check_declarations(WRONG["spins the other way"](right, np.random.default_rng(8)))
    with pytest.raises(Refused, match="--accept-declaration rotor_spin"):
        go_on(checks)
    assert any(check.verdict == "contradicted" for check in checks)
    go_on(checks, ["rotor_spin"])


def test_the_command_refuses_first_and_prints_what_to_write(
    right: FlightData, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_bundle(WRONG["mass 2.5 times too large"](right, np.random.default_rng(8)), tmp_path / "flight")
    status = main(["identify", str(folder), "--logs", str(tmp_path / "logs")])
    printed = capsys.readouterr()
    text = printed.out + printed.err
    assert status == 3
    assert "Is this the right vehicle?" in text
    assert "--accept-declaration thrust" in text
    assert not (tmp_path / "logs").exists()


def test_what_was_accepted_and_left_out_stays_so_in_the_command_that_looks_further(
    right: FlightData, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_bundle(WRONG["mass 2.5 times too large"](right, np.random.default_rng(8)), tmp_path / "a flight")
    left_out = ["--exclude", "12.0:12.5", "--exclude", "15.0:15.5"]
    words = [str(folder), "--accept-declaration", "thrust", *left_out]
    assert main(["identify", *words, "--logs", str(tmp_path / "logs")]) == 0
    told = capsys.readouterr().out.strip().splitlines()[-1]
    assert told.startswith("The intervals hold if the model lacks nothing")
    assert shlex.split(told.split("groundstation diagnose ")[1]) == words


def test_a_real_firmwares_log_under_another_vehicles_mass_is_asked_about() -> None:
    if not PX4_LOG.exists():
        pytest.skip(f"the PX4 log is not there: {PX4_LOG}")
    other = sih_vehicle().model_copy(update={"mass_kg": 2.15})
    with pytest.raises(Refused, match=r"Is this the right vehicle\?"):
        go_on(check_declarations(load_flight(PX4_LOG, vehicle=other)))


@pytest.mark.parametrize(("lag_s", "asked"), [(0.05, False), (0.054, False), (0.07, True)])
def test_a_declared_lag_15_percent_off_is_asked_about(lag_s: float, asked: bool) -> None:
    vehicle = sih_vehicle()
    rotors = vehicle.rotors.model_copy(update={"lag": vehicle.rotors.lag.model_copy(update={"up_s": 0.05})})
    said = lag_doubts({"rotor_lag_up_s": Estimate.normal(lag_s, 0.002)}, vehicle.model_copy(update={"rotors": rotors}))
    assert bool(said) == asked
    assert all("Is this the right vehicle?" in text for text in said)


MEASURED = [
    *(
        (f"nanodrone/{name}", None)
        for name in ("multisine_20251017_run1", "random1_20251017_run2", "square_20251017_run3")
    ),
    *(
        (f"crazypad/{name}", "crazyflie21")
        for name in (
            "normal_flight/E9_log00",
            "normal_flight/E9_log02",
            "add_weight_W1_near_M3/E9_log04",
            "cut_propeller_M3_4mm_4mm_39mm/E8_log01",
        )
    ),
    ("crazyflie-1khz/log10", "crazyflie21"),
    ("crazyflie-1khz/log15", "crazyflie21"),
    ("crazyflie-1khz/log16", "crazyflie21"),
]


@pytest.mark.parametrize(("name", "vehicle"), MEASURED)
def test_no_measured_flight_is_told_that_its_right_declaration_is_wrong(name: str, vehicle: str | None) -> None:
    path = DATA / name
    if not path.exists():
        pytest.skip(f"the measured flights are not there: {path}")
    declared = None if vehicle is None else load_vehicle(find_config("vehicles", vehicle))
    checks = check_declarations(load_flight(path, vehicle=declared))
    assert checks
    assert not [check.sentence() for check in checks if check.verdict in ("contradicted", "doubtful")]
