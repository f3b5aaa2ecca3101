"""Acquisition of frames: the only module that synchronises projector and camera.

Stepped: show a pattern, wait until it has settled, take one frame. Triggered: the projector is the clock,
and each of its trigger pulses exposes one frame. Afterwards the frames themselves must prove that each shows
its own pattern; where those of a triggered plan cannot, two more patterns are played that do: black and
white.
"""

import logging
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing

from fpplab.acquisition.synchronisation import check_synchronisation, provable, synchronisation_remedy
from fpplab.acquisition.timing import check_stepped, pulse_timing
from fpplab.core.conventions import Image
from fpplab.core.errors import CapabilityError, SyncError
from fpplab.core.progress import ignore
from fpplab.devices import Camera, CameraSettings, Frame, Projector
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.sessions.frame_writer import write_frames
from fpplab.sessions.session import Session

_log = logging.getLogger(__name__)

READ_TIMEOUT_S = 10.0  # time in s beyond its exposure that a frame may take (chosen)

NO_END_MARKER = "after the last pattern no black and then white image was seen"
"""Evidence of a slip: the black and white patterns at the end were not seen."""

FrameObserver = Callable[[Frame], None]  # called with each frame once it is on disk: a progress bar, a viewer


def acquire(
    rig: Rig,
    plan: Plan,
    session: Session,
    observe: FrameObserver = ignore,
    exposed: Callable[[], object] = ignore,
) -> None:
    """Take every image of the plan that the session lacks; tell `exposed` when the last exposure is over."""
    # The projector is dark afterwards, whatever happened.
    all_missing = session.missing()
    last = max(all_missing, default=-1)
    for exposure_s, images, first in zip(plan.exposures, plan.passes, plan.pass_starts, strict=False):
        missing = {images[k - first]: k for k in all_missing if first <= k < first + len(images)}
        _log.info("%d frames are to be taken, %g s each", len(missing), exposure_s)
        if missing:
            over = exposed if last in missing.values() else ignore
            _take_pass(rig, plan, session, missing, exposure_s, observe, over)
    if all_missing:
        _prove(rig, session)
    else:
        exposed()


def _take_pass(
    rig: Rig,
    plan: Plan,
    session: Session,
    missing: Mapping[int, int],
    exposure_s: float,
    observe: FrameObserver,
    exposed: Callable[[], object],
) -> None:
    """Take the missing images of the plan at one exposure; `missing` has their frames."""
    caps = rig.projector.caps
    settings = rig.camera_settings(exposure_s, plan.bits)
    patterns = make_patterns(plan, caps.size, caps.lattice)
    ends = end_markers(plan.part_at(exposure_s), caps.size)
    brightness = []
    shown = [*(patterns[i] for i in missing), *ends]
    with (
        write_frames(session, observe) as record,
        closing(expose(rig, shown, settings, plan)) as raw,
        closing(_telling_last(raw, len(shown), exposed)) as shots,
    ):
        for index, shot in zip(missing, shots, strict=False):
            record(shot.showing(patterns[index].id, missing[index]))
            if ends:
                brightness.append(float(shot.image.mean()))
        brightness += [float(shot.image.mean()) for shot in shots]
    if ends and not _ends_black_and_white(brightness):
        raise _out_of_step(rig, session, NO_END_MARKER)


def _telling_last(
    shots: Iterator[Frame], count: int, exposed: Callable[[], object]
) -> Generator[Frame, None, None]:
    for number, shot in enumerate(shots, 1):
        if number == count:
            exposed()
        yield shot


def capture(rig: Rig, plan: Plan) -> list[Image]:
    """Take every image of the plan into memory, with the same check of synchronisation as `acquire`."""
    # returns (height, width)
    plan.refuse_exposures("a search on this rig")
    caps = rig.projector.caps
    ends = end_markers(plan, caps.size)
    patterns = [*make_patterns(plan, caps.size, caps.lattice), *ends]
    settings = rig.camera_settings(plan.exposure_s, plan.bits)
    with closing(expose(rig, patterns, settings, plan)) as shots:
        frames = [shot.image for shot in shots]
    if ends and not _ends_black_and_white([float(frame.mean()) for frame in frames]):
        raise SyncError(rig.camera.name, "capture", NO_END_MARKER, synchronisation_remedy(plan))
    taken = Recording(
        frames[: plan.images], plan, caps.size, settings.bits, "frames", bayer=rig.camera.caps.bayer
    )
    verdict = check_synchronisation(taken)
    if not verdict.in_step:
        raise SyncError(rig.camera.name, "capture", verdict.describe(), synchronisation_remedy(plan))
    return frames[: plan.images]


