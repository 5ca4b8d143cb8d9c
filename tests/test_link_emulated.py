"""The link against the simulator's autopilot (written by others from the recorded traffic), on virtual time."""

from __future__ import annotations

import pytest
from emulated import RigidAirframe, quadrotor
from mavlink_vehicle import small_plan

from drivers.mavlink.exchange import Conversation
from drivers.mavlink.ftp import Ftp, FtpError, checksum
from drivers.mavlink.logs import Logs
from groundstation.flight.link.link_core import LinkCore, Options
from groundstation.flight.link.phase import IN_AIR, Phase
from groundstation.flight.station import station_from_dict
from groundstation.trajectory import PlannedUntil
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.px4 import Px4

KINDS = {"px4": Px4, "arducopter": ArduCopter}
BOTH = pytest.mark.parametrize("kind", KINDS)
QUICK = {"policy": {"climb_m_s": 1.0, "settle_s": 1.0}}


class Pair:
    """A link core and an emulated autopilot on one clock."""

    def __init__(self, kind: str, **options):
        vehicle = quadrotor()
        self.autopilot = KINDS[kind](vehicle, RigidAirframe(vehicle), boot_s=60.0)
        self.autopilot.add_link("link", "companion")
        self.core = LinkCore(vehicle, station_from_dict(QUICK), Options(set_parameters=True, keep_raw=False, **options))
        self.now_s, self.step_s = 0.0, 0.01
        self.drop = lambda _n: False
        self._count = 0
        self._outgoing: list[bytes] = []
        self.conversation: Conversation | None = None

    def step(self) -> None:
        self.now_s += self.step_s
        frames = self.autopilot.step(self.now_s, [("link", data) for data in self._outgoing])
        self.core.core_heard(self.now_s)
        kept = []
        for _, data in frames:
            self._count += 1
            if not self.drop(self._count):
                kept.append(("vehicle", data))
        out = self.core.step(self.now_s, kept)
        self._outgoing = out.send

    def run(self, until, limit_s: float = 60.0) -> bool:
        end = self.now_s + limit_s
        while not until() and self.now_s < end:
            self.step()
        return until()

    def ready(self) -> Pair:
        assert self.run(lambda: self.core.ready, 30.0), self.core.trouble
        return self

    def ask(self, steps, limit_s: float = 60.0):
        """Run a conversation beside the flight."""
        talk = self.core.converse(steps)
        assert self.run(lambda: talk.done, limit_s)
        if talk.error is not None:
            raise talk.error
        return talk.result


@BOTH
def test_a_plan_is_flown_from_preflight_to_disarmed(kind):
    pair = Pair(kind).ready()
    answer = pair.core.upload(small_plan(), pair.now_s)
    assert answer.ok, answer.reason
    armed = pair.core.order("arm", pair.now_s)
    assert pair.run(lambda: armed.ok is not None, 10.0)
    assert armed.ok, armed.reason
    pair.core.order("start", pair.now_s)
    pilot = pair.core.pilot
    assert pair.run(lambda: pilot.exciting, 40.0), (pilot.phase, pilot.reason)
    assert pair.run(lambda: pilot.phase not in IN_AIR, 60.0)
    assert (pilot.phase, pilot.reason) == (Phase.LANDED, "")
    assert pair.core.clock.error_s(pair.now_s) < 0.02


@BOTH
def test_files_go_up_are_confirmed_by_checksum_and_come_back(kind):
    pair = Pair(kind).ready()
    content = bytes((7 * n + n // 256) % 256 for n in range(3000))
    name = "etc/plan.bin" if kind == "px4" else "scripts/plan.bin"
    ftp = Ftp(1, 1)
    pair.ask(ftp.make_folder(name.split("/")[0]))
    pair.ask(ftp.write(name, content))
    assert pair.ask(ftp.crc(name)) == checksum(content)
    assert pair.ask(ftp.read(name)) == content
    assert pair.ask(ftp.read(name, start=content[:1000])) == content
    assert any("plan.bin" in entry for entry in pair.ask(ftp.list(name.split("/")[0])))


def test_a_file_survives_a_link_that_loses_every_seventh_frame():
    pair = Pair("arducopter").ready()
    pair.drop = lambda n: n % 7 == 0
    content = bytes(range(256)) * 4
    pair.ask(Ftp(1, 1).make_folder("scripts"))
    pair.ask(Ftp(1, 1).write("scripts/a.bin", content))
    assert pair.ask(Ftp(1, 1).read("scripts/a.bin")) == content


def test_a_file_that_is_not_there_is_refused_with_the_reason():
    with pytest.raises(FtpError, match="no such file"):
        pair = Pair("px4").ready()
        pair.ask(Ftp(1, 1).read("no/such/file"))


@pytest.mark.parametrize("loses", [0, 9])
def test_an_onboard_log_is_listed_fetched_and_resumed_whole(loses):
    pair = Pair("px4").ready()
    pair.core.upload(small_plan(), pair.now_s)
    armed = pair.core.order("arm", pair.now_s)
    pair.run(lambda: armed.ok is not None, 10.0)
    pair.run(lambda: False, 1.0)
    pair.core.order("disarm", pair.now_s)
    assert pair.run(lambda: pair.core.view.armed is False, 10.0)
    if loses:
        pair.drop = lambda n: n % loses == 0
    logs = Logs(1, 1)
    entries = pair.ask(logs.list())
    entry = entries[-1]
    assert entry.size > 1000
    whole = pair.ask(logs.fetch(entry, bytearray()), 300.0)
    assert len(whole) == entry.size
    assert whole[:4] == b"ULog"
    assert pair.ask(logs.fetch(entry, bytearray(whole[:5000])), 300.0) == whole


def test_the_excitation_ends_at_the_next_rest_point_and_never_after_what_was_checked():
    """Three periods are checked, two planned: it may be told to go on for one more and no further, and to end after the
    first.
    """
    pair = Pair("px4").ready()
    plan = small_plan()
    section = PlannedUntil(targets={"mass_kg": 0.01}, planned_periods=2)
    answer = pair.core.upload(plan.model_copy(update={"periods": 3.0, "until": section}), pair.now_s)
    assert answer.ok, answer.reason
    pilot, period_s = pair.core.pilot, plan.series().period_s
    assert pilot.order("extend", pair.now_s).ok is False, "on the ground nothing is led"
    armed = pair.core.order("arm", pair.now_s)
    assert pair.run(lambda: armed.ok is not None, 10.0)
    pair.core.order("start", pair.now_s)
    assert pair.run(lambda: pilot.exciting, 40.0), (pilot.phase, pilot.reason)

    def lasts() -> float:
        begin, end = pilot.window_s(pair.now_s)
        return end - begin

    assert lasts() == pytest.approx(2 * period_s)
    assert pair.core.order("extend", pair.now_s).ok
    assert lasts() == pytest.approx(3 * period_s)
    refused = pair.core.order("extend", pair.now_s)
    assert refused.ok is False
    assert "checked before the flight" in refused.reason
    assert pair.core.order("finish", pair.now_s).ok
    assert lasts() == pytest.approx(period_s)
    assert pair.run(lambda: pilot.phase not in IN_AIR, 60.0)
    assert (pilot.phase, pilot.reason) == (Phase.LANDED, "")
    began, ended = pilot.excitation_s
    assert ended - began == pytest.approx(period_s, abs=0.1)
