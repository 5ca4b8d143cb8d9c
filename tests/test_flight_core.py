"""The core as a real process with a scripted vehicle: whoever dies, the recording opens and the vehicle comes down."""

from __future__ import annotations

import os
import signal
import time
from contextlib import suppress
from pathlib import Path

import pytest

from drivers import bus
from groundstation.flight.client.client import FlightOrder, connect, outcome, running_cores, start_core
from groundstation.flight.client.interrupts import Interrupts
from groundstation.flight.client.rehearse import rejoin
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.messages import CoreCommand
from groundstation.paths import find_config
from groundstation.recording.load import read_recording
from groundstation.recording.manifest import provenance
from groundstation.trajectory import coefficients_from_arrays, plan_from_dict

DEADLINE_S = 30.0


@pytest.fixture
def plan_file(tmp_path) -> Path:
    """A hover of ten seconds, as a plan."""
    import tomli_w

    flat = [[0.0]] * 4
    coefficients = coefficients_from_arrays(flat, flat, [0.0, 0.0, 1.0, 0.0]).model_dump(mode="json")
    document = {"vehicle": "qball2", "base_frequency_rad_s": 0.628, "coefficients": coefficients}
    plan_from_dict(document)
    path = tmp_path / "plan.toml"
    path.write_text(tomli_w.dumps(document))
    return path


@pytest.fixture
def core(tmp_path, plan_file, monkeypatch):
    """Start a core with a scripted vehicle; everything it started is gone afterwards."""
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    started = []

    def start(fault: str = "", *, go: bool = True, analyse: bool = False):
        folder = tmp_path / "logs" / "flight"
        drone = ("scripted_drone", *(("--fault", fault) if fault else ()))
        vehicle = find_config("vehicles", "qball2")
        child, endpoint = start_core(FlightOrder(folder, plan_file, vehicle, drone, analyse=analyse), start=go)
        started.append((child, endpoint))
        return child, endpoint, folder

    yield start
    for child, endpoint in started:
        child.kill()
        kill_who_knows(endpoint.endpoint)


def kill_who_knows(endpoint: str) -> None:
    """A vehicle outlives its core, frozen or waiting for credit: end whoever has the endpoint among its arguments."""
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            if endpoint.encode() in file.read_bytes().split(b"\0"):
                os.kill(int(file.parent.name), signal.SIGKILL)


def events(recording) -> list[str]:
    return [" ".join(row) for row in recording.texts["events"].rows]


def wait_for(condition, what: str):
    """Poll a condition of another process."""
    end = time.monotonic() + DEADLINE_S
    while time.monotonic() < end:
        if value := condition():
            return value
        time.sleep(0.01)
    raise AssertionError(f"waited {DEADLINE_S} s for {what}")


def phase_reached(folder: Path, phase: str):
    log = folder / JOURNAL
    return wait_for(
        lambda: log.is_file() and any(entry["text"].endswith(f"-> {phase}") for entry in read_journal(log)), phase
    )


def test_a_flight_is_recorded_whole_and_ends_well(core):
    child, _, folder = core()
    assert child.wait(DEADLINE_S) == 0, (folder / "core.log").read_text()
    assert outcome(folder)[0] == 0
    recording = read_recording(folder / "flight.mcap")
    imu = recording.streams["imu"].t_s
    assert len(imu) > 1000
    assert max(imu[1:] - imu[:-1]) < 0.011, "a sample is missing"
    assert recording.window_s is not None
    assert recording.window_s[1] - recording.window_s[0] == pytest.approx(6.0)
    assert {"vehicle.toml", "plan.toml"} <= set(recording.files)
    assert any("exciting" in text for text in events(recording))
    assert not (folder / "core.endpoint").exists()
    assert provenance(folder / "flight.mcap").startswith("The data are as flown: flight.mcap")


@pytest.mark.parametrize("fault", ["die@uploaded", "die@takeoff", "die@exciting", "die@landing", "crash@exciting"])
def test_a_vehicle_that_dies_leaves_an_open_recording_and_an_aborted_flight(core, fault):
    child, _, folder = core(fault)
    expected = 4 if fault in ("die@uploaded", "crash@exciting") else 5
    assert child.wait(DEADLINE_S) == expected, (folder / "core.log").read_text()
    status, reason = outcome(folder)
    assert status == expected and "vehicle" in reason
    assert ("may still be flying" in reason) is (expected == 5)
    recording = read_recording(folder / "flight.mcap")
    assert "plan.toml" in recording.files
    if not fault.endswith("uploaded"):
        assert len(recording.streams["imu"]) > 100


def test_a_frozen_vehicle_is_noticed(core):
    child, _, folder = core("freeze@exciting")
    assert child.wait(DEADLINE_S) == 5
    assert "vanished" in outcome(folder)[1] or "nothing was heard" in outcome(folder)[1]
    assert "imu" in read_recording(folder / "flight.mcap").streams


