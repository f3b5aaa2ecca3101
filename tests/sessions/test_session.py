"""A session after a crash at any moment, and with anything in it damaged."""

import json
import os
import shutil
import signal
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.session_names import FRAMES, JOURNAL
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session, recorded_sessions
from tests.support.recorded import PLAN, KillAtLine, frame, image_of, in_a_child, record


@pytest.fixture(autouse=True)
def _quick_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a process has written outlives it, also when it is not on the disk yet."""
    monkeypatch.setattr(os, "fsync", lambda handle: None)


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return record(tmp_path / "session").path


def check_whole(session: Session) -> None:
    assert session.missing() == []
    for index, image in enumerate(Session.open(session.path).stack()):
        np.testing.assert_array_equal(image, image_of(index))


def test_a_journal_torn_at_any_byte_of_its_last_line(whole: Path) -> None:
    journal = whole / JOURNAL
    text = journal.read_bytes()
    start = text.rfind(b"\n", 0, -1) + 1
    for cut in range(start, len(text)):
        journal.write_bytes(text[:cut])
        assert Session.open(whole).missing() == [3]
        if cut % 8 == start % 8:
            session = Session.resume(whole, PLAN)
            session.write(frame(3))
            check_whole(session)


@pytest.mark.whole
def test_killed_at_any_line_while_a_frame_is_written(tmp_path: Path) -> None:
    begun = record(tmp_path / "begun", 2).path
    for n in count():
        path = shutil.copytree(begun, tmp_path / "killed")

        def work(path: Path = path, n: int = n) -> None:
            session = Session.open(path)
            sys.settrace(KillAtLine(n))
            session.write(frame(2))
            sys.settrace(None)

        ended = in_a_child(work)
        assert ended in (0, -signal.SIGKILL)
        survivor = Session.open(path)
        assert survivor.missing() in ([2, 3], [3])
        for index in range(4 - len(survivor.missing())):
            np.testing.assert_array_equal(survivor.read(index), image_of(index))
        resumed = Session.resume(path, PLAN)
        for index in resumed.missing():
            resumed.write(frame(index))
        check_whole(resumed)
        assert len(list((path / FRAMES).iterdir())) == 4, "half a file is left behind"
        shutil.rmtree(path)
        if ended == 0:
            break
    assert n > 20


@pytest.mark.whole
def test_killed_at_any_line_while_a_session_is_made(tmp_path: Path) -> None:
    for n in count():
        path = tmp_path / f"{n}" / "session"

        def work(path: Path = path, n: int = n) -> None:
            sys.settrace(KillAtLine(n))
            Session.create(path, PLAN)
            sys.settrace(None)

        ended = in_a_child(work)
        assert ended in (0, -signal.SIGKILL)
        resumed = Session.resume(path, PLAN)
        assert resumed.missing() == [0, 1, 2, 3]
        if ended == 0:
            break
    assert n > 20


def test_a_disk_that_is_gone_is_not_written_beneath(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a mount that is lost, the empty folder is left that it was mounted on."""
    session = record(tmp_path / "disk" / "part", 1)
    (tmp_path / "disk").rename(tmp_path / "gone")
    (tmp_path / "disk").mkdir()
    with pytest.raises(DataError, match="is not on its disk any more; connect that again"):
        session.write(frame(1))
    assert list((tmp_path / "disk").iterdir()) == []
    (tmp_path / "gone" / "part").rename(tmp_path / "disk" / "part")
    stated = Path.stat

    def on_another_disk(path: Path, **given: Any) -> os.stat_result:
        mode, node, disk, *others = stated(path, **given)[:10]
        return os.stat_result((mode, node, disk + 1, *others))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "stat", on_another_disk)
        with pytest.raises(DataError, match="is not on its disk any more"):
            session.write(frame(1))
    session.write(frame(1))


def test_a_missing_frame(whole: Path) -> None:
    (whole / Session.open(whole).record(2).file).unlink()
    with pytest.raises(DataError, match="frame 2 is missing"):
        Session.open(whole).stack()


def test_an_altered_frame(whole: Path) -> None:
    path = whole / Session.open(whole).record(2).file
    data = bytearray(path.read_bytes())
    data[-7] ^= 1
    path.write_bytes(data)
    with pytest.raises(DataError, match=r"frame 2 is corrupt: its checksum"):
        Session.open(whole).stack()
    assert Session.open(whole).read(2, verify=False).shape == (16, 20)


def test_a_frame_truncated_at_any_length(whole: Path) -> None:
    path = whole / Session.open(whole).record(2).file
    data = path.read_bytes()
    for length in range(0, len(data), 7):
        path.write_bytes(data[:length])
        with pytest.raises(DataError, match=r"frame 2 is (truncated or damaged|corrupt)"):
            Session.open(whole).read(2)


