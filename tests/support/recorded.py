"""A small session, and how to harm it."""

import os
import signal
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session

PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4, projector_size=(64, 48)),))
SIZE = (20, 16)


def image_of(index: int, size: tuple[int, int] = SIZE) -> Image:
    """A picture that no other frame has."""
    rows = np.arange(size[0] * size[1], dtype=np.uint32).reshape(size[1], size[0])
    return ((rows * 7 + index * 31) % 251).astype(np.uint8)


def frame(index: int, plan: Plan = PLAN, image: Image | None = None, bits: int = 8) -> Frame:
    ids = [name for _, _, name in plan.steps()]
    picture = image_of(index) if image is None else image
    return Frame(picture, index, CameraSettings(0.02, 0.0, bits), 100.0 + index, None, ids[index])


def record(path: Path, count: int = PLAN.images, plan: Plan = PLAN) -> Session:
    """A session whose first `count` frames are there."""
    session = Session.create(path, plan)
    for index in range(count):
        session.write(frame(index, plan))
    return session


def in_a_child(work: Callable[[], object]) -> int:
    """Run `work` in a forked process; its exit code, or minus the signal that ended it."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            work()
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class KillAtLine:
    """Ends the process by SIGKILL at the n-th line of the code that writes sessions."""

    def __init__(self, n: int) -> None:
        self.left = n

    def __call__(self, called: FrameType, event: str, argument: Any) -> Any:
        if not called.f_code.co_filename.endswith(("fpplab/sessions/session.py", "fpplab/core/files.py")):
            return None
        if event == "line":
            self.left -= 1
            if self.left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
        return self
