"""Whole commands: the range of depths of option, plan and rig file, and the cost of uncertain orders."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.progress import no_progress
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.pipeline.decoding import checked_recording
from fpplab.sessions.session import Session
from tests.support.commands import Command
from tests.support.warmup import DISTANCE_MM, frames_of_plane, small_rig

RIG = small_rig()
NEAR, FAR = DISTANCE_MM - 40.0, DISTANCE_MM + 40.0
DEVICE = {"backend": "tests.conformance.reference:ReferenceCamera"}


def recorded(folder: Path, plan_mm: tuple | None, rig_mm: tuple | None, noise: float = 300.0) -> Path:
    """A session of a plane with a guided plan, and its calibration beside it."""
    fringes = tuple(Sinusoid(axis="x", stripes=s, steps=4) for s in (9.0, 120.0))
    masks = MaskRules(modulation_min=0.0, contrast_min=0.0, residual_max=10.0)
    plan = Plan(fringes=fringes, unwrapping="guided", depth_mm=plan_mm, masks=masks)
    size, lattice = RIG.projector.size, Lattice.SQUARE
    resolved = {
        "camera": {"model": "small", "size": list(RIG.camera.size)},
        "projector": {"model": "small", "size": list(size), "lattice": lattice.value},
    }
    rig = {"name": "small", "camera": DEVICE, "projector": DEVICE, "resolved": resolved}
    session = Session.create(folder / "plane", plan, {**rig, "depth_mm": list(rig_mm)} if rig_mm else rig)
    random, patterns = np.random.default_rng(8), make_patterns(plan, size, lattice)
    for index, frame in enumerate(frames_of_plane(plan, RIG, 16)):
        level = np.clip(frame + random.normal(0.0, noise, frame.shape), 0, 65000)
        image, settings = np.rint(level).astype(np.uint16), CameraSettings(0.02, 0.0, 16)
        session.write(Frame(image, index, settings, 0.0, None, patterns[index].id))
    RIG.save(folder / "calibration.yaml")
    return session.path


def words(session: Path) -> tuple[object, ...]:
    calibration = session.parent / "calibration.yaml"
    return "reconstruct", session, "--calibration", calibration, "--out", session / "cloud.ply", "--json"


@pytest.mark.parametrize(
    ("plan_mm", "rig_mm", "option", "source"),
    [
        (None, (NEAR, FAR), None, "rig.yaml: 'depth_mm'"),
        ((NEAR, FAR), (100.0, 110.0), None, "plan.yaml: 'depth_mm'"),
        ((100.0, 110.0), (100.0, 110.0), (NEAR, FAR), "--depth"),
    ],
)
def test_the_option_precedes_the_plan_and_the_plan_the_rig(
    tmp_path: Path, plan_mm, rig_mm, option, source
) -> None:
    session = Session.open(recorded(tmp_path, plan_mm, rig_mm))
    used = checked_recording(session, RIG, option, no_progress).depth
    assert used is not None
    assert used.mm == (NEAR, FAR)
    assert used.source.endswith(source)


def test_a_damaged_range_of_a_recorded_rig_is_named(tmp_path: Path) -> None:
    session = Session.open(recorded(tmp_path, None, (500.0, 300.0)))
    with pytest.raises(
        ConfigError, match=r"rig\.yaml: 'depth_mm' is \[500\.0, 300\.0\]: the first must be less"
    ):
        _ = session.depth


def test_without_a_range_the_message_says_where_it_may_stand(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab(*words(recorded(tmp_path, None, None)))
    assert done.code == 2
    assert "--depth, or 'depth_mm' in plan or rig file" in done.json["error"]
    assert not (tmp_path / "plane" / "cloud.ply").exists()


@pytest.mark.whole
def test_the_report_names_the_range_and_the_set_that_cost_pixels(fpplab: Command, tmp_path: Path) -> None:
    session = recorded(tmp_path, None, (NEAR, FAR), noise=3500.0)
    done = fpplab(*words(session))
    assert done.code == 0, done.err
    assert done.json["depth_range"] == {"mm": [NEAR, FAR], "source": f"{session / 'rig.yaml'}: 'depth_mm'"}
    cost = done.json["uncertain_orders"]
    # Thirteen fine periods in a coarse one: the noise of the coarse set leaves open which is meant.
    assert list(cost) == ["x 9 stripes"]
    assert cost["x 9 stripes"] > 1000
    assert done.json["points"] > 1000
    page = (session / "cloud.html").read_text(encoding="utf-8")
    assert "for an uncertain fringe order, by the set at fault: x 9 stripes" in page
    assert f"Only distances from {NEAR:g} to {FAR:g} mm count" in page
    # 9 and 120 stripes have the divisor 3: after every third of the projector both repeat.
    assert any("decoded wrongly" in one for one in done.json["warnings"])
