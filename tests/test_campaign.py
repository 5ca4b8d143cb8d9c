"""A campaign ends by itself with what was hidden, judges each model on a flight it has not seen, and survives being
killed.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from groundstation.campaign import campaign as module
from groundstation.campaign import deciding, ending
from groundstation.campaign.campaign import Campaign, load_campaign, run
from groundstation.campaign.judging import at_floor
from groundstation.campaign.report import lines, write_campaign_report
from groundstation.errors import BadInput
from groundstation.paths import find_config
from groundstation.recording import load_flight, write_mcap
from groundstation.targets import parse_targets, reached
from groundstation.trajectory import load_plan
from groundstation.vehicle import load_vehicle
from sim.flight import simulate
from studies.flown import flight_data
from tests.flights import laboratory


def test_targets_are_read_with_names_that_wait_for_their_percentage():
    assert parse_targets("ixx, iyy:2%,mass:0.5%") == {"ixx_kg_m2": 0.02, "iyy_kg_m2": 0.02, "mass_kg": 0.005}


@pytest.mark.parametrize(
    "text",
    ["", "mass", "mass:", "mass:x%", "mass:0%", "mass:-1%", "mass:100%", "mass:nan%", "weight:1%", "mass:1%,ixx"],
)
def test_bad_targets_are_one_sentence(text):
    with pytest.raises(BadInput, match=r"'.*'"):
        parse_targets(text)


def test_a_target_is_the_half_width_of_the_95_percent_interval():
    estimates = {"mass_kg": {"value": 2.0, "std": 0.01 / 1.959964}, "ixx_kg_m2": {"value": 0.0, "std": 1.0}}
    assert reached(estimates, {"mass_kg": 0.005, "ixx_kg_m2": 0.02, "izz_kg_m2": 0.02}) == pytest.approx(
        {"mass_kg": 1.0, "ixx_kg_m2": float("inf"), "izz_kg_m2": float("inf")}
    )


def test_the_floor_is_the_error_on_the_models_own_flights():
    assert at_floor({"velocity_m_s": 0.12}, {"velocity_m_s": 0.1})
    assert not at_floor({"velocity_m_s": 0.13}, {"velocity_m_s": 0.1})
    assert not at_floor({"velocity_m_s": float("nan")}, {"velocity_m_s": 0.1})
    assert not at_floor({}, {})


class Killed(BaseException):
    """As SIGKILL would end the process."""


class Hall:
    """Flies plans in the simulator of this process, in a laboratory with rotor drag that nobody declared."""

    def __init__(self, logs: Path, vehicle, die_at: tuple[int, ...] = ()):
        self.logs, self.vehicle, self.die_at, self.flown = logs, vehicle, die_at, 0

    def place(self) -> Path:
        return self.logs / f"flight-{self.flown + 1}"

    def was_flown(self, folder: Path) -> bool:
        return (folder / "flight.mcap").is_file()

    def fly(self, plan: Path, folder: Path) -> None:
        self.flown += 1
        scenario = laboratory(rotor_drag={"drag_kg_s": [0.4, 0.35]})
        flight = flight_data(simulate(self.vehicle, load_plan(plan), scenario, 200 + self.flown), plan.stem)
        folder.mkdir(parents=True)
        (folder / "plan.toml").write_bytes(plan.read_bytes())
        write_mcap(flight, folder / "flight.mcap")
        if self.flown in self.die_at:
            raise Killed  # the vehicle flies its plan to the end, whoever watches


def test_a_campaign_settles_by_itself_and_goes_on_after_it_was_killed(tmp_path, monkeypatch):
    monkeypatch.setattr(deciding, "DURATION_S", 20.0)
    monkeypatch.setattr(module, "PLAN_S", 1.5)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    hall = Hall(tmp_path / "logs", vehicle, die_at=(2,))
    begun = Campaign(tmp_path / "campaign", vehicle, parse_targets("mass:1%,ixx,iyy:8%"), at_most=4, seed=3).save()
    with pytest.raises(Killed):
        run(begun, hall)
    stood = load_campaign(tmp_path / "campaign")
    assert len(stood.rounds) == 1
    assert stood.pending["plan"].endswith("plan-2.toml")
    assert hall.flown == 2
    done = run(stood, hall)
    assert done.outcome == "settled", done.sentence
    assert [Path(r.folder).name for r in done.rounds] == [f"flight-{n}" for n in range(1, len(done.rounds) + 1)]
    assert hall.flown == len(done.rounds), "a flight that was flown is not flown again"
    last = done.rounds[-1]
    assert last.names() == ("rotor_drag",)
    assert (
        last.judged["after"]["velocity_m_s"]
        < last.judged["before"]["velocity_m_s"]
        < last.judged["declared"]["velocity_m_s"]
    )
    assert load_campaign(tmp_path / "campaign") == done
    assert any("Settled after" in line for line in lines(done))
    page = write_campaign_report(tmp_path / "report.html", done).read_text()
    assert "Error on flights that no estimate had seen" in page


class HallWithABadFlight(Hall):
    """The second flight's excitation is cut off after 0.4 s."""

    def fly(self, plan: Path, folder: Path) -> None:
        super().fly(plan, folder)
        if self.flown == 2:
            flight = load_flight(folder)
            assert flight.window_s is not None
            (folder / "flight.mcap").unlink()
            begin = flight.window_s[0]
            write_mcap(replace(flight, window_s=(begin, begin + 0.4)), folder / "flight.mcap")


