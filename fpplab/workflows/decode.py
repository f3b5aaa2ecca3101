"""Find the projector coordinates of every camera pixel of a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError
from fpplab.core.files import need_suffix, refuse_existing
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.diagnosis import DiagnosisLimits
    from fpplab.reconstruction.depth_range import KnownPixels
    from fpplab.results.decoding import DecodingResult


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
    from fpplab.results.decoding import DecodingResult
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
