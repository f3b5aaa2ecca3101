"""Small files are small, JSON is plain data, and no path in a file leaves its folder."""

import json
import os
from pathlib import Path

import pytest

from fpplab.core import config, journals
from fpplab.core.checksums import check_recorded, write_recorded
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import read_bounded
from fpplab.core.journals import whole_lines
from fpplab.core.lock import lock_owner
from fpplab.core.strict_json import parse_json, parse_object
from sim.dataset.card import read_card
from sim.dataset.shard import check_shard

DEEP = "[" * 100_000


def test_a_file_may_have_just_as_many_bytes_as_its_kind(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"12345")
    assert read_bounded(tmp_path / "a", 5) == b"12345"
    with pytest.raises(OSError, match="larger than 4 bytes, the most"):
        read_bounded(tmp_path / "a", 4)


def test_text_files_of_any_size_are_refused_in_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(config, "MAX_TEXT_BYTES", 10)
    (tmp_path / "rig.yaml").write_text("name: a bench\n")
    with pytest.raises(ConfigError, match=r"rig.yaml: cannot be read \(it is larger than 10 bytes"):
        config.read_text(tmp_path / "rig.yaml")


def test_journals_are_no_pipes_and_no_larger_than_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(DataError, match=r"pipe: cannot be read \(it is a pipe or a device, not a file\)"):
        whole_lines(tmp_path / "pipe")
    monkeypatch.setattr(journals, "MAX_JOURNAL_BYTES", 3)
    (tmp_path / "journal.jsonl").write_text("a\nb\n")
    with pytest.raises(DataError, match=r"journal.jsonl: cannot be read \(it is larger"):
        whole_lines(tmp_path / "journal.jsonl")


@pytest.mark.parametrize("text", [DEEP, '{"a":' * 100_000, "[1, 2", "\xff", "1" * 5000, b"\xff"])
def test_json_that_cannot_be_read_is_a_value_error(text: str | bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse_json(text)


def test_json_of_an_object_is_one() -> None:
    assert parse_object('{"a": [1, null]}') == {"a": [1, None]}
    for text in ("[]", "3", "null", '"a"'):
        with pytest.raises(ValueError, match="not an object"):
            parse_object(text)


def test_records_nested_without_end_are_refused(tmp_path: Path) -> None:
    write_recorded(tmp_path / "plan.yaml", "a: 1\n")
    (tmp_path / "files.jsonl").write_text(DEEP + "\n")
    with pytest.raises(DataError, match=r"files.jsonl line 1: is not the checksum of a file"):
        check_recorded(tmp_path / "plan.yaml", b"a: 1\n")
    (tmp_path / "card.json").write_text(DEEP)
    with pytest.raises(DataError, match=r"card.json: cannot be read"):
        read_card(tmp_path)
    (tmp_path / "lock").write_text(DEEP)
    assert lock_owner(tmp_path / "lock") == "another process"
    (tmp_path / "lock").write_text(json.dumps({"pid": 1, "host": "h", "command": "c", "since": "s"}))
    assert lock_owner(tmp_path / "lock") == "process 1 on h ('c', since s)"


@pytest.mark.parametrize("name", ["../secret", "/etc/hostname", "a/../../secret"])
def test_checksums_of_a_shard_are_of_its_own_files(tmp_path: Path, name: str) -> None:
    (tmp_path / "secret").write_bytes(b"x")
    shard = tmp_path / "shard_00000"
    shard.mkdir()
    (shard / "sha256.json").write_text(json.dumps({name: "0" * 64}))
    with pytest.raises(DataError, match="which is not in its folder"):
        check_shard(shard)
