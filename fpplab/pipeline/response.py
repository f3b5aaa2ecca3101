"""The response of projector and camera to grey levels."""

from collections.abc import Callable
from contextlib import closing

import numpy as np

from fpplab.acquisition.acquire import expose
from fpplab.core.conventions import Floats
from fpplab.core.progress import Progress, no_progress
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import GreyLevels
from fpplab.patterns.response import Response
from fpplab.patterns.response_fit import GreyLevelImages, fit_greys, pixels_of_regions, statistics


def measure_response(
    rig: Rig,
    exposure_s: float,
    greys: GreyLevels | None = None,
    progress: Progress = no_progress,
    observe_frame: Callable[[int, Frame], object] = lambda level, frame: None,
) -> tuple[Response, Floats]:
    """Show uniform grey-level images and fit the response."""
    # They are shown from black to white and back, `repeats` times in all, so that a lamp that drifts does not
    # pass for a response; before them one frame with the projector off.
    # returns levels (K, 2)
    greys = greys or GreyLevels()
    settings = rig.camera_settings(exposure_s)
    patterns = uniform_patterns(greys.shown, rig.projector.caps.size)
    dark = _dark_frame(rig, exposure_s)
    levels_seen = np.empty((greys.repeats, len(patterns), *statistics(dark.image, dark.settings.bits).shape))
    for repeat in range(greys.repeats):
        order = range(len(patterns))[:: 1 if repeat % 2 == 0 else -1]
        with closing(expose(rig, [patterns[i] for i in order], settings)) as shots:
            for done, (i, frame) in enumerate(zip(order, shots, strict=True), 1):
                levels_seen[repeat, i] = statistics(frame.image, frame.settings.bits)
                observe_frame(greys.shown[i], frame)
                progress((repeat + done / len(patterns)) / greys.repeats)
    response = fit_greys(
        GreyLevelImages(
            shown=np.array(greys.shown) / 255.0,
            statistics=levels_seen,
            dark=statistics(dark.image, dark.settings.bits),
            pixels=pixels_of_regions(dark.image),
            bits=dark.settings.bits,
        )
    )
    return response, np.array([(level.shown, level.seen) for level in response.measured])


def _dark_frame(rig: Rig, exposure_s: float) -> Frame:
    """A frame with the projector off: the camera's black level, and the light of the room."""
    rig.camera.configure(rig.camera_settings(exposure_s))
    rig.make_dark()
    return rig.camera.snap()
