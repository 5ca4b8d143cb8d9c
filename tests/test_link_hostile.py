"""What others send cannot end the link, hold its setpoints up, take the vehicle's place or be believed in its name."""

from __future__ import annotations

import math
import random
import socket
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mavlink_vehicle import Rig

from drivers.mavlink.codec import MavlinkCodec
from drivers.mavlink.dialect import MESSAGES, mavlink
from drivers.mavlink.transports import UdpTransport
from drivers.samples import Event
from groundstation.flight.link.phase import Phase

BOTH = pytest.mark.parametrize("kind", ["px4", "arducopter"])
BAD = (math.inf, -math.inf, math.nan, 3e38, -3e38)


FLYING = Rig("px4")
FLYING.run(lambda: FLYING.core.view is not None, 3.0)


def told(rig: Rig) -> list[str]:
    return [s.text for s, _ in rig.samples if isinstance(s, Event)]


def from_vehicle(rig: Rig, *messages) -> None:
    """Frames in the vehicle's name, once."""
    frames = [rig.vehicle.codec.encode(m) for m in messages]
    before = rig.down

    def down(own: list[bytes]) -> list[bytes]:
        rig.down = before
        return [*before(own), *frames]

    rig.down = down


def attitude(rig: Rig, value: float):
    return mavlink.MAVLink_attitude_message(int(rig.vehicle.device_s * 1e3), value, 0, 0, 0, 0, 0)


@BOTH
@pytest.mark.parametrize("value", BAD)
def test_an_attitude_that_cannot_be_is_refused_told_and_flown_past(kind, value):
    rig = Rig(kind)
    rig.excite()
    rig.vehicle.intervals.pop(31, None)  # so that ATTITUDE is what the link goes by
    from_vehicle(rig, attitude(rig, value))
    rig.wait(0.1)
    assert rig.phase is Phase.FOLLOWING
    assert any("ATTITUDE: roll is" in text and "not believed" in text for text in told(rig))


def test_a_handler_that_fails_is_counted_told_and_skipped():
    rig = Rig("px4")
    rig.excite()

    def fails(_m):
        raise ZeroDivisionError("a fault of ours")

    rig.core._telemetry._handlers["BATTERY_STATUS"] = fails
    assert rig.finish() and rig.reason == ""
    said = [text for text in told(rig) if "a fault of ours" in text]
    assert 2 <= len(said) <= 3 and "(10 so far)" in said[1], "told at the first, the tenth, the hundredth time"


def hostile(rng: random.Random, vehicle) -> bytes:
    """A valid frame in the vehicle's name with any content: bytes of any message, floats made impossible often."""
    kind = MESSAGES[rng.choice(sorted(MESSAGES))]
    size = kind.unpacker.size
    payload = bytearray(rng.randbytes(size)) if rng.random() < 0.7 else bytearray(b"\xff" * size)
    for at in range(0, size - 3, 4):
        if rng.random() < 0.3:
            payload[at : at + 4] = rng.choice((b"\x00\x00\x80\x7f", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\xff"))
    m = mavlink.MAVLink_message(kind.id, kind.msgname)
    raw = m._pack(vehicle.codec._packer, kind.crc_extra, bytes(payload))
    vehicle.codec._packer.seq = (vehicle.codec._packer.seq + 1) % 256
    return raw


@BOTH
def test_any_content_in_the_vehicles_name_ends_at_worst_in_a_landing(kind):
    seed = 20261129
    print("seed", seed)
    rng = random.Random(seed)
    rig = Rig(kind)
    rig.excite()
    clean = rig.down
    rig.down = lambda own: [*clean(own), *(hostile(rng, rig.vehicle) for _ in range(15))]
    rig.wait(2.0)
    rig.down = clean
    assert rig.finish() or rig.phase is Phase.RELEASED, "a frame of a pilot's mode makes the station let go"
    assert not any("could not be taken in" in text for text in told(rig)), "the gate is to catch it"


def test_the_guard_and_its_orders_run_though_nothing_can_be_decoded_any_more():
    rig = Rig("px4")
    rig.excite()

    def fails(*_args, **_options):
        raise MemoryError("a fault of ours")

    rig.core._inlet.codecs["vehicle"].decode = fails  # type: ignore[method-assign]
    begun = rig.now_s
    assert rig.run(lambda: rig.vehicle.mode == rig.vehicle.land, 2.0)
    assert (rig.now_s - begun < 1.5 and "nothing from the vehicle" in rig.reason) or "no position" in rig.reason
    assert any("what arrived could not be taken in" in text for text in told(rig))


@settings(deadline=None, max_examples=60)
@given(st.lists(st.tuples(st.sampled_from(["vehicle", "10.0.0.9:1"]), st.binary(max_size=300)), max_size=20))
def test_no_bytes_raise_through_a_step_of_the_link(datagrams):
    core = FLYING.core
    out = core.step(core._stepped_s + 0.01, datagrams)
    assert isinstance(out.send, list)


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=600), st.booleans())
def test_no_bytes_raise_through_the_codec(data, datagram):
    codec = MavlinkCodec()
    for received in codec.decode(
        data + codec.encode(mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0)), datagram=datagram
    ):
        assert received.frame.raw


@BOTH
def test_garbage_of_strangers_is_told_and_costs_no_setpoint(kind):
    rig = Rig(kind)
    rig.excite()
    begun, step = rig.now_s, rig.core.step
    noise = [(f"10.0.0.9:{port}", b"\xfe" * 60_000) for port in range(5)]
    rig.core.step = lambda now_s, incoming: step(now_s, [*noise, *incoming])  # type: ignore[method-assign]
    spent = time.process_time()
    rig.wait(0.6)
    spent = time.process_time() - spent
    assert rig.phase is Phase.FOLLOWING, rig.reason
    assert sum(t > begun + 0.02 for t, _ in rig.vehicle.setpoints) >= 25, "50 setpoints a second"
    assert spent < 3.0, "300 datagrams of 60 kB: a second of one core would be 2 ms each"
    assert any("strangers on the port" in text for text in told(rig))


