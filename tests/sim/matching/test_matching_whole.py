"""A whole matching on the plane twin: from recorded sessions to a twin and its report."""

from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.diagnosis import Finding, Verdict
from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED
from fpplab.diagnosis.causes.projector_drift import PROJECTOR_DRIFT
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.sessions.session import Session
from sim.matching import match
from sim.matching.judging import verdict
from sim.matching.judging.verdict import diagnose_matching
from sim.matching.loss import Weights
from sim.matching.match import MatchingLimits, match_twin
from sim.matching.page import write_matching_report
from sim.matching.record import MatchingRecord
from sim.matching.reference import Reference
from sim.matching.run import (
    MatchingListener,
    MatchingRequest,
    MatchingResult,
    match_sessions,
    with_reference_geometry,
)
from sim.matching.samples import sample_pixels
from sim.matching.steps import MatchingContext, MatchingStep
from sim.parameters import TwinParameters
from sim.prediction import Discrepancy
from tests.sim.matching.light.test_contrast import scanned
from tests.support.plane_twin import TARGET, PlaneTwin, nominal, record, tilted

PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis=axis, stripes=stripes, steps=4) for axis in ("x", "y") for stripes in (1, 8, 32)
    )
)
POSES = 4
EPOCHS = 3

pytestmark = pytest.mark.nightly


@dataclass(frozen=True)
class Matching:
    truth: TwinParameters
    sessions: list[Session]
    folder: Path
    outcome: MatchingResult
    twin: PlaneTwin


@pytest.fixture(scope="module")
def matching(tmp_path_factory: pytest.TempPathFactory) -> Matching:
    folder = tmp_path_factory.mktemp("matching")
    truth = replace(
        nominal(tilted(POSES, seed=3)),
        white=0.85,
        ink=0.09,
        ambient=0.05,
        projector_blur=0.9,
    )
    sessions = record(PlaneTwin(truth, 1), PLAN, folder / "board")
    twin = PlaneTwin(nominal(()), 7)
    wanted = MatchingRequest(limits=MatchingLimits(epochs=EPOCHS))
    outcome = match_sessions(twin, sessions, TARGET, folder / "matched", wanted)
    return Matching(truth, sessions, folder / "matched", outcome, twin)


def test_the_twin_matches_the_reference(matching: Matching) -> None:
    summary = matching.outcome.summary()
    assert summary["ssim_board"] > 0.95
    assert summary["ssim"] > 0.95
    before, after = (row["ssim_board"] for row in summary["rows"])
    assert after > before
    losses = [epoch.loss["loss_board"] for epoch in matching.outcome.matched.epochs if epoch.accepted]
    assert losses[-1] < 0.5 * losses[0]


def test_every_pose_has_its_figures(matching: Matching) -> None:
    summary = matching.outcome.summary()
    assert [one["pose"] for one in summary["poses"]] == [session.path.name for session in matching.sessions]
    first, last = summary["rows"]
    for when, row in (("before", first), ("after", last)):
        for key in ("ssim", "ssim_board"):
            mean = np.mean([one[f"{key}_{when}"] for one in summary["poses"]])
            assert mean == pytest.approx(row[key])
        assert all(abs(one[f"epsilon_d_px_{when}"]) < 0.1 for one in summary["poses"])


def test_light_of_the_reference_is_found(matching: Matching) -> None:
    found, truth = matching.outcome.matched.parameters, matching.truth
    # A few epochs leave some of the white to the projector's blur: 2 % too much of one for the other.
    assert found.white == pytest.approx(truth.white, rel=0.025)
    assert found.ink == pytest.approx(truth.ink, rel=0.05)
    assert found.ambient == pytest.approx(truth.ambient, abs=0.01)


def test_epochs_and_twin_are_saved(matching: Matching) -> None:
    epochs = MatchingRecord(matching.folder).read()
    assert [e.step for e in epochs][:4] == ["start", "points", "light", "ambient light"]
    assert len(epochs) == EPOCHS + 1
    assert (matching.folder / "calibration.yaml").is_file()
    left = Discrepancy.beside(matching.folder / "rig.yaml")
    assert left is not None
    assert left.noise is not None
    assert abs(left.noise.mean) < 0.1
    assert left.noise.fitted  # no more poses than the light is fitted to


def test_a_matching_continues_from_its_record(matching: Matching) -> None:
    before = len(MatchingRecord(matching.folder).read())
    wanted = MatchingRequest(limits=MatchingLimits(epochs=EPOCHS + 1))
    again = match_sessions(PlaneTwin(nominal(()), 8), matching.sessions, TARGET, matching.folder, wanted)
    epochs = MatchingRecord(matching.folder).read()
    assert len(epochs) == before + 1
    assert [e.epoch for e in epochs] == list(range(len(epochs)))
    assert again.matched.ended == f"after {EPOCHS + 1} epochs"


