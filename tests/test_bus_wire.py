"""The bus over a real loopback link: typed requests, losses counted, garbage survived, liveliness."""

from __future__ import annotations

import contextlib
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers import bus
from drivers.samples import Batch, Imu, decode_batch, encode_batch


@pytest.fixture(scope="module")
def pair():
    endpoint = bus.loopback(bus.free_port())
    core = bus.open_session(listen=[endpoint])
    drone = bus.open_session(connect=[endpoint])
    yield core, drone
    drone.close()
    core.close()


def _ask_when_up(session, key, request, kind=bus.Answer):
    for _ in range(50):  # declarations travel on their own time
        try:
            return bus.ask(session, key, request, kind, timeout_s=2.0)
        except ConnectionError:
            threading.Event().wait(0.02)
    raise AssertionError(f"no queryable appeared on {key}")


def test_a_request_is_decoded_answered_and_a_foreign_one_is_refused_with_the_reason(pair):
    core, drone = pair
    keys = bus.DroneKeys("asked")
    seen: list[bus.Command] = []

    def order(command: bus.Command) -> bus.Answer:
        seen.append(command)
        return bus.Answer(False, "not on Sundays")

    queryable = bus.serve(drone, keys.command, bus.Command, order)
    assert _ask_when_up(core, keys.command, bus.Command("arm")) == bus.Answer(False, "not on Sundays")
    answer = bus.ask(core, keys.command, bus.Credit(1.0))
    assert not answer.ok and "not understood" in answer.reason
    assert seen == [bus.Command("arm")]
    queryable.undeclare()


def test_asking_nobody_is_an_error_that_names_the_key(pair):
    with pytest.raises(ConnectionError, match="gs/nobody/command"):
        bus.ask(pair[0], bus.DroneKeys("nobody").command, bus.Command("arm"), timeout_s=0.2)


def test_publications_arrive_in_order_and_undecodable_ones_are_counted(pair):
    core, drone = pair
    keys = bus.DroneKeys("speaks")
    arrived: list[float] = []
    done = threading.Event()

    def on_credit(message: bus.Credit) -> None:
        arrived.append(message.host_s)
        if message.host_s >= 999.0:
            done.set()

    subscription = bus.subscribe(core, keys.credit, bus.decoder_of(bus.Credit), on_credit)
    publisher = bus.Publisher(drone, keys.credit, lossless=True)
    for _ in range(200):
        publisher.put(bus.Credit(-1.0))
        if arrived:
            break
        threading.Event().wait(0.01)
    publisher.put(b"\xc1 garbage")
    for i in range(1000):
        publisher.put(bus.Credit(float(i)))
    assert done.wait(5.0)
    assert [t for t in arrived if t >= 0.0] == [float(i) for i in range(1000)]
    assert subscription.rejected == 1


def test_bursts_from_a_process_that_stood_still_arrive_whole(pair):
    """A hundred batches at once, two seconds' worth, on the publisher that never blocks; thirty times."""
    core, drone = pair
    seen, arrived = [], threading.Event()

    def take(batch: Batch) -> None:
        seen.append(batch.sequence)
        if batch.sequence % 100 == 0:
            arrived.set()

    subscription = bus.subscribe(core, "gs/burst/samples", decode_batch, take)
    publisher = bus.Publisher(drone, "gs/burst/samples")
    samples = tuple(Imu(0.001 * i, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)) for i in range(25))
    batches = [encode_batch(Batch(n, (0.0,) * 25, samples)) for n in range(3001)]
    while not arrived.wait(0.05):
        publisher.put(batches[0])
    seen.clear()
    for burst in range(30):
        arrived.clear()
        for batch in batches[100 * burst + 1 : 100 * burst + 101]:
            publisher.put(batch)
        arrived.wait(5.0)
    assert [n for n in seen if n] == list(range(1, 3001))
    subscription.close()


def test_a_token_is_seen_to_come_and_go(pair):
    core, drone = pair
    came, went = threading.Event(), threading.Event()
    watch = bus.watch_alive(core, bus.DroneKeys("*").alive, lambda _key, up: (came if up else went).set())
    with bus.alive(drone, bus.DroneKeys("lives").alive):
        assert came.wait(5.0)
        assert not went.is_set()
    assert went.wait(5.0)
    watch.undeclare()


def test_nothing_listens_beyond_loopback_and_a_dead_endpoint_is_an_error():
    assert bus.loopback(7447).startswith("tcp/127.0.0.1:")
    with pytest.raises(ConnectionError, match="cannot be opened"):
        bus.open_session(connect=[bus.loopback(bus.free_port())], connect_timeout_s=0.2)


@given(st.binary(max_size=200), st.integers(0, 199), st.integers(1, 255))
def test_one_flipped_byte_breaks_the_checksum(plan, place, flip):
    upload = bus.make_upload(plan)
    assert bus.checksum_holds(bus.decode(bus.encode(upload), bus.Upload))
    if plan:
        damaged = bytearray(plan)
        damaged[place % len(plan)] ^= flip
        assert not bus.checksum_holds(bus.Upload("toml", bytes(damaged), upload.crc32))


@given(st.binary(max_size=60))
def test_any_bytes_decode_or_are_a_value_error(data):
    for kind in (bus.Credit, bus.DroneStatus, bus.Upload, bus.Command, bus.Answer):
        with contextlib.suppress(ValueError):
            assert isinstance(bus.decode(data, kind), kind)


@pytest.mark.parametrize("name", ["", "a/b", "two words", "all*", "x?y"])
def test_a_name_that_is_no_key_is_refused(name):
    with pytest.raises(ValueError, match="cannot name a drone"):
        bus.DroneKeys(name)
