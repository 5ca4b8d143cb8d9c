"""Which of several sets of effects a diagnosis goes on with."""

from __future__ import annotations

from typing import Any, cast

from groundstation.diagnosis.columns import Candidate
from groundstation.diagnosis.effect import Effect, catalogue
from groundstation.diagnosis.rivals import Entry, preferred


def _set(*names: str, **settings: float) -> list[Entry]:
    known = catalogue()
    return [(Candidate(cast(Effect, known[name]), settings), cast(Any, None)) for name in names]


WRENCH, ROTOR, OFFSET = _set("constant_wrench"), _set("weak_rotor", "com_offset"), _set("com_offset")


def test_a_set_that_explains_more_with_fewer_numbers_goes_on():
    """Five numbers of a wrench against three of a rotor and an offset."""
    assert preferred([WRENCH, ROTOR], [100.0, 103.0], 2.0) == 1
    assert preferred([WRENCH, ROTOR, OFFSET], [100.0, 103.0, 104.0], 2.0) == 2


def test_more_numbers_have_to_explain_clearly_more():
    assert preferred([OFFSET, WRENCH], [100.0, 110.0], 2.0) == 0
    assert preferred([OFFSET, WRENCH], [100.0, 120.0], 2.0) == 1


def test_what_the_formula_of_a_large_effect_may_miss_is_no_reason_for_another_set():
    assert preferred([OFFSET, WRENCH], [4000.0, 4070.0], 2.0) == 0
    assert preferred([OFFSET, WRENCH], [4000.0, 4090.0], 2.0) == 1


def test_less_explained_is_no_reason_to_go_on_with_fewer_numbers():
    assert preferred([WRENCH, ROTOR], [100.0, 99.0], 2.0) == 0


def test_an_instant_that_was_looked_for_is_a_number():
    failed = _set("rotor_degradation", from_s=10.0)
    weak = _set("weak_rotor")
    assert preferred([failed, weak], [100.0, 90.0], 2.0) == 1
    assert preferred([weak, failed], [100.0, 110.0], 2.0) == 0
