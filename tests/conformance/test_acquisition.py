"""Patterns and frames in step, on every rig."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.acquisition.acquire import acquire, expose
from fpplab.core.errors import CapabilityError, DataError, DeviceError, SyncError
from fpplab.devices import Frame, State
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session
from tests.conformance.bench import BLACK, WHITE, brightness, dark_now, dim_plan, patterns_for, picture


@pytest.fixture
def session(rig: Rig, tmp_path: Path) -> Session:
    return Session.create(tmp_path / "session", dim_plan(rig), rig.described())


def ids(plan: Plan) -> list[str]:
    return [name for _, _, name in plan.steps()]


def reference_levels(rig: Rig) -> tuple[float, float]:
    """Brightness of a black and of a white pattern; the projector is dark afterwards."""
    rig.camera.configure(rig.camera_settings(dim_plan(rig).exposure_s))
    rig.projector.load(patterns_for(rig))
    levels = brightness(picture(rig, BLACK)), brightness(picture(rig, WHITE))
    rig.projector.blank()
    return levels


def test_every_pattern_is_taken_once_and_in_order(rig: Rig, session: Session) -> None:
    levels = reference_levels(rig)
    frames: list[Frame] = []
    acquire(rig, session.plan, session, frames.append)
    assert [f.pattern_id for f in frames] == ids(session.plan)
    assert [f.index for f in frames] == list(range(session.plan.images))
    assert dark_now(rig, *levels)
    recorded = Session.open(session.path)
    assert recorded.missing() == []
    assert [r.pattern for r in recorded.records] == ids(session.plan)
    for frame, image in zip(frames, recorded.stack(), strict=True):
        np.testing.assert_array_equal(frame.image, image)


def test_each_frame_shows_its_pattern(rig: Rig, session: Session) -> None:
    reference_levels(rig)
    rig.projector.load(patterns_for(rig))
    full = float((1 << rig.file.camera.bits) - 1)
    known = {i: picture(rig, i) for i in (0, 2, 4, 6, 8, 10)}
    rig.projector.blank()
    acquire(rig, session.plan, session)
    for i in known:
        frame = session.read(i) / full
        assert min(known, key=lambda k: float(np.abs(frame - known[k]).mean())) == i


def test_a_failure_in_the_middle_leaves_the_bench_dark(rig: Rig, session: Session) -> None:
    levels = reference_levels(rig)

    def fail(frame: Frame) -> None:
        if frame.index == 3:
            raise KeyError("the viewer fell over")

    try:
        acquire(rig, session.plan, session, fail)
    except KeyError:
        assert rig.camera.state is State.IDLE
        assert dark_now(rig, *levels), "dark before anyone has handled the exception"
    else:
        pytest.fail("the exception was swallowed")


def test_resuming_takes_only_what_is_missing(rig: Rig, session: Session) -> None:
    def fail(frame: Frame) -> None:
        if frame.index == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        acquire(rig, session.plan, session, fail)
    again = Session.resume(session.path, session.plan, rig.described())
    before = [again.read(i).copy() for i in range(len(again.records))]
    frames: list[Frame] = []
    acquire(rig, again.plan, again, frames.append)
    assert len(before) >= 5, "what was seen is on disk; what was taken since may be"
    assert [f.index for f in frames] == list(range(len(before), session.plan.images))
    assert [f.pattern_id for f in frames] == ids(session.plan)[len(before) :]
    assert Session.open(session.path).missing() == []
    for i, image in enumerate(before):
        np.testing.assert_array_equal(again.read(i), image)


def test_a_complete_session_takes_nothing(rig: Rig, session: Session) -> None:
    acquire(rig, session.plan, session)
    frames: list[Frame] = []
    acquire(rig, session.plan, session, frames.append)
    assert frames == []


def test_a_frame_of_another_pattern_is_noticed(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the backend knows what was on show; where it cannot know, nothing is invented."""
    levels = reference_levels(rig)
    rig.projector.load(patterns_for(rig))
    rig.projector.show(0)
    knows = rig.camera.snap().pattern_id is not None
    really_show = rig.projector._show
    monkeypatch.setattr(rig.projector, "_show", lambda i: really_show(i + 1 if i == 2 else i))
    if knows:
        with pytest.raises(SyncError, match=f"shows '{ids(session.plan)[3]}' instead of"):
            acquire(rig, session.plan, session)
        assert len(session.records) == 2
    else:
        acquire(rig, session.plan, session)
    assert dark_now(rig, *levels)


