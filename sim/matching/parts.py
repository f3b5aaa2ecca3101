"""Surfaces of parts, matched to scans together with a board, or on a twin that is matched already."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from fpplab.calibration.model import Calibration
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.devices.rig import Rig
from fpplab.sessions.session import Session
from sim.matching.judging import plausibility
from sim.matching.refusal import Refusals
from sim.matching.scene.artefacts import BenchScan, fit_scan
from sim.matching.scene.surface import SurfaceMatch, match_surface, with_surfaces
from sim.prediction import Discrepancy
from sim.twin import Twin


def check_scans(twin: Twin, scans: Mapping[str, Session]) -> None:
    """Refuse scans of other devices or of items without a mesh before any work."""
    known = twin.parameters.calibration
    for item, session in scans.items():
        twin.mesh(item)
        plausibility.check_devices(known.camera.size, known.projector, session)


def fit_scans(
    twin: Twin, scans: Mapping[str, Session], calibration: Calibration, refusals: Refusals
) -> list[BenchScan]:
    return [fit_scan(twin, item, session, calibration, refusals) for item, session in scans.items()]


def match_surfaces(twin: Twin, scans: Sequence[BenchScan], tell: Say = ignore) -> list[SurfaceMatch]:
    matches = []
    for scan in scans:
        tell(f"matching the surface of the {scan.item}")
        matches.append(match_surface(twin, scan))
    return matches


def match_parts(
    twin: Twin,
    scans: Mapping[str, Session],
    folder: Path,
    rig: Rig,
    refusals: Refusals,
    notes: Sequence[str] = (),
    *,
    progress: Progress = no_progress,
    tell: Say = ignore,
) -> list[SurfaceMatch]:
    """Match the surfaces of parts on a twin that was matched before, and save it."""
    # What bench and twin differed by on the board and in earlier scans stays what it was, and so do the
    # settings of the rig's camera.
    check_scans(twin, scans)
    own = twin.world.camera.bayer and twin.world.camera.bayer.pattern
    for session in scans.values():
        if session.bayer != own:
            raise ConfigError(
                f"{session.path}: the bench's camera has the filter {session.bayer or 'none'}, the twin's "
                f"{own or 'none'}; name the twin that was matched to this bench"
            )
    tell("comparing the scans with the parts' shapes")
    fitted = fit_scans(twin, scans, twin.parameters.calibration, refusals)
    progress(0.3)
    matches = match_surfaces(twin, fitted, tell)
    progress(0.9)
    discrepancy = Discrepancy.beside(Path(rig.source))
    if discrepancy is not None:
        discrepancy.save(folder)
    settings = rig.camera_settings(exposure_s=1.0)  # which a rig file does not hold
    matched = twin.with_parameters(with_surfaces(twin.parameters, matches))
    matched.save(folder, settings, [*notes, *refusals.notes])
    return matches
