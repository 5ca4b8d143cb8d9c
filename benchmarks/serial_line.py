"""A serial line that is not there: two pseudo-terminals joined at the speed of a baud rate, as a telemetry radio joins
them.

    python -m benchmarks.serial_line 57600      # prints the two devices, then relays until interrupted

Give one to ``groundstation sim --mavlink --link serial://DEVICE:57600`` and the other to ``groundstation fly --link``.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import signal
import sys
import time
import tty

BUFFER = 4096


class Direction:
    """One way: bytes leave at the line's rate, and what comes while the buffer is full is lost, as in a radio."""

    def __init__(self, source: int, sink: int, bytes_per_s: float):
        self.source, self.sink, self.rate = source, sink, bytes_per_s
        self.waiting = bytearray()
        self.lost = 0
        self._allowed, self._last_s = 0.0, time.monotonic()

    def take(self) -> None:
        """Read what is there."""
        data = os.read(self.source, 65536)
        room = max(0, BUFFER - len(self.waiting))
        self.waiting += data[:room]
        self.lost += max(0, len(data) - room)

    def give(self) -> None:
        """Write what the line has carried by now."""
        now = time.monotonic()
        self._allowed = min(self._allowed + self.rate * (now - self._last_s), 0.05 * self.rate)
        self._last_s = now
        count = min(int(self._allowed), len(self.waiting))
        if count:
            with contextlib.suppress(BlockingIOError):  # nobody reads at the other end: lost, as on the air
                os.write(self.sink, self.waiting[:count])
            del self.waiting[:count]
            self._allowed -= count


def main() -> None:
    """Relay until interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):  # a shell's background jobs ignore the first
        signal.signal(number, signal.default_int_handler)
    rate = int(sys.argv[1]) / 10.0
    (a, a_name), (b, b_name) = (_terminal() for _ in range(2))
    print(a_name, b_name, flush=True)
    ways = [Direction(a, b, rate), Direction(b, a, rate)]
    try:
        while True:
            ready, _, _ = select.select([a, b], [], [], 0.002)
            for way in ways:
                if way.source in ready:
                    way.take()
                way.give()
    except KeyboardInterrupt:
        print(f"lost {ways[0].lost} bytes one way, {ways[1].lost} the other", flush=True)


def _terminal() -> tuple[int, str]:
    master, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, os.ttyname(slave)


if __name__ == "__main__":
    main()
