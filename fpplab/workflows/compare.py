"""Compare a cloud with the true shape, and draw where they differ."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import DataError
from fpplab.core.files import check_new_file
from fpplab.core.session_names import CALIBRATION, CLOUD, JOURNAL
from fpplab.results.observer import Observer

if TYPE_CHECKING:
    import trimesh

    from fpplab.calibration.model import Calibration
    from fpplab.clouds import Cloud
    from fpplab.comparison import Comparison
    from fpplab.results.comparison import ComparisonResult


@dataclass(frozen=True)
class ComparisonRequest:
    """Which cloud to compare with which shape, and where the result is drawn."""

    source: Path  # cloud, or session that holds one
    mesh: Path  # true shape, in mm
    align: bool = False  # whether the mesh is first moved onto the cloud, rigidly
    calibration: Path | None = None  # of what both devices see; by default the one next to the cloud
    out: Path | None = None  # picture of the errors (.png), or points coloured by them (.ply)
    page: Path | None = None  # report
    force: bool = False  # whether existing files are replaced

    @property
    def cloud(self) -> Path:
        """The cloud's own file."""
        return self.source / CLOUD if self.source.is_dir() else self.source

    @property
    def cloud_name(self) -> str:
        """What the cloud is called: its session, or its file."""
        cloud = self.cloud
        return cloud.absolute().parent.name if cloud.name == CLOUD else cloud.stem


def run_comparison(request: ComparisonRequest, observer: Observer | None = None) -> ComparisonResult:
    """Compare a cloud with the true shape, and write pictures and report where they are asked for."""
    check_comparison_output(request)
    observer = observer or Observer()
    result = _compare(request, observer)
    observer.result(result)
    if request.out:
        from fpplab.report.comparison import write_errors

        write_errors(request.out, result)
    for warning in result.comparison.warnings():
        observer.message(warning)
    if request.page:
        from fpplab.report.comparison import write_comparison_report

        write_comparison_report(request.page, result)
    return result


def check_comparison_output(request: ComparisonRequest) -> None:
    """Refuse an output that cannot be written, or exists already."""
    for path, suffixes in ((request.out, (".png", ".ply")), (request.page, (".html",))):
        if path:
            check_new_file(path, request.force, *suffixes)


def _compare(request: ComparisonRequest, observer: Observer) -> ComparisonResult:
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import load_cloud, load_mesh
    from fpplab.comparison import find_misplacement
    from fpplab.diagnosis.record import load_diagnosis
    from fpplab.results.comparison import ComparisonResult
    from fpplab.results.provenance import cloud_provenance

    path = request.cloud
    stored = path.parent / CALIBRATION
    source = request.calibration or (stored if stored.is_file() else None)
    calibration = Calibration.load(source) if source else None
    cloud = load_cloud(request.source)
    if calibration and cloud.size:
        calibration.check_camera(cloud.size, source or path)
    with observer.stage("Comparing"):
        mesh = load_mesh(request.mesh)
        if request.align:
            comparison, misplaced = _align_and_compare(cloud, mesh, calibration), None
        else:
            comparison = _as_placed(cloud, mesh, calibration, request.mesh)
            misplaced = find_misplacement(cloud, mesh)
    recorded = load_diagnosis(path.parent) if (path.parent / JOURNAL).is_file() else None
    provenance = cloud_provenance(path, calibration)
    return ComparisonResult(
        name=request.cloud_name,
        cloud=cloud,
        comparison=comparison,
        misplaced=misplaced.describe() if misplaced else None,
        diagnosis=recorded.diagnosis() if recorded else None,
        provenance=provenance.with_values(true_shape=str(request.mesh)),
        report_file=request.page,
    )


def _align_and_compare(cloud: Cloud, mesh: trimesh.Trimesh, calibration: Calibration | None) -> Comparison:
    from fpplab.artefacts.recognition import recognise
    from fpplab.comparison import compare

    return compare(cloud, mesh, calibration, align=True, artefact=recognise(mesh))


def _as_placed(
    cloud: Cloud, mesh: trimesh.Trimesh, calibration: Calibration | None, source: Path
) -> Comparison:
    """Compare without an alignment; where nothing can be compared for want of one, say so: `DataError`."""
    from fpplab.comparison import UnseenMeshError, compare, find_misplacement

    try:
        return compare(cloud, mesh, calibration)
    except UnseenMeshError as error:
        misplaced = find_misplacement(cloud, mesh)
        if misplaced is None:
            raise
        raise DataError(f"{source}: {misplaced.describe()}") from error
