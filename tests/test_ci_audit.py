"""What CI says of licences and vulnerabilities."""

from __future__ import annotations

import importlib.util
import json
from email.message import Message
from pathlib import Path

import pytest

_SPEC = importlib.util.spec_from_file_location("audit", Path(__file__).parents[1] / ".ci" / "audit.py")
assert _SPEC is not None and _SPEC.loader is not None
audit = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(audit)


def about(**fields: str) -> Message:
    message = Message()
    for name, value in fields.items():
        message[name.replace("_", "-")] = value
    return message


@pytest.mark.parametrize(
    ("fields", "fine"),
    [
        ({"License_Expression": "MIT"}, True),
        ({"License_Expression": "Apache-2.0 AND MIT"}, True),
        ({"License_Expression": "GPL-3.0-only OR MIT"}, True),
        ({"License_Expression": "GPL-3.0-only AND MIT"}, False),
        ({"License_Expression": "(MIT OR BSD-3-Clause) AND GPL-3.0-only"}, False),
        ({"Classifier": "License :: OSI Approved :: BSD License"}, True),
        ({"Classifier": "License :: OSI Approved :: GNU Affero General Public License v3", "License": "MIT"}, False),
        ({"Classifier": "License :: OSI Approved", "License": "MIT"}, True),
        ({}, False),
    ],
)
def test_a_licence_is_on_the_list_or_named(fields, fine):
    said = audit.forbidden([("package", about(**fields))])
    assert (not said) is fine and all(text.startswith("package: licence '") for text in said)


def test_what_the_program_needs_at_run_time_is_on_the_list():
    packages = audit.runtime()
    assert {"numpy", "pymavlink", "rosbags", "pydantic-core"} <= set(packages)
    assert not {"pytest", "groundstation", "mujoco"} & set(packages)
    assert audit.forbidden((name, package.metadata) for name, package in packages.items()) == []


@pytest.mark.parametrize("text", ["", "Traceback", "[]", "{}", "null"])
def test_a_service_that_does_not_answer_is_one_line_and_no_failure(text):
    line, fine = audit.vulnerabilities(text, 3)
    assert fine and "not looked for" in line and "\n" not in line


def test_a_known_vulnerability_fails_and_an_unseen_package_is_not_called_sound():
    sound = {"name": "a", "version": "1", "vulns": []}
    unseen = {"name": "b", "skip_reason": "Dependency not found"}
    hurt = {"name": "c", "version": "2", "vulns": [{"id": "CVE-2026-1", "fix_versions": []}]}
    assert audit.vulnerabilities(json.dumps({"dependencies": [sound]}), 1) == (
        "vulnerabilities: none known in 1 of 1 packages",
        True,
    )
    line, fine = audit.vulnerabilities(json.dumps({"dependencies": [sound, unseen]}), 2)
    assert fine and "1 of 2 packages; the audit service does not answer" in line
    line, fine = audit.vulnerabilities(json.dumps({"dependencies": [sound, unseen, hurt]}), 3)
    assert not fine and "c 2: CVE-2026-1" in line
