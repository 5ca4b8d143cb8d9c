"""Batch work: resumable, stopped by nothing, and the same table whoever computed it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.errors import BadInput
from groundstation.fleet import batch
from groundstation.fleet.runner import run
from groundstation.recording import write_mcap
from studies.study import draw


def double(number):
    if number == 3:
        raise ValueError("three is refused")
    return 2 * number


def die_once(path):
    """The first process that is given an item dies of it; the second does it."""
    marker = Path(path)
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return marker.name


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


def hog(_):
    return len(bytearray(4_000_000_000))


def test_what_raises_costs_no_other_item():
    outcomes = sorted(run(double, [1, 2, 3, 4], workers=2), key=lambda o: o.index)
    assert [o.value for o in outcomes] == [2, 4, None, 8]
    assert outcomes[2].failure == "ValueError: three is refused"


def test_a_worker_that_is_killed_costs_nothing(tmp_path):
    items = [str(tmp_path / name) for name in "abcd"]
    outcomes = list(run(die_once, items, workers=2))
    assert sorted(o.value for o in outcomes) == ["a", "b", "c", "d"]


def test_an_item_that_always_kills_its_worker_fails_alone():
    (outcome,) = run(die, ["x"], workers=2)
    assert outcome.failure == "the process that worked on it died"


def test_memory_is_bounded():
    (outcome,) = run(hog, ["x"], workers=1, memory_bytes=1_000_000_000)
    assert outcome.failure == "it needs more memory than a worker may take"


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Two short simulated flights, and a file that is no recording."""
    folder = tmp_path_factory.mktemp("recordings")
    for seed in (1, 2):
        flight, _, _ = draw(seed, share=0.3, rate_hz=100.0)
        (folder / f"f{seed}").mkdir()
        write_mcap(flight, folder / f"f{seed}" / "flight.mcap")
    (folder / "broken.ulg").write_bytes(b"this is no log")
    return folder


def batch_all(folder, out, **how):
    found = batch.find([f"{folder}/**"])
    return list(batch.results(batch.tasks(found, str(out), None, ("identify",)), **how))


def test_a_bad_file_is_listed_and_what_is_done_is_not_done_again(recordings, tmp_path):
    first = batch_all(recordings, tmp_path, workers=2)
    assert sorted(r.state for r in first) == ["bad", "done", "done"]
    assert all(r.fresh for r in first)
    bad = next(r for r in first if r.state == "bad")
    assert "broken.ulg" in bad.sentence
    times = {p: p.stat().st_mtime_ns for p in recordings.rglob("identification.json")}
    again = batch_all(recordings, tmp_path, workers=1)
    assert not any(r.fresh for r in again)
    assert batch.table(again) == batch.table(first)
    assert times == {p: p.stat().st_mtime_ns for p in recordings.rglob("identification.json")}
    (recordings / "f1" / batch.BATCH_FILE).unlink()  # as after a crash: results without a mark do not count
    redone = batch_all(recordings, tmp_path, workers=1)
    assert [Path(r.source).parent.name for r in redone if r.fresh] == ["f1"]
    assert batch.table(redone) == batch.table(first)


def test_a_changed_recording_or_vehicle_is_another_task(recordings, tmp_path):
    source = str(recordings / "f1" / "flight.mcap")
    (task,) = batch.tasks([source], str(tmp_path), None, ("identify",))
    vehicle = tmp_path / "v.toml"
    vehicle.write_text("x = 1\n")
    (other,) = batch.tasks([source], str(tmp_path), vehicle, ("identify",))
    (more,) = batch.tasks([source], str(tmp_path), None, ("identify", "diagnose"))
    assert len({task.key, other.key, more.key}) == 3


def test_two_logs_of_one_name_do_not_share_a_folder(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / "log.ulg").write_bytes(name.encode())
    wanted = batch.tasks(batch.find([f"{tmp_path}/**"]), str(tmp_path / "logs"), None, ("identify",))
    assert len({t.results for t in wanted}) == 2


def test_a_pattern_that_names_nothing_is_refused(tmp_path):
    with pytest.raises(BadInput, match="names no recording"):
        batch.find([str(tmp_path / "*.ulg")])


@pytest.fixture
def cluster():
    """A Dask scheduler and two workers, each a process of its own, on loopback."""
    script = (
        "from distributed import LocalCluster; import sys\n"
        "if __name__ == '__main__':\n"
        "    c = LocalCluster(n_workers=2, threads_per_worker=1, host='127.0.0.1', dashboard_address=None, "
        "processes=True)\n"
        "    print(c.scheduler_address, *(n.pid for n in c.workers.values()), flush=True); sys.stdin.read()\n"
    )
    env = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(Path.cwd())}
    process = subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=env,
    )
    assert process.stdout is not None
    address, *pids = process.stdout.readline().split()
    yield address, [int(p) for p in pids]
    process.stdin.close()
    process.wait(30)


def test_a_cluster_makes_the_same_table_although_a_worker_is_killed(recordings, tmp_path, cluster):
    address, pids = cluster
    here = batch_all(recordings, tmp_path, workers=2)
    for marker in recordings.rglob(batch.BATCH_FILE):
        marker.unlink()
    (tmp_path / "broken" / batch.BATCH_FILE).unlink()
    there = []
    for result in batch.results(
        batch.tasks(batch.find([f"{recordings}/**"]), str(tmp_path), None, ("identify",)), scheduler=address
    ):
        if not there:
            os.kill(pids[0], signal.SIGKILL)
        there.append(result)
    assert all(r.fresh for r in there)
    assert json.dumps(batch.table(there)) == json.dumps(batch.table(here))


def test_results_at_a_url_come_from_there_and_stay_there(recordings, tmp_path):
    """``file://`` stands for any store that fsspec reaches."""
    out = f"file://{tmp_path}/store"
    source = f"file://{recordings}/f2/flight.mcap"
    (first,) = batch.results(batch.tasks([source], out, None, ("identify",)))
    assert first.state == "done"
    assert (tmp_path / "store" / "flight" / batch.BATCH_FILE).is_file()
    (again,) = batch.results(batch.tasks([source], out, None, ("identify",)))
    assert not again.fresh
    assert batch.table([again]) == batch.table([first])


def test_no_scheduler_is_a_sentence():
    with pytest.raises(BadInput, match="no Dask scheduler answers"):
        list(run(double, [1], scheduler="tcp://127.0.0.1:9"))
