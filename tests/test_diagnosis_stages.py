"""The stages of a diagnosis pass frozen results on, and change all flights of a case alike."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from groundstation.diagnosis.case import Case
from groundstation.diagnosis.judging import Judged
from groundstation.diagnosis.results import Unexplained
from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle


def case_of_words() -> Case:
    return Case(load_vehicle(find_config("vehicles", "qball2")), ("a",), ("b", "c"), ("d",))  # type: ignore[arg-type]


def test_a_change_of_a_case_reaches_suspects_healthy_and_unseen_flights():
    case = case_of_words()
    changed = case.map(str.upper)  # type: ignore[arg-type]
    assert (changed.suspects, changed.healthy, changed.unseen) == (("A",), ("B", "C"), ("D",))
    assert changed.vehicle is case.vehicle and case.suspects == ("a",)
    with pytest.raises(FrozenInstanceError):
        case.suspects = ()  # type: ignore[misc]


@pytest.mark.parametrize(
    ("findings", "left", "worse", "verdict"),
    [
        ((), False, "", "clean"),
        (("drag",), False, "", "explained"),
        (("drag",), True, "", "unexplained"),
        (("drag",), False, "worse", "unexplained"),
        ((), True, "", "unexplained"),
    ],
)
def test_a_verdict_follows_from_what_was_found_what_is_left_and_what_got_worse(findings, left, worse, verdict):
    remaining = (Unexplained("force_x", 0.5),) if left else ()
    judged = Judged(findings, remaining, {}, {}, {}, np.zeros((7, 7)), worse, (), {})
    assert judged.verdict == verdict
