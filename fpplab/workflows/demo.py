"""The demonstration: the whole method on the virtual bench, ending in a report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError
from fpplab.core.files import refuse_existing, write_text
from fpplab.core.session_names import CALIBRATION, REPORT
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.characterisation import Characterisation
    from fpplab.core.conventions import Floats
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.patterns.response import Response
    from fpplab.results.demo import DemoResult, DemoScan

POSES = 12  # poses of the board (chosen)
TRUTH, RESULT, BOARD = "truth.stl", "demo.json", "board"


@dataclass(frozen=True)
class DemoRequest:
    """Where the demonstration goes, and how fine its images are."""

    out: Path  # folder; the session of every measurement stays in it
    quick: bool = False  # whether images have 684 x 456 pixels instead of 1368 x 912
    force: bool = False  # whether existing files are replaced

    @property
    def rig(self) -> str:
        """The virtual bench, which comes with fpplab."""
        return "rig_demo_quick.yaml" if self.quick else "rig_demo.yaml"


def run_demo(request: DemoRequest, observer: Observer | None = None) -> DemoResult:
    """Measure response, characterisation and artefacts, compare with the true shapes, and write a report."""
    from fpplab import artefacts
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.report.demo import write_demo_report
    from fpplab.results.demo import DemoResult

    observer, out, stopwatch = observer or Observer(), request.out, Stopwatch()
    for name in (RESULT, REPORT, CALIBRATION, BOARD, *artefacts.NAMES):
        refuse_existing(out / name, request.force)
    plan = Plan.load("plan_scan.yaml")
    with Rig.load(request.rig) as rig:
        response, levels = _measure_response(rig, plan, observer)
        characterised = _characterise(rig, request, observer)
        characterised.calibration.save(out / CALIBRATION)
        held = rig.need_fixture("the demonstration").caps.items
        scans = [
            _scan_artefact(rig, name, plan, characterised, request, observer)
            for name in artefacts.NAMES
            if held is None or name in held
        ]
        result = DemoResult(response, levels, characterised, tuple(scans), stopwatch.seconds, out / REPORT)
        write_demo_report(result)
    write_text(out / RESULT, json.dumps(result.summary(), indent=2) + "\n")
    return result


def _measure_response(rig: Rig, plan: Plan, observer: Observer) -> tuple[Response, Floats]:
    from fpplab.pipeline.response import measure_response

    with observer.stage("Response") as progress:
        rig.need_fixture("the demonstration").mount("grey_card")
        return measure_response(rig, plan.exposure_s, progress=progress)


def _characterise(rig: Rig, request: DemoRequest, observer: Observer) -> Characterisation:
    from fpplab.patterns.plan import Plan
    from fpplab.pipeline.characterising import characterise_sessions
    from fpplab.pipeline.taking import take_poses
    from fpplab.targets import Target

    plan, folder = Plan.load("plan_board.yaml"), request.out / BOARD
    with observer.stage(f"Taking {POSES} poses of the board") as progress:
        poses = take_poses(rig, plan, "board", POSES, folder, request.force, progress)
    with observer.stage("Characterising") as progress:
        return characterise_sessions(poses, Target.load("target_paper.yaml"), progress)


def _scan_artefact(
    rig: Rig, name: str, plan: Plan, characterised: Characterisation, request: DemoRequest, observer: Observer
) -> DemoScan:
    """Measure an artefact in its first pose, and compare it with its true shape there."""
    from fpplab import artefacts
    from fpplab.artefacts.recognition import recognise
    from fpplab.comparison import compare
    from fpplab.pipeline.measuring import finish_scan
    from fpplab.pipeline.taking import take_or_resume_session
    from fpplab.reconstruction.points import triangulate
    from fpplab.results.demo import DemoScan
    from fpplab.results.provenance import session_provenance
    from fpplab.results.scan import scan_result

    stopwatch, calibration, out = Stopwatch(), characterised.calibration, request.out / name
    with observer.stage(f"Scanning the {name}") as progress:
        session = take_or_resume_session(
            rig, plan, out, (name, 0), replace_existing=request.force, progress=progress
        )
        reconstruction = finish_scan(session, calibration)
    reconstruction.diagnosis.require_usable(str(session.path))
    assert reconstruction.decoded is not None
    assert reconstruction.cloud is not None
    provenance = session_provenance(session, calibration, Path(CALIBRATION))
    scan = scan_result(reconstruction, provenance, stopwatch.seconds, images=plan.frames)
    standing = rig.need_fixture("the demonstration").pose(name)
    if standing is None:
        raise ConfigError("the demonstration needs a fixture that knows where it holds an item")
    truth = artefacts.make(name)
    truth.apply_transform(standing.matrix)
    artefacts.save_stl(truth, out / TRUTH)
    with observer.stage(f"Comparing the {name}"):
        placed = recognise(truth)
        comparison = compare(reconstruction.cloud, truth, calibration, align=True, artefact=placed)
        points = triangulate(reconstruction.decoded, calibration, normals=False)
        unfiltered = compare(points, truth, calibration, align=True)
    return DemoScan(name, scan, comparison, unfiltered)
