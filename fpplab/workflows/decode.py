"""Find the projector coordinates of every camera pixel of a session."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import DataError
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.results.decoding import DecodingResult


@dataclass(frozen=True)
class DecodingRequest:
    """Which session to decode, and where the maps go."""

    session: Path
    out: Path  # maps (.npz)
    as_recorded: bool = False  # whether frames that are out of step with the plan are taken as they are
    force: bool = False  # whether an existing file is replaced


def run_decoding(request: DecodingRequest, observer: Observer | None = None) -> DecodingResult:
    """Decode a session and write its maps.

    Parameters
    ----------
    request : DecodingRequest
        The session.
    observer : Observer, optional
        Shown progress and the maps.

    Returns
    -------
    DecodingResult
        The maps.

    Raises
    ------
    ConfigError
        The output exists.
    DataError
        Frames are missing, damaged or out of step with the plan, or no pixel could be measured.
    """
    from fpplab.core.files import need_suffix, refuse_existing

    need_suffix(request.out, ".npz")
    refuse_existing(request.out, request.force)

    from fpplab.pipeline import decode_session
    from fpplab.results.decoding import DecodingResult
    from fpplab.sessions.session import Session

    observer, stopwatch = observer or Observer(), Stopwatch()
    with observer.stage("Decoding") as progress:
        session = Session.open(request.session)
        decoded = decode_session(session, progress, as_recorded=request.as_recorded)
        if not decoded.valid.any():
            raise DataError(
                f"{request.session}: no pixel could be measured; see that the fringes reach the object, "
                "and that they are neither faint nor saturated"
            )
        observer.maps(decoded)
        decoded.save(request.out)
    return DecodingResult(decoded, stopwatch.seconds)
