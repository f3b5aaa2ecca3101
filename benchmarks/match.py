"""A twin matched to a hidden bench, each figure beside its target; the matching does not know the truth.

The hidden bench is a virtual one with a world of its own. What it records of a card, of a board and of the
artefacts is all that the nominal twin is given. The matching is made once from the bench's own
characterisation and once from a start that is off. Then come twins that cannot become the bench: each must be
refused, and why is said on the way.
"""

import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import fmean

import numpy as np

from benchmarks import Result, below
from benchmarks.virtual import virtual_bench
from fpplab.cli import console
from fpplab.core import config
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.files import write_text
from fpplab.core.geometry import RigidTransform
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.pipeline.response import measure_response
from fpplab.pipeline.taking import take_or_resume_session, take_poses
from fpplab.sessions.session import Session, recorded_sessions
from fpplab.targets import Target
from sim.matching.match import MatchingLimits
from sim.matching.run import MatchingListener, MatchingRequest, MatchingResult, match_sessions, twin_of
from sim.parameters import TwinParameters, white_level_per_s
from sim.twin import Twin
from sim.world import World

BOARD, CARD = "board", "grey_card"
RESPONSE, SCANS, REFOCUSED = "response.yaml", "scans", "refocused"
"""Names in the folder of a recording, beside `BOARD`."""
FEW, MOVED = 6, 2
"""Poses that a wrong twin is matched to, and how many of them were taken after the focus moved."""
OFF_MM, OFF_DEG = 2.0, 1.0
SCALE = 1.2

MOST_UNLIKE = {"board": 0.05, "whole": 0.10}
MOST_LOSS = {"board": 0.045, "whole": 0.085}
MOST_EPSILON_PX, MOST_EPOCHS, MOST_SECONDS = 0.002, 25, 900.0
MOST_POSITION_UM, MOST_ANGLE_DEG, MOST_BASELINE_UM, MOST_LIGHT_PERCENT = 20.0, 0.02, 50.0, 1.0
MOST_DELTA_UM, MOST_DELTA_PERCENT = 3.0, 10.0


@dataclass(frozen=True)
class MatchBenchmarkSetup:
    """What is recorded and matched.

    The hidden bench is a simulated laboratory rig whose file the matching never reads.
    """

    hidden: str = "rig_hidden.yaml"  # rig files of the hidden bench and of the twin
    twin: str = "rig_twin.yaml"  # rig files of the hidden bench and of the twin
    board_plan: str = "plan_board.yaml"  # plan files for the board and for the artefacts
    scan_plan: str = "plan_paper.yaml"  # plan files for the board and for the artefacts
    poses: int = 20  # how many of the board
    artefacts: tuple[str, ...] = ("pyramid", "pillars", "steps")  # which are scanned
    limits: MatchingLimits = field(default_factory=MatchingLimits)  # of epochs and time
    focus_moved_mm: float = 40.0  # how far the focus is moved for recordings that no twin can match, in mm

    @property
    def few(self) -> int:
        """Poses that a wrong twin is matched to; the last `MOVED` of them are taken with both focuses."""
        return min(FEW, self.poses)


FULL = MatchBenchmarkSetup()


