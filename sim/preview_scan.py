"""A scan of what the Blender extension shows."""

from pathlib import Path

from fpplab.calibration.model import Calibration
from fpplab.core.progress import Progress, no_progress
from fpplab.devices.rig import Rig
from fpplab.results.scan import ScanResult
from fpplab.workflows.scan import scan
from sim.preview import Arrangement, arranged_setup, bench_of_rig


def record_scan(
    rig: Rig,
    arrangement: Arrangement,
    out: Path,
    *,
    calibration: Calibration | None = None,
    force: bool = False,
    progress: Progress = no_progress,
) -> ScanResult:
    """Measure on a simulated rig, and leave the session with its cloud and no report."""
    bench = bench_of_rig(rig)
    setup = arranged_setup(bench.world, arrangement)
    plan = arrangement.plan()
    if arrangement.baseline_mm is not None:
        plan = plan.model_copy(update={"stage_mm": setup.stage_mm})
    used_calibration = calibration or bench.studio().calibration(setup.stage_mm)
    mount = (setup.item, setup.pose)
    return scan(rig, plan, used_calibration, out, mount, force=force, report=False, progress=progress)
