"""Several flights on several cores: the numbers of one flight after the other, and each flight prepared once."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from groundstation.campaign.judging import prediction_errors
from groundstation.campaign.kept import Kept
from groundstation.diagnosis import diagnose
from groundstation.errors import Refused
from groundstation.flightdata import FlightData
from groundstation.identification import preparation, together
from groundstation.identification.pipeline import identify
from groundstation.identification.starts import flight_states
from groundstation.identification.together import cores, of_each
from groundstation.identification.work import Work
from groundstation.json_types import JsonObject
from groundstation.reporting.exports import model_document
from studies.golden import SEED, plain, simulated


@pytest.fixture(scope="module")
def flights() -> list[FlightData]:
    print("seed", SEED)
    return [simulated(number, 2.0, weak_rotor={"rotor": 3, "loss": 0.06}) for number in (20, 21)]


def test_items_are_worked_out_in_their_order_and_under_the_caller_s_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(together, "cores", lambda: 3)
    meeting = threading.Barrier(3, timeout=30.0)

    def made(value: float) -> float:
        meeting.wait()  # passes where three are at work at once
        return float(np.float64(1.0) / np.float64(value))

    with np.errstate(divide="ignore"):
        assert of_each(made, [0.0, 2.0, 4.0]) == [np.inf, 0.5, 0.25]

    def refused(value: int) -> int:
        raise Refused(f"flight {value}", "Fly another.")

    with pytest.raises(Refused, match="flight 7"):
        of_each(refused, [7, 8])


def test_the_linear_algebra_s_limit_is_that_of_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    assert cores() == 1
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert cores() >= 1


def test_flights_on_two_cores_give_the_numbers_of_one(
    flights: list[FlightData], monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[JsonObject] = []
    for count in (1, 2):
        monkeypatch.setattr(together, "cores", lambda count=count: count)
        work = Work()
        identified = identify(flights, work=work)
        diagnosed = diagnose(flights, work=work).to_dict()
        found.append({"best": plain(identified.methods[identified.best].to_dict()), "diagnosis": plain(diagnosed)})
    assert found[0] == found[1]


def test_a_campaign_prepares_each_flight_once(flights: list[FlightData], monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []
    prepare = preparation.prepare
    monkeypatch.setattr(
        preparation, "prepare", lambda flight, **options: counted.append(flight.name) or prepare(flight, **options)
    )
    kept = Kept()
    for some in (flights[:1], flights):
        states = kept.states(some)
        identified = identify(some, work=kept.work)
    assert len(counted) == 2
    document = model_document(identified, flights[0].vehicle)
    again = [prediction_errors(document, flight_states(flight)) for flight in flights]
    assert [prediction_errors(document, each) for each in states] == again