def test_a_crowd_that_spoke_first_keeps_no_vehicle_out():
    rig = Rig("px4")
    step = rig.core.step
    crowd = [(f"10.0.0.9:{port}", b"\xfd\xfe" * 20) for port in range(200)]
    rig.core.step = lambda now_s, incoming: step(now_s, [*crowd, *incoming])  # type: ignore[method-assign]
    rig.prepare()
    assert rig.core.peer == "vehicle" and len(rig.core._inlet.codecs) == 1


@BOTH
@pytest.mark.parametrize("noise", [b"\xfe" * 60_000, b"\xfd\x01\x00\x00\x00\x01\x01\x39\x30\x00" * 6_000])
def test_garbage_from_the_vehicles_own_address_is_bounded_in_every_step(kind, noise):
    rig = Rig(kind)
    rig.excite()
    begun = rig.now_s
    step, longest = rig.core.step, [0.0]

    def noisy(now_s, incoming):
        before = time.process_time()
        out = step(now_s, [*incoming, ("vehicle", noise)] if now_s < begun + 0.05 else incoming)
        longest[0] = max(longest[0], time.process_time() - before)
        return out

    rig.core.step = noisy  # type: ignore[method-assign]
    rig.wait(1.0)
    assert longest[0] < 0.1, "one datagram of 60 kB took 160 ms and more of a busy machine before"
    assert rig.setpoints_after(begun + 0.02) > 20 or rig.phase is Phase.LANDING


@BOTH
def test_after_a_cut_another_sender_gets_nothing(kind):
    rig = Rig(kind)
    rig.excite()
    clean, step, begun = rig.down, rig.core.step, rig.now_s
    stranger = MavlinkCodec(1, 1)

    def another(now_s, incoming):
        beat = mavlink.MAVLink_heartbeat_message(2, 12 if kind == "px4" else 3, 0, 0, 4, 3)
        here = mavlink.MAVLink_local_position_ned_message(int((now_s - begun) * 1e3) + 777_000, 0, 0, 0, 0, 0, 0)
        frames = [stranger.encode(beat), stranger.encode(here)]
        return step(now_s, [*incoming, *(("10.0.0.9:14550", frame) for frame in frames)])

    rig.core.step = another  # type: ignore[method-assign]
    rig.down = rig.up = lambda frames: []
    rig.wait(6.5)
    assert rig.core.peer == "vehicle"
    assert any("its clock is another's" in text for text in told(rig))
    rig.down = rig.up = clean
    assert rig.finish() and rig.core.peer == "vehicle"


def test_in_flight_the_vehicle_is_followed_to_a_new_address_where_its_clock_goes_on():
    rig = Rig("px4")
    rig.excite()
    where, step = ["vehicle"], rig.core.step
    rig.core.step = lambda now_s, incoming: step(now_s, [(where[0], d) for _, d in incoming])  # type: ignore[method-assign]
    clean = rig.down
    rig.down = lambda frames: []
    rig.wait(1.2)
    rig.down, where[0] = clean, "10.0.0.5:14580"
    assert rig.finish()
    assert rig.core.peer == "10.0.0.5:14580"
    assert any("moved from vehicle to 10.0.0.5:14580" in text for text in told(rig))
    clean, where[0] = rig.down, "10.0.0.6:14580"
    rig.wait(2.0)
    assert rig.core.peer == "10.0.0.5:14580", "on the ground the operator decides"
    assert any("start the link again" in text for text in told(rig))


def test_udp_answers_nobody_but_who_the_link_says():
    transport = UdpTransport("127.0.0.1", 0, listen=True, forget_s=0.0)
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
    try:
        for end in ends:
            end.settimeout(2.0)
            end.sendto(b"hello", ("127.0.0.1", transport.port))
        peers = []
        while len(peers) < 2:
            transport.wait(1.0)
            peers += [peer for peer, _ in transport.read()]
        transport.answer(peers[0])
        ends[1].sendto(b"and again", ("127.0.0.1", transport.port))
        transport.wait(1.0)
        transport.read()
        transport.write(b"setpoint")
        assert ends[0].recv(100) == b"setpoint"
        ends[1].setblocking(False)
        with pytest.raises(BlockingIOError):
            ends[1].recv(100)
    finally:
        transport.close()
        for end in ends:
            end.close()


@BOTH
def test_another_component_of_the_vehicle_is_recorded_and_not_believed(kind):
    rig = Rig(kind, keep_raw=True)
    rig.excite()
    beside = MavlinkCodec(1, 197)
    far = mavlink.MAVLink_local_position_ned_message(int(rig.vehicle.device_s * 1e3) + 5, 3.0, 0, -1.0, 0, 0, 0)
    frame = beside.encode(far)
    raws: list[bytes] = []
    step = rig.core.step

    def watched(now_s, incoming):
        out = step(now_s, incoming)
        raws.extend(s.data for s, _ in out.samples if type(s).__name__ == "Raw")
        return out

    rig.core.step = watched  # type: ignore[method-assign]
    clean = rig.down
    rig.down = lambda own: [*clean(own), frame]
    rig.wait(0.2)
    assert rig.phase is Phase.FOLLOWING, rig.reason
    assert frame in raws
    assert any("component 197" in text for text in told(rig))
    assert rig.finish() and rig.reason == ""
