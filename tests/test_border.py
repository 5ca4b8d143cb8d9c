"""What comes from outside: names, files, documents and sessions that mean harm."""

from __future__ import annotations

import os
import re
import socket
import stat
import struct
import zlib
from dataclasses import replace
from io import BytesIO

import lz4.frame
import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st

from drivers import bus
from drivers.access import Access, Login, new_secrets
from drivers.samples import Batch, Imu, Motors, decode_batch, encode_batch
from groundstation.cli import main
from groundstation.errors import BadInput
from groundstation.flight.client.access import read_access, write_access
from groundstation.flight.client.client import new_flight_folder
from groundstation.flight.core.recorder import sound
from groundstation.flightdata import Stream
from groundstation.outside import inside, parse_json, parse_toml
from groundstation.paths import find_config
from groundstation.recording import convert, dataflashfile, load_flight, write_bundle
from groundstation.recording.container import MAGIC, Contents, read_container
from groundstation.recording.mcapfile import write_recording_as_mcap
from groundstation.recording.recorded import recording_of
from groundstation.recording.settings import Settings
from groundstation.recording.tables import MissingField, Table
from groundstation.texts import file_name, shown
from groundstation.vehicle import load_vehicle
from studies.fuzz import fuzz
from tests.polling import eventually
from tests.recording_flight import flight


def test_mutated_inputs_over_all_readers_neither_crash_nor_hang_nor_take_a_gigabyte():
    tally = fuzz(2000, minutes=0.3)
    assert tally.total() > 50
    assert tally.crashes() == {}


@given(st.text(max_size=60))
def test_whatever_a_name_says_its_path_lies_in_the_folder(tmp_path_factory, name):
    folder = tmp_path_factory.getbasetemp()
    try:
        path = inside(folder, name)
    except BadInput as error:
        assert str(error).isprintable()
        return
    assert path.resolve().is_relative_to(folder.resolve()) and path.resolve() != folder.resolve()


@given(st.text(max_size=200))
def test_what_is_shown_is_printable_and_a_file_name_is_no_path(text):
    assert shown(text).isprintable()
    name = file_name(text)
    assert "/" not in name and not name.startswith(".") and name


@pytest.mark.parametrize("name", ["../../x", "/x/y", "a/../../x", "..", "a\x00b"])
def test_convert_stays_in_its_folder_whatever_a_topic_or_attachment_is_called(tmp_path, name):
    made = recording_of(flight(0.3))
    stream = Stream(np.array([1.0, 2.0]), np.ones((2, 1)), ("v",))
    hostile = replace(made, extras={name: stream}, files={**made.files, name: b"x"})
    source = write_recording_as_mcap(hostile, tmp_path / "a.mcap")
    before = set(tmp_path.parent.rglob("*"))
    told = convert(source, tmp_path / "deep" / "down" / "b")
    written = set(tmp_path.parent.rglob("*")) - before
    assert all(path.is_relative_to(tmp_path / "deep") for path in written)
    assert sum("its name is not one a bundle can give" in text for text in told) == 2


def test_a_vehicle_s_name_cannot_lead_out_of_the_logs(tmp_path):
    assert new_flight_folder(tmp_path, "../../x").parent == tmp_path


def test_a_link_in_a_bundle_is_not_followed(tmp_path):
    folder = write_bundle(flight(0.3), tmp_path / "b")
    (folder / "secret.txt").symlink_to("/etc/hostname")
    with pytest.raises(BadInput, match="is a link"):
        load_flight(folder)


def test_a_pipe_is_refused_and_a_refused_convert_leaves_nothing(tmp_path, capfd):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "bad.mcap").write_bytes(MAGIC + b"x")
    for source, target in (("pipe", "b"), ("bad.mcap", "b"), ("bad.mcap", "c.mcap")):
        assert main(["convert", str(tmp_path / source), str(tmp_path / target)]) == 2
    assert "a pipe" in capfd.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.mcap", "pipe"]


@pytest.mark.parametrize("text", ["a = " + "[" * 5000, "a = 1" + "0" * 4400, "a = 1" + "0" * 30])
def test_deep_nesting_and_huge_numbers_are_one_sentence(text):
    for parse, data in ((parse_toml, text), (parse_json, text.removeprefix("a = "))):
        with pytest.raises(BadInput, match="x: ") as refused:
            parse(data.encode(), "x")
        assert len(str(refused.value)) < 400


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
def test_a_small_file_cannot_expand_beyond_its_bounds(compression):
    raw = bytes(64 * 1024 * 1024 - 1)
    packed = zstandard.compress(raw) if compression == "zstd" else lz4.frame.compress(raw)
    word = compression.encode()
    body = (
        struct.pack("<QQQII", 0, 0, len(raw), zlib.crc32(raw), len(word))
        + word
        + struct.pack("<Q", len(packed))
        + packed
    )
    chunk = struct.pack("<BQ", 6, len(body)) + body
    with pytest.raises(ValueError, match="expand to more than"):
        list(read_container(BytesIO(MAGIC + chunk * 12), Contents()))


def test_what_a_forged_batch_can_say_is_bounded():
    forged = encode_batch(Batch(0, (0.0,), (Imu(0.0, (0.0,) * 3, (0.0,) * 3),))).replace(
        b"\x94\x00", b"\x94\xcf" + b"\xff" * 8, 1
    )
    with pytest.raises(ValueError, match="not a batch"):
        decode_batch(forged)
    assert not sound(Batch(0, (1e300,), (Imu(0.0, (0.0,) * 3, (0.0,) * 3),)), 4)
    assert not sound(Batch(0, (1.0,), (Motors(0.0, (1.0,) * 5),)), 4)
    assert sound(Batch(0, (1.0,), (Motors(0.0, (1.0,) * 4),)), 4)


