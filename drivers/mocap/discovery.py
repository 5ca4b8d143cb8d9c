"""Which motion-capture systems answer on the network: by broadcast where the protocol has one, else by asking hosts."""

from __future__ import annotations

import socket
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from drivers.mocap import natnet, qtm
from drivers.mocap.connection import broadcast
from drivers.mocap.session import SYSTEMS

LISTEN_S = 0.5
KNOCK_S = 0.3


@dataclass(frozen=True, slots=True)
class Found:
    """A system that answers: a key of ``SYSTEMS``, its address, and what it says of itself."""

    system: str
    host: str
    said: str = ""


def find(hosts: Iterable[str] = ()) -> list[Found]:
    """Ask everybody, and the hosts named (this one too) for what has no broadcast; each system and address once."""
    out: dict[tuple[str, str], Found] = {}
    with suppress(OSError):
        for data, host in broadcast(
            natnet.COMMAND_PORT, lambda _port: natnet.message(natnet.CONNECT, b"Ping\0"), LISTEN_S
        ):
            reader = natnet.NatNet()
            reader.feed(data, 0.0)
            if reader.server:
                out["natnet", host] = Found("natnet", host, reader.server)
    with suppress(OSError):
        for data, host in broadcast(qtm.DISCOVERY_PORT, qtm.discovery, LISTEN_S):
            said = qtm.discovered(data)
            if said is not None:
                out["qtm", host] = Found("qtm", host, said)
    for host in dict.fromkeys(["127.0.0.1", *hosts]):
        for name, system in SYSTEMS.items():
            if system.kind == "tcp" and (name, host) not in out and _listens(host, system.port):
                out[name, host] = Found(name, host)
    return list(out.values())


def _listens(host: str, port: int) -> bool:
    address, _, own = host.partition(":")
    if own:
        return False  # an address with a port is of one system, which the station file names
    try:
        with socket.create_connection((address, port), timeout=KNOCK_S):
            return True
    except OSError:
        return False
