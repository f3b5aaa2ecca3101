"""Files of strangers that attack who reads them: archives, YAML, JSON and words for the terminal."""

import io
import json
import os
import pickle
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fpplab.cli import console
from fpplab.cli.console import NOT_PRINTED
from fpplab.clouds.files import load_cloud
from fpplab.core import archives, config, strict_yaml
from fpplab.core.archives import ArchiveLimits, load_arrays
from fpplab.core.errors import FppError
from fpplab.core.strict_json import parse_object
from fpplab.core.strict_yaml import YamlLimits, load_yaml
from fpplab.patterns.plan import Plan
from fpplab.phase.decoded import Decoded
from fpplab.sessions.bug_report import write_bug_report
from fpplab.sessions.session import Session
from tests.support.recorded import record

LONGEST_S = 2.0
MOST_BYTES = 300 << 20


class Harmful:
    """Makes a file where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Callable[[str], object], tuple[str]]:
        return os.mkdir, (str(self.mark),)


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.fixture(autouse=True)
def bounded() -> object:
    """Each attack ends soon, and takes little memory."""
    before, began = resident_bytes(), time.process_time()
    yield
    assert time.process_time() - began < LONGEST_S
    assert resident_bytes() - before < MOST_BYTES


def archive(name: str, content: bytes, kind: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as written:
        written.writestr(name, content)
    return out.getvalue()


def npy(head: str, values: bytes = b"", version: tuple[int, int] = (1, 0)) -> bytes:
    return b"\x93NUMPY" + bytes(version) + struct.pack("<H", len(head) + 1) + head.encode() + b"\n" + values


def with_a_link() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as written:
        link = zipfile.ZipInfo("u.npy")
        link.external_attr = 0o120777 << 16
        written.writestr(link, "/etc/passwd")
    return out.getvalue()


def with_size(claimed: int) -> bytes:
    """An archive whose only part claims a size."""
    content = bytearray(archive("u.npy", b"\0" * 100, zipfile.ZIP_STORED))
    for place in (content.find(b"PK\x01\x02") + 24,):
        content[place : place + 4] = struct.pack("<I", claimed)
    return bytes(content)


ARCHIVES: dict[str, Callable[[Path], bytes]] = {
    "objects": lambda mark: archive("u.npy", npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }")
                                    + pickle.dumps(np.array([Harmful(mark)], object))),
    "no archive but objects": lambda mark: pickle.dumps(Harmful(mark)),
    "more values than memory": lambda _: archive(
        "u.npy", npy("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }")
    ),
    "fewer than no values": lambda _: archive(
        "u.npy", npy("{'descr': '<f4', 'fortran_order': False, 'shape': (-1, -1000000), }", b"\0" * 64)
    ),
    "a shape that overflows": lambda _: archive(
        "u.npy", npy("{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296), }")
    ),
    "a head that is a program": lambda mark: archive("u.npy", npy(f"__import__('os').mkdir({str(mark)!r})")),
    "a head of many brackets": lambda _: archive("u.npy", npy("(" * 60_000)),
    "much out of little": lambda _: archive("u.npy", b"\0" * 100_000),
    "a part that claims more than there is": lambda _: with_size(0xFFFFFFF0),
    "a symbolic link": lambda _: with_a_link(),
    "a place above": lambda _: archive("../../../u.npy", npy("{}")),
    "an archive that is cut off": lambda _: archive("u.npy", b"\1" * 1000)[:60],
    "a text field as numbers": lambda _: archive(
        "u.npy", npy("{'descr': [('u', '|O')], 'fortran_order': False, 'shape': (1,), }", b"\0" * 8)
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ARCHIVES)
def test_an_archive_is_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archives, "LIMITS", ArchiveLimits(always_allowed_bytes=80_000))
    mark, file = tmp_path / "ran", tmp_path / "decoded.npz"
    file.write_bytes(ARCHIVES[name](mark))
    with pytest.raises(FppError) as refused:
        Decoded.load(file)
    assert "\n" not in str(refused.value)
    with pytest.raises((ValueError, KeyError)):
        load_arrays(file, ["u"])["u"]
    assert {entry.name for entry in tmp_path.iterdir()} == {"decoded.npz"}


@pytest.mark.parametrize("frames", [False, True])
def test_links_of_a_session_stay_out_of_a_bug_report(frames: bool, tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("root:x:0:0: not for others", encoding="utf-8")
    session = record(tmp_path / "part", 2).path
    for name in ("plan.yaml", "log.jsonl", "calibration.yaml", "frames/0009_x.tif"):
        (session / name).unlink(missing_ok=True)
        (session / name).symlink_to(secret)
    write_bug_report(tmp_path / "r.zip", [session], frames)
    with zipfile.ZipFile(tmp_path / "r.zip") as report:
        content = {name: report.read(name) for name in report.namelist()}
    assert not any(b"root:x" in part for part in content.values())
    assert b"plan.yaml is a symbolic link, which is not followed" in content["1_part/verified.txt"]
    assert {"1_part/plan.yaml", "1_part/calibration.yaml"}.isdisjoint(content)
    (session / "frames").rename(tmp_path / "elsewhere")
    (session / "frames").symlink_to(tmp_path / "elsewhere")
    entries = write_bug_report(tmp_path / "s.zip", [session], frames)
    assert not [entry for entry in entries if entry.name.endswith(".tif")]


YAML = {
    "lists in lists": "[" * 1_000_000,
    "mappings in mappings": "{a: " * 300_000,
    "lists of lines": "- " * 300_000,
    "keys of keys": "? " * 300_000,
    "doubling aliases": "".join(
        f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 9)}]\n" if k >= 0 else "a: &a [1]\n"
        for k in range(-1, 12)
    ),
    "doubling by merging": "a: &a {x: 1}\nb: {<<: [*a, *a]}\n",
    "an alias of itself": "a: &a [*a]",
    "an object": "a: !!python/object/apply:os.system ['touch ran']",
    "a name of Python": "a: !!python/name:os.system",
    "a tag of its own": "%TAG ! tag:yaml.org,2002:python/\n---\na: !object/apply:os.system [x]",
    "half a character": 'a: "\\ud800"',
    "a bell": "a: \x07",
    "a key given twice": "a: 1\na: 2",
    "two documents": "a: 1\n---\nb: 2",
}


@pytest.mark.parametrize("name", YAML)
def test_yaml_is_refused(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FppError) as refused:
        config.validate(config.parse_yaml(YAML[name], "some.yaml"), Plan, "some.yaml")
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 2000
    assert list(tmp_path.iterdir()) == []


def test_many_values_are_refused_before_all_are_composed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(strict_yaml, "LIMITS", YamlLimits(max_nodes=1000))
    with pytest.raises(Exception, match="values, those that aliases repeat included"):
        load_yaml("[" + "[]," * 600_000)


LINES = {
    "lists in lists": b"[" * 1_000_000,
    "objects in objects": b'{"a":' * 300_000,
    "a name that is a list": b'{"index": 0, "pattern": ["a"], "file": ["b"], "sha256": {}, "width": 1}',
    "a number of many digits": b'{"index": ' + b"9" * 100_000 + b"}",
    "no number": b'{"index": NaN, "width": Infinity}',
    "no object": b"[]",
    "half a character": b'{"file": "\\ud800"}',
    "not UTF-8": b'{"file": "\xff"}',
}


@pytest.mark.parametrize("journal", ["journal.jsonl", "files.jsonl"])
@pytest.mark.parametrize("name", LINES)
def test_a_journal_is_refused(name: str, journal: str, tmp_path: Path) -> None:
    session = record(tmp_path / "part", 2).path
    (session / journal).write_bytes(LINES[name] + b"\n")
    with pytest.raises(FppError, match=journal) as refused:
        Session.open(session)
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code in (2, 4)


def test_an_archive_whose_names_are_no_text_is_damaged(tmp_path: Path) -> None:
    """A flag says that names are UTF-8, and one is not: the unpacker raises what is no error of archives."""
    content = archive("p\N{LATIN SMALL LETTER E WITH ACUTE}.npy", b"").replace(b"p\xc3\xa9", b"p\xe3e")
    (tmp_path / "cloud.npz").write_bytes(content)
    with pytest.raises(FppError, match=r"cloud\.npz: .*invalid continuation byte"):
        load_cloud(tmp_path / "cloud.npz")


@pytest.mark.parametrize("wrong", [{"file": ["plan.yaml"], "sha256": "0"}, {"file": "a", "sha256": 1},
                                   {"file": "a", "sha256": "0", "text": []}, {"sha256": "0"}])  # fmt: skip
def test_fields_of_another_kind_are_refused(wrong: dict[str, object], tmp_path: Path) -> None:
    session = record(tmp_path / "part", 2).path
    (session / "files.jsonl").write_text(json.dumps(wrong) + "\n", encoding="utf-8")
    with pytest.raises(FppError, match=r"files\.jsonl line 1: is not the checksum of a file"):
        Session.open(session)


def test_json_that_is_nested_without_end_is_one_exception() -> None:
    with pytest.raises(ValueError, match="too many lists and mappings inside one another"):
        parse_object(b'{"a": ' + b"[" * 1_000_000)


ORDERS = {
    "clear the screen": "\x1b[2J\x1b[H",
    "write the clipboard": "\x1b]52;c;cm0gLXJmIC8=\x07",
    "name the window": "\x1b]0;title\x1b\\",
    "a link": "\x1b]8;;http://example.com\x1b\\part\x1b]8;;\x1b\\",
    "answer for the user": "\x1bP$q\x1b\\\x1b[c",
    "one character": "\x9b31m",
    "write over": "good\rbad",
    "take back": "bad\b\b\bgood",
    "turned around": "part\u202egpj.exe",
    "another line": "a\u2028b\x0bc\x0cd",
    "a bell": "\x07\x7f",
}


@pytest.mark.parametrize("name", ORDERS)
def test_a_terminal_is_given_no_orders(name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    order = ORDERS[name]
    console.log_status(f"status {order}")
    console.print_result({f"key {order}": order, "list": [{"a": order, order: 1}]}, as_json=False)
    console.print_result({f"key {order}": order}, as_json=True)
    console.table(f"title {order}", [order, "b"], [[order, f"[red]{order}"]])
    with console.progress(f"progress {order}"):
        pass
    with pytest.raises(FppError) as refused:
        config.validate({order: 1}, Plan, tmp_path / order)
    with pytest.raises(SystemExit):
        console._end_with(refused.value, as_json=False)
    said = capsys.readouterr()
    assert "status" in said.err
    assert "title" in said.out
    assert not NOT_PRINTED.search(said.out.replace("\x7f", "") + said.err)
    assert all(ord(character) > 31 or character == "\n" for character in said.out + said.err)
