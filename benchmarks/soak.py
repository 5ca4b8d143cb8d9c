"""Ten minutes of the fullest recording with faults of disk, folder, process and clock: what was lost. As root on Linux.

python -m benchmarks.soak [--seconds 100] [--out docs/results/soak.json]

Six recordings, one after the other, each by a process of its own at full load: IMU at 1 kHz, poses of three bodies at
360 Hz, four rotor speeds at 400 Hz, setpoints at 50 Hz and raw MAVLink frames at 400 Hz, through the flight's own
recorder, file and keeper. Each has a small disk of its own (tmpfs; ext4 in a file where it turns read-only). What comes
back is counted by the MCAP library's reader, not by ours.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

RATES_HZ = {"imu": 1000, "pose": 3 * 360, "motors": 400, "setpoint": 50, "raw": 400}
FAULTS = ("none", "kill", "disk full", "read-only", "folder removed", "clock jump")
STEP_S = 0.02
BREAKS_AT = 0.7
SYNC_BOUND_S = 2.0


def worker(folder: Path, seconds: float, jump: bool) -> None:
    """Record at full load in real time; each line on standard output is what was put so far, or what was told."""
    from drivers.samples import Batch, Imu, Motors, Pose, Raw, Setpoint
    from groundstation.flight.core.recorder import Recorder
    from groundstation.recording.keeper import Keeper
    from groundstation.recording.recorder import McapRecorder

    def told(reason: str) -> None:
        print(json.dumps({"told": reason, "at_s": time.monotonic()}), flush=True)

    sink = McapRecorder(folder / "flight.mcap", {"motor_kind": "rotor_speed"})
    recorder = Recorder(sink, on_digested=lambda _s: None, on_failure=told)
    keeper = Keeper(sink.path, sink.sync, told)
    begun, step, put, longest = time.monotonic(), 0, 0, 0.0
    owed = dict.fromkeys(RATES_HZ, 0.0)
    frame = bytes(range(60))
    while step * STEP_S < seconds:
        now = step * STEP_S
        device = now + (3600.0 if jump and 0.4 < now / seconds < 0.6 else 0.0)
        samples = []
        for name, rate in RATES_HZ.items():
            owed[name] += rate * STEP_S
            for k in range(int(owed[name])):
                t = device + k * STEP_S / owed[name]
                samples.append(
                    Imu(t, (0.1, 0.2, 0.3), (0.0, 0.0, 9.81)) if name == "imu"
                    else Pose(t, (0.0, 0.0, 1.0 + k), (1.0, 0.0, 0.0, 0.0)) if name == "pose"
                    else Motors(t, (400.0, 401.0, 402.0, 403.0)) if name == "motors"
                    else Setpoint(t, (0.0, 0.0, 1.0), 0.0) if name == "setpoint"
                    else Raw(t, "in", frame)
                )  # fmt: skip
            owed[name] -= int(owed[name])
        before = time.monotonic()
        recorder.put(Batch(step, (begun + now,) * len(samples), tuple(samples)))
        longest = max(longest, time.monotonic() - before)
        put += len(samples)
        if step % 5 == 0:
            print(json.dumps({"put": put, "at_s": time.monotonic(), "longest_put_s": longest}), flush=True)
        step += 1
        time.sleep(max(0.0, begun + step * STEP_S - time.monotonic()))
    recorder.close()
    keeper.close()
    print(json.dumps({"put": put, "at_s": time.monotonic(), "longest_put_s": longest, "lost": sink.lost}), flush=True)


def tool(name: str, *arguments: str) -> bool:
    """Run a tool of the system; whether it was there and worked."""
    path = shutil.which(name, path=f"{os.environ.get('PATH', '')}:/sbin:/usr/sbin")
    return path is not None and subprocess.run([path, *arguments], check=False, capture_output=True).returncode == 0


def break_it(fault: str, process: subprocess.Popen[str], folder: Path, disk: Path) -> None:
    """Let it happen."""
    if fault == "kill":
        process.kill()
    elif fault == "disk full":
        with contextlib.suppress(OSError), (disk / "ballast").open("wb") as ballast:
            while True:
                ballast.write(bytes(1 << 20))
    elif fault == "read-only":
        tool("mount", "-o", "remount,abort", str(disk))  # what ext4 does by itself when its disk fails: EROFS
    elif fault == "folder removed":
        shutil.rmtree(folder)


def readable(path: Path) -> int:
    """Messages in the file by the MCAP library; without an index as far as they go."""
    if not path.is_file():
        return 0
    count = 0
    with path.open("rb") as file, contextlib.suppress(McapError, EOFError, OSError):
        try:
            return sum(1 for _, channel, _ in make_reader(file).iter_messages() if not channel.topic.endswith("/exact"))
        except McapError:
            file.seek(0)
            channels: dict[int, str] = {}
            for record in StreamReader(file, record_size_limit=None).records:
                if type(record).__name__ == "Channel":
                    channels[record.id] = record.topic
                elif type(record).__name__ == "Message":
                    count += not channels[record.channel_id].endswith("/exact")
    return count


def measure(fault: str, seconds: float) -> dict[str, object]:
    """One recording with one fault."""
    disk = Path(tempfile.mkdtemp(prefix="soak-"))
    size = 64 if fault == "disk full" else 1024
    if fault == "read-only":
        image = disk.with_suffix(".img")
        with image.open("wb") as file:
            file.truncate(512 << 20)
        mounted = tool("mkfs.ext4", "-q", str(image)) and tool("mount", "-o", "loop", str(image), str(disk))
    else:
        mounted = tool("mount", "-t", "tmpfs", "-o", f"size={size}m", "tmpfs", str(disk))
    folder = disk / "flight"
    if not mounted and fault in ("disk full", "read-only"):
        return {"fault": fault, "skipped": "needs to mount a small disk (root)"}
    command = [
        sys.executable,
        "-P",
        "-c",
        f"import sys; sys.path.insert(0, {str(Path.cwd())!r})\nfrom benchmarks.soak import worker\n"
        f"from pathlib import Path\nworker(Path({str(folder)!r}), {seconds}, {fault == 'clock jump'})",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    broken_s, put_then, put, longest, told, told_s = None, 0, 0, 0.0, "", None
    begun = time.monotonic()
    for line in process.stdout:
        word = json.loads(line)
        if "told" in word and not told:
            told, told_s = word["told"], word["at_s"]
        put, longest = word.get("put", put), max(longest, word.get("longest_put_s", 0.0))
        if broken_s is None and fault not in ("none", "clock jump") and time.monotonic() - begun > BREAKS_AT * seconds:
            broken_s, put_then = time.monotonic(), put
            break_it(fault, process, folder, disk)
        if (
            fault in ("disk full", "read-only", "folder removed")
            and told_s is not None
            and time.monotonic() > told_s + 3.0
        ):
            process.send_signal(signal.SIGKILL)
    process.wait()
    found = readable(folder / "flight.mcap")
    total = sum(RATES_HZ.values())
    whole = put_then if broken_s is not None else put
    result = {
        "fault": fault,
        "seconds": round(time.monotonic() - begun, 1),
        "put": put,
        "put_before_the_fault": whole,
        "read_back": found,
        "lost_before_the_fault_s": round(max(0, whole - found) / total, 3),
        "noticed_after_s": None if told_s is None or broken_s is None else round(told_s - broken_s, 2),
        "told": told.replace(str(folder), "FOLDER"),
        "longest_put_ms": round(1e3 * longest, 2),
    }
    if mounted:
        tool("umount", "-l", str(disk))
        disk.with_suffix(".img").unlink(missing_ok=True)
    shutil.rmtree(disk, ignore_errors=True)
    return result


def table(document: dict) -> str:
    """The results as a table."""
    lines = [
        "| fault | put before it | read back | lost | noticed after | longest hand-over | reported |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for r in document["recordings"]:
        if "skipped" in r:
            lines.append(f"| {r['fault']} | {r['skipped']} | | | | | |")
            continue
        noticed = "—" if r["noticed_after_s"] is None else f"{r['noticed_after_s']:.2f} s"
        lost = (
            "everything (the folder is gone)"
            if r["fault"] == "folder removed"
            else f"{r['lost_before_the_fault_s']:.2f} s"
        )
        lines.append(
            f"| {r['fault']} | {r['put_before_the_fault']} | {r['read_back']} | {lost} | {noticed} | "
            f"{r['longest_put_ms']:.1f} ms | {r['told'] or '—'} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Record, break, count; JSON and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=100.0, help="of each of the six recordings")
    parser.add_argument("--out", type=Path, default=Path("docs/results/soak.json"))
    options = parser.parse_args()
    document = {"rates_hz": RATES_HZ, "recordings": [measure(fault, options.seconds) for fault in FAULTS]}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(document, indent=1) + "\n")
    print(table(document))


if __name__ == "__main__":
    main()
