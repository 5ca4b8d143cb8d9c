"""A relay between an autopilot and a station that breaks what passes, and says what the vehicle really does.

python benchmarks/relay.py STATION_PORT [VEHICLE_PORT]

It knows MAVLink by itself (the standard library alone; no code of the link's): frames, checksums, four messages. The
vehicle speaks to ``vehicle_port``, which the first line of output names; the station waits on STATION_PORT. Orders come
as lines of JSON on standard input: {"cut": seconds, "way": "up" | "down" | "both"}, {"loss": share}, {"delay":
seconds}, {"frames": name, "count": n, "per_s": rate} (see KINDS), {"stranger": name, "per_s": rate, "seconds": s}. What
it sees leaves as lines of JSON, at most ten a second and on each change.
"""

from __future__ import annotations

import json
import random
import select
import socket
import struct
import sys
import time

HEARTBEAT, ATTITUDE, POSITION, COMMAND, EXTENDED, SETPOINT = 0, 30, 32, 76, 245, 84
SEEDS = {
    HEARTBEAT: 50,
    ATTITUDE: 39,
    POSITION: 185,
    COMMAND: 152,
    EXTENDED: 130,
    SETPOINT: 143,
    31: 246,
    105: 93,
    147: 154,
    1: 124,
    36: 222,
    253: 83,
    77: 143,
    22: 220,
    111: 34,
    241: 90,
    230: 163,
    331: 91,
    375: 251,
    251: 170,
}
SIZES = {
    HEARTBEAT: 9,
    ATTITUDE: 28,
    POSITION: 28,
    EXTENDED: 2,
    31: 48,
    105: 63,
    147: 54,
    1: 43,
    36: 37,
    253: 54,
    77: 10,
    22: 25,
    111: 16,
    241: 32,
    230: 42,
    331: 232,
    375: 140,
    251: 18,
}
IMPOSSIBLE = (b"\x00\x00\x80\x7f", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\xff", b"\xff\xff\x7f\x7f")


def crc(data: bytes) -> int:
    """CRC-16/MCRF4XX, bit by bit of the standard's description."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0x8408 if value & 1 else value >> 1
    return value


def pack(number: int, payload: bytes, system: int = 1, component: int = 1, sequence: int = 0) -> bytes:
    """A MAVLink 2 frame."""
    head = struct.pack(
        "<BBBBBBBHB", 0xFD, len(payload), 0, 0, sequence & 0xFF, system, component, number & 0xFFFF, number >> 16
    )
    return head + payload + struct.pack("<H", crc(head[1:] + payload + bytes([SEEDS.get(number, 0)])))


def frames(data: bytes):
    """(message, system, component, payload) of the MAVLink 2 frames of one datagram; checksums are the other ends'
    business.
    """
    at = 0
    while at + 12 <= len(data) and data[at] == 0xFD:
        size = data[at + 1]
        number = data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16
        yield number, data[at + 5], data[at + 6], data[at + 10 : at + 10 + size].ljust(SIZES.get(number, 33), b"\0")
        at += 12 + size + (13 if data[at + 2] & 1 else 0)


class Hostile:
    """Frames that nobody honest sends, by kind."""

    def __init__(self, seed: int):
        self.random = random.Random(seed)
        self.sequence = 0

    def frame(self, kind: str) -> bytes:
        """One of a kind of KINDS."""
        return KINDS[kind](self)

    def _packed(self, number: int, payload: bytes, system: int = 1, component: int = 1) -> bytes:
        self.sequence += 1
        return pack(number, payload, system, component, self.sequence)

    def infinite_attitude(self) -> bytes:
        """The one frame that once ended the link."""
        return self._packed(ATTITUDE, struct.pack("<I6f", 1000, float("inf"), 0, 0, 0, 0, 0))

    def impossible(self) -> bytes:
        """A message the link uses, in the autopilot's name, its floats impossible; never a word about mode or
        arming.
        """
        number = self.random.choice([n for n in SIZES if n not in (HEARTBEAT, EXTENDED, 22, 77, 111, 253, 1)])
        payload = b"".join(self.random.choice(IMPOSSIBLE) for _ in range((SIZES[number] + 3) // 4))
        return self._packed(number, payload[: SIZES[number]])

    def any_content(self) -> bytes:
        """Any bytes in the autopilot's name, of any message but its heartbeat and landed state."""
        number = self.random.choice([n for n in SIZES if n not in (HEARTBEAT, EXTENDED)])
        return self._packed(number, self.random.randbytes(SIZES[number]))

    def component(self) -> bytes:
        """Another component of the vehicle claims to be 3 m away."""
        return self._packed(
            POSITION, struct.pack("<I6f", int(time.monotonic() * 1e3) & 0xFFFFFFFF, 3, 0, -1, 0, 0, 0), 1, 197
        )

    def unknown(self) -> bytes:
        """A message nobody knows."""
        return self._packed(0xF00000 | self.random.randrange(65536), self.random.randbytes(self.random.randrange(256)))

    def damaged(self) -> bytes:
        """A frame with a wrong checksum."""
        raw = bytearray(self.any_content())
        raw[-1] ^= 0x55
        return bytes(raw)

    def noise(self) -> bytes:
        """Random bytes, start markers among them."""
        return self.random.randbytes(self.random.randrange(1, 300)).replace(b"\x00", b"\xfd")

    def garbage(self) -> bytes:
        """60 kB of start markers."""
        return b"\xfe" * 60_000


KINDS = {
    name: getattr(Hostile, name)
    for name in (
        "infinite_attitude",
        "impossible",
        "any_content",
        "component",
        "unknown",
        "damaged",
        "noise",
        "garbage",
    )
}
KINDS["mixed"] = lambda self: self.frame(
    self.random.choices(("impossible", "component", "unknown", "damaged", "noise"), (4, 2, 2, 1, 1))[0]
)
KINDS["all"] = lambda self: self.frame("any_content" if self.random.random() < 0.3 else "mixed")


class Relay:
    """Passes datagrams on, or does not."""

    def __init__(self, station_port: int, vehicle_port: int = 0):
        self.vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.vehicle.bind(("127.0.0.1", vehicle_port))
        self.station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.station.bind(("127.0.0.1", 0))
        self.stranger = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stranger.bind(("127.0.0.1", 0))
        self.to_station = ("127.0.0.1", station_port)
        self.to_vehicle: tuple[str, int] | None = None
        self.cuts = {"up": 0.0, "down": 0.0}
        self.loss, self.delay = 0.0, 0.0
        self.random, self.hostile = random.Random(7), Hostile(7)
        self.queue: list[tuple[float, socket.socket, bytes, tuple[str, int]]] = []
        self.inject: dict | None = None
        self.seen: dict[str, object] = {
            "mode": None,
            "armed": None,
            "landed": None,
            "height": None,
            "mode_orders": 0,
            "mode_orders_passed": 0,
            "setpoints": 0,
            "stranger_got": 0,
            "injected": 0,
            "injected_in_air": 0,
            "beats_up": 0,
            "longest_up_gap_s": 0.0,
        }
        self.up_s = self.told_s = 0.0
        print(json.dumps({"vehicle_port": self.vehicle.getsockname()[1]}), flush=True)

    def run(self) -> None:
        """Until standard input ends."""
        inputs = [self.vehicle, self.station, self.stranger, sys.stdin]
        while True:
            ready, _, _ = select.select(inputs, [], [], 0.002)
            now = time.monotonic()
            for one in ready:
                if one is sys.stdin:
                    line = sys.stdin.readline()
                    if not line:
                        return
                    self.order(json.loads(line), now)
                else:
                    data, address = one.recvfrom(65536)
                    self.take(one, data, address, now)
            self.drive(now)
            if now - self.told_s > 0.1:
                self.tell(now)

    def order(self, order: dict, now: float) -> None:
        """Carry one out."""
        if "cut" in order:
            for way in ("up", "down") if order["way"] == "both" else (order["way"],):
                self.cuts[way] = now + order["cut"]
        self.loss = order.get("loss", self.loss)
        self.delay = order.get("delay", self.delay)
        if "frames" in order or "stranger" in order:
            self.inject = {**order, "begun": now, "sent": 0}

    def take(self, one: socket.socket, data: bytes, address: tuple[str, int], now: float) -> None:
        """A datagram arrived."""
        if one is self.stranger:
            self.seen["stranger_got"] = int(self.seen["stranger_got"]) + 1  # type: ignore[call-overload]
            return
        way = "down" if one is self.vehicle else "up"
        if way == "down":
            self.to_vehicle = address
            self.note_vehicle(data, now)
        else:
            self.note_station(data, now)
        if now < self.cuts[way]:
            return
        target, out = (self.to_station, self.station) if way == "down" else (self.to_vehicle, self.vehicle)
        if target is None:
            return
        copies = [data] if self.random.random() >= self.loss else []
        if copies and self.random.random() < self.loss:
            copies.append(data)
        if copies and self.random.random() < self.loss:
            damaged = bytearray(data)
            damaged[self.random.randrange(len(damaged))] ^= 1 << self.random.randrange(8)
            copies = [bytes(damaged)]
        late = self.random.random() * 0.05 if self.random.random() < self.loss else 0.0
        for copy in copies:
            if self.delay + late > 0.0:
                self.queue.append((now + self.delay + late, out, copy, target))
            else:
                out.sendto(copy, target)

    def drive(self, now: float) -> None:
        """Send what is due: delayed datagrams, and hostile ones."""
        due = [item for item in self.queue if item[0] <= now]
        self.queue = [item for item in self.queue if item[0] > now]
        for _, out, data, target in due:
            out.sendto(data, target)
        job = self.inject
        if job is None:
            return
        owed = int((now - job["begun"]) * job["per_s"]) - job["sent"]
        out = self.stranger if "stranger" in job else self.station
        for _ in range(min(owed, 60)):
            out.sendto(self.hostile.frame(job.get("frames") or job["stranger"]), self.to_station)
            job["sent"] += 1
            self.seen["injected"] = int(self.seen["injected"]) + 1  # type: ignore[call-overload]
            self.seen["injected_in_air"] = int(self.seen["injected_in_air"]) + (self.seen["landed"] != 1)  # type: ignore[call-overload]
        if job["sent"] >= job.get("count", 1 << 60) or now - job["begun"] > job.get("seconds", 1e9):
            self.inject = None

    def note_vehicle(self, data: bytes, now: float) -> None:
        """What the vehicle says of itself."""
        before = {k: self.seen[k] for k in ("mode", "armed", "landed")}
        for number, _, component, payload in frames(data):
            if component != 1:
                continue
            if number == HEARTBEAT:
                mode, _, _, base, _, _ = struct.unpack("<IBBBBB", payload[:9])
                self.seen["mode"], self.seen["armed"] = mode, bool(base & 128)
            elif number == EXTENDED:
                self.seen["landed"] = payload[1]
            elif number == POSITION:
                self.seen["height"] = round(-struct.unpack("<I6f", payload[:28])[3], 3)
        if before != {k: self.seen[k] for k in before}:
            self.tell(now)

    def note_station(self, data: bytes, now: float) -> None:
        """What the station orders."""
        if self.up_s:
            self.seen["longest_up_gap_s"] = max(float(self.seen["longest_up_gap_s"]), round(now - self.up_s, 3))  # type: ignore[arg-type]
        self.up_s = now
        for number, _, _, payload in frames(data):
            if number == SETPOINT:
                self.seen["setpoints"] = int(self.seen["setpoints"]) + 1  # type: ignore[call-overload]
            elif number == HEARTBEAT:
                self.seen["beats_up"] = int(self.seen["beats_up"]) + 1  # type: ignore[call-overload]
            elif number == COMMAND and struct.unpack("<H", payload[28:30])[0] in (176, 21):
                for name in ("mode_orders", "mode_orders_passed")[: 1 + (now >= self.cuts["up"])]:
                    self.seen[name] = int(self.seen[name]) + 1  # type: ignore[call-overload]

    def tell(self, now: float) -> None:
        """One line."""
        self.told_s = now
        print(json.dumps({"at_s": now, **self.seen}), flush=True)


if __name__ == "__main__":
    Relay(*map(int, sys.argv[1:3])).run()
