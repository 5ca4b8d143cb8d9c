"""What keeps this computer's clock: chrony, PTP or systemd-timesyncd, as far as they are there and say so."""

from __future__ import annotations

import re
import shutil
import subprocess

from groundstation.flight import timeouts


def host_time_sync() -> list[str]:
    """One sentence for each that answers; empty where none does."""
    out = [
        told
        for command, read in (
            (("chronyc", "-c", "tracking"), chrony),
            (("pmc", "-u", "-b", "0", "GET TIME_STATUS_NP"), ptp),
            (("timedatectl", "show", "--property=NTPSynchronized"), timesyncd),
        )
        if (text := _asked(command)) is not None and (told := read(text))
    ]
    return out


def _asked(command: tuple[str, ...]) -> str | None:
    if shutil.which(command[0]) is None:
        return None
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=timeouts.CLOCK_DAEMON_S, errors="replace"
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return done.stdout if done.returncode == 0 else None


def chrony(text: str) -> str:
    """Of ``chronyc -c tracking``: name of the source, offset and its bound (half the root delay plus dispersion)."""
    fields = text.strip().split(",")
    try:
        name, offset, delay, dispersion = fields[1], float(fields[4]), float(fields[10]), float(fields[11])
    except (IndexError, ValueError):
        return ""
    if not name:
        return "chrony runs and follows no source"
    return f"chrony follows {name}: off by {1e6 * offset:+.0f} us, within {1e6 * (0.5 * delay + dispersion):.0f} us"


def ptp(text: str) -> str:
    """Of ``pmc GET TIME_STATUS_NP``: whether a grandmaster is there, and the offset from it."""
    offset, present = re.search(r"master_offset\s+(-?\d+)", text), re.search(r"gmPresent\s+(\w+)", text)
    if offset is None:
        return ""
    if present is not None and present[1] != "true":
        return "PTP runs without a grandmaster"
    return f"PTP follows a grandmaster: off by {float(offset[1]) / 1e3:+.1f} us"


def timesyncd(text: str) -> str:
    """Of ``timedatectl show``."""
    return "the system's clock is synchronised by NTP" if "NTPSynchronized=yes" in text else ""
