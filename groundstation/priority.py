"""A process's place in the queue for the processor."""

from __future__ import annotations

import os
import time
from pathlib import Path

AUTOGROUP = Path("/proc/self/autogroup")
TRIES, PAUSE_S = 5, 0.15
"""Linux takes one change of a session's value in a tenth of a second from all users together."""


def set_nice(nice: int) -> bool:
    """Set this process's nice value (-20 first, 19 last) against all others; whether the system took it.

    Desktop Linux shares the processor between sessions first and between the processes of a session after that
    (autogroup, man 7 sched). A process that leads a session of its own, as those of a flight do, is alone there: its
    nice value has no effect until the session has it too.
    """
    try:
        os.setpriority(os.PRIO_PROCESS, 0, nice)
        if os.getsid(0) == os.getpid() and AUTOGROUP.exists():
            return _set_session(nice)
    except OSError:
        return False
    return True


def _set_session(nice: int) -> bool:
    for _ in range(TRIES):
        try:
            AUTOGROUP.write_text(f"{nice}\n", encoding="ascii")
        except BlockingIOError:
            time.sleep(PAUSE_S)
        else:
            return True
    return False
