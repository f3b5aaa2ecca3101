"""Faults in how frames and patterns are kept in step, and in the virtual bench."""

from __future__ import annotations

from tests.conformance.fault import Fault

PROJECTOR_BASE = "fpplab/devices/projector.py"
ACQUISITION = "fpplab/acquisition/acquire.py"
TIMING = "fpplab/acquisition/timing.py"
SYNCHRONISATION = "fpplab/acquisition/synchronisation.py"
MARKER = "fpplab/setup/rig_check/marker_check.py"
RIG = "fpplab/devices/rig.py"
SIM = "sim/devices.py"

IN_STEP = [
    Fault("never dark again", ACQUISITION, "expose", "rig.make_dark()", ""),
    Fault(
        "dark only once the exception is forgotten",
        ACQUISITION,
        "",
        "from contextlib import closing",
        "from contextlib import nullcontext as closing",
    ),
    Fault("lit when the camera cannot stop", RIG, "Rig.make_dark", "both.callback(safe)", "safe()"),
    Fault(
        "the pattern before", ACQUISITION, "_stepped", "projector.show(i)", "projector.show(max(i - 1, 0))"
    ),
    Fault(
        "another pattern is not noticed",
        ACQUISITION,
        "in_step",
        "if frame.pattern_id not in (None, pattern.id):",
        "if False:",
    ),
    Fault(
        "frames out of step are not noticed",
        ACQUISITION,
        "_prove",
        "if not verdict.in_step:",
        "if False:",
    ),
    Fault(
        "a slip in frames that prove nothing is not noticed",
        ACQUISITION,
        "acquire",
        "if ends and not _ended(brightness):",
        "if False:",
    ),
    Fault(
        "out of step is taken for noise",
        SYNCHRONISATION,
        "_decide",
        "likelihood[0] + LEAST_LOG_RATIO",
        "likelihood[0] + 1e3",
    ),
    Fault("a marker that follows anything", MARKER, "MOST_DEPARTURE", "0.015", "1.0"),
    Fault(
        "a wrong pattern id",
        ACQUISITION,
        "acquire",
        "patterns[index].id",
        "patterns[index - 1].id",
    ),
    Fault(
        "everything taken again",
        ACQUISITION,
        "acquire",
        "session.missing()",
        "list(range(plan.images))",
    ),
    Fault("one frame short", ACQUISITION, "acquire", "session.missing()", "session.missing()[:-1]"),
    Fault(
        "played before the camera listens",
        ACQUISITION,
        "_triggered",
        "camera.arm(...)\nrig.projector.play(...)",
        "rig.projector.play(timing.light_s, timing.dark_s, timing.period_s)\n"
        'camera.arm(len(patterns), "hardware")',
    ),
    Fault(
        "the next pattern before the last row is read",
        TIMING,
        "pulse_timing",
        "exposure_s + caps.readout_s",
        "exposure_s",
    ),
    Fault(
        "lit while rows end",
        ACQUISITION,
        "_triggered",
        "rig.projector.play(...)",
        "rig.projector.play(timing.light_s, 0.0, timing.period_s)",
    ),
    Fault(
        "timing: a pulse as soon as the exposure ends",
        ACQUISITION,
        "_triggered",
        "rig.projector.play(...)",
        "rig.projector.play(timing.light_s, timing.dark_s)",
    ),
    Fault(
        "timing: the stated dead time is not used",
        ACQUISITION,
        "_triggered",
        "pulse_timing(camera, rig.projector, patterns, settings.exposure_s, dead_s, gap_s)",
        "pulse_timing(camera, rig.projector, patterns, settings.exposure_s, None, gap_s)",
    ),
    Fault("timing: clocks are equal", TIMING, "pulse_timing", "1 + CLOCK_TOLERANCE", "1"),
    Fault("timing: a camera that tells nothing is ready", TIMING, "UNKNOWN_DEAD_S", "1e-3", "0.0"),
    Fault(
        "timing: the stated dead time replaces the camera's",
        TIMING,
        "_ready",
        "found | ...",
        "{PeriodLimit.STATED: end_s + dead_s} if dead_s else found",
    ),
    Fault(
        "timing: a gap of any length",
        TIMING,
        "pulse_timing",
        "if light_s < period_s < light_s + shown.gap_s:",
        "if light_s > period_s:",
    ),
    Fault(
        "timing: shown too briefly",
        TIMING,
        "_check_light",
        "exposure_s + readout_s < least_s",
        "exposure_s + readout_s < 0",
    ),
    Fault(
        "timing: shown for too long",
        TIMING,
        "_check_light",
        "exposure_s + readout_s > caps.longest_s",
        "exposure_s > caps.longest_s",
    ),
    Fault(
        "timing: played without a trigger output",
        TIMING,
        "pulse_timing",
        "if not shown.trigger_outputs:",
        "if shown.trigger_outputs < 0:",
    ),
    Fault(
        "stepped with a global reset",
        TIMING,
        "check_stepped",
        "if camera.caps.dark_s:",
        "if camera.caps.dark_s < 0:",
    ),
    Fault(
        "darkness of any length",
        PROJECTOR_BASE,
        "Projector.play",
        "if not dark_s >= 0:",
        "if dark_s < -1e9:",
    ),
    Fault(
        "a period of any length",
        PROJECTOR_BASE,
        "Projector.play",
        "if not period_s >= 0:",
        "if period_s < -1e9:",
    ),
]

SIMULATED = [
    Fault(
        "simulated: off by one",
        SIM,
        "SimProjector._show",
        "Show(self._loaded, i)",
        "Show(self._loaded, i - 1)",
    ),
    Fault(
        "simulated: blank is not dark",
        SIM,
        "SimProjector._blank",
        "self._bench.show = None",
        "self._loaded = self._loaded",
    ),
    Fault(
        "simulated: counts on after a stop",
        SIM,
        "SimCamera._arm",
        "self._index = 0",
        "self._index += 0",
    ),
]
