"""Follows a station on another machine, flight after flight.

What its screens read of a flight is fetched into a folder here.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from drivers.access import Access
from groundstation.flight.messages import CoreStatus
from groundstation.flight.sequence import FINAL
from groundstation.flight.share.files import fetch
from groundstation.flight.share.messages import Shared
from groundstation.flight.share.passes import Pass, pass_for
from groundstation.flight.share.remote import RemoteClient, connect, place_of, status_of
from groundstation.texts import file_name
from groundstation.tui.watch import CoreWatch

AGAIN_S = 2.0
"""Until a station that was not there is looked for again."""


class StationWatch(CoreWatch):
    """A client of a station's gate, for as long as the program runs. A station that is not there is looked for again.

    Args:
        host: of the station.
        shown: the pass.
        keep: where flights' files go, each into a folder of its own.
        clock: monotonic seconds.

    Attributes:
        flight: which is shown; empty before the first.
        heard: the station has said something since the program started.
    """

    def __init__(self, host: str, shown: Pass, keep: Path, clock: Callable[[], float] = time.monotonic):
        self._host, self._pass = host, shown
        self._keep = keep / file_name(shown.station, "station")
        self.flight, self.heard = "", False
        super().__init__(Access(f"tls/{host}"), self._keep, clock)
        self.place = shown.station

    @property
    def following(self) -> bool:
        """A flight is being followed that has not ended."""
        return super().following and bool(self.flight) and (self.newest is None or self.newest.phase not in FINAL)

    def _run(self) -> None:
        self.may_operate, self.name = self._pass.role == "operate", self._pass.name
        while not self._stop.is_set():
            try:
                with connect(self._host, self._pass) as client:
                    self._client = client
                    client.require_heard()
                    self.fault = ""
                    self._follow_station(client)
            except (ConnectionError, OSError) as error:
                self.fault = str(error)
            finally:
                self._client = None
            self._stop.wait(AGAIN_S)

    def _follow_station(self, client: RemoteClient) -> None:
        while not self._stop.is_set():
            shared = client.shared(0.2)
            if shared is None:
                continue
            self.heard = True
            status = status_of(shared)
            if status is not None:
                self._see(client, shared, status)

    def _see(self, client: RemoteClient, shared: Shared, status: CoreStatus) -> None:
        new, ended = status.flight != self.flight, status.phase in FINAL
        before = self.newest.phase if self.newest is not None else ""
        if new:
            fetch(client.file, status.flight, self._keep)
            self.folder = self._keep / file_name(status.flight, "flight")
            self.history.clear()
            self.flight = status.flight
            if self.may_operate and not ended:
                client.take_lease()
        elif ended and before not in FINAL:
            fetch(client.file, status.flight, self._keep)
        if shared.fresh or new:
            self._take(status)


def watch_station(host: str) -> StationWatch:
    """Follow the station on another machine, with the pass that was accepted for it.

    Raises:
        BadInput: no pass is for it.
    """
    place_of(host)
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    return StationWatch(host, pass_for(host), cache / "groundstation")