def test_the_endpoint_is_for_its_owner_alone_and_a_foreign_one_is_not_followed(tmp_path):
    path, access = tmp_path / "core.endpoint", Access("tcp/127.0.0.1:7450", Login("operate", "s3cret"))
    write_access(path, access)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600 and read_access(path) == access
    for text, mode in (
        ("", 0o600),
        ('{"endpoint": "tcp/192.0.2.1:1", "role": "", "secret": ""}', 0o600),
        (path.read_text(), 0o644),
    ):
        path.write_text(text)
        path.chmod(mode)
        with pytest.raises(BadInput, match="not followed"):
            read_access(path)


@pytest.fixture(scope="module")
def core():
    secrets, endpoint, heard = new_secrets(), bus.loopback(bus.free_port()), []
    session = bus.open_session(listen=[endpoint], admit=(secrets, "vehicle"))

    def answer(key):
        return lambda request: heard.append((key, request)) or bus.Answer(True)

    keys = (bus.CORE_COMMAND, bus.CORE_ABORT, bus.CORE_LEASE)
    handles = [bus.serve(session, key, bus.Command, answer(key)) for key in keys]
    status = bus.DroneKeys("vehicle").status
    handles.append(bus.subscribe(session, status, bus.decoder_of(bus.DroneStatus), lambda m: heard.append((status, m))))
    yield endpoint, secrets, heard
    del handles
    session.close()


@pytest.mark.parametrize("login", [None, Login("operate", "guessed"), Login("drone", "")])
def test_without_the_secret_no_session_opens(core, login):
    with pytest.raises(ConnectionError):
        bus.open_session(connect=[core[0]], login=login, connect_timeout_s=0.5)


def landed(text: str) -> bus.DroneStatus:
    return bus.DroneStatus("landed", False, 1.0, 1.0, text)


def texts_of(heard) -> set[str]:
    return {message.text for key, message in heard if key.endswith("/status")}


@pytest.mark.parametrize(
    ("role", "may"), [("watch", {"abort"}), ("operate", {"abort", "command", "lease"}), ("drone", set())]
)
def test_a_role_gives_its_orders_and_no_others_and_only_the_drone_says_landed(core, role, may):
    endpoint, secrets, heard = core
    heard.clear()
    session = bus.open_session(connect=[endpoint], login=Login(role, secrets[role]))
    drone = bus.open_session(connect=[endpoint], login=Login("drone", secrets["drone"]))
    try:
        for leaf in ("abort", "command", "lease"):
            try:
                taken = bus.ask(session, f"gs/core/{leaf}", bus.Command("kill"), timeout_s=2.0).ok
            except ConnectionError:
                taken = False
            assert taken == (leaf in may)
        # A session's first messages may come before it knows who subscribes: both speak until the drone's is heard.
        speakers = [(session, role), (drone, "true drone")]
        said = [(bus.Publisher(s, bus.DroneKeys("vehicle").status), landed(text)) for s, text in speakers]
        assert eventually(lambda: [p.put(m) for p, m in said] and len(texts_of(heard)) == (2 if role == "drone" else 1))
    finally:
        session.close()
        drone.close()
    assert texts_of(heard) == ({"drone", "true drone"} if role == "drone" else {"true drone"})


def test_three_thousand_idle_connections_do_not_lock_the_operator_out(core):
    endpoint, secrets, _ = core
    host, port = endpoint.removeprefix("tcp/").split(":")
    idle = []
    try:
        for _ in range(3000):
            idle.append(socket.create_connection((host, int(port)), timeout=5.0))
        session = bus.open_session(connect=[endpoint], login=Login("operate", secrets["operate"]))
        assert bus.ask(session, bus.CORE_ABORT, bus.Command("abort")).ok
        session.close()
    finally:
        for connection in idle:
            connection.close()


@pytest.mark.parametrize("value", ["1e200", "1e-200", "inf", "nan"])
def test_numbers_beyond_any_vehicle_are_refused_where_they_enter(tmp_path, value):
    text = find_config("vehicles", "x500").read_text()
    (tmp_path / "x500.toml").write_text(re.sub(r"speed_max_rad_s = \S+", f"speed_max_rad_s = {value}", text))
    with pytest.raises(BadInput, match=r"rotors\.speed_max_rad_s"):
        load_vehicle(tmp_path / "x500.toml")


def test_a_log_whose_own_layout_has_texts_for_numbers_and_numbers_for_names_is_read_without_them():
    rows = np.frombuffer(b"abcd" * 8, dtype=np.uint8)
    table = Table("PARM", 0, {"Name": (0, "<f4", 1.0), "Value": (0, "S4", 1.0)}, rows, np.arange(0, 32, 4))
    assert dataflashfile._words(table, "Name") is None and dataflashfile._words(table, "Else") is None
    assert dataflashfile._settings({"PARM": table}) == Settings()
    with pytest.raises(MissingField, match="Value with numbers"):
        table.column("Value")


def test_a_name_that_the_system_does_not_take_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(BadInput, match="cannot name a file"):
        inside(tmp_path, "Ü" * 200)
