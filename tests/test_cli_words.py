"""The command line's manners: help, suggestions, completion, progress, and every command that the documents print."""

from __future__ import annotations

import io
import re
import shlex
import sys
from pathlib import Path

import click
import pytest

from groundstation.cli import COMMANDS, cli, main
from groundstation.commands.common import ProgressLine
from groundstation.commands.files import FORMAT_NAMES, OTHER_NAMES

ROOT = Path(__file__).resolve().parent.parent
DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def printed_commands() -> list[tuple[str, str]]:
    """Every line of a fenced block or inline code that begins with ``groundstation``, with the document it stands
    in.
    """
    found = []
    for path in DOCUMENTS:
        text = path.read_text(encoding="utf-8")
        blocks = re.findall(r"```\w*\n(.*?)```", text, re.S)
        lines = [line.strip().removeprefix("$ ") for block in blocks for line in block.splitlines()]
        lines += re.findall(r"`(groundstation [^`]+)`", text.replace("\n", " "))
        found += [(path.name, line) for line in lines if line.startswith("groundstation ")]
    return sorted(set(found))


def parsed(line: str) -> None:
    """Parse a command with the real options; nothing runs. Places such as FLIGHT or ... stand for themselves."""
    words = shlex.split(re.sub(r"\s+&$|\s{3,}.*", "", line), comments=True)[1:]
    words = [word for word in words if word not in ("...", "…", "[...]")]
    for stop in ("|", ">", "&&", ";"):
        if stop in words:
            words = words[: words.index(stop)]
    if not words or words[0] in {"-h", "--help", *(option for each in cli.params for option in each.opts)}:
        return
    name, *rest = words
    command = cli.get_command(click.Context(cli), name)
    assert command is not None, f"there is no command {name}"
    if name == "sim" or not rest:
        return
    command.make_context(name, list(rest), parent=click.Context(cli, help_option_names=["-h", "--help"]))


@pytest.mark.parametrize(("document", "line"), printed_commands())
def test_every_command_that_the_documents_print_parses(document, line, monkeypatch):
    try:
        parsed(line)
    except click.exceptions.Exit:
        pass
    except click.BadOptionUsage as error:
        assert line.endswith(error.option_name), (document, line)  # running text that names an option without its value
    except click.MissingParameter as error:
        # A line in running text may name a command and leave its arguments out, but no option that it prints may be
        # wrong.
        assert "`" not in line and error.param is not None, (document, line)


def test_the_documents_print_enough_commands_to_mean_something():
    assert len(printed_commands()) > 25


@pytest.mark.parametrize("name", list(COMMANDS))
def test_each_command_answers_minus_h_with_an_example(name, capsys):
    if name == "sim":
        pytest.skip("sim replaces the process; test_sim_alone_explains_itself runs it")
    assert main([name, "-h"]) == 0
    out = capsys.readouterr().out
    assert f"Usage: groundstation {name}" in out and "Example:" in out


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["idenitfy", "x"], "identify"),
        (["digagnose", "x"], "diagnose"),
        (["export", "m.toml", "--format", "mujoco"], "mjcf"),
        (["export", "m.toml", "--format", "rotopy"], "rotorpy"),
        (["rehearse", "--vehicle", "qbal2"], "qball2"),
        (["completion", "bsh"], "bash"),
    ],
)
def test_a_slip_names_what_was_meant_in_one_line(words, meant, capsys):
    assert main(words) == 2
    said = capsys.readouterr().err
    assert re.search(rf"(?i)did you mean .*{meant}", said), said
    assert said.count("\n") == 1


MISTAKES = {
    "identify": "`groundstation identify -h` shows how it is called.",
    "identify nowhere.mcap": "nowhere.mcap: there is no such file or folder.",
    "predict nowhere.toml flight.mcap": "nowhere.toml: there is no such file or folder.",
    "identify empty": "motors.csv is missing; a flight bundle needs it",
    "diagnose nowhere.mcap --exclude 3": "write start:end in seconds",
    "export nowhere.toml --format urdf": "there is no such file; give the path of an identification file.",
    "rehearse --scenario rain": "among the shipped scenarios; there are clean, hall",
    "rehearse --seed abc": "'abc' is not a valid integer",
    "rehearse --until mass": "write for example ixx,iyy,izz:2%,mass:0.5%.",
    "preflight --link ttyUSB0 --vehicle x500": "'ttyUSB0' names no link; write serial:///dev/",
    "fly --vehicle x500": "Missing option '--link'. `groundstation fly -h` shows how it is called.",
    "fly --link udpin://127.0.0.1:0 --vehicle x500": "armed only by somebody at a terminal",
    "plan --limit speedmax=3": "speedmax is not a limit. Did you mean speed_max_m_s",
    "plan --time-budget-s 1e999": "inf is not in the range",
    "plan --duration-s -3": "the duration must be positive",
    "compare empty empty": "has no identification.json; `groundstation report` makes one",
    "flights nosuch": "'nosuch' is no flight in logs",
    "flights --since yesterday": "'yesterday' is no date; write it as 2025-01-31.",
    "flights --sort masss": "Did you mean mass?",
    "campaign --vehicle x500": "say what flies: --scenario NAME",
    "campaign --vehicle x500 --scenario hal": "did you mean hall?",
    "batch nowhere": "names no recording",
    "--vehicle x500": "No such option '--vehicle'. `groundstation -h` shows",
    "reproduce more": "unexpected extra argument (more). `groundstation reproduce -h` shows",
}
"""Typical mistakes, and what their one sentence says."""


