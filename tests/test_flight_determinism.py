"""One seed, scenario and plan give one flight, whatever else the machine does: recordings compared to the last bit."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
import tomli_w
from mcap.reader import make_reader

from drivers.bus import DroneStatus
from drivers.samples import Batch, Event
from groundstation.flight import timeouts
from groundstation.flight.client.client import FlightOrder, connect, outcome, start_core
from groundstation.flight.client.rehearse import simulated_drone
from groundstation.flight.core import pacing
from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import Phase
from groundstation.paths import find_config
from groundstation.trajectory import load_plan, plan_to_dict

SEED = 5
DEADLINE_S = 120.0  # the simulator compiles on its first start
BURN = "import time\nend = time.monotonic() + 60.0\nwhile time.monotonic() < end: sum(range(100_000))"


@pytest.fixture
def plan_file(tmp_path) -> Path:
    """One period of the published trajectory, smaller, so that it is flown in seconds."""
    document = plan_to_dict(load_plan(find_config("plans", "paper_table2")))
    for channel in document["coefficients"].values():
        channel["a"] = [0.7 * value for value in channel["a"]]
        channel["b"] = [0.7 * value for value in channel["b"]]
    document["periods"] = 1.0
    path = tmp_path / "short.toml"
    path.write_text(tomli_w.dumps(document))
    return path


def _checked(endpoint: str) -> CoreStatus:
    """Look on until the flight is checked, wait a moment longer as a person would, and start it."""
    with connect(endpoint) as client:
        assert client.take_lease().ok
        end = time.monotonic() + DEADLINE_S
        while (status := client.status(0.5)) is None or status.phase != Phase.CHECKED:
            assert time.monotonic() < end, status
        later = [seen for _ in range(4) if (seen := client.status(0.5)) is not None]
        assert client.command("start").ok
        return later[-1]


def _fly(folder: Path, plan_file: Path, *, by_hand: bool) -> dict[str, list[tuple[int, int, bytes]]]:
    """Fly, and return the recording's messages of each topic as they stand in the file."""
    vehicle, scenario = find_config("vehicles", "qball2"), find_config("scenarios", "worn")
    drone = simulated_drone(vehicle, scenario, SEED)
    core, endpoint = start_core(FlightOrder(folder, plan_file, vehicle, drone, analyse=False), start=not by_hand)
    if by_hand:
        assert _checked(endpoint).host_s == pytest.approx(timeouts.SIMULATED_LOOK_S)
    core.wait(DEADLINE_S)
    assert outcome(folder)[0] == 0, (folder / "core.log").read_text()
    topics: dict[str, list[tuple[int, int, bytes]]] = {}
    with (folder / "flight.mcap").open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            topics.setdefault(channel.topic, []).append((message.log_time, message.publish_time, message.data))
    topics["/events"].sort()  # the vehicle's and the station's of one instant have no order among them
    return topics


def test_a_busy_machine_and_a_slow_hand_fly_the_same_flight_to_the_last_bit(tmp_path, plan_file):
    quiet = _fly(tmp_path / "quiet", plan_file, by_hand=False)
    burners = [subprocess.Popen([sys.executable, "-c", BURN]) for _ in range(4)]
    try:
        busy = _fly(tmp_path / "busy", plan_file, by_hand=True)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert quiet.keys() == busy.keys()
    for topic, messages in quiet.items():
        assert len(messages) == len(busy[topic]), topic
        assert messages == busy[topic], f"{topic} differs (seed {SEED})"
    assert sum(map(len, quiet.values())) > 10_000


def test_on_the_ground_time_stands_still_wherever_an_order_may_come():
    pace = pacing.Pace(lock_step=True)
    assert pace.credit_s(Phase.PLANNED, 0.0) == 0.0
    pace.look()
    assert pace.credit_s(Phase.UPLOADED, 0.5) == timeouts.SIMULATED_LOOK_S
    assert not pace.stands(timeouts.SIMULATED_LOOK_S - 0.05) and pace.stands(timeouts.SIMULATED_LOOK_S)
    assert pace.credit_s(Phase.CHECKED, timeouts.SIMULATED_LOOK_S) == timeouts.SIMULATED_LOOK_S
    assert not pace.owes(Phase.CHECKED, timeouts.SIMULATED_LOOK_S)
    assert (
        pace.credit_s(Phase.AIRBORNE, timeouts.SIMULATED_LOOK_S)
        == timeouts.SIMULATED_LOOK_S + timeouts.SIMULATED_AHEAD_S
    )
    pace.look()
    assert (
        pace.credit_s(Phase.UPLOADED, timeouts.SIMULATED_LOOK_S)
        == timeouts.SIMULATED_LOOK_S + timeouts.SIMULATED_LOOK_AGAIN_S
    )


def test_a_word_that_overtakes_its_samples_waits_for_them():
    lock_step, real_time = pacing.Pace(lock_step=True), pacing.Pace(lock_step=False)
    word = DroneStatus("landed", False, 1.05, 1.05)
    for pace in (lock_step, real_time):
        pace.heard(word)
    assert real_time.due() == [word] and real_time.due() == []
    assert lock_step.due() == []
    lock_step.recorded(Batch(1, (), (), 1.05))
    assert lock_step.due() == [word] and lock_step.due() == []


def test_a_recording_ends_with_the_batch_in_which_the_vehicle_came_to_rest():
    flying = Batch(0, (1.0,), (Event(1.0, "phase", "landing: excitation flown; landing"),), 1.0)
    down = Batch(1, (1.05,), (Event(1.05, "phase", "landed: landed and disarmed"),), 1.05)
    after = Batch(2, (), (), 1.1)
    lock_step, real_time = pacing.Pace(lock_step=True), pacing.Pace(lock_step=False)
    assert [lock_step.recorded(batch) for batch in (flying, down, after)] == [True, True, False]
    assert all(real_time.recorded(batch) for batch in (flying, down, after))
