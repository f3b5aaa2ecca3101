"""The result of a scan, whether measured now or reconstructed from a recorded session."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fpplab.core.notebook import html_table
from fpplab.diagnosis.islands import island_counts
from fpplab.phase.precision import uncertain_orders
from fpplab.pipeline.measuring import Reconstruction
from fpplab.reconstruction.filtering import count_removed
from fpplab.reconstruction.points import cost_at_edges
from fpplab.results.provenance import Provenance


@dataclass(frozen=True, eq=False, repr=False)
class ScanResult(Reconstruction):
    """Points of a scan, whether to believe them, and where they come from.

    It unpacks: `decoded, cloud = reconstruct(session, calibration)`.

    Attributes
    ----------
    session : Session
        The recorded frames.
    calibration : Calibration
        That the points were triangulated with.
    decoded : Decoded or None
        Maps (height, width) of projector coordinates, which know what was removed; None without points.
    cloud : Cloud or None
        Points in mm in the camera's frame, with their sigmas; None where no pixel gives one.
    depth : DepthRange or None
        Range of depths that counted; None where none is stated.
    diagnosis : Diagnosis
        Verdict and findings.
    provenance : Provenance
        Devices, settings, times and calibration as recorded.
    seconds : float
        Time that the work took, without the report.
    images : int or None
        Images of the plan, where they were taken now; None for a recorded session.
    cloud_file : Path or None
        Where the cloud is written if it is usable; None where it is not written.
    report_file : Path or None
        Where the report is written; None where none is.
    """

    provenance: Provenance
    seconds: float
    images: int | None = None
    cloud_file: Path | None = None
    report_file: Path | None = None

    def __repr__(self) -> str:
        points = len(self.cloud) if self.cloud else 0
        return f"<ScanResult of {self.session.path}: {points} points, {self.diagnosis.sentence}>"

    def _repr_html_(self) -> str:
        near_far = None if self.depth is None else f"{self.depth.mm[0]:g} to {self.depth.mm[1]:g} mm"
        rows: dict[str, object] = {
            "verdict": self.diagnosis.verdict.value,
            "reason": self.diagnosis.reason,
            "points": f"{len(self.cloud) if self.cloud else 0:,}",
            "depths": near_far,
            "time": f"{self.seconds:.1f} s",
        }
        for number, finding in enumerate(self.diagnosis.findings, 1):
            rows[f"finding {number}"] = f"{finding.sentence}; {finding.remedy}"
        return html_table(f"Scan {self.session.path.name}", rows)

    def __iter__(self) -> Iterator[Any]:
        """Unpack into maps and points, which is what `reconstruct` gave in version 0.1."""
        return iter((self.decoded, self.cloud))

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Give attributes of the cloud, which is what `scan` gave in version 0.1.

            Programs that were written for it keep working; type checkers know `cloud` alone.
            """
            if name.startswith("_") or self.cloud is None:
                raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
            return getattr(self.cloud, name)

    def require_usable(self) -> None:
        """Refuse a result that must not be used.

        Raises
        ------
        UselessScanError
            The verdict is `useless`; it says why.
        """
        self.diagnosis.require_usable(str(self.session.path))

    def figures(self) -> dict[str, Any]:
        """Collect what the report holds as data: as `summary`, without provenance and files."""
        verdict: dict[str, Any] = self.diagnosis.summary()
        if self.decoded is None or self.cloud is None:
            return verdict
        images = {} if self.images is None else {"images": self.images}
        return {
            **verdict,
            "points": len(self.cloud),
            **images,
            "removed": count_removed(self.decoded),
            "depth_range": asdict(self.depth) if self.depth else None,
            "warnings": list(self.decoded.outside.warnings()) if self.decoded.outside else [],
            "uncertain_orders": uncertain_orders(self.decoded, self.session.plan),
            "edges": cost_at_edges(self.decoded, self.cloud),
            "seconds": self.seconds,
            **({} if (islands := island_counts(self.decoded)) is None else {"islands": islands}),
        }

    def summary(self) -> dict[str, Any]:
        """Collect what `fpplab scan --json` and `fpplab reconstruct --json` print.

        Returns
        -------
        dict
            Verdict, figures, provenance and files.
        """
        return {
            **self.figures(),
            "provenance": self.provenance.summary(),
            "cloud": None if self.cloud_file is None else str(self.cloud_file),
            "report": None if self.report_file is None else str(self.report_file),
        }


def scan_result(
    reconstruction: Reconstruction,
    provenance: Provenance,
    seconds: float,
    *,
    images: int | None = None,
    cloud_file: Path | None = None,
    report_file: Path | None = None,
) -> ScanResult:
    return ScanResult(
        **vars(reconstruction),
        provenance=provenance,
        seconds=seconds,
        images=images,
        cloud_file=cloud_file,
        report_file=report_file,
    )
