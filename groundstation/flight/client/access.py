"""The files that say how to reach a running core: for this user alone, believed only where they can be this user's
own.
"""

from __future__ import annotations

import json
import re
from pathlib import Path

from drivers.access import Access, Login
from groundstation.errors import BadInput
from groundstation.outside import read_json, require_own
from groundstation.writing import write_private

_ENDPOINT = re.compile(r"tcp/127\.0\.0\.1:[0-9]{1,5}")


def write_access(path: Path, access: Access) -> None:
    """Write endpoint, role and secret into a file that its owner alone can read, from its first byte on."""
    login = access.login
    document = {
        "endpoint": access.endpoint,
        "role": login.role if login else "",
        "secret": login.secret if login else "",
    }
    write_private(path, json.dumps(document))


def read_access(path: Path) -> Access:
    """What :func:`write_access` wrote.

    Raises:
        BadInput: the file is a link, others could have written or read it, or it names no core of this machine.
    """
    remedy = "It is not followed; remove it if no flight is under way."
    require_own(path, "a flight's endpoint", remedy)
    try:
        document = read_json(path, "a flight's endpoint")
        endpoint, role, secret = (document[key] for key in ("endpoint", "role", "secret"))
        good = _ENDPOINT.fullmatch(endpoint) and all(isinstance(text, str) for text in (role, secret))
    except (BadInput, KeyError, TypeError):
        good = False
        endpoint = role = secret = ""
    if not good:
        raise BadInput(f"{path}: is empty or says nothing of a core on this machine. {remedy}")
    return Access(endpoint, Login(role, secret) if secret else None)
