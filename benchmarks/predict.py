"""Twins of benches that nobody has seen: what they predict, beside what the benches then measure.

Every bench has all effects of `benchmarks.hidden`, of drawn strength. The twin is given its recordings alone:
of a card, of a board, of one part, and of a part of another surface by another plan. Then it predicts five
measurements, which the bench makes afterwards. Further benches have an effect that neither twins nor the
others have (`benchmarks.hidden.foreign`). Seeds below `JUDGING` are for development.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Self

import numpy as np

from benchmarks import Result, above, below
from benchmarks.hidden.bench import HiddenBench, hidden_bench, write_rig
from benchmarks.hidden.foreign import KINDS
from benchmarks.hidden.worlds import BOARD, MOVED, PAINTED, SHAPES, nominal_world
from benchmarks.match import truth_of
from fpplab.calibration.model import INTRINSICS, POSE, Calibration
from fpplab.cli import console
from fpplab.core.conventions import Floats
from fpplab.core.errors import FppError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.sessions.session import Session, recorded_sessions
from sim.effects.falloff import FALLOFF
from sim.effects.room_lamp import ROOM_LAMP
from sim.matching.judging.measured import measured_figures
from sim.matching.match import MatchingLimits
from sim.matching.record import MatchingEpoch
from sim.matching.run import MatchingListener, MatchingRequest, MatchingResult, match_sessions, twin_of
from sim.parameters import ADJUSTABLE, TwinParameters
from sim.prediction import MeasuredFigures, Prediction, predict
from sim.prediction.intervals import FigureInterval

JUDGING = 9422
"""First seed of the benches that judge; to be run once a method is fixed. Seeds 5000 to 5011, 5100 to 5111,
and 5200 to 5211 have been looked at since (docs/decisions/archive, records 53 to 55), and 9400 to 9421."""
SIGMAS = 3.0
MOST_POSES_UM, LEAST_PARAMETERS = 30.0, 0.95
NEAR, LEAST_NEAR = 0.10, 0.90
LEAST_COVERED, MOST_COVERED = 0.90, 0.99
FIGURES = ("distance_um", "noise_um")
CONFOUNDED = {"ambient", "white", "paper", "vignetting", *FALLOFF, *ROOM_LAMP}
"""Parameters that stand for more than the world's own: a second lamp, falloffs, or a product. The world of a
hidden bench states no falloff of the projector and no second lamp, which are another formula's."""


@dataclass(frozen=True)
class Question:
    """One measurement to be predicted."""

    name: str  # what differs from the part that the twin was given
    item: str  # of the bench
    plan: str  # plan file
    exposure: float = 1.0  # factor of the plan's exposure

    def loaded(self) -> Plan:
        """Load the plan with its exposure."""
        plan = Plan.load(self.plan)
        return plan.model_copy(update={"exposure_s": self.exposure * plan.exposure_s})


@dataclass(frozen=True)
class PredictSetup:
    """What is drawn, recorded and predicted."""

    seeds: tuple[int, ...] = tuple(range(JUDGING, JUDGING + 12))  # of the benches
    kinds: tuple[str, ...] = KINDS  # of foreign effects, on benches of the seeds that follow
    poses: int = 12  # of the board, and of the camera
    binning: int = 8  # of the board, and of the camera
    board_plan: str = "plan_board.yaml"  # plan files for the board and for the part that the twin is given
    part_plan: str = "plan_nine_images.yaml"
    other_plan: str = "plan_paper.yaml"  # plan file of the first question
    scans: int = 3  # of each question; the first judges, the others show how well the bench repeats it
    limits: MatchingLimits = field(default_factory=lambda: MatchingLimits(seconds=3600.0))  # of each matching

    @property
    def questions(self) -> tuple[Question, ...]:
        """The five measurements."""
        return (
            Question("other_plan", SHAPES[0], self.other_plan),
            Question("half_exposure", SHAPES[0], self.part_plan, 0.5),
            Question("other_pose", MOVED, self.part_plan),
            Question("other_shape", SHAPES[2], self.part_plan),
            Question("other_surface", PAINTED, self.part_plan),
        )


