"""The whole loop with the simulated drone as real processes, and what happens when one of them is killed."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import tomli_w

from drivers import bus
from drivers.access import new_secrets
from groundstation.flight.client.client import FlightOrder, outcome, start_core
from groundstation.flight.client.rehearse import simulated_drone
from groundstation.flight.core.vehicle_process import DRONE
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.paths import find_config
from groundstation.recording import load_flight
from groundstation.trajectory import load_plan, plan_from_dict, plan_to_dict
from tests.one_answer import disagreements

DEADLINE_S = 120.0  # the simulator compiles on its first start


@pytest.fixture
def plan_file(tmp_path) -> Path:
    """One period of the published trajectory, a tenth smaller so that it keeps its own limits."""
    document = plan_to_dict(load_plan(find_config("plans", "paper_table2")))
    for channel in document["coefficients"].values():
        channel["a"] = [0.9 * value for value in channel["a"]]
        channel["b"] = [0.9 * value for value in channel["b"]]
    document["periods"] = 1.0
    plan_from_dict(document)
    path = tmp_path / "short.toml"
    path.write_text(tomli_w.dumps(document))
    return path


def rehearse(plan_file: Path, *more: str) -> subprocess.Popen[str]:
    arguments = ["rehearse", "--scenario", "clean", "--plan", str(plan_file), "--logs", "logs", *more]
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "groundstation.cli", *arguments],
        cwd=plan_file.parent,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def until_line(process: subprocess.Popen[str], start: str) -> None:
    """Read the client's progress up to a line that starts so."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith(start):
            return
    raise AssertionError(f"no line starts with {start}; status {process.wait()}")


def the_flight(plan_file: Path) -> Path:
    (folder,) = (plan_file.parent / "logs").iterdir()
    return folder


def test_the_whole_loop_ends_with_a_report_and_the_truth_beside_the_estimates(plan_file):
    process = rehearse(plan_file, "--json")
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    document = json.loads(out)
    folder = Path(document["folder"])
    assert {path.name for path in folder.iterdir()} >= {
        *("flight.mcap", "report.html", "identification.json", "identification.toml", "flight.log.jsonl"),
    }
    flight = load_flight(folder / "flight.mcap")
    assert flight.truth is not None and flight.plan == load_plan(plan_file)
    assert flight.metadata["scenario"] == "clean"
    assert flight.window_s is not None
    assert flight.window_s[1] - flight.window_s[0] == pytest.approx(10.0, abs=0.01)
    best = document["identification"]["best"]
    mass = document["identification"]["methods"][best]["parameters"]["mass_kg"]
    assert mass["value"] == pytest.approx(document["truth"]["mass_kg"], rel=0.01)
    assert "exciting" in err and "s left" in err and "Hz: " in err
    kinds = [entry["kind"] for entry in read_journal(folder / JOURNAL)]
    assert kinds[-1] == "outcome" and "estimates" in kinds
    assert disagreements(folder, flight.vehicle) == [], "every place shows the same digits"


def test_a_killed_client_changes_nothing_for_the_flight(plan_file):
    process = rehearse(plan_file)
    until_line(process, "airborne")
    process.kill()
    process.wait()
    folder, end = the_flight(plan_file), time.monotonic() + DEADLINE_S
    while read_journal(folder / JOURNAL)[-1]["kind"] != "outcome":
        assert time.monotonic() < end, "the core did not finish"
        time.sleep(0.05)
    assert outcome(folder)[0] == 0
    assert (folder / "report.html").is_file()


def test_an_interrupt_lands_the_vehicle_and_says_so(plan_file):
    process = rehearse(plan_file, "--scenario", "seed", "--json")
    until_line(process, "airborne")
    os.kill(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 4, err
    assert "aborted" in json.loads(out)["error"]
    folder = the_flight(plan_file)
    flight = load_flight(folder / "flight.mcap")
    assert flight.setpoint is not None
    assert abs(flight.setpoint.values[-1, 2]) < 0.6
    phases = [entry["text"] for entry in read_journal(folder / JOURNAL) if entry["kind"] == "vehicle"]
    assert phases[-1] == "landed"


def test_an_interrupt_after_landing_ends_the_analysis_and_says_what_to_run(plan_file):
    process = rehearse(plan_file)
    until_line(process, "identifying")
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 4, err
    recording = the_flight(plan_file) / "flight.mcap"
    last = err.strip().splitlines()[-1]
    assert last.startswith("the analysis was given up: aborted by")
    assert last.endswith(f"The recording is kept; `groundstation report {recording}` analyses it.")
    assert load_flight(recording).window_s is not None
    assert not (recording.parent / "report.html").exists()


def _asked_until_answered(session, key, request):
    """That a drone which has connected anew can be asked at once is no promise, that it can be is."""
    end = time.monotonic() + 20.0
    while True:
        try:
            return bus.ask(session, key, request)
        except ConnectionError:
            assert time.monotonic() < end, "nobody answered"
            threading.Event().wait(0.2)


def test_a_killed_core_leaves_an_open_recording_and_the_drone_lands_itself(plan_file):
    folder = plan_file.parent / "logs" / "flight"
    vehicle, scenario = find_config("vehicles", "qball2"), find_config("scenarios", "clean")
    drone = simulated_drone(vehicle, scenario, 1)
    secrets = new_secrets()
    order = FlightOrder(folder, plan_file, vehicle, drone, analyse=False)
    core, access = start_core(order, start=True, secrets=secrets)
    end = time.monotonic() + DEADLINE_S
    while not ((log := folder / JOURNAL).is_file() and any("-> exciting" in e["text"] for e in read_journal(log))):
        assert time.monotonic() < end and core.poll() is None, (folder / "core.log").read_text()
        time.sleep(0.01)
    core.kill()
    core.wait()
    seen: queue.SimpleQueue[bus.DroneStatus] = queue.SimpleQueue()
    with (
        bus.open_session(listen=[access.endpoint], admit=(secrets, DRONE)) as session,
        bus.alive(session, bus.CORE_ALIVE),
    ):
        keys = bus.DroneKeys(DRONE)
        handle = bus.subscribe(session, keys.status, bus.decoder_of(bus.DroneStatus), seen.put)
        # The drone connects again by itself. A new core's token and credit let it tell how it is; it came down without,
        # or is about to, where it is connected again before it has heard of the old one's end.
        credit, granted = bus.Publisher(session, keys.credit), 0.0
        phases, end = [], time.monotonic() + 30.0
        while not phases or phases[-1] != "landed":
            assert time.monotonic() < end, phases
            credit.put(bus.Credit(granted))
            try:
                status = seen.get(timeout=0.2)
            except queue.Empty:
                granted += 5.0
                continue
            granted = max(granted, status.host_s + 1.0)
            if not phases or phases[-1] != status.phase:
                phases.append(status.phase)
        assert phases in (["exciting", "landing", "landed"], ["landing", "landed"], ["landed"])
        assert not status.armed and status.host_s < status.window_s[1]
        assert _asked_until_answered(session, keys.command, bus.Command("shutdown")).ok
        handle.close()
    flight = load_flight(folder / "flight.mcap")
    assert len(flight.motors) > 1000 and flight.plan is not None


def test_a_plan_the_vehicle_cannot_fly_is_refused_with_its_reason(plan_file):
    document = plan_to_dict(load_plan(plan_file))
    document["coefficients"]["x"]["a"] = [8.0 * value for value in document["coefficients"]["x"]["a"]]
    plan_file.write_text(tomli_w.dumps(document))
    process = rehearse(plan_file, "--json")
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 3, err
    assert "refused" in json.loads(out)["reason"]
