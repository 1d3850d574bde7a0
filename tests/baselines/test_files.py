"""Files: writes are atomic, and readers raise only ValueError with a message of one line."""

import csv
import io
import json
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baselines.tools.files import (
    DEEPEST,
    checked_plain,
    guarded,
    parse_yaml,
    read_bytes,
    read_csv,
    read_json,
    read_text,
    read_yaml,
    write_atomically,
)

TEXT = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]))  # others: two in JSON, one in YAML
LEAF = st.none() | st.booleans() | st.integers() | st.floats() | TEXT
FLAT = LEAF | st.lists(LEAF, max_size=4) | st.dictionaries(TEXT, LEAF, max_size=4)
PLAIN = FLAT | st.lists(FLAT, max_size=4) | st.dictionaries(TEXT, FLAT, max_size=4)
READERS = (read_csv, read_json, read_text, read_yaml)
AWKWARD = {
    "brackets": b"[" * 100_000,
    "tables": b'{"a":' * 100_000,
    "deep but valid": b"[" * (DEEPEST + 2) + b"]" * (DEEPEST + 2),
    "a large number": b"[" + b"9" * 309 + b"]",
    "a huge number": b"9" * 100_000,
    "half a character": b'["\\ud800"]',
    "other bytes": b"\xff\xfe\x00",
    "a quote": b'a,b\n1,"2',
    "no end": b'{"a": [1, 2',
}


def refusal(read, file):
    """Return the message with which a reader refuses a file; None if it reads it."""
    try:
        read(file)
    except ValueError as error:
        return str(error)
    return None


@pytest.mark.parametrize("awkward", AWKWARD)
def test_readers_raise_one_line_that_names_the_file(awkward, tmp_path):
    file = tmp_path / "input"
    file.write_bytes(AWKWARD[awkward])
    messages = [message for read in READERS if (message := refusal(read, file))]
    assert messages
    for message in messages:
        assert str(file) in message
        assert "\n" not in message
        assert len(message) < 2000
    with pytest.raises(ValueError, match="JSON"):
        read_json(file)


@settings(deadline=None)
@given(st.binary())
def test_readers_of_random_bytes_raise_only_value_errors(tmp_path_factory, data):
    file = tmp_path_factory.getbasetemp() / "bytes"
    file.write_bytes(data)
    for read in READERS:
        assert str(file) in (refusal(read, file) or str(file))


@given(PLAIN)
def test_plain_values_are_restored_from_json_and_yaml(value):
    text = json.dumps(value)
    assert repr(checked_plain(json.loads(text))) == repr(json.loads(text))
    if "NaN" not in text and "Infinity" not in text and "e" not in text:  # YAML spells these in another way
        assert json.dumps(parse_yaml(text)) == text


def test_yaml_aliases_are_refused_only_if_their_expansion_is_large():
    lines = ["a0: &a0 [1, 2]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 30)]
    with pytest.raises(ValueError, match="entries with its aliases expanded"):
        parse_yaml("\n".join(lines))
    merged = ["a0: &a0 {x: 1}"] + [f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}" for i in range(1, 30)]
    with pytest.raises(ValueError, match="entries with its aliases expanded"):
        parse_yaml("\n".join(merged))
    with pytest.raises(ValueError, match="entries with its aliases expanded"):
        parse_yaml("a: &a [*a]")
    assert parse_yaml("a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}")["b"] == {"x": 1, "y": 3}


@pytest.mark.parametrize(
    "text", ["a: 2020-01-01", "? [1, 2]\n: 3", "!!set {a}", "!!binary aGFsbG8=", "!!python/name:os.system"]
)
def test_yaml_allows_only_plain_values(text):
    with pytest.raises(ValueError, match=r"^YAML: "):
        parse_yaml(text)


def test_only_regular_files_of_a_bounded_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for file in (tmp_path / "pipe", tmp_path):
        with pytest.raises(ValueError, match="is no regular file"):
            read_bytes(file)
    (tmp_path / "large").write_bytes(bytes(11))
    with pytest.raises(ValueError, match="is larger than 10 bytes"):
        read_bytes(tmp_path / "large", 10)
    assert read_bytes(tmp_path / "large", 11) == bytes(11)
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "none")


@given(st.lists(st.fixed_dictionaries({"a": st.text("xyz,\"'\n", min_size=1), "b": st.text("xyz ")}), max_size=5))
def test_tables_are_restored_without_empty_entries(tmp_path_factory, rows):
    buffer = io.StringIO(newline="")
    writer = csv.DictWriter(buffer, ["a", "b"])
    writer.writeheader()
    writer.writerows(rows)
    file = tmp_path_factory.getbasetemp() / "table.csv"
    file.write_bytes(buffer.getvalue().encode())
    assert read_csv(file) == [{k: v for k, v in row.items() if v} for row in rows]


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