def test_a_refused_flight_is_left_out_and_the_campaign_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(deciding, "DURATION_S", 20.0)
    monkeypatch.setattr(module, "PLAN_S", 1.5)
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    begun = Campaign(tmp_path / "campaign", vehicle, parse_targets("mass:1%,ixx,iyy:8%"), at_most=3, seed=3).save()
    done = run(begun, HallWithABadFlight(tmp_path / "logs", vehicle))
    _, refused, last = done.rounds
    assert not refused.estimates
    assert "too short" in refused.not_settled[0]
    assert last.judged, "the first flight's model is judged on the third"
    assert len(last.levels["mass_kg"]["flights"]) == 2, "estimates are made without the refused flight"
    assert "refused" in "\n".join(lines(done))
    assert write_campaign_report(tmp_path / "report.html", done).is_file()


def test_a_damaged_campaign_is_a_sentence(tmp_path):
    with pytest.raises(BadInput, match="holds no campaign"):
        load_campaign(tmp_path)
    for text in ("", "{", "[]", '{"schema": "x"}', json.dumps({"schema": module.SCHEMA})):
        (tmp_path / module.FILE).write_text(text)
        with pytest.raises(BadInput):
            load_campaign(tmp_path)


def test_an_interval_that_holds_more_than_noise_is_no_matter_of_further_flights(tmp_path):
    """A campaign of five flights said that it would still take 0.0 of them."""
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    campaign = Campaign(tmp_path, vehicle, parse_targets("mass:0.5%,ixx:2%"), 5, 1)
    goal = {"mass_kg": 0.005 * vehicle.mass_kg / 1.96, "ixx_kg_m2": 0.02 * vehicle.inertia_kg_m2.xx / 1.96}
    truth = vehicle.parameters()
    estimates = {name: {"value": truth[name], "std": 1.5 * std} for name, std in goal.items()}
    stuck = ending._exhausted(campaign, module.Round(str(tmp_path), "", 40.0, estimates=estimates))
    assert "do not sharpen mass, Ixx:" in stuck and "still take" not in stuck
    sharp = parse_targets("mass:0.0005%,ixx:0.002%")
    far = ending._exhausted(
        replace(campaign, targets=sharp), module.Round(str(tmp_path), "", 40.0, estimates=estimates)
    )
    assert "still take: mass " in far and "sharpen" not in far


