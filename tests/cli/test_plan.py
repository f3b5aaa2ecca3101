"""`fpplab plan show` on the reference rig, whose limits are known, and `fpplab plan fine`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fpplab.calibration.model import Calibration
from fpplab.core.config import find_config
from fpplab.core.errors import CapabilityError, ConfigError, FppError, SettingError
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.setup.plan_preview import plan_precision, preview_plan
from sim.world import World
from tests.conformance.reference import EXPOSURE_TICK_S, READOUT_S, ReferenceCamera, ReferenceProjector
from tests.support.commands import Command

RIG = Path("tests/conformance/rigs/rig_reference.yaml").resolve()
PLAN = """
fringes: [{axis: x, stripes: 4, steps: 3}]
trigger: triggered
exposure_s: 0.0200012
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """The reference rig, with a camera that needs 10 ms after each exposure."""
    camera = 'ReferenceCamera"'
    text = RIG.read_text(encoding="utf-8").replace(camera, f"{camera}, dead_time_s: 0.01")
    (tmp_path / "rig.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path / "rig.yaml"


def test_a_plan_is_shown(fpplab: Command, rig: Path) -> None:
    picture = rig.with_name("patterns.png")
    words = ("plan", "show", rig.with_name("plan.yaml"), "--rig", rig, "--out", picture, "--json")
    done = fpplab(*words)
    assert done.code == 0, done.err
    found = done.json
    light_s, ends = 0.02 + READOUT_S, found["end_markers"]
    period_s = (light_s + 0.01) * 1.0002
    assert (found["trigger"], found["images"], ends) == ("triggered", 3, 2)
    assert found["bit_planes"] == 8 * (3 + ends)
    assert found["exposure_s"] == pytest.approx(0.02, abs=EXPOSURE_TICK_S / 1e3)
    assert found["light_s"] == pytest.approx(light_s)
    assert found["period_s"] == pytest.approx(period_s)
    assert found["dark_s"] == pytest.approx(period_s - light_s)
    assert found["least_s"] == pytest.approx((3 + ends) * period_s)
    with Image.open(picture) as drawn:
        grey = np.asarray(drawn.convert("L"))
    assert np.ptp(grey) > 200
    again = fpplab(*words)
    assert (again.code, "--force" in again.json["error"]) == (2, True)


def test_a_plan_that_cannot_work_is_refused_by_its_limit(fpplab: Command, rig: Path) -> None:
    plan = rig.with_name("plan.yaml")
    plan.write_text(PLAN.replace("0.0200012", "0.002"), encoding="utf-8")
    picture = rig.with_name("patterns.png")
    done = fpplab("plan", "show", plan, "--rig", rig, "--out", picture)
    assert done.code == 3
    assert "exposure 2 ms and readout 4 ms" in done.err
    assert "with 8 bits at least 8 ms: lengthen the plan's exposure_s" in done.err
    assert not picture.exists()


def test_codes_that_a_scan_would_refuse_are_refused_here(fpplab: Command, rig: Path) -> None:
    plan = rig.with_name("plan.yaml")
    plan.write_text(
        "fringes: [{kind: shifted, axis: x, stripes: 3, shifts_deg: [0, 120, 240]}]\nexposure_s: 0.02\n"
    )
    done = fpplab("plan", "show", plan, "--rig", rig)
    assert done.code == 2
    assert f"{plan}: 'fringes' along x look alike at coordinates " in done.err


def planned(stripes: float = 4, steps: int = 3, **more: object) -> Plan:
    return Plan(fringes=(Sinusoid(axis="x", stripes=stripes, steps=steps),), **more)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("plan", "error", "limit"),
    [
        (planned(stripes=13), ConfigError, r"my\.yaml: 'fringes\[0\]\.stripes' is 13.*at most 12"),
        (planned(steps=33), CapabilityError, "33 patterns given; holds 1 to 32"),
        (planned(exposure_s=2.0), SettingError, r"exposure_s is 2 s; the device accepts 0\.0001 to 1 s"),
        (planned(bits=10), ConfigError, "'bits' is 10, but camera of .* offers 8, 12"),
    ],
)
def test_what_a_device_does_not_accept(plan: Plan, error: type[FppError], limit: str) -> None:
    with Rig.load(RIG) as rig, pytest.raises(error, match=limit):
        preview_plan(rig, plan, "my.yaml")


