"""What is wrong with a rig: a marker shows how it is synchronised, and fringes what a scan's frames show."""

import math
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.acquisition.acquire import expose
from fpplab.acquisition.synchronisation import check_synchronisation, synchronisation_remedy
from fpplab.acquisition.timing import PulseTiming, planned_timing
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core import config
from fpplab.core.conventions import AXES, Image, axis_length, raw_dtype
from fpplab.core.depth import first_stated
from fpplab.core.errors import CapabilityError, ConfigError, DataError, DeviceError
from fpplab.core.progress import Progress
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Diagnosis, FaultCause, Finding, Verdict, diagnose_frames, diagnose_scan
from fpplab.diagnosis.causes.missing_colour import MISSING_COLOUR
from fpplab.diagnosis.causes.of_rig_check import OUT_OF_STEP
from fpplab.diagnosis.causes.projector_dark import PROJECTOR_DARK
from fpplab.diagnosis.causes.underexposed import UNDEREXPOSED
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.exposures import merged_recording
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.sessions.origin import SessionOrigin
from fpplab.setup.rig_check.devices import (
    DECISIVE_EXCESS,
    device_finding,
    disk_finding,
    link_finding,
    mains_finding,
    with_mains,
)
from fpplab.setup.rig_check.marker import marker
from fpplab.setup.rig_check.marker_check import UNCERTAIN_EXCESS, MarkerInspection, MarkerRun, recover_camera

UNSEEN_COLOUR = "the colour of the light, and which LED is off: a grey camera does not show them"

WITHOUT_CALIBRATION = "small_angle, wrong_axis, stale_calibration, undersampled: give --calibration"


@dataclass(frozen=True, eq=False)
class RigCheck:
    """Result of `check_rig`."""

    shown: NDArray[np.int64]  # grey levels of 255 in the order shown
    runs: tuple[MarkerRun, ...]  # the stepped run, and the triggered one where the rig can
    findings: tuple[Finding, ...]  # what is wrong, the worst first; empty when all is well
    unknown: tuple[str, ...] = ()  # what could not be checked, and why
    settle_s: float | None = None  # the settling time in s that a stepped plan needs
    timing: PulseTiming | None = None  # the plan's times on this rig; None where the devices do not accept it
    recording: Recording | None = None  # frames with fringes; None where none were taken
    decoded: Decoded | None = None  # their projector coordinates, where they were computed
    cloud: Cloud | None = None  # their points, where there is a calibration
    rig: dict[str, Any] = field(default_factory=dict)  # as `Rig.described` gave it
    origin: SessionOrigin | None = None  # when and with which devices; None where one could not be opened

    def summary(self) -> dict[str, Any]:
        return {
            "ok": not self.findings,
            "findings": [finding.summary() for finding in self.findings],
            "unverified": list(self.unknown),
            "settle_s": self.settle_s,
            "timing": asdict(self.timing) if self.timing else None,
            "shown": self.shown.tolist(),
            "seen": {
                run.how: [None if math.isnan(level) else level for level in run.levels.tolist()]
                for run in self.runs
            },
        }


def check_rig(
    rig: Rig,
    plan: Plan,
    item: str,
    progress: Progress,
    calibration: Calibration | None = None,
    folder: Path | None = None,
) -> RigCheck:
    # What a device raises is a finding too.
    marker_inspection, fringes = MarkerInspection(plan), _FringeInspection(plan, calibration)
    failed: list[Finding] = []
    described, origin, timing = config.plain(rig.file), None, None
    try:
        with rig:
            described, origin = rig.described(), SessionOrigin.of(rig)
            _require_fitting(rig, plan, calibration)
            if rig.fixture:
                rig.fixture.mount(item)
            marker_inspection.at(rig, lambda share: progress(0.4 * share))
            fringes.at(rig, marker_inspection.fringe_plan, lambda share: progress(0.4 + 0.6 * share))
            timing = _plan_timing(rig, plan)
            failed += _of_transport(rig, plan, timing, folder)
    except DeviceError as error:
        failed.append(device_finding(error))
    progress(1.0)
    of_light = tuple(marker_inspection.light)
    unknown = tuple(fringes.unknown)
    if fringes.diagnosis:
        of_light = fringes.diagnosis.findings
        unknown += fringes.diagnosis.unknown
    return RigCheck(
        shown=marker(),
        runs=tuple(marker_inspection.runs),
        findings=_rank_findings([*failed, *marker_inspection.findings, *of_light]),
        unknown=(*_causes_invisible_in_darkness(of_light), *unknown),
        settle_s=marker_inspection.settle_s,
        timing=timing,
        recording=fringes.recording,
        decoded=fringes.decoded,
        cloud=fringes.cloud,
        rig=described,
        origin=origin,
    )


def _causes_invisible_in_darkness(findings: Sequence[Finding]) -> tuple[str, ...]:
    dark = {PROJECTOR_DARK, UNDEREXPOSED, MISSING_COLOUR}
    return (UNSEEN_COLOUR,) if any(finding.cause in dark for finding in findings) else ()


def _plan_timing(rig: Rig, plan: Plan) -> PulseTiming | None:
    caps = rig.projector.caps
    patterns = make_patterns(plan, caps.size, caps.lattice)
    recover_camera(rig)
    settings = rig.camera.configure(rig.camera_settings(plan.exposure_s, plan.bits))
    try:
        rig.projector.load(patterns)
        return planned_timing(rig, plan, patterns, settings.exposure_s)
    except CapabilityError:  # the fringes have reported it
        return None


