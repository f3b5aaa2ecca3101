"""Maps of projector coordinates: those of a session, and points of maps that another program decoded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError, DataError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.files import check_new_file, need_suffix, refuse_existing
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.diagnosis import DiagnosisLimits
    from fpplab.reconstruction.depth_range import KnownPixels
    from fpplab.results.maps import DecodingResult, MapsResult


@dataclass(frozen=True)
class DecodingRequest:
    """Which session to decode, and where the maps go."""

    session: Path
    out: Path  # maps (.npz)
    as_recorded: bool = False  # whether frames that are out of step with the plan are taken as they are
    force: bool = False  # whether an existing file is replaced
    limits: DiagnosisLimits | None = None  # of an expert, by which the maps are judged
    known: KnownPixels = ()  # points of known coordinate, or height, for plans that neighbours unwrap
    reference: Path | None = None  # session of a plane, over which heights are asked for
    plane: Path | None = None  # file that says how the devices stand over it


def run_decoding(request: DecodingRequest, observer: Observer | None = None) -> DecodingResult:
    """Decode a session, judge the maps and write them; useless ones only as recorded."""
    need_suffix(request.out, ".npz")
    if (request.reference is None) != (request.plane is None):
        raise ConfigError("--reference and --plane: one is given without the other; heights need both")
    refuse_existing(request.out, request.force)

    from fpplab.diagnosis import diagnose_decoded
    from fpplab.diagnosis.limits import USUAL_LIMITS
    from fpplab.phase import decode
    from fpplab.pipeline.decoding import recording_and_fault
    from fpplab.pipeline.heights import decode_over_plane
    from fpplab.results.maps import DecodingResult
    from fpplab.sessions.session import Session

    observer, stopwatch = observer or Observer(), Stopwatch()
    with observer.stage("Decoding") as progress:
        session = Session.open(request.session)
        known = () if request.plane else request.known
        recording, fault = recording_and_fault(
            session, progress, as_recorded=request.as_recorded, known=known
        )

        def second_half(share: float) -> None:
            progress(0.5 + 0.5 * share)

        if request.reference and request.plane:
            plane = request.reference, request.plane
            decoded = decode_over_plane(recording, *plane, request.known, second_half)
        else:
            decoded = decode(recording, second_half)
        observer.maps(decoded)
        diagnosis = diagnose_decoded(recording, decoded, request.limits or USUAL_LIMITS, fault)
        result = DecodingResult(
            str(session.path), decoded, diagnosis, stopwatch.seconds, request.out, request.as_recorded
        )
        if result.is_written:
            decoded.save(request.out)
    return result


MIN_SHARE = 0.5  # of the pixels with coordinates that give a point (chosen: maps of another rig give few)


@dataclass(frozen=True, eq=False)
class MapsRequest:
    """Which maps to triangulate, and where the points go."""

    maps: Path  # as `fpplab import --phase` or `fpplab decode` writes them
    calibration: Calibration
    out: Path  # the cloud
    force: bool = False  # whether an existing file is replaced


def run_triangulation(request: MapsRequest, observer: Observer | None = None) -> MapsResult:
    """Triangulate maps and write the cloud; without frames its points are never judged good."""
    from fpplab.clouds import CLOUD_SUFFIXES, save_cloud
    from fpplab.diagnosis.maps import diagnose_without_frames
    from fpplab.phase import Decoded
    from fpplab.reconstruction.points import triangulate
    from fpplab.reconstruction.triangulation import coordinate_noise
    from fpplab.reconstruction.uncertainty import with_uncertainty
    from fpplab.results.maps import MapsResult

    check_new_file(request.out, request.force, *CLOUD_SUFFIXES)
    observer, stopwatch = observer or Observer(), Stopwatch()
    observer.calibration(request.calibration)
    with observer.stage("Triangulating") as progress:
        with naming_other_kinds(request.maps, "maps"):
            decoded = Decoded.load(request.maps).of_known_order()
        if not decoded.valid.any():
            raise DataError(f"{request.maps}: no pixel has a known fringe order; decode it with --known")
        observer.maps(decoded)
        cloud = triangulate(decoded, request.calibration)
        share = len(cloud) / max(int(decoded.valid.sum()), 1)
        if share < MIN_SHARE:
            raise DataError(
                f"{request.maps}: only {100 * share:.1f} % of the pixels with coordinates give a point in "
                "front of both devices; axis, direction or orientation of the maps is not that of the "
                "calibration, or it is of another rig"
            )
        progress(0.5)
        noise = coordinate_noise(decoded)
        cloud = with_uncertainty(cloud, request.calibration, noise, lambda done: progress(0.5 + 0.5 * done))
        result = MapsResult(decoded, cloud, diagnose_without_frames(cloud), stopwatch.seconds, request.out)
        observer.result(result)
        result.diagnosis.require_usable(str(request.maps))
        save_cloud(cloud, request.out)
    return result
