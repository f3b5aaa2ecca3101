"""A scan of what the Blender extension shows."""

from __future__ import annotations

from pathlib import Path

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.progress import Progress, no_progress
from fpplab.devices.rig import Rig
from fpplab.pipeline import scan
from sim.preview import Arrangement, arranged_setup, bench_of_rig


def record_scan(
    rig: Rig,
    wanted: Arrangement,
    out: Path,
    *,
    calibration: Calibration | None = None,
    force: bool = False,
    progress: Progress = no_progress,
) -> Cloud:
    """Measure on a simulated rig, and leave the session with its cloud.

    Parameters
    ----------
    rig : Rig
        Open, and simulated.
    wanted : Arrangement
        Item, baseline and the finest fringes.
    out : Path
        Folder of the session.
    calibration : Calibration, optional
        Of the rig at that baseline; by default the simulation's true one.
    force : bool
        Whether a session that is there already is replaced.
    progress : callable
        Told the share done, 0 … 1.

    Returns
    -------
    Cloud
        Points in mm in the camera's frame.

    Raises
    ------
    ConfigError
        The rig cannot be arranged like this.
    DeviceError, DataError, CalibrationError
        As `fpplab.pipeline.scan`.
    """
    bench = bench_of_rig(rig)
    setup = arranged_setup(bench.world, wanted)
    plan = wanted.plan()
    if wanted.baseline_mm is not None:
        plan = plan.model_copy(update={"stage_mm": setup.stage_mm})
    known = calibration or bench.studio().calibration(setup.stage_mm)
    mount = (setup.item, setup.pose)
    return scan(rig, plan, known, out, mount, force=force, progress=progress)
