"""Child processes: each in a session of its own, so that a terminal's Ctrl-C reaches the station alone."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO

from groundstation.flight import timeouts


def module_command(module: str, *arguments: str) -> list[str]:
    """Run a module of this installation; ``-P`` keeps the working directory off the import path."""
    return [sys.executable, "-P", "-m", module, *arguments]


def last_line(log: Path) -> str:
    """The last line of a log file; empty when there is none."""
    text = log.read_text(encoding="utf-8", errors="replace").strip() if log.is_file() else ""
    return text.splitlines()[-1] if text else ""


class Child:
    """A running child whose output goes to a log file."""

    def __init__(self, process: subprocess.Popen[str], log: Path):
        self._process = process
        self._log = log

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def poll(self) -> int | None:
        """Exit status once it has ended."""
        return self._process.poll()

    def wait(self, timeout_s: float | None = None) -> int:
        """Wait for its end.

        Raises:
            subprocess.TimeoutExpired: it did not end in time.
        """
        return self._process.wait(timeout_s)

    def lines(self) -> Iterator[str]:
        """Lines of its standard output, if that was piped."""
        yield from self._process.stdout or ()

    def tell(self, line: str) -> None:
        """Write a line to its standard input, if that was piped; one that has ended does not hear it."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.write(line + "\n")
                self._process.stdin.flush()
            except BrokenPipeError:
                return

    def last_words(self) -> str:
        """The last line it logged; empty when there is none."""
        return last_line(self._log)

    def interrupt(self) -> None:
        """Ask it to end (SIGTERM), as a service manager would."""
        if self.poll() is None:
            self._process.terminate()

    def kill(self) -> None:
        """End it at once."""
        if self.poll() is None:
            self._process.kill()

    def stop(self, patience_s: float = timeouts.CHILD_STOP_S) -> None:
        """Ask it to end, and end it if it does not in time."""
        if not self.leave(patience_s):
            self.kill()
            self.wait()

    def leave(self, patience_s: float) -> bool:
        """Ask it to end, and leave it alone if it has not in time; whether it has."""
        self.interrupt()
        try:
            self.wait(patience_s)
        except subprocess.TimeoutExpired:
            return False
        return True


def start_child(
    command: list[str], log: Path, *, piped: bool = False, environment: Mapping[str, str] | None = None
) -> Child:
    """Start a command with its standard error in ``log``, its standard output too unless both ends are ``piped``.

    ``environment`` is added to this process's own.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a", encoding="utf-8") as sink:
        output: int | IO[str] = subprocess.PIPE if piped else sink
        input_ = subprocess.PIPE if piped else subprocess.DEVNULL
        process = subprocess.Popen(
            command,
            stdin=input_,
            stdout=output,
            stderr=sink,
            start_new_session=True,
            text=True,
            env={**os.environ, **(environment or {})},
        )
    return Child(process, log)
