"""Faults in the one interface that all backends share, in what uses it, and in the virtual bench."""

from __future__ import annotations

from tests.conformance.fault import Fault

DEVICE = "fpplab/devices/device.py"
CAMERA_BASE = "fpplab/devices/camera.py"
PROJECTOR_BASE = "fpplab/devices/projector.py"
STAGE_BASE = "fpplab/devices/stage.py"
FIXTURE_BASE = "fpplab/devices/fixture.py"
ACQUISITION = "fpplab/acquisition/acquire.py"
TIMING = "fpplab/acquisition/timing.py"
SYNCHRONISATION = "fpplab/acquisition/synchronisation.py"
MARKER = "fpplab/acquisition/sync_check.py"
RIG = "fpplab/devices/rig.py"
REPLAY = "fpplab/sessions/replay.py"
REFERENCE = "tests/conformance/reference.py"
SIM = "sim/devices.py"

LIFE = [
    Fault(
        "a foreign exception is swallowed",
        DEVICE,
        "Device._guard",
        "raise DeviceError(...) from error",
        "return",
    ),
    Fault(
        "a foreign exception passes as it is",
        DEVICE,
        "Device._guard",
        "except Exception as error:",
        "except ZeroDivisionError as error:",
    ),
    Fault(
        "a fault does not last",
        DEVICE,
        "Device._fault",
        "self._state = State.FAULT",
        "self._state = State.IDLE",
    ),
    Fault(
        "closing twice is refused",
        DEVICE,
        "Device.close",
        "if self._state is State.CLOSED:\n    return",
        'self._need(State.IDLE, State.ARMED, State.FAULT, doing="close")',
    ),
    Fault(
        "a failed closing leaves it open",
        DEVICE,
        "Device.close",
        "try:\n    ...\nfinally:\n    self._state = State.CLOSED",
        'with self._guard("close"):\n    self._close()\nself._state = State.CLOSED',
    ),
    Fault(
        "a failed opening counts as one",
        DEVICE,
        "Device.open",
        "self._close_quietly()\nraise",
        "self._close_quietly()\nself._state = State.IDLE\nraise",
    ),
    Fault(
        "opening twice is accepted",
        DEVICE,
        "Device.open",
        "if self._state is not State.CLOSED:",
        "if self._state is State.FAULT:",
    ),
    Fault("what was known survives a closing", DEVICE, "Device.open", "self._forget()", ""),
]

CAMERA = [
    Fault(
        "the exposure is clamped",
        CAMERA_BASE,
        "Camera.configure",
        'self._within("exposure_s", settings.exposure_s, caps.exposure_s, "s")',
        "least, most = caps.exposure_s\n"
        "settings = replace(settings, exposure_s=min(max(settings.exposure_s, least), most))",
    ),
    Fault(
        "the gain is not checked",
        CAMERA_BASE,
        "Camera.configure",
        'self._within("gain_db", settings.gain_db, caps.gain_db, "dB")',
        "",
    ),
    Fault(
        "the bits are not checked",
        CAMERA_BASE,
        "Camera.configure",
        "if settings.bits not in caps.bits:",
        "if settings.bits > 16:",
    ),
    Fault(
        "settings are returned as asked for",
        CAMERA_BASE,
        "Camera.configure",
        "return back",
        "return settings",
    ),
    Fault(
        "armed after the last frame",
        CAMERA_BASE,
        "Camera.read",
        "if self._taken == self._awaited:",
        "if self._taken > self._awaited:",
    ),
    Fault("armed after a stop", CAMERA_BASE, "Camera.stop", "self._state = State.IDLE", ""),
    Fault(
        "arming while armed",
        CAMERA_BASE,
        "Camera.arm",
        'self._need(State.IDLE, doing="arm")',
        'self._need(State.IDLE, State.ARMED, doing="arm")',
    ),
    Fault(
        "a lost frame is not noticed",
        CAMERA_BASE,
        "Camera._checked",
        "if frame.index != self._taken:",
        "if frame.index < self._taken:",
    ),
    Fault(
        "a trigger that is not there",
        CAMERA_BASE,
        "Camera.arm",
        "if trigger not in self.caps.triggers:",
        "if not trigger:",
    ),
    Fault("a frame is dropped", REFERENCE, "ReferenceCamera._read", "self._count += 1", "self._count += 2"),
    Fault(
        "a frame is repeated",
        REFERENCE,
        "ReferenceCamera._read",
        "self._buffer[...] = self._levels(pattern)",
        "if not self._buffer.any():\n    self._buffer[...] = self._levels(pattern)",
    ),
    Fault(
        "frames share a buffer",
        REFERENCE,
        "ReferenceCamera._read",
        "self._buffer.copy()",
        "self._buffer",
    ),
    Fault(
        "a time-out is ignored",
        REFERENCE,
        "ReferenceCamera._exposed",
        "raise DeviceTimeoutError(...)",
        "return self._bench.on_show",
    ),
    Fault("12 bits hold 8", REFERENCE, "ReferenceCamera._levels", "(1 << settings.bits) - 1", "255"),
    Fault(
        "another clock than the host's",
        REFERENCE,
        "ReferenceCamera._read",
        "time.time()",
        "time.monotonic()",
    ),
]

