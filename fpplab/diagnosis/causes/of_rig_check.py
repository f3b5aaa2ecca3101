"""Causes that `fpplab check` reports of devices, synchronisation and further frames."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.drawing import ACCENT, ALARM, FULL, SECOND, new_figure
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.pictures import draw_rate


def draw_marker_levels(shown: NDArray[np.integer[Any]], runs: Mapping[str, Floats]) -> Figure:
    """Draw the levels seen of a marker frame by frame, and those expected of synchronous frames."""
    # The levels seen are expected to rise with the levels shown: expected are the levels seen of a run,
    # sorted in the order of the levels shown.
    # shown (K,); runs of (K,)
    figure = new_figure(FULL, 2.6)
    panels = np.atleast_1d(figure.subplots(1, len(runs), sharey=True))
    for axes, (how, levels) in zip(panels, runs.items(), strict=True):
        frames = np.flatnonzero(np.isfinite(levels))
        expected = np.sort(levels[frames])[np.argsort(np.argsort(shown[frames]))]
        axes.plot(frames, expected, color=SECOND, linewidth=1.2, label="expected")
        axes.plot(frames, levels[frames], "o", color=ACCENT, markersize=4, label="seen")
        mismatched = frames[np.abs(levels[frames] - expected) > 0.05 * np.ptp(levels[frames])]
        axes.plot(
            mismatched, levels[mismatched], "o", color=ALARM, markersize=4, label="seen, of another image"
        )
        axes.set(xlabel="frame", xlim=(-0.5, len(shown) - 0.5))
        axes.set_title(how, fontsize=8.5)
    panels[0].set(ylabel="level, of full scale")
    panels[0].legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=3)
    return figure


def _draw_marker(evidence: Evidence, _: Finding) -> Figure:
    assert evidence.marker is not None
    return draw_marker_levels(evidence.marker, evidence.runs)


RATE_PICTURE = Picture(Needs.FINDING, draw_rate)
_cause = partial(FaultCause, seen_in="check")
_of_marker = partial(_cause, picture=Picture(Needs.MARKER, _draw_marker))
DEVICE_REPORT = "what the device reports"

DEVICE = _cause(
    key="device",
    meaning="A device reported an error.",
    remedy="check its cable, power and drivers; 'fpplab devices' lists what is connected",
    measured="errors reported by a device",
    limit="any error",
    shown_by=DEVICE_REPORT,
)
NO_TRIGGER = _of_marker(
    key="no_trigger",
    meaning="No trigger pulse reaches the camera.",
    remedy="check the trigger cable, the camera's `line` and input voltage, and trigger output 1 of "
    "the projector",
    measured="number of frames in a triggered run of uniform images",
    limit="none received",
)
TRIGGER_EDGE = _of_marker(
    key="trigger_edge",
    meaning="The camera exposes at the wrong edge of the trigger pulse.",
    remedy="select the other `edge` of the camera trigger, or the other polarity (`inverted`) of "
    "trigger output 1 of the projector; check the trigger delay",
    measured="frames of a run with dark intervals between the images",
    limit="the frames are dark",
)
CAMERA_NOT_READY = _of_marker(
    key="camera_not_ready",
    meaning="The next trigger comes before the camera is ready.",
    remedy="state a longer `dead_time_s` in the rig file's section of the camera",
    measured="number of frames in runs with longer trigger periods",
    limit="all received then, but not before",
)
TRIGGER_SHIFTED = _of_marker(
    key="trigger_shifted",
    meaning="Triggered exposures begin before or after their patterns.",
    remedy="reduce `delay_us` and `debounce_us` of the camera's trigger, choose the edge at which a "
    "pattern begins, or use a GPIO line",
    measured="grey levels of the triggered run as mixtures of those of the stepped run",
    limit="3 % or more of a neighbouring pattern",
)
SLOW_DISPLAY = _of_marker(
    key="slow_display",
    meaning="The display is slower than the settling time of the plan.",
    remedy="increase settle_s in the plan",
    measured="grey levels seen relative to those shown, at longer settling times",
    limit="twice in step at a longer time, twice out of step at the plan's",
)
OUT_OF_STEP = _of_marker(
    key="out_of_step",
    meaning="Frames show patterns other than their own.",
    remedy="check the trigger, or increase settle_s in the plan",
    measured="as `slow_display`; trigger slips that explain the frames",
    limit="1.5 % of their range RMS",
)
NO_PERMISSION = _cause(
    key="no_permission",
    meaning="The user lacks permission to open a device.",
    remedy="install the udev rules of docs/hardware.md, join the group they name, and reconnect the device",
    measured="whether the operating system refuses to open a device",
    limit="any refusal",
    shown_by=DEVICE_REPORT,
)
SLOW_LINK = _cause(
    key="slow_link",
    meaning="The camera's connection is too slow for the frame rate of the plan.",
    remedy="use a USB 3 port and cable, fewer bits, or a longer period between frames",
    measured="frame rate of the camera's connection, as stated by its driver",
    limit="frame rate of the plan",
    picture=RATE_PICTURE,
)
SLOW_DISK = _cause(
    key="slow_disk",
    meaning="Frames arrive faster than they can be written.",
    remedy="write to a local disk, or take fewer frames per second",
    measured="frames per second that can be written to the folder of `--out`, or the working folder",
    limit="frame rate of a triggered plan",
    picture=RATE_PICTURE,
)
MAINS_FLICKER = _cause(
    key="mains_flicker",
    meaning="The light flickers with the mains.",
    remedy="set the exposure to whole periods of the light, or supply the lamp with direct current",
    measured="scatter of the brightness of extra frames, with the exposure of the plan and with whole "
    "periods of 100 and 120 Hz",
    limit="0.75 %, reduced to at most 0.4 of it by whole periods",
    picture=FLICKER.picture,
)
