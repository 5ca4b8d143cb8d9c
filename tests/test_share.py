"""A station and its views on other machines: who is let in, what each may do, and what a lost connection costs.

All on loopback.
"""

from __future__ import annotations

import datetime
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import pytest
from textual.widgets import Static

from drivers import bus
from drivers.access import Access, Login, new_secrets
from drivers.mocap.session import Session
from drivers.samples import Pose
from drivers.secure import ClientKeys, Identity, poses_rules, secured
from groundstation.cli import main
from groundstation.errors import BadInput
from groundstation.flight import sequence as seq
from groundstation.flight.client.access import write_access
from groundstation.flight.core.lease import OperatorLease
from groundstation.flight.core.orders import ClientOrders
from groundstation.flight.journal import ENDPOINT_FILE, WATCH_FILE
from groundstation.flight.link.pose_source import PoseSource
from groundstation.flight.messages import CLIENT_ALIVE, CoreCommand, CoreStatus, Lease, LeaseAnswer
from groundstation.flight.share import passes, remote
from groundstation.flight.share.certificates import Owner, issue, new_authority
from groundstation.flight.share.files import fetch, read_part
from groundstation.flight.share.messages import PART_BYTES
from groundstation.flight.share.passes import Pass
from groundstation.flight.share.sharing import Cameras, publish_poses, share
from groundstation.flight.station import MocapSource
from groundstation.paths import find_config
from groundstation.tui.app import GroundStation
from groundstation.tui.remote import StationWatch
from groundstation.vehicle import load_vehicle
from sim.mocap.published import ZenohPublisher
from sim.mocap.scene import Seen
from sim.mocap.wire import Shot

PATIENCE_S = 20.0
NOW = datetime.datetime.now(datetime.UTC)


def wait_for(condition: Callable[[], object], what: str) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s, f"waited in vain for {what}"
        time.sleep(0.02)


class Core:
    """The doors of a core: its bus with its secrets, its lease, its orders; a status whenever it is told to."""

    def __init__(self, folder: Path):
        self.folder, self.events = folder, []
        self.lease = OperatorLease()
        self.phase = seq.Phase.CHECKED
        orders = ClientOrders(
            self.lease, time.monotonic, lambda: self.phase, lambda run: run(), self.events.append, lambda: ""
        )
        endpoint, secrets = bus.loopback(bus.free_port()), new_secrets()
        folder.mkdir(parents=True)
        write_access(folder / ENDPOINT_FILE, Access(endpoint, Login("operate", secrets["operate"])))
        write_access(folder / WATCH_FILE, Access(endpoint, Login("watch", secrets["watch"])))
        self.session = bus.open_session(listen=[endpoint], admit=(secrets, "vehicle"))
        self._status = bus.Publisher(self.session, bus.CORE_STATUS)
        self._handles = [
            bus.serve(self.session, bus.CORE_COMMAND, CoreCommand, orders.command),
            bus.serve(self.session, bus.CORE_ABORT, CoreCommand, orders.abort),
            bus.serve(self.session, bus.CORE_LEASE, Lease, orders.lease),
            bus.watch_alive(self.session, CLIENT_ALIVE.format(client="*"), self.lease.client_alive),
        ]

    def say(self, flight_s: float = 1.0) -> None:
        self._status.put(
            CoreStatus(
                self.folder.name, str(self.folder), "qball2", self.phase, flight_s=flight_s, lease=self.lease.holder
            )
        )


@dataclass
class Place:
    """A station that is shared at ``host``, with a core behind it."""

    core: Core
    host: str
    said: list[str] = field(default_factory=list)

    @property
    def endpoint(self) -> str:
        return f"tls/{self.host}"


@contextmanager
def running(target: Callable[[threading.Event], None]) -> Iterator[None]:
    stop = threading.Event()
    thread = threading.Thread(target=target, args=(stop,))
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path


@pytest.fixture
def place(home: Path) -> Iterator[Place]:
    """The station's own loopback address is another one than its clients': 127.0.0.2."""
    core = Core(home / "logs" / "flight")
    here = Place(core, f"127.0.0.2:{bus.free_port()}")
    with running(lambda stop: share(home / "logs", here.endpoint, ["127.0.0.2"], stop, here.said.append)):
        wait_for(lambda: here.said, "the gate")
        yield here
    core.session.close()


def invited(place: Place, name: str, role: passes.PassRole) -> Pass:
    """A pass that the running gate has taken up."""
    made = passes.invite(name, role, ["127.0.0.2"], NOW)
    wait_for(lambda: any(name in line for line in place.said), "the gate to take the pass up")
    return made


