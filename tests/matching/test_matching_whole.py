"""A whole matching on the plane twin: from recorded sessions to a twin and its report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.matching.match import MatchingLimits
from fpplab.matching.record import MatchingRecord
from fpplab.matching.run import MatchingRequest, MatchingResult, match_sessions
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.report.matching import write_matching_report
from fpplab.sessions.session import Session
from fpplab.simulation.matchable import TwinParameters
from tests.support.plane_twin import TARGET, PlaneTwin, nominal, record, tilted

PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis=axis, stripes=stripes, steps=4) for axis in ("x", "y") for stripes in (1, 8, 32)
    )
)
POSES = 4
EPOCHS = 3

pytestmark = pytest.mark.slow


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


def test_a_matching_continues_from_its_record(matching: Matching) -> None:
    before = len(MatchingRecord(matching.folder).read())
    wanted = MatchingRequest(limits=MatchingLimits(epochs=EPOCHS + 1))
    again = match_sessions(PlaneTwin(nominal(()), 8), matching.sessions, TARGET, matching.folder, wanted)
    epochs = MatchingRecord(matching.folder).read()
    assert len(epochs) == before + 1
    assert [e.epoch for e in epochs] == list(range(len(epochs)))
    assert again.matched.ended == f"after {EPOCHS + 1} epochs"


def test_report_of_a_matching(matching: Matching, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    write_matching_report(page, matching.outcome, matching.twin)
    text = page.read_text()
    for words in ("SSIM over the board", "ambient light", "the bench less the twin", "paper", "pose_00"):
        assert words in text
    assert np.isfinite(matching.outcome.matched.unexplained)
