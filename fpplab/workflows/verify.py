"""Acceptance test of a measuring system, from clouds and sessions or from scans taken now."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import check_new_file, is_portable_name
from fpplab.core.session_names import CLOUD, JOURNAL
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import Cloud
    from fpplab.comparison.acceptance import Standard
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.results.acceptance import AcceptanceResult


@dataclass(frozen=True, eq=False)
class AcceptanceRequest:
    """Which standard to judge by, and where the points come from: from files, or from a rig."""

    standard: Standard
    out: Path  # report; scans of a rig go into a folder next to it
    spheres: tuple[Path, ...] = ()  # clouds or sessions of the ball bar
    planes: tuple[Path, ...] = ()  # clouds or sessions of the plane
    calibration: Calibration | None = None  # of the rig, or of sessions that are reconstructed again
    rig: Rig | None = None  # not open; measures the standard's items
    plan: Plan | None = None  # of its scans
    force: bool = False  # whether existing files are replaced
    calibration_file: Path | None = None  # as provenance calls it


def run_acceptance(request: AcceptanceRequest, observer: Observer | None = None) -> AcceptanceResult:
    """Judge a measuring system by its points on a ball bar and a plane, and write the report."""
    check_acceptance_input(request)
    observer, stopwatch = observer or Observer(), Stopwatch()
    if request.rig:
        bars, planes = _scan_standard(request, request.rig, observer)
    else:
        bars, planes = _by_name(request.spheres), _by_name(request.planes)

    from fpplab.comparison.acceptance import verify
    from fpplab.diagnosis.acceptance import diagnose_acceptance
    from fpplab.report.acceptance import write_acceptance_report
    from fpplab.results.acceptance import AcceptanceResult
    from fpplab.results.provenance import source_provenance

    with observer.stage("Verifying"):
        calibration = None if request.rig else request.calibration
        acceptance = verify(
            request.standard, _load_clouds(bars, calibration), _load_clouds(planes, calibration)
        )
        observer.result(acceptance)
        result = AcceptanceResult(
            acceptance=acceptance,
            diagnosis=diagnose_acceptance(acceptance),
            provenance={
                name: source_provenance(path, request.calibration, request.calibration_file)
                for name, path in {**bars, **planes}.items()
            },
            seconds=stopwatch.seconds,
            report_file=request.out,
        )
        write_acceptance_report(request.out, result)
    return result


def check_acceptance_input(request: AcceptanceRequest) -> None:
    """Refuse an output that exists already, and points from nowhere or from two places."""
    check_new_file(request.out, request.force, ".html")
    if bool(request.spheres or request.planes) == bool(request.rig):
        raise ConfigError("give either --spheres and --planes, or --rig, to say where the points come from")


def _by_name(paths: Sequence[Path]) -> dict[str, Path]:
    """Clouds and sessions by name. Raises `ConfigError` for one that is missing, or given twice."""
    names = [str(path) for path in paths]
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise ConfigError(f"{name}: is given twice; each position of a standard counts once")
        if not path.exists():
            raise ConfigError(f"{name}: there is no such cloud or session")
    return dict(zip(names, paths, strict=True))


def _load_clouds(sources: Mapping[str, Path], calibration: Calibration | None) -> Iterator[tuple[str, Cloud]]:
    for name, path in sources.items():
        yield name, _load_cloud(path, calibration)


def _load_cloud(path: Path, calibration: Calibration | None) -> Cloud:
    """A cloud from its file; or from a session: reconstructed again if a calibration is given."""
    from fpplab.clouds import load_cloud
    from fpplab.pipeline.measuring import reconstruct_points
    from fpplab.sessions.session import Session

    if not path.is_dir():
        return load_cloud(path)
    if calibration:
        return reconstruct_points(Session.open(path), calibration)[1]
    if (path / JOURNAL).is_file() and not (path / CLOUD).is_file():
        raise DataError(f"{path}: holds no {CLOUD}; give --calibration to reconstruct it")
    return load_cloud(path)


def _scan_standard(
    request: AcceptanceRequest, rig: Rig, observer: Observer
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Sessions of ball bars and planes by item, scanned into a folder next to the report."""
    from fpplab.pipeline.depth import check_plan

    standard, calibration, plan = request.standard, request.calibration, request.plan
    if calibration is None or plan is None:
        raise ConfigError("--rig needs --calibration, the rig's own; make it with fpplab characterise")
    items = (*standard.items.ball_bar, *standard.items.plane)
    if not items:
        raise ConfigError(
            f"standard '{standard.name}': 'items' is empty; name what the rig's fixture holds, by position"
        )
    if wrong := [item for item in items if not is_portable_name(item)]:
        raise ConfigError(
            f"standard '{standard.name}': 'items' names '{wrong[0]}': its scan is a folder of that name, "
            "which Windows does not allow; rename the item"
        )
    check_plan(plan, "--plan", calibration, rig)
    folder = request.out.with_name(request.out.stem + "_scans")
    sessions = {item: folder / item for item in items}
    with rig:
        _check_devices(rig, plan, calibration, sessions, request.force)
        caps = rig.projector.caps
        observer.plan(plan, caps.size, caps.lattice)
        observer.calibration(calibration)
        for item, path in sessions.items():
            _scan_item(rig, plan, calibration, item, path, request.force, observer)
    return (
        {item: sessions[item] for item in standard.items.ball_bar},
        {item: sessions[item] for item in standard.items.plane},
    )


def _check_devices(
    rig: Rig, plan: Plan, calibration: Calibration, sessions: Mapping[str, Path], force: bool
) -> None:
    from fpplab.pipeline.taking import check_disk_space

    fixture, caps = rig.need_fixture("fpplab verify --rig"), rig.projector.caps
    plan.check_projector(caps.size, "--plan")
    calibration.check_camera(rig.camera.caps.size, "--calibration")
    calibration.check_projector(caps.size, caps.lattice, "--calibration")
    for item in sessions:
        fixture.check(item)
    check_disk_space(rig, plan, list(sessions.values()), force)


def _scan_item(
    rig: Rig, plan: Plan, calibration: Calibration, item: str, path: Path, force: bool, observer: Observer
) -> None:
    from fpplab.pipeline.measuring import finish_scan
    from fpplab.pipeline.taking import take_or_resume_session

    with observer.stage(f"Scanning {item}") as progress:
        session = take_or_resume_session(
            rig,
            plan,
            path,
            (item, 0),
            replace_existing=force,
            accept_complete=True,
            progress=progress,
            observe_frame=observer.frame,
        )
        reconstruction = finish_scan(session, calibration)
        reconstruction.diagnosis.require_usable(str(path))
        observer.result(reconstruction)
