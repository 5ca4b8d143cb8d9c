"""Candidates that are whitened, multiplied and solved together give what each gives by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import groundstation.diagnosis.evidence as evidence_module
from groundstation.diagnosis.along import Beside
from groundstation.diagnosis.attribution import Selection
from groundstation.diagnosis.base import for_evidence
from groundstation.diagnosis.beside import beside
from groundstation.diagnosis.columns import Candidate, Columns
from groundstation.diagnosis.effect import Effect, ParameterInfo, blank
from groundstation.diagnosis.evidence import Evidence
from groundstation.diagnosis.flight_evidence import WRENCH_ROW, FlightEvidence
from groundstation.diagnosis.pool import candidates
from groundstation.diagnosis.products import product
from groundstation.diagnosis.rivals import Entry, material, plausible, share_of
from groundstation.diagnosis.selection import Selected
from groundstation.identification.dynamic_fit import fit_dynamics
from groundstation.identification.preparation import prepare
from groundstation.model.signals import Signals
from groundstation.paths import find_config
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from sim.scenario import load_scenario
from studies.flown import flight_data

SEED = 6
TOGETHER = ("rotor_drag", "weak_rotor", "rotor_degradation", "payload_change", "tether", "com_offset", "wind")


@pytest.fixture(scope="module")
def flights() -> list[FlightEvidence]:
    """Two flights about the fit of the first: rows of several flights stand below each other."""
    print("seed", SEED)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    plan = load_plan(find_config("plans", "qball2")).model_copy(update={"periods": 1.5})
    lab = load_scenario(find_config("scenarios", "lab"))
    flown = [for_evidence(prepare(flight_data(simulate(vehicle, plan, lab, SEED + i)))) for i in range(2)]
    fitted = fit_dynamics(flown[:1])
    return [FlightEvidence(each, fitted.best, fitted.options) for each in flown]


@pytest.fixture(scope="module")
def evidence(flights: list[FlightEvidence]) -> Evidence:
    return Evidence(flights)


def _pool(evidence: Evidence) -> list[Candidate]:
    flight = evidence.flights[0]
    found = candidates(flight.prepared.record.vehicle, flight.excited)
    return [each for name in TOGETHER for each in [c for c in found if c.identifier == name][:4]]


def _entries(evidence: Evidence) -> list[Entry]:
    pool = _pool(evidence)
    columns = evidence.columns_of(pool)
    assert len(pool) > 15 and all(each is not None for each in columns)
    return [(candidate, each) for candidate, each in zip(pool, columns, strict=True) if each is not None]


def test_columns_whitened_together_are_those_of_each(evidence: Evidence) -> None:
    for candidate, columns in _entries(evidence):
        alone = evidence.columns(Candidate(replace(candidate.effect, straight=None), candidate.settings))
        assert alone is not None and alone.energy is not None and columns.energy is not None
        for together, own in zip(columns.pair(), alone.pair(), strict=True):
            np.testing.assert_allclose(together, own, atol=1e-8 * np.abs(own).max(), rtol=0)
        np.testing.assert_allclose(columns.wrench_rms, alone.wrench_rms, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(columns.energy, alone.energy, atol=1e-9)
        by_hand = Columns.of(*columns.pair(), columns.wrench_rms)
        assert evidence.threshold(by_hand, 1e-5) == pytest.approx(evidence.threshold(columns, 1e-5), rel=1e-8)


def test_products_of_batches_are_those_of_pairs(evidence: Evidence) -> None:
    entries = _entries(evidence)
    (_, first), (_, last) = entries[0], entries[-1]
    evidence.table.with_each(first, [last])
    for a, b in ((evidence.base, first), (first, last), (last, first), (first, first), (last, evidence.output)):
        found, expected = evidence.table.pair(a, b), product(a, b, evidence.weight)
        for name in ("zx", "zz", "xx", "xz"):
            own = getattr(expected, name)
            np.testing.assert_allclose(getattr(found, name), own, atol=1e-9 * np.abs(own).max(initial=1.0), rtol=1e-7)


def test_estimates_beside_others_are_those_of_each_by_itself(evidence: Evidence) -> None:
    entries = _entries(evidence)
    others, rest = entries[:1], entries[2:]
    first = len(others[0][0].effect.parameters)
    seen = 0
    for found in beside(evidence, others, rest):
        walds, right, large = found.walds(), found.plausible(), found.material(evidence.scale)
        for place, index in enumerate(found.index):
            candidate, columns = rest[index]
            solution = evidence.solve([*others, rest[index]])
            values, covariance = solution.part(first, len(candidate.effect.parameters))
            np.testing.assert_allclose(found.values[place], values, atol=1e-6 * np.sqrt(np.diag(covariance)).min())
            np.testing.assert_allclose(found.covariance[place], covariance, rtol=1e-5, atol=1e-9 * covariance.max())
            assert walds[place] == pytest.approx(solution.wald(first, candidate.effect.telling()), rel=1e-5, abs=1e-6)
            assert right[place] == plausible(candidate, values, covariance)
            assert large[place] == material(evidence, columns, values)
            seen += 1
    assert seen == len(rest)


def test_a_function_of_time_is_whitened_once_for_all_channels(evidence: Evidence) -> None:
    chosen = _entries(evidence)[:1]

    def hats(signals: Signals) -> np.ndarray:
        return np.stack([np.sin(signals.t_s), signals.position_m[:, 2]], axis=1)

    found = Beside(evidence, chosen).along(hats, (1, 5), lambda channel: 2.0)
    first = len(chosen[0][0].effect.parameters)
    for channel, estimate in found.items():

        def wrench(signals: Signals, vehicle: object, settings: object, row: int = WRENCH_ROW[channel]) -> np.ndarray:
            out = blank(signals, 2)
            out[:, row] = hats(signals)
            return out

        parameters = tuple(ParameterInfo(name, lambda vehicle: np.sqrt(0.5)) for name in "ab")
        effect = Effect(
            identifier=f"hats {channel}", equation="", source="", parameters=parameters, confused_with=(),
            manoeuvre="", sentence="", wrench=wrench,
        )  # fmt: skip
        columns = evidence.columns(Candidate(effect, {}))
        assert columns is not None
        solution = evidence.solve([*chosen, (Candidate(effect, {}), columns)])
        values, covariance = solution.part(first, 2)
        np.testing.assert_allclose(estimate.values, values, atol=1e-6 * np.sqrt(np.diag(covariance)).min())
        assert estimate.wald() == pytest.approx(solution.wald(first, range(2)), rel=1e-5)
        assert evidence.threshold_of(estimate.energy, 1e-6) == pytest.approx(
            evidence.threshold(columns, 1e-6), rel=1e-6
        )
    assert set(found) == {1, 5}


def test_a_long_flight_is_multiplied_in_batches_that_are_made_anew(
    flights: list[FlightEvidence], evidence: Evidence, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evidence_module, "COLUMNS_BYTES", 1)
    monkeypatch.setattr(evidence_module, "BATCH_BYTES", 5 * 16 * len(evidence.y))
    small = Evidence(flights)
    pairs = zip(beside(small, [], _entries(small)), beside(evidence, [], _entries(evidence)), strict=True)
    for found, expected in pairs:
        np.testing.assert_allclose(found.walds(), expected.walds(), rtol=1e-6)


def test_with_nothing_chosen_the_base_bends_nothing(evidence: Evidence):
    """A second pass may drop all that the first one named."""
    selection = Selection(evidence, ())
    assert not Selected(evidence, [], [], evidence.solve([]), selection).is_bent()


def test_how_large_an_effect_is_does_not_hang_on_the_axes() -> None:
    random = np.random.default_rng(3)
    turn = np.linalg.qr(random.standard_normal((3, 3)))[0]
    force, torque = random.standard_normal((2, 3))
    turned = np.concatenate([turn @ force, turn @ torque])
    assert share_of(turned) == pytest.approx(float(share_of(np.concatenate([force, torque]))))
    assert share_of(np.array([0.3, 0.4, 0.0, 0.0, 0.1, 0.0])) == pytest.approx(0.5)
