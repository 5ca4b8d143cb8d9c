"""Who may do what on the bus: a secret per role and flight, and the rules by which a core admits sessions.

Zenoh proves a user's password by a keyed hash when a session opens, and filters every message of that session by the
rules of its user. So whatever arrives on a key was sent by a role that may send it: nothing has to be checked where it
is used.

======== ==================================================================================================
role     may
======== ==================================================================================================
watch    see the status, hold a client's token, ask for an abort
operate  that, take the lease, and give the orders that need it
drone    publish samples and status, answer the core
core     everything; no session logs in as it
======== ==================================================================================================
"""

from __future__ import annotations

import json
import os
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

Role = Literal["watch", "operate", "drone", "core"]
ROLES: tuple[Role, ...] = ("watch", "operate", "drone", "core")
LOGIN_VARIABLE, SECRETS_VARIABLE = "GROUNDSTATION_BUS_LOGIN", "GROUNDSTATION_BUS_SECRETS"
"""Environment of a child: arguments are seen by every user of a machine, the environment by its owner alone."""


@dataclass(frozen=True, slots=True)
class Login:
    """A role and its secret."""

    role: str
    secret: str = field(repr=False)


@dataclass(frozen=True, slots=True)
class Access:
    """Where a core listens, and as whom to open a session there; no login where the core asks for none."""

    endpoint: str
    login: Login | None = None

    def __str__(self) -> str:
        return self.endpoint


Secrets = Mapping[Role, str]


def new_secrets() -> dict[Role, str]:
    """Of one flight: 128 bits each."""
    return {role: secrets.token_hex(16) for role in ROLES}


def hand_over(login: Login | None = None, flight: Secrets | None = None) -> dict[str, str]:
    """What to add to a child's environment: its login, or (for a core) the secrets of all roles."""
    out = {}
    if login is not None:
        out[LOGIN_VARIABLE] = f"{login.role}:{login.secret}"
    if flight is not None:
        out[SECRETS_VARIABLE] = json.dumps(dict(flight))
    return out


def own_login() -> Login | None:
    """The login that the parent handed over; taken out of the environment, so that no child of this process has it."""
    role, _, secret = os.environ.pop(LOGIN_VARIABLE, "").partition(":")
    return Login(role, secret) if secret else None


def own_secrets() -> dict[Role, str]:
    """The secrets that the parent handed over, taken out of the environment; new ones where it gave none.

    Raises:
        ValueError: they are of another form.
    """
    text = os.environ.pop(SECRETS_VARIABLE, "")
    if not text:
        return new_secrets()
    given = json.loads(text)
    if not isinstance(given, dict) or set(given) != set(ROLES):
        raise ValueError(f"{SECRETS_VARIABLE} is no table of {', '.join(ROLES)}")
    return {role: str(given[role]) for role in ROLES}


def rules(vehicle: str) -> dict[str, Any]:
    """Zenoh's access control of a core for one vehicle. From the core's side: ingress comes in, egress goes out."""
    drone = f"gs/{vehicle}"
    told = [f"{drone}/samples", f"{drone}/status"]
    asked = [f"{drone}/{leaf}" for leaf in ("credit", "upload", "command", "describe")]
    liveliness = ["liveliness_token", "liveliness_query", "declare_liveliness_subscriber"]
    listening = ["declare_subscriber", "declare_liveliness_subscriber", "liveliness_query"]
    shared = [
        allow("core-alive", ["ingress", "egress"], liveliness, ["gs/core/alive"]),
        allow("core-listens", ["egress"], listening, [f"{drone}/*", "gs/client/*/alive"]),
    ]
    watch = [
        allow("status", ["egress"], ["put"], ["gs/core/status"]),
        allow("status-wanted", ["ingress"], ["declare_subscriber"], ["gs/core/status"]),
        allow("abort", ["ingress"], ["query"], ["gs/core/abort"]),
        allow("answers", ["egress"], ["reply", "declare_queryable"], ["gs/core/*"]),
        allow("client-alive", ["ingress"], ["liveliness_token"], ["gs/client/*/alive"]),
    ]
    operate = [allow("orders", ["ingress"], ["query"], ["gs/core/command", "gs/core/lease"])]
    vehicle_rules = [
        allow("tells", ["ingress"], ["put"], told),
        allow("vehicle-alive", ["ingress"], ["liveliness_token"], [f"{drone}/alive"]),
        allow("serves", ["ingress"], ["reply", "declare_queryable", "declare_subscriber"], asked),
        allow("asks", ["egress"], ["put", "query"], asked),
    ]
    policies = (
        (shared, ["watch", "operate", "drone"]),
        (watch, ["watch", "operate"]),
        (operate, ["operate"]),
        (vehicle_rules, ["drone"]),
    )
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for allowed, _ in policies for rule in allowed],
        "subjects": [{"id": role, "usernames": [role]} for role in ("watch", "operate", "drone")],
        "policies": [
            {"rules": [rule["id"] for rule in allowed], "subjects": subjects} for allowed, subjects in policies
        ],
    }


def allow(name: str, flows: Sequence[str], messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    """One rule of zenoh's access control."""
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows),
        "messages": list(messages),
        "key_exprs": list(keys),
    }
