"""Files that are whole or not there."""

import os
from pathlib import Path

import pytest

from groundstation.writing import write_whole


def test_a_file_is_written_and_nothing_is_left_beside_it(tmp_path):
    path = tmp_path / "plan.toml"
    assert write_whole(path, "mass = 1 # µ\n") == path
    write_whole(path, b"mass = 2\n")
    assert path.read_text() == "mass = 2\n"
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_there_stays_where_the_disk_fails(tmp_path, monkeypatch):
    path = write_whole(tmp_path / "plan.toml", "whole")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(path, "anew")
    assert path.read_text() == "whole"
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_meets_the_old_file_or_the_new_one(tmp_path, monkeypatch):
    path = write_whole(tmp_path / "plan.toml", "old")
    seen, replace = [], Path.replace

    def looked_at(self: Path, target: Path) -> Path:
        seen.append(path.read_text())
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", looked_at)
    write_whole(path, "new")
    assert (seen, path.read_text()) == (["old"], "new")


def test_a_link_keeps_pointing_and_a_device_stays_one(tmp_path):
    path, link = tmp_path / "plan.toml", tmp_path / "link.toml"
    path.write_text("old")
    link.symlink_to(path)
    write_whole(link, "new")
    assert link.is_symlink() and path.read_text() == "new"
    write_whole("/dev/null", "gone")
    assert Path("/dev/null").is_char_device()
