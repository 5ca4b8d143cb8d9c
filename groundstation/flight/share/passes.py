"""Files of a station's certificates: its authority, the list of who has a pass, the passes, and those of other
stations.

In the user's settings folder: ``share/authority.json`` and ``share/station.json`` (keys of this station),
``share/list.json`` (who may do what), and ``stations/NAME.json`` (passes for other stations). A *pass* is one file:
whom it is for, the station's addresses, certificate and private key. It is made at the station and carried to the
machine that uses it. All are for their owner alone.
"""

from __future__ import annotations

import datetime
import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar, cast

import msgspec

from drivers.secure import PASS_ROLES, STATION, Identity, PassRole
from groundstation.errors import BadInput
from groundstation.flight.share.certificates import Authority, Owner, addresses_of, expires, issue, new_authority
from groundstation.outside import require_file, require_own
from groundstation.paths import settings_dir
from groundstation.texts import file_name, shown
from groundstation.writing import write_private

_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,31}")
PASS_BYTES = 64 * 1024
F = TypeVar("F", bound=msgspec.Struct)


class Signer(msgspec.Struct, frozen=True):
    """The file of the authority."""

    certificate: str
    key: str


class Pass(msgspec.Struct, frozen=True):
    """A machine's certificate, and what it is good for.

    Attributes:
        station: name of the station it is for.
        addresses: by which that station was called when the pass was made; of a camera computer its own.
        name, role: of its owner.
        authority, certificate, key: PEM.
    """

    station: str
    addresses: tuple[str, ...]
    name: str
    role: str
    authority: str
    certificate: str
    key: str
    schema: str = "groundstation.pass/1"

    @property
    def identity(self) -> Identity:
        """What a session shows."""
        return Identity(self.authority.encode(), self.certificate.encode(), self.key.encode())

    @property
    def expires(self) -> datetime.datetime:
        """Until when it holds."""
        return expires(self.certificate.encode())


class Entry(msgspec.Struct, frozen=True):
    """Who has a pass: what for, until when, and whether it was withdrawn."""

    role: PassRole
    until: str
    withdrawn: bool = False


Listed = dict[str, Entry]


def share_dir() -> Path:
    """Keys of this station, and the list of its passes."""
    return settings_dir() / "share"


def list_file() -> Path:
    """Who has a pass."""
    return share_dir() / "list.json"


def station_file() -> Path:
    """This station's own certificate; the driver of a camera computer's poses reads it too."""
    return share_dir() / "station.json"


def listed() -> Listed:
    """Who has a pass of this station, by name.

    Raises:
        BadInput: the list is damaged, or not this user's own.
    """
    path = list_file()
    return _read(path, Listed, "the list of passes") if path.exists() else {}


def roles() -> dict[str, PassRole]:
    """What each pass that was not withdrawn is good for."""
    return {name: entry.role for name, entry in listed().items() if not entry.withdrawn}


def invite(name: str, role: PassRole, addresses: Sequence[str], now: datetime.datetime) -> Pass:
    """Make a pass and put it on the list; the authority is made with the first one.

    Args:
        name: of its owner, never used before.
        role: see :mod:`drivers.secure`.
        addresses: of a camera computer, by which this station calls it; else more of this station's own.
        now: with a time zone.

    Raises:
        BadInput: the name is used or none, or a camera computer has no address.
    """
    known = listed()
    if not _NAME.fullmatch(name) or name == STATION:
        raise BadInput(f"'{shown(name, limit=60)}' names no pass; take small letters, digits and '-', at most 32.")
    if name in known:
        state = "was withdrawn" if known[name].withdrawn else "has a pass already"
        raise BadInput(
            f"'{name}' {state}; give the new pass another name, so that the old one does not become good again."
        )
    if role == "poses" and not addresses:
        raise BadInput(
            "a pass for poses needs --address: the name or number of the camera computer, as this station calls it."
        )
    authority = _authority(now)
    try:
        places = tuple(addresses) if role == "poses" else addresses_of(addresses, own_addresses())
        owner = Owner(name, listens=role == "poses", connects=role != "poses", addresses=places)
        made = issue(authority, owner, now)
    except ValueError as error:
        raise BadInput(f"the pass cannot be made: {error}; give --address as a name or a number.") from None
    new = _pass(made, name, role, places)
    if not station_file().exists():
        renew_station((), now)
    _write(list_file(), {**known, name: Entry(role, new.expires.date().isoformat())})
    return new


def withdraw(name: str) -> None:
    """From now on the pass of that name is good for nothing; a station that shares takes it up at once.

    Raises:
        BadInput: there is none.
    """
    known = listed()
    if name not in known:
        raise BadInput(f"'{shown(name, limit=60)}' has no pass; there are {', '.join(sorted(known)) or 'none'}.")
    _write(list_file(), {**known, name: msgspec.structs.replace(known[name], withdrawn=True)})


def renew_station(addresses: Sequence[str], now: datetime.datetime) -> Pass:
    """This station's own certificate, made anew for the addresses that it has now.

    Raises:
        BadInput: an address is none.
    """
    try:
        places = addresses_of(addresses, own_addresses())
        made = issue(_authority(now), Owner(STATION, listens=True, addresses=places), now)
    except ValueError as error:
        raise BadInput(f"the station's certificate cannot be made: {error}.") from None
    new = _pass(made, STATION, STATION, places)
    _write(station_file(), new)
    return new