def test_frames_that_were_swapped(whole: Path) -> None:
    one, two = (whole / Session.open(whole).record(i).file for i in (1, 2))
    one.rename(whole / "x")
    two.rename(one)
    (whole / "x").rename(two)
    with pytest.raises(DataError, match="frame 1 is corrupt"):
        Session.open(whole).stack()


@pytest.mark.parametrize(
    ("image", "found"),
    [
        (np.zeros((16, 21), np.uint8), r"uint8 \(21, 16\)"),
        (np.zeros((16, 20), np.uint16), r"uint16 \(20, 16\)"),
        (np.zeros((16, 20, 3), np.uint8), r"uint8 \(3, 20, 16\)"),
    ],
)
def test_a_frame_of_another_kind(whole: Path, image: np.ndarray[Any, Any], found: str) -> None:
    path = whole / Session.open(whole).record(1).file
    photometric = "rgb" if image.ndim == 3 else "minisblack"
    tifffile.imwrite(path, image, photometric=photometric, metadata=None)
    with pytest.raises(DataError, match=rf"frame 1 is {found} but the journal says uint8 \(20, 16\)"):
        Session.open(whole).read(1)


def test_frames_of_two_sizes(tmp_path: Path) -> None:
    session = record(tmp_path / "session", 3)
    session.write(frame(3, image=np.zeros((8, 8), np.uint8)))
    with pytest.raises(DataError, match="frame 3 is 8 x 8 at 8 bits, but the first is 20 x 16 at 8 bits"):
        Session.open(session.path).stack()


def test_frames_of_two_depths(tmp_path: Path) -> None:
    session = record(tmp_path / "session", 3)
    session.write(frame(3, image=np.zeros((16, 20), np.uint16), bits=12))
    with pytest.raises(DataError, match="frame 3 is 20 x 16 at 12 bits, but the first is 20 x 16 at 8"):
        Session.open(session.path).stack()


def alter(path: Path, line: int, **fields: object) -> None:
    """Write other values into a line of the journal."""
    lines = (path / JOURNAL).read_text().splitlines()
    lines[line] = json.dumps(json.loads(lines[line]) | fields)
    (path / JOURNAL).write_text("\n".join(lines) + "\n")


def test_a_frame_recorded_twice(whole: Path) -> None:
    lines = (whole / JOURNAL).read_text().splitlines()
    (whole / JOURNAL).write_text("\n".join([*lines, lines[1]]) + "\n")
    with pytest.raises(DataError, match="line 5: frame 1 is recorded already"):
        Session.open(whole)
    (whole / JOURNAL).write_text("\n".join(lines) + "\n")
    with pytest.raises(DataError, match="frame 1 is recorded already"):
        Session.open(whole).write(frame(1))


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"index": 4}, "another plan"),
        ({"index": -1}, "another plan"),
        ({"pattern": "00-x-2-001of4"}, "another plan"),
        ({"index": "1"}, "'index' is '1'"),
        ({"width": None}, "'width' is None"),
        ({"colour": "red"}, "unknown key 'colour'"),
        ({"exposure_s": float("nan")}, "line 2: is not a frame's record"),
    ],
)
def test_a_record_that_does_not_fit(whole: Path, fields: dict[str, object], complaint: str) -> None:
    alter(whole, 1, **fields)
    with pytest.raises(DataError, match=f"line 2: .*{complaint}|{complaint}"):
        Session.open(whole)


@pytest.mark.parametrize(
    "line", [b"", b"{}", b"[1, 2]", b"\x00\x00\x00", b"\xff\xfe", b'{"index": 1', b"null"]
)
def test_a_line_that_is_no_record(whole: Path, line: bytes) -> None:
    lines = (whole / JOURNAL).read_bytes().splitlines()
    (whole / JOURNAL).write_bytes(b"\n".join([*lines[:2], line, lines[3]]) + b"\n")
    with pytest.raises(DataError, match="line 3: is not a frame's record"):
        Session.open(whole)


def test_a_frame_that_the_plan_has_not(tmp_path: Path) -> None:
    session = record(tmp_path / "session", 1)
    other = Plan(fringes=(Sinusoid(axis="y", stripes=1, steps=9),))
    for index in (1, 8):
        with pytest.raises(DataError, match="not what the plan has there"):
            session.write(frame(index, other))
    assert Session.open(session.path).missing() == [1, 2, 3]
    assert len(list((session.path / FRAMES).iterdir())) == 1


def test_no_session_at_all(tmp_path: Path, whole: Path) -> None:
    with pytest.raises(DataError, match="nowhere: there is no such file or folder"):
        Session.open(tmp_path / "nowhere")
    for path in (whole / "frames", whole / "plan.yaml"):
        with pytest.raises(DataError, match=rf"expected a session, .*; did you mean the session {whole}"):
            Session.open(path)
    (whole / "plan.yaml").unlink()
    with pytest.raises(DataError, match=r"is not a session \(it has no plan\.yaml\)"):
        Session.open(whole)