@pytest.mark.parametrize(
    ("device", "lack", "trigger", "said"),
    [
        (ReferenceCamera, {"triggers": ("software",)}, "triggered", "has no hardware trigger"),
        (ReferenceProjector, {"trigger_outputs": 0}, "triggered", "has no trigger output"),
        (ReferenceCamera, {"dark_s": 0.001}, "stepped", "global reset"),
    ],
)
def test_what_a_device_cannot_do(
    monkeypatch: pytest.MonkeyPatch, device: type, lack: dict[str, object], trigger: str, said: str
) -> None:
    whole = device._caps
    monkeypatch.setattr(device, "_caps", lambda self: replace(whole(self), **lack))
    with Rig.load(RIG) as rig, pytest.raises(CapabilityError, match=said):
        preview_plan(rig, planned(trigger=trigger), "plan")


def test_a_stepped_plan_waits_for_its_display_and_projects_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def lit(*_: object) -> None:
        raise AssertionError("something is projected")

    monkeypatch.setattr(ReferenceProjector, "_show", lit)
    monkeypatch.setattr(ReferenceProjector, "_play", lit)
    with Rig.load(RIG) as rig:
        found, patterns = preview_plan(rig, planned(settle_s=0.1), "plan")
    step_s = 0.1 + 0.02 + READOUT_S
    assert (found.images, found.end_markers, len(patterns), found.dark_s) == (3, 0, 3, 0.0)
    assert (found.light_s, found.period_s, found.least_s) == pytest.approx((step_s, step_s, 3 * step_s))


def test_noise_is_told_as_depth_where_a_calibration_is_given() -> None:
    known = Calibration.load(Path("configs/calibration_matched.yaml"))
    fine, coarse = (
        plan_precision(planned(stripes), known.projector.size, 0.02, known) for stripes in (64, 32)
    )
    assert fine.sigma_um is not None
    assert fine.depth_mm is not None
    assert coarse.sigma_um == pytest.approx(2 * fine.sigma_um)
    point = np.array([[0.0, 0.0, fine.depth_mm], [0.0, 0.0, fine.depth_mm + 1.0]])
    near, far = known.projector.project(point, known.T_projector_camera)
    assert fine.sigma_um == pytest.approx(1e3 * fine.sigma_px["x"] / abs(far - near)[0], rel=0.1)


def test_a_plan_of_fine_fringes_is_written(fpplab: Command, tmp_path: Path) -> None:
    known = tmp_path / "calibration.yaml"
    demo_calibration().save(known)
    words = ("plan", "fine", "--calibration", known, "--out", tmp_path / "fine.yaml", "--json")
    done = fpplab(*words, "--depth", 425, 475)
    assert done.code == 0, done.err
    written = Plan.load(tmp_path / "fine.yaml")
    assert written.fringes == Plan.load("plan_interreflections").fringes
    assert (done.json["images"], written.depth_mm) == (36, (425.0, 475.0))
    again = fpplab(*words, "--depth", 425, 475)
    assert (again.code, "--force" in again.json["error"]) == (2, True)
    wide = fpplab(*words, "--force", "--depth", 200, 900)
    assert (wide.code, "mm at most" in wide.json["error"]) == (2, True)
    turned = fpplab(*words, "--force", "--depth", 475, 425)
    assert (turned.code, "--depth" in turned.json["error"]) == (2, True)


def demo_calibration() -> Calibration:
    world = World.load(find_config("world_demo", "world"))
    return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