@pytest.mark.parametrize("words", MISTAKES)
def test_a_typical_mistake_gets_one_sentence_and_leaves_nothing(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", io.StringIO())
    (tmp_path / "empty").mkdir()
    assert main(words.split()) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert MISTAKES[words] in said[-1], said
    assert len([line for line in said if not line.startswith("reading ")]) == 1, said
    assert [path.name for path in tmp_path.iterdir()] == ["empty"]


def test_a_link_that_cannot_be_opened_is_told_once_and_names_no_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    plan = str(ROOT / "configs" / "plans" / "qball2.toml")
    assert main(["preflight", "--link", "tcp://127.0.0.1:1", "--vehicle", "qball2", "--plan", plan]) == 3
    said = capsys.readouterr().out + capsys.readouterr().err
    assert said.count("cannot be opened") == 1 and "flight.mcap" not in said


def test_what_is_near_to_nothing_lists_all(capsys):
    assert main(["xyzzy"]) == 2
    assert "There are plan, sim, rehearse" in capsys.readouterr().err


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_for_each_shell(shell, capsys):
    assert main(["completion", shell]) == 0
    assert "_GROUNDSTATION_COMPLETE" in capsys.readouterr().out


def test_completion_offers_commands_and_values():
    from click.shell_completion import ShellComplete

    complete = ShellComplete(cli, {}, "groundstation", "_GROUNDSTATION_COMPLETE")
    assert {"identify", "diagnose"} <= {item.value for item in complete.get_completions([], "")}
    offered = [item.value for item in complete.get_completions(["export", "m.toml", "--format"], "m")]
    assert offered == ["mjcf", "matlab"]


def test_formats_of_the_command_are_those_that_are_written():
    from groundstation.reporting.exports import FORMATS

    assert set(FORMAT_NAMES) == set(FORMATS)
    assert set(OTHER_NAMES.values()) <= set(FORMATS)


def test_sim_alone_explains_itself():
    import subprocess

    done = subprocess.run(
        [sys.executable, "-P", "-m", "groundstation.cli", "sim"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0
    assert "groundstation sim [-h]" in done.stdout and "python -P -m" not in done.stdout


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_fits_one_line_and_says_the_time_left(monkeypatch):
    terminal, now = _Terminal(), [0.0]
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", "40")
    line = ProgressLine(clock=lambda: now[0])
    for step in range(1, 11):
        now[0] += 2.0
        line.fraction(step / 10, "a sentence that is a good deal longer than the terminal is wide")
    line.end()
    shown = terminal.getvalue()
    assert shown.count("\n") == 1
    assert all(len(part.rstrip()) < 40 for part in shown.split("\r"))
    assert "10 %" in shown and re.search(r"\d+ s left", shown)


def test_a_fault_behind_progress_begins_a_line_of_its_own(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    ProgressLine().fraction(0.5, "half of it")
    assert main(["xyzzy"]) == 2
    assert terminal.getvalue().splitlines()[-1].startswith("there is no command 'xyzzy'.")


def test_progress_elsewhere_is_whole_lines_without_control_characters(monkeypatch):
    stream, now = io.StringIO(), [0.0]
    monkeypatch.setattr(sys, "stderr", stream)
    line = ProgressLine(clock=lambda: now[0])
    for step in range(1, 4):
        now[0] += 5.0
        line.fraction(step / 3, "working")
    line.end()
    assert "\r" not in stream.getvalue() and "\x1b" not in stream.getvalue()
    assert stream.getvalue().splitlines()[-1] == "100 %  working"


def test_a_line_that_stays_the_same_is_not_printed_every_second(monkeypatch):
    stream, now = io.StringIO(), [0.0]
    monkeypatch.setattr(sys, "stderr", stream)
    line = ProgressLine(clock=lambda: now[0])
    for _ in range(25):
        line.say("idle")
        now[0] += 1.0
    line.say("planned")
    assert stream.getvalue().splitlines() == ["idle", "idle", "idle", "planned"]


def test_preflight_says_each_failed_check_on_a_line_of_its_own():
    from groundstation.commands.flying import preflight_text
    from groundstation.flight.client.rehearse import Checked
    from groundstation.flight.messages import CheckStatus

    seen = (
        CheckStatus("link", True, "0.2 % lost"),
        CheckStatus("battery", False, "11.1 V (charge it)"),
        CheckStatus("room", False, "2 m short (shrink the plan)"),
    )
    assert preflight_text(Checked("the vehicle refused the plan: …", seen)).splitlines() == [
        "not ready to fly: 2 of 3 checks failed",
        "  battery: 11.1 V (charge it)",
        "  room: 2 m short (shrink the plan)",
        "passed: link",
    ]
    assert preflight_text(Checked("", seen[:1])) == "ready to fly\npassed: link"
    assert preflight_text(Checked("nothing is heard", ())) == "nothing is heard"
