"""Captures of a real rig: calibrations from fewer poses, and a twin judged by poses that were left out.

Five captures of a board by a LightCrafter 4500 and a camera, of which nobody knows the truth. The
calibration is judged by what it states: by calibrations from four poses, and by the fifth. A twin is matched
to four poses; only the board's pose is fitted to the fifth, and then its images are compared, and how far the
points of its board lie from where a calibration by the other four expects them, on the rig and in the twin.

    python -m benchmarks.real_captures FOLDER [POSE…]

keeps sessions and matched twins in a folder, and goes on with those that are there.
"""

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean

import numpy as np

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.characterisation import (
    Characterisation,
    Observation,
    characterise,
    finest_periods,
    judge,
    observe,
)
from fpplab.characterisation.judging import CalibrationAsFitted, Judgement
from fpplab.characterisation.zhang import transform
from fpplab.cli import console
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.characterising import observe_session
from fpplab.sessions.image_selection import ImageSelection
from fpplab.sessions.importing import import_images
from fpplab.sessions.session import Session
from sim.matching.evaluation import pose_similarity
from sim.matching.match import MatchingLimits
from sim.matching.reference import Reference
from sim.matching.run import MatchingListener, MatchingRequest, match_sessions, twin_of
from sim.twin import Twin

POSES = tuple(f"calseq{k}" for k in range(1, 6))
RIG, PLAN = "rig_slstudio", "plan_slstudio_board"
LIMITS = MatchingLimits(epochs=40, seconds=1e9)
RATIOS, LEAST_CHANCE, MOST_CONTRADICTED = (0.7, 1.5), 0.01, 1
LEAST_SSIM = {"board": 0.97, "whole": 0.90}
MOST_OFF, MOST_EPSILON_PX = 0.2, 0.01


_Pair = tuple[float, float]  # of camera and projector


@dataclass(frozen=True)
class LeftOutPose:
    """A pose that a twin was not matched to."""

    name: str
    ssim_whole: float
    ssim_board: float
    epsilon_d_px: float  # of the poses that the twin was matched to
    real_px: _Pair  # errors in camera and projector, on the rig
    twin_px: _Pair  # in the twin