def test_a_matching_that_goes_on_is_the_undisturbed_one(matching: Matching, tmp_path: Path) -> None:
    """Wherever it was interrupted: noise, samples and parameters are the same."""

    def matched(folder: Path) -> MatchingResult:
        wanted = MatchingRequest(limits=MatchingLimits(epochs=4))
        return match_sessions(PlaneTwin(nominal(()), 7), matching.sessions[:3], TARGET, folder, wanted)

    whole = matched(tmp_path / "whole")
    lines = (tmp_path / "whole" / "match.jsonl").read_bytes().splitlines(keepends=True)
    assert len(lines) == 5
    for kept in (1, 3, 5):
        folder = tmp_path / f"stopped_{kept}"
        folder.mkdir()
        (folder / "match.jsonl").write_bytes(b"".join(lines[:kept]))
        again = matched(folder)
        assert again.summary() == whole.summary()
        for one, other in zip(again.matched.epochs, whole.matched.epochs, strict=True):
            assert one.model_dump(exclude={"seconds"}) == other.model_dump(exclude={"seconds"})


@pytest.mark.parametrize("blurred_by_the_part", [0.0, 0.9])
def test_scans_with_finer_fringes_tell_the_sharpness_unless_the_part_blurs_them(
    matching: Matching, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blurred_by_the_part: float
) -> None:
    """With the steps alone that matter: the others take minutes."""
    some = {one.name: one for one in (*match.FIRST_STEPS, *match.REPEATED_STEPS)}
    monkeypatch.setattr(match, "FIRST_STEPS", tuple(some[n] for n in ("light", "projector defocus")))
    monkeypatch.setattr(match, "REPEATED_STEPS", (some["fine fringes"],))
    monkeypatch.setattr(match, "CHANGING_STEPS", (some["flicker"],))
    truth, twin = matching.truth, PlaneTwin(nominal(()), 7)
    found = characterise_sessions(matching.sessions, TARGET)
    reference = Reference.of(matching.sessions, TARGET, found)
    start = replace(with_reference_geometry(twin.parameters, found), ambient=truth.ambient)
    soft = replace(truth, projector_blur=float(np.hypot(truth.projector_blur, blurred_by_the_part)))
    scans, limits = [scanned(soft)], MatchingLimits(epochs=12)
    outcome = match_twin(reference, twin, start, MatchingRecord(tmp_path), Weights(), limits, scans)
    steps = [epoch.step for epoch in outcome.epochs]
    assert "fine fringes" in steps
    assert steps[-1] == "flicker"
    assert ("sharpness of the board" in steps) is bool(blurred_by_the_part)
    lines = (tmp_path / "match.jsonl").read_bytes().splitlines(keepends=True)
    (tmp_path / "match.jsonl").write_bytes(b"".join(lines[:-1]))
    again = match_twin(reference, twin, start, MatchingRecord(tmp_path), Weights(), limits, scans)
    assert [epoch.step for epoch in again.epochs] == steps
    off = outcome.parameters.projector_blur - truth.projector_blur
    # The board's images alone leave some of the white to the blur.
    assert abs(off) < (0.15 if blurred_by_the_part else 0.02)