def run() -> list[Result]:
    """Measure matching; the baselines are the targets. It takes some hour and a half on two cores."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        record(Path(folder))
        return match_figures(Path(folder))


def record(folder: Path, trial: MatchBenchmarkSetup = FULL) -> None:
    """Record what the hidden bench sees; sessions that are complete are kept."""
    plan, scan_plan = Plan.load(trial.board_plan), Plan.load(trial.scan_plan)
    with Rig.load(trial.hidden) as rig:
        rig.need_fixture("the benchmark").mount(CARD, 0)
        with console.progress("Recording the response") as report:
            measure_response(rig, plan.exposure_s, progress=report)[0].save(folder / RESPONSE)
        with console.progress(f"Recording {trial.poses} poses of the board") as report:
            take_poses(rig, plan, BOARD, trial.poses, folder / BOARD, replace_existing=False, progress=report)
        for item in trial.artefacts:
            with console.progress(f"Recording the {item}") as report:
                out = folder / SCANS / item
                take_or_resume_session(rig, scan_plan, out, (item, 0), accept_complete=True, progress=report)
        with console.progress(f"Recording {MOVED} poses with the focus moved"):
            virtual_bench(rig).replace_world(_refocused(virtual_bench(rig).world, trial.focus_moved_mm))
            for pose in range(trial.few - MOVED, trial.few):
                out = folder / REFOCUSED / f"pose_{pose:02d}"
                take_or_resume_session(rig, plan, out, (BOARD, pose), accept_complete=True)


def _refocused(world: World, further_mm: float) -> World:
    focus = world.camera.focus_mm
    assert focus is not None
    camera = world.camera.model_copy(update={"focus_mm": focus + further_mm})
    return world.model_copy(update={"camera": camera})


def match_figures(folder: Path, trial: MatchBenchmarkSetup = FULL) -> list[Result]:
    """Match twins to a recording and compare them with the truth."""
    sessions = recorded_sessions([folder / BOARD])
    response = Response.load(folder / RESPONSE)
    scans = {item: Session.open(folder / SCANS / item) for item in trial.artefacts}
    plain = MatchingRequest(board=BOARD, card=CARD, response=response, limits=trial.limits)
    results = []
    with Rig.load(trial.hidden) as bench, Rig.load(trial.twin) as rig:
        truth = truth_of(bench, virtual_bench(rig).world)
        for name, wanted in (
            ("match", replace(plain, scans=scans)),
            ("match_perturbed", replace(plain, start=perturbed)),
        ):
            begin = time.perf_counter()
            found = _matched(twin_of(rig, BOARD), sessions, folder / name, wanted)
            results += _convergence(name, found, time.perf_counter() - begin)
            results += errors(name, found.matched.parameters, _seen_in(found.reference.sessions, truth))
            if wanted.scans:
                results += _artefact_figures(name, found)
        results += _refusals(rig, sessions, folder / "wrong", plain)
    return results


def _matched(twin: Twin, sessions: Sequence[Session], out: Path, wanted: MatchingRequest) -> MatchingResult:
    shutil.rmtree(out, ignore_errors=True)  # an earlier matching would go on
    with console.progress(f"Matching {out.name}") as report:
        return match_sessions(twin, sessions, twin.target, out, wanted, MatchingListener(report))


def truth_of(bench: Rig, nominal: World) -> TwinParameters:
    """Give what a matching ought to find of an open virtual bench."""
    known = twin_of(bench, BOARD).parameters
    return replace(known, white=white_level_per_s(virtual_bench(bench).world) / white_level_per_s(nominal))


def _seen_in(sessions: Sequence[Session], truth: TwinParameters) -> TwinParameters:
    """The truth with only the poses of the sessions, in their order."""
    return replace(truth, poses=tuple(truth.poses[_mounted(session)] for session in sessions))


def _mounted(session: Session) -> int:
    rig = session.rig()
    assert rig is not None
    return int(rig["resolved"]["mounted"]["pose"])


def perturbed(parameters: TwinParameters) -> TwinParameters:
    """Move every pose of the board and the projector by `OFF_MM` and `OFF_DEG`, each to another side."""
    random = np.random.default_rng(0)

    def off(pose: RigidTransform) -> RigidTransform:
        turn, shift = (one / np.linalg.norm(one) for one in random.standard_normal((2, 3)))
        turned = RigidTransform.from_vectors(np.radians(OFF_DEG) * turn, np.zeros(3)).rotation @ pose.rotation
        return RigidTransform(turned, pose.translation + OFF_MM * shift)

    known = parameters.calibration
    calibration = replace(known, T_projector_camera=off(known.T_projector_camera))
    return replace(parameters, calibration=calibration, poses=tuple(off(pose) for pose in parameters.poses))


def _convergence(name: str, found: MatchingResult, seconds: float) -> list[Result]:
    """How alike bench and twin became, and what it took: from recorded sessions to everything saved."""
    loss = found.final.loss
    ssim = {"board": loss.similarity.board.mean(), "whole": loss.similarity.whole.mean()}
    return [
        *(below(f"{name}_unlike_{of}", float(1 - ssim[of]), "1 - SSIM", most)
          for of, most in MOST_UNLIKE.items()),
        *(below(f"{name}_loss_{of}", getattr(loss, of), "L", most) for of, most in MOST_LOSS.items()),
        below(f"{name}_epsilon_d", abs(loss.rms_difference_px), "px", MOST_EPSILON_PX),
        below(f"{name}_epochs", len(found.matched.epochs) - 1, "epochs", MOST_EPOCHS),
        below(f"{name}_seconds", seconds, "s", MOST_SECONDS),
    ]  # fmt: skip


def errors(name: str, found: TwinParameters, truth: TwinParameters) -> list[Result]:
    """Compare what was found with the truth, pose by pose."""
    pairs = list(zip(found.poses, truth.poses, strict=True))
    away = max(float(np.linalg.norm(a.translation - b.translation)) for a, b in pairs)
    turned = max(float(np.linalg.norm((a @ b.inverse()).rotation_vector)) for a, b in pairs)
    baseline = found.calibration.baseline_mm - truth.calibration.baseline_mm
    light = {
        "gamma": found.response.g / truth.response.g,
        "black": found.response.b / truth.response.b,
        "white": found.white * found.paper / (truth.white * truth.paper),
    }
    return [
        below(f"{name}_pose_position", 1e3 * away, "µm", MOST_POSITION_UM),
        below(f"{name}_pose_angle", np.degrees(turned), "°", MOST_ANGLE_DEG),
        below(f"{name}_baseline", 1e3 * abs(baseline), "µm", MOST_BASELINE_UM),
        *(below(f"{name}_{of}", 100 * abs(share - 1), "%", MOST_LIGHT_PERCENT)
          for of, share in light.items()),
    ]  # fmt: skip


def _artefact_figures(name: str, found: MatchingResult) -> list[Result]:
    """How differently bench and twin measure the artefacts, on average."""
    judged = [one.summary() for one in found.artefacts]
    um = fmean(abs(one["delta_um"]) for one in judged)
    percent = fmean(one["delta_percent"] for one in judged)
    return [
        below(f"{name}_delta_smcd", um, "µm", MOST_DELTA_UM),
        below(f"{name}_delta_smcd_share", percent, "%", MOST_DELTA_PERCENT),
    ]


def _refusals(rig: Rig, sessions: Sequence[Session], folder: Path, wanted: MatchingRequest) -> list[Result]:
    """Twins that are not the bench's, and benches that are none."""
    world, few = virtual_bench(rig).world, sessions[:FEW]
    board = twin_of(rig, BOARD).target
    folder.mkdir(parents=True, exist_ok=True)
    cases = {
        "other_board": (_with_board(world, _recounted(board), folder), few),
        "board_of_other_pitch": (_with_board(world, _scaled(board), folder), few),
        "mirrored": (world, [_mirrored(session, folder / "seen_mirrored") for session in few]),
        "other_camera": (world.binned(4 if world.camera.binning == 8 else 8), few),
        "moved_focus": (world, [*few[:-MOVED], *recorded_sessions([folder.parent / REFOCUSED])]),
    }
    return [
        _refusal(name, Twin.of(nominal, BOARD, virtual_bench(rig).blender), seen, folder / name, wanted)
        for name, (nominal, seen) in cases.items()
    ]