FULL = PredictSetup()


@dataclass(frozen=True)
class ComparedFigure:
    """A predicted figure beside what the bench then measured."""

    value: float  # predicted, with its interval of 95 %
    low: float
    high: float
    measured: float
    again: tuple[float, ...] = ()  # by the same bench in further scans, with nothing changed

    @classmethod
    def of(cls, predicted: FigureInterval, measured: Sequence[float]) -> Self:
        """Put a prediction beside the measurement, the first of several."""
        return cls(predicted.value, predicted.low, predicted.high, measured[0], tuple(measured[1:]))

    @property
    def off(self) -> float:
        """Relative error of the prediction."""
        return abs(self.value / self.measured - 1.0)

    @property
    def repeated_off(self) -> float | None:
        """Relative difference of the measurement from the mean of its repetitions."""
        return abs(float(np.mean(self.again)) / self.measured - 1.0) if self.again else None

    @property
    def is_covered(self) -> bool:
        """Whether the interval holds what was measured."""
        return self.low <= self.measured <= self.high


@dataclass(frozen=True)
class JudgedBench:
    """One hidden bench."""

    seed: int  # of the bench
    kind: str | None = None  # of its foreign effect
    refused: str | None = None  # why nothing was predicted; the rest is then empty
    verdict: str = ""  # what the matching says
    is_good: bool = False  # whether it says good
    nearer: tuple[str, ...] = ()  # steps that it took back although they were nearer to the truth
    poses_um: tuple[float, ...] = ()  # distances of the poses from the truth, relative to each other
    placed_um: tuple[float, ...] = ()  # the same in the camera's frame
    sigmas: dict[str, float] = field(default_factory=dict)  # errors over stated uncertainties, by parameter
    answers: dict[str, dict[str, ComparedFigure]] = field(default_factory=dict)  # by question and figure
    processor_s: float = 0.0  # time of the matching on all cores together

    @property
    def poses_rms_um(self) -> float:
        """RMS distance of the poses from the truth, relative to each other."""
        return _rms(np.array(self.poses_um))

    @property
    def within(self) -> float:
        """Share of the parameters that their standard uncertainty covers."""
        return float(np.mean(np.abs(list(self.sigmas.values())) <= SIGMAS))

    @property
    def is_believed_wrong(self) -> bool:
        """Whether the matching says good of a twin that is not."""
        return self.is_good and (self.poses_rms_um > MOST_POSES_UM or self.within < LEAST_PARAMETERS)


def judged(seed: int, folder: Path, trial: PredictSetup = FULL, kind: str | None = None) -> JudgedBench:
    """Record a hidden bench, match a twin to it, predict, measure and compare."""
    with hidden_bench(seed, folder / "bench", trial.poses, trial.binning, kind) as bench:
        console.log_status(f"Recording hidden bench {seed}")
        plan = Plan.load(trial.board_plan)
        response = bench.response(plan.exposure_s)
        sessions = bench.board(plan, folder / "board")
        part = bench.record(Plan.load(trial.part_plan), folder / "part", SHAPES[0])
        painted = bench.record(Plan.load(trial.other_plan), folder / "painted", PAINTED)
        calibration = bench.calibration_of_board(plan.images)
        truth = replace(truth_of(bench.rig, bench.world), calibration=calibration)
        write_rig(nominal_world(bench.world), folder / "nominal", "Nominal twin")
        begun = time.process_time()
        try:
            found = matched(folder, trial, sessions, {SHAPES[0]: part}, {PAINTED: painted}, response)
            processor_s = time.process_time() - begun
            predicted = predictions(folder / "matched" / "rig.yaml", trial.questions)
        except FppError as error:
            console.log_status(f"{seed}: {error}")
            return JudgedBench(seed, kind, str(error))
        known = found.reference.characterisation.calibration
        answers = {}
        for one in trial.questions:
            figures_of = predicted[one.name].figures
            measured = [_measured(bench, one, folder / f"measured_{k}", known) for k in range(trial.scans)]
            answers[one.name] = {
                figure: ComparedFigure.of(figures_of[figure], [getattr(scan, figure) for scan in measured])
                for figure in FIGURES
            }
    parameters = found.matched.parameters
    apart = [a.translation - b.translation for a, b in zip(parameters.poses, truth.poses, strict=True)]
    return JudgedBench(
        seed=seed,
        kind=kind,
        verdict=found.diagnosis.sentence,
        is_good=found.diagnosis.is_good,
        nearer=tuple(steps_nearer_than_kept(found.matched.epochs, truth)),
        poses_um=tuple(poses_off_um(parameters.poses, truth.poses).tolist()),
        placed_um=tuple((1e3 * np.linalg.norm(apart, axis=1)).tolist()),
        sigmas=errors_in_sigmas(parameters, truth),
        answers=answers,
        processor_s=processor_s,
    )


