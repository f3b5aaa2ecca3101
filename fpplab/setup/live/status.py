"""What the set-up shows, as a snapshot after each frame: for page, terminal, viewer and `--json`."""

from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.devices import CameraSettings
from fpplab.diagnosis import Finding
from fpplab.setup.live.exposure import ExposureAdvice, LightLevels
from fpplab.setup.live.focus import FocusTracker
from fpplab.setup.live.measuring import MarksInView
from fpplab.setup.live.patterns import View


@dataclass(frozen=True)
class StageState:
    """Where the stage is."""

    homed: bool  # whether its positions are absolute
    position_mm: float  # as read from the device


@dataclass(frozen=True, eq=False)
class LiveStatus:
    """A snapshot of the set-up."""

    frames: int  # frames shown so far
    rate_hz: float | None  # frames per s; None at first
    view: View  # what the projector shows
    views: tuple[View, ...]  # what it can show
    settings: CameraSettings | None  # of the camera, as read back; None before it was opened
    levels: LightLevels | None  # light of the latest cycle or image
    advice: ExposureAdvice | None  # exposure to take
    camera_focus: FocusTracker  # focus by region
    projector_focus: FocusTracker  # focus by region
    findings: tuple[Finding, ...] = ()  # what the fringes show to be wrong
    geometry: dict[str, object] | None = None  # overlap, distances and angle, with a calibration
    noise_um: Floats | None = None  # expected standard uncertainty by noise, by region, in µm
    marks: MarksInView | None = None  # reference marks, with a calibration that has them
    coverage: dict[str, object] | None = None  # poses of the board, with a target
    stage: StageState | None = None  # where the stage is, if there is one
    message: str = ""  # result of the latest order
    paused_for: str | None = None  # the process that has the rig
    pauses: int = 0  # how many times another command had the rig

    def summary(self) -> dict[str, object]:
        noise = None if self.noise_um is None else overall_median(self.noise_um)
        expected = None if self.geometry is None else {**self.geometry, "noise_um": noise}
        return {
            "frames": self.frames,
            "rate_hz": self.rate_hz,
            "view": self.view.value,
            "views": [view.value for view in self.views],
            "exposure_s": self.settings.exposure_s if self.settings else None,
            "gain_db": self.settings.gain_db if self.settings else None,
            "light": None if self.levels is None else self.levels.__dict__,
            "advice": None if self.advice is None else self.advice.__dict__,
            "focus": {"camera": self.camera_focus.summary(), "projector": self.projector_focus.summary()},
            "findings": [finding.summary() for finding in self.findings],
            "expected": expected,
            "marks": None if self.marks is None else self.marks.__dict__,
            "coverage": self.coverage,
            "stage": None if self.stage is None else self.stage.__dict__,
            "message": self.message,
            "paused_for": self.paused_for,
            "pauses": self.pauses,
        }

    def line(self) -> str:
        if self.paused_for:
            return f"paused: {self.paused_for} has the rig"
        if self.settings is None:
            return "opening the rig"
        parts = [
            f"{self.view.value}",
            f"{1e3 * self.settings.exposure_s:.4g} ms, {self.settings.gain_db:.3g} dB",
        ]
        if self.levels is not None:
            parts.append(f"peak {100 * self.levels.peak:.0f} %")
        if self.advice is not None and not self.advice.is_right:
            parts.append(f"advised {1e3 * self.advice.exposure_s:.4g} ms, {self.advice.gain_db:.3g} dB")
        for name, tracker in (("camera", self.camera_focus), ("projector", self.projector_focus)):
            share = tracker.share
            parts.append(f"{name} focus " + ("–" if share is None else f"{100 * share:.0f} % of best"))
        if self.noise_um is not None and (noise := overall_median(self.noise_um)) is not None:
            parts.append(f"noise {noise:.3g} µm")
        if self.marks is not None:
            parts.append(self.marks.line)
        return " | ".join(parts)


def overall_median(values: Floats) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if finite.size else None
