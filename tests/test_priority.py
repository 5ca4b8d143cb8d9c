"""Nice values that hold against other sessions, in a process that leads one."""

from __future__ import annotations

import subprocess
import sys

import pytest

from groundstation.priority import AUTOGROUP

SAYS = """
import os
from groundstation.priority import AUTOGROUP, set_nice
taken = set_nice(7)
words = AUTOGROUP.read_text().split() if AUTOGROUP.exists() else []
print(taken, os.getpriority(os.PRIO_PROCESS, 0), words[-1] if words else None)
"""


@pytest.mark.parametrize("leads", [True, False])
def test_a_session_of_its_own_gets_the_nice_value_too_and_a_shared_one_is_left_alone(leads):
    said = subprocess.run(
        [sys.executable, "-P", "-c", SAYS], capture_output=True, text=True, check=True, start_new_session=leads
    ).stdout.split()
    assert said[:2] == ["True", "7"]
    if AUTOGROUP.exists():  # empty where a session has no group of its own, as in some containers
        assert (said[2] == "7") == leads