def _round(folder: Path, reached: dict[str, float], **changes) -> module.Round:
    """A round against which nothing stands but its targets; its estimates are sharper than the plan's own noise."""
    truth = load_vehicle(find_config("vehicles", "qball2")).parameters()
    share = {"mass_kg": 0.005, "ixx_kg_m2": 0.02}
    estimates = {
        name: {"value": truth[name], "std": times * share[name] * truth[name] / 1.959964}
        for name, times in reached.items()
    }
    errors = {"velocity_m_s": 0.1}
    done = module.Round(
        str(folder), "", 40.0, judged={"after": errors}, seen=errors, verdict="clean", estimates=estimates
    )
    return replace(done, reached=reached, **changes)


@pytest.mark.parametrize(
    ("before", "now", "outcome"),
    [
        ({"mass_kg": 3.0, "ixx_kg_m2": 0.5}, {"mass_kg": 2.9, "ixx_kg_m2": 0.4}, "limit"),
        ({"mass_kg": 3.0, "ixx_kg_m2": 0.5}, {"mass_kg": 2.2, "ixx_kg_m2": 0.4}, ""),  # averaged: 3 / sqrt(2)
        ({"mass_kg": 3.0, "ixx_kg_m2": 1.5}, {"mass_kg": 2.9, "ixx_kg_m2": 1.1}, ""),  # one of two still falls
        ({"mass_kg": 0.9, "ixx_kg_m2": 0.5}, {"mass_kg": 1.2, "ixx_kg_m2": 0.4}, ""),  # two flights differ, by chance?
        ({"mass_kg": 1.5, "ixx_kg_m2": 0.5}, {"mass_kg": 0.9, "ixx_kg_m2": 0.4}, "settled"),
    ],
)
def test_a_campaign_ends_where_flights_sharpen_nothing_that_is_missed(tmp_path, before, now, outcome):
    """One with a load let go and a sagging battery flew all its five flights at ten times the target of the mass."""
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    begun = Campaign(tmp_path, vehicle, parse_targets("mass:0.5%,ixx:2%"), 5, 1, rounds=(_round(tmp_path, before),))
    done = ending.with_round(begun, _round(tmp_path, now))
    assert done.outcome == outcome
    if outcome == "limit":
        assert "mass (2.90 times its target)" in done.sentence and "do not sharpen mass:" in done.sentence


def test_what_would_not_show_though_it_lifted_the_vehicle_is_of_any_size(tmp_path):
    """A steady force beside a tether that pulls steadily: it would have shown from 52 N on, the vehicle weighs 18 N."""
    entry = {"effect": "constant_wrench", "parameter": "force_world_y_n", "least": 52.0, "share": 2.9}
    done = _round(tmp_path, {"mass_kg": 0.5}, would_show=(entry,))
    assert "constant wrench (force world y) of any size." in ending._settled([done])


def test_a_flight_that_promised_nothing_is_no_reason_to_end(tmp_path, monkeypatch):
    """As one that was planned to separate two explanations."""
    monkeypatch.setattr(ending, "promised", lambda vehicle, estimates, plan: dict.fromkeys(estimates, 0.999))
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    first = _round(tmp_path, {"mass_kg": 3.0})
    begun = Campaign(tmp_path, vehicle, parse_targets("mass:0.5%"), 5, 1, rounds=(first,))
    assert ending.with_round(begun, _round(tmp_path, {"mass_kg": 2.99})).outcome == ""


@pytest.mark.parametrize("against", [{"verdict": "unexplained"}, {"judged": {"after": {"velocity_m_s": 0.2}}}])
def test_what_stands_against_the_model_is_flown_for_whatever_the_targets(tmp_path, against):
    (tmp_path / "plan.toml").write_bytes(find_config("plans", "qball2").read_bytes())
    vehicle = load_vehicle(find_config("vehicles", "qball2"))
    first = _round(tmp_path, {"mass_kg": 3.0})
    begun = Campaign(tmp_path, vehicle, parse_targets("mass:0.5%"), 5, 1, rounds=(first,))
    done = ending.with_round(begun, _round(tmp_path, {"mass_kg": 3.0}, **against))
    assert done.outcome == "" and len(done.rounds[-1].not_settled) == 2
