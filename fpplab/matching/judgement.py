"""What a matched twin is for: it measures an artefact as wrongly as its bench does.

Bench and twin scan the same plan in the same place, each is reconstructed with its own calibration and
compared with the true shape, by the symmetric distance between points and surface. Where the artefact stood
on the bench is found by laying its true shape onto the bench's cloud.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.comparison import Comparison, compare
from fpplab.comparison.alignment import align_mesh
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline import points_of, reconstruct
from fpplab.sessions.session import Session
from fpplab.simulation.matchable import Twin


@dataclass(frozen=True, eq=False)
class ArtefactJudgement:
    """One artefact, measured by both and compared with its true shape."""

    item: str
    bench: Comparison
    twin: Comparison
    bench_cloud: Cloud
    twin_cloud: Cloud

    @property
    def bench_um(self) -> float:
        """The bench's symmetric mean distance between points and surface."""
        return _surface(self.bench)

    @property
    def twin_um(self) -> float:
        return _surface(self.twin)

    @property
    def delta_um(self) -> float:
        """The twin's less the bench's: negative where the twin measures better."""
        return self.twin_um - self.bench_um

    def summary(self) -> dict[str, Any]:
        return {
            "item": self.item,
            "bench_um": self.bench_um,
            "twin_um": self.twin_um,
            "delta_um": self.delta_um,
            "delta_percent": 100.0 * abs(self.delta_um) / self.bench_um,
        }


def _surface(found: Comparison) -> float:
    assert found.surface_smcd_um is not None  # every cloud of a scan lies on a pixel grid
    return found.surface_smcd_um


def judge_artefacts(
    twin: Twin,
    scans: Mapping[str, Session],
    bench_calibration: Calibration,
    twin_calibration: Calibration,
    progress: Progress = no_progress,
) -> list[ArtefactJudgement]:
    """Compare bench and twin on recorded scans by item.

    bench_calibration, twin_calibration: what each found of itself. Raises `DataError` when an item's true
    shape does not fit the bench's cloud, `ConfigError` when the twin has no such item.
    """
    found = []
    for number, (item, session) in enumerate(scans.items(), 1):
        found.append(_judged(twin, item, session, bench_calibration, twin_calibration))
        progress(number / len(scans))
    return found


def _judged(
    twin: Twin, item: str, session: Session, bench_calibration: Calibration, twin_calibration: Calibration
) -> ArtefactJudgement:
    mesh = twin.mesh(item)
    _, cloud = reconstruct(session, bench_calibration)
    stands = align_mesh(cloud.points.astype(float), mesh).transform
    own = _scanned(twin, item, session, stands, twin_calibration)
    placed = mesh.copy().apply_transform(stands.matrix)
    return ArtefactJudgement(
        item,
        compare(cloud, placed, bench_calibration, align=True),
        compare(own, placed, twin_calibration, align=True),
        cloud,
        own,
    )


def _scanned(twin: Twin, item: str, session: Session, stands: Any, calibration: Calibration) -> Cloud:
    """The twin's cloud of an item that stands there, by the session's plan and settings."""
    plan, (size, lattice) = session.plan, session.projector()
    settings = session.records[0].settings
    frames = twin.scan(item, stands, make_patterns(plan, size, lattice), settings)
    recording = Recording(frames, plan, size, settings.bits, f"the twin's {item}")
    decoded = decode(recording)
    return points_of(decoded, calibration, plan, recording.mean_image())[1]
