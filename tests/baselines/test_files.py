"""Files: writes are atomic, tables are restored, and readers raise ValueError with the name of the file."""

import os

import pytest

from baselines.tools.files import guarded, read_csv, read_json, write_atomically


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="pipe is no regular file"):
        read_json(tmp_path / "pipe")
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "none")


def test_tables_are_restored_without_empty_entries(tmp_path):
    (tmp_path / "table.csv").write_bytes(b'a,b\r\n"x,""\n1",\r\n2,y\r\n')
    assert read_csv(tmp_path / "table.csv") == [{"a": 'x,"\n1'}, {"a": "2", "b": "y"}]


def test_guarded_converts_only_exceptions_of_damaged_files():
    for kind in (OSError, KeyboardInterrupt, SystemExit):
        with pytest.raises(kind), guarded("x"):
            raise kind("y")
    with pytest.raises(ValueError, match=r"^x: AssertionError: y$"), guarded("x"):
        raise AssertionError("y")


def test_a_failed_write_keeps_the_old_file(tmp_path, monkeypatch):
    file, synced = tmp_path / "file", []
    monkeypatch.setattr(os, "fsync", synced.append)
    write_atomically(file, "old")
    assert len(synced) == 2  # the file and its folder
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(OSError, match="No space"):
        write_atomically(file, b"new")
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]
