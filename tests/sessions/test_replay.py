"""A recording gives back what was recorded, and invents nothing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.acquisition.acquire import acquire
from fpplab.core.conventions import Image, Lattice
from fpplab.core.errors import CapabilityError, ConfigError, DataError, FrameLossError, SettingError
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.sessions.frame_files import read_frame
from fpplab.sessions.journal import FrameRecord
from fpplab.sessions.session import Session
from tests.support.recorded import PLAN, frame, image_of, record

RIG = """
name: replay
bench: {backend: "fpplab.sessions.replay:RecordedSession", session: recorded}
camera: {backend: "fpplab.sessions.replay:ReplayCamera"}
projector: {backend: "fpplab.sessions.replay:ReplayProjector"}
"""
SETTINGS = CameraSettings(0.02)
PATTERNS = make_patterns(PLAN, (64, 48), Lattice.SQUARE)


def rig_of(tmp_path: Path, text: str = RIG) -> Rig:
    (tmp_path / "rig.yaml").write_text(text)
    return Rig.load(tmp_path / "rig.yaml")


def test_the_recording_is_measured_again(tmp_path: Path) -> None:
    record(tmp_path / "recorded")
    with rig_of(tmp_path) as rig:
        again = Session.create(tmp_path / "again", PLAN, rig.described())
        acquire(rig, PLAN, again)
    for index in range(4):
        np.testing.assert_array_equal(again.read(index), image_of(index))
    assert again.projector() == ((64, 48), Lattice.SQUARE)


def test_every_exposure_is_measured_again(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"exposures_s": (0.08, 0.02)})
    recorded = Session.create(tmp_path / "recorded", plan)
    for index in range(8):
        settings = CameraSettings(plan.exposures[index // 4])
        shown = frame(index % 4, image=image_of(index))
        recorded.write(replace(shown, index=index, settings=settings))
    with rig_of(tmp_path) as rig:
        again = Session.create(tmp_path / "again", plan, rig.described())
        acquire(rig, plan, again)
    assert [record.exposure_s for record in again.records] == [0.08] * 4 + [0.02] * 4
    for index in range(8):
        np.testing.assert_array_equal(again.read(index), image_of(index))
    first, second = again.passes()
    np.testing.assert_array_equal(second.frames[1], image_of(5))
    assert len(first.frames) == 4
    assert Session.open(again.path).missing() == []


def test_sets_of_other_exposures_are_measured_again(tmp_path: Path) -> None:
    """Frames that no exposure took are missing from its pass, and from nothing else."""
    sets = [PLAN.sets[0], PLAN.fringes[0].model_copy(update={"stripes": 2, "exposures_s": (0.08, 0.02)})]
    plan = PLAN.model_copy(update={"fringes": tuple(sets), "exposure_s": 0.02})
    ids = [name for _, _, name in plan.steps()]
    recorded = Session.create(tmp_path / "recorded", plan)
    assert (plan.exposures, plan.frames) == ((0.02, 0.08), 12)
    shown = [(each, i) for each, images in zip(plan.exposures, plan.passes, strict=True) for i in images]
    for index, (exposure_s, image) in enumerate(shown):
        taken = replace(frame(0, image=image_of(index)), index=index, settings=CameraSettings(exposure_s))
        recorded.write(replace(taken, pattern_id=ids[image]))
    with rig_of(tmp_path) as rig:
        again = Session.create(tmp_path / "again", plan, rig.described())
        acquire(rig, plan, again)
    for index, (exposure_s, _) in enumerate(shown):
        assert again.record(index).exposure_s == exposure_s
        np.testing.assert_array_equal(again.read(index), image_of(index))
    assert [len(each.frames) for each in again.passes()] == [8, 4]
    assert Session.open(again.path).missing() == []


def test_new_frames_are_not_read_back_for_their_checksums(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The proof that they are in step takes a sample of their pixels; checksums would delay the next scan."""
    record(tmp_path / "recorded")
    verified: set[Path] = set()

    def reading(path: Path, of: FrameRecord, verify: bool) -> Image:
        verified.update([path] if verify else [])
        return read_frame(path, of, verify)

    monkeypatch.setattr("fpplab.sessions.session.read_frame", reading)
    with rig_of(tmp_path) as rig:
        again = Session.create(tmp_path / "again", PLAN, rig.described())
        acquire(rig, PLAN, again)
    assert not {path for path in verified if path.is_relative_to(again.path)}
    again.stack()
    assert len({path for path in verified if path.is_relative_to(again.path)}) == PLAN.images