def _refusal(
    name: str, twin: Twin, sessions: Sequence[Session], out: Path, wanted: MatchingRequest
) -> Result:
    """1 if it was refused."""
    refused = 0.0
    try:
        found = _matched(twin, sessions, out, wanted)
        refused = float(found.diagnosis.is_useless)
        console.log_status(f"{name}: {found.diagnosis.sentence}")
    except (CalibrationError, ConfigError) as error:
        refused = 1.0
        console.log_status(f"{name}: {error}")
    return Result(f"match_refuses_{name}", refused, "refused", 1.0, refused)


def _with_board(world: World, target: Target, folder: Path) -> World:
    """The world with something else printed on its board; the target file is left in `folder`."""
    path = folder / f"target_{'_'.join(map(str, target.counts))}_{target.spacing_mm[0]:g}.yaml"
    write_text(path, config.dump(target))
    board = world.item(BOARD).model_copy(update={"target": str(path)})
    return world.model_copy(update={"items": {**world.items, BOARD: board}})


def _recounted(target: Target) -> Target:
    """A board with two columns of points fewer."""
    return target.model_copy(update={"counts": (target.counts[0] - 2, target.counts[1])})


def _scaled(target: Target) -> Target:
    """The same board larger: its pictures tell nothing but the scale of the whole bench."""
    assert target.diameter_mm is not None
    lengths = {name: tuple(SCALE * mm for mm in getattr(target, name)) for name in ("size_mm", "spacing_mm")}
    return target.model_copy(update={**lengths, "diameter_mm": SCALE * target.diameter_mm})


def _mirrored(session: Session, folder: Path) -> Session:
    """What a camera records over a mirror.

    A mirrored print would be no fault: the board of staggered circles is its own mirror image.
    """
    copy = Session.create(folder / session.path.name, session.plan, session.rig(), force=True)
    for record in session.records:
        image = np.ascontiguousarray(session.read(record.index)[:, ::-1])
        copy.write(Frame(image, record.index, record.settings, record.host_time_s, pattern_id=record.pattern))
    return copy