def end_markers(plan: Plan, size: tuple[int, int]) -> list[Pattern]:
    """Make the patterns that follow a plan whose frames alone cannot reveal a trigger slip."""
    needed = plan.trigger != "stepped" and not provable(plan)
    # In a depth that the plan has: others might make every exposure longer.
    return uniform_patterns([0, 255], size, min(s.bit_depth for s in plan.sets)) if needed else []


def _ends_black_and_white(brightness: Sequence[float]) -> bool:
    """Whether the last two frames are darker and brighter than every other."""
    *fringes, black, white = brightness
    return black < min(fringes) and white > max(fringes)


def _prove(rig: Rig, session: Session) -> None:
    for of_exposure in session.passes(verify=False):
        verdict = check_synchronisation(of_exposure)
        if not verdict.in_step:
            raise _out_of_step(rig, session, verdict.describe())


def _out_of_step(rig: Rig, session: Session, evidence: str) -> SyncError:
    advice = f"then take it again, with --force; the frames stay in {session.path} until then"
    return SyncError(
        rig.camera.name, "acquire", evidence, f"{synchronisation_remedy(session.plan)}; {advice}"
    )


def expose(
    rig: Rig,
    patterns: Sequence[Pattern],
    settings: CameraSettings,
    plan: Plan | None = None,
    gap_s: float = 0.0,
) -> Generator[Frame, None, None]:
    """Take one frame per pattern, in order, synchronised as the plan says."""
    # The projector is dark again once the generator ends or is closed; a caller that may leave it early must
    # close it.
    if not patterns:
        return
    camera, projector = rig.camera, rig.projector
    try:
        settings = camera.configure(settings)
        if plan is not None and plan.trigger == "triggered":
            yield from _triggered(rig, patterns, settings, gap_s, in_parts=provable(plan))
        elif plan is not None and plan.trigger == "followed":
            projector.load(patterns)
            yield from _followed(camera, projector, patterns, settings, plan.settle_s)
        else:
            projector.load(patterns)
            yield from _stepped(camera, projector, patterns, settings, plan.settle_s if plan else 0.0)
    finally:
        rig.make_dark()


def _stepped(
    camera: Camera,
    projector: Projector,
    patterns: Sequence[Pattern],
    settings: CameraSettings,
    settle_s: float,
) -> Iterator[Frame]:
    check_stepped(camera)
    for i, pattern in enumerate(patterns):
        projector.show(i)
        time.sleep(settle_s)  # the display's own latency, which the plan states
        yield in_step(camera, camera.snap(timeout_s=settings.exposure_s + READ_TIMEOUT_S), pattern)


def _followed(
    camera: Camera,
    projector: Projector,
    patterns: Sequence[Pattern],
    settings: CameraSettings,
    settle_s: float,
) -> Iterator[Frame]:
    """Let the camera be the clock: each exposure brings its pattern."""
    check_stepped(camera)
    if not camera.caps.strobe:
        raise CapabilityError(
            camera.name, "arm", "has no output that is active while it exposes", "use a stepped plan"
        )
    if camera.caps.readout_s and projector.caps.flashes:
        raise CapabilityError(
            projector.name,
            "follow",
            "shows a pattern for a part of each exposure, and the camera's rows are not exposed together",
            "use a global shutter, or a stepped plan",
        )
    camera.arm(len(patterns), "software")
    projector.follow(settings.exposure_s)
    for pattern in patterns:
        time.sleep(settle_s)
        yield in_step(camera, camera.read(timeout_s=settings.exposure_s + READ_TIMEOUT_S), pattern)


def _triggered(
    rig: Rig, patterns: Sequence[Pattern], settings: CameraSettings, gap_s: float, in_parts: bool
) -> Iterator[Frame]:
    """Take triggered frames, in parts as large as the camera keeps where the frames prove themselves."""
    # A projector that is fed by the computer plays to the end before the first frame is read.
    camera, projector, dead_s = rig.camera, rig.projector, rig.file.camera.dead_s(settings.exposure_s)
    kept = (camera.caps.buffers if in_parts else None) or len(patterns)
    for part in (patterns[i : i + kept] for i in range(0, len(patterns), kept)):
        projector.load(part)
        timing = pulse_timing(camera, projector, part, settings.exposure_s, dead_s, gap_s)
        camera.arm(len(part), "hardware")
        projector.play(timing.light_s, timing.dark_s, timing.period_s)
        for pattern in part:
            yield in_step(camera, camera.read(timeout_s=timing.period_s + READ_TIMEOUT_S), pattern)
        projector.blank()


def in_step(camera: Camera, frame: Frame, pattern: Pattern) -> Frame:
    """Refuse a frame whose camera backend knows that another pattern was shown."""
    if frame.pattern_id not in (None, pattern.id):
        raise SyncError(
            camera.name,
            "read",
            f"the frame shows '{frame.pattern_id}' instead of '{pattern.id}'",
            "make sure that nothing else drives the projector, and scan again",
        )
    return frame