def test_an_incomplete_recording_gives_the_frames_that_it_has(tmp_path: Path) -> None:
    session = Session.create(tmp_path / "recorded", PLAN)
    for index in (0, 1, 3):
        session.write(frame(index))
    with rig_of(tmp_path) as rig:
        rig.camera.configure(SETTINGS)
        rig.projector.load(PATTERNS)
        rig.projector.show(3)
        shot = rig.camera.snap()
        assert shot.pattern_id == PATTERNS[3].id
        np.testing.assert_array_equal(shot.image, image_of(3))
        rig.projector.show(2)
        with pytest.raises(FrameLossError, match="frame 2 is not recorded; record the session again"):
            rig.camera.snap()


def test_a_damaged_frame_is_a_lost_one(tmp_path: Path) -> None:
    session = record(tmp_path / "recorded")
    (session.path / session.record(1).file).unlink()
    with rig_of(tmp_path) as rig:
        rig.camera.configure(SETTINGS)
        rig.projector.load(PATTERNS)
        rig.projector.show(1)
        with pytest.raises(FrameLossError, match="frame 1 is missing"):
            rig.camera.snap()


def test_patterns_settings_and_darkness_that_were_not_recorded(tmp_path: Path) -> None:
    record(tmp_path / "recorded")
    with rig_of(tmp_path) as rig:
        rig.camera.configure(SETTINGS)
        with pytest.raises(CapabilityError, match="pattern 'grey-255' was not recorded"):
            rig.projector.load(uniform_patterns([255], (64, 48)))
        altered = replace(PATTERNS[1], image=np.invert(PATTERNS[1].image))
        with pytest.raises(CapabilityError, match=f"pattern '{altered.id}' was not recorded"):
            rig.projector.load([PATTERNS[0], altered])
        with pytest.raises(SettingError, match=r"exposure_s is 0.03 s; the device accepts 0.02 to 0.02 s"):
            rig.camera.configure(CameraSettings(0.03))
        with pytest.raises(FrameLossError, match="no dark frame was recorded"):
            rig.camera.snap()


def test_patterns_may_come_in_another_order(tmp_path: Path) -> None:
    record(tmp_path / "recorded")
    with rig_of(tmp_path) as rig:
        rig.camera.configure(SETTINGS)
        rig.projector.load(PATTERNS[::-1])
        for i in range(4):
            rig.projector.show(i)
            np.testing.assert_array_equal(rig.camera.snap().image, image_of(3 - i))


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="there is no such file or folder"), rig_of(tmp_path):
        pass
    Session.create(tmp_path / "recorded", PLAN)
    with pytest.raises(DataError, match="has no frames yet"), rig_of(tmp_path):
        pass


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("session: recorded", "path: recorded", "takes exactly one option, 'session'"),
        ("session: recorded", "session: 3", "takes exactly one option, 'session'"),
        ("bench:", "#", "a replay needs the bench fpplab.sessions.replay:RecordedSession"),
        ('ReplayCamera"', 'ReplayCamera", speed: 2', "'camera' has no option 'speed'"),
    ],
)
def test_a_wrong_rig_file_is_refused(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    record(tmp_path / "recorded")
    assert RIG.count(old) == 1
    with pytest.raises(ConfigError, match=complaint), rig_of(tmp_path, RIG.replace(old, new)):
        pass
