"""A virtual scene measured through a display: the pixels of an X server's screen light it."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.acquisition.acquire import capture
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.errors import SyncError
from fpplab.core.progress import no_progress
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import GreyLevels, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.response import measure_response
from fpplab.reconstruction.points import points_of
from fpplab.setup.display_timing import measure_display
from sim.items import item_poses
from sim.world import World
from tests.drivers.x_screen import SPOILED

WORLD = Path(__file__).parents[1] / "conformance" / "rigs" / "world.yaml"
SIZES = {"square": [320, 200], "diamond": [160, 200]}
PLAN = Plan(
    fringes=(Sinusoid(axis="x", stripes=1, steps=6), Sinusoid(axis="x", stripes=10, steps=4)),
    exposure_s=0.02,
)
"""Four steps, which the second harmonic of a curve that is not corrected reaches."""


@pytest.fixture(params=["square", "diamond"])
def lattice(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def optics(folder: Path, lattice: str) -> World:
    """A tilted card, and the rig that sees it, in a folder."""
    world = config.parse_yaml(WORLD.read_text(), "world")
    width, height = SIZES[lattice]
    world["camera"] |= {"sensor_size": [192, 128], "pixel_um": 68.4}
    world["projector"] |= {"size": [width, height], "lattice": lattice}
    world["projector"]["centre_px"] = [(width - 1) / 2, (height - 1) / 2]
    world["projector"]["leds"]["green"]["lumens"] = 0.15
    world["items"]["card"]["pose"]["rotation_deg"] = [12.0, -20.0, 0.0]
    world["mounted"] = "card"
    (folder / "world.yaml").write_text(config.to_yaml(world))
    own = "sim.devices:"
    rig = {
        "name": "Optics",
        "bench": {"backend": own + "VirtualBench", "world": "world.yaml", "analytic": True},
        "camera": {"backend": own + "SimCamera"},
        "projector": {"backend": own + "SimProjector"},
        "fixture": {"backend": own + "SimFixture"},
    }
    (folder / "rig.yaml").write_text(config.to_yaml(rig))
    return World.load(folder / "world.yaml")


def through_display(
    folder: Path, lattice: str, curve: str = "linear", of_bench: str = "linear", **spoiled: str
) -> Rig:
    sections = {
        "name": "A scene through a display",
        "bench": {
            "backend": "tests.drivers.x_screen:XScreenBench",
            "size": SIZES[lattice],
            "optics": str(folder / "rig.yaml"),
            "curve": of_bench,
            **spoiled,
        },
        "camera": {"backend": "tests.drivers.x_screen:XScreenCamera"},
        "projector": {
            "backend": "drivers.display:DisplayProjector",
            "display": 0,
            "size": SIZES[lattice],
            "lattice": lattice,
            "curve": curve,
        },
    }  # fmt: skip
    return Rig(RigFile.model_validate(sections), folder, folder / "rig_display.yaml")


def error_mm(frames: list[np.ndarray], world: World, plan: Plan = PLAN) -> float:
    """RMS distance of the points from the card that is really there."""
    recording = Recording(frames, plan, world.projector.size, 8, "scene")
    true = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    _, cloud = points_of(decode(recording), true, plan)
    assert len(cloud.points) > 5000
    pose = item_poses(world, "card")[0]
    return float(np.sqrt(np.mean(((cloud.points - pose.translation) @ pose.rotation[:, 2]) ** 2)))


def test_frames_are_the_twins_own_and_the_card_is_where_it_is(lattice: str, tmp_path: Path) -> None:
    world = optics(tmp_path, lattice)
    with Rig.load(tmp_path / "rig.yaml") as twin:
        expected = capture(twin, PLAN)
    with through_display(tmp_path, lattice) as rig:
        frames = capture(rig, PLAN)
    np.testing.assert_array_equal(np.stack(frames), np.stack(expected))
    assert error_mm(frames, world) < 1.0


@pytest.mark.nightly
@pytest.mark.parametrize("spoiled", SPOILED)
def test_pixels_that_are_altered_on_the_way_show_in_the_cloud(spoiled: str, tmp_path: Path) -> None:
    world = optics(tmp_path, "square")
    with through_display(tmp_path, "square") as rig:
        right = error_mm(capture(rig, PLAN), world)
    with through_display(tmp_path, "square", spoiled=spoiled) as rig:
        try:
            wrong = error_mm(capture(rig, PLAN), world)
        except SyncError:  # frames that no plan explains are refused before anything is computed
            return
    assert wrong > 2 * right


@pytest.mark.nightly
def test_a_curve_that_is_known_or_measured_is_taken_out(tmp_path: Path) -> None:
    world = optics(tmp_path, "square")
    with through_display(tmp_path, "square") as rig:
        linear = error_mm(capture(rig, PLAN), world)
    with through_display(tmp_path, "square", of_bench="srgb") as rig:
        ignored = error_mm(capture(rig, PLAN), world)
        response, _ = measure_response(rig, PLAN.exposure_s, GreyLevels(levels=24, repeats=2), no_progress)
        measured = PLAN.model_copy(update={"response": Curve(a=response.a, b=response.b, g=response.g)})
        by_response = error_mm(capture(rig, measured), world, measured)
    with through_display(tmp_path, "square", curve="srgb", of_bench="srgb") as rig:
        known = error_mm(capture(rig, PLAN), world)
    assert ignored > 1.25 * linear  # noise included, of which there is much at so few pixels
    assert known < 1.1 * linear
    assert by_response < 1.1 * linear


@pytest.mark.nightly
def test_times_are_those_of_the_display(tmp_path: Path) -> None:
    """SDL draws in steps of 16 whole ms on a server without a screen, and each frame is there at once."""
    optics(tmp_path, "square")
    with through_display(tmp_path, "square") as rig:
        found = measure_display(rig, PLAN, no_progress)
    assert found.reported_s == pytest.approx(0.016, rel=0.1)
    assert found.refresh_s == pytest.approx(0.016, rel=0.12)
    assert found.agrees
    assert found.settle_s <= 0.008
