"""The demonstration: the whole method on the virtual bench, ending in a report."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab import artefacts
from fpplab.artefacts.recognition import recognise
from fpplab.calibration.model import Calibration
from fpplab.cli import console
from fpplab.comparison import Comparison, compare
from fpplab.core.errors import ConfigError
from fpplab.core.files import refuse_existing, write_text
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Diagnosis
from fpplab.patterns.plan import Plan
from fpplab.pipeline import (
    CALIBRATION,
    REPORT,
    characterise_sessions,
    finish_scan,
    measure_response,
    take,
    take_poses,
)
from fpplab.reconstruction.filtering import removal
from fpplab.reconstruction.triangulation import triangulate
from fpplab.report import PageBasis, ScanSection, scan_section, write_report
from fpplab.report.provenance import session_provenance
from fpplab.targets import Target

POSES = 12
UNFILTERED = ("points", "surface_smcd_um", "surface_rms_um", "surface_p95_um", "completeness", "outliers")
"""What is also told of all points, so that the filter's effect can be seen."""
TRUTH, RESULT, BOARD = "truth.stl", "demo.json", "board"


@dataclass(frozen=True)
class Scan:
    """One artefact of the demonstration, measured and compared with its true shape."""

    name: str  # the artefact
    section: ScanSection  # what the report shows of it
    comparison: Comparison  # of the cloud
    unfiltered: Comparison  # the same without the plan's filter
    points: int  # of the cloud
    removed: dict[str, Any] | None  # how many points the filter took out, by rule

    def summary(self) -> dict[str, Any]:
        """Give the keys of one scan in `fpplab demo --json`."""
        return {
            "artefact": self.name,
            "images": self.section.images,
            **self.comparison.summary(),
            "points": self.points,
            "removed": self.removed,
            "unfiltered": {name: getattr(self.unfiltered, name) for name in UNFILTERED},
        }


def run_demo(out: Path, quick: bool, force: bool) -> dict[str, Any]:
    """Measure response, characterisation and three artefacts, compare them, and write a report.

    The session of every measurement stays below `out`.
    """
    for name in (RESULT, REPORT, CALIBRATION, BOARD, *artefacts.NAMES):
        refuse_existing(out / name, force)
    rig_name = "rig_demo_quick.yaml" if quick else "rig_demo.yaml"
    board_plan, scan_plan = Plan.load("plan_board.yaml"), Plan.load("plan_paper.yaml")
    with console.stopwatch() as seconds, Rig.load(rig_name) as rig:
        fixture = rig.need_fixture("the demonstration")
        with console.progress("Response") as report:
            fixture.mount("grey_card")
            response, levels = measure_response(rig, scan_plan.exposure_s, progress=report)
        with console.progress(f"Taking {POSES} poses of the board") as report:
            poses = take_poses(rig, board_plan, "board", POSES, out / BOARD, force, report)
        with console.progress("Characterising") as report:
            found = characterise_sessions(poses, Target.load("target_paper.yaml"), report)
        found.calibration.save(out / CALIBRATION)
        held = fixture.caps.items
        scans = [
            _measure(rig, name, scan_plan, found.calibration, out / name, force)
            for name in artefacts.NAMES
            if held is None or name in held
        ]
        result = {
            "gamma": response.summary(),
            "characterisation": {**found.summary(), "left_out": list(found.left_out)},
            "scans": [s.summary() for s in scans],
            "mean_surface_smcd_um": _mean([s.comparison.surface_smcd_um for s in scans]),
            "seconds": seconds(),
            "report": str(out / REPORT),
        }
        write_report(
            out / REPORT,
            "Demonstration on the virtual bench",
            facts=found.facts(),
            response=(response, levels),
            characterisation=found,
            scans=[s.section for s in scans],
            basis=PageBasis(answer=result),
        )
    write_text(out / RESULT, json.dumps(result, indent=2) + "\n")
    return result


def _mean(figures: list[float | None]) -> float:
    """Every cloud of the demonstration lies on a pixel grid, so every figure is there."""
    return float(np.mean([f for f in figures if f is not None]))


def _measure(rig: Rig, name: str, plan: Plan, calibration: Calibration, out: Path, force: bool) -> Scan:
    with console.progress(f"Scanning the {name}") as report:
        session = take(rig, plan, out, (name, 0), force=force, progress=report)
        judged: list[Diagnosis] = []
        decoded, cloud = finish_scan(session, calibration, judged=lambda *results: judged.append(results[2]))
    standing = rig.need_fixture("the demonstration").pose(name)
    if standing is None:
        raise ConfigError("the demonstration needs a fixture that knows where it holds an item")
    truth = artefacts.make(name)
    truth.apply_transform(standing.matrix)
    artefacts.save_stl(truth, out / TRUTH)
    with console.progress(f"Comparing the {name}"):
        placed = recognise(truth)
        comparison = compare(cloud, truth, calibration, align=True, artefact=placed)
        unfiltered = compare(triangulate(decoded, calibration, normals=False), truth, calibration, align=True)
    source = session_provenance(session, calibration, Path(CALIBRATION))
    section = scan_section(name, session, decoded, cloud, comparison, diagnosis=judged[0], provenance=source)
    return Scan(name, section, comparison, unfiltered, len(cloud), removal(decoded))
