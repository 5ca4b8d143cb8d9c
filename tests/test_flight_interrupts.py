"""Ctrl-C at every phase of `rehearse` and `fly`, which share what follows the plan: before arming nothing is ever
armed, afterwards the vehicle lands. Real processes on loopback."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import tomli_w
from mavlink_vehicle import small_plan

from groundstation.commands.common import ProgressLine
from groundstation.commands.flying import _fetch_log
from groundstation.errors import FlightAborted
from groundstation.flight.client.client import FlightOrder
from groundstation.flight.client.interrupts import Interrupts
from groundstation.flight.client.rehearse import FlightResult, fly
from groundstation.flight.journal import NAME as JOURNAL
from groundstation.flight.journal import read_journal
from groundstation.flight.link import onboard_log
from groundstation.paths import find_config
from groundstation.recording import load_flight

SCRIPTED = Path(__file__).with_name("scripted_drone.py")


@pytest.fixture
def scripted(tmp_path, monkeypatch) -> tuple[str, ...]:
    """The scripted drone as a module that the core can start."""
    monkeypatch.setenv("PYTHONPATH", str(SCRIPTED.parent))
    return ("scripted_drone",)


def interrupt() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def flown(tmp_path: Path, drone, *, at: str, analyse: bool = False) -> list[dict]:
    """Fly, with Ctrl-C at a moment; what the flight's journal says."""
    plan = tmp_path / "plan.toml"
    plan.write_text(tomli_w.dumps(small_plan().model_dump(mode="json", by_alias=True, exclude_none=True)))
    folder = tmp_path / "flight"
    sent = []

    def once(here: bool) -> None:
        if here and not sent:
            sent.append(at)
            interrupt()

    class Watched(Interrupts):
        @contextlib.contextmanager
        def ordering(self, order):
            with super().ordering(order):
                once(at == "connected" and (folder / JOURNAL).is_file())
                yield

    def confirm() -> bool:
        once(at == "asked")
        return True

    if at == "connecting":  # the core's interpreter starts: nobody is connected yet
        signal.signal(signal.SIGALRM, lambda *_: once(True))
        signal.setitimer(signal.ITIMER_REAL, 0.15)
    with pytest.raises(FlightAborted), Watched() as stop:
        once(at == "planning")
        stop.check()
        fly(
            FlightOrder(folder, plan, find_config("vehicles", "qball2"), drone, analyse=analyse),
            say=lambda text: once(text.split()[:1] == [at]),
            confirm=confirm,
            stop=stop,
        )
    assert sent == [at]
    return read_journal(folder / JOURNAL) if (folder / JOURNAL).is_file() else []


@pytest.mark.parametrize("at", ["planning", "connecting", "connected", "asked"])
def test_ctrl_c_before_arming_means_that_nothing_is_armed(tmp_path, scripted, at):
    entries = flown(tmp_path, scripted, at=at)
    assert not any(e["kind"] == "vehicle" and e["text"] in ("armed", "takeoff") for e in entries)
    if at not in ("planning", "connecting"):
        assert entries[-1]["kind"] == "outcome" and entries[-1]["exit_status"] == 4


@pytest.mark.parametrize("at", ["airborne", "exciting", "landing"])
def test_ctrl_c_in_flight_lands_and_is_an_aborted_flight(tmp_path, scripted, at):
    phase = {"airborne": "takeoff"}.get(at, at)
    entries = flown(tmp_path, (*scripted, "--fault", f"hold@{phase}"), at=at)  # it lands no sooner than it is told to
    said = [entry["text"] for entry in entries if entry["kind"] == "vehicle"]
    assert "landing" in said and said[-1] == "landed"
    assert entries[-1]["kind"] == "outcome" and entries[-1]["exit_status"] == 4
    assert "aborted by the operator" in entries[-1]["reason"]


def test_ctrl_c_after_landing_ends_the_analysis_alone(tmp_path, scripted):
    entries = flown(tmp_path, scripted, at="identifying", analyse=True)
    assert entries[-1]["exit_status"] == 4 and entries[-1]["reason"].startswith("the analysis was given up: ")
    recorded = load_flight(tmp_path / "flight" / "flight.mcap").imu
    assert recorded is not None and len(recorded.t_s) > 100


def test_ctrl_c_while_the_onboard_log_is_fetched_keeps_the_result(tmp_path, monkeypatch, capsys):
    """`fly` fetches it last, when everything else is there."""

    def fetched(*_: object, **__: object) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr(onboard_log, "fetch_onboard_log", fetched)
    _fetch_log("udpin://x:1", find_config("vehicles", "x500"), FlightResult(tmp_path, 0, ""), ProgressLine(), None)
    assert "no onboard log (stopped by Ctrl-C)" in capsys.readouterr().err


def test_a_solver_that_swallows_the_interrupt_does_not_swallow_the_word():
    with pytest.raises(FlightAborted, match="before anything was armed"), Interrupts() as stop:
        with contextlib.suppress(KeyboardInterrupt):
            interrupt()
        stop.check()


@pytest.mark.parametrize(
    "command", ["rehearse --scenario clean", "fly --link udpin://127.0.0.1:0 --vehicle x500 --yes-simulated"]
)
def test_ctrl_c_while_planning_flies_nothing(tmp_path, command):
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "groundstation.cli", *command.split(), "--logs", str(tmp_path / "logs")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert process.stderr is not None
    while "%" not in process.stderr.readline() and process.poll() is None:
        pass
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 4, said
    assert "before anything was armed" in said
    assert not list(tmp_path.glob(f"logs/*/{JOURNAL}")), "no core was started"
