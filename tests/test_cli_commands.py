"""The console command as a process: statuses, one JSON document, sentences instead of tracebacks, a fast --help."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest

from groundstation.cli import COMMANDS
from groundstation.commands.common import ProgressLine, assignments, result_folder, seconds_pair
from groundstation.commands.listing import SECTIONS
from groundstation.errors import BadInput
from groundstation.paths import find_config


def groundstation(*arguments: str, cwd=None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "groundstation.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, stdin=subprocess.DEVNULL, timeout=120)


def test_help_is_there_at_once():
    """Processor time, which does not grow when others want the machine too."""
    before = os.times()
    done = groundstation("--help")
    after = os.times()
    assert done.returncode == 0
    assert all(name in done.stdout for name in COMMANDS)
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    assert spent < 1.5  # 0.1 s on an idle machine; the promise is 0.5 s


HEAVY = ("numpy", "scipy", "pydantic", "numba", "casadi", "pandas", "duckdb", "plotly", "matplotlib")
STARTS = {
    "help": "from groundstation.cli import main; main(['--help'])",
    "doctor": "from groundstation.cli import main; main(['doctor'])",
    "first screen": "import groundstation.tui.app as ui; ui.GroundStation.MODES['station']()",
}


@pytest.mark.parametrize("start", list(STARTS))
def test_what_has_to_be_there_at_once_imports_nothing_heavy(start):
    code = f"import sys; {STARTS[start]}; print([m for m in {HEAVY} if m in sys.modules], file=sys.stderr)"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stderr.strip() == "[]"


def test_help_lists_every_command_once_on_a_line_of_80_columns():
    listed = [name for section in SECTIONS.values() for name in section]
    assert sorted(listed) == sorted(COMMANDS)
    assert len(listed) == len(set(listed))
    lines = groundstation("--help").stdout.splitlines()
    for section in SECTIONS.values():
        for name, summary in section.items():
            assert any(line.split(maxsplit=1) == [name, summary] for line in lines), name
    assert max(map(len, lines)) <= 80


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-P", "-m", "groundstation", "--version"], capture_output=True, text=True, timeout=60
    )
    assert done.stdout.startswith("groundstation, version ")


def test_help_imports_neither_bus_nor_screens():
    code = (
        f"import sys; {STARTS['help']}; print([m for m in ('zenoh', 'textual') if m in sys.modules], file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=60)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize("command", list(COMMANDS))
def test_every_command_explains_itself_with_an_example(command):
    done = groundstation(command, "--help")
    assert done.returncode == 0, done.stderr
    assert f"groundstation {command}" in done.stdout.split("Example:")[1]


BAD = {
    "unknown command": (["fyl"], "fyl"),
    "unknown option": (["plan", "--tilt", "3"], "--tilt"),
    "no number": (["plan", "--tilt-max-deg", "steep"], "steep"),
    "missing argument": (["identify"], "FLIGHTS"),
    "missing file": (["identify", "nowhere.mcap"], "nowhere.mcap"),
    "missing vehicle": (["plan", "--vehicle", "blimp"], "qball2"),
    "limit nobody knows": (["plan", "--limit", "colour=3"], "speed_max_m_s"),
    "impossible limit": (["plan", "--thrust-max-n", "1.0"], "thrust"),
    "stretch backwards": (["identify", "x.mcap", "--exclude", "13:12"], "13:12"),
    "paper of another vehicle": (["plan", "--paper", "--vehicle", "x500"], "QBall"),
    "scenario missing": (["rehearse", "--scenario", "hurricane"], "hurricane"),
}


PROGRESS = re.compile(r"[^:]+: \d+ s")
"""What a command says of itself that has been quiet for a second and a half, as on a machine that others keep busy."""


@pytest.mark.parametrize(("arguments", "names"), BAD.values(), ids=BAD.keys())
def test_bad_arguments_are_status_2_one_sentence_and_nothing_written(tmp_path, arguments, names):
    done = groundstation(*arguments, "--json", cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    document = json.loads(done.stdout)
    assert names in document["error"] and document["exit_status"] == 2
    assert "Traceback" not in done.stderr
    told = [line for line in done.stderr.strip().splitlines() if not PROGRESS.fullmatch(line)]
    assert len(told) == 1, done.stderr
    assert not list(tmp_path.iterdir())


def test_malformed_flights_are_status_2_and_name_the_place(tmp_path):
    flight = tmp_path / "flight"
    flight.mkdir()
    (flight / "vehicle.toml").write_text(find_config("vehicles", "qball2").read_text())
    imu = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    (flight / "imu.csv").write_text(imu + "\n0.0,0,0,0,0,0,9.8\n")
    columns = "t_s,m1_rad_s,m2_rad_s,m3_rad_s,m4_rad_s"
    (flight / "motors.csv").write_text(columns + "\n0.0,1,2,three,4\n")
    done = groundstation("identify", str(flight), "--json", cwd=tmp_path)
    assert done.returncode == 2
    assert "motors.csv" in json.loads(done.stdout)["error"]
    assert [path.name for path in tmp_path.iterdir()] == ["flight"]


def test_a_plan_is_one_json_document_that_can_be_flown(tmp_path):
    done = groundstation("plan", "--paper", "--time-budget-s", "0.5", "--output", "plan.toml", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["schema"] == "groundstation.plan/1"
    assert document["condition_number"] < 30.0
    from groundstation.trajectory import load_plan

    assert load_plan(tmp_path / "plan.toml").condition_number == document["condition_number"]


def test_the_doctor_says_what_is_here(tmp_path):
    done = groundstation("doctor", "--json", cwd=tmp_path)
    assert done.returncode == 0
    checks = {check["name"]: check for check in json.loads(done.stdout)["checks"]}
    assert checks["packages"]["verdict"] == "ok" and checks["bus"]["verdict"] == "ok"
    assert all(check["remedy"] for check in checks.values() if check["verdict"] == "wrong")


def test_a_defect_is_a_sentence_unless_debug_is_asked_for(monkeypatch, capsys):
    from groundstation import cli
    from groundstation.commands import station

    def broken(*_):
        raise ZeroDivisionError("planted")

    monkeypatch.setattr(station, "_clock", broken)
    assert cli.main(["doctor"]) == 1
    told = capsys.readouterr().err
    assert "planted" in told and "--debug" in told and "Traceback" not in told
    with pytest.raises(ZeroDivisionError):
        cli.main(["--debug", "doctor"])


def test_pairs_and_assignments_are_read_or_refused():
    assert seconds_pair("12.0:13.5") == (12.0, 13.5)
    assert assignments(("a=1", "b=-2.5")) == {"a": 1.0, "b": -2.5}
    for wrong in ("12", "1:2:3", "a:b", "nan:3", "3:3"):
        with pytest.raises(BadInput):
            seconds_pair(wrong)
    with pytest.raises(BadInput):
        assignments(("speed",))


def test_results_go_beside_a_recording_and_never_into_any_other_input(tmp_path):
    assert result_folder(tmp_path / "a" / "flight.mcap", tmp_path / "logs") == tmp_path / "a"
    (tmp_path / "bundle").mkdir()
    assert result_folder(tmp_path / "bundle", tmp_path / "logs") == tmp_path / "logs" / "bundle"
    assert result_folder(tmp_path / "log15", tmp_path / "logs") == tmp_path / "logs" / "log15"
    flown = tmp_path / "logs" / "2026-01-01T12-00-00-x500"
    flown.mkdir(parents=True)
    (flown / "flight.mcap").touch()
    assert result_folder(flown, tmp_path / "logs") == flown, "a flight's own folder stands for its recording"


def test_progress_elsewhere_than_on_a_terminal_is_a_line_now_and_then(capsys):
    now = [0.0]
    line = ProgressLine(clock=lambda: now[0])
    for step, now[0] in enumerate((0.0, 0.2, 1.1, 1.2)):
        line.fraction(0.1 * step, f"step {step}")
    assert capsys.readouterr().err.splitlines() == ["  0 %  step 0", " 20 %  4 s left  step 2"]


def test_the_table_shows_truth_only_where_there_is_one_and_says_what_is_not_revealed():
    from groundstation.flight.client.rehearse import result_table

    found = {"value": 1.8253, "std": 0.0003, "ci95": [1.8247, 1.8259]}
    document = {
        "best": "PE",
        "methods": {"PE": {"parameters": {"mass_kg": found}}},
        "model": {},
        "not_identifiable": ["izz_kg_m2"],
    }
    declared = {"mass_kg": 1.79, "izz_kg_m2": 0.04, "rotor_lag_up_s": 0.0}
    lines = result_table(document, declared, {"mass_kg": 1.8258}).splitlines()
    assert lines[0].split()[:4] == ["parameter", "unit", "nominal", "true"]
    assert lines[2].split() == ["mass", "kg", "1.79000", "1.82580", "1.82530", "1.82470", "..", "1.82590"]
    assert "not revealed" in lines[3] and len(lines) == 4
    assert "true" not in result_table(document, declared, {})


@pytest.mark.parametrize("arguments", [["doctor"], ["doctor", "--json"], ["completion", "bash"]])
def test_a_reader_that_has_read_enough_ends_the_command_quietly(arguments):
    read, write = os.pipe()
    os.close(read)  # as `| head` leaves it
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", "groundstation.cli", *arguments],
            stdout=write, stderr=subprocess.PIPE, text=True, check=False, timeout=120,
        )  # fmt: skip
    finally:
        os.close(write)
    assert "Error" not in done.stderr and "defect" not in done.stderr, done.stderr
    assert done.returncode in (0, 2), "the command's own status"
