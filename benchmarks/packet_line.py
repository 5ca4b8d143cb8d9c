"""Two network namespaces with a line between them that delays, loses and cuts packets. As root on Linux.

The line is a pair of TUN devices whose packets pass this process, since the kernel's own emulator (netem) is not in
every kernel.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import random
import select
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

_TUNSETIFF = 0x400454CA
_TUN_NO_INFO = 0x0001 | 0x1000
_PACKET = 1 << 16


@dataclass(frozen=True, slots=True)
class Condition:
    """How a line is, each way.

    Attributes:
        delay_s, jitter_s: of each packet, uniform within the jitter; order is kept.
        loss: share of packets that never arrive.
        cut: nothing arrives.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    cut: bool = False


class PacketLine:
    """Carries packets both ways between two namespaces.

    Args:
        ends: (namespace, address with its prefix) of both.
        seed: of loss and jitter.
    """

    def __init__(self, ends: tuple[tuple[str, str], tuple[str, str]], seed: int):
        self.condition = Condition()
        self.carried = self.dropped = 0
        self._random = random.Random(seed)
        self._stop = threading.Event()
        self._ends = [_device(f"gsline{k}", *end) for k, end in enumerate(ends)]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End it; the devices go with their descriptors."""
        self._stop.set()
        self._thread.join()
        for end in self._ends:
            os.close(end)

    def _run(self) -> None:
        due: list[tuple[float, int, int, bytes]] = []
        newest, number = [0.0, 0.0], 0
        while not self._stop.is_set():
            wait_s = max(0.0, min(0.05, due[0][0] - time.monotonic())) if due else 0.05
            for ready in select.select(self._ends, [], [], wait_s)[0]:
                way, number = self._ends.index(ready), number + 1
                packet, how = os.read(ready, _PACKET), self.condition
                if how.cut or self._random.random() < how.loss:
                    self.dropped += 1
                    continue
                late_s = max(0.0, how.delay_s + self._random.uniform(-how.jitter_s, how.jitter_s))
                newest[way] = max(newest[way], time.monotonic() + late_s)
                heapq.heappush(due, (newest[way], number, way, packet))
            while due and due[0][0] <= time.monotonic():
                _, _, way, packet = heapq.heappop(due)
                os.write(self._ends[1 - way], packet)
                self.carried += 1


def _device(name: str, namespace: str, address: str) -> int:
    descriptor = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(descriptor, _TUNSETIFF, struct.pack("16sH", name.encode(), _TUN_NO_INFO))
    _ip("link", "set", name, "netns", namespace)
    for words in (("link", "set", "lo", "up"), ("addr", "add", address, "dev", name), ("link", "set", name, "up")):
        _ip("-n", namespace, *words)
    return descriptor


@contextmanager
def namespaces(*names: str) -> Iterator[None]:
    """Namespaces that are gone afterwards."""
    made: list[str] = []
    try:
        for name in names:
            _ip("netns", "add", name)
            made.append(name)
        yield
    finally:
        for name in made:
            _ip("netns", "del", name)


def _ip(*words: str) -> None:
    tool = shutil.which("ip", path=f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin") or "/sbin/ip"
    subprocess.run([tool, *words], check=True, capture_output=True)
