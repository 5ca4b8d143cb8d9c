"""The simulated drone on the bus: credit, pacing, and a station that dies."""

from __future__ import annotations

import queue
import subprocess
import sys
import threading
import time

import pytest
import tomli_w
from flights import rest_to_rest_plan

from drivers import bus
from drivers.samples import Batch, decode_batch
from groundstation.paths import find_config
from groundstation.trajectory import plan_to_dict
from groundstation.vehicle import load_vehicle
from sim.drone import Drone
from sim.process import DroneProcess, Station
from sim.scenario import load_scenario
from sim.simulation import Simulation

PLAN = bus.make_upload(tomli_w.dumps(plan_to_dict(rest_to_rest_plan(periods=1.0))).encode())


class Core:
    """A core as simple as can be: grants credit and counts what comes."""

    def __init__(self, endpoint: str, drone: str):
        self.keys = bus.DroneKeys(drone)
        self.session = bus.open_session(listen=[endpoint])
        self.batches: queue.Queue[Batch] = queue.Queue()
        self.states: list[bus.DroneStatus] = []
        self.alive = threading.Event()
        self.kept = [
            bus.subscribe(self.session, self.keys.samples, decode_batch, self.batches.put),
            bus.subscribe(self.session, self.keys.status, bus.decoder_of(bus.DroneStatus), self.states.append),
            bus.watch_alive(self.session, self.keys.alive, lambda _key, up: up and self.alive.set()),
        ]
        self.credit = bus.Publisher(self.session, self.keys.credit)
        self.host_s = 0.0
        self.sequence = 0

    def ask(self, name) -> bus.Answer:
        return bus.ask(self.session, self.keys.command, bus.Command(name))

    def start(self) -> None:
        assert bus.ask(self.session, self.keys.upload, PLAN).ok
        assert self.ask("arm").ok
        assert self.ask("start").ok

    def fly(self, until_s: float) -> None:
        """Grant half a second at a time and take every batch."""
        while self.host_s < until_s:
            self.credit.put(bus.Credit(min(self.host_s + 0.5, until_s + 0.05)))
            batch = self.batches.get(timeout=10.0)
            assert batch.sequence == self.sequence
            self.sequence += 1
            self.host_s = max([self.host_s, *batch.host_s])

    def close(self) -> None:
        self.session.close()


