"""A small data set for teaching and other programs: a board, a part in two codes, and their truth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.artefacts import save_stl
from fpplab.calibration.model import Calibration
from fpplab.core.config import find_config
from fpplab.core.errors import ConfigError
from fpplab.core.files import refuse_existing, write_atomic, write_text
from fpplab.core.session_names import CALIBRATION, REPORT
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.diagnosis import Verdict
from fpplab.diagnosis.record import load_diagnosis
from fpplab.patterns.plan import Plan
from fpplab.pipeline.true_maps import trace_true_maps
from fpplab.results.observer import Observer
from fpplab.targets import Target
from fpplab.workflows.characterise import CharacterisationRequest, run_characterisation
from fpplab.workflows.scan import ScanRequest, run_scan
from fpplab.workflows.stopwatch import Stopwatch

PART, TARGET = "pyramid", "target_paper.yaml"  # of the demonstration's world
POSES = 8  # of the board (chosen: each takes two seconds)
README, RIG, TRUTH = "README.md", "rig.yaml", "truth"
RIG_FILE = """# The bench that this data set was recorded on; `fpplab scan --rig rig.yaml` records more.
name: Virtual bench, sample
bench: {backend: virtual_bench, world: world_demo.yaml, binning: 8, analytic: true}
camera: {backend: virtual_camera, bits: 8}
projector: {backend: virtual_projector}
fixture: {backend: virtual_fixture}
geometry: {max_age_h: 24}
"""
GRAY_CODE = {
    "fringes": (
        {"kind": "gray", "axis": "x", "bits": 10, "inverses": "each"},
        {"kind": "gray", "axis": "y", "bits": 11, "inverses": "each"},
        {"kind": "even", "levels": (1, 0)},
    ),
    "exposure_s": 0.02,
}
ABOUT = """# Sample data of fpplab

Recorded on a simulated bench: a camera of 684 x 456 px with 8 bits, and a projector of 912 x 1140 mirrors on
a diamond lattice (odd rows are shifted by half a column). Lengths are in mm. Camera frame: x right, y down,
z forward. Pixel (0, 0) is the centre of the first pixel.

* `calibration_poses/pose_00` …: a board of 52 circles in {poses} poses, 32 images each: phase-shifted fringes
  along both axes. `target.yaml` describes the board.
* `calibration.yaml`, `calibration.html`: camera and projector as characterised from these poses.
* `pyramid`: a pyramid of 90 x 70 x 25 mm under {fringes} images of fringes, with cloud, maps and report.
* `pyramid_gray`: the same under {gray} images of Gray code, 10 bits along x and 11 along y, each bit followed
  by its inverse, then white and black.
* `truth/calibration.yaml`: the true devices.
* `truth/pyramid.stl`: the true surface in the camera's frame.
* `truth/pyramid.npz`: true maps (height, width) of the camera: `depth` in mm, `normals`, `mask` (what is seen
  and lit), and projector coordinates `u` and `v`.
* `rig.yaml`: the bench, to record more on.

The images of a session are `frames/*.tif`, in the order of their names; `plan.yaml` says what they show. Try

    fpplab characterise calibration_poses --target target.yaml --out again.yaml
    fpplab reconstruct pyramid --calibration again.yaml --out again.ply
    fpplab compare again.ply truth/pyramid.stl
"""


@dataclass(frozen=True)
class SampleRequest:
    """Where the data set goes."""

    out: Path  # folder; an interrupted data set in it is completed
    force: bool = False  # whether a complete one is replaced


def make_sample(request: SampleRequest, observer: Observer | None = None) -> dict[str, Any]:
    """Record a board and a part on the virtual bench, and write them with the truth."""
    observer, out, stopwatch = observer or Observer(), request.out, Stopwatch()
    refuse_existing(out / README, request.force)  # which is written last
    out.mkdir(parents=True, exist_ok=True)
    write_text(out / RIG, RIG_FILE)
    calibration = _characterise(request, observer)
    plans = {PART: Plan.load("plan_scan.yaml"), f"{PART}_gray": Plan.model_validate(GRAY_CODE)}
    verdicts = {name: _scan(request, name, plan, calibration, observer).value for name, plan in plans.items()}
    _write_truth(out, observer)
    images = [plan.frames for plan in plans.values()]
    write_text(out / README, ABOUT.format(poses=POSES, fringes=images[0], gray=images[1]))
    return {"sample": str(out), "poses": POSES, "verdicts": verdicts, "seconds": stopwatch.seconds}


def _characterise(request: SampleRequest, observer: Observer) -> Calibration:
    file = request.out / CALIBRATION
    if request.force or not file.exists():
        target = find_config(TARGET, "target").read_text(encoding="utf-8")
        write_text(request.out / "target.yaml", target)
        rig, plan = Rig.load(request.out / RIG), Plan.load("plan_board.yaml")
        run_characterisation(
            CharacterisationRequest(
                Target.load(TARGET), file, rig=rig, plan=plan, poses=POSES, force=request.force
            ),
            observer,
        )
    return Calibration.load(file)


def _scan(
    request: SampleRequest, name: str, plan: Plan, calibration: Calibration, observer: Observer
) -> Verdict:
    rig, out = Rig.load(request.out / RIG), request.out / name
    recorded = load_diagnosis(out) if (out / REPORT).is_file() and not request.force else None
    if recorded is not None:
        return recorded.diagnosis().verdict
    observer.message(f"{name}: {plan.frames} images")
    file = request.out / CALIBRATION
    wanted = ScanRequest(rig, plan, calibration, out, (PART, 0), force=request.force, calibration_file=file)
    return run_scan(wanted, observer).diagnosis.verdict


def _write_truth(out: Path, observer: Observer) -> None:
    """Write the devices, surface and maps that the simulation has, which nothing measures."""
    import numpy as np

    with observer.stage("Tracing the truth"), Rig.load(out / RIG) as rig:
        if not isinstance(rig.simulation, Predictable):
            raise ConfigError("the sample needs a simulation that knows its truth")
        sampler = rig.simulation.image_part_sampler()
        surface, devices = sampler.mesh(PART), sampler.calibration
    maps = vars(trace_true_maps(surface, devices))
    devices.save(out / TRUTH / CALIBRATION)
    save_stl(surface, out / TRUTH / f"{PART}.stl")
    write_atomic(out / TRUTH / f"{PART}.npz", lambda stream: np.savez_compressed(stream, **maps))