@pytest.mark.parametrize(("fault", "why"), [("refuse@upload", "cannot fly that"), ("refuse@arm", "compass")])
def test_a_refusal_to_fly_is_status_3_with_the_reason(core, fault, why):
    child, _, folder = core(fault)
    assert child.wait(DEADLINE_S) == 3
    assert why in outcome(folder)[1]


def test_a_vehicle_that_lands_by_itself_has_aborted_with_its_own_words(core):
    child, _, folder = core("land@exciting")
    assert child.wait(DEADLINE_S) == 4
    assert outcome(folder)[1] == "low battery"


def test_lost_batches_are_counted(core):
    child, endpoint, folder = core("gap@exciting", go=False)
    with connect(endpoint) as client:
        assert client.take_lease().ok
        wait_for(lambda: (s := client.status(1.0)) and s.phase == "checked", "checked")
        assert client.command("start").ok
        last = wait_for(lambda: (s := client.status(1.0)) and s.exit_status is not None and s, "the end")
    assert child.wait(DEADLINE_S) == 0
    assert 10 < last.lost < 25  # one of seven batches in six seconds of twenty a second
    assert f"{last.lost} batches were lost" in " ".join(e["text"] for e in read_journal(folder / JOURNAL))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("phase", ["checked", "airborne", "exciting"])
def test_a_signal_to_the_core_lands_the_vehicle(core, phase, number):
    # The flight is faster than real time: a busy machine would let it end before the signal is sent, so the vehicle
    # waits for it.
    at = {"checked": "", "airborne": "hold@takeoff", "exciting": "hold@exciting"}[phase]
    child, _, folder = core(at, go=phase != "checked")
    phase_reached(folder, phase)
    os.kill(child.pid, number)
    assert child.wait(DEADLINE_S) == 4
    recording = read_recording(folder / "flight.mcap")
    assert "core was asked to stop" in outcome(folder)[1]
    if phase != "checked":
        assert any("landing" in text for text in events(recording))


def test_a_killed_core_leaves_a_recording_that_opens_and_a_vehicle_that_lands(core):
    child, _, folder = core()
    phase_reached(folder, "exciting")
    child.kill()
    child.wait(DEADLINE_S)
    assert "imu" in read_recording(folder / "flight.mcap").streams


def test_only_the_holder_of_the_lease_starts_and_everyone_aborts(core):
    child, endpoint, folder = core(go=False)
    with connect(endpoint, name="operator") as operator, connect(endpoint, name="guest") as guest:
        assert operator.take_lease().ok
        refused = guest.take_lease()
        assert not refused.ok and refused.holder == "operator"
        wait_for(lambda: (s := guest.status(1.0)) and s.phase == "checked", "checked")
        answer = guest.command("start")
        assert not answer.ok and "operator" in answer.reason
        assert running_cores(folder.parent) == [(folder, endpoint)]
        assert guest.command("abort").ok
    assert child.wait(DEADLINE_S) == 4
    assert outcome(folder)[1] == "aborted by guest"


def test_a_lease_ends_with_its_holder(core):
    _, endpoint, _ = core(go=False)
    with connect(endpoint, name="guest") as guest:
        with connect(endpoint, name="operator") as operator:
            assert operator.take_lease().ok
        wait_for(lambda: guest.take_lease().ok, "the lease to be free")
        assert guest.command("abort").ok


@pytest.mark.parametrize("go", [True, False], ids=["in flight", "not started yet"])
def test_a_flight_whose_client_was_killed_is_followed_to_its_end(core, go):
    child, _, folder = core(go=go)
    phase_reached(folder, "exciting" if go else "checked")
    lines: list[str] = []
    with Interrupts() as stop:
        assert rejoin(folder, say=lines.append, confirm=lambda: True, stop=stop)
        assert outcome(folder)[0] == 0
        assert child.wait(DEADLINE_S) == 0
        assert not rejoin(folder, say=lines.append, confirm=lambda: True, stop=stop), "it has ended"
    assert lines[0] == "flight is still under way; following it to its end"


def test_a_flood_of_orders_is_limited_an_old_one_is_refused_and_an_abort_is_always_taken(core):
    child, endpoint, folder = core(go=False)
    with connect(endpoint, name="operator") as operator, connect(endpoint, name="guest") as guest:
        flood = [guest.take_lease(force=True) for _ in range(60)]
        assert 0 < sum("orders a second" in answer.reason for answer in flood) < 60
        wait_for(lambda: operator.take_lease(force=True).ok, "the lease")
        wait_for(lambda: (s := guest.status(1.0)) and s.phase == "checked", "checked")
        assert all(not guest.command("start").ok for _ in range(40))  # costs the operator nothing
        old = CoreCommand("start", "operator", 1)
        assert "not newer" in bus.ask(guest._session, bus.CORE_COMMAND, old).reason
        assert (now := operator.status(1.0)) is not None and now.phase == "checked"
        assert not all(guest.take_lease().reason.startswith("client operator") for _ in range(60))
        assert guest.command("abort").ok
    assert child.wait(DEADLINE_S) == 4
    assert outcome(folder)[1] == "aborted by guest"
