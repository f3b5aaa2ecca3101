"""Space on the disk is asked for before anything is projected or written, and refused in one sentence."""

import logging
import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from fpplab.core.disk_space import disk_bytes, need_space
from fpplab.core.errors import DataError
from fpplab.core.session_names import JOURNAL
from fpplab.core.units import readable_bytes
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session, take_poses
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.importing import import_images
from fpplab.sessions.session import Session
from tests.conformance.reference import ReferenceFixture, ReferenceProjector
from tests.support.commands import ROOT, Command
from tests.support.recorded import image_of

RIG = ROOT / "tests/conformance/rigs/rig_reference.yaml"
SETS = (Sinusoid(axis="x", stripes=1, steps=4), Sinusoid(axis="y", stripes=1, steps=3))
PLAN = Plan(fringes=SETS)
FRAME = 48 * 32
"""Bytes of a frame of the reference rig at 8 bits."""
Usage = namedtuple("Usage", "total used free")


def leave(monkeypatch: pytest.MonkeyPatch, free: int) -> None:
    """Have the disk say that so many bytes are free."""
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**12, 10**12 - free, free))


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig that must neither show nor move anything."""

    def fail(*_: object) -> None:
        raise AssertionError("the rig was used before the disk was looked at")

    for kind, hooks in ((ReferenceProjector, ("_show", "_load", "_play")), (ReferenceFixture, ("_mount",))):
        for hook in hooks:
            monkeypatch.setattr(kind, hook, fail)


def test_a_scan_that_does_not_fit_is_refused_before_anything_is_done(
    tmp_path: Path, idle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave(monkeypatch, 7 * FRAME - 1)
    out = tmp_path / "scans" / "s"
    with Rig.load(RIG) as rig, pytest.raises(DataError) as caught:
        take_or_resume_session(rig, PLAN, out, ("grey_card", 0))
    assert str(caught.value) == (
        f"{out}: 7 frames of 48 x 32 at 8 bits need 10.8 kB, but only 10.8 kB are free there; free some "
        "space, or name an output on another disk"
    )
    assert list(tmp_path.iterdir()) == []


def test_a_scan_that_just_fits_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leave(monkeypatch, 7 * FRAME)
    with Rig.load(RIG) as rig:
        assert take_or_resume_session(rig, PLAN, tmp_path / "s").missing() == []


def test_deeper_frames_need_twice_as_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    leave(monkeypatch, 7 * FRAME)
    deep = PLAN.model_copy(update={"bits": 12})
    with Rig.load(RIG) as rig, pytest.raises(DataError, match=r"at 12 bits need 21\.5 kB"):
        take_or_resume_session(rig, deep, tmp_path / "s")


def test_an_interrupted_scan_needs_what_it_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "s"
    with Rig.load(RIG) as rig:
        take_or_resume_session(rig, PLAN, out)
        lines = (out / JOURNAL).read_bytes().splitlines(keepends=True)
        (out / JOURNAL).write_bytes(b"".join(lines[:5]))
        leave(monkeypatch, 2 * FRAME - 1)
        with pytest.raises(DataError, match="2 frames of"):
            take_or_resume_session(rig, PLAN, out)
        assert len(Session.open(out).missing()) == 2
        leave(monkeypatch, 2 * FRAME)
        take_or_resume_session(rig, PLAN, out)
        leave(monkeypatch, 0)
        assert (
            take_or_resume_session(rig, PLAN, out, accept_complete=True).missing() == []
        )  # nothing is to be written


def test_a_replaced_session_frees_its_own_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "s"
    with Rig.load(RIG) as rig:
        take_or_resume_session(rig, PLAN, out)
        leave(monkeypatch, 0)
        assert disk_bytes(out) >= 7 * FRAME
        assert take_or_resume_session(rig, PLAN, out, replace_existing=True).missing() == []


def test_all_poses_are_counted_before_the_first(
    tmp_path: Path, idle: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    leave(monkeypatch, 12 * 7 * FRAME - 1)
    with Rig.load(RIG) as rig, pytest.raises(DataError, match=r"poses: 84 frames of 48 x 32 at 8 bits need"):
        take_poses(rig, PLAN, "board", 12, tmp_path / "poses", False)
    assert list(tmp_path.iterdir()) == []


def test_imported_images_that_do_not_fit_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from PIL import Image as Pillow

    for index in range(7):
        Pillow.fromarray(image_of(index)).save(tmp_path / f"{index}.png")
    words = (ImageSelection((tmp_path,), "{index}.png"), PLAN, tmp_path / "s")
    leave(monkeypatch, 7 * 20 * 16 - 1)
    with pytest.raises(DataError, match="7 frames of 20 x 16 at 8 bits need 2"):
        import_images(*words, projector_size=(64, 48))
    assert not (tmp_path / "s").exists()
    leave(monkeypatch, 7 * 20 * 16)
    assert import_images(*words, projector_size=(64, 48)).missing() == []


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "out"),
    [
        (("characterise", "--target", "target_paper", "--poses", 200_000), "c.yaml"),
        (("dataset", "--count", 1_000_000), "d"),
    ],
    ids=["poses", "data set"],
)
def test_commands_that_need_more_than_there_is_leave_nothing(
    fpplab: Command, tmp_path: Path, words: tuple[object, ...], out: str
) -> None:
    done = fpplab(*words, "--rig", "rig_demo_quick", "--out", tmp_path / out, "--json")
    assert done.code == DataError.exit_code
    assert " TB, but only " in done.json["error"]
    assert str(tmp_path) in done.json["error"]
    assert list(tmp_path.iterdir()) == []


def test_the_disk_of_the_nearest_folder_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []

    def usage(path: Path) -> Usage:
        asked.append(path)
        return Usage(2, 1, 1)

    monkeypatch.setattr(shutil, "disk_usage", usage)
    need_space(tmp_path / "a" / "b", 1, "frames")
    assert asked == [tmp_path]
    with pytest.raises(DataError, match="need 2 bytes, but only 1 bytes are free"):
        need_space(tmp_path, 2, "frames")


@pytest.mark.parametrize(
    ("count", "said"),
    [
        (0, "0 bytes"), (999, "999 bytes"), (1000, "1.00 kB"), (10_752, "10.8 kB"), (123_456_789, "123 MB"),
        (999_600_000, "1.00 GB"), (2 << 30, "2.15 GB"), (5 * 10**15, "5.00 PB"),
    ],
)  # fmt: skip
def test_bytes_are_readable(count: int, said: str) -> None:
    assert readable_bytes(count) == said


@pytest.mark.parametrize(("needed", "level"), [(1 << 20, logging.INFO), (2 << 30, logging.WARNING)])
def test_what_work_takes_is_said_before(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    needed: int,
    level: int,
) -> None:
    usage = Usage(9 << 30, 1 << 30, 8 << 30)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with caplog.at_level(logging.INFO):
        need_space(tmp_path, needed, "1000 samples")
    [said] = [record for record in caplog.records if record.name == "fpplab.core.disk_space"]
    assert said.levelno == level
    assert f"1000 samples take {readable_bytes(needed)}; 8.59 GB are free there" in said.getMessage()