def test_a_refused_step_is_tried_again_only_where_that_may_help(
    matching: Matching, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rounds are counted alike by a matching that goes on."""
    some = {one.name: one for one in match.FIRST_STEPS}

    def refused(name: str, again: bool) -> MatchingStep:
        grows = count()  # a misfit that is greater after the step
        return MatchingStep(
            name, lambda at: at.twin.parameters, misfit=lambda at: float(next(grows)), again=again
        )

    monkeypatch.setattr(match, "FIRST_STEPS", (some["light"],))
    monkeypatch.setattr(match, "REPEATED_STEPS", (refused("once", False), refused("always", True)))
    monkeypatch.setattr(match, "CHANGING_STEPS", (some["flicker"],))
    twin = PlaneTwin(nominal(()), 7)
    found = characterise_sessions(matching.sessions, TARGET)
    reference = Reference.of(matching.sessions, TARGET, found)
    start, limits = with_reference_geometry(twin.parameters, found), MatchingLimits(patience=3)
    wanted = ["start", "light", "once", "always", "always", "always", "flicker"]
    for kept in (0, 3, 6):
        path = tmp_path / "match.jsonl"
        if kept:
            path.write_bytes(b"".join(path.read_bytes().splitlines(keepends=True)[:kept]))
        outcome = match_twin(reference, twin, start, MatchingRecord(tmp_path), Weights(), limits)
        assert [epoch.step for epoch in outcome.epochs] == wanted
        assert outcome.ended == match.CONVERGED


def test_steps_that_leave_the_expected_images_change_none(matching: Matching) -> None:
    """What such a step finds has the loss of the epoch before without being evaluated."""
    found, sessions = characterise_sessions(matching.sessions, TARGET), matching.sessions
    reference = Reference.of(sessions, TARGET, found)
    twin = PlaneTwin(matching.truth, 7)
    images = list(range(4))
    at = MatchingContext(reference, twin, sample_pixels(reference, matching.truth, (0, 1), images), "white")
    shown = reference.shown(reference.finest)
    before = twin.expected(0, shown, reference.settings)
    steps = [one for one in match.FIRST_STEPS if one.same_images]
    assert {one.name for one in steps} == match.CHANGING
    for step in steps:
        at = at.with_parameters(step.propose(at))
        assert np.array_equal(at.twin.expected(0, shown, reference.settings), before), step.name


def test_a_step_is_ended_when_the_time_is_over(
    matching: Matching, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By a clock that goes on only when the twin computes images, so that the end lies within a step."""
    clock = iter(np.arange(0.0, 1e6))
    monkeypatch.setattr(match.time, "monotonic", lambda: float(next(clock)))
    words: list[str] = []
    shares: list[float] = []

    def matched(seconds: float) -> MatchingResult:
        wanted = MatchingRequest(limits=MatchingLimits(epochs=2, seconds=seconds))
        twin = PlaneTwin(nominal(()), 7)
        sessions, out = matching.sessions[:3], tmp_path / "out"
        listener = MatchingListener(shares.append, tell=words.append)
        return match_sessions(twin, sessions, TARGET, out, wanted, listener)

    first = matched(40.0)
    assert first.matched.ended.startswith("after 4")
    record = MatchingRecord(tmp_path / "out").read()
    assert [epoch.step for epoch in record] == ["start", "points"], "the step of light was given up"
    assert first.matched.epochs == tuple(record)
    assert first.diagnosis.verdict is Verdict.DOUBTFUL
    assert "ended_early" in [one.cause.key for one in first.diagnosis.findings]
    told = [one for one in words if one.startswith("epoch 2, light: loss over the board ")]
    left = [float(one.rsplit(", ", 1)[1].split()[0]) for one in told]
    assert len(left) > 5
    assert left == sorted(left, reverse=True)
    assert shares == sorted(shares)
    assert len({share for share in shares if 0.1 < share < 0.5}) > len(record) + 5, "it moves within steps"
    again = matched(1e5)
    assert [epoch.step for epoch in again.matched.epochs] == ["start", "points", "light"]
    assert again.matched.epochs[:2] == first.matched.epochs


def test_verdicts_on_a_matching(matching: Matching, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same matching with one figure changed has one finding more."""
    found = matching.outcome
    assert found.diagnosis.verdict is Verdict.DOUBTFUL
    assert [one.cause.key for one in found.diagnosis.findings] == ["ended_early"]
    assert found.summary()["findings"][0]["remedy"].startswith("name another --out")
    whole = replace(found, matched=replace(found.matched, ended="converged"))
    assert diagnose_matching(whole).verdict is Verdict.GOOD

    def with_changed(**changes: Any) -> MatchingResult:
        return replace(whole, matched=replace(whole.matched, **changes))

    blurred = diagnose_matching(with_changed(unexplained=12.0))
    assert (blurred.verdict, blurred.findings[0].cause.key) == (Verdict.DOUBTFUL, "unlike_images")
    unlike = diagnose_matching(with_changed(unexplained=60.0))
    assert (unlike.verdict, unlike.findings[0].cause.key) == (Verdict.USELESS, "unlike_images")
    worse = replace(whole, final=found.before, before=found.final)
    assert diagnose_matching(worse).verdict is Verdict.USELESS
    assert diagnose_matching(worse).findings[0].cause.key == "no_gain"
    focus = Finding(LENS_NOT_LOCKED, "pose_02: its edges are softer", 1.5)
    moved_focus = replace(whole, late=(focus,))
    assert diagnose_matching(moved_focus).verdict is Verdict.USELESS
    accepted = replace(moved_focus, accepted=frozenset({LENS_NOT_LOCKED}))
    assert diagnose_matching(accepted).verdict is Verdict.DOUBTFUL
    assert accepted.notes == ("lens_not_locked accepted: pose_02: its edges are softer",)
    assert whole.notes == ()
    at_border = with_changed(parameters=replace(whole.matched.parameters, f_number=64.0))
    assert [one.cause.key for one in diagnose_matching(at_border).findings] == ["at_border"]
    final = whole.final
    loss = replace(final.loss, twin_rms_px=final.loss.twin_rms_px + 0.3)
    apart = diagnose_matching(replace(whole, final=replace(final, loss=loss)))
    assert "points_misfit" in [one.cause.key for one in apart.findings]
    drift = Finding(PROJECTOR_DRIFT, "the projector's picture of the board walks", 2.0)
    monkeypatch.setattr(verdict, "findings_of_poses", lambda characterisation: [drift])
    drifting = diagnose_matching(whole)
    assert (drifting.verdict, drifting.findings) == (Verdict.DOUBTFUL, (drift,))


def test_report_of_a_matching(matching: Matching, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    write_matching_report(page, matching.outcome, matching.twin)
    text = page.read_text()
    assert "Doubtful" in text
    assert "ended early" in text
    for words in ("SSIM over the board", "ambient light", "the bench less the twin", "paper", "pose_00"):
        assert words in text
    assert np.isfinite(matching.outcome.matched.unexplained)
