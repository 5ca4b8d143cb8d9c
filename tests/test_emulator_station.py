"""The station's own link core flies the emulated vehicles: preflight, upload, excitation, landing, on virtual time."""

from __future__ import annotations

import pytest

from groundstation.paths import find_config
from groundstation.vehicle import load_vehicle
from sim.mavlink.arducopter import ArduCopter
from sim.mavlink.faults import FAULTS
from sim.mavlink.px4 import Px4
from tests.emulated import RigidAirframe
from tests.mavlink_vehicle import Phase, Rig

LINK = "station"


class Emulated:
    """The emulator in the place of the link tests' scripted vehicle."""

    def __init__(self, kind: str):
        vehicle = load_vehicle(find_config("vehicles", "x500"))
        self.autopilot = (Px4 if kind == "px4" else ArduCopter)(vehicle, RigidAirframe(vehicle), boot_s=60.0)
        self.autopilot.add_link(LINK)

    def step(self, now_s: float, incoming: list[bytes]) -> list[bytes]:
        return [frame for _, frame in self.autopilot.step(now_s, [(LINK, data) for data in incoming])]

    @property
    def armed(self) -> bool:
        return self.autopilot.armed


def rig(kind: str) -> Rig:
    made = Rig(kind, set_parameters=True)
    made.vehicle = Emulated(kind)  # type: ignore[assignment]
    return made


@pytest.mark.parametrize("kind", ["px4", "arducopter"])
def test_the_station_flies_a_plan_on_the_emulated_vehicle(kind):
    r = rig(kind)
    r.excite()
    assert r.finish()
    assert r.phase is Phase.LANDED, r.reason
    states = [s for s, _ in r.samples if type(s).__name__ == "State"]
    assert max(s.position_m[2] for s in states) == pytest.approx(1.0, abs=0.2)
    assert len(r.vehicle.autopilot.logs.logs) == 1  # type: ignore[attr-defined]


@pytest.mark.parametrize("fault", ["pilot", "reboot", "battery-low", "silent"])
def test_whatever_fails_in_flight_no_setpoint_leads_it_afterwards(fault):
    r = rig("px4")
    r.excite()
    FAULTS[fault](r.vehicle.autopilot)  # type: ignore[attr-defined]
    assert r.run(lambda: r.phase is not Phase.FOLLOWING, 10.0)
    assert r.reason
