"""Surfaces of parts, matched to scans together with a board, or on a twin that is matched already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from fpplab.calibration.model import Calibration
from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.matching import plausibility
from fpplab.matching.artefacts import BenchScan, fit_scan
from fpplab.matching.refusal import Refusals
from fpplab.matching.surface import SurfaceMatch, match_surface, with_surfaces
from fpplab.prediction import Discrepancy
from fpplab.sessions.session import Session
from fpplab.simulation.matchable import Twin


def check_scans(twin: Twin, scans: Mapping[str, Session]) -> None:
    """Refuse what can be told of scans before any work.

    Parameters
    ----------
    twin : Twin
        Whose world has the parts.
    scans : mapping of str to Session
        By part.

    Raises
    ------
    ConfigError
        The twin has no such part, or another camera or projector than the bench.
    """
    for item, session in scans.items():
        twin.mesh(item)
        plausibility.check_devices(twin, session)


def fit_scans(
    twin: Twin, scans: Mapping[str, Session], calibration: Calibration, refusals: Refusals
) -> list[BenchScan]:
    """Find how parts stood in their scans.

    Parameters
    ----------
    twin : Twin
        Whose world has the parts.
    scans : mapping of str to Session
        By part.
    calibration : Calibration
        Of the bench.
    refusals : Refusals
        Refuse, or note what is accepted.

    Returns
    -------
    list of BenchScan
        In the order of `scans`.

    Raises
    ------
    CalibrationError, DataError
        A scan is not of the part, see `fit_scan`.
    """
    return [fit_scan(twin, item, session, calibration, refusals) for item, session in scans.items()]


def match_surfaces(twin: Twin, scans: Sequence[BenchScan], tell: Say = ignore) -> list[SurfaceMatch]:
    """Match the surfaces of parts. The twin is left with them.

    Parameters
    ----------
    twin : Twin
        Matched to the bench by its board.
    scans : sequence of BenchScan
        One for each part.
    tell : callable
        Given a few words on what is done.

    Returns
    -------
    list of SurfaceMatch
        In the order of `scans`.

    Raises
    ------
    DataError
        A scan shows too little of its part.
    """
    found = []
    for scan in scans:
        tell(f"matching the surface of the {scan.item}")
        found.append(match_surface(twin, scan))
    twin.become(with_surfaces(twin.parameters, found))
    return found


def match_parts(
    twin: Twin,
    scans: Mapping[str, Session],
    folder: Path,
    rig: Path,
    refusals: Refusals,
    notes: Sequence[str] = (),
    *,
    progress: Progress = no_progress,
    tell: Say = ignore,
) -> list[SurfaceMatch]:
    """Match the surfaces of parts on a twin that was matched before, and save it.

    What bench and twin differed by on the board and in earlier scans stays what it was.

    Parameters
    ----------
    twin : Twin
        Of the matched rig.
    scans : mapping of str to Session
        The bench's scans by part.
    folder : Path
        Gets `rig.yaml`, `world.yaml`, `calibration.yaml` and `discrepancy.yaml`.
    rig : Path
        The rig file of the matched twin.
    refusals : Refusals
        Refuse, or note what is accepted.
    notes : sequence of str
        Of the rig file, which the new one keeps.
    progress : Progress
        Told the share that is done.
    tell : callable
        Given a few words on what is done.

    Returns
    -------
    list of SurfaceMatch
        In the order of `scans`.

    Raises
    ------
    ConfigError
        The twin has no such part, or another camera or projector than the bench.
    CalibrationError, DataError
        A scan is not of the part, or shows too little of it.
    """
    check_scans(twin, scans)
    tell("comparing the scans with the parts' shapes")
    fitted = fit_scans(twin, scans, twin.parameters.calibration, refusals)
    progress(0.3)
    found = match_surfaces(twin, fitted, tell)
    progress(0.9)
    known = Discrepancy.beside(rig)
    if known is not None:
        known.save(folder)
    twin.save(folder, [*notes, *refusals.notes])
    return found
