"""From the frames of a view to what is shown of them: light, focus, findings, expected noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Image, Mask, full_scale
from fpplab.devices import Frame
from fpplab.diagnosis import Finding, diagnose_frames
from fpplab.diagnosis.sample import FrameSample
from fpplab.patterns.mosaic import Bayer, without_mosaic
from fpplab.patterns.recording import Recording
from fpplab.setup.live.expectation import WorkingPoint
from fpplab.setup.live.exposure import LightLevels, levels_of_fringes, levels_of_image
from fpplab.setup.live.focus import FocusTracker, camera_sharpness, projector_contrast
from fpplab.setup.live.patterns import LivePatterns, View
from fpplab.targets import Target


@dataclass(frozen=True)
class MarksInView:
    """How many points of the marks the camera sees, and by how much they have moved in its image."""

    points: int
    located: int  # at the time of the characterisation
    moved_px: float | None  # median distance; None where none are seen

    @property
    def line(self) -> str:
        moved = "" if self.moved_px is None else f", moved by {self.moved_px:.2f} px"
        return f"marks {self.points} of {self.located} points{moved}"


def marks_in_view(image: NDArray[Any], calibration: Calibration) -> MarksInView | None:
    if (marks := calibration.marks) is None:
        return None
    detection = config.validate(marks.target, Target, "the calibration's marks").detect(image)
    if detection is None:
        return MarksInView(0, len(marks.ids), None)
    common, then, now = np.intersect1d(marks.ids, detection.ids, return_indices=True)
    moved = np.linalg.norm(detection.pixels[now] - marks.camera_px[then], axis=1)
    return MarksInView(len(common), len(marks.ids), float(np.median(moved)) if len(common) else None)


class LiveMeasures:
    """Measures of the frames so far; those of another view or exposure do not mix with them."""

    def __init__(self, working: WorkingPoint | None = None) -> None:
        self.working, self.black = working, 0.0
        self.levels: LightLevels | None = None
        self.findings: tuple[Finding, ...] = ()
        self.camera_focus, self.projector_focus = FocusTracker(), FocusTracker()
        self.noise_um: NDArray[np.float64] | None = None
        self.marks: MarksInView | None = None
        self._view = View.MEASURE
        self._patterns: LivePatterns | None = None
        self._projector_size = (0, 0)
        self._bayer: Bayer | None = None
        self._images: list[Image] = []
        self._brightest: Image | None = None

    def begin(
        self, patterns: LivePatterns, view: View, projector_size: tuple[int, int], bayer: Bayer | None = None
    ) -> None:
        """Begin a view: earlier frames are of another light."""
        # projector_size (width, height) px
        self._patterns, self._view, self._projector_size = patterns, view, projector_size
        self._bayer = bayer
        self._images, self._brightest = [], None
        self.levels, self.noise_um = None, None
        if view is not View.MEASURE:
            self.findings = ()

    def add(self, frame: Frame) -> bool:
        if self._view is View.MEASURE:
            return self._add_to_cycle(frame)
        previous, self._images = self._images[-1:], [frame.image]
        if self._view is View.BLACK:
            return False
        self.levels = levels_of_image(frame.image, frame.settings.bits, self.black)
        if self._view is View.WHITE:
            self._brightest = frame.image
            if previous:
                self._sharpness(previous[0], frame.image, full_scale(frame.settings.bits))
        return True

    def forget_focus(self) -> None:
        self.camera_focus = self.camera_focus.forgotten()
        self.projector_focus = self.projector_focus.forgotten()

    def dark(self, bits: int) -> Mask | None:
        # returns (height, width)
        if self._brightest is None:
            return None
        return np.asarray(self._brightest < 0.03 * full_scale(bits))

    def _add_to_cycle(self, frame: Frame) -> bool:
        assert self._patterns is not None, "a view was begun"
        plan = self._patterns.plan
        self._images.append(frame.image)
        if len(self._images) < plan.images:
            return False
        images, self._images = self._images, []
        bits = frame.settings.bits
        self._update_measures(Recording(images, plan, self._projector_size, bits, "live", bayer=self._bayer))
        return True

    def _update_measures(self, recording: Recording) -> None:
        sample = FrameSample(recording)
        self.levels = levels_of_fringes(sample, self.black)
        self.findings = diagnose_frames(recording)
        self._brightest = np.maximum.reduce(recording.frames)
        # The mean of each set is the scene under even light, and their noise is independent.
        ends = recording.plan.set_starts
        halves = ends[:2] + ends[-2:] if len(ends) > 2 else (0, ends[1] // 2, ends[1] // 2, ends[1])
        first, last = (_mean(recording.frames[a:b]) for a, b in (halves[:2], halves[2:]))
        self._sharpness(first, last, recording.full_scale)
        self.projector_focus = self.projector_focus.after(projector_contrast(sample))
        if self.working is not None:
            self.noise_um = self.working.noise_um(sample) if sample.measured.any() else None
            self.marks = marks_in_view(recording.mean_image(), self.working.geometry.calibration)

    def _sharpness(
        self, first_image: NDArray[np.generic], second_image: NDArray[np.generic], full_scale: int
    ) -> None:
        shares = [image.astype(np.float32) / full_scale for image in (first_image, second_image)]
        if self._bayer:
            shares = [without_mosaic(share) for share in shares]
        self.camera_focus = self.camera_focus.after(camera_sharpness(*shares))


def _mean(images: Sequence[Image]) -> NDArray[np.float32]:
    total = np.zeros(images[0].shape, np.float32)
    for image in images:
        total += image
    return total / len(images)