def test_a_session_without_frames_says_so(tmp_path: Path) -> None:
    session = Session.create(tmp_path / "session", PLAN)
    with pytest.raises(DataError, match="has no frames yet"):
        _ = session.format
    with pytest.raises(DataError, match=r"4 of 4 frames are missing \(0, 1, 2, 3\)"):
        session.stack()
    with pytest.raises(DataError, match="frame 0 is not recorded"):
        session.read(0)


def test_resuming_with_another_plan_or_rig(tmp_path: Path) -> None:
    path = tmp_path / "session"
    rig = {"name": "one", "camera": {"serial": "21e7", "gain_db": 1e-5}}
    Session.create(path, PLAN, rig).write(frame(0))
    assert Session.resume(path, PLAN, rig).missing() == [1, 2, 3]
    with pytest.raises(DataError, match="another plan"):
        Session.resume(path, PLAN.model_copy(update={"exposure_s": 0.5}), rig)
    with pytest.raises(DataError, match="another rig"):
        Session.resume(path, PLAN, rig | {"name": "two"})
    assert Session.resume(path, PLAN, rig | {"name": "two"}, force=True).missing() == [0, 1, 2, 3]


def test_resuming_with_another_item_or_pose(tmp_path: Path) -> None:
    path = tmp_path / "session"
    bench: dict[str, Any] = {"name": "one", "resolved": {"camera": {"serial": "21e7"}}}

    def holding(item: str, pose: int) -> dict[str, Any]:
        return bench | {"resolved": bench["resolved"] | {"mounted": {"item": item, "pose": pose}}}

    Session.create(path, PLAN, holding("board", 1)).write(frame(0))
    assert Session.resume(path, PLAN, holding("board", 1)).missing() == [1, 2, 3]
    for other in (holding("pyramid", 1), holding("board", 2), bench):
        with pytest.raises(DataError, match="another item or pose"):
            Session.resume(path, PLAN, other)


@pytest.mark.parametrize("load", [Session.stack, Session.recording])
def test_a_session_is_not_loaded_with_an_altered_frame(
    whole: Path, load: Callable[[Session], object]
) -> None:
    path = whole / Session.open(whole).record(2).file
    data = bytearray(path.read_bytes())
    data[-7] ^= 1
    path.write_bytes(data)
    (whole / "rig.yaml").unlink(missing_ok=True)
    with pytest.raises(DataError, match=r"frame 2 is corrupt: its checksum"):
        load(Session.open(whole))


def test_what_exists_is_not_overwritten(whole: Path) -> None:
    for make in (Session.create, Session.resume):
        with pytest.raises(ConfigError, match="exists already; name another output, or add --force"):
            make(whole, PLAN)
    check_whole(Session.open(whole))
    assert Session.create(whole, PLAN, force=True).missing() == [0, 1, 2, 3]


def test_force_replaces_sessions_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "photographs"
    folder.mkdir()
    (folder / "wedding.png").write_bytes(b"dear")
    for make in (Session.create, Session.resume):
        with pytest.raises(DataError, match="is not a session, so --force does not replace it"):
            make(folder, PLAN, force=True)
    assert (folder / "wedding.png").read_bytes() == b"dear"
    (tmp_path / "note").write_text("x")
    with pytest.raises(DataError, match="is not a session"):
        Session.create(tmp_path / "note", PLAN, force=True)


def test_sessions_that_belong_together(tmp_path: Path) -> None:
    for k in range(3):
        record(tmp_path / "poses" / f"pose_{k:02d}")
    found = recorded_sessions([tmp_path / "poses"])
    assert [s.path.name for s in found] == ["pose_00", "pose_01", "pose_02"]
    assert recorded_sessions([found[1].path])[0].path == found[1].path
    with pytest.raises(DataError, match="is a folder without a session"):
        recorded_sessions([tmp_path])


def test_sessions_that_do_not(tmp_path: Path) -> None:
    record(tmp_path / "a")
    record(tmp_path / "b", plan=PLAN.model_copy(update={"exposure_s": 0.5}))
    with pytest.raises(DataError, match="another plan"):
        recorded_sessions([tmp_path / "a", tmp_path / "b"])
    other = Session.create(tmp_path / "c", PLAN)
    other.write(frame(0, image=np.zeros((8, 8), np.uint8)))
    with pytest.raises(DataError, match=r"frames of 8 x 8 at 8 bits, but .* of 20 x 16"):
        recorded_sessions([tmp_path / "a", tmp_path / "c"])
