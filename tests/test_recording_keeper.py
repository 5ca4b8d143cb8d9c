"""A recording is written through, and its folder's end is noticed within a second and told; nothing that records
waits.
"""

from __future__ import annotations

import os
import queue
import shutil
import threading
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from drivers.samples import Event
from groundstation.flight.journal import Journal
from groundstation.recording.keeper import Keeper, missing
from groundstation.recording.recorder import McapRecorder


def read_raw(path: Path):
    """Messages by the MCAP library, not ours."""
    with path.open("rb") as file:
        yield from make_reader(file).iter_messages(topics=None)


def kept(path: Path, sync, told: queue.SimpleQueue, every_s: float = 0.02) -> Keeper:
    return Keeper(path, sync, lambda reason: told.put((time.monotonic(), reason)), every_s)


@pytest.mark.parametrize("how", ["removed", "moved", "replaced"])
def test_a_folder_that_is_gone_is_told_once_with_what_it_means(tmp_path, how):
    folder = tmp_path / "flight"
    recorder, told = McapRecorder(folder / "flight.mcap"), queue.SimpleQueue()
    keeper = kept(recorder.path, recorder.sync, told, every_s=0.5)
    begun = time.monotonic()
    if how == "removed":
        shutil.rmtree(folder)
    elif how == "moved":
        folder.rename(tmp_path / "elsewhere")
    else:
        recorder.path.unlink()
        recorder.path.write_bytes(b"another's")
    when, reason = told.get(timeout=5.0)
    assert when - begun < 1.0
    assert "lost" in reason and str(folder) in reason
    recorder.add(Event(1.0, "note", "still taken"), 1.0)
    recorder.close()
    keeper.close()
    assert told.empty()


def test_a_full_disk_is_told_before_it_is_full(tmp_path, monkeypatch):
    path = tmp_path / "flight.mcap"
    path.write_bytes(b"")
    assert missing(path, path.stat()) == ""
    room = os.statvfs(tmp_path)
    low = os.statvfs_result([room.f_bsize, room.f_frsize, room.f_blocks, 5, 5, *list(room)[5:]])
    monkeypatch.setattr(os, "statvfs", lambda _path: low)
    assert "full" in missing(path, path.stat())


def test_a_sync_that_hangs_holds_no_sample_up(tmp_path):
    recorder, hang, told = McapRecorder(tmp_path / "flight.mcap"), threading.Event(), queue.SimpleQueue()
    began = threading.Event()

    def sync() -> None:
        began.set()
        hang.wait(10.0)

    keeper = kept(recorder.path, sync, told)
    assert began.wait(5.0)
    for k in range(1000):
        recorder.add(Event(0.01 * k, "note", "x"), 0.01 * k)
    recorder.close()
    assert recorder.written == 1000 and recorder.lost == 0 and not hang.is_set()
    hang.set()
    keeper.close()
    assert sum(1 for _ in read_raw(tmp_path / "flight.mcap")) == 1000


def test_a_disk_that_does_not_take_a_sync_is_told(tmp_path):
    path, told = tmp_path / "flight.mcap", queue.SimpleQueue()
    path.write_bytes(b"")

    def sync() -> None:
        raise OSError(5, "Input/output error")

    keeper = kept(path, sync, told)
    assert "Input/output error" in told.get(timeout=5.0)[1]
    keeper.close()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device here that is always full")
def test_a_journal_on_a_full_disk_ends_nothing(tmp_path):
    path = tmp_path / "flight.log.jsonl"
    path.symlink_to("/dev/full")
    journal = Journal(path, lambda: 1.0)
    for _ in range(3):
        journal.write("phase", "idle -> planned")
    journal.close()
    assert path.is_symlink()