def _of_transport(rig: Rig, plan: Plan, timing: PulseTiming | None, folder: Path | None) -> list[Finding]:
    settings = rig.camera.configure(rig.camera_settings(plan.exposure_s, plan.bits))
    caps = rig.camera.caps
    period_s = timing.period_s if timing else settings.exposure_s + caps.readout_s
    width, height = caps.size
    kind = raw_dtype(settings.bits)
    findings = [link_finding(rig.camera.info(), width * height * np.dtype(kind).itemsize, period_s)]
    if folder is not None:
        noise: Image = np.random.default_rng(0).integers(0, 256, (height, width), kind)
        findings.append(disk_finding(folder, plan, noise, settings, period_s))
    return [finding for finding in findings if finding is not None]


def _rank_findings(findings: list[Finding]) -> tuple[Finding, ...]:
    first: dict[FaultCause, Finding] = {}
    for finding in sorted(findings, key=lambda finding: -finding.excess):
        first.setdefault(finding.cause, finding)
    return tuple(first.values())


def _require_fitting(rig: Rig, plan: Plan, calibration: Calibration | None) -> None:
    caps = rig.projector.caps
    plan.check_projector(caps.size, "plan")
    if calibration is not None:
        calibration.check_camera(rig.camera.caps.size, "calibration")
        calibration.check_projector(caps.size, caps.lattice, "calibration")


class _FringeInspection:
    def __init__(self, plan: Plan, calibration: Calibration | None) -> None:
        self._plan, self._calibration = plan, calibration
        self.diagnosis: Diagnosis | None = None
        self.unknown: list[str] = []
        self.recording: Recording | None = None
        self.decoded: Decoded | None = None
        self.cloud: Cloud | None = None

    def at(self, rig: Rig, plan: Plan | None, progress: Progress) -> None:
        if plan is None:
            self.unknown.append("light, focus and geometry: the frames do not show their own patterns")
            return
        for shown_plan in _with_both_axes(plan, rig.projector.caps.size) if self._calibration else (plan,):
            try:
                recording = _take_frames(rig, shown_plan, lambda share: progress(0.8 * share))
            except CapabilityError as error:
                missing = error
                continue
            self.recording = recording
            self.diagnosis = self._judge_frames(recording, rig)
            findings = with_mains(self.diagnosis.findings, mains_finding(rig, plan))
            self.diagnosis = replace(self.diagnosis, findings=findings)
            return
        self.unknown.append(f"light, focus and geometry: {missing.found}; {missing.remedy}")

    def _judge_frames(self, recording: Recording, rig: Rig) -> Diagnosis:
        in_step = check_synchronisation(recording)
        if in_step.in_step:
            return self._of_frames(recording, rig)
        excess = DECISIVE_EXCESS if in_step.causes else UNCERTAIN_EXCESS
        slipped = Finding(OUT_OF_STEP, in_step.describe(), excess, synchronisation_remedy(recording.plan))
        # Light that flickers and parts that move look like frames out of step which no slip explains.
        others = () if in_step.causes else diagnose_frames(recording)
        return Diagnosis(Verdict.DOUBTFUL, slipped.sentence, others or (slipped,))

    def _of_frames(self, recording: Recording, rig: Rig) -> Diagnosis:
        if self._calibration is None:
            self.decoded = _decoded_alone(recording)
            findings = diagnose_frames(recording, self.decoded)
            return Diagnosis(Verdict.GOOD, "", findings, (WITHOUT_CALIBRATION,))
        return self._with_points(recording, rig, self._calibration)

    def _with_points(self, recording: Recording, rig: Rig, calibration: Calibration) -> Diagnosis:
        depth = first_stated((self._plan.depth_mm, "plan"), (rig.file.depth_mm, str(rig.source)))
        decoded = decode(recording, bounds=decoding_bounds(recording.plan, calibration, depth))
        cloud = None
        if decoded.valid.any():
            with suppress(DataError):  # the frames say why there is no point
                decoded, cloud = points_of(decoded, calibration, recording.plan)
        self.decoded, self.cloud = decoded, cloud
        return diagnose_scan(recording, decoded, cloud, calibration, self._plan)


def _with_both_axes(plan: Plan, size: tuple[int, int]) -> Iterator[Plan]:
    """A plan with fringes along both axes, which show a stale calibration, and the plan itself."""
    # The further sets are those of the plan along the other axis, so that they can be unwrapped too.
    if len(plan.axes) < len(AXES):
        (other,) = set(AXES) - set(plan.axes)
        crossed = tuple(each.model_copy(update={"axis": other}) for each in plan.sets if each.coded_axis)
        if not any(each.fault(axis_length(size, other)) for each in crossed):
            yield plan.model_copy(update={"fringes": plan.sets + crossed})
    yield plan


def _take_frames(rig: Rig, plan: Plan, progress: Progress) -> Recording:
    caps = rig.projector.caps
    patterns = make_patterns(plan, caps.size, caps.lattice)
    recover_camera(rig)
    frames, exposures_s = list[Image](), list[float]()
    for exposure_s, images in zip(plan.exposures, plan.passes, strict=True):
        settings = rig.camera_settings(exposure_s, plan.bits)
        with closing(expose(rig, [patterns[i] for i in images], settings, plan)) as shots:
            for shot in shots:
                frames.append(shot.image)
                progress(len(frames) / plan.frames)
        exposures_s.append(shot.settings.exposure_s)
    bayer = rig.camera.caps.bayer
    raw = Recording(frames, plan, caps.size, settings.bits, "check", lattice=caps.lattice, bayer=bayer)
    return merged_recording(raw, exposures_s)


def _decoded_alone(recording: Recording) -> Decoded | None:
    """The projector coordinates, where the plan can be unwrapped without a calibration."""
    try:
        return decode(recording)
    except ConfigError:
        return None
