"""Look at the motion-capture systems on the network: what each tracks, how well, and what to do about the rest."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.mocap.discovery import Found
from drivers.mocap.health import Health, Summary
from drivers.mocap.session import SYSTEMS, Session
from drivers.secure import Identity, read_identity
from groundstation.flight import timeouts
from groundstation.flight.mocap_judging import Track, body_row, faults

MOST_BODIES = 50


@dataclass(frozen=True, slots=True)
class SystemSurvey:
    """One system.

    Attributes:
        found: where it is.
        server: name and version.
        bodies: figures by name; those that were never seen have None.
        clock_error_s: within what stamps are known; None before they are.
        clock: how the server's clock is known.
        up: the axis it says points up.
        faults: what is wrong, one sentence each.
    """

    found: Found
    server: str
    bodies: Mapping[str, Summary | None]
    clock_error_s: float | None
    clock: str
    up: str
    faults: tuple[str, ...]

    def document(self) -> dict[str, object]:
        """For JSON."""
        return {
            "system": self.found.system,
            "host": self.found.host,
            "server": self.server,
            "clock": self.clock,
            "clock_error_s": self.clock_error_s,
            "up": self.up or None,
            "bodies": {name: None if s is None else body_row(s) for name, s in self.bodies.items()},
            "faults": list(self.faults),
        }


@dataclass(slots=True)
class _Watched:
    health: Health = field(default_factory=Health)
    rows: list[tuple[float, ...]] = field(default_factory=list)


def _shown(host: str) -> Identity | None:
    if not host.startswith("tls/"):
        return None
    from groundstation.flight.share.passes import station_file

    return read_identity(station_file())


def survey(found: Found, seconds: float = 3.0, body: str = "") -> SystemSurvey:
    """Watch one system for a while.

    Args:
        body: the one wanted: its absence is a fault, and zenoh is asked for it alone.
    """
    try:
        session = Session(found.system, found.host, body, identity=_shown(found.host))
    except OSError as error:
        return SystemSurvey(found, found.said, {}, None, "", "", (f"cannot be reached: {error}",))
    watched: dict[str, _Watched] = {}
    trouble = ""
    try:
        _watch(session, watched, seconds)
    except OSError as error:
        trouble = str(error)
    finally:
        session.close()
    return _judged(found, session, watched, [trouble] if trouble else [], body)


def survey_all(systems: Iterable[Found], seconds: float = 3.0) -> list[SystemSurvey]:
    """Each in turn."""
    return [survey(found, seconds) for found in systems]


def _watch(session: Session, watched: dict[str, _Watched], seconds: float) -> None:
    until_s, seen = time.monotonic() + timeouts.MOCAP_FIRST_FRAME_S, False
    while time.monotonic() < until_s:
        for arrived in session.poll():
            if not seen:
                seen, until_s = True, time.monotonic() + seconds
            for body in arrived.frame.bodies:
                if len(watched) < MOST_BODIES or body.name in watched:
                    each = watched.setdefault(body.name, _Watched())
                    each.health.take(arrived, body)
                    each.rows.append((arrived.stamp_s, *body.position_m, *body.quaternion))
            for name in arrived.frame.lost:
                if name in watched:
                    watched[name].health.take(arrived, None)


def _judged(found: Found, session: Session, watched: dict[str, _Watched], out: list[str], wanted: str) -> SystemSurvey:
    reader, now_s = session.reader, time.monotonic()
    tracks = {name: _track(name, each.rows) for name, each in watched.items()}
    summaries = {name: each.health.summary(now_s, 60.0) for name, each in watched.items()}
    out += [reader.trouble] if reader.trouble and reader.trouble not in out else []
    for name, track in tracks.items():
        out += faults(track, summaries[name], [t for t in tracks.values() if t is not track])
    missing = [name for name in reader.names if name not in watched]
    out += [f"'{name}' is known and not seen" for name in missing]
    if wanted and wanted not in watched and wanted not in missing and not wanted.isdigit():
        out.append(f"there is no body '{wanted}'; there are {', '.join(reader.names) or 'none'}")
    if reader.up == "y":
        out.append('it says that y points up: write `up = "y"` under [mocap] in the station file')
    if session.strangers():
        out.append(f"another server sends on the same group ({', '.join(session.strangers())}); it is not listened to")
    known = session.clock.now
    method = "" if known is None else known.method
    if SYSTEMS[found.system].delay.error_s:
        method += ", delay after the exposure untold"
    bodies: dict[str, Summary | None] = {**summaries, **dict.fromkeys(missing)}
    error_s = None if known is None else session.error_s()
    return SystemSurvey(found, reader.server or found.said, bodies, error_s, method, reader.up, tuple(out))


def _track(name: str, rows: list[tuple[float, ...]]) -> Track:
    table = np.array(sorted(rows))
    return Track(name, table[:, 0], table[:, 1:4], table[:, 4:8])