def hears(client: remote.RemoteClient, core: Core) -> CoreStatus:
    """The flight's status, through the gate."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        core.say()
        shared = client.shared(0.2)
        if shared is not None and shared.fresh and (status := remote.status_of(shared)) is not None:
            return status
    raise AssertionError("nothing of the flight was heard")


def test_a_viewer_sees_the_flight_and_aborts_it_and_may_do_nothing_else(place: Place) -> None:
    wall = invited(place, "wall", "watch")
    with remote.connect(place.host, wall) as client:
        assert hears(client, place.core).flight == "flight"
        assert "may watch and abort" in client.command("start").reason
        assert not client.take_lease().ok
        for key, request in (
            (client._keys.command, CoreCommand("start", "wall", 1)),
            (client._keys.lease, Lease("wall")),
        ):
            with pytest.raises(ConnectionError):  # one that ignores its role
                bus.ask(client._session, key, request, bus.Answer, 2.0)
        assert place.core.events == [] and place.core.lease.holder == ""
        assert client.command("abort").ok
    assert place.core.events == [seq.AbortRequested("aborted by wall")]


def test_the_lease_s_holder_arms_and_an_order_played_back_is_refused(place: Place) -> None:
    ours = invited(place, "laptop", "operate")
    with remote.connect(place.host, ours) as client:
        hears(client, place.core)
        assert "needs the operator's lease" in client.command("start").reason
        assert client.take_lease().ok and place.core.lease.holder == "laptop"
        order = CoreCommand("start", "whatever it calls itself", time.time_ns())
        assert bus.ask(client._session, client._keys.command, order).ok
        assert "not newer" in bus.ask(client._session, client._keys.command, order).reason
        assert place.core.events == [seq.StartRequested()]
    wait_for(lambda: place.core.lease.holder == "", "the lease of a view that has gone")


def test_one_pass_does_not_speak_in_another_s_name(place: Place) -> None:
    other, ours = invited(place, "other", "operate"), invited(place, "laptop", "operate")
    with remote.connect(place.host, ours) as client:
        hears(client, place.core)
        with pytest.raises(ConnectionError):
            bus.ask(client._session, ClientKeys(other.name).lease, Lease(other.name), LeaseAnswer, 2.0)
        with pytest.raises(ConnectionError):
            bus.ask(client._session, bus.CORE_ABORT, CoreCommand("abort", "laptop"), bus.Answer, 2.0)
    assert place.core.lease.holder == ""


def test_who_has_no_pass_of_this_station_is_not_let_in(place: Place) -> None:
    wall = invited(place, "wall", "watch")
    foreign = issue(new_authority("elsewhere", NOW), Owner("wall"), NOW)
    stolen = Identity(wall.identity.authority, foreign.certificate, foreign.key)
    host, port = remote.place_of(place.host)
    for shown, why in ((foreign, "cannot prove to be the station"), (stolen, "does not take this certificate")):
        with pytest.raises(ConnectionError):
            bus.open_session(connect=[place.endpoint], secure=secured(shown), connect_timeout_s=0.5)
        assert why in remote.why_not(host, port, shown)
    nothing = {k: v for k, v in secured(wall.identity).items() if "connect_" not in k and "listen_" not in k}
    for endpoint, settings in ((place.endpoint, nothing), (f"tcp/{place.host}", None)):
        with pytest.raises(ConnectionError):
            bus.open_session(connect=[endpoint], secure=settings, connect_timeout_s=0.5)
    assert "nobody answers" in remote.why_not("127.0.0.2", bus.free_port(), wall.identity)


def test_a_camera_s_certificate_opens_no_view_and_a_viewer_s_is_no_station(home: Path) -> None:
    wall, cameras = passes.invite("wall", "watch", (), NOW), passes.invite("cameras", "poses", ["127.0.0.2"], NOW)
    endpoint = f"tls/127.0.0.2:{bus.free_port()}"
    for listener, client in ((wall, cameras), (cameras, cameras), (wall, wall)):
        session = bus.open_session(listen=[endpoint], secure=secured(listener.identity, rules=poses_rules()))
        with session, pytest.raises(ConnectionError):
            bus.open_session(connect=[endpoint], secure=secured(client.identity), connect_timeout_s=0.5)


def test_a_withdrawn_pass_is_good_for_nothing_at_once_and_its_name_is_used_up(place: Place) -> None:
    wall = invited(place, "wall", "watch")
    with remote.connect(place.host, wall) as client:
        hears(client, place.core)
        passes.withdraw("wall")
        wait_for(lambda: "nobody" in place.said[-1], "the gate to take it up")
    with remote.connect(place.host, wall) as client:
        with pytest.raises(ConnectionError, match="withdrawn"):
            client.require_heard()
        with pytest.raises(ConnectionError, match="withdrawn"):
            client.command("abort")
    with pytest.raises(BadInput, match="withdrawn"):
        passes.invite("wall", "operate", (), NOW)
    assert place.core.events == []


@pytest.mark.parametrize(
    "endpoint", ["tcp/0.0.0.0:7447", "tcp/192.0.2.1:7447", "tls/0.0.0.0:7451", "udp/127.0.0.1:7447"]
)
def test_nothing_listens_beyond_this_machine_without_certificates(home: Path, endpoint: str) -> None:
    own = passes.renew_station((), NOW)
    for settings in (None, secured(own.identity)):  # the latter admits whoever has a pass, to everything
        with pytest.raises(ConnectionError, match="needs certificates"):
            bus.open_session(listen=[endpoint], secure=settings)


class Relay:
    """Carries bytes between a view and a gate, until it is cut; a cut line says nothing to either side."""

    def __init__(self, host: str):
        self._target = remote.place_of(host)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.host = f"127.0.0.1:{self._server.getsockname()[1]}"
        self.cut = threading.Event()
        self._lines: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(self._target)
                self._lines += [near, far]
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=self._carry, args=(a, b), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while data := source.recv(1 << 16):
                if not self.cut.is_set():
                    sink.sendall(data)

    def close(self) -> None:
        for line in (*self._lines, self._server):
            line.close()


def test_a_lost_connection_frees_the_lease_and_touches_no_flight_and_comes_back(place: Place) -> None:
    ours = invited(place, "laptop", "operate")
    relay = Relay(place.host)
    try:
        with remote.connect(relay.host, ours) as client:
            hears(client, place.core)
            assert client.take_lease().ok
            relay.cut.set()
            wait_for(lambda: place.core.lease.holder == "", "the lease of a view that is not heard")
            assert place.core.events == [], "nobody asked for anything"
            relay.cut.clear()
            assert hears(client, place.core).flight == "flight"
            assert client.take_lease().ok
            assert client.command("abort").ok
    finally:
        relay.close()
    assert place.core.events == [seq.AbortRequested("aborted by the operator")]


def test_a_gate_that_ends_leaves_the_flight_alone(home: Path) -> None:
    core = Core(home / "logs" / "flight")
    endpoint, said = f"tls/127.0.0.2:{bus.free_port()}", []
    passes.invite("laptop", "operate", (), NOW)
    with running(lambda stop: share(home / "logs", endpoint, ["127.0.0.2"], stop, said.append)):
        wait_for(lambda: said, "the gate")
    assert core.events == [] and core.lease.holder == ""
    core.session.close()


def test_a_view_reads_what_its_screens_show_and_nothing_else(place: Place, tmp_path: Path) -> None:
    folder = place.core.folder
    report = bytes(range(256)) * (PART_BYTES // 100)
    (folder / "report.html").write_bytes(report)
    (folder / "plan.toml").symlink_to(folder / ENDPOINT_FILE)
    (folder / "flight.mcap").write_bytes(b"recording")
    for name in ("plan.toml", "flight.mcap", ENDPOINT_FILE, "../flight/report.html", "report.html\0"):
        assert not read_part(folder, name, 0).ok
    wall = invited(place, "wall", "watch")
    with remote.connect(place.host, wall) as client:
        hears(client, place.core)
        assert fetch(client.file, "flight", tmp_path / "kept") == ["report.html"]
    assert (tmp_path / "kept" / "flight" / "report.html").read_bytes() == report


def test_poses_of_a_camera_computer_come_with_certificates(home: Path) -> None:
    cameras = passes.invite("cameras", "poses", ["127.0.0.2"], NOW)
    served, endpoint, said = bus.free_port(), f"tls/127.0.0.2:{bus.free_port()}", []
    capture = Cameras("zenoh", f"127.0.0.1:{served}")
    vehicle = load_vehicle(find_config("vehicles", "x500"))
    source = ZenohPublisher(served)
    reader = PoseSource(MocapSource(system="zenoh", host=endpoint, body="drone"), vehicle)  # as the link has it
    try:
        with running(lambda stop: publish_poses(capture, endpoint, cameras, stop, said.append)):
            got, number, end_s = [], 0, time.monotonic() + PATIENCE_S
            while len(got) < 20 and time.monotonic() < end_s:
                number, now_s = number + 1, time.monotonic()
                seen = (Seen("drone", 1, ((0.1, 0.2, 1.0), (1.0, 0.0, 0.0, 0.0)), 0.0004),)
                source.send(Shot(number, now_s - 0.004, now_s, seen))
                got += [sample for sample, _ in reader.read() if isinstance(sample, Pose)]
                time.sleep(0.01)
            assert len(got) >= 20 and all(pose.position_m == (0.1, 0.2, 1.0) for pose in got)
            assert abs(got[-1].device_s - time.monotonic()) < 5.0, "stamps are on the station's clock"
            with pytest.raises(OSError):  # without a certificate nobody reads them
                Session("zenoh", endpoint, "drone")
    finally:
        reader.close()
        source.close()


def test_a_pass_from_invitation_to_the_end(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def said(*arguments: str, status: int = 0) -> dict:
        assert main(["station", *arguments, "--json"]) == status
        return json.loads(capfd.readouterr().out)

    file = home / "laptop.pass"
    made = said("--invite", "laptop", "--role", "operate", "--out", str(file))
    assert made["role"] == "operate" and file.stat().st_mode & 0o077 == 0
    assert "has a pass already" in said("--invite", "laptop", "--out", str(home / "b"), status=2)["error"]
    assert "--address" in said("--invite", "cameras", "--role", "poses", status=2)["error"]
    assert "names no pass" in said("--invite", "../x", "--out", str(home / "c"), status=2)["error"]
    file.chmod(0o755)  # as on a stick
    assert said("--accept", str(file))["name"] == "laptop"
    assert said()["given"] == [{"name": "laptop", "role": "operate", "until": made["until"], "withdrawn": False}]
    assert "nobody answers" in said("--abort", f"127.0.0.1:{bus.free_port()}", status=5)["error"]
    assert "nobody answers" in said("--watch", f"127.0.0.1:{bus.free_port()}", status=2)["error"]
    for name, role in (("phone", "watch"), ("spare", "operate")):
        said("--invite", name, "--role", role, "--out", str(home / name))
        said("--accept", str(home / name))
    assert len(said()["accepted"]) == 3
    assert passes.pass_for("10.0.0.9:7451").role == "operate", "certificates prove who answers, whatever its address"
    said("--withdraw", "laptop")
    assert said()["given"][0]["withdrawn"] is True
    file.write_text(file.read_text().replace("BEGIN CERTIFICATE", "BEGIN NOTHING"))
    assert "damaged" in said("--accept", str(file), status=2)["error"]
    file.write_bytes(b"{" * 100)
    assert "is not a pass" in said("--accept", str(file), status=2)["error"]
    past = issue(new_authority("x", NOW), Owner("y"), NOW - datetime.timedelta(days=9), days=8)
    old = msgspec.structs.replace(passes.accepted()[0], certificate=past.certificate.decode())
    passes.write_pass(file, old)
    assert "held until" in said("--accept", str(file), status=2)["error"]
    for path in (home / "config" / "groundstation" / "stations").iterdir():
        passes.write_pass(path, old)
    with pytest.raises(BadInput, match="held until"):
        passes.pass_for("lab")


async def test_the_screens_follow_another_station_and_abort_its_flight(place: Place, tmp_path: Path) -> None:
    wall = invited(place, "wall", "watch")
    (place.core.folder / "plan.toml").write_bytes(find_config("plans", "paper_table2").read_bytes())
    watch = StationWatch(place.host, wall, tmp_path / "kept")
    app = GroundStation(tmp_path / "logs", remote=watch)

    async def until(condition: Callable[[], object]) -> None:
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, "waited in vain"
            place.core.say()
            await pilot.pause(0.05)

    def line() -> str:
        return "".join(str(widget.content) for widget in app.screen.query("#flight-line").results(Static))

    async with app.run_test(size=(120, 40)) as pilot:
        await until(lambda: watch.flight == "flight" and app.station.limits.room and "ready to start" in line())
        assert wall.station in line() and watch.folder == tmp_path / "kept" / wall.station / "flight"
        app.station.prepare_flight()
        assert not app.station.preparing and not app.station.may_take_lease
        assert "may watch and abort" in watch.order("start")
        await pilot.press("ctrl+g")
        await until(lambda: place.core.events)
        assert place.core.events == [seq.AbortRequested("aborted by wall")]
        place.core.phase = seq.Phase.ABORTED
        (place.core.folder / "refused.json").write_text("{}")
        await until(lambda: watch.newest is not None and watch.newest.phase == seq.Phase.ABORTED)
        assert (watch.folder / "refused.json").is_file() and not watch.following


def test_a_station_without_a_pass_is_not_shown(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["--station", "lab"]) == 2
    assert "no pass was accepted here" in capfd.readouterr().err
