"""What each fault costs: when it is noticed, when the vehicle is down, and by whom. On virtual time; prints a table.

make faults
"""

# pyright: reportMissingImports=false, reportArgumentType=false
# The tests' rigs are found by the path they are run with.

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from mavlink_vehicle import Rig, lossy, small_plan
from test_link_process import process

from drivers.bus import make_upload
from drivers.samples import Batch, Pose, Vector3
from groundstation.flight.core.recorder import Recorder
from groundstation.flight.link.phase import Phase
from groundstation.recording.recorded import plan_file

Break = Callable[[Rig], None]
PATIENCE_S = 10.0
"""Real time for another thread's work of microseconds."""
WATCHED = {"indoors": False, "mocap": {"system": "natnet"}, "policy": {"placement": "world"}}
INDOORS = {
    "px4": {"EKF2_EV_CTRL": (15.0, 6), "EKF2_HGT_REF": (3.0, 6), "EKF2_GPS_CTRL": (0.0, 6)},
    "arducopter": {
        "VISO_TYPE": (1.0, 9), "GPS1_TYPE": (0.0, 9),
        **{f"EK3_SRC1_{what}": (6.0, 9) for what in ("POSXY", "POSZ", "YAW")},
    },
}  # fmt: skip


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


class Poses:
    """Motion capture at 125 Hz that sees where the vehicle is, until something happens to it."""

    def __init__(self, rig: Rig, change: Callable[[Vector3], Vector3] = lambda p: p):
        self.rig, self.change, self.alive, self._count = rig, change, True, 0
        rig.vehicle.parameters.update(INDOORS[rig.vehicle.kind])
        rig.hooks.append(self._see)

    def _see(self) -> None:
        self._count += 1
        if self.alive and self._count % 2 == 0:
            north, east, down = self.rig.vehicle.position
            seen = self.change((north + 1e-5 * (self._count % 7), -east, -down))
            self.rig._to_vehicle += self.rig.core.pose(
                Pose(self.rig.now_s, seen, (1.0, 0.0, 0.0, 0.0)), self.rig.now_s
            ).send

    def stop(self) -> None:
        """No frame comes any more."""
        self.alive = False

    def freeze(self) -> None:
        """The same pose again and again."""
        north, east, down = self.rig.vehicle.position
        self.change = lambda _p: (north, -east, -down)

    def jump(self) -> None:
        """Another body is taken for the vehicle's."""
        self.change = lambda p: (p[0] + 0.7, p[1], p[2])


class FullDisk:
    """Where nothing can be written."""

    failure = None

    def add(self, *_: object) -> None:
        """Fails, as the recorder's file does."""
        self.failure = "no space left on device"


def full(rig: Rig) -> None:
    """The disk has no room left: the recorder fails, and the core aborts as it does."""
    failed: list[str] = []
    recorder = Recorder(FullDisk(), lambda _s: None, failed.append)
    told = [len(rig.samples)]

    def record() -> None:
        new, told[0] = rig.samples[told[0] :], len(rig.samples)
        due = recorder.recorded + len(new)
        recorder.put(Batch(0, tuple(t for _, t in new), tuple(sample for sample, _ in new)))
        end = time.monotonic() + PATIENCE_S
        while recorder.recorded < due and not failed:
            if time.monotonic() > end:
                raise SystemExit(f"the recorder's thread has neither recorded nor failed for {PATIENCE_S:.0f} s")
            time.sleep(0.0)  # its thread's turn
        if failed:
            rig.core.order("abort", rig.now_s, failed[0])

    rig.hooks.append(record)


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
    "disk full": full,
    "operator's abort": abort,
}
POSES: dict[str, Callable[[Poses], None]] = {
    "poses stop": Poses.stop,
    "poses freeze": Poses.freeze,
    "poses jump 0.7 m": Poses.jump,
}


def swapped(kind: str) -> str:
    """Why a motion capture with x and y swapped is not flown with, once the vehicle was carried along both."""
    rig = Rig(kind, WATCHED)
    Poses(rig, lambda p: (p[1], p[0], p[2]))
    rig.prepare()
    for axis in (0, 1, 0, 1):
        for n in range(100):
            rig.vehicle.position[axis] = 0.6 * math.sin(math.pi * n / 100) ** 2
            rig.step()
    rig.vehicle.position[:] = [0.0, 0.0, 0.0]
    rig.wait(1.0)
    return rig.upload().reason


def denied(kind: str) -> str:
    """What comes back when the autopilot does not arm."""
    rig = Rig(kind)
    rig.vehicle.deny_arming = "Arm: Need Position Estimate"
    rig.prepare()
    rig.upload()
    return rig.order("arm").reason


def damaged(kind: str) -> str:
    """What the link says of a plan that lost a byte on its way."""
    rig = Rig(kind)
    rig.prepare()
    whole = make_upload(plan_file(small_plan()))
    return process(rig)._on_upload(msgspec.structs.replace(whole, plan=whole.plan[:-1])).reason


GROUND = {"poses' axes swapped": swapped, "arming denied": denied, "upload corrupted": damaged}


def broken(kind: str, name: str) -> Rig:
    """A vehicle in the middle of its excitation, with the fault from now on."""
    rig = Rig(kind, WATCHED if name in POSES else None)
    poses = Poses(rig) if name in POSES else None
    rig.excite()
    if poses is not None:
        POSES[name](poses)
    else:
        FAULTS[name](rig)
    return rig


def measure(kind: str, name: str) -> tuple[str, str, str]:
    """Noticed after, on the ground after, by whom."""
    rig = broken(kind, name)
    begun = rig.now_s
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
    for name in (*FAULTS, *POSES):
        for kind in ("px4", "arducopter"):
            print(f"| {name} | {kind} | {' | '.join(measure(kind, name))} |", flush=True)
    for name, refused in GROUND.items():
        for kind in ("px4", "arducopter"):
            why = refused(kind).split(";")[0]
            print(f"| {name} | {kind} | before take-off | never left it | refused: {why} |", flush=True)


if __name__ == "__main__":
    main()
