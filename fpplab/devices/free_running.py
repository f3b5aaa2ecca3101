"""Cameras that expose all the time, such as webcams, phones and the cameras of small computers."""

import time
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import final

from fpplab.core.conventions import Image
from fpplab.core.errors import CapabilityError, DeviceTimeoutError
from fpplab.devices.camera import Camera, CameraSettings, Frame, Trigger, are_settings_honoured

CLOCK_S = 1e-3  # by which frames may lie ahead of the computer's time (chosen: above the rounding of clocks)


@dataclass(frozen=True)
class FreeRun:
    """How a camera runs at its present settings."""

    period_s: float  # longest time from one frame to the next
    latency_s: float = 0.0  # longest time for which a frame is held back before it is stamped or delivered
    queued: int = 4  # frames that may wait to be read; only needed where frames have no time
    late: int = 0  # frames after a change of settings that may still have the settings from before
    warm_up: int = 0  # frames after each start that are not fit for use


@dataclass(frozen=True, eq=False)
class FreeFrame:
    """A frame as it comes, whenever it was exposed."""

    image: Image | Callable[[], Image]
    """Raw integers (height, width), a copy; or a function that gives them, called for frames that are fit."""
    time_s: float | None = None  # of any moment of it, by `time.monotonic`; None where nothing tells it
    exposure_s: float | None = None  # with which it was exposed, where the camera says so of each frame


class FreeRunningCamera(Camera):
    """A camera that cannot be triggered: of the frames that come, those are taken that began after the call.

    A driver fills in `_caps`, `_configure`, `_stop` and the hooks below, instead of `_arm` and `_read`;
    `CameraCaps.triggers` is ("software",).
    """

    _shown: CameraSettings | None = None

    @abstractmethod
    def _run(self) -> FreeRun:
        """Tell how the camera runs at its present settings; called with every frame, so it must be quick.

        Returns
        -------
        FreeRun
            Times in s and numbers of frames; an upper bound where a value is not known.
        """

    @abstractmethod
    def _start(self) -> None:
        """Let frames come; called by `arm` in IDLE, configured.

        Raises
        ------
        DeviceError
            They cannot come.
        """

    @abstractmethod
    def _next(self, timeout_s: float) -> FreeFrame | None:
        """Deliver the frame that has waited longest, or wait for one.

        Called by `read` in ARMED, until a frame is fit. Do not drop any frame here.

        Parameters
        ----------
        timeout_s : float
            Longest time in s to wait.

        Returns
        -------
        FreeFrame or None
            The frame; None where none came in time.
        """

    @final
    def _arm(self, n: int, trigger: Trigger) -> None:
        settings, run = self._configured("arm"), self._run()
        self._unfit = run.warm_up + (run.late if settings is not self._shown else 0)
        self._shown = settings
        self._start()

    @final
    def _read(self, timeout_s: float) -> Frame:
        settings, run, begin_s = self._configured("read"), self._run(), time.monotonic()
        # Whichever moment of a frame its time is of, from here on it was exposed after `begin_s`.
        fresh_s = begin_s + settings.exposure_s + run.period_s + run.latency_s
        untimed = run.queued + 1  # of those that waited, and the one that is under way
        while True:
            frame = self._next(begin_s + timeout_s - time.monotonic())
            if frame is None:
                raise DeviceTimeoutError(
                    self.name,
                    "read",
                    f"no frame that began after it was asked for came within {timeout_s:g} s",
                    "check the cable, or allow more time",
                )
            if frame.time_s is None:
                untimed -= 1
                is_fresh = untimed < 0
            else:
                self._check_clock(frame.time_s)
                is_fresh = frame.time_s >= fresh_s
            if is_fresh and self._unfit:
                self._unfit -= 1
            elif is_fresh and self._has_settings(frame, settings):
                image = frame.image() if callable(frame.image) else frame.image
                return Frame(image, self._taken, settings, time.time(), frame.time_s)

    def _has_settings(self, frame: FreeFrame, settings: CameraSettings) -> bool:
        exposure_s = settings.exposure_s if frame.exposure_s is None else frame.exposure_s
        return are_settings_honoured(
            settings, CameraSettings(exposure_s, settings.gain_db, settings.bits), self.caps
        )

    def _check_clock(self, time_s: float) -> None:
        """Refuse times that are not of the computer's clock: by those stale frames would look fresh."""
        if time_s > time.monotonic() + CLOCK_S:
            raise CapabilityError(
                self.name,
                "read",
                "its frames do not state when they were exposed",
                "use a camera whose driver stamps frames with the monotonic clock, and not ahead of it",
            )
