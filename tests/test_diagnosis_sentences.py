"""Sentences of findings: units, signs in words, no identifiers, no exponents, short; and the page that shows them
all.
"""

import re

import numpy as np
import pytest

from groundstation.diagnosis.effect import Effect, FittedEffect, catalogue
from groundstation.diagnosis.sentences import UNITS, filled, quantity
from studies.sentences import PAGE, page, sentences

ALL = [(name, text) for name, said in sentences().items() for text in said]


@pytest.mark.parametrize(("name", "text"), ALL)
def test_a_sentence_is_short_and_in_words(name, text):
    assert text[0].isupper() and text.endswith("."), text
    for part in text.split(". "):
        assert len(part.split()) < 25, part
    assert not re.search(r"[a-z]_[a-z]|\d[eE][-+]?\d|[{}]|nan|inf\b", text), text
    assert not re.search(r"[-−]\d", text), f"a sign is not in words: {text}"
    without = re.sub(r"[Rr]otor \d|at 1 m/s", "", text)
    for number in re.findall(r"\d[\d.]*(.*?)(?=\d|$)", without):
        units = "|".join(re.escape(u) for u in ("mm", "ms", "m", "s", "%", "degrees", "mN", "µN", "N", "g"))
        assert re.match(rf" ({units})\b| %| (above|below)", number), f"a number without a unit in {text!r}: {number!r}"


def test_every_effect_that_makes_findings_has_its_sentence_on_the_page():
    able = {name for name, effect in catalogue().items() if isinstance(effect, Effect | FittedEffect)}
    assert able <= set(sentences())
    assert page() == PAGE.read_text(), "write it anew: python -m benchmarks.sentences"


def test_both_signs_are_words():
    com = catalogue()["com_offset"]
    assert isinstance(com, Effect)
    assert filled(com.sentence, com_offset_x_m=0.006, com_offset_y_m=-0.0001) == (
        "The centre of mass lies 6.0 mm forward and 0.1 mm to the right of the declared origin."
    )
    weak = catalogue()["weak_rotor"]
    assert isinstance(weak, Effect)
    assert filled(weak.sentence, rotor="3", loss=-0.03) == "Rotor 3 gives 3.0 % more thrust than declared."


def test_numbers_have_no_exponent_whatever_their_size():
    rng = np.random.default_rng(16)
    print("seed 16")
    for unit in UNITS:
        for size in 10.0 ** rng.uniform(-9, 4, 50):
            for value in (size, -size):
                assert re.fullmatch(r"−?\d+(\.\d+)?( \D.*)?", quantity(value, unit)), (value, unit)
    assert quantity(-1e-9, "mm") == "0.0 mm" and quantity(0.0, "N") == "0 N"
    assert quantity(0.0123, "N m") == "12.3 mN m" and quantity(1.03, "% change", "more", "less") == "3.0 % more"
    assert "unknown" in quantity(float("nan"), "N")


def test_an_unknown_unit_names_the_known_ones():
    with pytest.raises(ValueError, match=r"furlong.*mm"):
        filled("{x:furlong}", x=1.0)
