"""What `fpplab match` does: match a twin to a bench, or surfaces of parts on a twin that is matched."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.extras import need_extra
from fpplab.core.session_names import REPORT
from fpplab.devices.rig import Rig
from fpplab.diagnosis import FaultCause
from fpplab.results.provenance import Provenance
from fpplab.sessions.session import Session
from fpplab.targets import Target
from fpplab.workflows.pose_causes import with_causes
from fpplab.workflows.stopwatch import Stopwatch
from sim.matching.observer import MatchObserver
from sim.matching.page import matching_provenance, write_matching_report
from sim.matching.parts import match_parts
from sim.matching.record import EPOCHS, MatchingEpoch
from sim.matching.reference import Reference
from sim.matching.refusal import Refusals
from sim.matching.run import MatchingListener, MatchingRequest, MatchingResult, match_sessions, twin_of
from sim.matching.scene.surface import SurfaceMatch
from sim.twin import Twin

RIG = "rig.yaml"  # the matched twin, in the folder of a matching that was not refused


@dataclass(frozen=True, eq=False)
class MatchRequest:
    """Which twin is matched to which recordings, and where the matched twin goes."""

    twin: Rig  # the nominal twin, not open
    sessions: Sequence[Session]  # the bench's, of a board
    out: Path  # an unfinished matching in it is continued
    matching: MatchingRequest  # what to match, and how
    target: Target | None = None  # the board; the twin's own by default
    force: bool = False  # whether a matching that is there is replaced


@dataclass(frozen=True, eq=False)
class MatchResult:
    """A matching, and the files that it left."""

    matching: MatchingResult
    provenance: Mapping[str, Provenance]  # of the recordings, by what was recorded
    seconds: float
    rig_file: Path | None  # the matched twin; None where it must not be used
    report_file: Path

    def summary(self) -> dict[str, Any]:
        return {
            **self.matching.summary(),
            "seconds": self.seconds,
            "provenance": {name: source.summary() for name, source in self.provenance.items()},
            "rig": None if self.rig_file is None else str(self.rig_file),
            "report": str(self.report_file),
        }


@dataclass(frozen=True, eq=False)
class SurfacesRequest:
    """On which matched twin surfaces of parts are matched, and to which scans."""

    twin: Rig  # matched to its board before, not open
    scans: Mapping[str, Session]  # the bench's scans by part, as the twin's world calls it
    out: Path
    board: str = "board"  # what the twin's fixture calls the board
    accepted: frozenset[FaultCause] = frozenset()  # causes for which nothing is refused
    force: bool = False  # whether a folder that is not empty is used


@dataclass(frozen=True, eq=False)
class SurfacesResult:
    """Surfaces of parts, and the twin that has them."""

    surfaces: Sequence[SurfaceMatch]
    notes: Sequence[str]  # of the rig file: what was accepted, earlier or now
    seconds: float
    rig_file: Path

    def summary(self) -> dict[str, Any]:
        return {
            "surfaces": [surface.summary() for surface in self.surfaces],
            "notes": list(self.notes),
            "seconds": self.seconds,
            "rig": str(self.rig_file),
        }


def match(request: MatchRequest, observer: MatchObserver | None = None) -> MatchResult:
    """Match a twin to the bench's recordings, and leave it with its report in the request's folder."""
    follow, stopwatch = observer or MatchObserver(), Stopwatch()
    check_match_output(request)
    if request.force:
        for name in (EPOCHS, REPORT, RIG):
            (request.out / name).unlink(missing_ok=True)
    with request.twin as rig:
        twin = twin_of(rig, request.matching.board)
        matching = _match(request, twin, follow)
        result = MatchResult(
            matching=matching,
            provenance=matching_provenance(matching, {**request.matching.scans, **request.matching.surfaces}),
            seconds=stopwatch.seconds,
            rig_file=None if matching.diagnosis.is_useless else request.out / RIG,
            report_file=request.out / REPORT,
        )
        with follow.stage("Drawing the report"):
            filtered = matching.reference.filtered(twin)
            write_matching_report(result.report_file, matching, filtered, result.summary(), result.provenance)
    return result


def _match(request: MatchRequest, twin: Twin, observer: MatchObserver) -> MatchingResult:
    references: list[Reference] = []

    def observe(epoch: MatchingEpoch) -> None:
        filtered = references[0].filtered(twin)
        observer.epoch(epoch, references[0], filtered.with_parameters(epoch.parameters.parameters()))

    try:
        with observer.work("Matching") as (progress, tell):
            return match_sessions(
                twin,
                request.sessions,
                request.target or twin.target,
                request.out,
                request.matching,
                MatchingListener(progress, observe, tell, references.append),
            )
    except CalibrationError as error:
        raise with_causes(error, request.sessions, observer) from error


def check_match_output(request: MatchRequest) -> None:
    """Refuse to overwrite a finished matching; an unfinished or refused one is continued."""
    out = request.out
    finished = (out / RIG).is_file() and (out / REPORT).is_file()  # which is last
    if finished and not request.force:
        raise ConfigError(f"{out}: exists already; name another output, or add --force to replace it")
    if out.exists() and not (out / EPOCHS).is_file() and any(out.iterdir()):
        raise ConfigError(f"{out}: exists and holds no matching; name another output")
    need_extra("skimage")


def match_surfaces_alone(request: SurfacesRequest, observer: MatchObserver | None = None) -> SurfacesResult:
    """Match surfaces of parts on a twin that was matched to its board before, and save it."""
    follow, stopwatch = observer or MatchObserver(), Stopwatch()
    if not request.scans:
        raise ConfigError("--reference: is missing; name the bench's sessions of a board, or a --surface")
    out = request.out
    if out.exists() and any(out.iterdir()) and not request.force:
        raise ConfigError(f"{out}: exists already; name another output, or add --force to replace it")
    with request.twin as rig:
        refusals, earlier = Refusals(request.accepted), rig.file.notes or ()
        with follow.work("Matching") as (progress, tell):
            surfaces = match_parts(
                twin_of(rig, request.board),
                request.scans,
                out,
                rig,
                refusals,
                earlier,
                progress=progress,
                tell=tell,
            )
    return SurfacesResult(surfaces, [*earlier, *refusals.notes], stopwatch.seconds, out / RIG)
