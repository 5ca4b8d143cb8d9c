"""The terminal UI in a real terminal (tmux), from its start to the report of a simulated flight, at two sizes.

    python -m benchmarks.tui_terminal [--size 80x24] [--size 200x60] [--show]

It types what a person would (r, s, then 4, 5, 6), reads what the terminal shows, and prints how long each step took and
what the UI's process cost while the flight was recorded at full rates. The terminal has 256 colours and no mouse.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PATIENCE_S = 300.0


class Terminal:
    """A tmux server of its own with one window."""

    def __init__(self, width: int, height: int, folder: Path):
        self._name = f"gs-{os.getpid()}-{width}"
        command = shlex.join([sys.executable, "-P", "-m", "groundstation.cli"])
        self._tmux("new-session", "-d", "-x", str(width), "-y", str(height), "-c", str(folder), f"exec {command}")
        self.process = int(self._tmux("list-panes", "-F", "#{pane_pid}"))

    def _tmux(self, *arguments: str) -> str:
        environment = {k: v for k, v in os.environ.items() if k not in ("COLORTERM", "TMUX")}
        done = subprocess.run(
            ["tmux", "-L", self._name, *arguments],  # noqa: S607
            check=True,
            capture_output=True,
            text=True,
            env=environment | {"TERM": "xterm-256color"},
        )
        return done.stdout

    def press(self, *keys: str) -> None:
        """Type."""
        self._tmux("send-keys", *keys)

    def screen(self) -> str:
        """What it shows."""
        return self._tmux("capture-pane", "-p")

    def until(self, *texts: str) -> float:
        """Wait until one of the texts is shown; returns the seconds it took."""
        began = time.monotonic()
        while not any(text in self.screen() for text in texts):
            if time.monotonic() - began > PATIENCE_S:
                raise SystemExit(f"waited {PATIENCE_S:.0f} s for {texts} in vain:\n{self.screen()}")
            time.sleep(0.1)
        return time.monotonic() - began

    def cpu_s(self) -> float:
        """Processor time of the UI's process."""
        fields = Path(f"/proc/{self.process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def close(self) -> None:
        """End it."""
        self._tmux("kill-server")


def run(width: int, height: int, *, show: bool) -> None:
    """One flight."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        began = time.monotonic()
        terminal = Terminal(width, height, folder)
        try:
            opened = terminal.until("Two keys fly a simulated drone")
            terminal.press("r")
            terminal.press("s")
            flying = terminal.until("AIRBORNE")
            terminal.until("EXCITING")
            cpu_s, at = terminal.cpu_s(), time.monotonic()
            shown = [terminal.screen()]
            landing = terminal.until("LANDING")
            share = (terminal.cpu_s() - cpu_s) / (time.monotonic() - at)
            terminal.until("analysis", "preliminary", "reading the recording", "(best)")
            terminal.press("4")
            report = terminal.until("(best)")
            for key, text in (("4", "(best)"), ("5", "verdict:"), ("6", "sorted by")):
                terminal.press(key)
                terminal.until(text)
                shown.append(terminal.screen())
            (found,) = folder.glob("logs/*/report.html")
            print(
                f"{width}x{height}: opened {opened:.1f} s, two keys to the air {flying:.1f} s, excitation "
                f"{landing:.0f} s, report {report:.0f} s after landing began ({found.stat().st_size / 1e6:.1f} MB), "
                f"{time.monotonic() - began:.0f} s in all; UI process {100 * share:.0f} % of a core while exciting",
                flush=True,
            )
            for text in shown if show else ():
                print(f"{'─' * width}\n{text}")
        finally:
            terminal.close()


def main() -> None:
    """Each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", action="append", help="columns x rows; 80x24 and 200x60 by default")
    parser.add_argument("--show", action="store_true", help="print the screens as the terminal showed them")
    arguments = parser.parse_args()
    if shutil.which("tmux") is None:
        raise SystemExit("tmux is not installed; Debian's package is tmux.")
    for size in arguments.size or ("80x24", "200x60"):
        width, height = map(int, size.split("x"))
        run(width, height, show=arguments.show)


if __name__ == "__main__":
    main()
