"""What the link says by itself: frames signed and numbered, heartbeats, and the questions and answers of TIMESYNC."""

from __future__ import annotations

from math import inf

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import Message, mavlink
from drivers.mavlink.signing import Signing
from drivers.mavlink.timesync import Timesync
from drivers.samples import Raw
from groundstation.flight import timeouts
from groundstation.flight.link.options import Options, Output

ASKED = 50
"""Questions of TIMESYNC that may be open; of more the oldest are forgotten."""


class Voice:
    """One link's sending side.

    Attributes:
        clock: the vehicle's clock against ours, by the answers.
    """

    def __init__(self, options: Options, signing: Signing | None):
        self.clock = Timesync()
        self._options = options
        self._sender = MavlinkCodec(signing=signing)
        self._heartbeat_s = self._timesync_s = -inf
        self._sync_sent: dict[int, float] = {}

    def send(self, message: Message, now_s: float, out: Output) -> None:
        """One message; it goes into the recording where frames are kept."""
        raw = self._sender.encode(message)
        out.send.append(raw)
        if self._options.keep_raw:
            out.samples.append((Raw(now_s, "out", raw), now_s))

    def heartbeat(self, now_s: float, out: Output) -> None:
        """A ground station's, when one is due."""
        if now_s - self._heartbeat_s < timeouts.HEARTBEAT_EVERY_S:
            return
        self._heartbeat_s = now_s
        station = mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID
        self.send(mavlink.MAVLink_heartbeat_message(*station, 0, 0, mavlink.MAV_STATE_ACTIVE, 3), now_s, out)

    def ask_time(self, now_s: float, out: Output) -> None:
        """A question of TIMESYNC, when one is due."""
        on_a_line = self._options.bytes_per_s is not None
        every = timeouts.TIMESYNC_ON_A_LINE_EVERY_S if on_a_line else timeouts.TIMESYNC_EVERY_S
        if now_s - self._timesync_s < every:
            return
        self._timesync_s = now_s
        stamp = int(now_s * 1e9)
        self._sync_sent[stamp] = now_s
        if len(self._sync_sent) > ASKED:
            del self._sync_sent[next(iter(self._sync_sent))]
        self.send(mavlink.MAVLink_timesync_message(0, stamp), now_s, out)

    def timesync(self, m: Message, now_s: float, out: Output) -> None:
        """Answer the vehicle's questions; use its answers to ours."""
        if m.tc1 == 0:
            self.send(mavlink.MAVLink_timesync_message(int(now_s * 1e9), m.ts1), now_s, out)
        elif (sent_s := self._sync_sent.pop(m.ts1, None)) is not None:
            self.clock.add(sent_s, m.tc1 * 1e-9, now_s)
