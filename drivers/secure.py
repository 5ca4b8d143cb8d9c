"""The bus between machines: TLS in which both sides show a certificate, and what each certificate's owner may do.

Two kinds of places listen, each for sessions with a certificate of the same station alone (:func:`secured`)::

    the gate of a station   gs/share/status            publication   Shared, to everyone who has a pass
                            gs/share/NAME/abort        queryable     watch and operate
                            gs/share/NAME/file         queryable     watch and operate
                            gs/share/NAME/command      queryable     operate
                            gs/share/NAME/lease        queryable     operate
                            gs/share/NAME/alive        liveliness    of the client NAME
    a camera computer       mocap/BODY                 publication   poses, to its station alone

NAME is the certificate's. Zenoh admits a session's messages by the name in its certificate (:func:`gate_rules`), so
whatever arrives on a key of NAME was sent by who holds that certificate. A certificate that is not on the list may do
nothing.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from drivers.access import allow
from drivers.admission import PENDING, SESSIONS

PassRole = Literal["watch", "operate", "poses"]
PASS_ROLES: tuple[PassRole, ...] = ("watch", "operate", "poses")
STATION = "station"
"""Name in the certificate of the station itself."""
GATE_PORT, POSES_PORT = 7451, 7452
SHARED_STATUS = "gs/share/status"
CLIENTS_ALIVE = "gs/share/*/alive"
_TLS = "transport/link/tls"
_LISTENING = {
    "transport/unicast/accept_timeout": 5000,  # ms: a handshake over a network that loses packets
    "transport/unicast/accept_pending": PENDING,
    "transport/unicast/max_sessions": SESSIONS,
}
_CONNECTING = {
    "transport/unicast/open_timeout": 4000,  # ms: a handshake that the network swallowed is begun again
    "connect/retry": {"period_init_ms": 500, "period_max_ms": 2000, "period_increase_factor": 2.0},
}


@dataclass(frozen=True, slots=True)
class Identity:
    """Certificate and private key of one machine, and the authority that it believes; all PEM."""

    authority: bytes
    certificate: bytes
    key: bytes = field(repr=False)


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """Keys of one client at a station's gate."""

    name: str

    def _key(self, leaf: str) -> str:
        return f"gs/share/{self.name}/{leaf}"

    @property
    def abort(self) -> str:
        return self._key("abort")

    @property
    def command(self) -> str:
        return self._key("command")

    @property
    def lease(self) -> str:
        return self._key("lease")

    @property
    def file(self) -> str:
        return self._key("file")

    @property
    def alive(self) -> str:
        return self._key("alive")


def client_of(key: str) -> str:
    """The client whose key this is."""
    return key.split("/")[2]


def read_identity(path: Path) -> Identity:
    """From a file in JSON with ``authority``, ``certificate`` and ``key``.

    Raises:
        ConnectionError: there is none: without it nobody connects.
    """
    try:
        document = json.loads(path.read_bytes())
        return Identity(*(document[name].encode() for name in ("authority", "certificate", "key")))
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise ConnectionError(
            f"{path} holds no certificate ({error}); `groundstation station --invite` makes it"
        ) from None


def secured(identity: Identity, *, rules: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Settings of a session over TLS in which both sides show a certificate.

    Args:
        identity: of this machine.
        rules: of who listens (:func:`gate_rules`, :func:`poses_rules`); a side that connects needs none.
    """
    settings: dict[str, Any] = {
        f"{_TLS}/root_ca_certificate_base64": _base64(identity.authority),
        f"{_TLS}/enable_mtls": True,
        f"{_TLS}/verify_name_on_connect": True,
    }
    for side in ("listen", "connect"):
        settings[f"{_TLS}/{side}_certificate_base64"] = _base64(identity.certificate)
        settings[f"{_TLS}/{side}_private_key_base64"] = _base64(identity.key)
    return {**settings, **(_CONNECTING if rules is None else {**_LISTENING, "access_control": dict(rules)})}


def gate_rules(roles: Mapping[str, PassRole]) -> dict[str, Any]:
    """Zenoh's access control of a station's gate, from the role of each certificate's name."""
    shared = [
        allow("status", ["egress"], ["put"], [SHARED_STATUS]),
        allow("status-wanted", ["ingress"], ["declare_subscriber"], [SHARED_STATUS]),
    ]
    listening = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
    rules, policies, subjects = list(shared), [], []
    for name, role in roles.items():
        if role == "poses":
            continue
        keys = ClientKeys(name)
        asked = [keys.abort, keys.file, *((keys.command, keys.lease) if role == "operate" else ())]
        own = [
            allow(f"asks-{name}", ["ingress"], ["query"], asked),
            allow(f"answered-{name}", ["egress"], ["reply", "declare_queryable"], asked),
            allow(f"alive-{name}", ["ingress"], ["liveliness_token"], [keys.alive]),
            allow(f"looks-{name}", ["egress"], listening, [CLIENTS_ALIVE]),
        ]
        rules += own
        subjects.append({"id": name, "cert_common_names": [name]})
        policies.append({"rules": [rule["id"] for rule in [*shared, *own]], "subjects": [name]})
    return _denying(rules, subjects, policies)


def poses_rules() -> dict[str, Any]:
    """Zenoh's access control of a camera computer: the station may read poses, and nobody anything else."""
    rules = [
        allow("poses", ["egress"], ["put"], ["mocap/*"]),
        allow("poses-wanted", ["ingress"], ["declare_subscriber"], ["mocap/*"]),
    ]
    subjects = [{"id": STATION, "cert_common_names": [STATION]}]
    return _denying(rules, subjects, [{"rules": ["poses", "poses-wanted"], "subjects": [STATION]}])


def _denying(rules: list[dict[str, Any]], subjects: list[dict[str, Any]], policies: list[dict[str, Any]]) -> dict:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _base64(data: bytes) -> str:
    return b64encode(data).decode("ascii")
