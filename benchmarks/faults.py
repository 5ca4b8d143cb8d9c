"""What each fault costs: when it is noticed, when the vehicle is down, and by whom. On virtual time; prints a table.

make faults
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from mavlink_vehicle import Rig, lossy

from groundstation.flight.pilot import Phase

Break = Callable[[Rig], None]


def cut(seconds: float) -> Break:
    """Nothing passes in either direction for a while."""

    def apply(rig: Rig) -> None:
        end = rig.now_s + seconds
        rig.up = rig.down = lambda frames: [] if rig.now_s < end else frames

    return apply


def disturb(rig: Rig) -> None:
    """A tenth of all frames lost, doubled, corrupted each, and some shuffled."""
    rig.down, rig.up = lossy(0.1, 1), lossy(0.1, 2)


def takeover(rig: Rig) -> None:
    """The pilot's switch."""
    rig.vehicle.set_mode("POSCTL" if rig.vehicle.kind == "px4" else "LOITER")
    rig.vehicle.heartbeat()


def silent(rig: Rig) -> None:
    """The core hangs."""
    rig.core_beats = False


def killed(rig: Rig) -> None:
    """The core's process is gone."""
    silent(rig)
    rig.core.core_lost()


def stalled(rig: Rig) -> None:
    """The link process stops for 0.9 s."""
    end = rig.now_s + 0.9
    rig.link_runs = False
    rig.hooks.append(lambda: setattr(rig, "link_runs", rig.now_s >= end))


def frozen(rig: Rig) -> None:
    """The link process stops for good (SIGSTOP, or killed)."""
    rig.link_runs = False


def up_cut(rig: Rig) -> None:
    """Only the way to the vehicle breaks."""
    rig.up = lambda _frames: []


def low(rig: Rig) -> None:
    """Ten per cent left."""
    rig.vehicle.battery = 10


def jump(rig: Rig) -> None:
    """The estimate moves by 0.8 m."""
    rig.vehicle.offset = [0.0, 0.8, 0.0]


def mute(rig: Rig) -> None:
    """Positions stop, the rest goes on."""
    rig.vehicle.intervals.pop(32)


def reboot(rig: Rig) -> None:
    """The autopilot restarts in the air."""
    rig.vehicle.reboot()


def abort(rig: Rig) -> None:
    """Ctrl-C."""
    rig.core.order("abort", rig.now_s, "Ctrl-C")


FAULTS: dict[str, Break] = {
    "link cut 0.2 s": cut(0.2),
    "link cut 1 s": cut(1.0),
    "link cut 5 s": cut(5.0),
    "link cut for ever": cut(1e9),
    "way to the vehicle cut for ever": up_cut,
    "10 % loss, duplication, reordering, corruption": disturb,
    "core hangs": silent,
    "core killed": killed,
    "link process stalls 0.9 s": stalled,
    "link process stopped or killed": frozen,
    "pilot changes the mode": takeover,
    "autopilot restarts in the air": reboot,
    "battery at 10 %": low,
    "estimate jumps 0.8 m": jump,
    "positions stop": mute,
    "operator's abort": abort,
}


def measure(kind: str, fault: Break) -> tuple[str, str, str]:
    """Noticed after, on the ground after, by whom."""
    rig = Rig(kind)
    rig.excite()
    begun = rig.now_s
    fault(rig)
    rig.run(lambda: rig.phase is not Phase.FOLLOWING or not rig.vehicle.armed, 30.0)
    noticed = rig.now_s - begun
    rig.wait(0.1)
    by = rig.reason
    if rig.phase is Phase.RELEASED and rig.vehicle.mode in (
        rig.vehicle.modes.get("POSCTL"),
        rig.vehicle.modes.get("LOITER"),
    ):
        return f"{noticed:.2f} s", "the pilot flies", "station lets go"
    down = rig.run(lambda: rig.vehicle.height_m < 0.05, 40.0)
    safe = f"{rig.now_s - begun:.1f} s" if down else "by its own GCS failsafe"
    if not by:
        completed = down and rig.phase is not Phase.FOLLOWING
        return ("not needed", safe, "the plan's end") if completed else ("not seen", safe, "vehicle's failsafe")
    who = "vehicle's failsafe; station lets go" if "let go" in by else f"link: {by.split(',')[0]}"
    return f"{noticed:.2f} s", safe, "vehicle" if "disarmed" in by else who


def main() -> None:
    """Print the table."""
    print("| fault | autopilot | noticed after | on the ground after | by |\n| --- | --- | --- | --- | --- |")
    for name, fault in FAULTS.items():
        for kind in ("px4", "arducopter"):
            print(f"| {name} | {kind} | {' | '.join(measure(kind, fault))} |", flush=True)


if __name__ == "__main__":
    main()
