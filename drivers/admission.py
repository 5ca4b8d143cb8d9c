"""Where a session of the bus may listen, and whom a listener admits."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drivers.access import Secrets, rules

_LOOPBACK = re.compile(r"(tcp|tls)/(127\.\d+\.\d+\.\d+|localhost|\[::1\]):\d+$")
PENDING = 4096
"""Connections that may be in the making: idle ones cost a descriptor each and leave after ``ACCEPT_S``."""
ACCEPT_S = 1.0
SESSIONS = 64


def keep_inside(listen: Sequence[str], secure: Mapping[str, Any]) -> None:
    """Refuse to listen beyond this machine, unless both sides show certificates and each may do what its name may."""
    guarded = bool(secure.get("transport/link/tls/enable_mtls")) and "access_control" in secure
    for endpoint in listen:
        if not _LOOPBACK.match(endpoint) and not (guarded and endpoint.startswith("tls/")):
            raise ConnectionError(
                f"{endpoint} is not listened on: beyond this machine the bus needs certificates; "
                "use `groundstation station --share`."
            )


@contextmanager
def admission(admit: tuple[Secrets, str] | None) -> Iterator[dict[str, Any]]:
    """Settings of a listener that admits sessions by role; the file that zenoh reads the secrets from is gone after
    it.
    """
    if admit is None:
        yield {}
        return
    flight, vehicle = admit
    allow_descriptors()
    descriptor, name = tempfile.mkstemp(prefix="groundstation-")  # readable by its owner alone
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as file:
            file.writelines(f"{role}:{secret}\n" for role, secret in flight.items())
        yield {
            "transport/auth/usrpwd": {"user": "core", "password": flight["core"], "dictionary_file": name},
            "transport/unicast/accept_timeout": int(1000 * ACCEPT_S),
            "transport/unicast/accept_pending": PENDING,
            "transport/unicast/max_sessions": SESSIONS,
            "access_control": rules(vehicle),
        }
    finally:
        Path(name).unlink(missing_ok=True)


def allow_descriptors() -> None:
    """As many open connections as the system allows this process, so that idle ones do not use them up."""
    try:
        import resource
    except ImportError:  # a system without such a limit
        return
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    with suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
