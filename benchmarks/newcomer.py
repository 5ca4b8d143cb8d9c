"""A newcomer's first ten minutes, from README alone, typed into a real terminal (tmux). `python -m benchmarks.newcomer`

Every command is taken from README.md as it is printed there; one that is no longer there ends the script. `make` sets
up an environment first, which is not timed here: what it then runs is run.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "docs" / "results" / "newcomer.json"
PATIENCE_S = 600.0
BUDGET_S = 600.0
"""Ten minutes, all of it."""


def printed(readme: str, start: str) -> str:
    """The command in README that begins so, without what is said behind it."""
    lines = [line.strip() for block in re.findall(r"```\w*\n(.*?)```", readme, re.S) for line in block.splitlines()]
    found = [re.sub(r"\s{2,}#.*|\s{3,}.*$", "", line) for line in lines if line.startswith(start)]
    if not found:
        raise SystemExit(f"README.md prints no command that begins with '{start}'.")
    return found[0]


class Shell:
    """A shell in tmux."""

    def __init__(self, folder: Path):
        self._steps = 0
        self._name = f"newcomer-{os.getpid()}"
        path = f"PATH={Path(sys.executable).parent}:$PATH"
        self._tmux(
            "-f",
            "/dev/null",
            "new-session",
            "-d",
            "-x",
            "120",
            "-y",
            "40",
            "-c",
            str(folder),
            f"env {path} PS1='$ ' sh",
        )

    def _tmux(self, *arguments: str) -> str:
        environment = {k: v for k, v in os.environ.items() if k != "TMUX"} | {"TERM": "xterm-256color"}
        command = ["tmux", "-L", self._name, *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout

    def type(self, text: str) -> None:
        """A line and Enter."""
        self._tmux("send-keys", "-l", text)
        self._tmux("send-keys", "Enter")

    def press(self, *keys: str) -> None:
        """Keys without Enter."""
        self._tmux("send-keys", *keys)

    def until(self, text: str) -> float:
        """Wait until it is shown; the seconds it took."""
        began = time.monotonic()
        while text not in self._shown():
            if time.monotonic() - began > PATIENCE_S:
                raise SystemExit(f"waited {PATIENCE_S:.0f} s for '{text}':\n{self._shown()}")
            time.sleep(0.2)
        return time.monotonic() - began

    def done(self, command: str) -> float:
        """Run a command to its end, which must be a good one; the seconds it took."""
        self._steps += 1
        ended = f"step {self._steps} ended with"
        self.type(f"clear; {command}; echo {ended} $?.")
        took = self.until(f"\n{ended}")
        if f"\n{ended} 0." not in self._shown():
            raise SystemExit(f"{command} failed:\n{self._shown()}")
        return took

    def _shown(self) -> str:
        return self._tmux("capture-pane", "-p")

    def close(self) -> None:
        """End it."""
        self._tmux("kill-server")


def walk(shell: Shell, readme: str, folder: Path) -> dict[str, float]:
    """Each step of README in its order, and the seconds it took."""
    took: dict[str, float] = {}

    def step(name: str, seconds: float) -> None:
        took[name] = round(seconds, 1)
        print(f"{seconds:6.1f} s  {name}", flush=True)

    assert (
        printed(readme, "make rehearse") == "make rehearse"
        and "groundstation rehearse" in (ROOT / "Makefile").read_text()
    )
    step("groundstation -h", shell.done("groundstation -h"))
    step("make rehearse (its command)", shell.done("groundstation rehearse"))
    (first,) = (folder / "logs").glob("*/flight.mcap")
    identify = printed(readme, "groundstation identify flight.mcap").replace("flight.mcap", shlex.quote(str(first)))
    step("groundstation identify flight.mcap", shell.done(identify))
    predict = printed(readme, "groundstation predict").replace("other.mcap", str(first))
    step(
        "groundstation predict",
        shell.done(predict.replace("identification.toml", str(first.with_name("identification.toml")))),
    )
    convert = printed(readme, "groundstation convert").replace("flight.mcap", str(first))
    step("groundstation convert", shell.done(convert))
    step("groundstation doctor", shell.done(printed(readme, "groundstation doctor")))
    shell.type("clear; groundstation; echo the UI ended with $?.")
    step("the terminal UI opens", shell.until("Two keys fly a simulated drone"))
    shell.press("r")
    shell.press("s")
    step("r, s: to the excitation", shell.until("EXCITING"))
    time.sleep(15.0)
    shell.press("C-g")
    step("ctrl+g after 15 s: landed and analysed", shell.until("Trust:"))
    shell.press("q")
    step("q: back at the shell", shell.until("the UI ended with 0."))
    step("groundstation flights --trend", shell.done(printed(readme, "groundstation flights --trend")))
    return took


def main() -> int:
    """The walk; prints each step and keeps them as JSON."""
    if shutil.which("tmux") is None:
        raise SystemExit("tmux is not installed; Debian's package is tmux.")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as name:
        shell = Shell(Path(name))
        try:
            took = walk(shell, readme, Path(name))
        finally:
            shell.close()
    whole = sum(took.values()) + 15.0
    print(f"{whole:6.1f} s  in all, of {BUDGET_S:.0f}")
    document = {
        "schema": "groundstation.newcomer/1",
        "steps_s": took,
        "whole_s": round(whole, 1),
        "load": os.getloadavg()[0],
    }
    RESULTS.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 0 if whole < BUDGET_S else 1


if __name__ == "__main__":
    raise SystemExit(main())
