"""The emulator against recorded firmware traffic: the same requests at the same times, the same answers."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from drivers.mavlink.codec import MavlinkCodec, Received
from drivers.mavlink.tlog import entries
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe, quadrotor

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
RECORDINGS = {"px4": DATA / "px4-sih" / "offboard.tlog", "arducopter": DATA / "arducopter" / "guided.tlog"}
Heard = list[tuple[float, Received]]

pytestmark = pytest.mark.skipif(not RECORDINGS["px4"].is_file(), reason="recorded firmware traffic is not here")

NOT_SENT = {
    "px4": {76, 87, 132, 410, 12901, 12904},  # gimbal commands, global target, range finder, events, open drone id
    "arducopter": set(),
}
"""Message ids in the recording that the emulator does not send; docs/emulator.md names them."""


@cache
def replayed(profile: str) -> tuple[Heard, Heard, float]:
    """What the firmware said, what the emulator says to the same requests, and for how long."""
    recorded = list(entries(RECORDINGS[profile].read_bytes()))
    start, end = recorded[0][0], recorded[-1][0] - recorded[0][0]
    decoder, said, requests = MavlinkCodec(), [], []
    for stamp, frame in recorded:
        for received in decoder.decode(frame, datagram=True):
            if received.frame.system == 1:
                said.append((stamp - start, received))
            else:
                requests.append((stamp - start, frame))
    kind, boot_s, drift = (Px4, 8.228, -0.012) if profile == "px4" else (ArduCopter, 2.25, 0.0)
    vehicle = quadrotor()
    autopilot = kind(vehicle, RigidAirframe(vehicle), boot_s=boot_s, clock_drift=drift)
    autopilot.add_link("link")
    codec, answered, now = MavlinkCodec(), [], 0.0
    requests.reverse()
    while now < end:
        incoming = []
        while requests and requests[-1][0] <= now:
            incoming.append(("link", requests.pop()[1]))
        for _, frame in autopilot.step(now, incoming):
            answered += [(now, r) for r in codec.decode(frame, datagram=True)]
        now += 0.002
    return said, answered, end


def acknowledgements(heard: Heard) -> list[tuple[int, int]]:
    return [(r.message.command, r.message.result) for _, r in heard if r.name == "COMMAND_ACK"]


def texts(heard: Heard) -> list[tuple[float, int, str]]:
    """Texts without their figures; the simulator's own remark and per-IMU duplicates apart."""
    found = [(t, r.message.severity, r.message.text) for t, r in heard if r.name == "STATUSTEXT"]
    return [(t, s, re.sub(r"-?\d+(?= m\b)", "N", text)) for t, s, text in found if not text.startswith("SIM ")]


def modes(heard: Heard) -> list[tuple[int, int, int]]:
    """Changes of base mode, custom mode and status; a state shorter than two heartbeats may fall between two of
    them.
    """
    shown: list[tuple[int, int, int]] = []
    for _, r in heard:
        if r.name == "HEARTBEAT":
            m = r.message
            state = (m.base_mode, m.custom_mode, m.system_status)
            if not shown or shown[-1] != state:
                shown.append(state)
    return shown


@pytest.mark.parametrize("profile", RECORDINGS)
def test_every_request_is_acknowledged_with_the_recorded_result_in_the_recorded_order(profile):
    said, answered, _ = replayed(profile)
    assert acknowledgements(answered) == acknowledgements(said)


@pytest.mark.parametrize("profile", RECORDINGS)
def test_acknowledgements_come_as_soon_as_the_firmwares(profile):
    said, answered, _ = replayed(profile)
    times = [[t for t, r in heard if r.name == "COMMAND_ACK"] for heard in (said, answered)]
    assert max(abs(a - b) for a, b in zip(*times, strict=True)) < 0.05


@pytest.mark.parametrize("profile", RECORDINGS)
def test_the_same_texts_come_in_the_same_order_at_about_the_same_times(profile):
    said, answered, _ = replayed(profile)
    ours, theirs = texts(answered), texts(said)
    assert [t[1:] for t in ours] == [t[1:] for t in theirs]
    # Texts about a flight phase depend on how fast this vehicle climbs and sinks; the others answer a request or a
    # clock.
    flown = ("Takeoff", "Landing", "Disarm", "RTL: land")
    for (mine, _, text), (recorded, _, _) in zip(ours, theirs, strict=True):
        assert abs(mine - recorded) < (3.0 if text.startswith(flown) else 0.25), text


@pytest.mark.parametrize("profile", RECORDINGS)
def test_the_heartbeat_shows_the_same_modes_in_the_same_order(profile):
    said, answered, _ = replayed(profile)
    recorded, emulated = modes(said), modes(answered)
    # Shorter than a heartbeat's period: OFFBOARD before arming (0.3 s); landed, not yet disarmed (0.5 s).
    brief = (17, 6 << 16, 3) if profile == "px4" else (217, 9, 3)
    assert [m for m in emulated if m != brief] == [m for m in recorded if m != brief]


@pytest.mark.parametrize("profile", RECORDINGS)
def test_the_same_messages_come_at_the_same_rates(profile):
    said, answered, seconds = replayed(profile)
    theirs, ours = (Counter(r.frame.message_id for _, r in heard) for heard in (said, answered))
    assert set(theirs) - set(ours) == NOT_SENT[profile]
    assert set(ours) <= set(theirs)
    singles = {22, 253}  # notifications of changed parameters; texts, compared above
    for number in set(ours) - singles:
        assert abs(ours[number] - theirs[number]) <= max(3, 0.04 * theirs[number]), (number, seconds)


def test_every_arducopter_parameter_reads_back_as_recorded():
    said, answered, _ = replayed("arducopter")
    theirs, ours = (
        {r.message.param_id: r.message for _, r in heard if r.name == "PARAM_VALUE" and r.message.param_index != 65535}
        for heard in (said, answered)
    )
    assert len(ours) == len(theirs) == 1362
    changed = {n for n in theirs if ours[n].param_value != pytest.approx(theirs[n].param_value, rel=1e-5, abs=1e-9)}
    assert changed <= {"MIS_TOTAL", "FRAME_TYPE"}, "the recorded vehicle was a plus, ours is an X"
    assert all(
        ours[n].param_type == theirs[n].param_type and ours[n].param_index == theirs[n].param_index for n in theirs
    )


def test_an_arducopter_mission_reads_back_as_recorded():
    said, answered, _ = replayed("arducopter")
    fields = ("seq", "frame", "command", "param4", "x", "y")
    theirs, ours = (
        [tuple(getattr(r.message, f) for f in fields) for _, r in heard if r.name == "MISSION_ITEM_INT"]
        for heard in (said, answered)
    )
    assert ours == theirs