PROJECTOR = [
    Fault(
        "one pattern too far",
        PROJECTOR_BASE,
        "Projector.show",
        "if not 0 <= i < len(self._loaded):",
        "if not 0 <= i <= len(self._loaded):",
    ),
    Fault(
        "patterns from the end",
        PROJECTOR_BASE,
        "Projector.show",
        "if not 0 <= i < len(self._loaded):",
        "if not i < len(self._loaded):",
    ),
    Fault(
        "patterns of any size",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8",
        "pattern.image.dtype != np.uint8",
    ),
    Fault(
        "patterns of any kind",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "pattern.image.shape != (height, width) or pattern.image.dtype != np.uint8",
        "pattern.image.shape != (height, width)",
    ),
    Fault(
        "patterns of any depth",
        PROJECTOR_BASE,
        "Projector._check_pattern",
        "if pattern.bit_depth not in caps.bit_depths:",
        "if not pattern.bit_depth:",
    ),
    Fault(
        "too many patterns",
        PROJECTOR_BASE,
        "Projector.load",
        "if not 1 <= len(patterns) <= caps.max_patterns:",
        "if not 1 <= len(patterns):",
    ),
    Fault(
        "half a load",
        PROJECTOR_BASE,
        "Projector.load",
        "self._check_pattern(pattern, caps)",
        "self._check_pattern(pattern, caps)\nself._loaded = (*self._loaded, pattern)",
    ),
    Fault(
        "patterns are not copied",
        PROJECTOR_BASE,
        "",
        "pattern.image.copy()",
        "pattern.image.view()",
    ),
    Fault(
        "playing without a trigger output",
        PROJECTOR_BASE,
        "Projector.play",
        "if not caps.trigger_outputs:",
        "if caps.trigger_outputs < 0:",
    ),
    Fault(
        "playing too fast",
        PROJECTOR_BASE,
        "Projector.play",
        "if not exposure_s >= least:",
        "if exposure_s < 0:",
    ),
    Fault("shown while it plays", PROJECTOR_BASE, "Projector.play", "self._state = State.ARMED", ""),
    Fault(
        "off by one",
        REFERENCE,
        "ReferenceProjector._show",
        "self._held[i]",
        "self._held[i - 1]",
    ),
    Fault(
        "blank is not dark",
        REFERENCE,
        "ReferenceProjector._blank",
        "self._bench.on_show = None",
        "self._bench.pulses.clear()",
    ),
    Fault(
        "closing is not dark",
        REFERENCE,
        "ReferenceProjector._close",
        "self._bench.on_show = None",
        "self._held = []",
    ),
    Fault(
        "not quantised",
        REFERENCE,
        "ReferenceProjector._load",
        "quantise(p.image / 255.0, p.bit_depth)",
        "p.image",
    ),
    Fault(
        "pattern ids are lost",
        REFERENCE,
        "ReferenceProjector._load",
        "replace(...)",
        'replace(p, id="", image=quantise(p.image / 255.0, p.bit_depth))',
    ),
    Fault(
        "a replayed frame is another's",
        REPLAY,
        "ReplayCamera._read",
        "self._recording.session.read(index)",
        "self._recording.session.read(max(index - 1, 0))",
    ),
    Fault(
        "a replayed pattern is another",
        REPLAY,
        "ReplayProjector._show",
        "self._indices[i]",
        "self._indices[i - 1]",
    ),
]

STAGE_AND_FIXTURE = [
    Fault(
        "moves without homing",
        STAGE_BASE,
        "Stage.move_to",
        "if not self._homed:",
        "if self._homed is None:",
    ),
    Fault(
        "moves are clamped",
        STAGE_BASE,
        "Stage._check_travel",
        "least, most = self.caps.travel_mm",
        "least, most = self.caps.travel_mm\nmm = min(max(mm, least), most)",
    ),
    Fault(
        "the position asked for is returned",
        STAGE_BASE,
        "Stage.move_to",
        "return self._position_mm()",
        "return mm",
    ),
    Fault("a halt keeps the reference", STAGE_BASE, "Stage.halt", "self._homed = False", ""),
    Fault(
        "any item",
        FIXTURE_BASE,
        "Fixture._check_held",
        "if items is not None and item not in items:",
        "if not item:",
    ),
    Fault(
        "one pose too many",
        FIXTURE_BASE,
        "Fixture._check_held",
        "pose >= poses",
        "pose > poses",
    ),
]

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