def accept(path: Path) -> Pass:
    """Keep a pass that was carried here, on a stick or by mail, where everyone may read a file.

    Raises:
        BadInput: it is none.
    """
    require_file(path, "a pass", PASS_BYTES)
    new = _good(_decoded(path, Pass, "a pass"), path)
    _write(settings_dir() / "stations" / f"{file_name(new.station)}.{new.name}.json", new)
    return new


def accepted() -> list[Pass]:
    """The passes that were accepted here and hold.

    Raises:
        BadInput: there are some, and none of them holds.
    """
    good: list[Pass] = []
    fault: BadInput | None = None
    for path in sorted((settings_dir() / "stations").glob("*.json")):
        try:
            good.append(read_pass(path))
        except BadInput as error:
            fault = error
    if fault is not None and not good:
        raise fault
    return good


def pass_for(host: str) -> Pass:
    """The pass for a station that goes by this name or address: of several the one that may most, and holds longest.

    Those of a single station are good for any address, as certificates prove who answers.

    Raises:
        BadInput: there is none, or it is not clear which.
    """
    host = host.rpartition(":")[0] or host
    known = [each for each in accepted() if each.role in ("watch", "operate")]
    fitting = [each for each in known if host == each.station or host in each.addresses] or known
    if len({each.authority for each in fitting}) == 1:
        return max(fitting, key=lambda each: (each.role == "operate", each.expires))
    if not known:
        raise BadInput(
            "no pass was accepted here: at the station `groundstation station --invite NAME`, "
            "here `groundstation station --accept FILE`."
        )
    there = ", ".join(f"{each.station} ({', '.join(each.addresses)})" for each in known)
    raise BadInput(f"{shown(host, limit=60)}: no pass is for this station; there are passes for {there}.")


def read_pass(path: Path) -> Pass:
    """A pass from its file.

    Raises:
        BadInput: others may read it, it is none, or it holds no longer.
    """
    return _good(_read(path, Pass, "a pass"), path)


def _good(found: Pass, path: Path) -> Pass:
    try:
        until = found.expires
    except ValueError:
        raise BadInput(f"{path}: its certificate is damaged; have another pass made.") from None
    if found.role not in (*PASS_ROLES, STATION) or not _NAME.fullmatch(found.name):
        raise BadInput(f"{path}: is no pass of this version; have another one made.")
    if until < datetime.datetime.now(datetime.UTC):
        raise BadInput(f"{path}: held until {until.date()}; have another pass made at the station.")
    return found


def write_pass(path: Path, given: Pass) -> None:
    """Write a pass where it is taken from.

    Raises:
        BadInput: it cannot be written.
    """
    _write(path, given)


def station_name() -> str:
    """By which this computer is called."""
    return socket.gethostname().lower()


def own_addresses() -> list[str]:
    """Names and numbers of this computer, as far as it knows them."""
    name = station_name()
    found = [name, f"{name}.local", "localhost", "127.0.0.1"]
    for target in (*(entry[4][0] for entry in _resolved(name)), *_interfaces()):
        if str(target) not in found:
            found.append(str(target))
    return found


def _resolved(name: str) -> list[tuple]:
    try:
        return socket.getaddrinfo(name, None, socket.AF_INET)
    except OSError:
        return []


def _interfaces() -> list[str]:
    """IPv4 numbers of all interfaces; where the system does not list them, of the one on the way to elsewhere."""
    out: list[str] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            import fcntl

            for _, interface in socket.if_nameindex():
                try:
                    told = fcntl.ioctl(probe.fileno(), 0x8915, interface.encode()[:15].ljust(256, b"\0"))  # SIOCGIFADDR
                    out.append(socket.inet_ntoa(told[20:24]))
                except OSError:
                    continue  # an interface without a number
        except ImportError:
            probe.connect(("192.0.2.1", 9))  # nothing is sent
            out.append(probe.getsockname()[0])
    return out


def _authority(now: datetime.datetime) -> Authority:
    path = share_dir() / "authority.json"
    if not path.exists():
        made = new_authority(f"groundstation {station_name()}"[:64], now)
        _write(path, Signer(made.certificate.decode(), made.key.decode()))
    found = _read(path, Signer, "the authority of this station")
    return Authority(found.certificate.encode(), found.key.encode())


def _pass(made: Identity, name: str, role: str, addresses: tuple[str, ...]) -> Pass:
    return Pass(
        station_name(), addresses, name, role, made.authority.decode(), made.certificate.decode(), made.key.decode()
    )


def _read(path: Path, kind: type[F] | type[Listed], wanted: str) -> F:
    """A file that is this user's own."""
    require_own(path, wanted, "Set its mode to 600 (chmod 600) if it is yours.")
    return _decoded(path, kind, wanted)


def _decoded(path: Path, kind: type[F] | type[Listed], wanted: str) -> F:
    try:
        return cast("F", msgspec.json.decode(path.read_bytes(), type=kind))
    except (OSError, msgspec.DecodeError, RecursionError) as error:
        raise BadInput(f"{path}: is not {wanted} ({shown(error, limit=120)}).") from None


def _write(path: Path, content: object) -> None:
    try:
        write_private(path, msgspec.json.format(msgspec.json.encode(content), indent=1).decode())
    except OSError as error:
        raise BadInput(f"{path}: cannot be written ({error.strerror}); choose another place with --out.") from None
