"""What the core says and hears on the bus beside ``drivers.bus``: its status, its commands, the operator's lease."""

from __future__ import annotations

from typing import Literal

import msgspec

CLIENT_ALIVE = "gs/client/{client}/alive"
"""Liveliness token of a client; when it vanishes, its lease is free again."""

WAY = "the trajectory is flown "
"""Begins the sentence in which a link says how it flies the trajectory, and why so."""

IN_FLIGHT = "the vehicle is armed and in flight"
"""Begins the sentence in which a link refuses a vehicle that somebody left in the air."""

CommandName = Literal["start", "agree", "land", "abort", "kill"]
"""``start``, ``agree`` (to what is proposed, ``CoreStatus.until``), ``land`` and ``kill`` (rotors off, it falls) belong
to the holder of the lease; ``abort`` to everyone."""


class CoreCommand(msgspec.Struct, frozen=True):
    """A client's order to the core. Answered by ``drivers.bus.Answer``.

    ``sequence`` grows from order to order of a client, lease requests included, and across its restarts; an order with
    an old number is refused. An ``abort`` needs none.
    """

    name: CommandName
    client: str
    sequence: int = 0


class Lease(msgspec.Struct, frozen=True):
    """A client takes (or gives back) the operator's lease; ``force`` takes it from another.

    ``sequence`` as in :class:`CoreCommand`.
    """

    client: str
    take: bool = True
    force: bool = False
    sequence: int = 0


class LeaseAnswer(msgspec.Struct, frozen=True):
    """Whether the client holds the lease now, and who does."""

    ok: bool
    holder: str = ""
    reason: str = ""


class StreamStatus(msgspec.Struct, frozen=True):
    """One stream as it arrives.

    Attributes:
        count: samples so far.
        rate_hz: over the last second of the device's clock.
        age_s: host time since the last sample arrived.
        longest_gap_s: the longest time between two stamps so far.
        delay_s: from a stamp to its arrival, as the clocks show it (their offset included), mean of the last second.
        delay_std_s: its standard deviation.
        trouble: what is wrong with it and what to do, as a sentence; empty when nothing is.
    """

    count: int = 0
    rate_hz: float = 0.0
    age_s: float = 0.0
    longest_gap_s: float = 0.0
    delay_s: float = 0.0
    delay_std_s: float = 0.0
    trouble: str = ""


class CheckStatus(msgspec.Struct, frozen=True):
    """One item of the preflight: its name, whether it passed, what was seen, and what to do where it failed."""

    name: str
    ok: bool
    text: str


class KnownStatus(msgspec.Struct, frozen=True):
    """One parameter of a flight that lasts until it is known; None where the motion has not revealed it.

    Attributes:
        spent, at_any_time: half width over target, by the interval whose error is spent over the rest points, and by
            the one that holds at every moment; 1 or less is met.
        seconds: of excitation until the first is met, as it goes.
    """

    spent: float | None
    at_any_time: float | None
    seconds: float | None


class UntilStatus(msgspec.Struct, frozen=True):
    """Of a flight that lasts until it is known.

    Attributes:
        parameters: by name.
        text: how it stands, as a sentence.
        proposal: what the operator may agree to now; empty where there is nothing, or the station decides by itself.
        length_s, at_most_s: of the excitation as it stands, and at the most.
    """

    parameters: dict[str, KnownStatus]
    text: str
    proposal: str
    length_s: float
    at_most_s: float


class SuspectStatus(msgspec.Struct, frozen=True):
    """What the diagnosis of the flight so far holds for likely: an effect, its odds, and what it cannot be told from
    yet.
    """

    effect: str
    odds: float
    alternatives: tuple[str, ...] = ()


class CoreStatus(msgspec.Struct, frozen=True):
    """What every view shows; published about ten times a second and on every change of phase.

    Attributes:
        flight, folder, vehicle: which flight this is and where it is kept.
        phase, reason, exit_status: of the sequence (``groundstation.flight.sequence``).
        host_s: host time, simulated in lock-step.
        time_left_s: of the planned path, landing included.
        tracking_error_m: distance between where the vehicle is and where it should be.
        streams: by name.
        recorded: samples in the recording; ``lost`` batches that never arrived; ``rejected`` that did not decode.
        lease: client that may start and land.
        progress, text: of the analysis, 0..1 and in words.
        table: the newest estimates: parameter -> (nominal, estimate, low, high), absent numbers NaN.
        notes: the last sentences of the flight's log.
        checks: the preflight so far, item by item.
        signals: the newest value of every recorded signal, as ``stream/column``.
        mocap: what the motion capture's client told last: its server's clock, rate and latency, or what is wrong.
        clock_s: stamp of motion capture minus that of the IMU at one instant, (estimate, half its 95 % interval).
        until: of a flight that lasts until it is known; None for any other, and before its excitation.
        suspects: by the diagnosis of the first ``suspects_s`` seconds of excitation; empty before the first, and where
            nothing is likely.
    """

    flight: str
    folder: str
    vehicle: str
    phase: str = "idle"
    reason: str = ""
    exit_status: int | None = None
    vehicle_phase: str = ""
    real_time: bool = False
    host_s: float = 0.0
    flight_s: float = 0.0
    time_left_s: float = 0.0
    tracking_error_m: float = 0.0
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    setpoint_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    euler_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    motors: tuple[float, ...] = ()
    battery_v: float = 0.0
    streams: dict[str, StreamStatus] = {}
    recorded: int = 0
    lost: int = 0
    rejected: int = 0
    lease: str = ""
    progress: float = 0.0
    text: str = ""
    table: dict[str, tuple[float, float, float, float]] = {}
    notes: tuple[str, ...] = ()
    checks: tuple[CheckStatus, ...] = ()
    signals: dict[str, float] = {}
    clock_s: tuple[float, float] | None = None
    until: UntilStatus | None = None
    suspects: tuple[SuspectStatus, ...] = ()
    suspects_s: float = 0.0
    mocap: str = ""
