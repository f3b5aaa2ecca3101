"""What `fpplab reconstruct` says of how well each point is known, as far as the calibration tells."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.clouds import load_cloud
from fpplab.patterns.plan import Plan
from tests.support.commands import Command
from tests.support.recorded import frame
from tests.support.warmup import frames_of_plane, small_rig

BASELINE = small_rig().T_projector_camera.translation[[0, 2]]
LONGER = Uncertainty(("T_projector_camera.x", "T_projector_camera.z"), 1e-6 * np.outer(BASELINE, BASELINE))
"""The baseline, which has no y here, is known to a thousandth in length, and exactly in direction."""


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A plane, recorded without noise."""
    from fpplab.sessions.session import Session

    plan, rig = Plan.load("plan_paper"), small_rig()
    fringes = tuple(f.model_copy(update={"projector_size": rig.projector.size}) for f in plan.fringes)
    plan = plan.model_copy(update={"fringes": fringes})
    recorded = Session.create(tmp_path / "plane", plan)
    for index, image in enumerate(frames_of_plane(plan, rig, 8)):
        recorded.write(frame(index, plan, image))
    return recorded.path


def saved(calibration: Calibration, path: Path) -> Path:
    calibration.save(path)
    return path


@pytest.mark.whole
@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_the_cloud_carries_its_uncertainty(
    fpplab: Command, session: Path, tmp_path: Path, suffix: str
) -> None:
    calibration = saved(replace(small_rig(), uncertainty=LONGER), tmp_path / "c.yaml")
    out = tmp_path / f"cloud{suffix}"
    done = fpplab("reconstruct", session, "--calibration", calibration, "--out", out, "--json")
    assert done.code == 0, done.err
    cloud = load_cloud(out)
    assert len(cloud) == done.json["points"] == 96 * 64
    parts = cloud.sigma_noise_mm, cloud.sigma_phase_error_mm, cloud.sigma_calibration_mm
    noise, common, whole = (np.asarray(s) for s in parts)
    form, both = np.asarray(cloud.sigma_form_mm), np.asarray(cloud.sigma_mm)
    assert np.allclose(whole, 1e-3 * np.linalg.norm(cloud.points, axis=1), rtol=1e-4)
    assert np.allclose(both, np.sqrt(noise**2 + common**2 + whole**2), rtol=1e-6)
    # Of a cloud that grows about the camera a thousandth of its own size remains.
    size = np.linalg.norm(cloud.points - cloud.points.mean(axis=0), axis=1)
    assert np.allclose(form, 1e-3 * size, rtol=1e-3, atol=1e-5)
    assert 0 < np.median(noise) < np.median(whole)
    page = out.with_suffix(".html").read_text()
    assert "median" in page
    assert "common to all points" in page


@pytest.mark.whole
def test_without_covariance_the_noise_remains(fpplab: Command, session: Path, tmp_path: Path) -> None:
    calibration, out = saved(small_rig(), tmp_path / "c.yaml"), tmp_path / "cloud.ply"
    done = fpplab("reconstruct", session, "--calibration", calibration, "--out", out, "--json")
    assert done.code == 0, done.err
    cloud = load_cloud(out)
    assert cloud.sigma_noise_mm is not None
    assert (cloud.sigma_calibration_mm, cloud.sigma_form_mm, cloud.sigma_mm) == (None, None, None)
    assert "says nothing of its own uncertainty" in out.with_suffix(".html").read_text()