class Wall:
    """A clock that tests turn."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def flown(request):
    """A core, and a drone served from a thread, on a clock of their own; ends the drone afterwards."""
    real_time = getattr(request, "param", False)
    endpoint = bus.loopback(bus.free_port())
    core = Core(endpoint, "threaded")
    scenario = load_scenario(find_config("scenarios", "seed"))
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    Simulation(vehicle, scenario, 1).idle(1)  # compiled before anybody waits
    drone = Drone("threaded", vehicle, scenario, 1, real_time=real_time)
    session = bus.open_session(connect=[endpoint])
    wall = Wall()
    process = DroneProcess(drone, session, clock=time.monotonic if real_time else wall)

    def run() -> None:
        with bus.alive(session, process.keys.alive):
            process.run()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert core.alive.wait(10.0)
    yield core, process, wall, thread
    process._ending.set()
    thread.join(10.0)
    core.close()
    session.close()
    assert not thread.is_alive()


def _eventually(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "did not happen"
        threading.Event().wait(0.01)


def test_a_grant_that_arrives_after_its_core_has_gone_does_not_bring_it_back():
    wall = Wall()
    station = Station(wall)
    assert not station.lost  # nobody was there yet
    station.on_alive("gs/core/alive", True)
    station.on_credit(bus.Credit(1.0))
    assert not station.lost
    station.on_alive("gs/core/alive", False)
    station.on_credit(bus.Credit(2.0))
    assert station.lost
    station.on_alive("gs/core/alive", True)
    assert not station.lost
    assert station.take_leave()  # however soon another came: what flew for the first is orphaned, and told so once
    assert not station.take_leave()
    wall.now += bus.CREDIT_TIMEOUT_S + 0.1
    assert station.lost


def test_in_lock_step_it_runs_exactly_as_far_as_it_is_granted(flown):
    core, process, _, _ = flown
    threading.Event().wait(0.2)
    assert process.drone.simulation.time_s == 0.0
    core.credit.put(bus.Credit(0.5))
    _eventually(lambda: process.drone.simulation.time_s >= 0.5 - 1e-9)
    threading.Event().wait(0.2)
    assert process.drone.simulation.time_s == pytest.approx(0.5)


def test_a_whole_flight_loses_nothing_and_lands(flown):
    core, process, _, _ = flown
    core.start()
    core.fly(32.0)
    assert process.drone.phase == "landed"
    phases = list(dict.fromkeys(s.phase for s in core.states))
    assert phases == ["uploaded", "armed", "takeoff", "exciting", "landing", "landed"]


def test_a_command_waits_for_no_more_than_the_stretch_under_way(flown):
    core, process, _, _ = flown
    reached = []

    def finish(request: bus.Command) -> bus.Answer:
        reached.append(process.drone.simulation.time_s)
        return Drone.command(process.drone, request)

    process.drone.command = finish
    core.credit.put(bus.Credit(1e6))
    _eventually(lambda: process.drone.simulation.time_s > 1.0)
    waited = []
    for _ in range(30):
        process._door.acquire()  # as one who asks does, who then waits for the drone
        asked = process.drone.simulation.time_s
        with process._lock:
            waited.append(process.drone.simulation.time_s - asked)
        process._door.release()
        assert not core.ask("finish").ok  # on the ground there is nothing to finish
    assert max(waited) <= 1.5 * process.drone.description.batch_s
    assert len(reached) == 30


def test_who_shuts_it_down_is_answered_before_it_ends(flown, monkeypatch):
    core, _, _, thread = flown
    encode = bus.encode

    def slow(message) -> bytes:
        if isinstance(message, bus.Answer):
            thread.join(0.3)  # on the drone's thread that answers: time enough for a process that does not wait for it
            assert thread.is_alive()
        return encode(message)

    monkeypatch.setattr(bus, "encode", slow)
    assert core.ask("shutdown").ok
    thread.join(10.0)
    assert not thread.is_alive()


def test_it_ends_when_told_to_though_the_answer_is_lost(flown, monkeypatch):
    core, _, _, thread = flown
    encode = bus.encode

    def lost(message) -> bytes:
        if isinstance(message, bus.Answer):
            raise OSError("the one who asked is gone")
        return encode(message)

    monkeypatch.setattr(bus, "encode", lost)
    with pytest.raises(ConnectionError):
        core.ask("shutdown")
    thread.join(10.0)
    assert not thread.is_alive()


@pytest.mark.parametrize("death", ["silence", "session closed"])
def test_when_the_station_is_gone_it_lands_by_itself_and_then_ends(flown, death):
    core, process, wall, thread = flown
    with bus.alive(core.session, bus.CORE_ALIVE):
        core.start()
        core.fly(14.0)
        assert process.drone.phase == "exciting"
        if death == "silence":
            wall.now += bus.LOCK_STEP_TIMEOUT_S + 0.1
    # Leaving the block takes the core's token away, which is how a killed core looks.
    _eventually(lambda: process.drone.phase == "landed")
    assert process.drone.simulation.position_m[2] == pytest.approx(0.1)
    _eventually(lambda: process.station.lost)
    wall.now += 20.0
    threading.Event().wait(0.2)
    wall.now += 20.0
    thread.join(10.0)
    assert not thread.is_alive()


def test_garbage_on_every_key_changes_nothing(flown):
    core, process, _, _ = flown
    core.start()
    core.fly(8.0)
    for key in (core.keys.upload, core.keys.command, core.keys.describe):
        for payload in (b"", b"\xc1", b"\x93\x01\x02\x03", b"x" * 10_000):
            for reply in core.session.get(key, payload=payload, timeout=2.0):
                answer = bus.decode(reply.ok.payload.to_bytes(), bus.Answer)
                assert not answer.ok
                assert "not understood" in answer.reason
    for payload in (b"", b"\xc1", b"\x80"):
        core.session.put(core.keys.credit, payload)
    core.fly(32.0)
    assert process.drone.phase == "landed"


@pytest.mark.parametrize("flown", [True], indirect=True)
def test_in_real_time_it_keeps_to_the_wall_clock_and_needs_no_credit(flown):
    _, process, _, _ = flown
    started, simulated = time.monotonic(), process.drone.simulation.time_s
    _eventually(lambda: process.drone.simulation.time_s >= simulated + 0.6)
    assert time.monotonic() - started >= 0.55


def test_bad_arguments_are_one_sentence_and_status_2(tmp_path):
    scenario = tmp_path / "odd.toml"
    scenario.write_text("[imu]\nrate_hz = -5\n[effects.no_such]\n")
    for arguments, words in (
        (["--scenario", str(scenario)], "rate_hz"),
        (["--scenario", "nowhere"], "no such file"),
        (["--vehicle", "nothing"], "no such file"),
    ):
        done = subprocess.run(
            [sys.executable, "-P", "-m", "sim", "--connect", "tcp/127.0.0.1:1", *arguments],
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
        assert done.returncode == 2
        assert words in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
