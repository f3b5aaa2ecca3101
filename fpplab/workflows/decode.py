"""Find the projector coordinates of every camera pixel of a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

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
    known: KnownPixels = ()  # points whose coordinate is known, for plans that neighbours unwrap


def run_decoding(request: DecodingRequest, observer: Observer | None = None) -> DecodingResult:
    """Decode a session, judge the maps and write them; useless ones only as recorded."""
    from fpplab.core.files import need_suffix, refuse_existing

    need_suffix(request.out, ".npz")
    refuse_existing(request.out, request.force)

    from fpplab.diagnosis import diagnose_decoded
    from fpplab.diagnosis.limits import USUAL_LIMITS
    from fpplab.phase import decode
    from fpplab.pipeline import recording_and_fault
    from fpplab.results.decoding import DecodingResult
    from fpplab.sessions.session import Session

    observer, stopwatch = observer or Observer(), Stopwatch()
    with observer.stage("Decoding") as progress:
        session = Session.open(request.session)
        recording, fault = recording_and_fault(
            session, progress, as_recorded=request.as_recorded, known=request.known
        )
        decoded = decode(recording, lambda share: progress(0.5 + 0.5 * share))
        observer.maps(decoded)
        diagnosis = diagnose_decoded(recording, decoded, request.limits or USUAL_LIMITS, fault)
        result = DecodingResult(
            str(session.path), decoded, diagnosis, stopwatch.seconds, request.out, request.as_recorded
        )
        if result.is_written:
            decoded.save(request.out)
    return result