def captures() -> Path:
    """Find the recorded captures of this computer."""
    data = Path(os.environ.get("FPPLAB_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not (data / "slstudio").is_dir():
        raise ConfigError(f"{data}: has no recorded captures; set FPPLAB_DATA to the folder that holds them")
    return data / "slstudio"


def run() -> list[Result]:
    """Judge calibration and twins by the captures. It takes an hour."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        sessions = imported_captures(Path(folder))
        return [*calibration_figures(sessions), *twin_figures(list(left_out_poses(Path(folder), sessions)))]


def imported_captures(folder: Path) -> list[Session]:
    """Import the board poses; those that are there are kept."""
    plan = Plan.load(PLAN)
    for name in POSES:
        if not (folder / name).exists():
            import_images(ImageSelection((captures() / name,), "{index:02d}.png"), plan, folder / name)
    return [Session.open(folder / name) for name in POSES]


def calibration_figures(sessions: Sequence[Session]) -> list[Result]:
    """Compare what the calibration states with calibrations from fewer poses, and with the poses left out."""
    with Rig.load(RIG) as rig:
        target = twin_of(rig, "board").target
    periods = finest_periods(sessions[0].plan, sessions[0].projector()[0])
    observations = [observe_session(session, target, periods) for session in sessions]
    (width, height, _), devices = sessions[0].format, sessions[0].projector()
    found = characterise(observations, target, (width, height), *devices)
    assert found.validation is not None
    moved = sum("as if the board had moved" in warning for warning in found.warnings)
    results = [below("real_boards_called_moved", float(moved), "", 0.0)]
    for repeat in found.validation.jackknife:
        name, ratio = f"real_jackknife_over_stated_{repeat.quantity}", repeat.changed / repeat.stated
        results += [above(name, ratio, "", RATIOS[0]), below(name, ratio, "", RATIOS[1])]
    judged = []
    for held in observations:
        others = [o for o in observations if o is not held]
        judged.append(judge(characterise(others, target, (width, height), *devices).calibration, [held]))
    contradicted = sum(min(j.camera.chance, j.projector.chance) < LEAST_CHANCE for j in judged)
    results.append(below("real_poses_contradicted", float(contradicted), "", MOST_CONTRADICTED))
    stated = [(j.camera.predicted_px, j.projector.predicted_px) for j in judged]
    return results + _predicted("stated", [_rms(j) for j in judged], stated)


def _predicted(how: str, real: Sequence[_Pair], predicted: Sequence[_Pair]) -> list[Result]:
    """Compare the errors of poses that were left out with predicted ones, in the mean square of poses."""
    off = np.sqrt(np.mean(np.square(predicted), axis=0) / np.mean(np.square(real), axis=0)) - 1.0
    return [
        below(f"real_left_out_error_{device}_{how}", abs(float(by)), "relative", MOST_OFF)
        for device, by in zip(("camera", "projector"), off, strict=True)
    ]


def left_out_poses(
    folder: Path, sessions: Sequence[Session], names: Sequence[str] = POSES
) -> Iterator[LeftOutPose]:
    """Match a twin without each pose in turn, and judge it by that pose."""
    for held in (session for session in sessions if session.path.name in names):
        console.log_status(f"Matching without {held.path.name}")
        yield _judged(folder / f"without_{held.path.name}", [s for s in sessions if s is not held], held)


def _judged(folder: Path, others: Sequence[Session], held: Session) -> LeftOutPose:
    with Rig.load(RIG) as rig:
        nominal = twin_of(rig, "board")
        request = MatchingRequest(limits=LIMITS)
        listener = MatchingListener(tell=console.log_status)
        matching = match_sessions(nominal, others, nominal.target, folder, request, listener)
    bench, own = matching.reference.characterisation, matching.final.characterisation
    assert own is not None
    reference = Reference((held,), matching.reference.target, bench)
    periods = finest_periods(held.plan, held.projector()[0])
    observed = observe_session(held, reference.target, periods)
    with Rig.load(folder / "rig.yaml") as rig:
        twin = twin_of(rig, "board")
        twin = _held(twin, _pose_in_twin(twin, bench, observed))
        whole, board = np.mean(pose_similarity(reference, twin, 0), axis=0)
        seen = _observed_in_twin(twin, reference, periods)
    real, simulated = judge(bench.calibration, [observed]), judge(own.calibration, [seen])
    return LeftOutPose(
        held.path.name,
        float(whole),
        float(board),
        matching.final.loss.rms_difference_px,
        _rms(real),
        _rms(simulated),
    )


def _rms(judgement: Judgement) -> _Pair:
    return judgement.camera.rms_px, judgement.projector.rms_px


def _pose_in_twin(twin: Twin, bench: Characterisation, observed: Observation) -> RigidTransform:
    """Fit the pose of the board to its points, with the twin's devices and the board as it is on the rig."""
    known, devices = bench.calibration, twin.parameters.calibration
    calibration: Calibration = replace(
        known,
        camera=devices.camera,
        projector=devices.projector,
        T_projector_camera=devices.T_projector_camera,
    )
    return transform(CalibrationAsFitted.of(calibration, "the twin").pose(observed))


def _held(twin: Twin, pose: RigidTransform) -> Twin:
    return twin.with_parameters(replace(twin.parameters, poses=(pose,)))


def _observed_in_twin(twin: Twin, reference: Reference, periods: tuple[float, float]) -> Observation:
    frames = twin.frames(0, reference.patterns, reference.settings)
    recording = Recording(frames, reference.plan, reference.projector[0], reference.settings.bits, "twin")
    return observe("twin", recording.mean_image(), decode(recording), reference.target, periods)


def twin_figures(poses: Sequence[LeftOutPose]) -> list[Result]:
    """Sum up."""
    return [
        above("real_ssim_board", fmean(p.ssim_board for p in poses), "", LEAST_SSIM["board"]),
        above("real_ssim_whole", fmean(p.ssim_whole for p in poses), "", LEAST_SSIM["whole"]),
        below("real_epsilon_d", max(abs(p.epsilon_d_px) for p in poses), "px", MOST_EPSILON_PX),
        *_predicted("in_twin", [p.real_px for p in poses], [p.twin_px for p in poses]),
    ]


def main(words: Sequence[str]) -> None:
    """Judge in a folder that is kept, by some poses."""
    folder = Path(words[0])
    sessions, judged = imported_captures(folder), []
    results = calibration_figures(sessions)
    for pose in left_out_poses(folder, sessions, words[1:] or POSES):
        console.stdout.print(pose)
        judged.append(pose)
    for result in [*results, *twin_figures(judged)]:
        console.stdout.print(f"{result.name:45} {result.value:8.4f} {result.baseline:8.4f} {result.unit}")


if __name__ == "__main__":
    main(sys.argv[1:])
