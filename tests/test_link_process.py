"""The link process without its processes: what its one thread does with a disk that is full and with orders after a
stall.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from mavlink_vehicle import Rig, small_plan

from drivers.samples import Event, decode_batch
from groundstation.errors import Refused
from groundstation.flight.link.arguments import Kept
from groundstation.flight.link.link_core import LinkCore
from groundstation.flight.link.parameter_journal import ParameterJournal, left_changed
from groundstation.flight.link.process import LinkProcess


class Port:
    """The scripted vehicle of a rig as a transport: a turn waits one step of its time."""

    datagrams, trouble = False, ""

    def __init__(self, rig: Rig):
        self.rig = rig
        self._out: list[bytes] = []
        self._in: list[tuple[str, bytes]] = []

    def wait(self, _seconds: float) -> None:
        self.pass_time(0.01)

    def pass_time(self, seconds: float) -> None:
        """The vehicle goes on; what it sends waits to be read."""
        for _ in range(round(seconds / 0.01)):
            self.rig.now_s += 0.01
            self._in += [("vehicle", data) for data in self.rig.vehicle.step(self.rig.now_s, self._out)]
            self._out.clear()

    def read(self) -> list[tuple[str, bytes]]:
        arrived, self._in = self._in, []
        return arrived

    def write(self, data: bytes) -> None:
        self._out.append(data)

    def answer(self, peer: str) -> None:
        assert peer == "vehicle"


class Bus:
    """Takes what is published."""

    failure = ""

    def put(self, _item: object) -> None:
        pass


def process(rig: Rig, raw_log: Path | None = None) -> LinkProcess:
    made = LinkProcess(rig.core, Port(rig), "vehicle", Kept(ParameterJournal(None), raw_log), clock=lambda: rig.now_s)
    made._publisher = Bus()  # type: ignore[assignment]
    return made


def turns(link: LinkProcess, done, limit: int = 3000) -> bool:
    for _ in range(limit):
        if done():
            return True
        link.turn()
        link.core.core_heard(link.clock())
    return False


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device here that is always full")
def test_a_raw_log_that_cannot_be_written_is_reported_once_and_the_link_goes_on():
    rig = Rig("px4", keep_raw=True)
    link = process(rig, Path("/dev/full"))
    told: list[str] = []
    emit = link._emit

    def watched(out) -> None:
        told.extend(s.text for s, _ in out.samples if isinstance(s, Event))
        emit(out)

    link._emit = watched  # type: ignore[method-assign]
    assert turns(link, lambda: rig.core.ready)
    link._logger.close()  # all that was put has been tried
    turns(link, lambda: False, 20)
    failures = [t for t in told if "raw log is not written" in t]
    assert len(failures) == 1 and "No space left" in failures[0]


def test_an_order_after_a_stall_is_judged_by_what_arrived_during_it():
    rig = Rig("px4")
    link = process(rig)
    assert turns(link, lambda: rig.core.ready)
    link.transport.pass_time(1.2)  # this thread did not run; the messages of 1.2 s wait in the port
    answers = []
    link._later(lambda: answers.append(link.core.upload(small_plan(), link.clock())))
    link.turn()
    assert answers and answers[0].ok, answers[0].reason


def test_the_checks_of_a_refusal_are_published_before_it():
    """A core that is refused ends its recording at once."""
    rig = Rig("px4")
    link = process(rig)
    assert turns(link, lambda: rig.core.ready)
    rig.core.free_bytes = lambda: 0
    seen: list[str] = []

    class Jobs(Bus):
        def put(self, item) -> None:
            item()

    class Batches:
        def put(self, data: bytes) -> None:
            seen.extend(s.text for s in decode_batch(data).samples if isinstance(s, Event) and s.kind == "preflight")

    class Reply:
        def put(self, answer) -> None:
            seen.append(f"answer {answer.ok}")

    link._publisher, link._samples, link._status = Jobs(), Batches(), Bus()  # type: ignore[assignment]
    link._later(lambda: link._waiting.append((link.core.upload(small_plan(), link.clock()), Reply())))
    link.turn()
    assert seen[-1] == "answer False" and seen.count("answer False") == 1
    assert any(text.startswith("disk failed") for text in seen[:-1]), seen


def test_a_vehicle_in_flight_is_refused_with_what_can_be_done_and_one_on_the_ground_is_not():
    rig = Rig("px4")
    rig.excite()
    rig.core = LinkCore(rig.core.vehicle, rig.core.station, rig.core.options)
    link = process(rig)
    rig.run(lambda: rig.core.view is not None and rig.core.view.on_ground is not None, 3.0)
    assert rig.core.found_flying
    with pytest.raises(Refused, match=r"in flight.*--take-over land"):
        link._refuse_in_flight()
    rig.core.view.on_ground = True
    link._refuse_in_flight()
    assert not rig.core.found_flying


def test_a_publisher_that_fails_is_told_once_in_the_recording_and_in_the_log(capfd):
    rig = Rig("px4")
    link = process(rig)
    link._publisher.failure = "the session is closed"
    told: list[str] = []
    emit = link._emit

    def watched(out) -> None:
        told.extend(s.text for s, _ in out.samples if isinstance(s, Event))
        emit(out)

    link._emit = watched  # type: ignore[method-assign]
    turns(link, lambda: False, 30)
    assert sum("the session is closed" in text for text in told) == 1
    assert capfd.readouterr().err.count("the session is closed") == 1


def test_a_link_without_core_and_without_vehicle_ends_at_last_and_not_before():
    rig = Rig("px4")
    rig.excite()
    link = process(rig)
    link._core_gone_s = rig.now_s
    rig.now_s += 170.0
    assert not link._finished(), "a vehicle in the air may be heard again"
    rig.now_s += 15.0
    assert link._finished()


def test_what_a_flight_left_changed_is_named(tmp_path):
    path = tmp_path / "parameters.journal"
    assert left_changed(path) == ""
    ParameterJournal(path).note("px4-1", "NAV_DLL_ACT", 1.0, 3.0)
    assert left_changed(path) == "NAV_DLL_ACT (1 before)"
    path.write_text("{")
    assert "restore them by hand" in left_changed(path)
