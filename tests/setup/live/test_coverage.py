"""Which pose would help next, by the poses so far."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from fpplab.characterisation.guide import Guide
from fpplab.core import config
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session
from fpplab.setup.live import coverage
from fpplab.setup.live.coverage import BoardCoverage, advise_by_coverage
from fpplab.setup.live.orders import Order
from fpplab.targets import Target
from tests.setup.live.benches import Operator, operate, rig_file
from tests.support.boards import pose
from tests.support.rigs import BOARD, CAMERA, SQUARE, observed, poses

SIZES = CAMERA.size, SQUARE.size

BOTH_AXES = config.validate(
    {"fringes": [{"axis": axis, "stripes": s, "steps": 4} for axis in "xy" for s in (1, 5, 20)]}, Plan, "plan"
)


def test_without_poses_the_first_is_asked_for() -> None:
    assert "first pose" in advise_by_coverage([], BOARD, *SIZES)[0]


def test_parts_of_the_image_are_asked_for() -> None:
    words = advise_by_coverage(observed([pose((0, 0, 0), (-25, -15, 250))]), BOARD, *SIZES)
    assert "tilt the board" in words[0]
    assert "lower right" in words[1]
    assert "upper left" not in words[1]


def test_tilts_and_distances_are_asked_for() -> None:
    flat = [pose((2.0 * k, 3.0 - k, 4.0 * k), (5.0 * k - 10, 0, 250)) for k in range(5)]
    words = advise_by_coverage(observed(flat), BOARD, *SIZES)
    assert any("tilt" in one for one in words)
    assert advise_by_coverage(observed(poses(8)), BOARD, *SIZES) == (
        "take 2 more poses, each tilted and placed differently",
    )
    assert "characterise now" in advise_by_coverage(observed(poses(12)), BOARD, *SIZES)[0]


@pytest.mark.whole
def test_poses_are_taken_counted_and_kept(tmp_path: Path) -> None:
    """A board that the twin holds; one pose too far away for its points to be found does not count."""
    places = [((10, 12, 3), (0, 0, 450)), ((-15, 8, 0), (5, 5, 440)), ((0, 0, 0), (0, 0, 2500))]
    board = {
        "target": "board.yaml",
        "poses": [{"rotation_deg": list(r), "translation_mm": list(t)} for r, t in places],
    }
    path = rig_file(tmp_path, items={"board": board}, mounted="board")
    orders = [Order.ADVICE, *[Order.TAKE, Order.NEXT_POSE] * 2, Order.TAKE, Order.QUIT]
    operator = Operator(*orders, after=10)
    held = {"target": Target.load(tmp_path / "board.yaml"), "item": "board"}
    setup = operate(path, operator, plan=BOTH_AXES, poses=tmp_path / "poses", **held)
    assert [p.name for p in setup.poses] == ["pose_00", "pose_01"]
    summary = setup.status.coverage
    assert summary is not None
    assert summary["poses"] == 2
    assert summary["camera"][1][1]  # type: ignore[index]
    assert len(summary["left_out"]) == 1  # type: ignore[arg-type]
    session = Session.open(setup.poses[1])
    assert not session.missing()
    assert (session.rig() or {})["resolved"]["mounted"] == {"item": "board", "pose": 1}
    # The exposure that was chosen is the one that was used.
    chosen = operator.seen[-1].settings
    assert chosen is not None
    assert session.plan.exposure_s == chosen.exposure_s != BOTH_AXES.exposure_s


def test_the_pose_that_lessens_the_uncertainty_most_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a guided characterisation of the same poses asks for it."""
    seen = observed(poses(2))
    handed = iter(seen)
    monkeypatch.setattr(coverage, "decode_session", lambda session: None)
    monkeypatch.setattr(coverage, "finest_periods", lambda plan, size: None)
    monkeypatch.setattr(coverage, "observe", lambda *_: next(handed))
    session = SimpleNamespace(
        path=Path("pose"), plan=None, recording=lambda verify: SimpleNamespace(mean_image=lambda: None)
    )
    board = BoardCoverage(BOARD, *SIZES)
    asked = Guide(BOARD, SIZES)
    for one in seen:
        board.add(session)  # type: ignore[arg-type]
        asked.add(one)
        assert board.summary()["next"][0] == asked.next_pose().description  # type: ignore[index]
    assert board.summary()["poses"] == len(seen)
