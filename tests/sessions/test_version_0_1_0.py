"""What version 0.1.0 wrote is still read: plans, sessions, calibrations, and the backends of rig files."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from fpplab import Calibration, Decoded, Plan, Session
from fpplab.core import config
from fpplab.devices.backends import load_backend
from fpplab.devices.operator import Operator
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.plan import FilterRules, MaskRules
from fpplab.pipeline.decoding import decode_session
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.sessions.replay import RecordedSession, ReplayCamera, ReplayProjector

DATA = Path(__file__).parents[1] / "data" / "version_0_1_0"


def test_a_plan_with_every_key(caplog: pytest.LogCaptureFixture) -> None:
    plan = Plan.load(DATA / "plan.yaml")
    assert "'order_vote' has no effect any more" in caplog.text
    written = config.parse_yaml((DATA / "plan.yaml").read_text(encoding="utf-8"), "plan")
    again = config.plain(plan)
    for index, fringes in enumerate(written.pop("fringes")):
        assert {**again["fringes"][index], **fringes} == again["fringes"][index]
    del again["fringes"]
    # What later versions added has its default.
    assert again["masks"].pop("wrong_order_max") == MaskRules().wrong_order_max
    assert again["filter"].pop("flying") is FilterRules().flying
    assert "depth_mm" not in again
    assert again == written


def test_a_session_decodes_to_the_same_coordinates() -> None:
    session = Session.open(DATA / "session")
    decoded, then = decode_session(session), Decoded.load(DATA / "session" / "decoded.npz")
    np.testing.assert_array_equal(decoded.modulation, then.modulation)
    assert decoded.v_per_u == pytest.approx(then.v_per_u, rel=0.05)
    assert then.sigma_phase_error is None
    # Version 0.1.0 took the finest set alone; the other sets move a coordinate within its noise.
    # Sigma is now estimated in another way; these frames have no noise but rounding.
    ratio = decoded.sigma_total[decoded.valid] / then.sigma[decoded.valid]
    assert 0.5 < np.median(ratio) < 2.0
    for moved, scale in ((decoded.u - then.u, 1.0), (decoded.v - then.v, then.v_per_u)):
        assert np.nanmax(np.abs(moved) / (scale * then.sigma)) < 1.5


def test_a_session_that_was_interrupted_is_completed(tmp_path: Path) -> None:
    folder = tmp_path / "session"
    shutil.copytree(DATA / "session", folder)
    journal = folder / "journal.jsonl"
    lines = journal.read_text(encoding="utf-8").splitlines(keepends=True)
    journal.write_text("".join(lines[:4]), encoding="utf-8")
    rig_file = config.load_document(Path("tests/conformance/rigs/rig_reference.yaml").resolve(), RigFile)
    with Rig(rig_file, DATA, "rig") as rig:
        session = take_or_resume_session(rig, Session.open(folder).plan, folder)
    assert session.missing() == []


def test_a_calibration_with_its_uncertainty(tmp_path: Path) -> None:
    calibration = Calibration.load(DATA / "calibration.yaml")
    assert calibration.uncertainty is not None
    calibration.save(tmp_path / "again.yaml")
    again = Calibration.load(tmp_path / "again.yaml")
    assert again.uncertainty is not None
    assert again.projector.size == calibration.projector.size == (912, 1140)
    for name in ("camera", "projector"):
        one, other = getattr(again, name), getattr(calibration, name)
        np.testing.assert_allclose(one.matrix, other.matrix, rtol=1e-12)
        np.testing.assert_allclose(one.distortion, other.distortion, rtol=1e-12)
    np.testing.assert_allclose(
        again.T_projector_camera.matrix, calibration.T_projector_camera.matrix, atol=1e-12
    )
    assert calibration.baseline_mm == pytest.approx(150.0, abs=0.1)


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        ("fpplab.operator:Operator", Operator),
        ("fpplab.replay:Recording", RecordedSession),
        ("fpplab.replay:ReplayCamera", ReplayCamera),
        ("fpplab.replay:ReplayProjector", ReplayProjector),
    ],
)
def test_backends_are_found_by_their_old_names(name: str, backend: type) -> None:
    assert load_backend(name, "rig", "camera") is backend
