"""Waiting for another process or thread that runs on a clock of its own, so that there is none to inject."""

from __future__ import annotations

import time
from collections.abc import Callable


def eventually(condition: Callable[[], object], within_s: float = 20.0, every_s: float = 0.02) -> bool:
    """Whether a condition comes true within a time, asked again and again."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(every_s)
    return bool(condition())
