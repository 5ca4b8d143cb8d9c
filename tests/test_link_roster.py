"""Several autopilots on one link: they are listed, and one is chosen."""

from __future__ import annotations

from mavlink_vehicle import Rig

from groundstation.flight.link.roster import Roster
from groundstation.flight.station import station_from_dict


def test_the_only_vehicle_needs_no_word_and_others_are_listed_once():
    roster = Roster(None)
    assert roster.trouble() == "no autopilot heard yet"
    assert roster.hears(1, 12) == ""
    assert roster.trouble() == ""
    assert "1 (PX4), 7 (ArduPilot); the first that can be flown is taken; choose with --system N" in roster.hears(7, 3)
    assert roster.hears(7, 3) == ""


def test_a_vehicle_that_is_wanted_and_not_heard_is_named_with_those_that_are():
    roster = Roster(7)
    assert "1 (PX4); system 7 is wanted" in roster.hears(1, 12)
    assert roster.trouble() == "system 7 is not heard; on the link are 1 (PX4)"
    roster.hears(7, 3)
    assert roster.trouble() == ""


def test_a_stranger_that_claims_every_number_is_not_listed_for_ever():
    roster = Roster(300)
    said = [roster.hears(system, 12) for system in range(1, 256)]
    assert sum(map(bool, said)) == 8


def test_a_station_file_may_say_which_system_is_flown():
    assert station_from_dict({"system": 7}).system == 7
    assert station_from_dict({}).system is None


def test_the_link_says_who_is_there_instead_of_waiting_in_silence():
    rig = Rig("px4", system=9)
    rig.wait(2.5)
    assert rig.core.view is None
    assert rig.core.trouble == "system 9 is not heard; on the link are 1 (PX4)"
