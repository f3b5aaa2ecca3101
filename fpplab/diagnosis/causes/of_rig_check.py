"""Causes that `fpplab check` reports of devices, synchronisation and further frames."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.diagnosis.causes.flicker import FlickerLimits
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import FaultCause, Figure, Finding, Picture


def draw_marker_levels(shown: NDArray[np.integer[Any]], runs: Mapping[str, Floats]) -> Figure:
    """Draw the levels seen of a marker frame by frame, and those expected of synchronous frames."""
    # The levels seen are expected to rise with the levels shown: expected are the levels seen of a run,
    # sorted in the order of the levels shown.
    # shown (K,); runs of (K,)
    from fpplab.core.drawing import ACCENT, ALARM, FULL, SECOND, new_figure

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


def _draw_rate(_: Evidence, finding: Finding) -> Figure:
    from fpplab.diagnosis.pictures import draw_rate

    return draw_rate(finding.excess)


def _draw_brightness(evidence: Evidence, _: Finding) -> Figure:
    from fpplab.diagnosis.pictures import draw_brightness_by_frame

    return draw_brightness_by_frame(evidence.frames, evidence.limits.of(FlickerLimits).max_scatter)


RATE_PICTURE = Picture(Needs.FINDING, _draw_rate)
_cause = partial(FaultCause, seen_in="check")
_of_marker = partial(_cause, picture=Picture(Needs.MARKER, _draw_marker))
DEVICE_REPORT = "what the device reports"

DEVICE = _cause(
    key="device",
    meaning="A device reported an error.",
    remedy="check its cable, power and drivers; 'fpplab devices' lists what is connected",
    measured="what a device reports",
    limit="any error",
    shown_by=DEVICE_REPORT,
)
NO_TRIGGER = _of_marker(
    key="no_trigger",
    meaning="No trigger pulse reaches the camera.",
    remedy="check the trigger cable, the camera's `line`, its input's voltage, and the projector's output 1",
    measured="frames of a triggered run of uniform images",
    limit="none came",
)
TRIGGER_EDGE = _of_marker(
    key="trigger_edge",
    meaning="The camera exposes at the wrong edge of the trigger pulse.",
    remedy="choose the other `edge` of the camera's trigger, or the other polarity (`inverted`) of the "
    "projector's output 1; check the trigger's delay",
    measured="frames of a run with darkness between the images",
    limit="they show the darkness",
)
CAMERA_NOT_READY = _of_marker(
    key="camera_not_ready",
    meaning="The next trigger comes before the camera is ready.",
    remedy="state a longer `dead_time_s` in the rig file's section of the camera",
    measured="frames of runs with more time between triggers",
    limit="all come then, and not before",
)
TRIGGER_SHIFTED = _of_marker(
    key="trigger_shifted",
    meaning="Triggered exposures begin after their patterns, or before them.",
    remedy="reduce `delay_us` and `debounce_us` of the camera's trigger, choose the edge at which a "
    "pattern begins, or use a GPIO line",
    measured="levels of the triggered run as mixtures of those of the stepped run",
    limit="a neighbour's share of 3 % or more",
)
SLOW_DISPLAY = _of_marker(
    key="slow_display",
    meaning="The display is slower than the plan waits.",
    remedy="give the plan a longer settle_s",
    measured="grey levels seen compared with those shown, at longer settling times",
    limit="in step twice at a longer one, out of step twice at the plan's",
)
OUT_OF_STEP = _of_marker(
    key="out_of_step",
    meaning="Frames show other patterns than their own.",
    remedy="check the trigger, or give the plan a longer settle_s",
    measured="the same as `slow_display`; slips of the trigger that explain them",
    limit="1.5 % of their range RMS",
)
NO_PERMISSION = _cause(
    key="no_permission",
    meaning="The user may not open a device.",
    remedy="copy the udev rules of docs/hardware.md, join the group that they name, and plug the device in "
    "again",
    measured="whether the system refuses to open a device",
    limit="any refusal",
    shown_by=DEVICE_REPORT,
)
SLOW_LINK = _cause(
    key="slow_link",
    meaning="The camera's connection carries fewer frames than the plan takes.",
    remedy="use a USB 3 port and cable, fewer bits, or a longer period between frames",
    measured="frames that the camera's link carries, by the rate that its driver states",
    limit="those of the plan",
    picture=RATE_PICTURE,
)
SLOW_DISK = _cause(
    key="slow_disk",
    meaning="Frames come faster than they are written.",
    remedy="write to a local disk, or take fewer frames per second",
    measured="frames per second that the folder of `--out` takes, or the working folder",
    limit="those of a triggered plan",
    picture=RATE_PICTURE,
)
MAINS_FLICKER = _cause(
    key="mains_flicker",
    meaning="The light follows the mains.",
    remedy="expose for whole periods of the light, or run the lamp from direct current",
    measured="scatter of the brightness of further frames, exposed as the plan says and for whole periods "
    "of 100 and 120 Hz",
    limit="0.75 %, of which whole periods leave at most 0.4",
    picture=Picture(Needs.FRAMES, _draw_brightness),
)
