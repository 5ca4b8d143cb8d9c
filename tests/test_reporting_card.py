"""The landing card: three lines; each reason against the numbers comes before the numbers."""

import re

import pytest

from groundstation.reporting.card import landing_card

MASS = {"value": 1.8254, "std": 0.000338, "ci95": [1.82474, 1.82606]}
IXX = {"value": 0.0390, "std": 0.0004, "ci95": [0.0382, 0.0398]}
IYY = {"value": 0.0299, "std": 0.0002, "ci95": [0.0295, 0.0303]}
DECLARED = {"mass_kg": 1.79, "ixx_kg_m2": 0.03, "iyy_kg_m2": 0.03, "izz_kg_m2": 0.04}
IDENTIFIED = {
    "best": "IV",
    "estimate": {"source": "IV", "parameters": {"mass_kg": MASS, "ixx_kg_m2": IXX, "iyy_kg_m2": IYY}},
}
WEAK = {"effect": "weak_rotor", "evidence": "", "confidence": 0.999, "rotor": 3}
FOUND = {"verdict": "explained", "findings": [WEAK], "adopted": True}


def test_a_flight_that_is_explained_says_yes_mass_change_and_what_to_do():
    trust, mass, following = landing_card(IDENTIFIED, FOUND, DECLARED)
    assert trust == "Trust: yes. The model explains the flight down to noise and disturbance."
    assert mass == "Mass: 1.82540 ± 0.00066 kg, 2.0 % more than declared; Ixx 30.0 % more. Found: weak rotor (rotor 3)."
    assert following.startswith("Next: export the model")


@pytest.mark.parametrize(
    ("identification", "diagnosis", "said"),
    [
        ({}, FOUND, "no. This flight was not identified"),
        ({"declarations": [{"name": "thrust", "verdict": "contradicted", "line": ""}]}, FOUND, "no.*declared thrust"),
        ({}, {}, "open.*not diagnosed"),
        (
            {},
            {"verdict": "unexplained", "unexplained": [{"channel": "force_z_n", "share": 0.3}]},
            "with care.*force z.*widened",
        ),
        ({}, FOUND | {"adopted": False}, "with care.*worse"),
        (
            {},
            FOUND | {"findings": [WEAK | {"alternatives": ["com_offset"]}]},
            "with care.*com offset instead of weak rotor",
        ),
        ({}, FOUND | {"findings": [WEAK | {"confidence": 0.7}]}, "with care.*chance"),
        ({"not_identifiable": ["ixx_kg_m2"]}, FOUND, "not all.*Ixx"),
    ],
)
def test_each_reason_against_the_numbers_is_said_first(identification, diagnosis, said):
    document = identification if said.startswith("no. This") else IDENTIFIED | identification
    card = landing_card(document, diagnosis, DECLARED)
    assert len(card) == 3 and all(line and "\n" not in line and "_" not in line for line in card)
    assert re.search(said, card[0]), card[0]


def test_a_contradicted_declaration_asks_for_its_line_first():
    checks = [{"name": "thrust", "verdict": "contradicted", "line": "thrust_coefficient_n_s2 = 1.2e-5"}]
    card = landing_card(IDENTIFIED | {"declarations": checks}, FOUND | {"next_flight": "fly slowly."}, DECLARED)
    assert "correct the vehicle file: " in card[2] and "thrust_coefficient_n_s2 = 1.2e-5" in card[2]


def test_a_planned_flight_is_named_with_what_it_separates():
    doubt = FOUND | {
        "findings": [WEAK | {"alternatives": ["com_offset"]}],
        "next_flight": "To tell it: climb. Planned.",
    }
    assert landing_card(IDENTIFIED, doubt, DECLARED)[2] == "Next: To tell it: climb."
    card = landing_card(IDENTIFIED, doubt, DECLARED, planned="next_flight.toml")
    assert card[2] == "Next: fly next_flight.toml; it should tell weak rotor from com offset."


def test_a_mass_within_its_interval_is_as_declared():
    card = landing_card(IDENTIFIED, {"verdict": "clean"}, {"mass_kg": 1.8252})
    assert card[1] == "Mass: 1.82540 ± 0.00066 kg, as declared."
