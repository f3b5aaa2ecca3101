"""Faults in the times of triggered runs, in the start of sequences, and in the check of a trigger."""

from __future__ import annotations

from tests.conformance.fault import Fault

TIMING = "fpplab/acquisition/timing.py"
CONTROLLER = "drivers/dlp4500/controller.py"
IN_FLASH = "drivers/dlp4500/in_flash.py"
SHIFT = "fpplab/setup/rig_check/exposure_shift.py"
SYNC = "fpplab/setup/rig_check/marker_check.py"
STEPS = "fpplab/setup/rig_check/steps.py"
IS_READY = "{} if told_s is None else {PeriodLimit.CAMERA: told_s}"
LEAST = "{PeriodLimit.EXPOSURE: end_s, PeriodLimit.LOADS: projector.loads.period_s}"

TIMED = [
    Fault("times: loads set no period", TIMING, "pulse_timing", LEAST, "{PeriodLimit.EXPOSURE: end_s}"),
    Fault(
        "times: less than the exposure",
        TIMING,
        "pulse_timing",
        "max(least[limit] + gap_s, end_s, projector.loads.period_s)",
        "least[limit] + gap_s",
    ),
    Fault("times: the least limit counts", TIMING, "pulse_timing", "max(least, key=...)", "min(least)"),
    Fault(
        "times: a global reset in the light",
        TIMING,
        "pulse_timing",
        "if caps.dark_s and not shown.dark_between:",
        "if caps.dark_s < 0:",
    ),
    Fault(
        "times: the gap is not named",
        TIMING,
        "pulse_timing",
        "limit, period_s = PeriodLimit.GAP, light_s + shown.gap_s",
        "period_s = light_s + shown.gap_s",
    ),
    Fault(
        "times: what is stated is not heard",
        TIMING,
        "_ready",
        "if told_s is None and dead_s is None:",
        "if told_s is None:",
    ),
    Fault("times: what the camera tells is not heard", TIMING, "_ready", IS_READY, "{}"),
    Fault(
        "times: dead from the pulse on",
        TIMING,
        "_ready",
        "{PeriodLimit.STATED: end_s + dead_s}",
        "{PeriodLimit.STATED: dead_s}",
    ),
    Fault(
        "times: a stepped plan does not settle",
        TIMING,
        "planned_timing",
        "plan.settle_s + exposure_s + rig.camera.caps.readout_s",
        "exposure_s + rig.camera.caps.readout_s",
    ),
    Fault(
        "times: a stepped plan is not read out",
        TIMING,
        "planned_timing",
        "plan.settle_s + exposure_s + rig.camera.caps.readout_s",
        "plan.settle_s + exposure_s",
    ),
    Fault(
        "times: the first pattern speaks for all",
        TIMING,
        "_check_light",
        "max((p.bit_depth for p in patterns), key=...)",
        "patterns[0].bit_depth",
    ),
    Fault(
        "dlp4500: loads take no time",
        IN_FLASH,
        "InFlash.loads",
        "1e-6 * least_period_us(self._slots, self._load_us)",
        "0.0",
    ),
    Fault("dlp4500: the first image is not counted", IN_FLASH, "_changes", "1 + sum(...)", "sum(...)"),
    Fault(
        "dlp4500: darkness from the video port",
        "drivers/dlp4500/on_video.py",
        "OnVideo.dark_between",
        "return False",
        "return True",
    ),
]
"""Of how long patterns are shown, and how far triggers are apart."""

STARTED = [
    Fault(
        "dlp4500: ordered again after the end",
        CONTROLLER,
        "Controller.start",
        "took_s < program.duration_s / 2",
        "took_s < START_S",
    ),
    Fault(
        "dlp4500: a short run is ordered once",
        CONTROLLER,
        "Controller.start",
        "if is_short and took_s < program.duration_s / 2:",
        "if is_short and took_s < 0:",
    ),
    Fault(
        "dlp4500: faults of an earlier run",
        CONTROLLER,
        "Controller._faults_until_running",
        "{*standing, HARDWARE_FAULTS['forced_swap_error']}",
        "{HARDWARE_FAULTS['forced_swap_error']}",
    ),
    Fault(
        "dlp4500: a late image ends the start",
        CONTROLLER,
        "Controller._faults_until_running",
        "{*standing, HARDWARE_FAULTS['forced_swap_error']}",
        "{*standing}",
    ),
    Fault(
        "dlp4500: what shows no fault runs",
        CONTROLLER,
        "Controller.start",
        "if faults is None or (is_short and not faults):",
        "if not faults:",
    ),
    Fault(
        "dlp4500: a short run has to be seen",
        CONTROLLER,
        "Controller.start",
        "if faults is None or (is_short and not faults):",
        "if faults is None:",
    ),
    Fault(
        "dlp4500: warnings are forgotten",
        CONTROLLER,
        "Controller.validate",
        "validation_messages(found, VALIDATION_WARNINGS)",
        "[]",
    ),
    Fault(
        "dlp4500: errors are warnings",
        CONTROLLER,
        "Controller.validate",
        "validation_messages(found, VALIDATION_ERRORS)",
        "validation_messages(found, {})",
    ),
    Fault(
        "dlp4500: busy is taken for done",
        CONTROLLER,
        "Controller.validate",
        'return not found["busy"]',
        "return True",
    ),
]
"""Of validation and start."""

CHECKED = [
    Fault(
        "check: frames in step are not mixed",
        SYNC,
        "MarkerInspection._of_trigger",
        "[_shifted(shift, plan.exposure_s)] if shift else []",
        "[]",
    ),
    Fault(
        "check: no pulse is no finding",
        SYNC,
        "MarkerInspection._of_trigger",
        "return [_no_pulse(len(shown))]",
        "return []",
    ),
    Fault(
        "check: the edge is not looked at",
        SYNC,
        "MarkerInspection._of_trigger",
        "return [_wrong_edge()]",
        "pass",
    ),
    Fault(
        "check: half of the dead time",
        SYNC,
        "MarkerInspection._of_trigger",
        "dead_s = math.ceil(...) / 1e4",
        "dead_s = gap_s / 2",
    ),
    Fault(
        "check: a slip is a shift",
        SHIFT,
        "exposure_shift",
        "LEAST_SHARE <= share <= MOST_SHARE",
        "LEAST_SHARE <= share",
    ),
    Fault("check: late is early", SHIFT, "exposure_shift", "step > 0", "step < 0"),
    Fault(
        "check: anything is a mixture",
        SHIFT,
        "exposure_shift",
        "misfit > MOST_MISFIT * np.ptp(own)",
        "misfit < 0.0",
    ),
    Fault("check: some frames are enough", STEPS, "_Steps._pulses", "came == len(greys)", "came > 0"),
    Fault("check: any rate will do", STEPS, "_Steps.rate", "fastest_s <= planned.period_s", "True"),
    Fault("check: a dark lamp will do", STEPS, "_Steps.lamp", "rise >= LEAST_RISE", "rise >= -1.0"),
]
"""Of the trigger's check."""