def steps_nearer_than_kept(epochs: Sequence[MatchingEpoch], truth: TwinParameters) -> Iterator[str]:
    """Name the steps taken back that were nearer to the truth by more than their own uncertainty."""
    kept = epochs[0].parameters.parameters()
    for epoch in epochs[1:]:
        tried = epoch.parameters.parameters()
        if epoch.accepted:
            kept = tried
            continue
        before, after = (errors_in_sigmas(replace(one, sigma=tried.sigma), truth) for one in (kept, tried))
        changed = [name for name in before if before[name] != after[name]]
        gained = _size(before[name] for name in changed) - _size(after[name] for name in changed)
        was, is_now = (_rms(poses_off_um(one.poses, truth.poses)) for one in (kept, tried))
        if gained > 1.0 or was - is_now > tried.sigma.get("poses_um", np.inf):
            yield f"{epoch.step}: {gained:.1f} σ, poses {was - is_now:.1f} µm"


def _size(errors: Iterable[float]) -> float:
    return float(np.linalg.norm(list(errors)))


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))


def matched(
    folder: Path,
    trial: PredictSetup,
    sessions: Sequence[Session],
    scans: Mapping[str, Session],
    surfaces: Mapping[str, Session],
    response: Response,
) -> MatchingResult:
    """Match the nominal twin to recordings."""
    wanted = MatchingRequest(response=response, scans=scans, surfaces=surfaces, limits=trial.limits)
    with Rig.load(folder / "nominal" / "rig.yaml") as rig, console.progress("Matching") as report:
        twin = twin_of(rig, BOARD)
        ordered = recorded_sessions([session.path for session in sessions])
        return match_sessions(
            twin, ordered, twin.target, folder / "matched", wanted, MatchingListener(report)
        )


def predictions(rig: Path, questions: Sequence[Question]) -> dict[str, Prediction]:
    """Answer questions by a twin."""
    with Rig.load(rig) as twin:
        return {one.name: predict(twin, one.loaded(), one.item) for one in questions}


def _measured(bench: HiddenBench, one: Question, folder: Path, known: Calibration) -> MeasuredFigures:
    session = bench.record(one.loaded(), folder / one.name, one.item)
    assert isinstance(bench.rig.simulation, Predictable)
    return measured_figures(session, known, bench.rig.simulation.image_part_sampler().mesh(one.item))


def poses_off_um(found: Sequence[RigidTransform], true: Sequence[RigidTransform]) -> Floats:
    """Compare poses with the truth relative to each other."""
    # returns (P,) µm
    here, there = (np.array([pose.translation for pose in poses]) for poses in (found, true))
    a, b = here - here.mean(axis=0), there - there.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray(1e3 * np.linalg.norm(a @ left @ mirror @ right - b, axis=1))