def test_a_camera_that_fails_leaves_the_projector_dark(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = reference_levels(rig)
    really_read, reads = rig.camera._read, []

    def fail(timeout_s: float) -> Frame:
        reads.append(timeout_s)
        if len(reads) == 3:
            raise OSError("the cable is gone")
        return really_read(timeout_s)

    with monkeypatch.context() as patch:
        patch.setattr(rig.camera, "_read", fail)
        with pytest.raises(DeviceError, match="the cable is gone"):
            acquire(rig, session.plan, session)
    assert rig.camera.state is State.FAULT
    rig.camera.close()
    rig.camera.open()
    rig.camera.configure(rig.camera_settings(session.plan.exposure_s))
    assert dark_now(rig, *levels)
    assert [r.index for r in session.records] == [0, 1]


def test_a_camera_that_cannot_stop_leaves_the_projector_dark(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = reference_levels(rig)
    rig.projector.load(patterns_for(rig))
    rig.projector.show(WHITE)

    def fail() -> None:
        raise OSError("it does not listen")

    with monkeypatch.context() as patch:
        patch.setattr(rig.camera, "_stop", fail)
        with pytest.raises(DeviceError, match="it does not listen"):
            rig.make_dark()
    rig.camera.close()
    rig.camera.open()
    rig.camera.configure(rig.camera_settings(dim_plan(rig).exposure_s))
    assert dark_now(rig, *levels)


def test_a_frame_lost_on_the_way_is_noticed(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    really_read = rig.camera._read

    def late(timeout_s: float) -> Frame:
        return replace(really_read(timeout_s), index=1)

    monkeypatch.setattr(rig.camera, "_read", late)
    with pytest.raises(DeviceError, match="frame 1 arrived instead of frame 0"):
        acquire(rig, session.plan, session)


def test_a_full_disk_leaves_the_bench_dark(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    levels = reference_levels(rig)

    def full(frame: Frame) -> None:
        raise DataError("no space left on the disk")

    monkeypatch.setattr(session, "write", full)
    try:
        acquire(rig, session.plan, session)
    except DataError:
        assert dark_now(rig, *levels)
    else:
        pytest.fail("the exception was swallowed")


def test_leaving_an_exposure_early_leaves_the_bench_dark(rig: Rig) -> None:
    levels = reference_levels(rig)
    plan = dim_plan(rig)
    shots = expose(rig, patterns_for(rig), rig.camera_settings(plan.exposure_s), plan)
    next(shots)
    shots.close()
    assert dark_now(rig, *levels)


def test_a_plan_that_follows_the_camera(rig: Rig, session: Session) -> None:
    """The camera is the clock; it gives the frames of a stepped plan, or is refused."""
    plan = session.plan.model_copy(update={"trigger": "followed"})
    settings = rig.camera_settings(plan.exposure_s)
    camera, projector = rig.camera.caps, rig.projector.caps
    rolls = projector.flashes and camera.readout_s
    if rolls or not (camera.strobe and projector.trigger_inputs):
        with pytest.raises(
            CapabilityError,
            match=r"active while it exposes|has no trigger input|global reset|part of each exposure",
        ):
            next(iter(expose(rig, patterns_for(rig), settings, plan)))
        assert rig.camera.state is rig.projector.state is State.IDLE
        return
    followed = [frame.image for frame in expose(rig, patterns_for(rig), settings, plan)]
    stepped = [frame.image for frame in expose(rig, patterns_for(rig), settings, session.plan)]
    for k, image in enumerate(followed):
        apart = [float(np.abs(image.astype(float) - other).mean()) for other in stepped]
        assert apart[k] == pytest.approx(min(apart), abs=0.5), f"frame {k} shows another pattern"


def test_a_triggered_plan(rig: Rig, session: Session) -> None:
    levels = reference_levels(rig)
    plan = session.plan.model_copy(update={"trigger": "triggered"})
    able = rig.projector.caps.trigger_outputs and "hardware" in rig.camera.caps.triggers
    if not able:
        with pytest.raises(CapabilityError, match="trigger"):
            acquire(rig, plan, session)
        assert session.records == []
    else:
        stepped = Session.create(session.path.with_name("stepped"), session.plan, rig.described())
        acquire(rig, session.plan, stepped)
        acquire(rig, plan, session)
        assert session.missing() == []
        full = float((1 << rig.file.camera.bits) - 1)
        known = {i: stepped.read(i) / full for i in (0, 2, 4, 6, 8, 10)}
        for i in known:
            frame = session.read(i) / full
            assert min(known, key=lambda k: float(np.abs(frame - known[k]).mean())) == i
    assert dark_now(rig, *levels)
    assert rig.projector.state is State.IDLE


def test_a_triggered_pattern_stays_up_until_the_last_row_is_read(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rolling shutter exposes its rows one after another: none may see the next pattern."""
    if not rig.projector.caps.trigger_outputs or "hardware" not in rig.camera.caps.triggers:
        assert rig.camera.caps.readout_s >= 0
        return
    played = times_played(rig, monkeypatch)
    acquire(rig, session.plan.model_copy(update={"trigger": "triggered"}), session)
    settings = rig.camera_settings(session.plan.exposure_s)
    exposure_s = rig.camera.configure(settings).exposure_s
    caps = rig.camera.caps
    ((light_s, dark_s, period_s),) = played
    assert (light_s, dark_s) == pytest.approx((exposure_s + caps.readout_s, caps.dark_s))
    assert period_s >= max(light_s + dark_s, caps.period_s or 0.0)


@pytest.mark.parametrize("dead_s", [None, 0.01])
def test_triggers_are_as_far_apart_as_the_camera_needs(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch, dead_s: float | None
) -> None:
    """By what the camera tells, or by what is stated in the rig file."""
    if not rig.projector.caps.trigger_outputs or "hardware" not in rig.camera.caps.triggers:
        assert rig.camera.caps.period_s is None or rig.camera.caps.period_s >= 0
        return
    caps = replace(rig.camera.caps, period_s=0.0 if dead_s else 0.06)
    section = rig.file.camera.model_copy(update={"dead_time_s": dead_s})
    played: list[float] = []

    def note(light_s: float, dark_s: float, period_s: float) -> None:
        played.append(period_s - (light_s if dead_s else 0.0))
        raise CapabilityError("projector", "play", "not now")

    with monkeypatch.context() as patch:
        patch.setattr(rig.camera, "_caps", lambda: caps)
        patch.setattr(rig, "file", rig.file.model_copy(update={"camera": section}))
        patch.setattr(rig.projector, "_play", note)
        with pytest.raises(CapabilityError, match="not now"):
            acquire(rig, session.plan.model_copy(update={"trigger": "triggered"}), session)
    assert played == [pytest.approx(dead_s or 0.06, rel=1e-2)]


def test_it_is_dark_while_rows_end_one_after_another(
    rig: Rig, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a global reset: what would fall on the later rows meanwhile, they would have too much."""
    levels = reference_levels(rig)
    caps = replace(rig.camera.caps, readout_s=0.0, dark_s=0.05)
    with monkeypatch.context() as patch:
        patch.setattr(rig.camera, "_caps", lambda: caps)
        with pytest.raises(CapabilityError, match=r"global reset.*set its shutter to rolling"):
            acquire(rig, session.plan, session)
        if rig.projector.caps.trigger_outputs and "hardware" in caps.triggers:
            played = times_played(rig, monkeypatch)
            is_able = rig.projector.caps.dark_between
            refused = pytest.raises(CapabilityError, match="no dark time between its patterns")
            with nullcontext() if is_able else refused:
                acquire(rig, session.plan.model_copy(update={"trigger": "triggered"}), session)
            settings = rig.camera_settings(session.plan.exposure_s)
            exposure_s = rig.camera.configure(settings).exposure_s
            assert [times[:2] for times in played] == ([pytest.approx((exposure_s, 0.05))] if is_able else [])
    assert dark_now(rig, *levels)


def times_played(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> list[tuple[float, float, float]]:
    """Of whatever is played from now on: exposure, darkness and period."""
    really_play, played = rig.projector._play, []

    def noted(exposure_s: float, dark_s: float, period_s: float) -> None:
        played.append((exposure_s, dark_s, period_s))
        really_play(exposure_s, dark_s, period_s)

    monkeypatch.setattr(rig.projector, "_play", noted)
    return played