def errors_in_sigmas(found: TwinParameters, truth: TwinParameters) -> dict[str, float]:
    """Compare parameters with the truth, in units of their own standard uncertainty.

    Images know the print only relative to its ground, so `ink` is compared as a share of `paper`.
    """
    errors = {
        name: _error_of(name, found, truth) / found.sigma[name]
        for name in ADJUSTABLE
        if found.sigma.get(name, 0.0) > 0 and name not in CONFOUNDED
    }
    if "ink" in errors:
        as_seen = found.paper * truth.ink / truth.paper
        errors["ink"] = (found.ink - as_seen) / found.sigma["ink"]
    for name, sigma in (found.calibration.uncertainty.sigma if found.calibration.uncertainty else {}).items():
        here, there = (_parameter(one.calibration, name) for one in (found, truth))
        errors[name] = (here - there) / sigma
    return errors


def _error_of(name: str, found: TwinParameters, truth: TwinParameters) -> float:
    if None in (getattr(found, name, 0.0), getattr(truth, name, 0.0)):
        return np.inf  # a lens that one of them takes for sharp at all distances
    read = ADJUSTABLE[name].read
    return read(found) - read(truth)


def _parameter(calibration: Calibration, name: str) -> float:
    device, _, term = name.partition(".")
    if device == "T_projector_camera":
        T = calibration.T_projector_camera
        return float(np.concatenate([T.rotation_vector, T.translation])[POSE.index(term)])
    model = getattr(calibration, device)
    (fx, _, cx), (_, fy, cy) = model.matrix[:2]
    return float(np.array([fx, fy, cx, cy, *model.distortion])[INTRINSICS.index(term)])


def figures(benches: Sequence[JudgedBench], prefix: str) -> list[Result]:
    """Sum up hidden benches."""
    kept = [one for one in benches if one.refused is None]
    wrong, nearer = sum(one.is_believed_wrong for one in kept), sum(len(one.nearer) for one in kept)
    results = [
        below(f"{prefix}_refused", len(benches) - len(kept), "benches", 0.0),
        below(f"{prefix}_believed_wrong", wrong, "benches", 0.0),
        below(f"{prefix}_refused_steps_nearer", nearer, "steps", 0.0),
    ]
    if not kept:
        return results
    sigmas = np.array([off for one in kept for off in one.sigmas.values()])
    within = float(np.mean(np.abs(sigmas) <= SIGMAS))
    poses = max(one.poses_rms_um for one in kept)
    results += [
        below(f"{prefix}_poses", poses, "µm", MOST_POSES_UM),
        above(f"{prefix}_parameters_within_3_sigma", within, "share", LEAST_PARAMETERS),
    ]
    for figure in FIGURES:
        off = [answer[figure].off for one in kept for answer in one.answers.values()]
        near = float(np.mean(np.array(off) <= NEAR))
        results.append(above(f"{prefix}_{figure}_within_10_percent", near, "share", LEAST_NEAR))
        repeated = [answer[figure].repeated_off for one in kept for answer in one.answers.values()]
        if known := [each for each in repeated if each is not None]:
            share = float(np.mean(np.array(known) <= NEAR))
            name = f"{prefix}_{figure}_repeated_within_10_percent"
            results.append(above(name, share, "share", LEAST_NEAR))
    for question in kept[0].answers:
        off = [each.off for one in kept for each in one.answers[question].values()]
        results.append(below(f"{prefix}_{question}_off", float(np.median(off)), "relative", NEAR))
    every = [each for one in kept for answer in one.answers.values() for each in answer.values()]
    covered = float(np.mean([each.is_covered for each in every]))
    results += [
        above(f"{prefix}_intervals_cover", covered, "share", LEAST_COVERED),
        below(f"{prefix}_intervals_are_not_too_wide", covered, "share", MOST_COVERED),
    ]
    return results
